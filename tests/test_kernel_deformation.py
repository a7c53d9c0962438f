"""Edge-length deformation of each edge over frames."""

import meshes
import numpy as np
import pytest
import warp as wp
from mesh_state import build_mesh
from oracles import motion as oracle

from warpqem.kernels.deformation import measure_length_deformation


def deformation(points, faces, device) -> np.ndarray:
    state = build_mesh(points, faces, device, with_trajectory=True).state
    out = wp.zeros(faces.size, dtype=wp.float32, device=device)
    inputs = [state.corner_vertex, state.stars, state.trajectory]
    wp.launch(measure_length_deformation, dim=faces.size, inputs=inputs, outputs=[out], device=device)
    return out.numpy()


@pytest.mark.parametrize("mesh", [meshes.waving_grid(4, 6), meshes.swaying_sphere(1, 5)], ids=["open", "closed"])
def test_deformation_matches_the_oracle(mesh, device):
    points, faces = mesh
    ends = zip(faces.ravel(), np.roll(faces, -1, axis=1).ravel(), strict=True)
    expected = [oracle.length_deformation(points, faces, int(u), int(v)) for u, v in ends]
    np.testing.assert_allclose(deformation(points, faces, device), expected, rtol=1e-3, atol=1e-9)


def test_deformation_of_a_still_mesh_is_zero(device):
    points, faces = meshes.icosphere(1)
    np.testing.assert_array_equal(deformation(np.stack([points] * 4), faces, device), 0)


def test_deformation_of_a_rigid_motion_is_rounding(device):
    points, faces = meshes.icosphere(1)
    # The square of float32 rounding of lengths of about one, times the area of a few faces.
    assert deformation(meshes.rigid_motion(points, 5), faces, device).max() < 1e-12


def test_deformation_of_one_frame_is_zero(device):
    points, faces = meshes.icosphere(1)
    np.testing.assert_array_equal(deformation(points[None], faces, device), 0)


def test_even_stretching_has_weight_one(device):
    points, faces = meshes.triangle()
    frames = np.stack([points, points * 2, points * 3])
    # Equal steps: deviation 0, so xi = area sum x step^2, with areas 1/2 (1 + 4 + 9) and step 1 along the first edge.
    assert deformation(frames, faces, device)[0] == pytest.approx(7.0, rel=1e-5)


@pytest.mark.parametrize("step", [0.03, 0.07, 0.1])
def test_even_stretching_by_a_rounded_step_has_weight_one(step, device):
    points, faces = meshes.triangle()
    scale = 1 + step * np.arange(12)
    frames = (points * 0.3 * scale[:, None, None]).astype(np.float32)
    area = 0.5 * 0.3**2 * (scale**2).sum()
    assert deformation(frames, faces, device)[0] == pytest.approx(area * (0.3 * step) ** 2, rel=0.01)
