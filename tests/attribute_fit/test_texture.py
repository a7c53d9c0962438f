"""Texture coordinates fitted to those of the input: no triangle is turned over, seams stay on their lines."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support import meshes
from tests.support.attribute_fit import fitting
from warpqem.attribute_fit import texture
from warpqem.attribute_fit.texture import fit_texture
from warpqem.attribute_fit.turned_triangles import areas_at, turned_back


@pytest.fixture(scope="module")
def plane():
    points, faces = meshes.grid(12, 12)
    return fitting(points.astype(np.float32), faces, ratio=0.3)


@pytest.fixture(scope="module")
def two_islands():
    """A plane with a seam at x = 0.5."""
    points, faces = meshes.grid(12, 12)
    ridge = np.flatnonzero(points[:, 0] == 0.5)
    return fitting(points.astype(np.float32), faces, np.stack([ridge[:-1], ridge[1:]], axis=1), ratio=0.3)


def at_corners(fit):
    return fit.points[fit.faces][:, :, :2].astype(np.float64)


def fitted(fit, corners, start):
    values = corners.reshape(-1, 2)
    signs = fit.signs(values)
    return signs, fit_texture(fit.result.faces, fit.layout, values, start, signs)


def own_places(fit):
    """(R, 2), where each value stands in the plane."""
    places = np.zeros((int(fit.layout.corner_row.max()) + 1, 2))
    places[fit.layout.corner_row] = fit.result.points[0][fit.result.faces][:, :, :2]
    return places


def signed_areas(corners):
    """Twice the areas (N,) of triangles (N, 3, 2), positive for counter-clockwise ones, corner by corner."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]


def face_signs(corners):
    """Which way triangles (N, 3, 2) turn: 1 counter-clockwise, -1 clockwise, 0 without area."""
    return np.sign(signed_areas(corners)).astype(np.int8)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**31), st.floats(0, 0.6))
def test_no_triangle_is_turned_over_wherever_values_start(plane, seed, size):
    corners = at_corners(plane)
    start = plane.start(corners)
    start = start + np.random.default_rng(seed).normal(scale=size / 12, size=start.shape)
    signs, found = fitted(plane, corners, start)
    assert (signs == signs[0]).all()
    before = (face_signs(start[plane.layout.corner_row]) != signs).sum()
    after = (face_signs(found[plane.layout.corner_row]) != signs).sum()
    assert after <= before
    assert after == 0 or size > 0.3


def test_values_of_a_plane_are_where_its_points_are(plane):
    corners = at_corners(plane)
    _, found = fitted(plane, corners, plane.start(corners))
    used = np.unique(plane.layout.corner_row)
    np.testing.assert_allclose(found[used], own_places(plane)[used], atol=1e-5)


def test_values_on_a_seam_stay_on_its_line_and_islands_apart(two_islands):
    left = two_islands.points[two_islands.faces].mean(axis=1)[:, 0] < 0.5
    # Bent within the islands, so that there is something to fit.
    corners = at_corners(two_islands)
    corners = corners + 0.05 * np.sin(7 * corners[:, :, ::-1]) * np.sin(np.pi * 2 * corners[:, :, :1])
    corners[~left, :, 0] += 5.0
    start = two_islands.start(corners)
    _, found = fitted(two_islands, corners, start)
    row = two_islands.layout.corner_row
    at_seam = np.unique(row[np.isclose(two_islands.result.points[0][two_islands.result.faces][:, :, 0], 0.5)])
    assert len(at_seam) > 4
    np.testing.assert_allclose(found[at_seam, 0], start[at_seam, 0], atol=1e-6)
    own_left = two_islands.result.points[0][two_islands.result.faces].mean(axis=1)[:, 0] < 0.5
    assert (found[row[own_left], 0] < 2).all()
    assert (found[row[~own_left], 0] > 2).all()


def squared_error(fit, corners, found):
    """Mean over the samples that have a partner."""
    partner, weight = fit.layout.partners.face.numpy(), fit.layout.partners.weight.numpy()
    wanted = np.einsum("nsk,nskc->nsc", weight, corners[partner])
    own = np.einsum("sk,nkc->nsc", fit.layout.partners.samples, found[fit.layout.corner_row])
    return (((wanted - own) ** 2).sum(axis=2) * fit.layout.partners.area[:, None])[partner >= 0].mean()


def test_values_on_a_seam_that_bends_move_into_their_island_by_its_bend_and_out_by_a_quarter(two_islands, monkeypatch):
    left = two_islands.points[two_islands.faces].mean(axis=1)[:, 0] < 0.5
    corners = at_corners(two_islands)
    corners[:, :, 0] += 0.1 * np.cos(3.0 * corners[:, :, 1])
    corners[~left, :, 0] += 5.0
    start = two_islands.start(corners)
    _, found = fitted(two_islands, corners, start)
    row, places = two_islands.layout.corner_row, own_places(two_islands)
    on_left = two_islands.result.points[0][two_islands.result.faces].mean(axis=1)[:, 0] < 0.5
    seam = np.unique(row[on_left][np.isclose(places[row[on_left], 0], 0.5)])
    seam = seam[np.argsort(places[seam, 1])]
    inner, along = seam[1:-1], start[seam[2:]] - start[seam[:-2]]
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1, keepdims=True)
    bend = ((start[inner] - start[seam[:-2]]) * normal).sum(axis=1)
    # Up the seam the island is on the left.
    into = ((found[inner] - start[inner]) * normal).sum(axis=1)
    assert len(inner) > 4
    assert into.min() < -5e-4
    assert into.max() > 1e-3
    assert (into <= np.abs(bend) + 1e-9).all()
    assert (into >= -0.25 * np.abs(bend) - 1e-9).all()
    assert (into > 0.25 * np.abs(bend)).any()
    monkeypatch.setattr(texture, "MAX_BEND_OUT", 0.0)
    _, held = fitted(two_islands, corners, start)
    assert ((held[inner] - start[inner]) * normal).sum(axis=1).min() >= -1e-9
    assert squared_error(two_islands, corners, found) < squared_error(two_islands, corners, held)


@pytest.mark.parametrize(
    ("corners", "sign"), [([[0, 0], [1, 0], [0, 1]], 1), ([[0, 0], [0, 1], [1, 0]], -1), ([[0, 0], [1, 1], [2, 2]], 0)]
)
def test_sign_of_a_triangle(corners, sign):
    assert np.sign(areas_at(np.array(corners, dtype=np.float64), np.arange(3, dtype=np.int32)[None])) == [sign]


def test_triangle_that_is_turned_over_is_mended_next_to_its_edge(plane):
    places = own_places(plane)
    row = plane.layout.corner_row
    # A corner inside, a little beyond the opposite edge of one of its faces.
    border = np.isin(places, [0.0, 1.0]).any(axis=1)
    face, corner = next((f, k) for f in range(len(row)) for k in range(3) if not border[row[f, k]])
    apex, first, second = (row[face, corner - k] for k in range(3))
    along = places[second] - places[first]
    foot = places[first] + along * ((places[apex] - places[first]) @ along) / (along @ along)
    start = places.copy()
    start[apex] = foot - 1e-3 * (places[apex] - foot)
    signs = plane.signs(at_corners(plane).reshape(-1, 2))
    found = turned_back(row, start, signs, np.full_like(start, -np.inf), np.full_like(start, np.inf))
    assert (face_signs(start[row]) * signs < 0).sum() == 1
    assert (face_signs(found[row]) * signs >= 0).all()
    assert np.abs(found - start).max() < 0.2 * np.linalg.norm(places[apex] - foot)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**31))
def test_triangles_that_are_turned_over_side_by_side_are_all_mended(plane, seed):
    places, row = own_places(plane), plane.layout.corner_row
    random = np.random.default_rng(seed)
    # All around a corner, which itself is where another one inside is.
    inside = np.flatnonzero(~np.isin(places, [0.0, 1.0]).any(axis=1))
    start = places.copy()
    start[random.choice(inside, 3, replace=False)] += random.normal(scale=0.15, size=(3, 2))
    signs = plane.signs(at_corners(plane).reshape(-1, 2))
    found = turned_back(row, start, signs, np.zeros_like(start), np.ones_like(start))
    assert (face_signs(found[row]) * signs >= 0).all()


def test_chart_that_gets_no_better_stays_as_it_is(two_islands):
    corners = at_corners(two_islands)
    left = two_islands.points[two_islands.faces].mean(axis=1)[:, 0] < 0.5
    # One is exact; the other gets better.
    corners[~left, :, 0] += 5.0 + 0.1 * np.sin(7 * corners[~left, :, 1])
    start = two_islands.start(corners)
    _, best = fitted(two_islands, corners, start)
    row = two_islands.layout.corner_row
    on_left = two_islands.result.points[0][two_islands.result.faces].mean(axis=1)[:, 0] < 0.5
    worse = best.copy()
    worse[np.unique(row[on_left])] += 0.01
    found = texture._where_better(two_islands.layout, corners.reshape(-1, 2), start, worse)
    assert (found[row[on_left]] == start[row[on_left]]).all()
    assert (found[row[~on_left]] == best[row[~on_left]]).all()
    assert (best[row[~on_left]] != start[row[~on_left]]).any()


def test_forks_of_seams_move_along_their_lines_too():
    """Four islands about a corner."""
    points, faces = meshes.grid(12, 12)
    points = points.astype(np.float32)
    middle = points[faces].mean(axis=1)[:, :2] > 0.5
    ridges = [np.flatnonzero(points[:, k] == 0.5) for k in (0, 1)]
    fit = fitting(points, faces, np.concatenate([np.stack([r[:-1], r[1:]], axis=1) for r in ridges]), ratio=0.3)
    corners = at_corners(fit)
    corners += 5.0 * middle[:, None]
    # Not linear along the line between the islands at the fork.
    corners[..., 1] += 0.2 * (corners[..., 1] % 5 - 0.5) ** 2
    start = fit.start(corners)
    _, found = fitted(fit, corners, start)
    row, places = fit.layout.corner_row, own_places(fit)
    fork = np.unique(row[(places[row] == 0.5).all(axis=2)])
    assert len(fork) == 4
    assert (np.abs(found - start)[fork].max(axis=1) > 1e-4).all()


def test_areas_by_rows_are_those_of_the_corners_to_the_last_bit():
    rng = np.random.default_rng(3)
    values, rows = rng.normal(size=(40, 2)), rng.integers(0, 40, (60, 3)).astype(np.int32)
    np.testing.assert_array_equal(areas_at(values, rows), signed_areas(values[rows]))
