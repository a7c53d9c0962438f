"""Every public function may be called from several threads, and gives the bits of serial calls."""

import asyncio
import multiprocessing
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import warp as wp
from pxr import Usd, UsdGeom

import warpqem
from tests.support.meshes import bending_bar, waving_grid
from warpqem.errors import DeviceError
from warpqem.measure import compare
from warpqem.picture.render import fit_view, render
from warpqem.pipeline.surface_transfer import surface_transfer
from warpqem.runtime import device as devices
from warpqem.usd.commands.simplify import simplify_stage
from warpqem.usd.commands.simplify_options import SimplifyOptions

CAPE = Path(__file__).parents[2] / "scenes" / "cape_wind.usdc"
# Longer than any call here takes; a call that waits for itself would hang.
PATIENCE = 60


def simplified(points, faces, **options):
    result = warpqem.simplify(points, faces, device="cpu", **options)
    return result.points, result.faces, result.vertex_map


def levels(points, faces):
    return [level.points for level in warpqem.simplify_levels(points, faces, ratios=[0.5, 0.2], device="cpu")]


def progressive(points, faces):
    mesh = warpqem.build_progressive(points, faces, base_faces=50, device="cpu")
    return mesh.level(0).points, mesh.level(20).points


def compared(points, faces):
    found = compare(points, faces, points * np.float32(1.01), faces, samples=300, device="cpu")
    return found.rms, found.hausdorff, found.jitter, found.slide


def features(points, faces):
    return (warpqem.motion_features(points, faces, device="cpu").label,)


def transferred(points, faces):
    result = warpqem.simplify(points, faces, ratio=0.4, device="cpu")
    return (surface_transfer(points[0], faces, result, device="cpu").wedge_weight,)


def symmetric(points, faces):
    return (warpqem.simplify_symmetric(points, faces, ratio=0.4, device="cpu").points,)


def drawn(points, faces):
    return (render(points[0], faces, fit_view(points), size=(40, 30), device="cpu"),)


CALLS = {
    "default": lambda p, f: simplified(p, f, ratio=0.3),
    "refit": lambda p, f: simplified(p, f, ratio=0.2, refit=True),
    "best": lambda p, f: simplified(p, f, ratio=0.2, refit=True, memoryless=True),
    "dod": lambda p, f: simplified(p, f, ratio=0.4, metric="dod"),
    "aqem": lambda p, f: simplified(p, f, ratio=0.4, metric="aqem"),
    "error": lambda p, f: simplified(p, f, max_error=0.5),
    "endpoint": lambda p, f: simplified(p, f, ratio=0.3, placement="endpoint", lock_borders=True),
    "levels": levels,
    "progressive": progressive,
    "compare": compared,
    "features": features,
    "transfer": transferred,
    "render": drawn,
}
MESHES = (waving_grid(14, frames=3), bending_bar(12, 24, frames=4))


@pytest.fixture(scope="module")
def serial():
    """What each call gives for each mesh when nothing else runs."""
    return {(name, k): call(*MESHES[k]) for name, call in CALLS.items() for k in range(len(MESHES))}


def same(left, right):
    return all(np.array_equal(a, b) for a, b in zip(left, right, strict=True))


@pytest.mark.parametrize("thread_count", [2, 6])
def test_threads_give_the_bits_of_serial_calls(serial, thread_count):
    def work(seed):
        rng = np.random.default_rng(seed)
        calls = [(name, int(rng.integers(len(MESHES)))) for name in rng.permutation(list(CALLS))]
        return [(name, k, same(CALLS[name](*MESHES[k]), serial[name, k])) for name, k in calls]

    with ThreadPoolExecutor(thread_count) as pool:
        checked = [row for rows in pool.map(work, range(thread_count), timeout=PATIENCE) for row in rows]
    assert [(name, k) for name, k, right in checked if not right] == []


def test_asyncio_gives_the_bits_of_serial_calls(serial):
    async def run():
        return await asyncio.gather(*(asyncio.to_thread(CALLS["default"], *MESHES[k % 2]) for k in range(6)))

    for k, result in enumerate(asyncio.run(asyncio.wait_for(run(), PATIENCE))):
        assert same(result, serial["default", k % 2])


def test_threads_may_simplify_one_stage(tmp_path):
    def run(name):
        output = tmp_path / f"{name}.usdc"
        simplify_stage(CAPE, output, SimplifyOptions(ratio=0.1, device="cpu"))
        stage = Usd.Stage.Open(str(output))
        (mesh,) = [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)]
        points = UsdGeom.Mesh(mesh).GetPointsAttr()
        return [np.asarray(points.Get(time)) for time in points.GetTimeSamples()]

    expected = run("serial")
    with ThreadPoolExecutor(3) as pool:
        results = list(pool.map(run, ("a", "b", "c"), timeout=PATIENCE))
    assert all(same(result, expected) for result in results)


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="no fork")
@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
def test_a_forked_process_gives_the_bits_of_this_one(serial):
    with multiprocessing.get_context("fork").Pool(1) as pool:
        points, faces, _ = pool.apply_async(simplified, MESHES[0], {"ratio": 0.3}).get(PATIENCE)
    assert same((points, faces), serial["default", 0][:2])


@pytest.fixture
def capturing(monkeypatch):
    """The CPU as a device that captures graphs, and so takes one thread at a time."""
    monkeypatch.setitem(devices._TRAITS, "cpu", replace(devices.CPU, captures=True))


def test_a_device_that_captures_takes_one_thread_at_a_time(capturing, serial):
    with ThreadPoolExecutor(4) as pool:
        results = list(pool.map(lambda k: CALLS["best"](*MESHES[k % 2]), range(8), timeout=PATIENCE))
    assert all(same(result, serial["best", k % 2]) for k, result in enumerate(results))


class Nested:
    """Frames whose reading simplifies another mesh, on the thread that reads ahead."""

    dtype = np.dtype(np.float32)

    def __init__(self, points, faces):
        self._points, self._faces = points, faces
        self.frame_count, self.vertex_count = points.shape[:2]
        self.threads = set()

    def read(self, frames):
        self.threads.add(threading.get_ident())
        warpqem.simplify(self._points[:1], self._faces, ratio=0.5, device="cpu")
        return self._points[frames]


class NestedSink:
    """Takes frames, and simplifies another mesh at each block."""

    def __init__(self, points, faces):
        self._mesh, self.blocks = (points, faces), []

    def begin(self, frame_count, vertex_count, faces):
        pass

    def write(self, frames, points):
        warpqem.simplify(self._mesh[0][:1], self._mesh[1], ratio=0.5, device="cpu")
        self.blocks.append(points.copy())


def test_frames_may_come_from_code_that_uses_the_device(capturing, monkeypatch):
    # Eight frames a block.
    monkeypatch.setattr("warpqem.pipeline.memory_plan.BLOCK_BYTES", 1)
    monkeypatch.setattr("warpqem.frames.blocks.BLOCK_BYTES", 1)
    points, faces = waving_grid(10, frames=20)
    source, sink = Nested(points, faces), NestedSink(points, faces)
    with ThreadPoolExecutor(1) as pool:
        pool.submit(warpqem.simplify, source, faces, ratio=0.3, sink=sink, device="cpu").result(PATIENCE)
    assert len(source.threads) > 1
    assert len(sink.blocks) == 3
    assert np.array_equal(np.concatenate(sink.blocks), warpqem.simplify(points, faces, ratio=0.3, device="cpu").points)


def test_a_failed_call_gives_its_turn_back(capturing):
    points, faces = MESHES[0]
    with pytest.raises(warpqem.errors.OptionError):
        warpqem.simplify(points, faces, ratio=2.0, device="cpu")
    with ThreadPoolExecutor(1) as pool:
        pool.submit(warpqem.simplify, points, faces, ratio=0.5, device="cpu").result(PATIENCE)


def test_a_capture_of_the_callers_is_refused():
    points, faces = MESHES[0]
    with wp.ScopedCapture(device="cpu"), pytest.raises(DeviceError, match="a graph is being captured on cpu"):
        warpqem.simplify(points, faces, ratio=0.5, device="cpu")
