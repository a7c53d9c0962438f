"""Faces in USD files: their feature points, pictures of them, and motion transferred from one to another."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Usd

from warpqem.errors import OptionError, StageError
from warpqem.face.feature_points import FacialFeatures, facial_features
from warpqem.face.retarget import FaceMesh, RetargetedMotion, retarget
from warpqem.files.outputs import InputFile, OutputFile
from warpqem.picture import View, fit_view, render, tile, write_png
from warpqem.picture.marks import mark
from warpqem.usd.checks.input_files import check_stage_outputs
from warpqem.usd.commands.face_points import FacePoints, face_axes, largest_mesh
from warpqem.usd.read.open_stage import find_meshes, open_stage
from warpqem.usd.read.skeleton_poses import StagePoses
from warpqem.usd.read.stage_views import copy_stage_metadata
from warpqem.usd.read.time_codes import FrameRange
from warpqem.usd.write.face_output import write_blend_shapes, write_samples
from warpqem.usd.write.layer_files import check_output_path, export_layer

__all__ = ["FaceOptions", "StageFace", "check_face_outputs", "draw_face", "read_face", "retarget_file", "write_points"]

# Views of a picture, in degrees about the up axis, and the size of one.
AZIMUTHS, SIZE = (0.0, 45.0, 90.0), (640, 720)
# A picture shows this many noses.
NOSES = 3.8


@dataclass(frozen=True)
class FaceOptions:
    """Which mesh is the face, and how it lies.

    Attributes:
        prim: Prim path of the mesh; None for the one with the most points.
        frames: Time codes to read; None for all authored ones.
        find_orientation: Find which way the face looks, instead of by the stage's up axis.
        points: JSON file with points by name that are taken as they are; None for none.
    """

    prim: str | None = None
    frames: FrameRange | None = None
    find_orientation: bool = False
    points: str | os.PathLike[str] | None = None


@dataclass(frozen=True)
class StageFace:
    """A face of a stage.

    Attributes:
        stage: The stage.
        path: Prim path of the mesh.
        times: Time codes of the frames; None for a mesh that does not move.
        points: float32, shape (F, V, 3), its used points in the mesh's own space.
        faces: int32, shape (N, 3), right-handed.
        used: int32, shape (V,), the mesh's own indices of these points.
        features: The feature points, as indices of `points`.
        points_file: File with points that were given; None for none.
    """

    stage: Usd.Stage
    path: str
    times: list[float] | None
    points: npt.NDArray[np.float32]
    faces: npt.NDArray[np.int32]
    used: npt.NDArray[np.int32]
    features: FacialFeatures
    points_file: str | os.PathLike[str] | None = None


def read_face(path: str | os.PathLike[str], options: FaceOptions | None = None) -> StageFace:
    """Read a mesh and find its feature points.

    Points of a JSON file take precedence over those that the mesh names itself, see
    `warpqem.usd.commands.face_points`, and these over what is found.

    Raises:
        StageError: the file cannot be read, or has no mesh.
        OptionError: an option is wrong, or a point that is given does not exist.
    """
    options = options or FaceOptions()
    stage = open_stage(path)
    selection = find_meshes(stage, () if options.prim is None else (options.prim,))
    if not selection.prims:
        raise StageError(f"{path}: there is no mesh on the stage")
    source = largest_mesh(selection.prims, StagePoses(stage))
    mesh = source.read(source.frame_times(options.frames))
    given = FacePoints() if options.points is None else FacePoints.read(options.points)
    up, forward = face_axes(stage)
    features = facial_features(
        mesh.points,
        mesh.right_handed_faces,
        up=None if options.find_orientation else up,
        forward=None if options.find_orientation else forward,
        overrides=given.over(FacePoints.authored(source.prim)).on_vertices(mesh),
    )
    geometry = (mesh.times, mesh.points, mesh.right_handed_faces, mesh.used_points)
    return StageFace(stage, mesh.path, *geometry, features, options.points)


def check_face_outputs(outputs: Sequence[OutputFile], faces: Sequence[StageFace]) -> None:
    """Refuse outputs that are a file which a face was read from, and two that are the same file.

    Raises:
        OptionError: one of them is; see `warpqem.usd.checks.input_files.check_stage_outputs`.
    """
    points = [InputFile(face.points_file, "the file of points") for face in faces if face.points_file is not None]
    check_stage_outputs(outputs, [face.stage for face in faces], points)


def write_points(face: StageFace) -> dict[str, Any]:
    """The feature points for a JSON file, as indices of the mesh's own points, with position and confidence."""
    features = face.features
    points = {
        name: {
            "point": int(face.used[features.vertices[name]]),
            "position": [float(value) for value in face.points[0, features.vertices[name]]],
            "confidence": round(features.confidence[name], 3),
        }
        for name in features.names
    }
    return {"prim": face.path, "points": points, "missing": features.missing, "axes": features.axes.tolist()}


def draw_face(face: StageFace, output: str | os.PathLike[str], device: str | None = None) -> None:
    """Write a picture of the points on the face, from the front, from half the side and from the side.

    Raises:
        OptionError: the output is no .png file, or a file that the face was read from.
        StageError: it cannot be written.
    """
    if not os.fspath(output).lower().endswith(".png"):
        raise OptionError(f"output {output}: the suffix must be .png")
    check_face_outputs([OutputFile("picture", output)], [face])
    # In the face's own axes, so that every face looks the same way.
    points = face.points[0].astype(np.float64) @ face.features.axes.T
    marked, pictures = points[face.features.indices], []
    for azimuth in AZIMUTHS:
        view = fit_view(points, azimuth=azimuth, elevation=0.0, aspect=SIZE[0] / SIZE[1])
        if face.features.units is not None:
            x, y, z = (face.features.axes @ face.features.units.tip).tolist()
            view = View(azimuth, 0.0, (x, y, z), NOSES * face.features.units.nose)
        picture = render(points, face.faces, view, size=SIZE, smooth=True, device=device)
        # From the side, points of the other side lie behind the face.
        seen = marked @ view.axes()[2] >= (np.array(view.middle) @ view.axes()[2]) - 2.0 * view.height / NOSES
        names = [name for name, visible in zip(face.features.names, seen, strict=True) if visible]
        pictures.append(mark(picture, view, marked[seen], names))
    try:
        write_png(tile(pictures, len(pictures)), output)
    except OSError as error:
        raise StageError(f"{output}: cannot be written ({error.strerror or error})") from error


def retarget_file(
    source: StageFace,
    target: StageFace,
    output_path: str | os.PathLike[str],
    blend_shapes: bool = False,
    device: str | None = None,
    other_outputs: Sequence[OutputFile] = (),
) -> RetargetedMotion:
    """Transfer the motion of one face to another, and write that one as a file of its own.

    Both are at rest in their first frame. The file has the points over time, or a blend shape for each frame.

    Args:
        source: The face that moves.
        target: The face to move.
        output_path: .usd, .usda or .usdc file; replaced if it exists.
        blend_shapes: Write a blend shape for each frame.
        device: Warp device; None for the default.
        other_outputs: What else the caller is going to write; see `warpqem.usd.simplify_stage`.

    Raises:
        StageError: the source does not move, or the output cannot be written.
        OptionError: an output path is wrong.
        FeaturePointError: the faces share too few points.
    """
    output = check_output_path(output_path, [])
    check_face_outputs([OutputFile("output", output_path), *other_outputs], (source, target))
    if source.times is None or len(source.times) < 2:
        raise StageError(f"{source.path}: the mesh has one pose only, so there is no motion to transfer")
    moved = retarget(
        FaceMesh(source.points[0], source.faces, source.features),
        FaceMesh(target.points[0], target.faces, target.features),
        source.points,
        device=device,
    )
    stage: Usd.Stage = Usd.Stage.CreateInMemory("face.usdc")
    copy_stage_metadata(target.stage.GetRootLayer(), stage.GetRootLayer())
    write = write_blend_shapes if blend_shapes else write_samples
    write(stage, target.path, target.faces, moved, source.times)
    stage.SetTimeCodesPerSecond(source.stage.GetTimeCodesPerSecond())
    stage.SetStartTimeCode(source.times[0])
    stage.SetEndTimeCode(source.times[-1])
    export_layer(stage.GetRootLayer(), output)
    return moved
