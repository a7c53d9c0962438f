"""One pass over the meshes of a stage: each is read, simplified and written into a layer of edits."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom

import warpqem
from warpqem.cost_models import cost_model
from warpqem.distance_limit import DistanceLimit
from warpqem.errors import (
    DeviceError,
    MeshShapeError,
    OptionError,
    StageError,
    UnreachableTargetError,
    VaryingTopologyError,
    WarpqemError,
)
from warpqem.frame_stream import LaterFrames, NoFrames
from warpqem.memory import parse_bytes
from warpqem.options import target_count
from warpqem.symmetry import Mirror, find_mirror, simplify_symmetric
from warpqem.transfer import is_proper
from warpqem.usd.attributes import check_names, weighted_fields
from warpqem.usd.blend_shapes import count_shape_users
from warpqem.usd.context import Context, Progress, SharedOrder
from warpqem.usd.example_poses import ExamplePoses
from warpqem.usd.face_points import FacePoints, face_protection, points_on_level
from warpqem.usd.feature_subsets import write_feature_points
from warpqem.usd.inheritors import heirs_first
from warpqem.usd.job import MeshJob, ReadOptions
from warpqem.usd.lengths import parse_length
from warpqem.usd.measuring import measure_written, written_within
from warpqem.usd.mesh import MeshSource
from warpqem.usd.morph import check_morph, morph_scale
from warpqem.usd.odd_values import find_odd_values
from warpqem.usd.point_samples import PointSamples
from warpqem.usd.report import PrimReport, StageReport, name_prim
from warpqem.usd.skel import StagePoses
from warpqem.usd.skin_bound import interpolated, largest_diagonal, simplify_skinned, skin_holds
from warpqem.usd.skin_fit import FittedMesh, SkinFitter, SkinPoses, simplify_by_pullback, why_not_fitted
from warpqem.usd.stage_budget import simplify_to_budget
from warpqem.usd.usd_errors import usd_errors_named
from warpqem.usd.varying import simplify_runs
from warpqem.usd.weights import check_weight_primvar, painted_options
from warpqem.usd.write import OverLayer

__all__ = ["Run"]

# Triangles that a ratio leaves of a mesh at least: one alone is half of the smallest card.
LEAST_FACES = 2
# What a mesh is at, in the words of the core's progress, for the message of an error that nobody expected.
STEPS = {"read": "reading its frames", "order": "collapsing edges", "place": "placing vertices"}

Result = TypeVar("Result")


class Run:
    """One pass over the meshes of a stage, into one layer."""

    def __init__(self, context: Context, by_root: bool = False) -> None:
        """Start.

        Args:
            context: What all passes share.
            by_root: Keep the edits of what is below a root prim below it.
        """
        self.context, self.options = context, context.options
        self.stage, self.selection = context.stage, context.selection
        self.progress, self.announce, self.share = context.progress, context.announce, context.share
        self.by_root = by_root
        self.poses = StagePoses(self.stage)
        self.examples = None if self.options.poses is None else ExamplePoses(self.stage, self.options.poses)
        self.shape_users = count_shape_users(self.stage)
        self.layer = OverLayer(self.stage, context.folder)
        context.cleanup.callback(self.layer.close)
        self.reports: dict[str, PrimReport] = {}
        self.notes: list[str] = []
        # What the mesh at work is at.
        self.step = ""
        self.face_points: FacePoints | None = None
        self.faces: dict[str, warpqem.FaceProtection] = {}

    def simplify(self) -> None:
        """Simplify all meshes into the layer."""
        prims = self.select()
        if self.options.faces is None:
            for index, prim in enumerate(prims):
                self.simplify_one(prim, self.part(index / len(prims), 1 / len(prims), prim))
        else:
            simplify_to_budget(self, prims, self.options.faces)
        self.finish()
        self.progress(1.0, "done")

    def finish(self) -> None:
        """Give the edits of meshes below instances to all instances of them; to be called once, after all meshes."""
        self.notes = self.layer.share_instances(self.selection, self.by_root)

    @property
    def kept_whole(self) -> str:
        """Why a mesh keeps all its faces although fewer were asked for."""
        return f"nothing could be removed with an error below {self.options.max_size_error:g} % of its size"

    def report(self) -> StageReport:
        """What happened to each mesh."""
        # In a flat file instances refer to their prototypes as those are.
        return StageReport("", None, list(self.reports.values()), notes=[] if self.options.flatten else self.notes)

    def select(self) -> list[Usd.Prim]:
        """The meshes to be simplified, each with a report."""
        selection = self.selection
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
        for path, lacking in selection.empty:
            self.reports[path] = PrimReport(path, "kept", message=f"no geometry: no value of {lacking}")
        return heirs_first(selection.prims)

    def simplify_one(self, prim: Usd.Prim, progress: Progress, shared: SharedOrder | None = None) -> None:
        """Simplify one mesh into the layer."""
        self.guarded(self._simplify_prim, prim, progress, None, shared)

    def part(self, start: float, share: float, prim: Usd.Prim, level: str = "") -> Progress:
        """Progress of one mesh as a part of the whole."""

        def show(fraction: float, text: str) -> None:
            self.step = STEPS.get(text, text)
            self.progress(start + share * fraction, f"{level}{prim.GetName()}: {text}")

        return show

    def guarded(self, action: Callable[..., Result], prim: Usd.Prim, *arguments: Any) -> Result | None:
        """Do something for a mesh; an error becomes its report, and None is returned, unless the run is strict."""
        report = self.reports[str(prim.GetPath())]
        start = time.perf_counter()
        self.step = "reading the mesh"
        try:
            return action(prim, *arguments)
        except MemoryError as error:
            if not isinstance(error, WarpqemError):
                raise
            return self._failed(report, name_prim(report.path, error), error)
        except WarpqemError as error:
            # A wrong option or device is no fault of this mesh.
            if isinstance(error, (OptionError, DeviceError)):
                raise
            return self._failed(report, name_prim(report.path, error), error)
        except Exception as error:
            # Not meant to happen; the other meshes of the stage have no part in it.
            self.layer.discard(report.path)
            report.faces_after, report.vertices_after = report.faces_before, report.vertices_before
            what = " ".join(f"{type(error).__name__}: {error}".split())
            return self._failed(report, f"{report.path}: unexpected error while {self.step}: {what}", error)
        finally:
            report.seconds += time.perf_counter() - start

    def _failed(self, report: PrimReport, message: str, error: Exception) -> None:
        """Note that a mesh could not be done; a strict run ends there."""
        report.status, report.message = "failed", message
        if self.options.strict:
            raise StageError(message) from error

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
        if job.repair is not None:
            report.problems += [f"{job.mesh.path}: {line}" for line in job.repair.findings.lines()]
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
        options = {**self._core_options(job), "max_size_error": self.options.size_limit}
        poses = self._skin_poses(job) if self.options.pose_independent else None
        if poses is not None:
            kept = ("attributes", "lock_borders", "keep_components", "memory", "device", "max_size_error")
            options = {name: value for name, value in options.items() if name in kept}
            return simplify_by_pullback(
                poses, **options, **self._importance(job), seams=seams, progress=progress, **goal
            )
        mirror = self._mirror(job)
        if mirror is not None:
            options |= {**self._importance(job), "seams": seams, "progress": progress}
            return simplify_symmetric(job.frames, job.faces, mirror, sink=sink, **options, **goal)
        plan = warpqem.plan(
            job.frames, job.faces, sink=sink, levels=order is not None, measure=False, **options, **goal
        )
        self.reports[job.mesh.path].plan = plan.to_dict()
        if order is None or order.order is None or not order.announced:
            self.announce(job.mesh.path, plan)
        if order is None:
            # What is measured is what the file shows.
            options |= {**self._importance(job), "seams": seams, "progress": progress, "measure": False}
            return warpqem.simplify(job.frames, job.faces, sink=sink, share=self.share, **options, **goal)
        order.announced = True
        placed = self._order(job, progress, seams, order)
        return placed.level(int(goal["target_faces"] or 0), sink=sink, share=self.share, progress=progress)

    def _core_options(self, job: MeshJob) -> dict[str, Any]:
        """Options of the core that say how a mesh is simplified."""
        return {
            **self.options.method(),
            "motion": self.options.motion,
            "attributes": weighted_fields(job.source, self.options.texture_weight, self.options.attribute_weights),
        }

    def _shares_order(self, job: MeshJob) -> bool:
        """True if levels of a mesh come from one ordering."""
        pulled_back = self.options.pose_independent and self._skin_poses(job) is not None
        return not (pulled_back or self._limits(job) or self._mirror(job) is not None)

    def _order(
        self, job: MeshJob, progress: Progress, seams: npt.NDArray[np.int32], shared: SharedOrder
    ) -> warpqem.LevelOrder:
        """The ordering that levels of a mesh share, made when it is first asked for."""
        if shared.order is None:
            shared.order = warpqem.order_levels(
                job.frames,
                job.faces,
                target_faces=shared.least(len(job.mesh.faces)),
                keep_frames=False,
                max_size_error=self.options.size_limit,
                seams=seams,
                progress=progress,
                **self._core_options(job),
                **self._importance(job),
            )
        return shared.order

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
        limits: dict[str, float] | None = None,
    ) -> warpqem.SimplifiedMesh:
        """Simplify to a face count, or to the limits or the last legal collapse before it."""
        try:
            return self._call_core(job, progress, seams, sink, order, target_faces=target_faces, **(limits or {}))
        except UnreachableTargetError as error:
            if error.result is None:
                raise
            return error.result

    def try_out(
        self, prim: Usd.Prim, progress: Progress, shared: SharedOrder, least: int
    ) -> tuple[MeshJob, warpqem.SimplifiedMesh | warpqem.LevelOrder | None]:
        """Collapse the edges of a mesh as far as they may, to learn what that costs; nothing is written.

        Args:
            prim: The mesh.
            progress: Called with the part done.
            shared: Gets the ordering, unless levels cannot share one.
            least: Faces to go down to.

        Returns:
            The mesh, and its ordering or result; None for a mesh that has no more faces.
        """
        job = self._prepare(prim, shared)
        if len(job.mesh.faces) <= least:
            return job, None
        seams = job.seams.hold()
        if self._shares_order(job):
            return job, self._order(job, progress, seams, shared)
        shared.job = None
        return job, self._as_far_as_it_goes(job, progress, seams, NoFrames(), least)

    def simplify_to(
        self,
        prim: Usd.Prim,
        progress: Progress,
        targets: Sequence[int],
        varies: bool = False,
        shared: SharedOrder | None = None,
    ) -> None:
        """Simplify a mesh to so many faces, one whose topology varies to so many in each of its runs."""
        if varies:
            simplify_runs(self, prim, progress, targets)
        else:
            self.simplify_constant(prim, progress, targets[0], shared)

    def _simplify_prim(
        self, prim: Usd.Prim, progress: Progress, target_faces: int | None, shared: SharedOrder | None = None
    ) -> None:
        try:
            self.simplify_constant(prim, progress, target_faces, shared)
        except VaryingTopologyError:
            if self.refuses_runs(prim):
                raise
            simplify_runs(self, prim, progress)

    def refuses_runs(self, prim: Usd.Prim) -> bool:
        """True of a mesh that is not to be simplified run by run if its topology varies over time."""
        # UsdSkel has one topology of a mesh that it deforms.
        return self.options.varying_topology == "refuse" or self.poses.poser(prim) is not None

    def simplify_constant(
        self, prim: Usd.Prim, progress: Progress, target_faces: int | None, shared: SharedOrder | None = None
    ) -> None:
        """Simplify a mesh with one topology into the layer.

        Raises:
            VaryingTopologyError: it has several.
            WarpqemError: it cannot be done.
        """
        job = self._prepare(prim, shared)
        report = self.reports[job.mesh.path]
        face_count = len(job.mesh.faces)
        if not face_count:
            report.status, report.message = "kept", "the mesh has no faces"
            return
        if target_faces is None and self.options.ratio is not None:
            least = 1 if self.options.size_limit is None else LEAST_FACES
            target_faces = max(target_count(self.options.ratio, face_count), least)
        if target_faces is not None and target_faces >= face_count:
            report.status, report.message = "kept", "the mesh has no more faces than asked for"
            return
        fitter = self._fitter(job, report)
        samples = self.layer.point_samples(job.mesh.path, job.written_times)
        try:
            with usd_errors_named(job.mesh.path):
                result, fitted = self._skinned_result(job, progress, fitter, samples, target_faces, shared, report)
            report.stopped = result.stopped
            if _is_simpler(job, result):
                self._write(job, samples, fitted, result, report)
                report.dropped += job.seams.let_go(job.faces, result.face_map)
                return
            report.status, report.message = "kept", f"nothing could be removed ({report.stopped})"
            if report.stopped == "max_size_error":
                report.message = self.kept_whole
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
        share: float = 1.0,
    ) -> warpqem.SimplifiedMesh:
        """The simplified mesh, within a share of the limits; ``taker`` gets its points in the poses."""
        sink: warpqem.FrameSink
        if isinstance(taker, SkinFitter):
            sink = taker
        else:
            # Of a mesh with a skin the rest shape alone is written; it is the first frame.
            sink = NoFrames() if job.skin is not None else LaterFrames(taker, job.pose_start)
        seams = job.seams.hold()
        limits = {name: share * limit for name, limit in self._limits(job).items()}
        if target_faces is None:
            return self._call_core(job, progress, seams, sink, **limits)
        if self.options.strict:
            return self._call_core(job, progress, seams, sink, shared, target_faces=target_faces, **limits)
        return self._as_far_as_it_goes(job, progress, seams, sink, target_faces, shared, limits)

    def _limits(self, job: MeshJob) -> dict[str, float]:
        """How far the result of a mesh may be from the input, as options of the core."""
        limit = self._distance_limit(job)
        limits = {"max_error": 100.0 * limit.part, "max_distance": limit.length}
        if self.options.pose_independent and limit:
            # The errors of pulled back quadrics are parts of the diagonal.
            limits = {"max_error": 100.0 * limit.relative(largest_diagonal(job))}
        return {name: value for name, value in limits.items() if np.isfinite(value)}

    def _distance_limit(self, job: MeshJob) -> DistanceLimit:
        """How far the result of a mesh may be from the input."""
        lengths = []
        if self.options.screen is not None:
            lengths.append(self.options.screen.length)
        if self.options.max_distance is not None:
            lengths.append(parse_length(self.options.max_distance, UsdGeom.GetStageMetersPerUnit(self.stage)))
        part = np.inf if self.options.max_error is None else self.options.max_error / 100.0
        return DistanceLimit(part, min(lengths) / job.mesh.world_scale if lengths else np.inf)

    def _skinned_result(
        self,
        job: MeshJob,
        progress: Progress,
        fitter: SkinFitter | None,
        samples: PointSamples,
        target_faces: int | None,
        shared: SharedOrder | None,
        report: PrimReport,
    ) -> tuple[warpqem.SimplifiedMesh, FittedMesh | None]:
        """The simplified mesh and its skin, which holds the limits where it is linear; None for one to interpolate."""
        limit, fitted = self._distance_limit(job), None
        poses = self._skin_poses(job) if limit and fitter is None else None if fitter is None else fitter.poses

        def simplify(share: float) -> warpqem.SimplifiedMesh:
            return self._result(job, progress, fitter or samples, target_faces, shared, share)

        def holds(result: warpqem.SimplifiedMesh) -> bool:
            nonlocal fitted, fitter
            if poses is None or not _is_simpler(job, result):
                return True
            carrier = job.carrier(result, self.options.device)
            if fitter is not None:
                try:
                    fitted = fitter.fit(result, carrier, self.options.refits, self.options.device)
                except MeshShapeError as error:
                    # What UsdSkel makes of the skin is not what its arrays say.
                    report.skin, fitted = f"interpolated: {error}", None
                    return True
            elif limit:
                fitted = interpolated(poses, result, carrier)
            return not limit or fitted is None or skin_holds(poses, result, fitted, carrier, limit, self.options.device)

        return simplify_skinned(simplify, holds), fitted

    def _write(
        self,
        job: MeshJob,
        samples: PointSamples,
        fitted: FittedMesh | None,
        result: warpqem.SimplifiedMesh,
        report: PrimReport,
    ) -> None:
        self.step = "writing the simplified mesh"
        carrier = job.carrier(result, self.options.device)
        protection = self._face(job).get("face")
        carrier.feature_points = points_on_level(job, protection, result.vertex_map)
        skin = job.skin
        if skin is not None:
            rest = job.rest_shape(result)
            if fitted is not None:
                skin, rest = replace(skin, fitted=fitted.influences), fitted.rest_points[None]
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
        if self.options.bake:
            # What was asked for is no loss.
            report.dropped = [name for name in report.dropped if not name.startswith("skin binding")]
        unused = job.source.point_count - len(job.mesh.used_points)
        if unused:
            report.dropped.append(f"{unused} point{'s' if unused > 1 else ''} that no face uses")
        if result.components_removed:
            report.dropped.append(f"{result.components_removed} small components of the surface")
        report.components_removed = result.components_removed
        report.faces_after = len(result.faces)
        report.vertices_after = result.points.shape[1]
        report.estimate = float(result.error)
        limit = self._distance_limit(job)
        if skin is not None and limit:
            self.step = "proving the limit"
            if not written_within(job, self.layer.stage, limit, self.options.device):
                report.problems.append(f"{job.mesh.path}: {limit}: not proved for the skin as it is written")
        if self.options.measure:
            measure_written(job, self.layer.stage, report, self.options.device)


def _is_simpler(job: MeshJob, result: warpqem.SimplifiedMesh) -> bool:
    """Whether anything was removed."""
    return len(result.log) > 0 or len(result.faces) < len(job.mesh.faces)
