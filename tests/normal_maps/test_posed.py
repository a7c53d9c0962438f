"""Normals taken from one pose into another."""

from __future__ import annotations

import numpy as np

from warpqem.mesh.directions import unit_vectors
from warpqem.normal_maps.posed import posed_normals


def patch() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points and faces of a bumpy patch, and normals at its points."""
    random = np.random.default_rng(1)
    x, y = np.meshgrid(np.arange(4.0), np.arange(4.0))
    points = np.stack([x.ravel(), y.ravel(), random.normal(0, 0.2, 16)], axis=1)
    first = (np.arange(3)[:, None] * 4 + np.arange(3)).ravel()
    faces = np.concatenate([first[:, None] + [0, 1, 5], first[:, None] + [0, 5, 4]])
    return points, faces, unit_vectors(random.normal(0, 0.3, (16, 3)) + np.array([0, 0, 1]))


def test_normals_stay_where_nothing_moves():
    points, faces, normals = patch()
    assert np.allclose(posed_normals(points[faces], normals[faces], points[faces]), normals[faces])


def test_normals_turn_with_a_mesh_that_turns():
    points, faces, normals = patch()
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    found = posed_normals(points[faces], normals[faces], (points @ turn.T * 3 + 5)[faces])
    assert np.allclose(found, normals[faces] @ turn.T)


def test_normals_of_a_sheared_plane_stay_upright_on_it():
    points, faces, _ = patch()
    points[:, 2] = 0
    up = np.broadcast_to([0.0, 0.0, 1.0], (*faces.shape, 3))
    sheared = points + points[:, :1] * [0.0, 0.7, 0.5]
    found = posed_normals(points[faces], up, sheared[faces])
    assert np.allclose(found, unit_vectors(np.array([-0.5, 0.0, 1.0])))


def test_corners_that_share_a_normal_still_do():
    points, faces, normals = patch()
    bent = points + np.stack([0 * points[:, 0], 0 * points[:, 0], 0.3 * points[:, 0] ** 2], axis=1)
    found = posed_normals(points[faces], normals[faces], bent[faces])
    for vertex in range(len(points)):
        at = found[faces == vertex]
        assert np.allclose(at, at[0])
