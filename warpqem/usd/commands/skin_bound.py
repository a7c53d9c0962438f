"""Limits on the distance of skinned meshes, which hold for what the skin makes of the simplified mesh in each pose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from warpqem.arguments.distance_limit import DistanceLimit
from warpqem.frames.blocks import frame_blocks
from warpqem.frames.stream import FrameSource, NoFrames, SomeFrames, read_ahead
from warpqem.mesh.mesh_input import read_mesh
from warpqem.pipeline.bound_sink import BoundSink, ExceededError
from warpqem.pipeline.result import SimplifiedMesh
from warpqem.runtime.device import device_turn
from warpqem.skinning.linear_skin import LinearSkin, pose_skin
from warpqem.usd.commands.mesh_job import MeshJob
from warpqem.usd.commands.skin_fit import FittedMesh, SkinPoses
from warpqem.usd.read.skin_poses import joint_transforms, shape_offsets
from warpqem.usd.write.attribute_transfer import AttributeTransfer
from warpqem.usd.write.skin_output import blend_influences

__all__ = [
    "MAX_STEPS",
    "STEP",
    "Attempt",
    "SkinnedFrames",
    "interpolated",
    "is_within",
    "largest_diagonal",
    "simplify_skinned",
    "skin_holds",
]

# What the skin leaves of a limit is not known before: each step leaves so much of it for the surface, until it holds.
STEP = 0.7
# After so many steps, at a tenth of the limit, it is the skin itself that does not hold.
MAX_STEPS = 7


@dataclass(frozen=True)
class Attempt:
    """A mesh that was simplified by a share of the limit, and its skin.

    Attributes:
        mesh: the mesh.
        fitted: its skin, of the fewest joints with which the limit holds; else of all. None for one to interpolate.
        holds: whether the limit holds.
        reached: whether it does with the joints that are asked for.
        hopeless: whether these are so far off that no mesh holds it with them.
    """

    mesh: SimplifiedMesh
    fitted: FittedMesh | None
    holds: bool = True
    reached: bool = True
    hopeless: bool = False

    @property
    def joint_count(self) -> int:
        """Joints that are left; 0 where it is not known."""
        return 0 if self.fitted is None or self.fitted.joints is None else self.fitted.joints.after


class SkinnedFrames:
    """A simplified mesh in all poses, as its skin has it: a :class:`warpqem.FrameSource`.

    Args:
        poses: the mesh in its poses.
        fitted: the skin.
        transfer: where the simplified mesh gets its values from.
    """

    def __init__(self, poses: SkinPoses, fitted: FittedMesh, transfer: AttributeTransfer) -> None:
        self._poses, self._rows = poses, transfer.vertices()
        rest = poses.fit.apply(fitted.rest_points.astype(np.float64))
        self._skin = LinearSkin(rest, fitted.influences.joints, fitted.influences.weights)
        self.frame_count, self.vertex_count = len(poses.all_codes), len(rest)
        self.dtype = np.dtype(np.float32)

    def read(self, frames: slice) -> npt.NDArray[np.float32]:
        """Consecutive poses."""
        poses = self._poses
        codes = poses.all_codes[frames]
        transforms = poses.fit.moved(joint_transforms(poses.poser, codes))
        assert poses.job.skin is not None
        shapes = shape_offsets(poses.poser, poses.job.skin.rest_points, codes)
        offsets = None
        if shapes is not None:
            offsets = np.stack([self._rows.blend(shape) for shape in shapes]) * np.float32(poses.fit.scale)
        return pose_skin(self._skin, transforms, offsets).astype(np.float32)


def interpolated(poses: SkinPoses, result: SimplifiedMesh, transfer: AttributeTransfer) -> FittedMesh:
    """The skin whose influences are blended from the input's."""
    assert poses.job.skin is not None
    influences = blend_influences(poses.influences, transfer.vertices(), poses.job.skin.influence_limit)
    return FittedMesh(poses.job.rest_shape(result)[0], influences)


def largest_diagonal(job: MeshJob) -> float:
    """Largest bounding-box diagonal of a frame, in local units."""
    blocks = read_ahead(job.frames.read, frame_blocks(job.frames.frame_count, job.frames.vertex_count))
    return max(float(np.linalg.norm(np.ptp(points.astype(np.float64), axis=1), axis=1).max()) for _, points in blocks)


def is_within(
    reference: FrameSource,
    reference_faces: npt.NDArray[np.int32],
    test: FrameSource,
    test_faces: npt.NDArray[np.int32],
    limit: DistanceLimit,
    diagonal: float,
    device: str | None,
) -> bool:
    """Whether two meshes are proved to be within a limit of each other in all frames that count."""
    with device_turn(device) as used:
        bound = BoundSink(NoFrames(), read_mesh(reference, reference_faces), limit, diagonal, used)
    bound.begin(test.frame_count, test.vertex_count, test_faces)
    largest = max(reference.vertex_count, test.vertex_count)
    try:
        for frames, points in read_ahead(test.read, frame_blocks(test.frame_count, largest)):
            bound.write(frames, points)
    except ExceededError:
        return False
    return True


def skin_holds(
    poses: SkinPoses,
    result: SimplifiedMesh,
    fitted: FittedMesh,
    transfer: AttributeTransfer,
    limit: DistanceLimit,
    device: str | None,
) -> bool:
    """Whether a simplified mesh is within a limit of the input in all poses, as its skin has it."""
    job = poses.job
    reference = SomeFrames(job.frames, job.pose_start, job.frames.frame_count)
    test = SkinnedFrames(poses, fitted, transfer)
    return is_within(reference, job.faces, test, result.faces, limit, largest_diagonal(job), device)


def simplify_skinned(
    simplify: Callable[[float], SimplifiedMesh], attempt: Callable[[SimplifiedMesh], Attempt]
) -> Attempt:
    """Simplify by smaller and smaller shares of a limit, until what the skin makes of the result holds the whole.

    Args:
        simplify: gets the share.
        attempt: finds the skin of a result; called once for each.
    """
    share = 1.0
    for _ in range(MAX_STEPS):
        done = attempt(simplify(share))
        if done.holds:
            break
        share *= STEP
    return done
