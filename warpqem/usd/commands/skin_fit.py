"""Fit the skin of a simplified mesh to its poses, see `warpqem.skinning.fit_skin`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Usd

from warpqem.frames.blocks import frame_blocks
from warpqem.frames.stream import SomeFrames
from warpqem.mesh.mesh_input import read_mesh
from warpqem.pipeline.key_frames import KeyFrameChoice
from warpqem.pipeline.result import SimplifiedMesh
from warpqem.skinning.fit_skin import fit_skin
from warpqem.skinning.linear_skin import LinearSkin
from warpqem.skinning.reduce_joints import JointGoals, ReducedJoints, RemovalPlan, reduce_in_steps
from warpqem.skinning.rest_pose_quadrics import simplify_pulled_back
from warpqem.usd.commands.mesh_job import MeshJob, RestFit
from warpqem.usd.commands.simplify_options import SimplifyOptions
from warpqem.usd.read.mesh_skin import Influences, Skin
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.skeleton_poses import MeshPoser
from warpqem.usd.read.skin_poses import (
    is_linear,
    joint_names,
    joint_parents,
    joint_transforms,
    repeated_joint,
    shape_offsets,
)
from warpqem.usd.write.attribute_transfer import AttributeTransfer
from warpqem.usd.write.skin_output import blend_influences
from warpqem.usd.write.stage_report import JointsReport

__all__ = [
    "FittedMesh",
    "SkinFitter",
    "SkinPoses",
    "has_linear_skin",
    "simplify_by_pullback",
    "skin_poses",
    "why_not_fitted",
]

# Poses that a skin is fitted to at most, far apart. More of them changed nothing that could be measured.
MAX_POSES = 32
# Weights as exporters round them, to eight bits, sum to one within this.
SUM_TOLERANCE = 0.01


@dataclass(frozen=True)
class FittedMesh:
    """The skin of a simplified mesh.

    Attributes:
        rest_points: float32, shape (V', 3), in the space of the authored points.
        influences: of these points, by the joints of the input.
        used: the joints that are left, int32, ascending, and their names; None where the order stays.
        joints: what became of the joints; None where all may stay.
    """

    rest_points: npt.NDArray[np.float32]
    influences: Influences
    used: tuple[npt.NDArray[np.int32], tuple[str, ...]] | None = None
    joints: JointsReport | None = None

    def written(self, skin: Skin) -> Skin:
        """The skin of the mesh with these influences, which count through the joints that are left."""
        if self.used is None:
            return replace(skin, fitted=self.influences)
        used, names = self.used
        place = np.zeros(int(used.max(initial=0)) + 1, dtype=np.int32)
        place[used] = np.arange(len(used))
        moved = self.influences.weights > 0
        joints = np.where(moved, place[np.where(moved, self.influences.joints, 0)], 0).astype(np.int32)
        return replace(skin, fitted=Influences(joints, self.influences.weights), joint_order=names)


def why_not_fitted(skin: Skin, poses: MeshSource) -> str | None:
    """Why the joint influences of a mesh cannot be fitted to its poses and are interpolated; None if they can be."""
    if poses.poser is None:
        return "no skeleton moves it"
    if not is_linear(poses.poser):
        return "its skinning is not linear"
    if len(skin.influences) > 1:
        return "its joint influences change over time"
    used = np.unique(poses.topology.triangles)
    weights = next(iter(skin.influences.values())).weights[used].astype(np.float64)
    if not ((weights >= 0).all() and np.abs(weights.sum(axis=1) - 1.0).max(initial=0.0) <= SUM_TOLERANCE):
        return "its joint weights do not sum to one"
    return None


class SkinPoses:
    """The poses of a mesh with a linear skin, or those of them that are farthest apart, the rest shape first.

    Args:
        job: The mesh.
        poses: The mesh in the poses of `job`.
        times: Time codes of these poses; None for one at the default time.

    Attributes:
        all_codes: Time codes of all poses.
    """

    def __init__(self, job: MeshJob, poses: MeshSource, times: list[float] | None) -> None:
        self.job, self._poses = job, poses
        self.all_codes = [Usd.TimeCode.Default()] if times is None else [Usd.TimeCode(time) for time in times]

    @cached_property
    def _chosen(self) -> npt.NDArray[np.int64]:
        return _choose_poses(self.job)

    @property
    def codes(self) -> list[Usd.TimeCode]:
        """Time codes of the chosen poses."""
        return [self.all_codes[index] for index in self._chosen]

    @property
    def frames(self) -> npt.NDArray[np.int64]:
        """The frames of `job` that the rest shape and these poses are."""
        return np.concatenate([[0], self.job.pose_start + self._chosen])

    @property
    def poser(self) -> MeshPoser:
        """What moves the mesh in these poses."""
        assert self._poses.poser is not None
        return self._poses.poser

    @property
    def fit(self) -> RestFit:
        """What makes rest points as large as the poses."""
        assert self.job.rest_fit is not None
        return self.job.rest_fit

    @property
    def influences(self) -> Influences:
        """The joint influences of the authored points."""
        assert self.job.skin is not None
        return next(iter(self.job.skin.influences.values()))

    @property
    def vertex_point(self) -> npt.NDArray[np.int64]:
        """An authored point of each vertex, shape (V,)."""
        point = np.empty(self.job.frames.vertex_count, dtype=np.int64)
        point[self.job.faces] = self.job.source.topology.triangles
        return point

    def points(self) -> npt.NDArray[np.float32]:
        """The vertices, shape (P, V, 3)."""
        return np.concatenate([self.job.frames.read(slice(frame, frame + 1)) for frame in self.frames.tolist()])

    def skin(self, rest: npt.NDArray[np.float32]) -> LinearSkin:
        """The skin of the vertices with these rest points."""
        return LinearSkin(rest, self.influences.joints[self.vertex_point], self.influences.weights[self.vertex_point])

    def transforms(self) -> npt.NDArray[np.float64]:
        """What joints do to rest points as large as the poses, shape (P, J, 3, 4)."""
        moved = self.fit.moved(joint_transforms(self.poser, self.codes))
        return np.concatenate([np.broadcast_to(np.eye(4)[:3], moved[:1].shape), moved])

    def offsets(self) -> npt.NDArray[np.float32] | None:
        """What blend shapes add to the authored rest points, as large as the poses, shape (P, points, 3)."""
        assert self.job.skin is not None
        offsets = shape_offsets(self.poser, self.job.skin.rest_points, self.codes)
        if offsets is None:
            return None
        # The rest shape is without them.
        return np.concatenate([np.zeros_like(offsets[:1]), offsets]) * np.float32(self.fit.scale)


def has_linear_skin(job: MeshJob) -> bool:
    """Whether joints of its own move every point of a mesh by a linear skin."""
    if job.skin is None or not job.skin.influences:
        return False
    return why_not_fitted(job.skin, job.examples or job.source) is None


def skin_poses(job: MeshJob, options: SimplifyOptions) -> SkinPoses:
    """The poses of a mesh that a skeleton is bound to."""
    if job.examples is not None:
        return SkinPoses(job, job.examples, job.examples.frame_times())
    return SkinPoses(job, job.source, job.source.frame_times(options.frames))


def simplify_by_pullback(poses: SkinPoses, **options: Any) -> SimplifiedMesh:
    """The rest shape simplified by the quadrics of all poses, see `warpqem.skinning.rest_pose_quadrics`."""
    points = poses.points()
    return simplify_pulled_back(points, poses.job.faces, poses.skin(points[0]), poses.transforms(), **options)


class SkinFitter:
    """Fits rest points and joint influences to poses.

    As a `warpqem.FrameSink` it keeps the simplified points of these poses.

    Attributes:
        poses: The poses.
        reduces: Whether joints are to go.
    """

    def __init__(self, poses: SkinPoses, joints: int | None = None, joint_error: float | None = None) -> None:
        """Fit to these poses of a mesh.

        Args:
            poses: The poses.
            joints: Joints that move the mesh at most; None for all.
            joint_error: What fewer joints may add, see `warpqem.skinning.reduce_joints`; None for no limit.
        """
        self.poses, self._frames = poses, poses.frames
        self._goals: JointGoals = {"joints": joints, "max_error": joint_error}
        self.reduces = joints is not None or joint_error is not None
        # Which joints go hardly depends on the mesh; how far an error limit lets them go does.
        self._plan: RemovalPlan | None = None
        self._points = np.zeros((0, 0, 3), dtype=np.float32)

    def begin(self, frame_count: int, vertex_count: int, faces: npt.NDArray[np.int32]) -> None:
        """Make room for the points of the poses."""
        self._points = np.empty((len(self._frames), vertex_count, 3), dtype=np.float32)

    def write(self, frames: slice, points: npt.NDArray[np.float32]) -> None:
        """Keep those of the frames that are wanted."""
        first, last = np.searchsorted(self._frames, [frames.start, frames.stop])
        self._points[first:last] = points[self._frames[first:last] - frames.start]

    def fit_steps(
        self,
        result: SimplifiedMesh,
        transfer: AttributeTransfer,
        most: int | None,
        device: str | None,
    ) -> list[FittedMesh]:
        """Fit skins with as few joints as may be, and with more and more up to all.

        Args:
            result: The simplified mesh, whose frames went through here.
            transfer: Where it gets its values from.
            most: Joints that move a point at most; None for as many as in the input.
            device: Warp device; None for the default.

        Raises:
            MeshShapeError: the poses are not what joints and blend shapes give.
        """
        poses, job = self.poses, self.poses.job
        rows = transfer.vertices()
        start = blend_influences(poses.influences, rows, most)
        offsets = poses.offsets()
        points = poses.points()
        given: dict[str, Any] = {
            "points": points,
            "faces": job.faces,
            "result": replace(result, points=self._points),
            "skin": poses.skin(points[0]),
            "transforms": poses.transforms(),
            "start": LinearSkin(self._points[0], start.joints, start.weights),
            "influences": most,
            "offsets": None if offsets is None else offsets[:, poses.vertex_point],
            "start_offsets": None if offsets is None else np.stack([rows.blend(offset) for offset in offsets]),
            "seams": job.seams.hold(),
            "to_planes": None,
        }
        if self.reduces:
            self._goals["parents"] = joint_parents(poses.poser)
            steps, plan = reduce_in_steps(tuple(given.values()), self._goals, device=device, plan=self._plan)
            self._plan = plan if self._goals["max_error"] is None else None
            return [self._reduced(step) for step in steps]
        fitted = fit_skin(**given, device=device)
        return [FittedMesh(poses.fit.undo(fitted.skin.rest), Influences(fitted.skin.joints, fitted.skin.weights))]

    def _reduced(self, done: ReducedJoints) -> FittedMesh:
        """The skin with fewer joints, in an order of its own where names say which joints are meant."""
        names = joint_names(self.poses.poser)
        skin = done.skin
        report = JointsReport(
            before=int(done.joint_counts[0]),
            after=len(done.used),
            removed=[names[joint] for joint in done.removed],
            heirs=[None if joint < 0 else names[joint] for joint in done.heirs],
            added_error=done.added_error,
            counts=done.joint_counts.tolist(),
            errors=done.errors.tolist(),
            influences=skin.joints.shape[1],
        )
        used = None
        if repeated_joint(self.poses.poser) is None:
            used = (done.used, tuple(names[joint] for joint in done.used))
        return FittedMesh(self.poses.fit.undo(skin.rest), Influences(skin.joints, skin.weights), used, report)


def _choose_poses(job: MeshJob) -> npt.NDArray[np.int64]:
    poses = SomeFrames(job.frames, job.pose_start, job.frames.frame_count)
    choice = KeyFrameChoice(read_mesh(poses, job.faces), MAX_POSES)
    for block in frame_blocks(poses.frame_count, poses.vertex_count):
        choice.observe(block, poses.read(block))
    return choice.choose()
