"""How good the results of ``warpqem.simplify`` are."""

import numpy as np
import pytest
import trimesh

import warpqem
from tests.oracles.greedy import greedy_simplify
from tests.support import meshes
from tests.support.moving_meshes import BAR, kept_near, rms
from warpqem.measure import compare


def outline_area(result) -> float:
    p = result.points[0].astype(np.float64)
    cross = np.cross(p[result.faces[:, 1]] - p[result.faces[:, 0]], p[result.faces[:, 2]] - p[result.faces[:, 0]])
    return float(np.linalg.norm(cross, axis=1).sum() / 2)


@pytest.mark.parametrize(("coherence", "tolerance"), [(0.0, 1e-4), (0.5, 5e-3)])
def test_flat_grid_keeps_its_plane_area_and_corners(coherence, tolerance, device):
    points, faces = meshes.grid(16, 16)
    result = warpqem.simplify(points, faces, ratio=0.1, coherence=coherence, device=device)
    assert np.abs(result.points[..., 2]).max() < 1e-6
    assert outline_area(result) == pytest.approx(1, abs=tolerance)
    for corner in ([0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]):
        assert np.linalg.norm(result.points[0] - corner, axis=1).min() < tolerance


def test_flat_grid_has_no_error(device):
    mesh = meshes.grid(16, 16)
    result = warpqem.simplify(*mesh, ratio=0.1, coherence=0.0, device=device)
    assert rms(mesh, result, device) < 1e-3
    assert result.error < 1e-3


# Smaller than the others: the serial order is written in Python.
SMALL = {
    "sphere": meshes.swaying_sphere(2, 6),
    "bar": meshes.bending_bar(12, 20, 8),
    "cloth": meshes.waving_grid(12, 6),
}


@pytest.mark.parametrize("name", SMALL)
def test_quality_is_that_of_the_serial_greedy_order(name, device):
    points, faces = mesh = SMALL[name]
    target = len(faces) // 4
    result = warpqem.simplify(points, faces, target_faces=target, coherence=0.0, device=device)
    greedy_points, greedy_faces = greedy_simplify(points, faces, target)
    greedy = compare(points, faces, greedy_points, greedy_faces, samples=4000, device=device).rms
    assert rms(mesh, result, device) <= 1.1 * greedy


def test_all_frames_decide_better_than_the_first_alone(device):
    errors = {m: rms(BAR, warpqem.simplify(*BAR, ratio=0.15, metric=m, device=device), device) for m in ("dsd", "qem")}
    assert errors["dsd"] < errors["qem"]


def test_aqem_keeps_more_vertices_in_motion_features_than_dsd(device):
    points, faces = meshes.icosphere(3)
    points = meshes.bend(points * np.array([2, 0.4, 0.4], dtype=np.float32), frames=4)
    joint = np.flatnonzero(warpqem.motion_features(points, faces, device=device).label >= 0)
    assert 0 < len(joint) < points.shape[1] / 2
    kept = {
        m: kept_near(warpqem.simplify(points, faces, ratio=0.25, metric=m, device=device), joint)
        for m in ("aqem", "dsd")
    }
    assert kept["aqem"] > 1.2 * kept["dsd"]


def test_dod_keeps_more_vertices_where_edges_stretch(device):
    points, faces = meshes.tube(16, 48)
    frames = np.stack([points] * 8)
    # The last third of the tube stretches by up to its own length, the rest only moves; both are equally round.
    frames[:, :, 0] += np.linspace(0, 1, 8)[:, None] ** 2 * np.maximum(points[:, 0] - 2 / 3, 0)
    stretching = np.flatnonzero(points[:, 0] > 0.7)
    kept = {
        m: kept_near(warpqem.simplify(frames, faces, ratio=0.25, metric=m, device=device), stretching)
        for m in ("dod", "dsd")
    }
    assert kept["dod"] > kept["dsd"]


@pytest.mark.parametrize("quality", ["fast", "best"])
@pytest.mark.parametrize("size", [5, 6, 8, 10, 12])
def test_small_flat_sheets_keep_their_corners_to_the_last_face(size, quality, device):
    points, faces = meshes.grid(size, size)
    result = warpqem.simplify(points, faces, target_faces=2, quality=quality, device=device)
    assert len(result.faces) == 2
    assert result.measured.hausdorff < 0.02


@pytest.mark.parametrize("quality", ["fast", "best"])
@pytest.mark.parametrize("cuts", [1, 2, 3, 4])
def test_boxes_keep_their_corners_to_the_last_face(cuts, quality, device):
    box = trimesh.creation.box()
    for _ in range(cuts):
        box = box.subdivide()
    points, faces = np.asarray(box.vertices, dtype=np.float32), np.asarray(box.faces, dtype=np.int32)
    result = warpqem.simplify(points, faces, target_faces=12, quality=quality, device=device)
    assert len(result.faces) == 12
    assert result.measured.hausdorff < 0.02
