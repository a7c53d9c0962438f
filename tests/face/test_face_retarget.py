"""The motion of a face carried to another one."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

import warpqem
from tests.support.faces import FACE_HEIGHT, talking_head
from warpqem.errors import FeaturePointError, MeshShapeError
from warpqem.face import FaceMesh, FaceProtection, FacialFeatures, RetargetedMotion
from warpqem.face.lips import keep_apart, lip_pairs
from warpqem.face.skin_regions import without_head_motion
from warpqem.measure.closest_points import ClosestPointSearch


@cache
def head() -> tuple[NDArray[np.float32], NDArray[np.int32], FacialFeatures]:
    points, faces = talking_head()
    return points, faces, warpqem.face.facial_features(points, faces)


def source() -> FaceMesh:
    points, faces, features = head()
    return FaceMesh(points[0], faces, features)


@cache
def expressions() -> NDArray[np.float64]:
    """Frames in which the head keeps still and the face does not."""
    points, faces, _ = head()
    return without_head_motion(points, np.unique(faces))


@cache
def stretched() -> tuple[NDArray[np.float64], NDArray[np.float64], RetargetedMotion]:
    """A linear map, the head mapped by it, and the motion that this one gets."""
    points, faces, features = head()
    linear = np.array([[1.8, 0.0, 0.1], [0.0, 2.3, 0.2], [0.0, 0.0, 2.0]])
    target = points[0] @ linear.T
    own = warpqem.face.facial_features(target, faces, overrides=features.vertices)
    return linear, target, warpqem.face.retarget(source(), FaceMesh(target, faces, own), expressions())


def test_a_face_gets_its_own_motion_back() -> None:
    points, _, _ = head()
    found = warpqem.face.retarget(source(), source(), points)
    error = np.linalg.norm(found.points - points, axis=2) / FACE_HEIGHT
    # Some vertices of the lips are pushed out of each other.
    assert np.quantile(error, 0.99) < 1e-4
    assert error.max() < 0.05


def test_a_stretched_face_gets_motion_stretched_as_much() -> None:
    linear, target, found = stretched()
    expected = (expressions() - expressions()[0]) @ linear.T
    error = np.linalg.norm(found.points - target - expected, axis=2)
    assert np.linalg.norm(expected, axis=2).max() > 3.0
    assert np.quantile(error, 0.99) < 0.02


def test_a_level_moves_more_like_the_original_than_by_its_nearest_vertices() -> None:
    points, faces, features = head()
    protection = FaceProtection(features=features)
    level = warpqem.simplify(points[:1], faces, target_faces=820, metric="face", face=protection, quality="fast")
    own = {name: int(level.vertex_map[vertex]) for name, vertex in features.vertices.items()}
    found = warpqem.face.retarget(
        source(), FaceMesh(level.points[0], level.faces, replace(features, vertices=own)), points
    )
    middle, size = points[0].mean(axis=0), 40.0
    search = ClosestPointSearch(faces.astype(np.int64), "cpu", "original")
    at = search.closest(*(((mesh - middle) / size).astype(float) for mesh in (points[0], level.points[0])), 0)
    motion = points - points[0]
    true = level.points[0] + np.einsum("tk,ftkx->ftx", at.barycentric, motion[:, faces[at.face]])
    nearest = level.points[0] + motion[:, cKDTree(points[0]).query(level.points[0])[1]]
    errors = [np.sqrt(((moved - true) ** 2).sum(axis=2).mean()) for moved in (found.points, nearest)]
    assert errors[0] < errors[1]


def test_what_the_source_lacks_keeps_still() -> None:
    points, faces, _ = head()
    at = points[0][faces].mean(axis=1)
    mask = faces[(at[:, 2] > 4.0) & (at[:, 1] > -11.0)]
    still = expressions().astype(np.float32)
    found = warpqem.face.retarget(
        FaceMesh(still[0], mask, warpqem.face.facial_features(still[:1], mask)), source(), still
    )
    back = points[0, :, 2] < -5.0
    assert (found.share[back] == 0.0).all()
    np.testing.assert_allclose(found.points[:, back], np.broadcast_to(points[0, back], (12, back.sum(), 3)), atol=0.3)


def test_blend_shapes_hold_the_motion() -> None:
    _, target, found = stretched()
    shapes = found.blend_shapes()
    assert len(shapes) == len(found.points)
    for frame, (vertices, offsets) in zip(found.points, shapes, strict=True):
        moved = found.neutral.copy()
        moved[vertices] += offsets
        assert np.abs(moved - frame).max() < 2e-5 * np.linalg.norm(np.ptp(target, axis=0))


def test_lips_do_not_sink_into_each_other() -> None:
    neutral = np.array([[0.0, 0.1, 0.0], [0.0, 0.0, 0.0], [5.0, 1.0, 0.0], [5.0, -1.0, 0.0]])
    pairs = lip_pairs(neutral, np.array([1, -1, 1, -1]), 0.5)
    assert pairs.tolist() == [[0, 1]]
    crossed = neutral + np.array([[0, -1.0, 0], [0, 0.3, 0], [0, 0, 0], [0, 0, 0]])
    apart = keep_apart(crossed, neutral, pairs, np.array([0.0, 1.0, 0.0]))
    assert apart[0, 1] == pytest.approx(apart[1, 1])
    assert apart[0, 1] + apart[1, 1] == pytest.approx(crossed[0, 1] + crossed[1, 1])
    np.testing.assert_array_equal(apart[2:], crossed[2:])


def test_lips_that_part_are_left_alone() -> None:
    neutral = np.array([[0.0, 0.1, 0.0], [0.0, 0.0, 0.0]])
    open_lips = neutral + np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
    apart = keep_apart(open_lips, neutral, np.array([[0, 1]]), np.array([0.0, 1.0, 0.0]))
    np.testing.assert_array_equal(apart, open_lips)


def test_runs_repeat_bit_for_bit() -> None:
    points, _, _ = head()
    first, again = (warpqem.face.retarget(source(), source(), points[:3]).points for _ in range(2))
    np.testing.assert_array_equal(first, again)


def test_wrong_input_is_refused() -> None:
    points, faces, features = head()
    with pytest.raises(MeshShapeError, match="motion"):
        warpqem.face.retarget(source(), source(), points[:, :10])
    few = replace(features, vertices={name: features.vertices[name] for name in ("chin", "nose_tip")})
    with pytest.raises(FeaturePointError, match="share 2 feature points"):
        warpqem.face.retarget(source(), FaceMesh(points[0], faces, few), points)
    with pytest.raises(FeaturePointError, match="nose"):
        warpqem.face.retarget(source(), FaceMesh(points[0], faces, replace(features, units=None)), points)
