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
from warpqem.usd.commands.rig_steps import Place, Rig
from warpqem.usd.commands.skin_fit import FittedMesh, SkinPoses
from warpqem.usd.read.skin_poses import joint_transforms, shape_offsets, whole_transforms
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
# So often the last step is halved between what held and what did not: a step of its own costs a third of the faces.
HALVINGS = 2


@dataclass(frozen=True)
class Attempt:
    """A mesh that was simplified by a share of the limit, and what moves it.

    Attributes:
        mesh: the mesh.
        rig: its skin and blend shapes, as little as the limit leaves; all of them where it does not hold.
        holds: whether the limit holds.
        place: steps that it takes to that from what is asked for.
        hopeless: whether that is so far off that no mesh holds it.
    """

    mesh: SimplifiedMesh
    rig: Rig
    holds: bool = True
    place: Place = (0, 0, 0)
    hopeless: bool = False

    @property
    def reached(self) -> bool:
        """Whether the limit holds with as little as is asked for."""
        return self.holds and self.place == (0, 0, 0)


class SkinnedFrames:
    """A simplified mesh in all poses, as its rig has it: a :class:`warpqem.FrameSource`.

    Args:
        poses: the mesh in its poses.
        result: the mesh.
        rig: its skin and blend shapes.
        transfer: where the simplified mesh gets its values from.
    """

    def __init__(self, poses: SkinPoses, result: SimplifiedMesh, rig: Rig, transfer: AttributeTransfer) -> None:
        self._poses, self._rows, self._shapes = poses, transfer.vertices(), rig.shapes
        fitted = rig.fitted
        points = poses.job.rest_shape(result)[0] if fitted is None else fitted.rest_points
        rest = poses.fit.apply(points.astype(np.float64))
        if fitted is None:
            # One joint moves all.
            self._skin = LinearSkin(rest, np.zeros((len(rest), 1), dtype=np.int32), np.ones((len(rest), 1)))
        else:
            self._skin = LinearSkin(rest, fitted.influences.joints, fitted.influences.weights)
        self._transforms = whole_transforms if fitted is None else joint_transforms
        self.frame_count, self.vertex_count = len(poses.all_codes), len(rest)
        self.dtype = np.dtype(np.float32)

    def read(self, frames: slice) -> npt.NDArray[np.float32]:
        """Consecutive poses."""
        poses = self._poses
        codes = poses.all_codes[frames]
        transforms = poses.fit.moved(self._transforms(poses.poser, codes))
        assert poses.job.skin is not None
        changed = None if self._shapes is None else self._shapes.changed
        shapes = shape_offsets(poses.poser, poses.job.skin.rest_points, codes, changed)
        offsets = None
        if shapes is not None:
            offsets = np.stack([self._rows.blend(shape) for shape in shapes]) * np.float32(poses.fit.scale)
        return pose_skin(self._skin, transforms, offsets).astype(np.float32)


def interpolated(poses: SkinPoses, result: SimplifiedMesh, transfer: AttributeTransfer, most: int | None) -> FittedMesh:
    """The skin whose influences are blended from the input's, at most so many a point; None for as many as there."""
    influences = blend_influences(poses.influences, transfer.vertices(), most)
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
    rig: Rig,
    transfer: AttributeTransfer,
    limit: DistanceLimit,
    diagonal: float,
    device: str | None,
) -> bool:
    """Whether a simplified mesh is within a limit of the input in all poses, as its rig has it."""
    job = poses.job
    reference = SomeFrames(job.frames, job.pose_start, job.frames.frame_count)
    test = SkinnedFrames(poses, result, rig, transfer)
    return is_within(reference, job.faces, test, result.faces, limit, diagonal, device)


def simplify_skinned(
    simplify: Callable[[float], SimplifiedMesh], attempt: Callable[[SimplifiedMesh], Attempt]
) -> Attempt:
    """Simplify by smaller and smaller shares of a limit, until what the skin makes of the result holds the whole.

    Args:
        simplify: gets the share; what takes the frames keeps those of the last call, which are those of the result.
        attempt: finds the rig of a result; called once for each.
    """
    share, beyond = 1.0, 0.0
    for _ in range(MAX_STEPS):
        done = attempt(simplify(share))
        if done.holds:
            break
        share, beyond = share * STEP, share
    if not done.holds or not beyond:
        return done
    tried = share
    for _ in range(HALVINGS):
        tried = (share + beyond) / 2
        finer = attempt(simplify(tried))
        if finer.holds and len(finer.mesh.faces) < len(done.mesh.faces):
            done, share = finer, tried
        else:
            beyond = tried
    if tried != share:
        simplify(share)
    return done
