"""Binding of test vertices to the reference: the right sheet, whatever is nearest in the first frame."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pxr import Usd

import warpqem
from tests.support import meshes
from warpqem.errors import MeshShapeError
from warpqem.measure import compare
from warpqem.measure.binding import bind, bind_by_shape, check_vertex_map
from warpqem.measure.checked_meshes import check_sequence, frame_scale
from warpqem.measure.sampling import place
from warpqem.usd.read.open_stage import find_meshes
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.skeleton_poses import StagePoses

SCENES = Path(__file__).parents[2] / "scenes"


def sequence(points, faces, name="test"):
    return check_sequence(points, faces, name)


def bound_by_shape(reference, test, device):
    return bind_by_shape(reference, test, *frame_scale(reference), device)


def joined(first, second):
    """Two moving meshes as one."""
    (points, faces), (more, more_faces) = first, second
    return np.concatenate([points, more], axis=-2), np.concatenate([faces, more_faces + points.shape[-2]])


def still(points, frames=4):
    return np.repeat(np.asarray(points, dtype=np.float64)[None], frames, axis=0)


def closest_on_triangles(query, corners):
    """Distances (M,) and barycentric coordinates (M, 3) of triangles (M, 3, 3): the textbook way, edge by edge."""
    best, where = np.full(len(corners), np.inf), np.zeros((len(corners), 3))
    a, b, c = corners.transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    twice = (normal**2).sum(axis=1)
    v = (np.cross(query - a, c - a) * normal).sum(axis=1) / twice
    w = (np.cross(b - a, query - a) * normal).sum(axis=1) / twice
    inside = np.stack([1 - v - w, v, w], axis=1)
    options = [(inside, (inside >= 0).all(axis=1))]
    for k in range(3):
        start, way = corners[:, k], corners[:, (k + 1) % 3] - corners[:, k]
        t = (((query - start) * way).sum(axis=1) / (way**2).sum(axis=1)).clip(0, 1)
        weight = np.zeros((len(corners), 3))
        weight[:, k], weight[:, (k + 1) % 3] = 1 - t, t
        options.append((weight, np.ones(len(corners), dtype=bool)))
    for weight, valid in options:
        distance = np.linalg.norm(np.einsum("mk,mkd->md", weight, corners) - query, axis=1)
        nearer = valid & (distance < best)
        best, where = np.where(nearer, distance, best), np.where(nearer[:, None], weight, where)
    return best, where


def legs(around, along, gap):
    """Two tubes beside each other that touch but for ``gap`` in the first frame and then swing apart: (F, V, 3)."""
    points, faces = meshes.tube(around, along)
    frames = []
    for angle in (0.0, 0.3, 0.6, 0.3, 0.0):
        turn = np.array([[np.cos(angle), np.sin(angle), 0], [-np.sin(angle), np.cos(angle), 0], [0, 0, 1.0]])
        left = points @ turn + [0, 0.15 + gap / 2, 0]
        right = points @ turn.T - [0, 0.15 + gap / 2, 0]
        frames.append(np.concatenate([left, right]))
    return np.stack(frames), np.concatenate([faces, faces + len(points)])


def towards_the_other(points, faces, by):
    """Legs whose vertices are moved towards the other leg, in all frames as far."""
    half = points.shape[1] // 2
    moved = points.copy()
    moved[:, :half, 1] -= by
    moved[:, half:, 1] += by
    return moved, faces


def test_vertices_stay_on_their_leg_where_the_other_one_is_nearer_in_the_first_frame(device):
    reference = sequence(*legs(48, 40, gap=0.01), "reference")
    test = sequence(*towards_the_other(*legs(12, 8, gap=0.01), by=0.008))
    binding = bound_by_shape(reference, test, device)
    own = np.arange(len(test.used)) < len(test.used) // 2
    np.testing.assert_array_equal(binding.face < len(reference.faces) // 2, own)
    distance = [closest_on_triangles(q, reference.points[0][reference.faces])[0].argmin() for q in test.points[0]]
    nearest_is_own = (np.array(distance) < len(reference.faces) // 2) == own
    assert (~nearest_is_own).sum() > 4


def test_slide_of_legs_that_part_is_that_of_their_own_motion(device):
    reference = legs(48, 40, gap=0.01)
    test = towards_the_other(*legs(12, 8, gap=0.01), by=0.008)
    # Each leg is rigid, and only what turns with it slides: the part of 0.008 that its turn changes.
    assert compare(*reference, *test, samples=100, device=device).slide < 0.25


def sheets(columns, gap, facing=1):
    """Two parallel sheets, the upper one at ``gap``; facing -1: the lower one faces down, as the skin of a plate."""
    points, faces = meshes.grid(columns, columns)
    lower = faces if facing > 0 else faces[:, ::-1]
    return joined((points.astype(np.float64), lower), (points + np.array([0, 0, gap]), faces))


def test_vertices_follow_their_neighbours_where_a_parallel_sheet_is_nearer(device):
    reference = sequence(still(sheets(24, 0.02)[0]), sheets(24, 0.02)[1], "reference")
    points, faces = sheets(6, 0.02)
    moved = still(points)
    inner = np.arange(len(points) // 2)[[8, 9, 17, 24, 31]]
    moved[:, inner, 2] += 0.013
    binding = bound_by_shape(reference, sequence(moved, faces), device)
    lower = np.arange(len(points)) < len(points) // 2
    np.testing.assert_array_equal(binding.face < len(reference.faces) // 2, lower)


@pytest.mark.parametrize("turned", [False, True], ids=["as it is", "inside out"])
def test_vertices_stay_on_their_side_of_a_plate_that_is_thinner_than_the_error(device, turned):
    reference = sequence(still(sheets(24, 0.01, -1)[0]), sheets(24, 0.01, -1)[1], "reference")
    points, faces = sheets(6, 0.01, -1)
    moved = still(points)
    half = len(points) // 2
    moved[:, :half, 2] += 0.008
    binding = bound_by_shape(reference, sequence(moved, faces[:, ::-1] if turned else faces), device)
    # The upper side lies on the reference; the lower one is nearer to it, and faces away from it.
    expected = np.arange(len(points)) < half
    np.testing.assert_array_equal(binding.face < len(reference.faces) // 2, expected)


def test_faces_of_their_own_vertices_are_bound_as_the_welded_ones(device):
    reference = sequence(still(sheets(24, 0.02)[0]), sheets(24, 0.02)[1], "reference")
    points, faces = sheets(6, 0.02)
    moved = still(points)
    moved[:, [8, 9, 17], 2] += 0.013
    welded = bound_by_shape(reference, sequence(moved, faces), device)
    loose = sequence(moved[:, faces.ravel()], np.arange(faces.size).reshape(-1, 3))
    apart = bound_by_shape(reference, loose, device)
    there = place(reference.points[0], reference.faces, apart.face, apart.barycentric)
    here = place(reference.points[0], reference.faces, welded.face, welded.barycentric)
    np.testing.assert_allclose(there, here[faces.ravel()], atol=1e-12)


def test_on_one_sheet_the_nearest_point_of_the_first_frame_counts(device):
    points, faces = meshes.icosphere(3)
    rng = np.random.default_rng(3)
    reference = sequence(np.stack([points, points * [1, 1.3, 0.8]]), faces, "reference")
    coarse, coarse_faces = meshes.icosphere(1)
    coarse = coarse + rng.normal(0, 0.01, coarse.shape)
    test = sequence(np.stack([coarse, coarse * [1, 1.3, 0.8]]), coarse_faces)
    binding = bound_by_shape(reference, test, device)
    found = place(reference.points[0], reference.faces, binding.face, binding.barycentric)
    corners = reference.points[0][reference.faces]
    expected = [closest_on_triangles(q, corners)[0].min() for q in test.points[0]]
    np.testing.assert_allclose(np.linalg.norm(found - test.points[0], axis=1), expected, rtol=1e-9, atol=1e-12)


def test_the_record_binds_to_the_nearest_point_of_the_faces_a_vertex_stands_for(device):
    points, faces = meshes.swaying_sphere(3, 4)
    result = warpqem.simplify(points, faces, ratio=0.2, device=device)
    reference, test = sequence(points, faces, "reference"), sequence(result.points, result.faces)
    binding = bind(reference, test, *frame_scale(reference), device, result.vertex_map)
    found = place(reference.points[0], reference.faces, binding.face, binding.barycentric)
    for vertex in range(0, len(test.used), 7):
        own = reference.faces[(result.vertex_map[reference.faces] == vertex).any(axis=1)]
        expected = closest_on_triangles(test.points[0][vertex], reference.points[0][own])[0].min()
        assert np.linalg.norm(found[vertex] - test.points[0][vertex]) == pytest.approx(expected, rel=1e-5, abs=1e-7)


def test_the_record_of_a_thin_part_binds_to_the_side_that_faces_as_the_vertex_does(device):
    points, faces = sheets(12, 0.01, -1)
    coarse, coarse_faces = sheets(3, 0.01, -1)
    moved = still(coarse)
    half = len(coarse) // 2
    moved[:, :half, 2] += 0.008
    reference, test = sequence(still(points), faces, "reference"), sequence(moved, coarse_faces)
    # Each vertex stands for both sides.
    near = np.linalg.norm(points[:, None, :2] - coarse[None, :half, :2], axis=2).argmin(axis=1)
    both_sides = near + half * (np.arange(len(points)) % 2)
    assert len(np.unique(both_sides)) == len(coarse)
    binding = bind(reference, test, *frame_scale(reference), device, both_sides)
    np.testing.assert_array_equal(binding.face < len(reference.faces) // 2, np.arange(len(coarse)) < half)


@pytest.fixture(scope="module")
def quadruped():
    stage = Usd.Stage.Open(str(SCENES / "quadruped_gallop.usdc"))
    [prim] = find_meshes(stage).prims
    source = MeshSource(prim, StagePoses(stage))
    mesh = source.read(source.authored_times)
    # Half of the gallop, which is the same on the other side.
    return mesh.points[:24], mesh.right_handed_faces


def test_slide_of_the_quadruped_falls_with_coherence_and_is_that_of_the_record(quadruped):
    slides = []
    for coherence in (0.0, 0.3, 1.0):
        result = warpqem.simplify(*quadruped, ratio=0.1, coherence=coherence, device="cpu")
        two = (*quadruped, result.points, result.faces)
        options = {"samples": 100, "frames": 1, "device": "cpu"}
        by_record = compare(*two, vertex_map=result.vertex_map, **options)
        by_shape = compare(*two, **options)
        assert by_shape.slide == pytest.approx(by_record.slide, rel=0.03)
        assert by_shape.slide_p95 == pytest.approx(by_record.slide_p95, rel=0.03)
        slides.append(by_shape.slide)
    assert slides == sorted(slides, reverse=True)
    assert slides[-1] < 0.25 * slides[0]


def test_percentile_leaves_out_the_few_vertices_that_slide(device):
    points, faces = meshes.grid(10, 10)
    test = still(points, 5)
    test[1::2, :3, 0] += 0.03
    found = compare(still(points, 5), faces, test, faces, samples=100, device=device)
    assert found.slide > 0.5
    assert found.slide_p95 < 1e-9
    test[1::2, :, 0] = points[:, 0] + 0.03
    every = compare(still(points, 5), faces, test, faces, samples=100, device=device)
    assert every.slide_p95 == pytest.approx(every.slide, rel=1e-6)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10**6), scale=st.sampled_from([1e-3, 1.0, 1e4]))
def test_a_mesh_is_bound_to_itself_whatever_the_order_of_its_faces(seed, scale):
    rng = np.random.default_rng(seed)
    points, faces = meshes.torus(14, 8)
    moving = scale * np.stack([points + rng.normal(0, 0.01, points.shape) for _ in range(3)])
    order = rng.permutation(len(points))
    back = np.argsort(order)
    test = sequence(moving[:, order], back[faces][rng.permutation(len(faces))])
    reference = sequence(moving, faces, "reference")
    binding = bound_by_shape(reference, test, "cpu")
    found = place(reference.points[0], reference.faces, binding.face, binding.barycentric)
    np.testing.assert_allclose(found, test.points[0], rtol=0, atol=1e-9 * scale)


def test_vertex_map_that_does_not_fit_is_refused():
    points, faces = meshes.icosphere(2)
    mesh = sequence(points, faces)
    fitting = np.arange(len(points))
    np.testing.assert_array_equal(check_vertex_map(fitting, mesh, mesh), fitting)
    with pytest.raises(MeshShapeError, match="161 entries for the reference's 162"):
        check_vertex_map(fitting[1:], mesh, mesh)
    with pytest.raises(MeshShapeError, match="entry 3 is 500"):
        check_vertex_map(np.where(fitting == 3, 500, fitting), mesh, mesh)
    with pytest.raises(MeshShapeError, match="leads to vertex 7 "):
        check_vertex_map(np.where(fitting == 7, 6, fitting), mesh, mesh)
