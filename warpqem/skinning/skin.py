"""Linear blend skins as arrays: posing them, and blending them from one mesh to another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warpqem.errors import MeshShapeError
from warpqem.mesh_input import as_numpy
from warpqem.transfer import blend

__all__ = [
    "LinearSkin",
    "blend_influences",
    "blend_skin",
    "largest_influences",
    "normalised_weights",
    "pose_skin",
]


@dataclass(frozen=True)
class LinearSkin:
    """The skin of V points, each moved by up to K joints.

    Attributes:
        rest: (V, 3) float, the rest shape.
        joints: (V, K) int32; those with weight 0 do not count.
        weights: (V, K) float, not negative, sum 1 per point.
    """

    rest: np.ndarray
    joints: np.ndarray
    weights: np.ndarray

    def checked(self, joint_count: int) -> LinearSkin:
        """The same as contiguous float64 and int32 arrays.

        Raises:
            MeshShapeError: shapes do not go together, or a joint does not exist.
        """
        rest, joints, weights = (as_numpy(array) for array in (self.rest, self.joints, self.weights))
        if rest.ndim != 2 or rest.shape[1] != 3 or joints.ndim != 2 or joints.shape != weights.shape:
            raise MeshShapeError(
                f"a skin needs rest (V, 3), joints (V, K) and weights (V, K), got {rest.shape}, {joints.shape} and "
                f"{weights.shape}"
            )
        if len(rest) != len(joints):
            raise MeshShapeError(f"the skin has {len(rest)} rest points and joints of {len(joints)}")
        if joints.dtype.kind not in "iu" or weights.dtype.kind != "f":
            raise MeshShapeError(f"joints must be int and weights float, got {joints.dtype} and {weights.dtype}")
        if not (weights >= 0).all():
            vertex, influence = np.argwhere(~(weights >= 0))[0]
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


def pose_skin(skin: LinearSkin, transforms: np.ndarray, offsets: np.ndarray | None = None) -> np.ndarray:
    """The points of a skin in P poses, (P, V, 3) float64.

    Args:
        skin: the skin.
        transforms: (P, J, 3, 4) float, what each joint does to rest points, as columns: ``M[:, :3] x + M[:, 3]``.
        offsets: (P, V, 3), added to the rest points first, as blend shapes do; None for none.
    """
    skin = skin.checked(transforms.shape[1])
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
