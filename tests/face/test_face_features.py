"""Named feature points of faces."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import warpqem
from tests.support.faces import FACE_HEIGHT, REFERENCE, talking_head
from warpqem.errors import OptionError
from warpqem.face import FEATURE_NAMES, PAIRS, FacialFeatures
from warpqem.face.contact_line import find_contact_line
from warpqem.face.lids import closing_lid
from warpqem.face.relief import Relief, make_relief
from warpqem.face.skin_regions import find_skin
from warpqem.face.walks import from_chord, walk_to_extremum


@cache
def found() -> FacialFeatures:
    return warpqem.face.facial_features(*talking_head())


def errors(features: FacialFeatures) -> dict[str, float]:
    """Distances from the reference in % of the face's height."""
    points = talking_head()[0][0]
    return {
        name: 100 * float(np.linalg.norm(points[vertex] - REFERENCE[name])) / FACE_HEIGHT
        for name, vertex in features.vertices.items()
        if name in REFERENCE
    }


def test_28_points_of_the_talking_head_lie_within_3_percent_of_the_reference() -> None:
    assert sum(error <= 3.0 for error in errors(found()).values()) >= 28


def test_no_point_lies_far_from_the_reference() -> None:
    assert max(errors(found()).values()) < 6.0


def test_both_halves_of_each_pair_mirror_each_other() -> None:
    points = talking_head()[0][0]
    for pair in PAIRS:
        left, right = (points[found().vertices[f"{pair}_{side}"]] for side in ("left", "right"))
        assert left[0] > 0.0 > right[0]
        assert np.linalg.norm(left * (-1, 1, 1) - right) < 0.04 * FACE_HEIGHT


def test_every_name_is_either_found_with_a_confidence_or_missing_with_a_reason() -> None:
    assert found().vertices.keys() | found().missing.keys() == set(FEATURE_NAMES)
    assert not found().vertices.keys() & found().missing.keys()
    assert found().confidence.keys() == found().vertices.keys()
    assert all(0.0 < value <= 1.0 for value in found().confidence.values())


def test_other_axes_give_the_same_points() -> None:
    points, faces = talking_head()
    # z up, -y forward.
    turned = points @ np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]], dtype=np.float32).T
    again = warpqem.face.facial_features(turned, faces, up="+z", forward="-y")
    assert again.vertices == found().vertices


def test_a_turned_head_gives_the_same_points_when_its_orientation_is_found() -> None:
    points, faces = talking_head()
    angle = np.radians(20.0)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    straight = warpqem.face.facial_features(points[0], faces, up=None, forward=None)
    turned = warpqem.face.facial_features((points[0] @ turn.T).astype(np.float32), faces, up=None, forward=None)
    assert turned.vertices == straight.vertices
    assert np.abs(turned.axes - straight.axes @ turn.T).max() < 1e-3
    assert sum(error <= 5.0 for error in errors(straight).values()) >= 26


def test_a_mask_has_no_top_no_sides_and_no_throat() -> None:
    points, faces = talking_head()
    at = points[0][faces].mean(axis=1)
    mask = faces[(at[:, 2] > 4.5) & (at[:, 1] > -10.2) & (at[:, 1] < 7.0)]
    features = warpqem.face.facial_features(points, mask)
    assert {"head_top", "head_side_left", "head_side_right", "throat"} <= features.missing.keys()
    assert len(features.vertices) >= 20


def test_a_ball_has_no_face() -> None:
    angles = np.linspace(0, np.pi, 20)[:, None], np.linspace(0, 2 * np.pi, 40, endpoint=False)[None]
    ball = np.stack(
        np.broadcast_arrays(
            np.sin(angles[0]) * np.cos(angles[1]), np.cos(angles[0]), np.sin(angles[0]) * np.sin(angles[1])
        ),
        -1,
    ).reshape(-1, 3)
    row, column = np.meshgrid(np.arange(19), np.arange(40), indexing="ij")
    a, b = row * 40 + column, row * 40 + (column + 1) % 40
    faces = np.concatenate([np.stack([a, b, a + 40], -1), np.stack([b, b + 40, a + 40], -1)]).reshape(-1, 3)
    features = warpqem.face.facial_features(ball, faces)
    assert features.vertices == {}
    assert features.missing.keys() == set(FEATURE_NAMES)


def test_points_that_the_caller_names_are_taken_as_they_are() -> None:
    points, faces = talking_head()
    features = warpqem.face.facial_features(points[0], faces, overrides={"nose_tip": 7, "throat": None})
    assert features.vertices["nose_tip"] == 7
    assert features.confidence["nose_tip"] == 1.0
    assert "throat" in features.missing


@pytest.mark.parametrize(
    "options",
    [
        {"up": "up"},
        {"up": "+z"},
        {"up": None},
        {"overrides": {"tail": 0}},
        {"overrides": {"chin": 10**9}},
    ],
)
def test_wrong_options_are_refused(options: dict) -> None:
    with pytest.raises(OptionError):
        warpqem.face.facial_features(*talking_head(), **options)


# Walks


@settings(deadline=None)
@given(st.lists(st.floats(-1, 1), min_size=3, max_size=40), st.floats(0.01, 0.5), st.sampled_from([1.0, -1.0]))
def test_a_walk_ends_at_an_extremum_of_what_it_passed(heights: list[float], prominence: float, sign: float) -> None:
    profile = np.array(heights)
    stop = walk_to_extremum(profile, 0, len(profile) - 1, sign, prominence)
    if stop is not None:
        assert sign * profile[stop.at] - (sign * profile[: stop.at + 1]).min() >= prominence
        assert stop.prominence >= 0.0


def test_the_same_walk_backwards_finds_the_mirrored_sample() -> None:
    profile = np.sin(np.linspace(0.0, 9.0, 91))
    forwards = walk_to_extremum(profile, 0, 90, 1.0, 0.1)
    backwards = walk_to_extremum(profile[::-1].copy(), 90, 0, 1.0, 0.1)
    assert forwards is not None
    assert backwards is not None
    assert forwards.at == 90 - backwards.at == 16


def test_the_corner_of_an_angle_stands_out_of_its_chord() -> None:
    profile = np.abs(np.arange(21) - 7.0)
    stop = from_chord(profile, 0, 20, -1.0, 1.0)
    assert stop is not None
    assert stop.at == 7


def test_a_lid_that_closes_tells_where_the_eye_is() -> None:
    left, up = (axis.ravel() for axis in np.meshgrid(np.linspace(0.2, 1.0, 41), np.linspace(0.3, 1.0, 36)))
    place = np.stack([left, up, np.zeros_like(left)], axis=1)
    lid = np.exp(-(((left - 0.55) / 0.1) ** 2) - ((up - 0.72) / 0.05) ** 2)
    # The whole face comes down in the second frame, the lid in the third.
    rise = np.stack([np.zeros_like(lid), np.full_like(lid, -0.5), -0.2 * lid])
    found = closing_lid(place, rise, (0.62, 0.67), 0.15)
    assert found is not None
    assert abs(found - 0.55) < 0.01
    assert closing_lid(place, rise[:2], (0.62, 0.67), 0.15) is None


def test_lips_of_a_still_head_are_found_as_those_of_one_that_moves() -> None:
    points, faces = talking_head()
    still = warpqem.face.facial_features(points[0], faces)
    mouth = [name for name in found().names if "lip" in name or "mouth" in name]
    assert len(mouth) == 10
    for name in mouth:
        assert np.linalg.norm(points[0][still.vertices[name]] - points[0][found().vertices[name]]) < 0.01 * FACE_HEIGHT


def test_corners_of_the_mouth_are_where_the_cut_between_the_lips_ends() -> None:
    points, faces = talking_head()
    at = errors(warpqem.face.facial_features(points[0], faces))
    assert at["mouth_corner_left"] < 1.0
    assert at["mouth_corner_right"] < 1.0


def outside_of_lips(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The head's faces without the pocket behind the lips: an open slit."""
    local = found().units.local(points.astype(np.float64))
    line = find_contact_line(local, find_skin(points, faces).faces, relief_of(local, faces), NOSE_FOOT)
    assert line is not None
    middle = local[faces].mean(axis=1)
    inside = (middle[:, 1] > -0.9) & (middle[:, 1] < -0.4) & (np.abs(middle[:, 0]) < 0.6)
    # The pocket lies behind the line and opens downwards and upwards into the head.
    depth = np.interp(middle[:, 0], line.place[:, 0], line.place[:, 2])
    return faces[~(inside & (middle[:, 2] < depth - 0.03))]


def relief_of(local: np.ndarray, faces: np.ndarray) -> Relief:
    return make_relief(local, faces, (-1.75, -2.2), (1.75, 2.2), 0.0125)


# Height of the foot of the nose of the talking head, in noses.
NOSE_FOOT = -0.24


@pytest.mark.parametrize("scale", [0.01, 1.0, 300.0])
def test_a_slit_without_a_pocket_is_found_at_any_size(scale: float) -> None:
    points, faces = talking_head()
    open_faces = outside_of_lips(points[0], faces)
    assert len(open_faces) < len(faces)
    features = warpqem.face.facial_features(points[0] * np.float32(scale), open_faces)
    at = errors(features)
    assert at["mouth_corner_left"] < 1.0
    assert at["mouth_corner_right"] < 1.0


def test_lips_that_are_not_cut_apart_have_no_contact_line() -> None:
    points, faces = talking_head()
    local = found().units.local(points[0].astype(np.float64))
    _, first, joined = np.unique(local, axis=0, return_index=True, return_inverse=True)
    welded = joined.ravel()[faces]
    assert find_contact_line(local[first], welded, relief_of(local, faces), NOSE_FOOT) is None


def test_points_split_along_the_profile_are_no_contact_line() -> None:
    points, faces = talking_head()
    local = found().units.local(points[0].astype(np.float64))
    _, first, joined = np.unique(local, axis=0, return_index=True, return_inverse=True)
    local, welded = local[first], joined.ravel()[faces]
    # As exporters split points at a UV seam: each side of the face has its own along the midline.
    left = local[welded].mean(axis=1)[:, 0] > 0.0
    shared = np.intersect1d(welded[left], welded[~left])
    place = np.arange(len(local))
    place[shared] = len(local) + np.arange(len(shared))
    split = np.where(left[:, None], place[welded], welded)
    relief = relief_of(local, welded)
    assert find_contact_line(np.concatenate([local, local[shared]]), split, relief, NOSE_FOOT) is None
