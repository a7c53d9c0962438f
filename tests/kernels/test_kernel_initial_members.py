"""What each vertex stands for at first, against NumPy."""

import numpy as np
import pytest
import warp as wp

from tests.support import meshes
from tests.support.mesh_state import packed
from warpqem.decimation.adjacency import build_adjacency
from warpqem.decimation.cluster_vertices import build_members

MESHES = {
    "closed": meshes.swaying_sphere(2, 3),
    "open": meshes.bending_bar(6, 4, 3),
    "pages": (meshes.book()[0][None], meshes.book()[1]),
    "poles": (meshes.fan(30)[0][None], meshes.fan(30)[1]),
}


def members_of(points, faces, device):
    corner_vertex = wp.array(faces.ravel(), dtype=wp.int32, device=device)
    adjacency = build_adjacency(corner_vertex, points.shape[1])
    return build_members(corner_vertex, adjacency, packed(points, device), len(points))


def expected_members(points, faces):
    """Area and squared reach, (2, V) each: in the first frame of points (F, V, 3), and the mean of all."""
    corner = points[:, faces].astype(np.float64)
    cross = np.cross(corner[:, :, 1] - corner[:, :, 0], corner[:, :, 2] - corner[:, :, 0])
    area = np.linalg.norm(cross, axis=2) / 6
    edge_squared = ((corner - np.roll(corner, -1, axis=2)) ** 2).sum(axis=3).max(axis=2) / 3
    shares, reaches = np.zeros((2, points.shape[1])), np.zeros((2, points.shape[1]))
    for row, frames in enumerate((slice(0, 1), slice(None))):
        np.add.at(shares[row], faces.ravel(), np.repeat(area[frames].mean(axis=0), 3))
        np.maximum.at(reaches[row], faces.ravel(), np.repeat(edge_squared[frames].mean(axis=0), 3))
    return shares, reaches


@pytest.mark.parametrize("name", MESHES)
def test_areas_and_reaches_match_numpy(name, device):
    points, faces = MESHES[name]
    members = members_of(points, faces, device)
    area, reach = expected_members(points, faces)
    np.testing.assert_allclose(members.area.numpy(), area, rtol=1e-6)
    np.testing.assert_allclose(members.reach_squared.numpy(), reach, rtol=1e-6)


def test_areas_of_all_vertices_are_that_of_the_mesh(device):
    points, faces = MESHES["open"]
    members = members_of(points, faces, device)
    corner = points[:, faces].astype(np.float64)
    cross = np.cross(corner[:, :, 1] - corner[:, :, 0], corner[:, :, 2] - corner[:, :, 0])
    area = np.linalg.norm(cross, axis=2).sum(axis=1).mean() / 2
    assert members.area.numpy()[1].sum(dtype=np.float64) == pytest.approx(area, rel=1e-6)


def test_each_vertex_stands_for_itself(device):
    points, faces = MESHES["closed"]
    members = members_of(points, faces, device)
    np.testing.assert_array_equal(members.last.numpy(), np.arange(points.shape[1]))
    np.testing.assert_array_equal(members.following.numpy(), -1)


def test_vertex_without_a_face_has_no_area(device):
    points = np.concatenate([meshes.octahedron()[0], np.ones((1, 3), dtype=np.float32)])
    members = members_of(points[None], meshes.octahedron()[1], device)
    assert not members.area.numpy()[:, -1].any()
    assert not members.reach_squared.numpy()[:, -1].any()
