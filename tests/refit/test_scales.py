"""Mean sizes of faces, on the host and on the device."""

from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from tests.support import meshes
from warpqem.refit import scales
from warpqem.refit.scales import SEAM_SHARE, FitSizes, Scales, frame_scale, seam_share


def sizes_of(given, faces, own_memory, device, monkeypatch) -> tuple[np.ndarray, int]:
    """What the fit of a mesh weighs, (SIZES,), and whether it has an area, by kernels or on the host."""
    traits = scales.device_traits(device)
    with monkeypatch.context() as patch:
        patch.setattr(scales, "device_traits", lambda _: replace(traits, own_memory=own_memory))
        corner_vertex = wp.array(faces.ravel(), dtype=wp.int32, device=device)
        found = FitSizes.of(given, faces, corner_vertex, vertex_count=given.shape[1], turns=3, seam_edges=5)
    return found.values.numpy(), int(found.has_area.numpy()[0])


@pytest.mark.parametrize("frame_count", [1, 5, 40])
def test_sizes_of_faces_are_the_same_where_the_device_sums_them_wherever_frames_are(frame_count, device, monkeypatch):
    points, faces = meshes.swaying_sphere(2, frame_count)
    there, found = wp.array(points, dtype=wp.vec3, device=device), {}
    for own_memory in (False, True):
        found[own_memory], again = (
            sizes_of(given, faces, own_memory, device, monkeypatch) for given in (points, there)
        )
        np.testing.assert_array_equal(found[own_memory][0], again[0])
        assert found[own_memory][1] == again[1] == 1
    np.testing.assert_allclose(found[True][0], found[False][0], rtol=1e-5)


def test_faces_without_area_weigh_nothing(device, monkeypatch):
    points, faces = meshes.swaying_sphere(2, 3)
    points[..., 1:] = 0.0
    values, has_area = sizes_of(points, faces, True, device, monkeypatch)
    assert has_area == 0
    assert values[0] == 1.0
    assert not values[1:].any()
    assert sizes_of(points, faces, False, device, monkeypatch)[1] == 0


def test_an_equilateral_triangle_has_its_area_and_edge():
    points = np.array([[[0, 0, 0], [2, 0, 0], [1, 3**0.5, 0]]], dtype=np.float32)
    scales_of_it = Scales.of(points, np.array([[0, 1, 2]]))
    np.testing.assert_allclose([scales_of_it.area, scales_of_it.edge_squared], [3**0.5, 4.0], rtol=1e-6)


def test_a_frame_half_as_large_counts_twice_and_one_that_collapses_no_more_than_ten_times():
    points = np.random.default_rng(0).normal(size=(7, 3)).astype(np.float32)
    frames = np.stack([points, 0.5 * points, 0.0 * points])
    np.testing.assert_allclose(frame_scale(frames), [1.0, 2.0, 10.0], rtol=1e-6)
    np.testing.assert_array_equal(frame_scale(0.0 * frames), np.ones(3))


def test_seams_of_many_small_islands_count_less_each():
    few, many = seam_share(10, 1000), seam_share(700, 1000)
    assert few == SEAM_SHARE
    assert many == pytest.approx(few / 2)
