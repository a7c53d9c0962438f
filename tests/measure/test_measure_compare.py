"""Comparison of mesh sequences: known errors give known figures."""

import json
from dataclasses import fields

import numpy as np
import pytest
import trimesh

from warpqem.errors import (
    DegenerateMeshError,
    DeviceError,
    FaceIndexError,
    MeshShapeError,
    NonFinitePointError,
    OptionError,
)
from warpqem.measure import FrameErrors, compare
from warpqem.measure.checked_meshes import check_sequence, chosen_frames
from warpqem.measure.sampling import draw_material_samples, normals_and_areas

DIAGONAL = np.sqrt(2)  # of the unit square


def square(n=6):
    x, y = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n), indexing="ij")
    i = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate([np.stack([i, i + n, i + n + 1], 1), np.stack([i, i + n + 1, i + 1], 1)])
    return np.stack([x.ravel(), y.ravel(), np.zeros(n * n)], 1), faces


def sphere(subdivisions=2):
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    return np.array(mesh.vertices), np.array(mesh.faces)


def rotation(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]) @ np.array([[1.0, 0, 0], [0, c, -s], [0, s, c]])


def still(points, frames):
    return np.repeat(points[None], frames, axis=0)


def test_identical_meshes_have_no_error(device):
    points, faces = sphere()
    moving = np.stack([points * [1, 1 + 0.2 * t, 1 - 0.1 * t] for t in range(4)])
    result = compare(moving, faces, moving, faces, samples=2000, device=device)
    assert result.hausdorff < 1e-12
    assert result.jitter < 1e-12
    assert result.slide < 1e-12
    assert result.edge_length_error < 1e-12
    assert result.normal_deviation < 1e-5  # arccos next to 1
    assert result.flips == 0


def test_square_shifted_along_its_normal_is_off_by_the_shift_everywhere(device):
    points, faces = square()
    result = compare(points, faces, points + np.array([0, 0, 0.01]), faces, samples=500, device=device)
    expected = pytest.approx(100 * 0.01 / DIAGONAL, rel=1e-10)
    assert result.mean == expected
    assert result.rms == expected
    assert result.hausdorff == expected
    assert result.normal_deviation < 1e-5


def test_percentages_refer_to_the_diagonal_of_their_own_frame(device):
    points, faces = square()
    reference = np.stack([points, 3 * points])
    result = compare(reference, faces, reference + np.array([0, 0, 0.01]), faces, samples=500, device=device)
    np.testing.assert_allclose(result.per_frame.rms, [1 / DIAGONAL, 1 / DIAGONAL / 3], rtol=1e-10)


def test_missing_half_counts_in_the_forward_direction_only(device):
    points, faces = square(n=7)
    half = faces[(points[faces][:, :, 0] <= 0.5 + 1e-9).all(axis=1)]
    frame = compare(points, faces, points, half, samples=40000, device=device).per_frame
    assert frame.rms_forward[0] == pytest.approx(100 * np.sqrt(1 / 24) / DIAGONAL, rel=0.02)
    assert frame.rms_backward[0] < 1e-12
    assert frame.rms[0] == frame.rms_forward[0]
    assert frame.mean[0] == pytest.approx(100 * (1 / 8) / 2 / DIAGONAL, rel=0.02)
    assert frame.hausdorff[0] == pytest.approx(100 * 0.5 / DIAGONAL, rel=1e-10)


def test_hausdorff_reaches_a_vertex_that_no_sample_hits(device):
    points, faces = square()
    spike = points.copy()
    spike[0, 2] = 0.2
    result = compare(points, faces, spike, faces, samples=1, device=device)
    assert result.hausdorff == pytest.approx(100 * 0.2 / DIAGONAL, rel=1e-10)


def test_normal_deviation_is_the_tilt_in_degrees(device):
    points, faces = square()
    tilted = (points - 0.5) @ rotation(np.radians(10)).T + 0.5
    normal = rotation(np.radians(10))[:, 2]
    expected = np.degrees(np.arccos(normal[2]))
    assert compare(points, faces, tilted, faces, samples=500, device=device).normal_deviation == pytest.approx(expected)


def test_flipped_face_is_counted(device):
    points, faces = sphere()
    flipped = faces.copy()
    flipped[[5, 11]] = flipped[[5, 11], ::-1]
    result = compare(still(points, 2), faces, still(points, 2), flipped, samples=200, device=device)
    assert result.per_frame.flips.tolist() == [2, 2]


def test_opposed_face_without_area_counts_as_degenerate_and_not_as_flipped(device):
    points, faces = square()
    tiny = np.array([[0.31, 0.35, 0], [0.31, 0.35 + 1e-8, 0], [0.31 + 1e-8, 0.35, 0]])  # clockwise, area 5e-17
    test_points = np.concatenate([points, tiny])
    test_faces = np.concatenate([faces, [np.arange(3) + len(points)]])
    result = compare(points, faces, test_points, test_faces, samples=200, device=device)
    assert result.per_frame.degenerate_faces.tolist() == [1]
    assert result.per_frame.flips.tolist() == [0]


def test_rigid_motion_of_both_meshes_costs_no_jitter_and_no_slide(device):
    (fine, fine_faces), (coarse, coarse_faces) = sphere(3), sphere(1)
    turns = [rotation(0.4 * t**2) for t in range(5)]
    fine, coarse = (np.stack([p @ m.T + [t**2, 0, 0] for t, m in enumerate(turns)]) for p in (fine, coarse))
    result = compare(fine, fine_faces, coarse, coarse_faces, samples=2000, device=device)
    assert result.rms > 1
    assert result.jitter < 1e-4
    assert result.slide < 1e-10


def test_jitter_is_the_second_difference_of_the_offset(device):
    points, faces = square()
    test = np.stack([points + np.array([0, 0, h]) for h in (0, 0, 0.01, 0.02)])  # second differences: 0.01, 0
    result = compare(still(points, 4), faces, test, faces, samples=500, device=device)
    assert result.jitter == pytest.approx(100 * 0.01 / np.sqrt(2) / DIAGONAL, rel=1e-9)


def test_slide_is_the_second_difference_along_the_surface(device):
    points, faces = square()
    test = np.stack([points + np.array([d, 0, 0]) for d in (0, 0, 0.01)])
    result = compare(still(points, 3), faces, test, faces, samples=500, device=device)
    assert result.slide == pytest.approx(100 * 0.01 / DIAGONAL, rel=1e-9)


def test_edge_length_error_is_the_relative_stretch(device):
    points, faces = square()
    result = compare(still(points, 2), faces, np.stack([points, 1.1 * points]), faces, samples=500, device=device)
    assert result.edge_length_error == pytest.approx(10 / np.sqrt(2), rel=1e-9)


def test_jitter_looks_at_the_middle_window_only(device):
    points, faces = square(3)
    test = still(points, 30)
    test[0] += [0, 0, 0.1]
    test[-1] += [0, 0, 0.1]
    assert compare(still(points, 30), faces, test, faces, samples=50, device=device).jitter < 1e-12


def test_two_frames_have_no_jitter_and_no_slide(device):
    points, faces = square()
    result = compare(still(points, 2), faces, still(points, 2), faces, samples=50, device=device)
    assert result.jitter is None
    assert result.slide is None


def test_figures_do_not_depend_on_place_and_size(device):
    (fine, fine_faces), (coarse, coarse_faces) = sphere(3), sphere(1)
    near = compare(fine, fine_faces, coarse, coarse_faces, samples=1000, device=device)
    far = compare(
        1e-3 * fine + [500, -700, 300], fine_faces, 1e-3 * coarse + [500, -700, 300], coarse_faces, samples=1000,
        device=device,
    )  # fmt: skip
    assert far.rms == pytest.approx(near.rms, rel=1e-7)
    assert far.hausdorff == pytest.approx(near.hausdorff, rel=1e-7)


def test_reruns_are_equal_to_the_bit(device):
    (fine, fine_faces), (coarse, coarse_faces) = sphere(3), sphere(1)
    fine, coarse = (np.stack([p, p * [1, 1, 1.1], p * [1, 1.2, 1]]) for p in (fine, coarse))
    first, second = (compare(fine, fine_faces, coarse, coarse_faces, samples=3000, device=device) for _ in range(2))
    assert first.to_dict() == second.to_dict()


def test_seed_changes_the_samples(device):
    (fine, fine_faces), (coarse, coarse_faces) = sphere(3), sphere(1)
    first, second = (
        compare(fine, fine_faces, coarse, coarse_faces, samples=500, seed=s, device=device) for s in (0, 7)
    )
    assert first.rms != second.rms
    assert first.rms == pytest.approx(second.rms, rel=0.1)


def test_chosen_frames_have_the_errors_of_the_whole_sequence(device):
    points, faces = sphere(1)
    test = np.stack([points * (1 + 0.01 * t) for t in range(6)])
    whole = compare(still(points, 6), faces, test, faces, samples=300, device=device)
    some = compare(still(points, 6), faces, test, faces, samples=300, frames=[4, 1], device=device)
    assert some.per_frame.frame.tolist() == [1, 4]
    # Where samples lie depends on the frames that were measured before.
    for name in ("rms_forward", "rms_backward"):
        np.testing.assert_allclose(getattr(some.per_frame, name), getattr(whole.per_frame, name)[[1, 4]], rtol=0.01)
    assert some.jitter == whole.jitter


def test_frame_number_spreads_evenly():
    assert chosen_frames(3, 11).tolist() == [0, 5, 10]
    assert chosen_frames(20, 4).tolist() == [0, 1, 2, 3]


def test_sample_weights_follow_the_areas_of_the_frame():
    points, faces = square()
    stretched = points * [1, 1, 1]
    stretched[:, 0] = points[:, 0] ** 3
    mesh = check_sequence(np.stack([points, stretched]), faces, "test")
    samples = draw_material_samples(mesh, 40000, 0, "test")
    for frame in mesh.points:
        area = normals_and_areas(frame, faces)[1]
        weight = np.bincount(samples.face, samples.weights(area), len(faces))
        np.testing.assert_allclose(weight.reshape(2, 5, 5).sum((0, 2)), area.reshape(2, 5, 5).sum((0, 2)), atol=0.01)


def test_samples_are_uniform_within_a_face():
    mesh = check_sequence(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]), np.array([[0, 1, 2]]), "test")
    barycentric = draw_material_samples(mesh, 40000, 0, "test").barycentric
    np.testing.assert_allclose(barycentric.mean(axis=0), 1 / 3, atol=0.005)
    np.testing.assert_allclose(np.cov(barycentric.T).diagonal(), 1 / 18, rtol=0.02)


def test_dictionary_survives_json(device):
    points, faces = square()
    result = compare(points, faces, points, faces, samples=50, device=device).to_dict()
    assert json.loads(json.dumps(result, allow_nan=False)) == result
    assert set(result["per_frame"]) == {f.name for f in fields(FrameErrors)}


def test_progress_reports_every_frame(device):
    points, faces = square(3)
    seen = []
    compare(
        still(points, 3), faces, still(points, 3), faces, samples=50, device=device, progress=lambda *a: seen.append(a)
    )
    # Small meshes are measured many frames at once.
    assert seen == [(3, 3)]


def test_unequal_frame_counts_are_named():
    points, faces = square()
    with pytest.raises(MeshShapeError, match=r"4.*3"):
        compare(still(points, 4), faces, still(points, 3), faces)


def test_missing_point_is_named_with_vertex_and_frame():
    points, faces = square()
    broken = still(points, 3)
    broken[2, 5, 1] = np.nan
    with pytest.raises(NonFinitePointError, match=r"test points: vertex 5 in frame 2"):
        compare(still(points, 3), faces, broken, faces)


def test_face_with_unknown_vertex_is_named():
    points, faces = square()
    broken = faces.copy()
    broken[4, 1] = 99
    with pytest.raises(FaceIndexError, match=r"reference faces: face 4"):
        compare(points, broken, points, faces)


def test_negative_vertex_index_is_refused():
    points, faces = square()
    with pytest.raises(FaceIndexError, match="negative"):
        compare(points, faces - 1, points, faces)


@pytest.mark.parametrize("shape", [(4,), (4, 2), (0, 4, 3)])
def test_points_of_the_wrong_shape_are_refused(shape):
    points, faces = square()
    with pytest.raises(MeshShapeError, match="reference points"):
        compare(np.zeros(shape), faces, points, faces)


def test_quadrilateral_faces_are_refused():
    points, faces = square()
    with pytest.raises(MeshShapeError, match="test faces"):
        compare(points, faces, points, np.array([[0, 1, 2, 3]]))


def test_mesh_without_faces_is_refused():
    points, faces = square()
    with pytest.raises(DegenerateMeshError, match="no face"):
        compare(points, faces, points, faces[:0])


def test_frame_in_which_either_mesh_is_a_point_is_named():
    points, faces = square()
    meshes = still(points, 2), np.stack([points, 0 * points])
    for reference, test in (meshes, meshes[::-1]):
        assert compare(reference, faces, test, faces).collapsed_frames == (1,)


@pytest.mark.parametrize("option", [{"samples": 0}, {"seed": -1}, {"frames": 0}, {"frames": [3]}, {"frames": []}])
def test_options_out_of_range_are_refused(option):
    points, faces = square()
    with pytest.raises(OptionError, match=next(iter(option))):
        compare(points, faces, points, faces, **option)


def test_unknown_device_is_named_with_those_that_exist():
    points, faces = square()
    with pytest.raises(DeviceError, match=r"'cuda:99'.*cpu"):
        compare(points, faces, points, faces, device="cuda:99")
