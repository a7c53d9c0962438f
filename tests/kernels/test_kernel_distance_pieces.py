"""Pieces in many frames at once, against the closest points of trimesh."""

import numpy as np
import trimesh
import warp as wp

from warpqem.frames.blocks import block_width, pack_frames
from warpqem.kernels.distance_bound import Pieces
from warpqem.kernels.distance_pieces import check_pieces

FRAMES, COUNT = 11, 200


def random_pieces(rng):
    """Pieces of single triangles, each over a triangle of the other mesh, in some frames."""
    own, other = (rng.uniform(-0.5, 0.5, (FRAMES, 3 * COUNT, 3)).astype(np.float32) for _ in range(2))
    weight = rng.dirichlet([1.0, 1.0, 1.0], (COUNT, 3, 2))[..., 1:].reshape(COUNT, 3, 4).astype(np.float32)
    return own, other, weight


def corner_distances(own, other, weight):
    """Distances (F, COUNT, 3) of the corners of pieces from the triangles they are over."""
    a, b, c = (own[:, k::3, None].astype(np.float64) for k in range(3))
    corners = a + weight[..., :1] * (b - a) + weight[..., 1:2] * (c - a)
    triangles = np.repeat(other.reshape(FRAMES, COUNT, 1, 3, 3), 3, axis=2)
    closest = trimesh.triangles.closest_point(triangles.reshape(-1, 3, 3), corners.reshape(-1, 3))
    return np.linalg.norm(closest.reshape(corners.shape) - corners, axis=3)


def apart_bits(own, other, weight, limit, left, device):
    width = block_width(FRAMES, device)
    pieces = Pieces()
    pieces.parent, pieces.owner, pieces.face = (
        wp.array(np.arange(COUNT), dtype=wp.int32, device=device) for _ in range(3)
    )
    pieces.weight = wp.array(weight, dtype=wp.float32, device=device)
    corner = wp.array(np.arange(3 * COUNT), dtype=wp.int32, device=device)
    blocks = [pack_frames(np.ascontiguousarray(points), device, width=width) for points in (own, other)]
    every = (left.astype(np.int32).reshape(COUNT, -1, width) << np.arange(width)).sum(axis=2, dtype=np.int32)
    out = wp.empty((COUNT, every.shape[1]), dtype=wp.int32, device=device)
    wp.launch(
        check_pieces[width],
        dim=out.shape,
        inputs=[*blocks, corner, corner, pieces, limit**2, wp.array(every, dtype=wp.int32, device=device)],
        outputs=[out],
        device=device,
    )
    return ((out.numpy()[..., None] >> np.arange(width)) & 1).reshape(COUNT, -1)[:, :FRAMES].astype(bool)


def padded(left, device):
    width = block_width(FRAMES, device)
    whole = np.zeros((COUNT, -(-FRAMES // width) * width), dtype=bool)
    whole[:, :FRAMES] = left
    return whole


def test_a_piece_is_apart_where_a_corner_is_too_far_from_the_face(device):
    own, other, weight = random_pieces(np.random.default_rng(3))
    largest = corner_distances(own, other, weight).max(axis=2).T
    limit = float(np.median(largest))
    found = apart_bits(own, other, weight, limit, padded(np.ones((COUNT, FRAMES)), device), device)
    clear = np.abs(largest - limit) > 1e-5
    assert np.array_equal(found[clear], (largest > limit)[clear])


def test_frames_that_are_not_asked_for_are_left_out(device):
    rng = np.random.default_rng(4)
    own, other, weight = random_pieces(rng)
    asked = rng.random((COUNT, FRAMES)) < 0.5
    found = apart_bits(own, other, weight, 0.0, padded(asked, device), device)
    assert np.array_equal(found, asked)


def test_faces_without_area_count_as_the_edges_that_they_are(device):
    own, other, weight = random_pieces(np.random.default_rng(5))
    other[:, 2::3] = other[:, ::3]
    other[:, 1::3, 1] = other[:, ::3, 1]
    largest = corner_distances(own, other, weight).max(axis=2).T
    limit = float(np.median(largest))
    found = apart_bits(own, other, weight, limit, padded(np.ones((COUNT, FRAMES)), device), device)
    clear = np.abs(largest - limit) > 1e-5
    assert np.array_equal(found[clear], (largest > limit)[clear])
