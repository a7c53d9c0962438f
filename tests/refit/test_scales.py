"""Mean sizes of faces, on the host and on the device."""

from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from tests.support import meshes
from warpqem.refit import scales
from warpqem.refit.scales import Scales, frame_scale, read_scales


@pytest.mark.parametrize("frame_count", [1, 5, 40])
def test_sizes_of_faces_are_the_same_where_the_device_sums_them_wherever_frames_are(frame_count, device, monkeypatch):
    points, faces = meshes.swaying_sphere(2, frame_count)
    corner_vertex = wp.array(faces.ravel(), dtype=wp.int32, device=device)
    other = wp.array(np.arange(5), dtype=wp.int32, device=device)
    there, traits = wp.array(points, dtype=wp.vec3, device=device), scales.device_traits(device)
    found = {}
    for own_memory in (False, True):
        monkeypatch.setattr(scales, "device_traits", lambda _, own=own_memory: replace(traits, own_memory=own))
        found[own_memory], again = (read_scales(given, faces, corner_vertex, other) for given in (points, there))
        assert found[own_memory][0] == again[0]
        assert found[own_memory][1].tolist() == again[1].tolist() == list(range(5))
    (here, _), (summed, _) = found[False], found[True]
    np.testing.assert_allclose([summed.area, summed.edge_squared], [here.area, here.edge_squared], rtol=1e-5)


def test_an_equilateral_triangle_has_its_area_and_edge():
    points = np.array([[[0, 0, 0], [2, 0, 0], [1, 3**0.5, 0]]], dtype=np.float32)
    scales_of_it = Scales.of(points, np.array([[0, 1, 2]]))
    np.testing.assert_allclose([scales_of_it.area, scales_of_it.edge_squared], [3**0.5, 4.0], rtol=1e-6)


def test_a_frame_half_as_large_counts_twice_and_one_that_collapses_no_more_than_ten_times():
    points = np.random.default_rng(0).normal(size=(7, 3)).astype(np.float32)
    frames = np.stack([points, 0.5 * points, 0.0 * points])
    np.testing.assert_allclose(frame_scale(frames), [1.0, 2.0, 10.0], rtol=1e-6)
    np.testing.assert_array_equal(frame_scale(0.0 * frames), np.ones(3))
