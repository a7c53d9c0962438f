"""Mean sizes of faces, on the host and on the device."""

import numpy as np
import pytest
import warp as wp

from tests.support import meshes
from warpqem.refit.scales import Scales, read_scales


@pytest.mark.parametrize("frame_count", [1, 5, 40])
def test_sizes_of_faces_are_the_same_where_points_are_on_the_device(frame_count, device):
    points, faces = meshes.swaying_sphere(2, frame_count)
    corner_vertex = wp.array(faces.ravel(), dtype=wp.int32, device=device)
    other = wp.array(np.arange(5), dtype=wp.int32, device=device)
    there = wp.array(points, dtype=wp.vec3, device=device)
    (here, _), (found, brought) = (read_scales(given, faces, corner_vertex, other) for given in (points, there))
    assert brought.tolist() == list(range(5))
    np.testing.assert_allclose([found.area, found.edge_squared], [here.area, here.edge_squared], rtol=1e-5)


def test_an_equilateral_triangle_has_its_area_and_edge():
    points = np.array([[[0, 0, 0], [2, 0, 0], [1, 3**0.5, 0]]], dtype=np.float32)
    scales = Scales.of(points, np.array([[0, 1, 2]]))
    np.testing.assert_allclose([scales.area, scales.edge_squared], [3**0.5, 4.0], rtol=1e-6)
