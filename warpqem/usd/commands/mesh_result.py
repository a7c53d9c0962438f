"""Write the result for one mesh: its points, skin and values into a layer of edits, and its figures into the report."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pxr import UsdGeom

import warpqem
from warpqem.arguments.distance_limit import DistanceLimit
from warpqem.arguments.figures import rounded_up
from warpqem.errors import WarpqemError
from warpqem.runtime.thread_limit import limit_threads, thread_scope, worthwhile_threads
from warpqem.usd.commands.context import Progress
from warpqem.usd.commands.face_points import points_on_level
from warpqem.usd.commands.measuring import WrittenMeasures, written_within
from warpqem.usd.commands.mesh_job import MeshJob
from warpqem.usd.commands.rig_steps import Rig
from warpqem.usd.commands.simplify_options import SimplifyOptions
from warpqem.usd.read.mesh_skin import Skin
from warpqem.usd.write.feature_subsets import write_feature_points
from warpqem.usd.write.point_samples import PointSamples
from warpqem.usd.write.smooth_normals import has_normals
from warpqem.usd.write.stage_report import PrimReport
from warpqem.usd.write.write import OverLayer

__all__ = ["MeshResult"]


@dataclass(frozen=True)
class MeshResult:
    """One mesh as the core has simplified it.

    Attributes:
        job: The mesh.
        mesh: What came of it.
        samples: What has its points in the poses already; None where the points of ``mesh`` are to be written.
        rig: Its skin and blend shapes.
        limit: How far it may be from the input.
        face: How the feature points of a face were kept; None for other cost models.
    """

    job: MeshJob
    mesh: warpqem.SimplifiedMesh
    samples: PointSamples | None
    rig: Rig
    limit: DistanceLimit
    face: warpqem.face.FaceProtection | None

    def write(
        self,
        layer: OverLayer,
        report: PrimReport,
        options: SimplifyOptions,
        progress: Progress,
        measures: WrittenMeasures,
    ) -> None:
        """Write the mesh, and measure what was written if the options say so.

        Args:
            layer: Edits over the stage that the mesh was read from.
            report: Gets what came of the mesh.
            options: What is asked for.
            progress: Called with the part done.
            measures: Measures it, a small one later, together with others.
        """
        samples = self.samples
        if samples is None:
            samples = layer.point_samples(self.job.mesh.path, self.job.written_times, options.normals == "keep")
        try:
            self._write(samples, layer, report, options, progress, measures)
        except WarpqemError:
            samples.discard()
            raise

    def _write(
        self,
        samples: PointSamples,
        layer: OverLayer,
        report: PrimReport,
        options: SimplifyOptions,
        progress: Progress,
        measures: WrittenMeasures,
    ) -> None:
        job, mesh = self.job, self.mesh
        transfer = job.transfer(mesh, options.device)
        transfer.normals, transfer.shades_all = options.normals or "fit", options.normals == "fit"
        # A map needs the normals that it tilts; faces that stay are shaded as they were without any.
        transfer.only_nearer = options.bake_normals is None and job.is_simplified_by(mesh)
        transfer.feature_points = points_on_level(job, self.face, mesh.vertex_map)
        skin = job.skin
        reduced = self.rig.shapes
        points = mesh.points
        if skin is not None:
            skin, points = self._at_rest(skin)
            if job.rest_fit is not None:
                transfer.reference = job.rest_fit.apply(points[0])
        if self.samples is None:
            samples.begin(1, mesh.points.shape[1], mesh.faces)
            samples.write(slice(0, 1), points)
        if skin is not None and reduced is not None:
            report.shapes = reduced.report
            report.notes += reduced.notes
        with thread_scope():
            # On a small mesh other threads take longer to start than the work takes.
            limit_threads(worthwhile_threads(len(job.faces), job.frames.frame_count))
            dropped = layer.replace_mesh(job.mesh.path, samples, job.written_times, mesh.faces, transfer, skin)
        if reduced is not None:
            undo = reduced.correct_animation(layer.stage, job.source)
            if undo is not None:
                layer.on_discard(job.mesh.path, undo)
        written = UsdGeom.Mesh(layer.stage.GetPrimAtPath(job.mesh.path))
        if transfer.shades_all and not has_normals(written.GetPrim()):
            report.notes.append(f"{job.mesh.path}: no normals, as it is shaded more like the input without them")
        write_feature_points(written, transfer.feature_points, create=self.face is not None)
        if options.bake_normals is not None:
            # Loaded for those who ask for it: its kernels take a while.
            from warpqem.usd.commands.normal_map import bake_mesh_normals

            bake_mesh_normals(job, mesh, transfer, layer, report, options.bake_normals, options.device)
        report.dropped = [*self._explained(dropped, options.bake), *self._left_out()]
        report.components_removed = mesh.components_removed
        report.faces_after = len(mesh.faces)
        report.vertices_after = mesh.points.shape[1]
        report.estimate = float(mesh.error)
        is_proved = skin is None or not self.limit or written_within(job, layer.stage, self.limit, options.device)
        if options.measure:
            measures.add(job, layer.stage, report, progress, waits=is_proved)
        if not is_proved:
            report.problems.append(self._unproved(report))

    def _unproved(self, report: PrimReport) -> str:
        """What is known of a limit that is not proved: that it does not hold, where a measured distance is above it."""
        start, found = f"{self.job.mesh.path}: {self.limit}", report.measured
        if found is None or not self.limit.is_below(found["hausdorff"] / 100, found["hausdorff_length"]):
            return f"{start}: not proved for the skin as it is written"
        broken = f"does not hold for the skin as it is written: a point is {rounded_up(found['hausdorff'])} % off"
        if found["verdict"] == "good":
            # Within what is good in general, but not what was asked for.
            report.measured = found | {"verdict": "look", "reason": f"the limit {broken}"}
        return f"{start}: {broken}"

    def _at_rest(self, skin: Skin) -> tuple[Skin, npt.NDArray[np.float32]]:
        """The skin of the new points and their rest shape (1, V', 3)."""
        fitted = self.rig.fitted
        rest = self.job.rest_shape(self.mesh) if fitted is None else fitted.rest_points[None]
        return self.rig.written(skin), rest

    def _explained(self, dropped: list[str], bake: bool) -> list[str]:
        """What was taken off the mesh, with why its skin was."""
        if bake:
            # What was asked for is no loss.
            return [name for name in dropped if not name.startswith("skin binding")]
        reason = self.job.unskinned_because
        if reason is None:
            return dropped
        return [f"{name} ({reason})" if name.startswith("skin binding") else name for name in dropped]

    def _left_out(self) -> list[str]:
        """What the new mesh has no longer, though nothing had to be taken off it."""
        lines = []
        unused = self.job.source.point_count - len(self.job.mesh.used_points)
        if unused:
            lines.append(f"{unused} point{'s' if unused > 1 else ''} that no face uses")
        if self.mesh.components_removed:
            lines.append(f"{self.mesh.components_removed} small components of the surface")
        return lines
