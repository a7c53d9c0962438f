"""Blocks of frames, and arithmetic on their lanes."""

from typing import Any

import numpy as np
import pytest
import warp as wp

from tests.support.mesh_state import blocks, packed
from warpqem.frames.blocks import block_width, pack_frames, unpack_frames
from warpqem.kernels.lanes import lane_cross, lane_dot, lane_inverse_length, lane_scale, lane_sum

wp.set_module_options({"enable_backward": False})  # no gradients are taken


@wp.kernel
def combine_points(
    # in
    a_in: Any,
    b_in: Any,
    # out
    cross_out: Any,
    unit_out: Any,
    dot_sum_out: wp.array[wp.float32],
):
    v, t = wp.tid()
    a = a_in[v, t]
    b = b_in[v, t]
    cross_out[v, t] = lane_cross(a, b)
    unit_out[v, t] = lane_scale(lane_inverse_length(a), a)
    dot_sum_out[v * a_in.shape[1] + t] = lane_sum(lane_dot(a, b))


def random_points(frame_count, vertex_count=5, seed=0):
    return np.random.default_rng(seed).normal(size=(frame_count, vertex_count, 3)).astype(np.float32)


def unpacked(packed_points, frame_count) -> np.ndarray:
    points = wp.empty((frame_count, len(packed_points)), dtype=wp.vec3, device=packed_points.device)
    unpack_frames(packed_points, points)
    return points.numpy()


@pytest.mark.parametrize("frame_count", [1, 2, 8, 13])
def test_unpacked_frames_are_those_packed(frame_count, device):
    points = random_points(frame_count)
    np.testing.assert_array_equal(unpacked(pack_frames(points, device), frame_count), points)


def test_frames_that_fill_up_the_last_block_are_zero(device):
    packed_points = pack_frames(random_points(13), device)
    width = block_width(13, device)
    filled = blocks(packed_points, packed_points.shape[1] * width)
    assert filled[:, :13].any(axis=(1, 2)).all()
    assert not filled[:, 13:].any()


@pytest.mark.parametrize("frames", [[0, 2, 9], [12], list(range(11))])
def test_chosen_frames_are_packed_without_the_others(frames, device):
    points = random_points(13)
    source = wp.array(points, dtype=wp.vec3, device=device)
    found = pack_frames(source, device, frames=np.array(frames))
    assert found.shape[1] == -(-len(frames) // block_width(len(frames), device))
    np.testing.assert_array_equal(unpacked(found, len(frames)), points[frames])


def test_packing_moves_and_scales(device):
    points = random_points(3)
    moved = unpacked(pack_frames(points, device, centre=(1, 2, 3), scale=0.5), 3)
    np.testing.assert_allclose(moved, (points - [1, 2, 3]) * 0.5, rtol=1e-6)


def test_single_frame_has_blocks_of_one(device):
    assert block_width(1, device) == 1


@pytest.mark.parametrize("frame_count", [1, 11])
def test_lane_arithmetic_is_that_of_each_frame(frame_count, device):
    a, b = random_points(frame_count, seed=1), random_points(frame_count, seed=2)
    a[0, 0] = 0
    x, y = packed(a, device), packed(b, device)
    cross, unit = wp.empty_like(x), wp.empty_like(x)
    dot_sum = wp.empty(x.size, dtype=wp.float32, device=device)
    wp.launch(combine_points, dim=x.shape, inputs=[x, y], outputs=[cross, unit, dot_sum], device=device)
    length = np.linalg.norm(a, axis=2, keepdims=True)
    np.testing.assert_allclose(blocks(cross, frame_count), np.cross(a, b).transpose(1, 0, 2), rtol=1e-4, atol=1e-6)
    expected = np.where(length > 0, a / np.where(length > 0, length, 1), 0).transpose(1, 0, 2)
    np.testing.assert_allclose(blocks(unit, frame_count), expected, rtol=1e-5, atol=1e-7)
    total = dot_sum.numpy().reshape(x.shape).sum(axis=1)
    np.testing.assert_allclose(total, (a * b).sum(axis=(0, 2)), rtol=1e-4, atol=1e-5)
