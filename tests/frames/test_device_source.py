"""Arrays that are on a device already: they stay there, and so does the result."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import warp as wp
from hypothesis import given
from hypothesis import strategies as st

import warpqem
from tests.support import meshes
from tests.support.device_arrays import FACES, OPTIONS, POINTS, RESULT_ARRAYS, assert_same, on
from warpqem.errors import DegenerateMeshError, MeshShapeError, NonFinitePointError, UnreachableTargetError
from warpqem.frames.device_source import DeviceFrames
from warpqem.frames.stream import ArraySink, SharedFrames, read_ahead
from warpqem.kernels.frame_origin import subtract_origin
from warpqem.runtime import device as devices


@pytest.fixture
def there(monkeypatch, device) -> str:
    """A device with memory of its own: a GPU, or the CPU that says so."""
    if not devices.device_traits(device).own_memory:
        monkeypatch.setitem(devices._TRAITS, "cpu", replace(devices.device_traits("cpu"), own_memory=True))
    return device


@contextmanager
def values_read(monkeypatch) -> Iterator[list[int]]:
    """How many values each ``numpy()`` of a Warp array brings to the host."""
    sizes: list[int] = []
    numpy = wp.array.numpy

    def counting(self: wp.array) -> np.ndarray:
        sizes.append(self.size * getattr(self.dtype, "_length_", 1))
        return numpy(self)

    with monkeypatch.context() as patch:
        patch.setattr(wp.array, "numpy", counting)
        yield sizes


VECTORS = {"float16": wp.vec3h, "float32": wp.vec3, "float64": wp.vec3d}
KINDS = {
    "scalars": lambda points, device: wp.array(points, device=device),
    "vectors": lambda points, device: wp.array(points, dtype=VECTORS[points.dtype.name], device=device),
    "every other frame": lambda points, device: wp.array(np.repeat(points, 2, axis=0), device=device)[::2],
    "every other vertex": lambda points, device: wp.array(np.repeat(points, 2, axis=1), device=device)[:, ::2],
    "every other number": lambda points, device: wp.array(np.repeat(points, 2, axis=2), device=device)[:, :, ::2],
    "indexed": lambda points, device: wp.array(points[::-1].copy(), device=device)[
        wp.array(np.arange(len(points))[::-1].copy(), dtype=wp.int32, device=device)
    ],
}


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
@pytest.mark.parametrize("kind", sorted(KINDS))
def test_points_there_give_the_bits_of_points_here_in_any_type_and_layout(kind, dtype, there):
    points = (POINTS + 7).astype(dtype)
    expected = warpqem.simplify(points, FACES, device=there, **OPTIONS)
    found = warpqem.simplify(KINDS[kind](points, there), FACES, device=there, **OPTIONS)
    assert_same(found, expected)


def test_whole_numbers_there_give_the_bits_of_those_here(there):
    points = np.rint(1000 * POINTS).astype(np.int32)
    found = warpqem.simplify(*on(there, points), device=there, **OPTIONS)
    assert_same(found, warpqem.simplify(points, FACES, device=there, **OPTIONS))


def test_result_is_on_the_device_of_the_points(there):
    found = warpqem.simplify(*on(there), **OPTIONS)
    frames, vertices, faces = 21, found.points.shape[1], len(found.faces)
    shapes = ((frames, vertices, 3), (faces, 3), (len(POINTS[0]),), (faces,))
    for name, shape in zip(RESULT_ARRAYS, shapes, strict=True):
        array = getattr(found, name)
        assert isinstance(array, wp.array), name
        dtype = wp.float32 if name == "points" else wp.int32
        assert (array.device.alias, array.shape, array.dtype) == (there, shape, dtype), name
    assert repr(found).startswith(f"SimplifiedMesh({faces} faces, {vertices} vertices, 21 frames")


def test_result_is_on_the_host_where_the_points_are(there):
    for points in (POINTS, POINTS.tolist()):
        found = warpqem.simplify(points, wp.array(FACES, device=there), device=there, **OPTIONS)
        assert all(isinstance(getattr(found, name), np.ndarray) for name in RESULT_ARRAYS)
        assert found.numpy() is found


def test_pose_alone_is_one_frame(there):
    expected = warpqem.simplify(POINTS[0], FACES, ratio=0.3, device=there)
    for points in (wp.array(POINTS[0], device=there), wp.array(POINTS[0], dtype=wp.vec3, device=there)):
        found = warpqem.simplify(points, FACES, ratio=0.3)
        assert found.points.shape == expected.points.shape
        assert_same(found, expected)


def test_frames_are_not_copied_to_the_host(there, monkeypatch):
    # Poses are compared at 1024 to 2047 vertices, which a larger mesh has more of.
    points, faces = meshes.swaying_sphere(5, 40)
    given = on(there, points.astype(np.float32), faces)
    options = {"ratio": 0.05, "key_frames": 4, "quality": "fast"}
    with values_read(monkeypatch) as sizes:
        found = warpqem.simplify(*given, **options)
    frame = points[0].size
    poses = 3 * 40 * 2047
    # The topology, the log and masks are there: some numbers for a vertex or a face, and none for a frame of it.
    assert sum(sizes) < poses + 12 * frame < 0.5 * points.size
    with values_read(monkeypatch) as sizes:
        warpqem.simplify(*given, ratio=0.05, key_frames=None, quality="fast")
    assert sum(sizes) < 12 * frame
    assert isinstance(found.points, wp.array)


@pytest.mark.parametrize(("dtype", "expected"), [(np.float32, []), (np.float64, [slice(0, 1)])])
@pytest.mark.parametrize("options", [OPTIONS, {"ratio": 0.3, "metric": "aqem"}], ids=["dqem", "aqem"])
def test_of_double_precision_the_first_frame_alone_is_read(options, dtype, expected, there, monkeypatch):
    read, reads = DeviceFrames.read, []
    monkeypatch.setattr(DeviceFrames, "read", lambda self, frames: (reads.append(frames), read(self, frames))[1])
    warpqem.simplify(*on(there, POINTS.astype(dtype)), quality="fast", **options)
    assert reads == expected


def test_single_precision_is_used_in_place(there):
    points = wp.array(POINTS, device=there)
    frames = DeviceFrames(points)
    assert frames.whole.ptr == points.ptr
    assert frames.block(slice(5, 9), np.zeros(3)).ptr == points.ptr + 5 * POINTS[0].nbytes
    plan = warpqem.plan(points, FACES, **OPTIONS)
    here = warpqem.plan(POINTS, FACES, device=there, **OPTIONS)
    assert plan.device_frame_bytes == 0
    assert plan.held_bytes == here.held_bytes - POINTS.nbytes


def test_plan_reads_no_frame(there, monkeypatch):
    given = wp.array(POINTS, device=there)
    with values_read(monkeypatch) as sizes:
        warpqem.plan(given, FACES, **OPTIONS)
    assert max(sizes, default=0) <= FACES.size


def test_input_stays_as_it_is(there):
    given = on(there)
    warpqem.simplify(*given, **OPTIONS)
    np.testing.assert_array_equal(given[0].numpy(), POINTS)
    np.testing.assert_array_equal(given[1].numpy(), FACES)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_frames_that_have_no_room_there_are_converted_as_they_are_needed(dtype, there):
    long = np.tile(POINTS, (20, 1, 1)).astype(dtype)
    asked = {"ratio": 0.3, "key_frames": 4}
    points = wp.array(np.repeat(long, 2, axis=2), device=there)[:, :, ::2]
    plan = warpqem.plan(points, FACES, **asked)
    limit = plan.peak_bytes - plan.device_frame_bytes
    assert warpqem.plan(points, FACES, memory=limit, **asked).device_frame_bytes == 0
    found = warpqem.simplify(points, FACES, memory=limit, **asked)
    assert_same(found, warpqem.simplify(long, FACES, device=there, **asked))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(("frame", "value"), [(0, np.nan), (13, np.inf), (20, -np.inf)])
def test_point_that_is_not_finite_is_named(frame, value, dtype, there):
    points = POINTS.astype(dtype)
    points[frame, 7, 1] = value
    points[20, 9, 0] = value
    with pytest.raises(NonFinitePointError, match=rf"vertex 7 in frame {frame} has y = {value} \(2 such points in all"):
        warpqem.simplify(*on(there, points), **OPTIONS)


@pytest.mark.parametrize("value", [1e39, -1e300])
def test_point_beyond_single_precision_is_named(value, there):
    points = POINTS.astype(np.float64)
    points[3, 5, 2] = value
    with pytest.raises(NonFinitePointError, match=r"vertex 5 in frame 3 has z = -?1e\+"):
        warpqem.simplify(*on(there, points), **OPTIONS)


@pytest.mark.parametrize(
    "wrong", [POINTS[..., :2], POINTS[None], POINTS[:0], POINTS[:, :0], POINTS > 0, POINTS[0, :, 0]], ids=range(6)
)
def test_wrong_arrays_there_are_refused_in_the_same_words(wrong, there):
    messages = []
    for points in (np.ascontiguousarray(wrong), wp.array(wrong, device=there)):
        with pytest.raises((MeshShapeError, DegenerateMeshError)) as error:
            warpqem.simplify(points, FACES, device=there, **OPTIONS)
        messages.append((error.type, str(error.value)))
    assert messages[0] == messages[1]


def test_matrices_are_refused_by_name(there):
    with pytest.raises(MeshShapeError, match=r"points must have shape .* got \(21, 3, 3, 3\)"):
        warpqem.simplify(wp.zeros((21, 3), dtype=wp.mat33, device=there), FACES, **OPTIONS)


@pytest.mark.parametrize(
    "options",
    [
        {"metric": "aqem", "ratio": 0.3},
        {"metric": "dod", "ratio": 0.3},
        {"ratio": 0.3, "refit": True},
        {"max_distance": 3.0},
        {"ratio": 0.3, "placement": "endpoint"},
    ],
    ids=str,
)
def test_other_ways_give_the_same_bits_there(options, there):
    found = warpqem.simplify(*on(there), **options)
    assert_same(found, warpqem.simplify(POINTS, FACES, device=there, **options))
    assert isinstance(found.points, wp.array)


def test_mended_topology_gives_the_same_bits_there(there):
    # Two spheres that meet in every third vertex: these are cut, which only many of them are.
    points = np.concatenate([POINTS, POINTS + np.float32(1)], axis=1)
    other = np.where(FACES % 3 == 0, FACES, FACES + len(POINTS[0]))
    faces = np.concatenate([FACES, other]).astype(np.int32)
    for dtype in (np.float32, np.float64):
        expected = warpqem.simplify(points.astype(dtype), faces, device=there, **OPTIONS)
        assert len(expected.repair.vertex) > points.shape[1]
        assert_same(warpqem.simplify(*on(there, points.astype(dtype), faces), **OPTIONS), expected)


def test_levels_are_there_too(there):
    found = warpqem.simplify_levels(*on(there), ratios=[0.5, 0.2])
    expected = warpqem.simplify_levels(POINTS, FACES, ratios=[0.5, 0.2], device=there)
    for level, other in zip(found, expected, strict=True):
        assert isinstance(level.points, wp.array)
        assert_same(level, other)


def test_many_meshes_are_there_too_each_where_its_points_were(there):
    found = warpqem.simplify_many([on(there), (POINTS, FACES)], ratio=0.3, device=there)
    assert [type(result.points) for result in found] == [wp.array, np.ndarray]
    assert_same(found[0], found[1])


def test_unreachable_result_is_there_too(there):
    given = on(there)
    for options in ({}, {"max_distance": 0.5}):
        with pytest.raises(UnreachableTargetError) as error:
            warpqem.simplify(*given, target_faces=2, locked=np.arange(len(POINTS[0])), **options)
        assert isinstance(error.value.result.points, wp.array)


def test_sink_gets_frames_on_the_host_and_so_is_the_rest(there):
    sink = ArraySink()
    found = warpqem.simplify(*on(there), sink=sink, **OPTIONS)
    expected = warpqem.simplify(POINTS, FACES, device=there, **OPTIONS)
    np.testing.assert_array_equal(sink.points, expected.points)
    assert all(isinstance(getattr(found, name), np.ndarray) for name in RESULT_ARRAYS)
    assert found.measured == expected.measured


def test_result_there_is_measured_saved_and_transferred_like_one_here(there, tmp_path):
    found = warpqem.simplify(*on(there), **OPTIONS)
    expected = warpqem.simplify(POINTS, FACES, device=there, **OPTIONS)
    assert found.measured == expected.measured
    assert found._repr_png_() == expected._repr_png_()
    np.testing.assert_array_equal(found.corner_clusters(FACES), expected.corner_clusters(FACES))
    np.testing.assert_array_equal(found.to_trimesh(2).vertices, expected.to_trimesh(2).vertices)
    files = [result.save(tmp_path / f"{index}_##.ply") for index, result in enumerate((found, expected))]
    assert len(files[0]) == len(files[1]) == 21

    from warpqem.pipeline.surface_transfer import surface_transfer

    transfers = [surface_transfer(POINTS[0], FACES, result, device=there) for result in (found, expected)]
    np.testing.assert_array_equal(transfers[0].wedge_weight, transfers[1].wedge_weight)


def test_motion_features_are_found_there(there, monkeypatch):
    given = on(there)
    with values_read(monkeypatch) as sizes:
        found = warpqem.motion_features(*given)
    assert max(sizes) <= FACES.size
    np.testing.assert_array_equal(found.factor, warpqem.motion_features(POINTS, FACES, device=there).factor)


def test_warp_arrays_of_the_host_are_taken_without_a_copy(monkeypatch):
    points = wp.array(POINTS, dtype=wp.vec3, device="cpu")
    if devices.device_traits("cpu").own_memory:
        pytest.skip("the CPU works like a device")
    assert warpqem.mesh.mesh_input.read_points(points, "points").ctypes.data == points.ptr
    found = warpqem.simplify(points, wp.array(FACES, device="cpu"), device="cpu", **OPTIONS)
    assert isinstance(found.points, np.ndarray)
    assert_same(found, warpqem.simplify(POINTS, FACES, device="cpu", **OPTIONS))


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 1e6, 1e30]))
def test_origin_goes_before_rounding_and_what_is_not_finite_is_nan(seed, size):
    rng = np.random.default_rng(seed)
    points = size + rng.normal(size=(2, 9, 3))
    points.reshape(-1)[rng.integers(54)] = rng.choice([np.nan, np.inf, -1e39, 3.0])
    origin = points[0, 0] if np.isfinite(points[0, 0]).all() else np.full(3, size)
    out = wp.empty((2, 9), dtype=wp.vec3, device="cpu")
    inputs = [wp.array(points, dtype=wp.vec3d, device="cpu"), wp.vec3d(*origin)]
    wp.launch(subtract_origin, dim=out.shape, inputs=inputs, outputs=[out], device="cpu")
    fits = np.abs(points) <= np.finfo(np.float32).max
    with np.errstate(invalid="ignore", over="ignore"):
        np.testing.assert_array_equal(out.numpy(), np.where(fits, (points - origin).astype(np.float32), np.nan))


def ends(function: Any) -> bool:
    """Whether a function comes to its end, and to no error, on a thread of its own."""
    ended = threading.Event()
    thread = threading.Thread(target=lambda: (function(), ended.set()), daemon=True)
    thread.start()
    thread.join(timeout=60)
    return ended.is_set()


BLOCKS = [slice(0, 8), slice(8, 16), slice(16, 21)]


def test_frames_are_read_ahead_in_turns_also_where_nobody_waits_for_the_last(there, monkeypatch):
    monkeypatch.setitem(devices._TRAITS, "cpu", replace(devices.device_traits("cpu"), captures=True))
    frames, seen = DeviceFrames(wp.array(POINTS, device=there)), []

    def read() -> None:
        with devices.device_turn(there):
            seen.extend(points for _, points in read_ahead(frames.read, BLOCKS))
            for _ in read_ahead(frames.read, BLOCKS):
                break

    assert ends(read)
    np.testing.assert_array_equal(np.concatenate(seen), POINTS)


def test_two_readers_of_shared_frames_do_not_wait_for_each_other(there, monkeypatch):
    monkeypatch.setitem(devices._TRAITS, "cpu", replace(devices.device_traits("cpu"), captures=True))
    frames = SharedFrames(DeviceFrames(wp.array(POINTS, device=there)))

    def read() -> None:
        with devices.device_turn(there):
            for _ in range(20):
                for block, points in read_ahead(frames.read, BLOCKS):
                    np.testing.assert_array_equal(points, frames.read(block))

    assert ends(read)
