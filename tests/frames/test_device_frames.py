"""Frames on the device: their bounds, and reading each of them once."""

import numpy as np
import pytest
import warp as wp
from hypothesis import given
from hypothesis import strategies as st

import warpqem
from tests.support import meshes
from warpqem.frames.checked_frames import frame_bounds
from warpqem.frames.device_frames import HeldFrames
from warpqem.kernels.frame_bounds import LARGEST, measure_bounds
from warpqem.options import MeshOptions
from warpqem.pipeline.prepare import prepare
from warpqem.runtime.device import device_traits

POINTS, FACES = meshes.swaying_sphere(2, 21)


def bounds_of(points, used, lanes, device) -> np.ndarray:
    """(F, 7) as the kernel leaves them, with so many threads for a frame."""
    largest = float(LARGEST)
    initial = np.repeat(np.float32([[*3 * [largest], *3 * [-largest], 0]]), len(points), axis=0)
    bounds = wp.array(initial, device=device)
    inputs = [wp.array(points, dtype=wp.vec3, device=device), wp.array(used, dtype=wp.bool, device=device), lanes]
    wp.launch(measure_bounds, dim=(len(points), lanes), inputs=inputs, outputs=[bounds], device=device)
    return bounds.numpy()


@given(st.integers(0, 2**32 - 1), st.integers(1, 90), st.booleans())
def test_bounds_are_those_of_the_used_vertices_by_any_number_of_threads(seed, lanes, everywhere):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(3, 70, 3)).astype(np.float32)
    used = rng.random(70) < 0.3
    used[rng.integers(70)] = True
    found = bounds_of(points, used[:0] if everywhere else used, lanes, "cpu")
    low, high = frame_bounds(points if everywhere else points[:, used])
    np.testing.assert_array_equal(found, np.concatenate([low, high, np.zeros((3, 1))], axis=1))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("vertex", [0, 4, 69])
def test_a_point_that_is_not_finite_is_found_in_its_frame_also_where_no_face_is(value, vertex, device):
    points = np.ones((4, 70, 3), dtype=np.float32)
    points[2, vertex, 1] = value
    used = np.ones(70, dtype=bool)
    used[vertex] = False
    np.testing.assert_array_equal(bounds_of(points, used, 7, device)[:, 6], [0, 0, 1, 0])


def test_frames_that_are_held_are_those_put_there(device):
    held = HeldFrames.empty(*POINTS.shape[:2], device)
    for frames in (slice(8, 21), slice(0, 8)):
        held.put(frames, POINTS[frames])
    np.testing.assert_array_equal(held.points.numpy(), POINTS)
    np.testing.assert_array_equal(held.block(slice(5, 9)).numpy(), POINTS[5:9])


class CountedReads:
    """Frames of an array, and how often each was read."""

    def __init__(self, points) -> None:
        self._points, self.dtype = points, points.dtype
        self.frame_count, self.vertex_count = points.shape[:2]
        self.reads = np.zeros(len(points), dtype=int)

    def read(self, frames: slice) -> np.ndarray:
        self.reads[frames] += 1
        return self._points[frames]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_device_with_memory_of_its_own_gets_every_frame_once(dtype, device):
    source = CountedReads(POINTS.astype(dtype))
    result = warpqem.simplify(source, FACES, ratio=0.3, key_frames=4, measure=False, device=device)
    own = device_traits(device).own_memory
    assert (result.plan.device_frame_bytes > 0) == own
    assert (source.reads == 1).all() if own else source.reads.max() > 1
    whole = warpqem.simplify(POINTS.astype(dtype), FACES, ratio=0.3, key_frames=4, device=device)
    np.testing.assert_array_equal(result.points, whole.points)


def test_frames_are_not_held_where_the_memory_is_for_a_block_of_them(device):
    long = np.tile(POINTS, (60, 1, 1))
    options = MeshOptions(ratio=0.3, key_frames=4, device=device)
    plan = warpqem.plan(long, FACES, ratio=0.3, key_frames=4, device=device)
    limit = plan.peak_bytes - plan.device_frame_bytes
    assert warpqem.plan(long, FACES, memory=limit, ratio=0.3, key_frames=4, device=device).device_frame_bytes == 0
    assert (prepare(long, FACES, options).mesh.held is not None) == device_traits(device).own_memory
