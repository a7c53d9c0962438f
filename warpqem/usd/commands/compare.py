"""Compare the meshes of two USD files."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from pxr import Sdf, Usd

from warpqem.errors import DeviceError, OptionError, StageError, VaryingTopologyError, WarpqemError
from warpqem.files.outputs import OutputFile, named_outputs
from warpqem.measure import Appearance, Comparison, compare, distance_colors
from warpqem.usd.checks.input_files import check_stage_outputs
from warpqem.usd.commands.appearance import compare_looks
from warpqem.usd.commands.compare_runs import VaryingMesh, combine, pair_runs, run_colors
from warpqem.usd.commands.level_stages import ORIGINAL, level_stages, original_of_levels
from warpqem.usd.read.mesh_pairs import pair_meshes
from warpqem.usd.read.open_stage import find_meshes, open_stage
from warpqem.usd.read.read_mesh import MeshSource, StageMesh
from warpqem.usd.read.skeleton_poses import StagePoses
from warpqem.usd.read.time_codes import FrameRange
from warpqem.usd.read.variants import select_variants
from warpqem.usd.read.visibility import seen_frames
from warpqem.usd.write.layer_files import check_output_path
from warpqem.usd.write.stage_report import collapsed_note, name_prim

if TYPE_CHECKING:
    from warpqem.usd.write.write import OverLayer

__all__ = ["CompareOptions", "PairReport", "compare_stages"]

# Distances in % of the diagonal that are rounding: double precision leaves some 1e-13.
NO_DISTANCE = 1e-9


@dataclass(frozen=True)
class CompareOptions:
    """How to compare.

    Attributes:
        samples: Sample points on each mesh in each frame; None for as many as suit frames and faces.
        frames: Time codes to compare at; None for all that either file has.
        prims: Prim paths; meshes at and below them are compared. Empty for all.
        device: Warp device; None for the default.
        heatmap: File to write a heat map over the test file to; None for none.
        heatmap_scale: Distance of the last colour, in % of the bounding-box diagonal; None for the largest distance,
            which is the Hausdorff distance of the tables.
        variants: Variants to compare, `SET=NAME` or `/Prim/Path{SET=NAME}`, of each file that has them.
        all_lods: Compare every level of detail of the test file below the original, one after the other.
    """

    samples: int | None = None
    frames: FrameRange | None = None
    prims: tuple[str, ...] = ()
    device: str | None = None
    heatmap: str | None = None
    heatmap_scale: float | None = None
    variants: tuple[str, ...] = ()
    all_lods: bool = False

    def __post_init__(self) -> None:
        """Refuse ways that exclude each other."""
        for name in ("heatmap", "variants"):
            if self.all_lods and getattr(self, name):
                raise OptionError(
                    f"`all_lods` and `{name}` exclude each other: choose one level as a `variant` instead"
                )


@dataclass
class PairReport:
    """The comparison of two meshes that the files show at the same places.

    Attributes:
        path: Prim path of the mesh of the reference; see `warpqem.usd.read.mesh_pairs.MeshPair`.
        times: Time codes compared at; None for one frame at the default time.
        comparison: The measures; None if the comparison failed, or neither mesh has a face.
        appearance: How texture, shading and colours differ; None likewise.
        heatmap_scale: Distance of the last colour of the heat map, in % of the diagonal; None without a heat map.
        message: Why it failed.
        level: Name of the level of detail, with `CompareOptions.all_lods`, or of the original in a file with levels as
            prims; else None.
    """

    path: str
    times: list[float] | None = None
    comparison: Comparison | None = None
    appearance: Appearance | None = None
    heatmap_scale: float | None = None
    message: str | None = None
    level: str | None = None

    @property
    def notes(self) -> list[str]:
        """What is worth knowing of how the meshes were compared."""
        frames = () if self.comparison is None else self.comparison.collapsed_frames
        return [collapsed_note(self.path, self.times, frames)] if frames else []

    def to_dict(self) -> dict[str, Any]:
        """Plain dictionaries, lists, numbers and None, ready for JSON."""
        measures = None if self.comparison is None else self.comparison.to_dict()
        return {
            "path": self.path,
            "times": self.times,
            "heatmap_scale": self.heatmap_scale,
            "message": self.message,
            "level": self.level,
            "comparison": measures,
            "appearance": None if self.appearance is None else self.appearance.to_dict(),
        }


def compare_stages(
    reference_path: str | os.PathLike[str],
    test_path: str | os.PathLike[str],
    options: CompareOptions,
    progress: Callable[[float, str], None] | None = None,
    other_outputs: Sequence[OutputFile] = (),
) -> list[PairReport]:
    """Compare meshes that both files show at the same path, in their local space, at the union of their frames.

    What instances share is compared once, wherever either file defines it.

    Args:
        reference_path: USD file.
        test_path: USD file.
        options: What to do.
        progress: Called with the fraction done and what is being done.
        other_outputs: What else the caller is going to write; see `warpqem.usd.simplify_stage`.

    Returns:
        One report for each mesh of either file, with `all_lods` for each on every level. A mesh that the other file
        lacks counts as failed.

    Raises:
        StageError: a file cannot be read, or the heat map cannot be written.
        OptionError: an option or an output path is wrong.
        DeviceError: there is no such device.
    """
    inputs = [reference_path, test_path]
    heatmap = check_output_path(options.heatmap, inputs, "heatmap") if options.heatmap else None
    stages = [open_stage(path) for path in inputs]
    outputs = [*named_outputs({"heatmap": options.heatmap}), *other_outputs]
    check_stage_outputs(outputs, stages)
    level = None if options.all_lods else _original_level(inputs, stages, options)
    chosen = select_variants(stages, options.variants)
    reference = _Side(reference_path, stages[0], options.prims)
    if options.all_lods:
        levels = level_stages(test_path)
        reports = []
        for number, (name, stage) in enumerate(levels):
            part = None if progress is None else _part_of(progress, number, len(levels), name)
            test = _Side(test_path, stage, options.prims)
            found = _SideComparison(reference, test, options).reports(part)
            reports += [replace(report, level=name) for report in found]
        return reports
    test = _Side(test_path, stages[1], options.prims)
    layer = None if heatmap is None else _heatmap_layer(stages[1])
    comparison = _SideComparison(reference, test, options, layer)
    reports = [replace(report, level=level) for report in comparison.reports(progress)]
    if heatmap is not None and layer is not None and any(report.comparison for report in reports):
        layer.share_instances(test.selection, by_root=False)
        # The colours are those of the variants that were compared.
        for choice in chosen[1]:
            Sdf.CreatePrimInLayer(layer.layer, choice.prim).variantSelections[choice.set] = choice.name
        layer.save(heatmap)
    return reports


def _original_level(
    paths: Sequence[str | os.PathLike[str]], stages: list[Usd.Stage], options: CompareOptions
) -> str | None:
    """Take the original alone of a test file that holds levels as prims, and the reference none; the level's name.

    Raises:
        OptionError: a heat map is to be written, which has no file to be a layer over.
    """
    original = original_of_levels(paths[1], stages[1])
    if original is None or original_of_levels(paths[0], stages[0]) is not None:
        return None
    if options.heatmap is not None:
        raise OptionError(
            f"heatmap {options.heatmap}: {paths[1]} holds levels as prims; colour files of one level each"
        )
    stages[1] = original
    return ORIGINAL


def _heatmap_layer(stage: Usd.Stage) -> OverLayer:
    """The layer over the test file that a heat map is authored in."""
    # What writes meshes needs most of the package, which takes longer to load than most comparisons take.
    from warpqem.usd.write.write import OverLayer

    return OverLayer(stage)


def _part_of(
    progress: Callable[[float, str], None], number: int, count: int, name: str
) -> Callable[[float, str], None]:
    """Progress of one level as a part of all."""
    return lambda fraction, text: progress((number + fraction) / count, f"{name} {text}")


class _Side:
    """The meshes of one of the two files."""

    def __init__(self, path: str | os.PathLike[str], stage: Usd.Stage, prims: Sequence[str]) -> None:
        self.name = os.fspath(path)
        self.selection = find_meshes(stage, prims)
        self._prims = {prim.GetPath(): prim for prim in self.selection.prims}
        self._poses = StagePoses(stage)

    def mesh(self, path: Sdf.Path | None, name: str) -> _SideMesh:
        """One of them.

        Raises:
            StageError: there is none.
        """
        if path is None:
            raise StageError(f"{name}: no such mesh in {self.name}")
        return _SideMesh(self._prims[path], self._poses)


@dataclass(frozen=True)
class _SideMesh:
    """A mesh of one of the two files."""

    prim: Usd.Prim
    poses: StagePoses

    def source(self) -> MeshSource:
        return MeshSource(self.prim, self.poses)

    def varying(self) -> VaryingMesh:
        """It as a mesh of which the topology may vary over time.

        Raises:
            VaryingTopologyError: it varies although a skeleton deforms it.
        """
        try:
            source = self.source()
            # The number of points may change without the faces.
            source.read(source.frame_times())
        except VaryingTopologyError:
            if self.poses.poser(self.prim) is not None:
                raise
            return VaryingMesh.of(self.prim, self.poses, None)
        return VaryingMesh.of(self.prim, self.poses, source)


@dataclass(frozen=True)
class _SideComparison:
    """Compares all meshes of two files.

    Attributes:
        reference: The meshes of the one.
        test: The meshes of the other.
        options: What to do.
        heatmap: What the colours of the heat map are authored in, over the test file; None for no heat map.
    """

    reference: _Side
    test: _Side
    options: CompareOptions
    heatmap: OverLayer | None = None

    def reports(self, progress: Callable[[float, str], None] | None) -> list[PairReport]:
        """One report for each mesh of either file."""
        reports = []
        pairs = pair_meshes(self.reference.selection, self.test.selection)
        for index, pair in enumerate(pairs):
            report = PairReport(pair.name)
            reports.append(report)

            def part(done: int, total: int, index: int = index, name: str = pair.name) -> None:
                if progress is not None:
                    progress((index + done / total) / len(pairs), name)

            try:
                sides = self.reference.mesh(pair.reference, pair.name), self.test.mesh(pair.test, pair.name)
                self._compare(report, sides, part)
            except WarpqemError as error:
                if isinstance(error, (OptionError, DeviceError)):
                    raise
                report.message = name_prim(pair.name, error)
        refused = dict(self.reference.selection.refused + self.test.selection.refused)
        return reports + [PairReport(path, message=str(refusal)) for path, refusal in refused.items()]

    def _compare(
        self, report: PairReport, sides: tuple[_SideMesh, _SideMesh], progress: Callable[[int, int], None]
    ) -> None:
        try:
            self._compare_constant(report, sides, progress)
        except VaryingTopologyError:
            self._compare_runs(report, sides, progress)

    def _compare_runs(
        self, report: PairReport, sides: tuple[_SideMesh, _SideMesh], progress: Callable[[int, int], None]
    ) -> None:
        options = self.options
        reference, test = (side.varying() for side in sides)
        if all(run.is_empty for side in (reference, test) for run in side.runs):
            return
        pairs = pair_runs(reference, test, options.frames)
        report.times = [time for pair in pairs for time in pair.times]
        report.comparison = combine(reference, test, pairs, progress, samples=options.samples, device=options.device)
        if self.heatmap is not None:
            scale = _heatmap_scale(report.comparison, options)
            colors, report.heatmap_scale = run_colors(reference, test, pairs, scale, options.device)
            self.heatmap.set_vertex_colors(str(sides[1].prim.GetPath()), report.times, colors)

    def _compare_constant(
        self, report: PairReport, sides: tuple[_SideMesh, _SideMesh], progress: Callable[[int, int], None]
    ) -> None:
        options = self.options
        sources = [side.source() for side in sides]
        times: list[float] | None = sorted({time for source in sources for time in source.authored_times}) or None
        if times is not None and options.frames is not None:
            times = options.frames.select(times)
            if not times:
                raise StageError(f"{report.path}.points: no sample in the frame range {options.frames}")
        report.times = times
        reference, test = (source.read(times) for source in sources)
        if not len(reference.right_handed_faces) and not len(test.right_handed_faces):
            return
        meshes = (reference.points, reference.right_handed_faces, test.points, test.right_handed_faces)
        half = (lambda done, total: progress(done, 2 * total), lambda done, total: progress(total + done, 2 * total))
        # Poses in which the mesh is invisible do not count.
        seen = None if times is None else seen_frames(sources[0].prim, times)
        frames = None if seen is None or seen.all() or not seen.any() else np.flatnonzero(seen).tolist()
        report.comparison = compare(
            *meshes, samples=options.samples, frames=frames, device=options.device, progress=half[0]
        )
        report.appearance = compare_looks(sources, (reference, test), options.device, half[1])
        if self.heatmap is not None:
            scale = _heatmap_scale(report.comparison, options)
            colors, report.heatmap_scale = distance_colors(*meshes, scale=scale, device=options.device)
            colors = _for_all_points(colors, test, sources[1].point_count)
            self.heatmap.set_vertex_colors(sources[1].path, times, colors)


def _heatmap_scale(found: Comparison, options: CompareOptions) -> float | None:
    """The scale asked for, else the largest distance, as tables have it; None for meshes that are the same."""
    if options.heatmap_scale is not None:
        return options.heatmap_scale
    return found.hausdorff if found.hausdorff > NO_DISTANCE else None


def _for_all_points(colors: npt.NDArray[np.float32], mesh: StageMesh, point_count: int) -> npt.NDArray[np.float32]:
    """Colours for the authored points from those in use; the others are not seen and stay black."""
    spread = np.zeros((len(colors), point_count, 3), dtype=np.float32)
    spread[:, mesh.used_points] = colors
    return spread
