"""Values fitted to those of the input's surface: what is reproduced, what stays, and that it is a minimum."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support import meshes
from tests.support.attribute_fit import fitting
from warpqem.attribute_fit import solve
from warpqem.attribute_fit.input_samples import MAX_FACES, find_input_samples
from warpqem.attribute_fit.normal_groups import split_corners
from warpqem.attribute_fit.partners import FEW_FACES, SAMPLES, SAMPLES_OF_FEW, PartnerSearch
from warpqem.attribute_fit.values import (
    NormalErrors,
    fit_normals,
    fit_smooth_values,
    normal_errors,
    normal_misfits,
    own_normals,
    split_normals,
)
from warpqem.measure.appearance import compare_appearance
from warpqem.measure.closest_points import ClosestPointSearch
from warpqem.measure.surface_values import CornerValues, SurfaceValues
from warpqem.mesh.directions import unit_vectors
from warpqem.mesh.smooth_normals import vertex_normals
from warpqem.runtime import cpu_threads
from warpqem.runtime.device import device_traits

FINITE = st.floats(-100, 100, width=32)


def terrain(size=12):
    """A hilly grid."""
    points, faces = meshes.grid(size, size)
    points = points.astype(np.float32)
    points[:, 2] = 0.03 * np.sin(12 * points[:, 0]) * np.cos(15 * points[:, 1])
    return points, faces


@pytest.fixture(scope="module")
def bumps():
    return fitting(*meshes.bumpy_sphere(4), ratio=0.05)


@pytest.fixture(scope="module")
def hills():
    return fitting(*terrain())


def at_corners(fit, values):
    """(3N, C) from values at the input's vertices (V, C)."""
    return values[fit.faces].reshape(-1, values.shape[1]).astype(np.float64)


def fitted(fit, values):
    corners = at_corners(fit, values)
    return fit_smooth_values(fit.layout, corners, fit.start(corners.reshape(-1, 3, values.shape[1])))


@settings(max_examples=20, deadline=None)
@given(st.lists(FINITE, min_size=3, max_size=3))
def test_constant_values_are_reproduced_to_the_bit(hills, constant):
    values = np.tile(np.array(constant), (len(hills.points), 1))
    assert (fitted(hills, values) == np.array(constant)).all()


@settings(max_examples=20, deadline=None)
@given(st.lists(FINITE, min_size=8, max_size=8))
def test_linear_values_of_a_plane_are_reproduced(numbers):
    points, faces = meshes.grid(9, 9)
    fit = fitting(points, faces, ratio=0.3)
    slope, offset = np.array(numbers[:6]).reshape(3, 2), np.array(numbers[6:])
    values = points.astype(np.float64) @ slope + offset
    expected = np.zeros_like(fit.start(at_corners(fit, values).reshape(-1, 3, 2)))
    corner = fit.layout.corner_row
    expected[corner] = (fit.result.points[0].astype(np.float64) @ slope + offset)[fit.result.faces]
    used = np.unique(corner)
    np.testing.assert_allclose(fitted(fit, values)[used], expected[used], atol=1e-3)


def oracle(fit, corner_values, start):
    """The change by dense least squares over all samples that have a partner, those without one missing nothing."""
    partners, row = fit.layout.partners, fit.layout.corner_row
    face, weight = partners.face.numpy(), partners.weight.numpy()
    rows, wanted = [], []
    for f in range(len(row)):
        for s, barycentric in enumerate(partners.samples.astype(np.float32).astype(np.float64)):
            line = np.zeros(len(start))
            np.add.at(line, row[f], barycentric)
            misfit = np.zeros(start.shape[1])
            if face[f, s] >= 0:
                misfit = weight[f, s].astype(np.float64) @ corner_values[face[f, s]] - line @ start
            rows.append(np.sqrt(partners.area[f]) * line)
            wanted.append(np.sqrt(partners.area[f]) * misfit)
    change, *_ = np.linalg.lstsq(np.array(rows), np.array(wanted), rcond=None)
    return start + change


def test_values_are_the_least_squares_over_the_samples(hills):
    rng = np.random.default_rng(1)
    values = rng.normal(size=(len(hills.points), 2))
    corners = at_corners(hills, values)
    start = hills.start(corners.reshape(-1, 3, 2))
    misfit = solve.misfits(hills.layout.partners, hills.layout.corner_element, corners, hills.layout.corner_row, start)
    free = np.ones(len(start), dtype=bool)
    found = start + solve.fit_values(hills.layout.partners, misfit, hills.layout.corner_row, free)
    np.testing.assert_allclose(found, oracle(hills, corners.reshape(-1, 3, 2), start), atol=1e-5)


def test_channels_are_solved_to_the_bits_of_a_thread_for_each_unknown(hills, monkeypatch):
    rng = np.random.default_rng(3)
    row = hills.layout.corner_row
    misfit = rng.normal(size=(*row.shape, 2))
    free = rng.random(int(row.max()) + 1) < 0.8
    found = []
    for in_order in (False, True):
        traits = replace(device_traits("cpu"), in_order=in_order)
        monkeypatch.setattr(solve, "device_traits", lambda _, traits=traits: traits)
        found.append(solve.fit_values(hills.layout.partners, misfit, row, free))
    np.testing.assert_array_equal(*found)
    assert (found[0][~free] == 0).all()


@pytest.mark.parametrize("samples", [SAMPLES, SAMPLES_OF_FEW])
def test_own_fit_of_a_face_is_that_of_its_samples_alone(samples):
    rng = np.random.default_rng(2)
    values = rng.normal(size=(len(samples), 3))
    misfit = np.einsum("sk,sc->kc", samples, values)[None] / len(samples)
    expected, *_ = np.linalg.lstsq(samples, values, rcond=None)
    np.testing.assert_allclose(solve.corner_fits(misfit)[0], expected, atol=1e-9)


@pytest.mark.parametrize("ratio", [0.1, 0.5])
def test_few_faces_have_more_samples_each(ratio):
    fit = fitting(*terrain(), ratio=ratio)
    assert fit.layout.partners.face.shape[1] == (12 if len(fit.result.faces) <= FEW_FACES else 3)
    np.testing.assert_allclose(fit.layout.partners.samples.sum(axis=1), 1.0)
    assert (fit.layout.partners.samples > 0).all()


def test_held_values_stay_and_the_others_are_fitted_around_them(hills):
    values = hills.points[:, :1].astype(np.float64) ** 2
    corners = at_corners(hills, values)
    start = hills.start(corners.reshape(-1, 3, 1))
    free = np.arange(len(start)) % 3 > 0
    found = fit_smooth_values(hills.layout, corners, start, free)
    assert (found[~free] == start[~free]).all()
    assert (found[free] != start[free]).any()


def test_values_stay_in_the_range_of_the_input(hills):
    values = (hills.points[:, :1] > 0.5).astype(np.float64)
    found = fitted(hills, values)
    assert (found >= 0).all()
    assert (found <= 1).all()


def angle(fit, corners, rows):
    """Mean angle between the normals of output and input at nearest points."""
    values = [SurfaceValues(normals=CornerValues.of("normals", c)) for c in (corners, rows[fit.layout.corner_row])]
    placed = fit.result.points[0]
    compared = compare_appearance(
        fit.points, fit.faces, values[0], placed, fit.result.faces, values[1], samples=1000, device="cpu"
    )
    return compared.normals.mean


def test_normals_are_nearer_to_the_input_than_transferred_ones(bumps):
    corners = vertex_normals(bumps.points, bumps.faces)[bumps.faces].astype(np.float64)
    start = unit_vectors(bumps.start(corners))
    missed = normal_misfits(bumps.layout, corners.reshape(-1, 3), start)
    found = fit_normals(bumps.layout, missed, start)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, atol=1e-12)
    assert angle(bumps, corners, found) < 0.8 * angle(bumps, corners, start)


def test_normals_of_one_direction_are_not_split(bumps):
    up = np.tile([0.0, 0.0, 1.0], (bumps.faces.size, 1))
    start = bumps.start(up.reshape(-1, 3, 3))
    own = own_normals(bumps.layout, normal_misfits(bumps.layout, up, start), start)
    layout, row = split_normals(bumps.result.faces, bumps.layout, [own])
    assert layout is bumps.layout
    assert len(row) == len(start)


def roof():
    """A grid bent by a right angle in its middle, and the edges there."""
    points, faces = meshes.grid(8, 8)
    points = points.astype(np.float32)
    points[:, 2] = -np.abs(points[:, 0] - 0.5)
    ridge = np.flatnonzero(points[:, 0] == 0.5)
    return points, faces, np.stack([ridge[:-1], ridge[1:]], axis=1)


def slope_normals(points, faces):
    """One normal on each side, at the corners."""
    left = points[faces].mean(axis=1)[:, 0] < 0.5
    side = np.where(left[:, None], [-1.0, 0.0, 1.0], [1.0, 0.0, 1.0]) / np.sqrt(2.0)
    return np.repeat(side, 3, axis=0)


def test_hard_edges_stay_hard():
    points, faces, ridge = roof()
    fit = fitting(points, faces, seams=ridge, ratio=0.4)
    corners = slope_normals(points, faces)
    start = unit_vectors(fit.start(corners.reshape(-1, 3, 3)))
    found = fit_normals(fit.layout, normal_misfits(fit.layout, corners, start), start)
    shown = found[fit.layout.corner_row]
    left = fit.result.points[0][fit.result.faces].mean(axis=1)[:, 0] < 0.5
    expected = np.where(left[:, None], [-1.0, 0.0, 1.0], [1.0, 0.0, 1.0]) / np.sqrt(2.0)
    np.testing.assert_allclose(shown, np.broadcast_to(expected[:, None], shown.shape), atol=1e-6)


def test_normals_are_split_where_no_seam_says_so_but_the_input_bends():
    points, faces, _ = roof()
    fit = fitting(points, faces, ratio=0.4)
    corners = slope_normals(points, faces)
    start = unit_vectors(fit.start(corners.reshape(-1, 3, 3)))
    missed = normal_misfits(fit.layout, corners, start)
    layout, row = split_normals(fit.result.faces, fit.layout, [own_normals(fit.layout, missed, start)])
    assert len(row) > len(np.unique(fit.layout.corner_row))
    found = fit_normals(layout, missed, start[row])
    np.testing.assert_allclose(np.abs(found[:, 0]), np.sqrt(0.5), atol=0.05)


@pytest.mark.parametrize(
    ("at_edge", "further", "is_split"),
    [(20, 20, True), (12, 90, False), (20, -90, False)],
    ids=["both apart", "one at the corner", "one among the samples"],
)
def test_normals_are_split_where_fits_are_apart_at_the_corner_and_among_the_samples(at_edge, further, is_split):
    """Two faces whose fits have these angles, to either side, at their common edge and at the other corner."""
    faces = np.array([[0, 1, 2], [2, 1, 3]], dtype=np.int32)
    angles = np.radians([[-further, -at_edge, -at_edge], [at_edge, at_edge, further]])
    fit = np.stack([np.sin(angles), np.zeros_like(angles), np.cos(angles)], axis=2)
    corner_row, row = split_corners(faces, faces, [fit])
    assert len(row) == (6 if is_split else 4)
    assert (row[corner_row] == faces).all()


def test_partners_do_not_cross_a_seam():
    points, faces, ridge = roof()
    fit = fitting(points, faces, seams=ridge, ratio=0.2)
    partner = fit.layout.partners.face.numpy()
    left = points[faces].mean(axis=1)[:, 0] < 0.5
    own = fit.result.points[0][fit.result.faces].mean(axis=1)[:, 0] < 0.5
    assert (partner >= 0).all()
    assert (left[partner] == own[:, None]).all()


def test_samples_have_no_partner_where_the_input_faces_away():
    points, faces = terrain()
    fit = fitting(points, faces, ratio=0.3)
    turned = fit.result.points[0] * np.float32([1, 1, -1]) @ np.diag([1, -1, 1]).astype(np.float32)
    turned[:, 1] += points[:, 1].max()
    search = PartnerSearch(faces, fit.result, fit.transfer, np.zeros((0, 2), dtype=np.int64), "cpu")
    partners = search.find(points, turned)
    assert (partners.face.numpy() == -1).all()


@pytest.mark.parametrize("threads", [2, 3])
def test_bits_do_not_depend_on_the_number_of_threads(threads, monkeypatch):
    points, faces = terrain(16)
    values = np.random.default_rng(4).normal(size=(len(points), 3))
    results = []
    for count in (1, threads):
        monkeypatch.setattr(cpu_threads, "_core_count", lambda count=count: count)
        results.append(fitted(fitting(points, faces), values))
    assert (results[0] == results[1]).all()


def test_samples_of_slivers_find_the_face_that_they_lie_on():
    # A strip of long slivers, whose vertices are all at its ends.
    ends = np.linspace(0, 1, 41)
    points = np.concatenate([np.stack([0 * ends + x, ends, 0 * ends], axis=1) for x in (-20.0, 20.0)])
    points = points.astype(np.float32)
    low = np.arange(40)
    faces = np.concatenate([np.stack([low, low + 41, low + 1], 1), np.stack([low + 1, low + 41, low + 42], 1)])
    fit = fitting(points, faces.astype(np.int32), ratio=0.2)
    partner, weight = fit.layout.partners.face.numpy(), fit.layout.partners.weight.numpy()
    assert (partner >= 0).all()
    found = np.einsum("fsk,fskd->fsd", weight, points[faces[partner]])
    sample = np.einsum("sk,fkd->fsd", fit.layout.partners.samples, fit.result.points[0][fit.result.faces])
    np.testing.assert_allclose(found, sample, atol=1e-3)


def test_partners_in_a_pose_are_near_those_of_another():
    points, faces = terrain()
    fit = fitting(points, faces)
    search = PartnerSearch(faces, fit.result, fit.transfer, np.zeros((0, 2), dtype=np.int64), "cpu")
    again = search.find(points, fit.result.points[0], fit.layout.partners)
    assert (again.face.numpy() == fit.layout.partners.face.numpy()).all()
    # Moved as one, each sample stays on its face.
    moved = search.find(points + np.float32([5, 0, 0]), fit.result.points[0] + np.float32([5, 0, 0]), again)
    assert (moved.face.numpy() == again.face.numpy()).mean() > 0.99


def long_box():
    """A closed box of a square's section, 20 times as long, with a ring of points in its middle."""
    square = np.array([[0, 0], [0.1, 0], [0.1, 0.1], [0, 0.1]])
    points = np.concatenate([np.column_stack([np.full(4, x), square]) for x in (0.0, 1.0, 2.0)]).astype(np.float32)
    quads = [[a + k, a + (k + 1) % 4, b + (k + 1) % 4, b + k] for a, b in ((0, 4), (4, 8)) for k in range(4)]
    quads += [[3, 2, 1, 0], [8, 9, 10, 11]]
    faces = np.array([corner for q in quads for corner in ([q[0], q[2], q[1]], [q[0], q[3], q[2]])], dtype=np.int32)
    return points, faces


def test_most_samples_find_the_side_beyond_an_edge_of_one_that_faces_away():
    fit = fitting(*long_box(), ratio=0.3)
    face, weight = fit.layout.partners.face.numpy(), fit.layout.partners.weight.numpy()
    across = face_crosses(fit.points, fit.faces)
    is_off = []
    for f, corners in enumerate(fit.result.points[0][fit.result.faces].astype(np.float64)):
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        same = np.flatnonzero(across @ normal > 0.2 * np.linalg.norm(across, axis=1) * np.linalg.norm(normal))
        query = fit.layout.partners.samples @ corners
        found = np.einsum("sk,skd->sd", weight[f], fit.points[fit.faces[face[f]]])
        nearest = ClosestPointSearch(fit.faces[same], "cpu", "box").closest(fit.points.astype(np.float64), query, 0)
        is_off.append(np.linalg.norm(found - query, axis=1) > nearest.distance + 1e-5)
    # The others are on a side that faces the same way, too. With walks that end beyond the edge it is a seventh.
    assert np.mean(is_off) < 0.08


def face_crosses(points, faces):
    corner = points[faces].astype(np.float64)
    return np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])


def test_errors_of_normals_are_those_of_numpy(hills):
    rng = np.random.default_rng(7)
    values = unit_vectors(rng.normal(size=(hills.faces.size, 3)) + np.array([0, 0, 2]))
    corners = unit_vectors(rng.normal(size=(len(hills.result.faces), 3, 3)) + np.array([0, 0, 2]))
    partners = hills.layout.partners
    squared = angle = area = 0.0
    for f, row in enumerate(partners.face.numpy()):
        for s, g in enumerate(row):
            if g >= 0:
                wanted = unit_vectors(partners.weight.numpy()[f, s] @ values[3 * g : 3 * g + 3])
                shown = unit_vectors(partners.samples[s] @ corners[f])
                squared += partners.area[f] * ((wanted - shown) ** 2).sum()
                angle += partners.area[f] * np.arccos(wanted @ shown)
                area += partners.area[f]
    [found] = normal_errors(hills.layout, values, corners)
    assert (found.squared, found.angle) == pytest.approx((squared / area, angle / area))
    # Without samples of the input one way is both.
    assert (found.both_squared, found.both_angle) == (found.squared, found.angle)


@pytest.mark.parametrize(
    ("squared", "angle", "share", "expected"),
    [(1.0, 1.0, 1.0, True), (0.9, 1.1, 1.0, False), (1.1, 0.9, 1.0, False), (0.9, 0.9, 0.75, False)],
)
def test_normals_are_nearer_where_both_errors_say_so(squared, angle, share, expected):
    assert NormalErrors(squared, angle, 1.0, 1.0).is_within(NormalErrors(1.0, 1.0, 1.0, 1.0), share) is expected


@pytest.mark.parametrize("both", [(1.1, 0.9), (0.9, 1.1)])
def test_normals_that_miss_more_of_the_input_are_not_nearer(both):
    assert not NormalErrors(0.5, 0.5, *both).is_within(NormalErrors(1.0, 1.0, 1.0, 1.0))


# A floor and a wall of the same size.
CORNER_POINTS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [0, 1, 1]], dtype=np.float32)
FLOOR = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
WALL = np.array([[0, 3, 5], [0, 5, 4]], dtype=np.int32)


def test_samples_of_the_input_see_what_has_no_sample_of_the_output_near():
    faces = np.concatenate([FLOOR, WALL])
    samples = find_input_samples(CORNER_POINTS, faces, CORNER_POINTS, FLOOR, "cpu")
    normals = np.repeat([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]], 6, axis=0).reshape(4, 3, 3)
    wanted, shown = samples.normals_of_input(normals), samples.normals_of_output(normals[:2])
    assert (shown == [0, 0, 1]).all()
    assert (wanted != shown).any(axis=1).mean() == pytest.approx(0.5, abs=0.01)


def test_samples_of_the_input_have_the_nearest_point_of_the_output():
    samples = find_input_samples(CORNER_POINTS, FLOOR, CORNER_POINTS, FLOOR[:, [1, 2, 0]], "cpu")
    there = np.einsum("sk,skd->sd", samples.weight, CORNER_POINTS[FLOOR[samples.face]])
    here = np.einsum("sk,skd->sd", samples.nearest_weight, CORNER_POINTS[FLOOR[:, [1, 2, 0]][samples.nearest]])
    np.testing.assert_allclose(here, there, atol=1e-6)


def test_outputs_of_many_faces_or_without_area_need_no_samples_of_the_input():
    points, faces = meshes.grid(10, 10)
    assert len(faces) > MAX_FACES
    assert find_input_samples(points, faces, points, faces, "cpu") is None
    flat = np.zeros_like(CORNER_POINTS)
    assert find_input_samples(CORNER_POINTS, FLOOR, flat, FLOOR, "cpu") is None


def test_faces_that_mending_turned_over_have_partners_at_their_own_places():
    points, faces = meshes.grid(10, 10)
    points = points.astype(np.float32)
    given = faces.copy()
    given[::3] = given[::3, ::-1]
    fit = fitting(points, given)
    assert 0 < fit.result.repair.is_turned.sum() < len(faces)
    partner, weight = fit.layout.partners.face.numpy(), fit.layout.partners.weight.numpy()
    assert (partner >= 0).all()
    found = np.einsum("nsk,nskd->nsd", weight, points[given][partner])
    own = np.einsum("sk,nkd->nsd", fit.layout.partners.samples, fit.result.points[0][fit.result.faces])
    np.testing.assert_allclose(found, own, atol=1e-5)


def test_texture_turns_with_faces_that_mending_turned_over():
    points, faces = meshes.grid(10, 10)
    given = faces.copy()
    given[::3] = given[::3, ::-1]
    fit = fitting(points.astype(np.float32), given)
    signs = fit.signs(points[given][:, :, :2].reshape(-1, 2).astype(np.float64))
    assert abs(signs.sum()) == len(fit.result.faces)
