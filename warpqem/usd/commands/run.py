"""One pass over the meshes of a stage: each is read, simplified and written into a layer of edits."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, TypeVar

from pxr import Usd

import warpqem
from warpqem.errors import CancelledError, DeviceError, OptionError, StageError, VaryingTopologyError, WarpqemError
from warpqem.options import target_count
from warpqem.runtime.cpu_kernels import compile_needed
from warpqem.runtime.device import device_traits, resolve_device
from warpqem.usd.checks.usd_errors import usd_errors_named
from warpqem.usd.commands.attributes import check_names
from warpqem.usd.commands.blend_shape_weights import check_morph
from warpqem.usd.commands.context import CORE_SHARE, Context, Progress, SharedOrder, part_of
from warpqem.usd.commands.core_calls import CoreCalls
from warpqem.usd.commands.face_points import FacePoints
from warpqem.usd.commands.kept_mesh import wanted_changes
from warpqem.usd.commands.measuring import WrittenMeasures
from warpqem.usd.commands.mesh_job import MeshJob
from warpqem.usd.commands.mesh_result import MeshResult
from warpqem.usd.commands.rig_left import changes_left
from warpqem.usd.commands.rig_options import single
from warpqem.usd.commands.small_meshes import simplify_in_groups
from warpqem.usd.commands.stage_budget import simplify_to_budget
from warpqem.usd.commands.varying import simplify_runs
from warpqem.usd.commands.weights import check_weight_primvar
from warpqem.usd.read.blend_shapes import count_shape_users
from warpqem.usd.read.example_poses import ExamplePoses
from warpqem.usd.read.inheritors import heirs_first
from warpqem.usd.read.odd_values import find_odd_values
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.skeleton_poses import StagePoses
from warpqem.usd.write.skeleton_output import reduce_skeletons
from warpqem.usd.write.stage_report import PrimReport, StageReport, name_prim
from warpqem.usd.write.write import OverLayer

__all__ = ["Run"]

# Triangles that a ratio leaves of a mesh at least: one alone is half of the smallest card.
MIN_FACES = 2
# What a mesh is at, in the words of the core's progress, for the message of an unexpected error.
STEPS = {
    "read": "reading its frames",
    "order": "collapsing edges",
    "place": "placing vertices",
    "write": "writing the simplified mesh",
    "measure": "measuring",
}
# Why a mesh is kept as it is.
NO_MORE_FACES = "the mesh has no more faces than asked for"

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
        self.progress, self.by_root = context.progress, by_root
        self.poses = StagePoses(self.stage)
        self.examples = None if self.options.poses is None else ExamplePoses(self.stage, self.options.poses)
        self.shape_users = count_shape_users(self.stage)
        self.layer = OverLayer(self.stage, context.folder)
        context.cleanup.callback(self.layer.close)
        self.reports: dict[str, PrimReport] = {}
        self._places = {str(prim.GetPath()): index for index, prim in enumerate(self.selection.prims, 1)}
        self.notes: list[str] = []
        # What the mesh at work is at.
        self.step = ""
        self.core = CoreCalls(context, self.reports)
        self._measures = WrittenMeasures(self.options.device)

    def simplify(self) -> None:
        """Simplify all meshes into the layer."""
        prims = self.select()
        device = resolve_device(self.options.device)
        if prims and device_traits(device).splits_launches:
            compile_needed(self.options.refits, self.options.measure)
        if self.options.faces is None:
            simplify_in_groups(self, prims)
        else:
            simplify_to_budget(self, prims, self.options.faces)
        self.finish()
        self.progress(1.0, "done")

    def finish(self) -> None:
        """Measure what waits, edit skeletons, and give edits below instances to all of them; once, after all meshes."""
        self.measure_waiting()
        lines = reduce_skeletons(self.layer.stage) if self.options.reduce_skeleton else []
        shared = self.layer.share_instances(self.selection, self.by_root)
        # In a flat file instances refer to their prototypes as those are.
        self.notes = lines if self.options.flatten else [*lines, *shared]

    @property
    def kept_whole(self) -> str:
        """Why a mesh keeps all its faces although fewer were asked for."""
        return f"nothing could be removed with an error below {self.options.max_size_error:g} % of its size"

    def report(self) -> StageReport:
        """What happened to each mesh."""
        return StageReport("", None, list(self.reports.values()), notes=self.notes)

    def select(self) -> list[Usd.Prim]:
        """The meshes to be simplified, each with a report."""
        selection = self.selection
        check_names(selection.prims, self.options.attribute_weights)
        check_weight_primvar(selection.prims, self.options.weight_primvar)
        check_morph(selection.prims, self.options.morph_weights, self.examples is not None)
        if self.options.face_points is not None:
            self.core.face_points = FacePoints.read(self.options.face_points).on_one_of(selection.prims, self.poses)
        for prim in selection.prims:
            self.reports[str(prim.GetPath())] = PrimReport(str(prim.GetPath()), "simplified")
        for path, error in selection.refused:
            if self.options.strict:
                raise error
            self.reports[path] = PrimReport(path, "failed", message=str(error))
        for path, lacking in selection.empty:
            self.reports[path] = PrimReport(path, "kept", message=f"no geometry: no value of {lacking}")
        return heirs_first(selection.prims)

    def simplify_one(
        self, prim: Usd.Prim, progress: Progress, shared: SharedOrder | None = None, job: MeshJob | None = None
    ) -> None:
        """Simplify one mesh into the layer; ``job`` is it where it has been read."""
        self.guarded(self._simplify_prim, prim, progress, None, shared, job)

    def part(self, start: float, share: float, prim: Usd.Prim, level: str = "") -> Progress:
        """Progress of one mesh as a part of the whole."""

        path = str(prim.GetPath())
        count, place = len(self.selection.prims), self._places.get(path, 0)
        which = f" ({place} of {count})" if count > 1 and place else ""

        def show(fraction: float, text: str) -> None:
            self.step = STEPS.get(text, text)
            report = self.reports[path]
            size = f", {report.faces_before:,} faces x {report.frames:,} frames" if report.frames else ""
            self.progress(start + share * fraction, f"{level}{prim.GetName()}{which}: {self.step}{size}")

        return show

    def guarded(self, action: Callable[..., Result], prim: Usd.Prim, *arguments: Any) -> Result | None:
        """Do something for a mesh; an error becomes its report, and None is returned, unless the run is strict."""
        found = self._guarded(action, prim, *arguments)
        if self._measures.is_full:
            self.measure_waiting()
        return found

    def measure_waiting(self) -> None:
        """Measure the small meshes that wait for each other."""

        def alone(path: str, action: Callable[[], None]) -> None:
            self._guarded(self._measure_alone, self.stage.GetPrimAtPath(path), action)

        self._measures.finish(alone)

    def _measure_alone(self, _: Usd.Prim, action: Callable[[], None]) -> None:
        self.step = STEPS["measure"]
        action()

    def _guarded(self, action: Callable[..., Result], prim: Usd.Prim, *arguments: Any) -> Result | None:
        report = self.reports[str(prim.GetPath())]
        start = time.perf_counter()
        self.step = "reading the mesh"
        try:
            return action(prim, *arguments)
        except MemoryError as error:
            if not isinstance(error, WarpqemError):
                raise
            self._failed(report, name_prim(report.path, error), error)
        except WarpqemError as error:
            # A wrong option or device, and the caller's wish to end, are no fault of this mesh.
            if isinstance(error, (OptionError, DeviceError, CancelledError)):
                raise
            self._failed(report, name_prim(report.path, error), error)
        except Exception as error:
            # Not meant to happen; the other meshes of the stage have no part in it.
            self.layer.discard(report.path)
            report.faces_after, report.vertices_after = report.faces_before, report.vertices_before
            what = " ".join(f"{type(error).__name__}: {error}".split())
            self._failed(report, f"{report.path}: unexpected error while {self.step}: {what}", error)
        finally:
            report.seconds += time.perf_counter() - start
        return None

    def _failed(self, report: PrimReport, message: str, error: Exception) -> None:
        """Note that a mesh could not be done; a strict run ends there."""
        report.status, report.message = "failed", message
        if self.options.strict:
            raise StageError(message) from error

    def read(self, prim: Usd.Prim, shared: SharedOrder | None = None) -> MeshJob:
        """Read a mesh; levels share what the first of them has read.

        Raises:
            VaryingTopologyError: it has several topologies.
            WarpqemError: it cannot be read.
        """
        job = None if shared is None else shared.job
        if job is None:
            with usd_errors_named(prim.GetPath(), reading=True):
                source = MeshSource(prim, self.poses)
                job = MeshJob.prepare(
                    source,
                    self.options,
                    shape_users=self.shape_users,
                    examples=None if self.examples is None else self.examples.source(source),
                )
            if shared is not None:
                shared.job = job
        elif job.skin is not None:
            # Levels may have limits of their own.
            job = replace(job, skin=replace(job.skin, influence_limit=single(self.options.influences)))
        report = self.reports[job.mesh.path]
        report.frames = job.pose_count
        report.faces_before = report.faces_after = len(job.mesh.faces)
        report.vertices_before = report.vertices_after = len(job.mesh.used_points)
        with usd_errors_named(job.mesh.path, reading=True):
            report.problems = find_odd_values(job.source)
        if job.repair is not None:
            report.problems += [f"{job.mesh.path}: {line}" for line in job.repair.findings.lines()]
        return job

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
        job = self.read(prim, shared)
        if len(job.mesh.faces) <= least:
            return job, None
        return job, self.core.try_out(job, progress, shared, least)

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
        self,
        prim: Usd.Prim,
        progress: Progress,
        target_faces: int | None,
        shared: SharedOrder | None = None,
        job: MeshJob | None = None,
    ) -> None:
        try:
            self.simplify_constant(prim, progress, target_faces, shared, job)
        except VaryingTopologyError:
            if self.refuses_runs(prim):
                raise
            simplify_runs(self, prim, progress)

    def refuses_runs(self, prim: Usd.Prim) -> bool:
        """True of a mesh that is not to be simplified run by run if its topology varies over time."""
        # UsdSkel has one topology of a mesh that it deforms.
        return self.options.varying_topology == "refuse" or self.poses.poser(prim) is not None

    def simplify_constant(
        self,
        prim: Usd.Prim,
        progress: Progress,
        target_faces: int | None,
        shared: SharedOrder | None = None,
        job: MeshJob | None = None,
    ) -> None:
        """Simplify a mesh with one topology into the layer; ``job`` is it where it has been read.

        Raises:
            VaryingTopologyError: it has several.
            WarpqemError: it cannot be done.
        """
        job = self.read(prim, shared) if job is None else job
        result = self.simplify_read(job, part_of(progress, 0.0, CORE_SHARE), target_faces, shared)
        if result is not None:
            self.write(result, part_of(progress, CORE_SHARE, 1.0 - CORE_SHARE))

    def simplify_read(
        self, job: MeshJob, progress: Progress, target_faces: int | None = None, shared: SharedOrder | None = None
    ) -> MeshResult | None:
        """Simplify a mesh that has been read: what is to be written; None for one that stays as it is.

        Raises:
            WarpqemError: it cannot be done.
        """
        report = self.reports[job.mesh.path]
        face_count = len(job.mesh.faces)
        if not face_count:
            report.status, report.message = "kept", "the mesh has no faces"
            return None
        if target_faces is None and self.options.ratio is not None:
            least = 1 if self.options.size_limit is None else MIN_FACES
            target_faces = max(target_count(self.options.ratio, face_count), least)
        wanted = wanted_changes(job, self.options)
        if target_faces is not None and target_faces >= face_count:
            if not wanted:
                self._keep(report, NO_MORE_FACES)
                return None
            target_faces = face_count
        fitter = self.core.fitter(job)
        samples = None
        if job.streams:
            samples = self.layer.point_samples(job.mesh.path, job.written_times, self.options.normals == "keep")
        try:
            with usd_errors_named(job.mesh.path):
                others = self.poses.shapes_of_others(job.source.prim) if self.options.reduces_shapes else set()
                done = self.core.simplify_with_rig(job, progress, fitter, samples, target_faces, shared, others)
        except WarpqemError:
            if samples is not None:
                samples.discard()
            raise
        result, wanted = done.mesh, changes_left(wanted, done.rig)
        report.stopped = result.stopped
        if wanted and not job.is_simplified_by(result):
            names = ", ".join(wanted)
            report.notes.append(f"{job.mesh.path}: keeps its faces, and is written as triangles for {names}")
        if wanted or job.is_simplified_by(result):
            return MeshResult(job, result, samples, done.rig, self.core.distance_limit(job), self.core.face(job))
        message = f"nothing could be removed ({report.stopped})"
        if report.stopped == "max_size_error":
            message = self.kept_whole
        elif report.stopped == "target":
            message = NO_MORE_FACES
        elif report.stopped == "max_error":
            message = f"nothing could be removed within {self.core.distance_limit(job)}"
        self._keep(report, message)
        if samples is not None:
            samples.discard()
        return None

    def write(self, result: MeshResult, progress: Progress) -> None:
        """Write a simplified mesh into the layer.

        Raises:
            WarpqemError: it cannot be written.
        """
        job, report = result.job, self.reports[result.job.mesh.path]
        progress(0.0, "write")
        if result.rig.fitted is not None:
            report.joints = result.rig.fitted.joints
        with usd_errors_named(job.mesh.path):
            result.write(self.layer, report, self.options, progress, self._measures)
            report.dropped += job.seams.released(job.faces, result.mesh.face_map)

    def _keep(self, report: PrimReport, message: str) -> None:
        """Leave a mesh as it is."""
        report.status, report.message = "kept", message
        if self.options.bake_normals is not None:
            report.notes.append(f"{report.path}: no normal map, as the mesh keeps its faces and its own shading")
