"""Faces in USD files: their feature points, pictures of them, and motion carried from one to another."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom

from warpqem.errors import OptionError, StageError
from warpqem.face import FEATURE_NAMES
from warpqem.face.features import FacialFeatures, facial_features
from warpqem.face.retarget import FaceMesh, RetargetedMotion, retarget
from warpqem.file_kinds import check_regular
from warpqem.picture import View, fit_view, render, tile, write_png
from warpqem.picture.marks import mark
from warpqem.usd.face_output import write_blend_shapes, write_samples
from warpqem.usd.frames import FrameRange
from warpqem.usd.mesh import MeshSource
from warpqem.usd.skel import StagePoses
from warpqem.usd.stage import find_meshes, open_stage
from warpqem.usd.write import check_output_path, copy_stage_metadata, export_layer

__all__ = ["FaceOptions", "StageFace", "draw_face", "read_face", "retarget_file", "write_points"]

# Point subsets of this family name feature points: each is named after one and holds it.
SUBSET_FAMILY = "face"
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
    """

    stage: Usd.Stage
    path: str
    times: list[float] | None
    points: npt.NDArray[np.float32]
    faces: npt.NDArray[np.int32]
    used: npt.NDArray[np.int32]
    features: FacialFeatures


def read_face(path: str | os.PathLike[str], options: FaceOptions | None = None) -> StageFace:
    """Read a mesh and find its feature points.

    Points of a JSON file take precedence over point subsets of the family `face` on the mesh, and those over what is
    found.

    Raises:
        StageError: the file cannot be read, or has no mesh.
        OptionError: an option is wrong, or a point that is given does not exist.
    """
    options = options or FaceOptions()
    stage = open_stage(path)
    selection = find_meshes(stage, () if options.prim is None else (options.prim,))
    if not selection.prims:
        raise StageError(f"{path}: there is no mesh on the stage")
    poses = StagePoses(stage)
    source = max((MeshSource(prim, poses) for prim in selection.prims), key=lambda mesh: mesh.point_count)
    mesh = source.read(source.frame_times(options.frames))
    place = {int(point): index for index, point in enumerate(mesh.used_points)}
    given = {**_subset_points(source.prim), **({} if options.points is None else _read_points(options.points))}
    unused = [name for name, point in given.items() if point is not None and point not in place]
    if unused:
        raise OptionError(f"feature point {unused[0]}: {mesh.path} has no point {given[unused[0]]} in a face")
    z_up = UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z
    up, forward = ("+z", "-y") if z_up else ("+y", "+z")
    features = facial_features(
        mesh.points,
        mesh.right_handed_faces,
        up=None if options.find_orientation else up,
        forward=None if options.find_orientation else forward,
        overrides={name: None if point is None else place[point] for name, point in given.items()},
    )
    return StageFace(stage, mesh.path, mesh.times, mesh.points, mesh.right_handed_faces, mesh.used_points, features)


def _subset_points(prim: Usd.Prim) -> dict[str, int | None]:
    found: dict[str, int | None] = {}
    for subset in UsdGeom.Subset.GetGeomSubsets(UsdGeom.Imageable(prim), UsdGeom.Tokens.point, SUBSET_FAMILY):
        name, indices = subset.GetPrim().GetName(), subset.GetIndicesAttr().Get()
        if name not in FEATURE_NAMES or not indices:
            raise OptionError(f"{subset.GetPath()}: expected the name of a feature point, and the point")
        found[name] = int(indices[0])
    return found


def _read_points(path: str | os.PathLike[str]) -> dict[str, int | None]:
    """Points by name: a number, null for a point that is not there, or what `write_points` wrote."""
    check_regular(path, OptionError, f"points {os.fspath(path)}")
    try:
        value: Any = json.loads(Path(path).read_text("utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise OptionError(f"points {path}: cannot be read ({error})") from error
    value = value.get("points", value) if isinstance(value, dict) else None
    if not isinstance(value, dict):
        raise OptionError(f"points {path}: expected an object with points by name")
    found = {name: entry.get("point") if isinstance(entry, dict) else entry for name, entry in value.items()}
    for name, point in found.items():
        if point is not None and (isinstance(point, bool) or not isinstance(point, int)):
            raise OptionError(f"points {path}: {name} is {point!r}, expected a point's index or null")
    return found


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
        OptionError: the output is no .png file.
        StageError: it cannot be written.
    """
    if not os.fspath(output).lower().endswith(".png"):
        raise OptionError(f"output {output}: the suffix must be .png")
    # In the face's own axes, so that every face looks the same way.
    points = face.points[0].astype(np.float64) @ face.features.axes.T
    marked, pictures = points[face.features.indices], []
    for azimuth in AZIMUTHS:
        view = fit_view(points, azimuth=azimuth, elevation=0.0, aspect=SIZE[0] / SIZE[1])
        if face.features.units is not None:
            tip = face.features.axes @ face.features.units.tip
            view = View(azimuth, 0.0, tuple(map(float, tip)), NOSES * face.features.units.nose)
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
) -> RetargetedMotion:
    """Carry the motion of one face to another, and write that one as a file of its own.

    Both are at rest in their first frame. The file has the points over time, or a blend shape for each frame.

    Raises:
        StageError: the source does not move, or the output cannot be written.
        OptionError: the output path is wrong.
        FeaturePointError: the faces share too few points.
    """
    inputs = [layer.realPath for face in (source, target) for layer in face.stage.GetUsedLayers() if layer.realPath]
    output = check_output_path(output_path, inputs)
    if source.times is None or len(source.times) < 2:
        raise StageError(f"{source.path}: the mesh has one pose only, so there is no motion to carry")
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
