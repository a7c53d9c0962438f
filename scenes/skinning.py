"""Skeletons, poses and linear blend skinning in NumPy. Column vectors; quaternions are (w, x, y, z)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray


def quaternion(axis: ArrayLike, degrees: ArrayLike) -> NDArray[np.float64]:
    """Return unit quaternions ``(..., 4)`` of turns about the unit `axis` ``(3,)`` by `degrees` ``(...)``."""
    half = np.radians(np.asarray(degrees, float)) / 2.0
    return np.concatenate([np.cos(half)[..., None], np.sin(half)[..., None] * np.asarray(axis, float)], axis=-1)


def multiply_quaternions(a: NDArray, b: NDArray) -> NDArray[np.float64]:
    """Return the Hamilton product of quaternions ``(..., 4)``: the turn `b` followed by the turn `a`."""
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    parts = (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )
    return np.stack(parts, axis=-1)


def rotation_matrix(q: NDArray) -> NDArray[np.float64]:
    """Return the rotation matrices ``(..., 3, 3)`` of unit quaternions ``(..., 4)``."""
    w, x, y, z = np.moveaxis(np.asarray(q, float), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


@dataclass(frozen=True)
class JointPoses:
    """Transforms of J joints relative to their parents in F frames.

    `translations` ``(F, J, 3)`` float32, `rotations` ``(F, J, 4)`` float32 unit quaternions (w, x, y, z).
    """

    translations: NDArray[np.float32]
    rotations: NDArray[np.float32]


@dataclass(frozen=True)
class Skeleton:
    """Joints in an order in which parents come first.

    `names` are unique; `parents` ``(J,)`` holds -1 for the root; `rest` is the rest pose as one frame of `JointPoses`
    and is the bind pose as well.
    """

    names: tuple[str, ...]
    parents: NDArray[np.int32]
    rest: JointPoses

    def paths(self) -> list[str]:
        """Return the joint paths, as ``root/child/grandchild``."""
        paths: list[str] = []
        for name, parent in zip(self.names, self.parents, strict=True):
            paths.append(name if parent < 0 else f"{paths[parent]}/{name}")
        return paths

    def rest_matrices(self) -> NDArray[np.float64]:
        """Return the rest transforms relative to the parents, ``(J, 4, 4)``."""
        return _matrices(self.rest)[0]

    def world(self, poses: JointPoses) -> NDArray[np.float64]:
        """Return the transforms of the joints in skeleton space, ``(F, J, 4, 4)``."""
        world = _matrices(poses)
        for joint, parent in enumerate(self.parents):
            if parent >= 0:
                world[:, joint] = world[:, parent] @ world[:, joint]
        return world

    def bind(self) -> NDArray[np.float64]:
        """Return the bind transforms in skeleton space, ``(J, 4, 4)``."""
        return self.world(self.rest)[0]


def _matrices(poses: JointPoses) -> NDArray[np.float64]:
    matrices = np.zeros((*poses.rotations.shape[:2], 4, 4))
    matrices[..., :3, :3] = rotation_matrix(poses.rotations)
    matrices[..., :3, 3] = poses.translations
    matrices[..., 3, 3] = 1.0
    return matrices


def skin(
    points: NDArray, skeleton: Skeleton, poses: JointPoses, joint_indices: NDArray, joint_weights: NDArray
) -> NDArray[np.float64]:
    """Return `points` ``(F, V, 3)`` of the bind pose carried by the poses with linear blend skinning, ``(F, V, 3)``."""
    motion = skeleton.world(poses) @ np.linalg.inv(skeleton.bind())
    moved = np.zeros(points.shape)
    for slot in range(joint_indices.shape[1]):
        transferred = motion[:, joint_indices[:, slot]]
        part = np.einsum("fvij,fvj->fvi", transferred[..., :3, :3], points) + transferred[..., :3, 3]
        moved += joint_weights[None, :, slot, None] * part
    return moved
