"""Levels that keep the feature points of a face."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

import warpqem
from tests.support.faces import FACE_HEIGHT, talking_head
from warpqem.errors import FeaturePointError, OptionError
from warpqem.face import FaceProtection, FacialFeatures, face_sums
from warpqem.measure import compare
from warpqem.pipeline.symmetry import simplify_symmetric

LEVELS = (1420, 1120, 820, 620)


@cache
def head_of_2000() -> tuple[NDArray[np.float32], NDArray[np.int32], FacialFeatures]:
    """Three frames of the talking head at 2000 faces, and its feature points there."""
    points, faces = talking_head()
    features = warpqem.face.facial_features(points, faces)
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


def level_of(face_count: int, **protection: object) -> warpqem.SimplifiedMesh:
    points, faces, features = head_of_2000()
    face = FaceProtection(features=features, **protection)
    return warpqem.simplify(points, faces, target_faces=face_count, metric="face", face=face)


def rms(level: warpqem.SimplifiedMesh) -> float:
    points, faces, _ = head_of_2000()
    return compare(points, faces, level.points, level.faces, samples=4000).rms


@pytest.mark.parametrize("face_count", LEVELS)
def test_all_points_survive_by_equation_one_alone(face_count: int) -> None:
    points, faces, features = head_of_2000()
    unpinned = level_of(face_count, keep=False)
    plain = warpqem.simplify(points, faces, target_faces=face_count, metric="qem")
    assert face_count - 1 <= len(unpinned.faces) <= face_count
    assert survivors(unpinned) >= len(features.vertices) - 2
    assert survivors(plain) < 10


@pytest.mark.parametrize("face_count", LEVELS)
def test_the_default_keeps_every_point_at_no_more_error(face_count: int) -> None:
    level = level_of(face_count)
    assert survivors(level) == len(head_of_2000()[2].vertices)
    assert rms(level) <= rms(level_of(face_count, keep=False)) * 1.0001


def test_points_that_are_kept_are_there_where_weights_alone_give_way() -> None:
    points, faces = talking_head()
    features = warpqem.face.facial_features(points, faces)
    levels = [
        warpqem.simplify(
            points, faces, target_faces=220, metric="face", face=FaceProtection(features, weight=10.0, keep=keep)
        )
        for keep in (True, False)
    ]
    near = [np.linalg.norm(x.points[0][:, None] - points[0, features.indices], axis=2).min(axis=0) for x in levels]
    assert (near[0] < 1e-5).all()
    assert (near[1] > 0.01 * FACE_HEIGHT).any()


def test_larger_rings_hold_longer() -> None:
    points, faces = talking_head()
    features = warpqem.face.facial_features(points, faces)
    kept = []
    for ring in (0, 1, 2):
        face = FaceProtection(features, weight=10.0, ring=ring, keep=False)
        level = warpqem.simplify(points, faces, ratio=0.1, metric="face", face=face)
        gaps = np.linalg.norm(level.points[0][:, None] - points[0, features.indices], axis=2).min(axis=0)
        kept.append(int((gaps <= 0.01 * FACE_HEIGHT).sum()))
    assert kept[0] < kept[1] < kept[2]


def test_a_symmetric_face_keeps_its_points_on_both_sides() -> None:
    points, faces, features = mirrored_face()
    level = simplify_symmetric(points, faces, "x", ratio=0.2, metric="face", face=FaceProtection(features, keep=False))
    for vertex in features.indices:
        for side in ((1.0, 1.0, 1.0), (-1.0, 1.0, 1.0)):
            gap = np.linalg.norm(level.points[0] - points[0, vertex] * side, axis=1).min()
            assert gap < 1e-5


def mirrored_face() -> tuple[NDArray[np.float32], NDArray[np.int32], FacialFeatures]:
    """A sheet with bumps that is its own mirror image across x, with a point off the plane and one on it."""
    x, y = np.meshgrid(np.linspace(-1.0, 1.0, 21), np.linspace(-1.0, 1.0, 21))
    z = 0.2 * np.cos(4.0 * x) * np.cos(3.0 * y + 1.0)
    points = np.stack([x, y, z], axis=2).reshape(1, -1, 3).astype(np.float32)
    corner = (np.arange(20)[:, None] * 21 + np.arange(20)).ravel()
    right = (corner % 21) >= 10
    a, b, c, d = corner, corner + 1, corner + 22, corner + 21
    one = np.where(right[:, None], np.stack([a, b, c], axis=1), np.stack([a, b, d], axis=1))
    two = np.where(right[:, None], np.stack([a, c, d], axis=1), np.stack([b, c, d], axis=1))
    names = {"mouth_corner_left": 5 * 21 + 15, "chin": 3 * 21 + 10}
    features = FacialFeatures(names, dict.fromkeys(names, 1.0), {}, np.eye(3))
    return points, np.concatenate([one, two]).astype(np.int32), features


def test_points_are_found_where_none_are_given() -> None:
    points, faces = talking_head()
    features = warpqem.face.facial_features(points[:1], faces)
    level = warpqem.simplify(points[:1], faces, target_faces=9000, metric="face")
    kept = points[:1, features.indices]
    np.testing.assert_allclose(level.points[:, level.vertex_map[features.indices]], kept, atol=1e-4)


def test_rings_hold_the_neighbours_so_many_edges_away() -> None:
    # A strip of squares, two faces each: columns of two vertices.
    column = np.arange(9)[:, None] * 2
    faces = np.concatenate([column + np.array(corner) for corner in ([0, 2, 1], [1, 2, 3])])
    features = FacialFeatures({"chin": 8}, {"chin": 1.0}, {}, np.eye(3))
    # Vertex 8 is the lower one of column 4; the diagonals lead from lower right to upper left.
    for ring, expected in enumerate(([8], [6, 7, 8, 9, 10], [4, 5, 6, 7, 8, 9, 10, 11, 12])):
        sums = face_sums(faces, FaceProtection(features=features, weight=7.0, ring=ring))
        assert sums.row.tolist() == [8]
        assert sums.vertex.tolist() == expected
        # The point's own quadric counts once already.
        np.testing.assert_array_equal(sums.weight, np.where(sums.vertex == 8, 6.0, 7.0))


def test_texture_coordinates_count_beside_the_points() -> None:
    points, faces, features = head_of_2000()
    # A texture with a frequency that the shape knows nothing of.
    texture = warpqem.costs.AttributeField(np.sin(3.0 * points[0][:, :2]), weight=0.2)
    common = {"target_faces": 820, "metric": "face", "face": FaceProtection(features=features)}
    plain = warpqem.simplify(points, faces, **common)
    textured = warpqem.simplify(points, faces, attributes=[texture], **common)
    assert survivors(textured) >= 23
    assert not np.array_equal(plain.faces, textured.faces)


def test_wrong_use_is_refused() -> None:
    points, faces, features = head_of_2000()
    with pytest.raises(OptionError, match="needs metric 'face'"):
        warpqem.simplify(points, faces, ratio=0.5, face=FaceProtection(features=features))
    for weight in (0.5, float("nan"), float("inf")):
        with pytest.raises(OptionError, match="weight"):
            FaceProtection(weight=weight)
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
