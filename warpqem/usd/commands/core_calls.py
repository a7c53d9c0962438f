"""Calls of the core for each mesh of a pass over a stage: options, limits, and which function is called."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import UsdGeom

import warpqem
from warpqem.arguments.distance_limit import SINGLE_PRECISION, DistanceLimit
from warpqem.costs.models import cost_model
from warpqem.errors import OptionError, UnreachableTargetError
from warpqem.frames.stream import LaterFrames, NoFrames
from warpqem.mesh.mesh_input import is_proper
from warpqem.pipeline.memory_plan import MemoryPlan
from warpqem.pipeline.mirror import Mirror, find_mirror
from warpqem.pipeline.symmetry import simplify_symmetric
from warpqem.skinning.rest_pose_quadrics import UNUSED_OPTIONS
from warpqem.usd.commands.attributes import weighted_fields
from warpqem.usd.commands.blend_shape_weights import morph_scale
from warpqem.usd.commands.context import Context, Progress, SharedOrder
from warpqem.usd.commands.face_points import FacePoints, face_protection
from warpqem.usd.commands.mesh_job import MeshJob
from warpqem.usd.commands.rig_reduction import RigReduction
from warpqem.usd.commands.skin_bound import Attempt, largest_diagonal
from warpqem.usd.commands.skin_fit import SkinFitter, has_linear_skin, simplify_by_pullback, skin_poses, why_not_fitted
from warpqem.usd.commands.skin_goals import make_fitter, whole_joints_stay
from warpqem.usd.commands.weights import painted_options
from warpqem.usd.read.lengths import parse_length
from warpqem.usd.write.point_samples import PointSamples
from warpqem.usd.write.stage_report import PrimReport

__all__ = ["CoreCalls", "part_of_limit"]

Seams = npt.NDArray[np.int32]


class CoreCalls:
    """The calls of the core for the meshes of one pass.

    Attributes:
        face_points: Feature points of a face that a file gives; None for none.
    """

    def __init__(self, context: Context, reports: dict[str, PrimReport]) -> None:
        """Start.

        Args:
            context: What all passes share.
            reports: The report on each mesh by its path, which gets the plan and how symmetry and skin are treated.
        """
        self._stage, self._options = context.stage, context.options
        self._announce, self._reports = context.announce, reports
        self.face_points: FacePoints | None = None
        self._faces: dict[str, warpqem.face.FaceProtection] = {}

    def simplify(
        self,
        job: MeshJob,
        progress: Progress,
        taker: PointSamples | SkinFitter | None,
        target_faces: int | None,
        shared: SharedOrder | None,
        share: float = 1.0,
    ) -> warpqem.SimplifiedMesh:
        """Simplify a mesh to a face count, within a share of the limits; ``taker`` gets its points in poses."""
        sink: warpqem.FrameSink
        if isinstance(taker, SkinFitter):
            sink = taker
        else:
            sink = NoFrames() if taker is None else LaterFrames(taker, job.pose_start)
        seams = job.seams.hold()
        limits: dict[str, Any] = {name: part_of_limit(name, limit, share) for name, limit in self._limits(job).items()}
        if target_faces is None:
            return self._call(job, progress, seams, sink, **limits)
        call = self._call if self._options.strict else self._as_far_as_it_goes
        return call(job, progress, seams, sink, shared, target_faces=target_faces, **limits)

    def simplify_with_rig(
        self,
        job: MeshJob,
        progress: Progress,
        fitter: SkinFitter | None,
        samples: PointSamples | None,
        target_faces: int | None,
        shared: SharedOrder | None,
        others: set[str],
    ) -> Attempt:
        """The simplified mesh and what moves it, which holds the limits where that can be known.

        Args:
            job: The mesh.
            progress: Called with the part done.
            fitter: What fits its skin; None for none.
            samples: What gets its points in poses, see `MeshJob.streams`; None where the result has them.
            target_faces: Faces to go down to; None for none.
            shared: What levels share.
            others: Names of blend shapes that other meshes take from the same animation.
        """
        limit, report = self.distance_limit(job), self._reports[job.mesh.path]
        reduction = RigReduction(job, self._options, fitter, limit, report, others)

        def simplify(share: float) -> warpqem.SimplifiedMesh:
            return self.simplify(job, progress, fitter or samples, target_faces, shared, share)

        return reduction.done(simplify)

    def try_out(
        self, job: MeshJob, progress: Progress, shared: SharedOrder, least: int
    ) -> warpqem.SimplifiedMesh | warpqem.LevelOrder:
        """Collapse the edges of a mesh down to ``least`` faces, whatever the limits, to learn what that costs.

        Returns:
            The ordering, which ``shared`` gets, too; the result where levels of the mesh cannot share one.
        """
        seams = job.seams.hold()
        if self._shares_order(job):
            return self._order(job, progress, seams, shared)
        shared.job = None
        return self._as_far_as_it_goes(job, progress, seams, NoFrames(), target_faces=least)

    def fitter(self, job: MeshJob) -> SkinFitter | None:
        """What fits the skin of a mesh; None if it has none, or it is to be interpolated."""
        report = self._reports[job.mesh.path]
        if job.skin is None or not job.skin.influences:
            report.notes += whole_joints_stay(job, self._options)
            return None
        reason: str | None = "as asked for"
        if self._options.skin_fit and not self._options.pose_independent:
            reason = why_not_fitted(job.skin, job.examples or job.source)
        if reason is None:
            report.skin = "fitted"
            fitter, notes = make_fitter(job, self._options)
            report.notes += notes
            return fitter
        report.skin = f"interpolated: {reason}"
        if self._options.reduces_joints:
            report.notes.append(f"{job.mesh.path}: all joints stay, as {reason}")
        return None

    def face(self, job: MeshJob) -> warpqem.face.FaceProtection | None:
        """How the feature points of a mesh are kept, found once for each mesh; None for other cost models."""
        if not cost_model(self._options.metric).keeps_face:
            return None
        path = job.mesh.path
        if path not in self._faces:
            given = FacePoints() if self.face_points is None or self.face_points.prim != path else self.face_points
            self._faces[path] = face_protection(job, self._options, given)
        return self._faces[path]

    def _call(
        self,
        job: MeshJob,
        progress: Progress,
        seams: Seams,
        sink: warpqem.FrameSink,
        shared: SharedOrder | None = None,
        **goal: Any,
    ) -> warpqem.SimplifiedMesh:
        options = {**self._method(job), "max_size_error": self._options.size_limit}
        if self._is_pulled_back(job):
            options = {name: value for name, value in options.items() if name not in UNUSED_OPTIONS}
            options |= {**self._importance(job), "seams": seams, "progress": progress}
            return simplify_by_pullback(skin_poses(job, self._options), **options, **goal)
        mirror = self._mirror(job)
        if mirror is not None:
            options |= {**self._importance(job), "seams": seams, "progress": progress}
            return simplify_symmetric(job.frames, job.faces, mirror, sink=sink, **options, **goal)
        if shared is None and self._announce is None:
            return self._simplify_planned(job, {**options, "seams": seams, "progress": progress, "sink": sink, **goal})
        plan = warpqem.plan(
            job.frames, job.faces, sink=sink, levels=shared is not None, measure=False, **options, **goal
        )
        plan = self._note_plan(job, plan)
        if self._announce is not None and (shared is None or shared.order is None or not shared.announced):
            self._announce(job.mesh.path, plan)
        if shared is None:
            return self._simplify_planned(job, {**options, "seams": seams, "progress": progress, "sink": sink, **goal})
        shared.announced = True
        placed = self._order(job, progress, seams, shared)
        return placed.level(int(goal["target_faces"] or 0), sink=sink, progress=progress)

    def _simplify_planned(self, job: MeshJob, options: dict[str, Any]) -> warpqem.SimplifiedMesh:
        """Simplify a mesh, and note the plan that this was done by."""
        try:
            # What is measured is what the file shows.
            result = warpqem.simplify(job.frames, job.faces, measure=False, **options, **self._importance(job))
        except UnreachableTargetError as error:
            if error.result is not None:
                self._note_plan(job, error.result.plan)
            raise
        self._note_plan(job, result.plan)
        return result

    def _note_plan(self, job: MeshJob, plan: MemoryPlan) -> MemoryPlan:
        """The plan of a mesh as its report has it: the frames of the table are those of the animation."""
        plan = replace(plan, added_poses=job.pose_start)
        self._reports[job.mesh.path].plan = plan.to_dict()
        return plan

    def _as_far_as_it_goes(
        self,
        job: MeshJob,
        progress: Progress,
        seams: Seams,
        sink: warpqem.FrameSink,
        shared: SharedOrder | None = None,
        **goal: Any,
    ) -> warpqem.SimplifiedMesh:
        """Simplify to a goal, or to the last legal collapse before it."""
        try:
            return self._call(job, progress, seams, sink, shared, **goal)
        except UnreachableTargetError as error:
            if error.result is None:
                raise
            return error.result

    def _order(self, job: MeshJob, progress: Progress, seams: Seams, shared: SharedOrder) -> warpqem.LevelOrder:
        """The decimation that levels of a mesh share, done on first use."""
        if shared.order is None:
            shared.order = warpqem.order_levels(
                job.frames,
                job.faces,
                target_faces=shared.least(len(job.mesh.faces)),
                keep_frames=False,
                max_size_error=self._options.size_limit,
                seams=seams,
                progress=progress,
                **self._method(job),
                **self._importance(job),
            )
        return shared.order

    def _shares_order(self, job: MeshJob) -> bool:
        """True if levels of a mesh come from one ordering."""
        return not (self._is_pulled_back(job) or self._limits(job) or self._mirror(job) is not None)

    def _method(self, job: MeshJob) -> dict[str, Any]:
        """Options of the core that say how a mesh is simplified."""
        return {
            **self._options.method(),
            "motion": self._options.motion,
            "attributes": weighted_fields(job.source, self._options.texture_weight, self._options.attribute_weights),
        }

    def _importance(self, job: MeshJob) -> dict[str, Any]:
        """Options of the core that say what matters on a mesh."""
        options: dict[str, Any] = painted_options(job, self._options.weight_primvar, self._options.weight_scales)
        scale = morph_scale(job, self._options.morph_weights, job.examples)
        if scale is not None:
            options["quadric_scale"] = scale * options.get("quadric_scale", np.ones_like(scale))
        face = self.face(job)
        return options if face is None else {**options, "face": face}

    def _limits(self, job: MeshJob) -> dict[str, Any]:
        """How far the result of a mesh may be from the input, as options of the core."""
        limit = self.distance_limit(job)
        limits = {"max_error": 100.0 * limit.part, "max_distance": limit.length}
        if self._options.pose_independent and limit:
            # The errors of rest-pose quadrics are parts of the diagonal.
            limits = {"max_error": 100.0 * limit.relative(largest_diagonal(job))}
        return {name: value for name, value in limits.items() if np.isfinite(value)}

    def distance_limit(self, job: MeshJob) -> DistanceLimit:
        """How far the result of a mesh may be from the input."""
        lengths = []
        if self._options.screen is not None:
            lengths.append(self._options.screen.length)
        if self._options.max_distance is not None:
            lengths.append(parse_length(self._options.max_distance, UsdGeom.GetStageMetersPerUnit(self._stage)))
        part = np.inf if self._options.max_error is None else self._options.max_error / 100.0
        return DistanceLimit(part, min(lengths) / job.mesh.world_scale if lengths else np.inf)

    def _mirror(self, job: MeshJob) -> Mirror | None:
        """How a mesh that is to stay symmetric maps to itself; None for one that is not."""
        if self._options.symmetry is None:
            return None
        report, faces = self._reports[job.mesh.path], job.faces[is_proper(job.faces)]
        try:
            mirror = find_mirror(job.frames.read(slice(0, 1))[0], faces, self._options.symmetry)
        except OptionError as error:
            report.symmetry = str(error)
            return None
        report.symmetry = "kept"
        return mirror

    def _is_pulled_back(self, job: MeshJob) -> bool:
        """True of a mesh that is simplified in its rest shape."""
        return self._options.pose_independent and has_linear_skin(job)


def part_of_limit(name: str, limit: float, share: float) -> float:
    """A share of a limit, but of one in % no less than single precision resolves, unless the limit itself is less."""
    least = 100.0 * SINGLE_PRECISION if name == "max_error" else 0.0
    return max(share * limit, min(limit, least))
