"""One pass over the meshes of a stage: each is read, simplified and written into a layer of edits."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
from pxr import Sdf, Usd, UsdGeom

import warpqem
from warpqem.arguments import target_count
from warpqem.cost_models import cost_model
from warpqem.errors import DeviceError, MeshShapeError, OptionError, StageError, UnreachableTargetError, WarpqemError
from warpqem.frame_blocks import frame_blocks
from warpqem.frame_stream import LaterFrames, NoFrames, read_ahead
from warpqem.memory import parse_bytes
from warpqem.symmetry import Mirror, find_mirror, simplify_symmetric
from warpqem.transfer import is_proper
from warpqem.usd.attributes import check_names, weighted_fields
from warpqem.usd.blend_shapes import count_shape_users
from warpqem.usd.budget import CostCurve, split_budget
from warpqem.usd.context import Context, Progress, SharedOrder
from warpqem.usd.example_poses import ExamplePoses
from warpqem.usd.face_points import FacePoints, face_protection, points_on_level
from warpqem.usd.feature_subsets import write_feature_points
from warpqem.usd.job import MeshJob, ReadOptions
from warpqem.usd.measuring import measure_written
from warpqem.usd.mesh import MeshSource
from warpqem.usd.morph import check_morph, morph_scale
from warpqem.usd.odd_values import find_odd_values
from warpqem.usd.point_samples import PointSamples
from warpqem.usd.report import PrimReport, StageReport, name_prim
from warpqem.usd.skel import StagePoses
from warpqem.usd.skin_fit import SkinFitter, SkinPoses, simplify_by_pullback, why_not_fitted
from warpqem.usd.stage import find_meshes
from warpqem.usd.usd_errors import usd_errors_named
from warpqem.usd.weights import check_weight_primvar, painted_options
from warpqem.usd.write import OverLayer

__all__ = ["Run"]

# Faces that a trial run goes down to, or as near as it can. A closed surface has at least the 4 of a tetrahedron.
TRIAL_FACES = 4

Result = TypeVar("Result")


class Run:
    """One pass over the meshes of a stage, into one layer."""

    def __init__(self, context: Context, within: Sdf.Path = Sdf.Path.absoluteRootPath) -> None:
        self.stage, self.options = context.stage, context.options
        self.progress, self.announce, self.share = context.progress, context.announce, context.share
        self.within = within
        self.poses = StagePoses(self.stage)
        self.examples = None if self.options.poses is None else ExamplePoses(self.stage, self.options.poses)
        self.shape_users = count_shape_users(self.stage)
        self.layer = OverLayer(self.stage, context.folder)
        context.cleanup.callback(self.layer.close)
        self.reports: dict[str, PrimReport] = {}
        self.face_points: FacePoints | None = None
        self.faces: dict[str, warpqem.FaceProtection] = {}

    def simplify(self) -> None:
        """Simplify all meshes into the layer."""
        prims = self.select()
        if self.options.faces is None:
            for index, prim in enumerate(prims):
                self.simplify_one(prim, self.part(index / len(prims), 1 / len(prims), prim))
        else:
            self._run_budget(prims, self.options.faces)
        self.progress(1.0, "done")

    def report(self) -> StageReport:
        """What happened to each mesh."""
        return StageReport("", None, list(self.reports.values()))

    def select(self) -> list[Usd.Prim]:
        """The meshes to be simplified, each with a report."""
        selection = find_meshes(self.stage, self.options.prims, self.within)
        if not selection.prims and not selection.refused:
            raise StageError("there is no mesh on the stage")
        check_names(selection.prims, self.options.attribute_weights)
        check_weight_primvar(selection.prims, self.options.weight_primvar)
        check_morph(selection.prims, self.options.morph_weights, self.examples is not None)
        if self.options.face_points is not None:
            self.face_points = FacePoints.read(self.options.face_points).on_one_of(selection.prims, self.poses)
        for prim in selection.prims:
            self.reports[str(prim.GetPath())] = PrimReport(str(prim.GetPath()), "simplified")
        for path, error in selection.refused:
            if self.options.strict:
                raise error
            self.reports[path] = PrimReport(path, "failed", message=str(error))
        prims: list[Usd.Prim] = selection.prims
        return prims

    def simplify_one(self, prim: Usd.Prim, progress: Progress, shared: SharedOrder | None = None) -> None:
        """Simplify one mesh into the layer."""
        self._guarded(self._simplify_prim, prim, progress, None, shared)

    def _run_budget(self, prims: list[Usd.Prim], budget: int) -> None:
        curves: dict[Usd.Prim, CostCurve] = {}
        for index, prim in enumerate(prims):
            curve = self._guarded(self._trial, prim, self.part(0.5 * index / len(prims), 0.5 / len(prims), prim))
            if curve is not None:
                curves[prim] = curve
        targets = split_budget(list(curves.values()), budget)
        for index, (prim, target) in enumerate(zip(curves, targets, strict=True)):
            part = self.part(0.5 + 0.5 * index / len(curves), 0.5 / len(curves), prim)
            self._guarded(self._simplify_prim, prim, part, target)

    def part(self, start: float, share: float, prim: Usd.Prim, level: str = "") -> Progress:
        """Progress of one mesh as a part of the whole."""
        return lambda fraction, text: self.progress(start + share * fraction, f"{level}{prim.GetName()}: {text}")

    def _guarded(self, action: Callable[..., Result], prim: Usd.Prim, *arguments: Any) -> Result | None:
        """Do something for a mesh; an error becomes its report, and None is returned, unless the run is strict."""
        report = self.reports[str(prim.GetPath())]
        start = time.perf_counter()
        try:
            return action(prim, *arguments)
        except WarpqemError as error:
            # A wrong option or device is no fault of this mesh.
            if isinstance(error, (OptionError, DeviceError)):
                raise
            report.status = "failed"
            report.message = name_prim(report.path, error)
            if self.options.strict:
                raise StageError(report.message) from error
            return None
        finally:
            report.seconds += time.perf_counter() - start

    def _prepare(self, prim: Usd.Prim, shared: SharedOrder | None = None) -> MeshJob:
        job = None if shared is None else shared.job
        if job is None:
            with usd_errors_named(prim.GetPath(), reading=True):
                source = MeshSource(prim, self.poses)
                job = MeshJob.prepare(
                    source,
                    self._reading(),
                    shape_users=self.shape_users,
                    examples=self._examples_of(source),
                )
            if shared is not None:
                shared.job = job
        report = self.reports[job.mesh.path]
        report.frames = job.pose_count
        report.faces_before = report.faces_after = len(job.mesh.faces)
        report.vertices_before = report.vertices_after = len(job.mesh.used_points)
        with usd_errors_named(job.mesh.path, reading=True):
            report.problems = find_odd_values(job.source)
        return job

    def _reading(self) -> ReadOptions:
        options = self.options
        memory = None if options.memory is None else parse_bytes(options.memory)
        return ReadOptions(options.frames, options.bake, options.weld, options.influences, memory)

    def _examples_of(self, source: MeshSource) -> MeshSource | None:
        return None if self.examples is None else self.examples.source(source)

    def _call_core(
        self,
        job: MeshJob,
        progress: Progress,
        seams: npt.NDArray[np.int32],
        sink: warpqem.FrameSink,
        order: SharedOrder | None = None,
        **goal: float | int | None,
    ) -> warpqem.SimplifiedMesh:
        options: dict[str, Any] = {
            "metric": self.options.metric,
            "coherence": self.options.coherence,
            "refit": self.options.refit,
            "memoryless": self.options.memoryless,
            "placement": self.options.placement,
            "key_frames": self.options.key_frames,
            "motion": self.options.motion,
            "attributes": weighted_fields(job.source, self.options.texture_weight, self.options.attribute_weights),
            "memory": self.options.memory,
            "device": self.options.device,
        }
        poses = self._skin_poses(job) if self.options.pose_independent else None
        if poses is not None:
            options = {name: options[name] for name in ("attributes", "memory", "device")}
            return simplify_by_pullback(
                poses, **options, **self._importance(job), seams=seams, progress=progress, **goal
            )
        mirror = self._mirror(job)
        if mirror is not None:
            options |= {**self._importance(job), "seams": seams, "progress": progress}
            return simplify_symmetric(job.frames, job.faces, mirror, sink=sink, **options, **goal)
        plan = warpqem.plan(job.frames, job.faces, sink=sink, levels=order is not None, **options, **goal)
        self.reports[job.mesh.path].plan = plan.to_dict()
        if order is None or order.order is None:
            self.announce(job.mesh.path, plan)
            options |= {**self._importance(job), "seams": seams, "progress": progress}
        if order is None:
            # What is measured is what the file shows.
            options["measure"] = False
            return warpqem.simplify(job.frames, job.faces, sink=sink, share=self.share, **options, **goal)
        if order.order is None:
            least = target_count(order.least_ratio, len(job.mesh.faces))
            order.order = warpqem.order_levels(job.frames, job.faces, target_faces=least, keep_frames=False, **options)
        return order.order.level(int(goal["target_faces"] or 0), sink=sink, share=self.share, progress=progress)

    def _mirror(self, job: MeshJob) -> Mirror | None:
        """How a mesh that is to stay symmetric maps to itself; None for one that is not."""
        if self.options.symmetry is None:
            return None
        report, faces = self.reports[job.mesh.path], job.faces[is_proper(job.faces)]
        try:
            mirror = find_mirror(job.frames.read(slice(0, 1))[0], faces, self.options.symmetry)
        except OptionError as error:
            report.symmetry = str(error)
            return None
        report.symmetry = "kept"
        return mirror

    def _importance(self, job: MeshJob) -> dict[str, Any]:
        """Options of the core that say what matters on a mesh."""
        painted = painted_options(job, self.options.weight_primvar, self.options.weight_scales)
        scale = morph_scale(job, self.options.morph_weights, self._examples_of(job.source))
        if scale is not None:
            painted["quadric_scale"] = scale * painted.get("quadric_scale", np.ones_like(scale))
        return {
            **painted,
            "lock_borders": self.options.lock_borders,
            "keep_components": self.options.keep_components,
            **self._face(job),
        }

    def _face(self, job: MeshJob) -> dict[str, Any]:
        """How the feature points of a mesh are kept, found once for each mesh; nothing for other cost models."""
        if not cost_model(self.options.metric).keeps_face:
            return {}
        path = job.mesh.path
        if path not in self.faces:
            given = FacePoints() if self.face_points is None or self.face_points.prim != path else self.face_points
            self.faces[path] = face_protection(job, self.options, given)
        return {"face": self.faces[path]}

    def _as_far_as_it_goes(
        self,
        job: MeshJob,
        progress: Progress,
        seams: npt.NDArray[np.int32],
        sink: warpqem.FrameSink,
        target_faces: int,
        order: SharedOrder | None = None,
    ) -> warpqem.SimplifiedMesh:
        """Simplify to a face count, or to the last legal collapse before it."""
        try:
            return self._call_core(job, progress, seams, sink, order, target_faces=target_faces)
        except UnreachableTargetError as error:
            if error.result is None:
                raise
            return error.result

    def _trial(self, prim: Usd.Prim, progress: Progress) -> CostCurve:
        """How the error of a mesh grows on the way to as few faces as it can have."""
        job = self._prepare(prim)
        face_count = len(job.mesh.faces)
        if face_count <= TRIAL_FACES:
            return CostCurve(face_count, np.zeros(0), np.zeros(0, dtype=np.int64))
        result = self._as_far_as_it_goes(job, progress, job.seams.hold(), NoFrames(), TRIAL_FACES)
        return CostCurve.from_log(
            face_count=face_count,
            cost=result.log.cost,
            faces_removed=result.log.faces_removed,
            unit_length=result.diagonal * job.mesh.world_scale,
            frame_count=len(result.key_frames),
        )

    def _simplify_prim(
        self, prim: Usd.Prim, progress: Progress, target_faces: int | None, shared: SharedOrder | None = None
    ) -> None:
        job = self._prepare(prim, shared)
        report = self.reports[job.mesh.path]
        face_count = len(job.mesh.faces)
        if not face_count:
            report.status, report.message = "kept", "the mesh has no faces"
            return
        if target_faces is None and self.options.ratio is not None:
            target_faces = target_count(self.options.ratio, face_count)
        if target_faces is not None and target_faces >= face_count:
            report.status, report.message = "kept", "the mesh has no more faces than asked for"
            return
        fitter = self._fitter(job, report)
        samples = self.layer.point_samples(job.mesh.path, job.written_times)
        try:
            with usd_errors_named(job.mesh.path):
                result = self._result(job, progress, fitter or samples, target_faces, shared)
            report.stopped = result.stopped
            if len(result.log) or result.components_removed:
                self._write(job, samples, fitter, result, report)
                report.dropped += job.seams.let_go(job.faces, result.face_map)
                return
            report.status, report.message = "kept", f"nothing could be removed ({report.stopped})"
        except WarpqemError:
            samples.discard()
            raise
        samples.discard()

    def _skin_poses(self, job: MeshJob) -> SkinPoses | None:
        """The poses of a mesh with a linear skin; None for other meshes."""
        examples = self._examples_of(job.source)
        poses = examples or job.source
        if job.skin is None or not job.skin.influences or why_not_fitted(job.skin, poses) is not None:
            return None
        return SkinPoses(job, poses, poses.frame_times(self.options.frames if examples is None else None))

    def _fitter(self, job: MeshJob, report: PrimReport) -> SkinFitter | None:
        """What fits the skin of a mesh; None if it has none, or it is to be interpolated."""
        if job.skin is None or not job.skin.influences:
            return None
        wanted = self.options.skin_fit and not self.options.pose_independent
        poses = self._skin_poses(job) if wanted else None
        if poses is not None:
            report.skin = "fitted"
            return SkinFitter(poses)
        reason = why_not_fitted(job.skin, self._examples_of(job.source) or job.source) if wanted else "as asked for"
        report.skin = f"interpolated: {reason}"
        return None

    def _result(
        self,
        job: MeshJob,
        progress: Progress,
        taker: PointSamples | SkinFitter,
        target_faces: int | None,
        shared: SharedOrder | None,
    ) -> warpqem.SimplifiedMesh:
        """The simplified mesh; ``taker`` gets its points in the poses."""
        sink: warpqem.FrameSink
        if isinstance(taker, SkinFitter):
            sink = taker
        else:
            # Of a mesh with a skin the rest shape alone is written; it is the first frame.
            sink = NoFrames() if job.skin is not None else LaterFrames(taker, job.pose_start)
        seams = job.seams.hold()
        if target_faces is None:
            result = self._call_core(job, progress, seams, sink, max_error=self._error_limit(job))
        elif self.options.strict:
            result = self._call_core(job, progress, seams, sink, shared, target_faces=target_faces)
        else:
            result = self._as_far_as_it_goes(job, progress, seams, sink, target_faces, shared)
        return result

    def _error_limit(self, job: MeshJob) -> float | None:
        """Largest error of a mesh in % of its diagonal."""
        if self.options.screen is None:
            return self.options.max_error
        return 100.0 * self.options.screen.length / (_diagonal(job) * job.mesh.world_scale)

    def _write(
        self,
        job: MeshJob,
        samples: PointSamples,
        fitter: SkinFitter | None,
        result: warpqem.SimplifiedMesh,
        report: PrimReport,
    ) -> None:
        carrier = job.carrier(result, self.options.device)
        protection = self._face(job).get("face")
        carrier.feature_points = points_on_level(job, protection, result.vertex_map)
        skin = job.skin
        if skin is not None:
            rest = job.rest_shape(result)
            if fitter is not None:
                try:
                    fitted = fitter.fit(result, carrier, self.options.refit, self.options.device)
                    skin, rest = replace(skin, fitted=fitted.influences), fitted.rest_points[None]
                except MeshShapeError as error:
                    # What UsdSkel makes of the skin is not what its arrays say.
                    report.skin = f"interpolated: {error}"
            samples.begin(1, result.points.shape[1], result.faces)
            samples.write(slice(0, 1), rest)
        report.dropped = self.layer.replace_mesh(job.mesh.path, samples, job.written_times, result.faces, carrier, skin)
        mesh = UsdGeom.Mesh(self.layer.stage.GetPrimAtPath(job.mesh.path))
        write_feature_points(mesh, carrier.feature_points, create=protection is not None)
        if job.unskinned_because is not None:
            report.dropped = [
                f"{name} ({job.unskinned_because})" if name.startswith("skin binding") else name
                for name in report.dropped
            ]
        if result.components_removed:
            report.dropped.append(f"{result.components_removed} small components of the surface")
        report.components_removed = result.components_removed
        report.faces_after = len(result.faces)
        report.vertices_after = result.points.shape[1]
        report.estimate = float(result.error)
        if self.options.measure:
            measure_written(job, self.layer.stage, report, self.options.device)


def _diagonal(job: MeshJob) -> float:
    """Largest bounding-box diagonal of a frame, in local units."""
    blocks = read_ahead(job.frames.read, frame_blocks(job.frames.frame_count, job.frames.vertex_count))
    return max(float(np.linalg.norm(np.ptp(points.astype(np.float64), axis=1), axis=1).max()) for _, points in blocks)
