"""Compare the meshes of two USD files."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Usd

from warpqem.errors import DeviceError, OptionError, StageError, WarpqemError
from warpqem.measure import Comparison, compare, distance_colors
from warpqem.outputs import OutputFile, named_outputs
from warpqem.usd.frames import FrameRange
from warpqem.usd.input_files import check_stage_outputs
from warpqem.usd.mesh import MeshSource, StageMesh
from warpqem.usd.report import name_prim
from warpqem.usd.skel import StagePoses
from warpqem.usd.stage import find_meshes, open_stage
from warpqem.usd.write import OverLayer, check_output_path

__all__ = ["CompareOptions", "PairReport", "compare_stages"]


@dataclass(frozen=True)
class CompareOptions:
    """How to compare.

    Attributes:
        samples: Sample points on each mesh in each frame; None for as many as suit the number of frames.
        frames: Time codes to compare at; None for all that either file has.
        prims: Prim paths; meshes at and below them are compared. Empty for all.
        device: Warp device; None for the default.
        heatmap: File to write a heat map over the test file to; None for none.
        heatmap_scale: Distance of the last colour, in % of the bounding-box diagonal; None for the largest that occurs.
    """

    samples: int | None = None
    frames: FrameRange | None = None
    prims: tuple[str, ...] = ()
    device: str | None = None
    heatmap: str | None = None
    heatmap_scale: float | None = None


@dataclass
class PairReport:
    """The comparison of two meshes at the same path.

    Attributes:
        path: Prim path.
        times: Time codes compared at; None for one frame at the default time.
        comparison: The measures; None if the comparison failed.
        heatmap_scale: Distance of the last colour of the heat map, in % of the diagonal; None without a heat map.
        message: Why it failed.
    """

    path: str
    times: list[float] | None = None
    comparison: Comparison | None = None
    heatmap_scale: float | None = None
    message: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """Plain dictionaries, lists, numbers and None, ready for JSON."""
        measures = None if self.comparison is None else self.comparison.to_dict()
        return {
            "path": self.path,
            "times": self.times,
            "heatmap_scale": self.heatmap_scale,
            "message": self.message,
            "comparison": measures,
        }


def compare_stages(
    reference_path: str | os.PathLike[str],
    test_path: str | os.PathLike[str],
    options: CompareOptions,
    progress: Callable[[float, str], None] | None = None,
    other_outputs: Sequence[OutputFile] = (),
) -> list[PairReport]:
    """Compare meshes that have the same path in both files, in their local space, at the union of their frames.

    Args:
        reference_path: USD file.
        test_path: USD file.
        options: What to do.
        progress: Called with the fraction done and what is being done.
        other_outputs: What else the caller is going to write; see `warpqem.usd.simplify_stage`.

    Returns:
        One report for each mesh of either file. A mesh that the other file lacks counts as failed.

    Raises:
        StageError: a file cannot be read, or the heat map cannot be written.
        OptionError: an option or an output path is wrong.
        DeviceError: there is no such device.
    """
    inputs = [reference_path, test_path]
    heatmap = check_output_path(options.heatmap, inputs, "heatmap") if options.heatmap else None
    reference, test = _Side(reference_path, options.prims), _Side(test_path, options.prims)
    outputs = [*named_outputs({"heatmap": options.heatmap}), *other_outputs]
    check_stage_outputs(outputs, [reference.stage, test.stage])
    layer = OverLayer(test.stage)
    reports = []
    paths = list(reference.prims) + [path for path in test.prims if path not in reference.prims]
    for index, path in enumerate(paths):
        report = PairReport(path)
        reports.append(report)

        def part(done: int, total: int, index: int = index, path: str = path) -> None:
            if progress is not None:
                progress((index + done / total) / len(paths), path)

        try:
            _compare_pair(report, reference, test, options, part, layer)
        except WarpqemError as error:
            if isinstance(error, (OptionError, DeviceError)):
                raise
            report.message = name_prim(path, error)
    reports += [PairReport(path, message=str(refusal)) for path, refusal in reference.refused + test.refused]
    if heatmap is not None and any(report.comparison for report in reports):
        layer.save(heatmap)
    return reports


class _Side:
    """The meshes of one of the two files."""

    def __init__(self, path: str | os.PathLike[str], prims: Sequence[str]) -> None:
        self.name = os.fspath(path)
        self.stage: Usd.Stage = open_stage(path)
        selection = find_meshes(self.stage, prims)
        self.prims = {str(prim.GetPath()): prim for prim in selection.prims}
        self.refused = selection.refused
        self.poses = StagePoses(self.stage)

    def source(self, path: str) -> MeshSource:
        if path not in self.prims:
            raise StageError(f"{path}: no such mesh in {self.name}")
        return MeshSource(self.prims[path], self.poses)


def _compare_pair(
    report: PairReport,
    reference_side: _Side,
    test_side: _Side,
    options: CompareOptions,
    progress: Callable[[int, int], None],
    layer: OverLayer,
) -> None:
    sources = [reference_side.source(report.path), test_side.source(report.path)]
    times: list[float] | None = sorted({time for source in sources for time in source.authored_times}) or None
    if times is not None and options.frames is not None:
        times = options.frames.select(times)
        if not times:
            raise StageError(f"{report.path}.points: no sample in the frame range {options.frames}")
    report.times = times
    reference, test = (source.read(times) for source in sources)
    meshes = (reference.points, reference.right_handed_faces, test.points, test.right_handed_faces)
    report.comparison = compare(*meshes, samples=options.samples, device=options.device, progress=progress)
    if options.heatmap is not None:
        colors, report.heatmap_scale = distance_colors(*meshes, scale=options.heatmap_scale, device=options.device)
        layer.set_vertex_colors(report.path, times, _for_all_points(colors, test, sources[1].point_count))


def _for_all_points(colors: npt.NDArray[np.float32], mesh: StageMesh, point_count: int) -> npt.NDArray[np.float32]:
    """Colours for the authored points from those in use; the others are not seen and stay black."""
    spread = np.zeros((len(colors), point_count, 3), dtype=np.float32)
    spread[:, mesh.used_points] = colors
    return spread
