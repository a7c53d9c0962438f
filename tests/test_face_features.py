"""Named feature points of faces."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import warpqem
from tests.faces import FACE_HEIGHT, REFERENCE, talking_head
from warpqem.errors import OptionError
from warpqem.face import FEATURE_NAMES, PAIRS, FacialFeatures
from warpqem.face.lids import closing_lid
from warpqem.face.walks import from_chord, walk_to_extremum


@cache
def found() -> FacialFeatures:
    return warpqem.facial_features(*talking_head())


def errors(features: FacialFeatures) -> dict[str, float]:
    """Distances from the reference in % of the face's height."""
    points = talking_head()[0][0]
    return {
        name: 100 * float(np.linalg.norm(points[vertex] - REFERENCE[name])) / FACE_HEIGHT
        for name, vertex in features.vertices.items()
        if name in REFERENCE
    }


def test_26_points_of_the_talking_head_lie_within_3_percent_of_the_reference() -> None:
    assert sum(error <= 3.0 for error in errors(found()).values()) >= 26


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
    again = warpqem.facial_features(turned, faces, up="+z", forward="-y")
    assert again.vertices == found().vertices


def test_a_turned_head_gives_the_same_points_when_its_orientation_is_found() -> None:
    points, faces = talking_head()
    angle = np.radians(20.0)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    straight = warpqem.facial_features(points[0], faces, up=None, forward=None)
    turned = warpqem.facial_features((points[0] @ turn.T).astype(np.float32), faces, up=None, forward=None)
    assert turned.vertices == straight.vertices
    assert np.abs(turned.axes - straight.axes @ turn.T).max() < 1e-3
    assert sum(error <= 5.0 for error in errors(straight).values()) >= 26


def test_a_mask_has_no_top_no_sides_and_no_throat() -> None:
    points, faces = talking_head()
    at = points[0][faces].mean(axis=1)
    mask = faces[(at[:, 2] > 4.5) & (at[:, 1] > -10.2) & (at[:, 1] < 7.0)]
    features = warpqem.facial_features(points, mask)
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
    features = warpqem.facial_features(ball, faces)
    assert features.vertices == {}
    assert features.missing.keys() == set(FEATURE_NAMES)


def test_points_that_the_caller_names_are_taken_as_they_are() -> None:
    points, faces = talking_head()
    features = warpqem.facial_features(points[0], faces, overrides={"nose_tip": 7, "throat": None})
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
        warpqem.facial_features(*talking_head(), **options)


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
