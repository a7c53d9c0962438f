"""Tangents at corners, against those summed face by face."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tests.oracles import normal_maps as oracle
from warpqem.mesh.directions import unit_vectors
from warpqem.normal_maps.tangents import corner_tangents


def patch(seed: int, mirrored: bool = False):
    """Corners, normals and texture coordinates of a bumpy patch of 18 triangles, half of it mirrored if asked for."""
    random = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(4.0), np.arange(4.0))
    points = np.stack([x.ravel(), y.ravel(), random.normal(0, 0.3, 16)], axis=1)
    first = (np.arange(3)[:, None] * 4 + np.arange(3)).ravel()
    faces = np.concatenate([first[:, None] + [0, 1, 5], first[:, None] + [0, 5, 4]])
    normals = unit_vectors(np.concatenate([random.normal(0, 0.2, (16, 2)), np.ones((16, 1))], axis=1))
    uvs = points[:, :2] / 3 + random.normal(0, 0.02, (16, 2))
    if mirrored:
        uvs[:, 0] = np.abs(uvs[:, 0] - 1 / 3)
    return points[faces], normals[faces], uvs[faces]


@given(st.integers(0, 10_000), st.booleans())
def test_tangents_are_the_means_of_those_of_the_faces(seed, mirrored):
    corners, normals, uvs = patch(seed, mirrored)
    found = corner_tangents(corners, normals, uvs)
    assert np.allclose(found, oracle.tangents(corners, normals, uvs), atol=1e-6)


@given(st.integers(0, 10_000))
def test_tangents_are_upright_on_normals_and_of_length_one(seed):
    corners, normals, uvs = patch(seed)
    tangent = corner_tangents(corners, normals, uvs)[..., :3]
    assert np.allclose((tangent * normals).sum(axis=2), 0, atol=1e-9)
    assert np.allclose(np.linalg.norm(tangent, axis=2), 1)


def test_mirrored_faces_have_the_other_side_and_share_no_tangent_with_others():
    corners, normals, uvs = patch(3, mirrored=True)
    found = corner_tangents(corners, normals, uvs)
    edge, other = uvs[:, 1] - uvs[:, 0], uvs[:, 2] - uvs[:, 0]
    area = edge[:, 0] * other[:, 1] - edge[:, 1] * other[:, 0]
    assert {-1.0, 1.0} == set(found[..., 3].ravel())
    assert np.array_equal(found[:, 0, 3] < 0, area < 0)
    # On a sheet that faces the viewer, the first coordinate grows to the left where it is mirrored.
    assert (found[area < 0][..., 0] < 0).all()
    assert (found[area > 0][..., 0] > 0).all()


def test_faces_without_area_in_the_texture_have_some_tangent():
    corners, normals, uvs = patch(4)
    tangent = corner_tangents(corners, normals, np.zeros_like(uvs))[..., :3]
    assert np.allclose(np.linalg.norm(tangent, axis=2), 1)
    assert np.allclose((tangent * normals).sum(axis=2), 0, atol=1e-9)
