"""Levels that keep the feature points of a face."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

import warpqem
from tests.faces import FACE_HEIGHT, talking_head
from warpqem import FaceProtection, FacialFeatures
from warpqem.errors import FeaturePointError, OptionError
from warpqem.face import face_weights

LEVELS = (1420, 1120, 820, 620)


@cache
def head_of_2000() -> tuple[NDArray[np.float32], NDArray[np.int32], FacialFeatures]:
    """Three frames of the talking head at 2000 faces, and its feature points there."""
    points, faces = talking_head()
    features = warpqem.facial_features(points, faces)
    head = warpqem.simplify(
        points[::4], faces, target_faces=2000, metric="face", face=FaceProtection(features=features)
    )
    own = {name: int(head.vertex_map[vertex]) for name, vertex in features.vertices.items()}
    return head.points, head.faces, replace(features, vertices=own)


def survivors(level: warpqem.SimplifiedMesh) -> int:
    """Feature points with a vertex within 1 % of the face's height, in every frame."""
    points, _, features = head_of_2000()
    gaps = np.linalg.norm(level.points[:, None] - points[:, features.indices][:, :, None], axis=3)
    return int((gaps.max(axis=0).min(axis=1) <= 0.01 * FACE_HEIGHT).sum())


@pytest.mark.parametrize("face_count", LEVELS)
def test_at_least_23_points_survive_and_plain_quadrics_lose_more(face_count: int) -> None:
    points, faces, features = head_of_2000()
    level = warpqem.simplify(
        points, faces, target_faces=face_count, metric="face", face=FaceProtection(features=features)
    )
    plain = warpqem.simplify(points, faces, target_faces=face_count, metric="qem")
    assert face_count - 1 <= len(level.faces) <= face_count
    assert survivors(level) >= 23
    assert survivors(plain) < survivors(level)


def test_weights_alone_keep_more_points_than_none() -> None:
    points, faces, features = head_of_2000()
    weighted = FaceProtection(features=features, weight=100.0, keep=False)
    level = warpqem.simplify(points, faces, target_faces=1120, metric="face", face=weighted)
    assert survivors(level) > survivors(warpqem.simplify(points, faces, target_faces=1120))


def test_points_are_found_where_none_are_given() -> None:
    points, faces = talking_head()
    features = warpqem.facial_features(points[:1], faces)
    level = warpqem.simplify(points[:1], faces, target_faces=9000, metric="face")
    kept = points[:1, features.indices]
    np.testing.assert_allclose(level.points[:, level.vertex_map[features.indices]], kept, atol=1e-4)


def test_weights_fall_linearly_over_the_rings() -> None:
    # A strip of squares, two faces each: columns of two vertices.
    column = np.arange(9)[:, None] * 2
    faces = np.concatenate([column + np.array(corner) for corner in ([0, 2, 1], [1, 2, 3])])
    features = FacialFeatures({"chin": 8}, {"chin": 1.0}, {}, np.eye(3))
    weights = face_weights(faces, 20, FaceProtection(features=features, weight=7.0, ring=2))
    # Vertex 8 is the lower one of column 4; the diagonals lead from lower right to upper left.
    expected = np.ones(20)
    expected[8] = 7.0
    expected[[6, 7, 9, 10]] = 5.0
    expected[[4, 5, 11, 12]] = 3.0
    np.testing.assert_allclose(weights, expected)


def test_texture_coordinates_count_beside_the_points() -> None:
    points, faces, features = head_of_2000()
    # A texture with a frequency that the shape knows nothing of.
    texture = warpqem.AttributeField(np.sin(3.0 * points[0][:, :2]), weight=0.2)
    common = {"target_faces": 820, "metric": "face", "face": FaceProtection(features=features)}
    plain = warpqem.simplify(points, faces, **common)
    textured = warpqem.simplify(points, faces, attributes=[texture], **common)
    assert survivors(textured) >= 23
    assert not np.array_equal(plain.faces, textured.faces)


def test_wrong_use_is_refused() -> None:
    points, faces, features = head_of_2000()
    with pytest.raises(OptionError, match="needs metric 'face'"):
        warpqem.simplify(points, faces, ratio=0.5, face=FaceProtection(features=features))
    with pytest.raises(OptionError, match="weight"):
        FaceProtection(weight=0.5)
    with pytest.raises(OptionError, match="ring"):
        FaceProtection(ring=-1)
    far = replace(features, vertices={"chin": 10**6})
    with pytest.raises(OptionError, match="1000000"):
        warpqem.simplify(points, faces, ratio=0.5, metric="face", face=FaceProtection(features=far))


def test_a_mesh_without_a_face_is_refused() -> None:
    grid = np.stack(np.meshgrid(np.arange(5.0), np.arange(5.0)), -1).reshape(-1, 2)
    flat = np.concatenate([grid, np.zeros((25, 1))], axis=1)
    corner = (np.arange(4)[:, None] * 5 + np.arange(4)).reshape(-1, 1)
    faces = np.concatenate([corner + np.array(side) for side in ([0, 1, 5], [1, 6, 5])])
    with pytest.raises(FeaturePointError, match="no face was found"):
        warpqem.simplify(flat, faces, ratio=0.5, metric="face")
