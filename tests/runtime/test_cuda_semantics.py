"""Captured graphs hold what they use, and results do not depend on the order of threads.

Most of it runs under ``CUDA_SEMANTICS`` only, see ``cuda_semantics.py``.
"""

import os
import weakref
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp

import warpqem
from tests.support import cuda_semantics
from tests.support.meshes import waving_grid
from warpqem.decimation.pass_steps import HISTOGRAM_BINS
from warpqem.frames.blocks import CHUNK_FRAMES
from warpqem.kernels.work import EdgeList
from warpqem.runtime import device, launches
from warpqem.runtime.launches import Recorder

under_cuda_semantics = pytest.mark.skipif("CUDA_SEMANTICS" not in os.environ, reason="needs CUDA_SEMANTICS")


@wp.kernel
def take_numbers(next_number: wp.array[wp.int32], place: wp.array[wp.int32]):
    place[wp.tid()] = wp.atomic_add(next_number, 0, 1)


@wp.kernel
def count_up(edges: EdgeList):
    edges.count[wp.tid()] += 1


def test_the_mode_is_made_for_one_version_of_warp(monkeypatch):
    monkeypatch.setattr(wp, "__version__", "1.20.0")
    with pytest.raises(RuntimeError, match=r"made for Warp 1\.19, this is 1\.20\.0"):
        cuda_semantics.install("shuffled")


@under_cuda_semantics
def test_threads_run_in_the_order_asked_for():
    place = wp.zeros(100, dtype=wp.int32, device="cpu")
    wp.launch(take_numbers, dim=100, inputs=[wp.zeros(1, dtype=wp.int32, device="cpu"), place], device="cpu")
    forward = np.array_equal(place.numpy(), np.arange(100))
    assert forward == (os.environ["CUDA_SEMANTICS"] == "forward")
    assert np.array_equal(np.sort(place.numpy()), np.arange(100))


OPTIONS = {
    "default": {"ratio": 0.3},
    "best": {"ratio": 0.2, "refit": True, "memoryless": True},
    "dod": {"ratio": 0.3, "metric": "dod"},
    "aqem": {"ratio": 0.3, "metric": "aqem"},
    "one frame": {"ratio": 0.3, "metric": "qem"},
    "error": {"max_error": 0.5, "lock_borders": True},
}


@pytest.fixture
def every_order():
    """The orders of threads to try, shuffled twice; afterwards the one asked for."""
    yield [*cuda_semantics.ORDERS, "shuffled"]
    cuda_semantics.set_order(os.environ["CUDA_SEMANTICS"])


@under_cuda_semantics
def test_sums_over_chunks_of_frames_do_not_depend_on_the_order_of_threads(every_order):
    points, faces = waving_grid(9, frames=2 * CHUNK_FRAMES + 6)
    results, factors = [], []
    for order in every_order:
        cuda_semantics.set_order(order)
        results.append(warpqem.simplify(points, faces, ratio=0.3, metric="dod", device="cpu"))
        factors.append(warpqem.motion_features(points, faces, device="cpu").factor)
    for result, factor in zip(results[1:], factors[1:], strict=True):
        assert np.array_equal(result.log.removed, results[0].log.removed)
        assert np.array_equal(result.log.cost, results[0].log.cost)
        assert np.array_equal(result.points, results[0].points)
        assert np.array_equal(factor, factors[0])


@under_cuda_semantics
@pytest.mark.parametrize("options", OPTIONS.values(), ids=OPTIONS)
def test_results_do_not_depend_on_the_order_of_threads(options):
    (large, large_faces), (small, small_faces) = waving_grid(14, frames=3), waving_grid(5, frames=3)
    points = np.concatenate([large, small + np.float32(2)], axis=1)
    faces = np.concatenate([large_faces, small_faces + large.shape[1]])
    results = []
    try:
        for order in [*cuda_semantics.ORDERS, "shuffled"]:
            cuda_semantics.set_order(order)
            results.append(warpqem.simplify(points, faces, device="cpu", **options))
    finally:
        cuda_semantics.set_order(os.environ["CUDA_SEMANTICS"])
    for result in results[1:]:
        assert np.array_equal(result.points, results[0].points)
        assert np.array_equal(result.faces, results[0].faces)
        assert np.array_equal(result.vertex_map, results[0].vertex_map)


@pytest.mark.parametrize(("threshold", "expected"), [(0, [1.0]), (2**30, [])], ids=["not set", "set by the caller"])
def test_a_gpu_keeps_freed_memory_unless_the_caller_says_how_much(threshold, expected, monkeypatch):
    kept = []
    monkeypatch.setattr(wp, "get_device", lambda name: SimpleNamespace(is_cuda=True))
    monkeypatch.setattr(wp, "is_mempool_enabled", lambda device: True)
    monkeypatch.setattr(wp, "get_mempool_release_threshold", lambda device: threshold)
    monkeypatch.setattr(wp, "set_mempool_release_threshold", lambda device, share: kept.append(share))
    device._keep_freed_memory("cuda:0")
    assert kept == expected


@under_cuda_semantics
def test_numpy_copies():
    array = wp.zeros(3, dtype=wp.int32, device="cpu")
    array.numpy()[:] = 1
    assert not array.numpy().any()


@under_cuda_semantics
def test_a_recorder_holds_its_arrays():
    array = wp.full(4, 7, dtype=wp.int32, device="cpu")
    recorder = Recorder("cpu")
    recorder.copy(array, wp.full(4, 9, dtype=wp.int32, device="cpu"))
    run = recorder.finish()
    del recorder
    run()
    assert (array.numpy() == 9).all()


@under_cuda_semantics
def test_a_recorder_holds_the_members_of_structs():
    edges = EdgeList()
    edges.count, edges.half_edge = (wp.zeros(4, dtype=wp.int32, device="cpu") for _ in range(2))
    recorder = Recorder("cpu")
    recorder.launch(count_up, 4, [edges])
    run = recorder.finish()
    count = weakref.ref(edges.count)
    del recorder, edges
    run()
    assert (count().numpy() == 1).all()


@under_cuda_semantics
@pytest.mark.parametrize(
    "is_lost",
    [lambda array: True, lambda array: array.shape == (1, HISTOGRAM_BINS), lambda array: array.shape == (1,)],
    ids=["all", "histogram", "counts"],
)
def test_simplifying_fails_where_references_are_lost(is_lost, monkeypatch):
    unique = launches._unique
    monkeypatch.setattr(launches, "_unique", lambda arrays: tuple(a for a in unique(arrays) if not is_lost(a)))
    points, faces = waving_grid(8, frames=2)
    with pytest.raises(cuda_semantics.FreedArrayError):
        warpqem.simplify(points, faces, ratio=0.3, device="cpu")
