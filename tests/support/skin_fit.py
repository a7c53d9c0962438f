"""A skin to fit, its poses, and how far a fit is off."""

import numpy as np
import pytest

import warpqem
from tests.support.meshes import rotation, tube
from warpqem.measure import compare
from warpqem.skinning.linear_skin import LinearSkin, pose_skin

JOINTS = np.array([0.15, 0.4, 0.6, 0.85])


def skinned_tube() -> tuple[LinearSkin, np.ndarray]:
    """A dented tube on four joints along x, each point moved by the three nearest of them."""
    points, faces = tube(16, 40)
    points[:, 1:] *= 1 + 0.15 * np.sin(25 * points[:, :1])
    distance = np.abs(points[:, :1] - JOINTS)
    joints = np.argsort(distance, axis=1, kind="stable")[:, :3].astype(np.int32)
    weights = np.exp(-((np.take_along_axis(distance, joints, axis=1) / 0.12) ** 2))
    return LinearSkin(points, joints, weights / weights.sum(axis=1, keepdims=True)), faces


def chain(angles: np.ndarray) -> np.ndarray:
    """Transforms (P, 4, 3, 4) of a chain of joints that turn about y by ``angles`` (P, 4) and z by half of them."""
    poses = []
    for turns in angles:
        matrix, row = np.eye(4), []
        for x, angle in zip(JOINTS, turns, strict=True):
            turn = np.eye(4)
            turn[:3, :3] = rotation([0, 1, 0], angle) @ rotation([0, 0, 1], 0.5 * angle)
            turn[:3, 3] = np.array([x, 0, 0]) - turn[:3, :3] @ np.array([x, 0, 0])
            matrix = matrix @ turn
            row.append(matrix[:3])
        poses.append(row)
    return np.array(poses)


def random_poses(count: int, seed: int) -> np.ndarray:
    return chain(np.random.default_rng(seed).uniform(-0.9, 0.9, (count, 4)))


SKIN, FACES = skinned_tube()


# The rest shape is the first pose.
TRANSFORMS = np.concatenate([chain(np.zeros((1, 4))), random_poses(11, seed=1)])


POSES = pose_skin(SKIN, TRANSFORMS).astype(np.float32)


def simplified(**options: object) -> warpqem.SimplifiedMesh:
    return warpqem.simplify(POSES, FACES, **{"ratio": 0.2, "device": "cpu", **options})


@pytest.fixture(scope="module")
def result() -> warpqem.SimplifiedMesh:
    return simplified()


def error(skin: LinearSkin, result: warpqem.SimplifiedMesh, transforms: np.ndarray) -> float:
    before, after = (pose_skin(item, transforms).astype(np.float32) for item in (SKIN, skin))
    return compare(before, FACES, after, result.faces, samples=4000, device="cpu").rms
