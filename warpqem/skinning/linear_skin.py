"""Linear blend skins as arrays: posing them, and blending them from one mesh to another."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from warpqem.arguments.array_input import finite_array, index_array, real_array
from warpqem.arguments.array_record import ArrayRecord
from warpqem.errors import MeshShapeError
from warpqem.frames.stream import ArrayFrames
from warpqem.mesh.blending import blend
from warpqem.mesh.mesh_input import finite_points, read_points

__all__ = [
    "LinearSkin",
    "blend_influences",
    "blend_skin",
    "largest_influences",
    "normalised_weights",
    "pose_skin",
    "read_offsets",
    "read_poses",
    "read_transforms",
]


@dataclass(frozen=True, eq=False, repr=False)
class LinearSkin(ArrayRecord):
    """The skin of V points, each moved by up to K joints.

    Attributes:
        rest: (V, 3) float, the rest shape.
        joints: (V, K) int32; those with weight 0 do not count.
        weights: (V, K) float, not negative, sum 1 per point.
    """

    rest: np.ndarray
    joints: np.ndarray
    weights: np.ndarray

    def rows(self, vertex: np.ndarray) -> LinearSkin:
        """The skin of some of the points."""
        return LinearSkin(self.rest[vertex], self.joints[vertex], self.weights[vertex])

    def checked(self, joint_count: int) -> LinearSkin:
        """The same as contiguous float64 and int32 arrays.

        Raises:
            MeshShapeError: shapes or dtypes do not go together, a joint does not exist, or a value is not finite.
        """
        rest = finite_array(self.rest, "skin.rest", ("V", 3), single=True)
        joints = index_array(self.joints, "skin.joints", ("V", "K"))
        weights = real_array(self.weights, "skin.weights", ("V", "K"))
        if joints.shape != weights.shape:
            raise MeshShapeError(
                f"a skin needs rest (V, 3), joints (V, K) and weights (V, K), got {rest.shape}, {joints.shape} and "
                f"{weights.shape}"
            )
        if len(rest) != len(joints):
            raise MeshShapeError(f"the skin has {len(rest)} rest points and joints of {len(joints)}")
        if weights.dtype.kind != "f":
            raise MeshShapeError(f"joints must be int and weights float, got {joints.dtype} and {weights.dtype}")
        wrong = ~((weights >= 0) & (weights < np.inf))
        if wrong.any():
            vertex, influence = np.argwhere(wrong)[0]
            raise MeshShapeError(f"a weight of vertex {vertex} is {weights[vertex, influence]}")
        outside = np.argwhere((weights > 0) & ((joints < 0) | (joints >= joint_count)))
        if len(outside):
            vertex, influence = outside[0]
            raise MeshShapeError(
                f"vertex {vertex} is moved by joint {joints[vertex, influence]}, but there are {joint_count} joints"
            )
        # A joint without weight may be anything.
        joints = np.where(weights > 0, joints, 0).astype(np.int32)
        return LinearSkin(rest.astype(np.float64), joints, weights.astype(np.float64))


def read_poses(points: Any) -> np.ndarray:
    """Check a mesh in P poses: (P, V, 3) float32 or float64, all finite in single precision.

    Raises:
        MeshShapeError: another shape or dtype.
        DegenerateMeshError: there is no point.
        NonFinitePointError: a point is not finite; the message names vertex and pose.
    """
    found = real_array(points, "points", ("P", "V", 3))
    frames = ArrayFrames(read_points(found, "points"))
    return finite_points(frames.read(slice(0, frames.frame_count)))


def read_transforms(transforms: Any, pose_count: int | None = None) -> np.ndarray:
    """Check what J joints do in P poses: (P, J, 3, 4) float64.

    Args:
        transforms: the argument.
        pose_count: poses P; None for any number.

    Raises:
        MeshShapeError: another shape or dtype, or a number that is not finite in single precision.
    """
    poses = "P" if pose_count is None else pose_count
    expected = f"({poses}, J, 3, 4) numbers"
    found = finite_array(transforms, "transforms", (poses, "J", 3, 4), expected=expected, single=True)
    return found.astype(np.float64)


def read_offsets(offsets: Any, name: str, pose_count: int, vertex_count: int) -> np.ndarray | None:
    """Check offsets of points in each pose, (P, V, 3); None for none.

    Raises:
        MeshShapeError: another shape or dtype, or a number that is not finite in single precision.
    """
    return None if offsets is None else finite_array(offsets, name, (pose_count, vertex_count, 3), single=True)


def pose_skin(skin: LinearSkin, transforms: Any, offsets: Any = None) -> np.ndarray:
    """The points of a skin in P poses, (P, V, 3) float64.

    Args:
        skin: the skin.
        transforms: (P, J, 3, 4) float, what each joint does to rest points, as columns: ``M[:, :3] x + M[:, 3]``.
        offsets: (P, V, 3), added to the rest points first, as blend shapes do; None for none.

    Raises:
        MeshShapeError: an array of another shape or dtype, a joint that does not exist, or a value that is not finite.
    """
    transforms = read_transforms(transforms)
    skin = skin.checked(transforms.shape[1])
    offsets = read_offsets(offsets, "offsets", len(transforms), len(skin.rest))
    poses = np.zeros((len(transforms), *skin.rest.shape))
    for index, transform in enumerate(transforms):
        rest = skin.rest if offsets is None else skin.rest + offsets[index]
        for k in range(skin.joints.shape[1]):
            matrix = transform[skin.joints[:, k]]
            moved = np.einsum("vij,vj->vi", matrix[:, :, :3], rest) + matrix[:, :, 3]
            poses[index] += skin.weights[:, k : k + 1] * moved
    return poses


def blend_influences(
    joints: np.ndarray, weights: np.ndarray, index: np.ndarray, share: np.ndarray, most: int | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Joint influences of new points: the weighted mean of the old points', its largest weights, scaled to sum one.

    Args:
        joints: (V, K) int, of the old points.
        weights: (V, K) float.
        index: (R, B) int, the old points that each new one is a blend of.
        share: (R, B) float, how much of each, sum 1.
        most: influences that a new point keeps; None for as many as an old one has.

    Returns:
        joints (R, most) int32 and weights (R, most) float64 in order of falling weight. A point without any weight
        keeps joint 0 with weight 0.
    """
    size = joints.shape[1] if most is None else most
    row_count = len(index)
    joint_count = int(joints.max(initial=0)) + 1
    weight = (share[:, :, None].astype(np.float64) * weights[index]).ravel()
    row = np.repeat(np.arange(row_count), len(weight) // max(row_count, 1))
    key, entry = np.unique(row * joint_count + joints[index].ravel(), return_inverse=True)
    total = np.bincount(entry.ravel(), weights=weight, minlength=len(key))
    return largest_influences(key // joint_count, key % joint_count, total, row_count, size)


def largest_influences(
    row: np.ndarray, joint: np.ndarray, weight: np.ndarray, row_count: int, size: int
) -> tuple[np.ndarray, np.ndarray]:
    """The ``size`` largest weights of each row, scaled to sum one: joints (R, size) int32, weights float64, falling.

    Args:
        row: (M,) int, the row of each entry.
        joint: (M,) int, no joint twice in a row.
        weight: (M,) float.
        row_count: rows R.
        size: entries that a row keeps.
    """
    order = np.lexsort((joint, -weight, row))
    row, joint, weight = row[order], joint[order], weight[order]
    rank = np.arange(len(row)) - np.searchsorted(row, row)
    kept = (rank < size) & (weight > 0)
    joints = np.zeros((row_count, size), dtype=np.int32)
    weights = np.zeros((row_count, size))
    joints[row[kept], rank[kept]] = joint[kept]
    weights[row[kept], rank[kept]] = weight[kept]
    total = weights.sum(axis=1, keepdims=True)
    return joints, np.divide(weights, total, out=np.zeros_like(weights), where=total > 0)


def normalised_weights(weights: np.ndarray) -> np.ndarray:
    """Weights (V, K) in falling order, sum one, rounded to float32 with that sum as near as it comes; zeros stay."""
    rounded = weights.astype(np.float32)
    # What rounding leaves over goes to the largest weight, where it matters least.
    has_weight = weights[:, 0] > 0
    rounded[:, 0] += np.where(has_weight, np.float32(1) - rounded.sum(axis=1, dtype=np.float32), np.float32(0))
    return rounded


def blend_skin(skin: LinearSkin, index: np.ndarray, share: np.ndarray, most: int | None = None) -> LinearSkin:
    """A skin of new points that are blends of old ones; arguments as for :func:`blend_influences`."""
    joints, weights = blend_influences(skin.joints, skin.weights, index, share, most)
    return LinearSkin(blend(skin.rest[index], share), joints, weights)
