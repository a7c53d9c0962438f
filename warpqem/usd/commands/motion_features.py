"""Show the motion features of the meshes of a USD file as colours."""

from __future__ import annotations

import colorsys
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

import warpqem
from warpqem.costs.motion_features import MotionWeighting
from warpqem.errors import DeviceError, OptionError, StageError, WarpqemError
from warpqem.files.outputs import OutputFile
from warpqem.usd.checks.input_files import check_stage_outputs
from warpqem.usd.read.open_stage import find_meshes, open_stage
from warpqem.usd.read.read_mesh import MeshSource, PoseFrames
from warpqem.usd.read.skeleton_poses import StagePoses
from warpqem.usd.read.time_codes import FrameRange
from warpqem.usd.write.layer_files import check_output_path
from warpqem.usd.write.stage_report import name_prim
from warpqem.usd.write.write import OverLayer

__all__ = ["FeatureReport", "color_features", "feature_colors"]

# Vertices outside every feature; dark enough that the colours stand out.
OUTSIDE_COLOR = (0.18, 0.18, 0.18)

# Hues in steps of the golden ratio never come close to an earlier one for long (Knuth, TAOCP 3, section 6.4).
GOLDEN_RATIO_STEP = 0.6180339887498949


@dataclass
class FeatureReport:
    """The motion features of one mesh.

    Attributes:
        path: Prim path.
        frames: Number of poses.
        features: Number of motion features.
        vertices: Vertices in use.
        feature_vertices: Vertices that belong to a feature.
        message: Why it failed.
    """

    path: str
    frames: int = 0
    features: int = 0
    vertices: int = 0
    feature_vertices: int = 0
    message: str | None = None


def feature_colors(labels: npt.NDArray[np.int32]) -> npt.NDArray[np.float32]:
    """A colour for each vertex by the feature it belongs to.

    Args:
        labels: int32, shape (V,), feature of each vertex, -1 for none.

    Returns:
        float32, shape (V, 3), linear Rec. 709.
    """
    hues = (np.arange(int(labels.max(initial=-1)) + 1) * GOLDEN_RATIO_STEP) % 1.0
    palette = [colorsys.hsv_to_rgb(float(hue), 0.85, 0.9) for hue in hues]
    # The last entry is the one that label -1 picks.
    return np.array([*palette, OUTSIDE_COLOR], dtype=np.float32)[labels]


def color_features(
    input_path: str | os.PathLike[str],
    output_path: str | os.PathLike[str],
    *,
    prims: tuple[str, ...] = (),
    frames: FrameRange | None = None,
    weighting: MotionWeighting | None = None,
    device: str | None = None,
    progress: Callable[[float, str], None] | None = None,
    other_outputs: Sequence[OutputFile] = (),
) -> list[FeatureReport]:
    """Write a layer over a USD file that colours the vertices of each mesh by motion feature (primvars:displayColor).

    Args:
        input_path: USD file.
        output_path: .usd, .usda or .usdc file; replaced if it exists.
        prims: Prim paths; meshes at and below them are coloured. Empty for all.
        frames: Time codes to read; None for all authored ones.
        weighting: Threshold of the features, see `warpqem.costs.MotionWeighting`; None for that of the paper.
        device: Warp device; None for the default.
        progress: Called with the fraction done and what is being done.
        other_outputs: What else the caller is going to write; see `warpqem.usd.simplify_stage`.

    Returns:
        One report for each mesh. Nothing is written if all fail.

    Raises:
        StageError: the input cannot be read or the output cannot be written.
        OptionError: an option or an output path is wrong.
        DeviceError: there is no such device.
    """
    output = check_output_path(output_path, [input_path])
    stage = open_stage(input_path)
    check_stage_outputs([OutputFile("output", output_path), *other_outputs], [stage])
    selection = find_meshes(stage, prims)
    poses = StagePoses(stage)
    layer = OverLayer(stage)
    reports = []
    for index, prim in enumerate(selection.prims):
        report = FeatureReport(str(prim.GetPath()))
        reports.append(report)
        try:
            _color_mesh(report, MeshSource(prim, poses), layer, frames, weighting, device)
        except WarpqemError as error:
            if isinstance(error, (OptionError, DeviceError)):
                raise
            report.message = name_prim(report.path, error)
        if progress is not None:
            progress((index + 1) / len(selection.prims), prim.GetName())
    reports += [FeatureReport(path, message=str(error)) for path, error in selection.refused]
    if any(report.message is None for report in reports):
        layer.share_instances(selection, by_root=False)
        layer.save(output)
    return reports


def _color_mesh(
    report: FeatureReport,
    source: MeshSource,
    layer: OverLayer,
    frames: FrameRange | None,
    weighting: MotionWeighting | None,
    device: str | None,
) -> None:
    times = source.frame_times(frames)
    if times is None or len(times) < 2:
        raise StageError(f"{report.path}: the mesh has one pose only, so nothing moves")
    mesh = source.layout(times)
    poses = PoseFrames(source, mesh.times, mesh.used_points)
    found = warpqem.motion_features(poses, mesh.faces, weighting=weighting, device=device)
    labels = np.full(source.point_count, -1, dtype=np.int32)
    labels[mesh.used_points] = found.label
    layer.set_vertex_colors(report.path, None, feature_colors(labels)[None])
    report.frames, report.vertices = len(times), len(mesh.used_points)
    report.features = int(found.label.max(initial=-1)) + 1
    report.feature_vertices = int((found.label >= 0).sum())
