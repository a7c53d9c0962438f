"""Sequences of mesh files as stages, and meshes of a stage as mesh files."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
from pxr import Sdf, Tf, Usd, UsdGeom, Vt

from warpqem.errors import StageError
from warpqem.mesh_files.file_names import frame_numbers
from warpqem.mesh_files.reading import has_shared_points, read_mesh_file
from warpqem.mesh_files.sequence import MeshSequence, Progress, scan
from warpqem.mesh_files.writing import WrittenValues, write_frames
from warpqem.usd.checks.usd_errors import first_line
from warpqem.usd.layers.sample_saver import SampleSaver
from warpqem.usd.write.collect_files import Collection
from warpqem.usd.write.layer_files import check_output_path, export_layer
from warpqem.usd.write.package import is_package, write_package
from warpqem.usd.write.point_samples import PointSamples

__all__ = ["export_meshes", "mesh_numbers", "save_stage", "write_mesh_stage"]

# The prim that holds the mesh.
MESH_ROOT = Sdf.Path("/Root")
# What numbers the files of a sequence, and stands around it.
FRAME_NUMBER = re.compile(r"[\W_]*(\d+|#+|\*+)$")


def write_mesh_stage(files: Sequence[str], path: Path, fps: float, progress: Progress | None = None) -> MeshSequence:
    """Write mesh files as the time samples of one mesh, one file in memory at a time.

    Args:
        files: The file of each frame; see `warpqem.load`.
        path: New .usdc file.
        fps: Time codes per second; the numbers of the frames are the time codes.
        progress: Called with the part done and the file.

    Returns:
        The sequence.

    Raises:
        MeshFileError: a file cannot be read, or has other faces than the first one.
        StageError: the stage cannot be written.
    """
    try:
        stage = Usd.Stage.CreateNew(os.fspath(path))
    except Tf.ErrorException as error:
        raise StageError(f"{path}: cannot be written ({first_line(error)})") from error
    first = read_mesh_file(files[0])
    mesh = _define_mesh(stage, _prim_name(files[0]), fps, frame_numbers(files))
    samples = PointSamples(mesh, _times(frame_numbers(files)), SampleSaver(stage.GetRootLayer()))

    def write(frame: int, points: npt.NDArray[np.floating]) -> None:
        samples.write(slice(frame, frame + 1), points[None].astype(np.float32))

    if all(map(has_shared_points, files)):
        samples.begin(len(files), len(first.points), first.faces)
        sequence = scan(list(files), progress, write)
    else:
        # Which corners are one vertex is known when all frames have been seen.
        sequence = scan(list(files), progress)
        samples.begin(len(files), sequence.vertex_count, sequence.faces)
        for frame in range(sequence.frame_count):
            write(frame, sequence.read(slice(frame, frame + 1))[0])
    _write_faces(mesh, sequence.faces)
    _write_values(mesh, sequence)
    if not stage.GetRootLayer().Save():
        raise StageError(f"{path}: USD cannot write it")
    return sequence


def save_stage(
    points: npt.NDArray[np.floating],
    faces: npt.NDArray[np.int32],
    path: str | os.PathLike[str],
    numbers: Sequence[int],
    fps: float,
) -> None:
    """Write arrays as a USD file with one mesh; see `warpqem.SimplifiedMesh.save`.

    Raises:
        OptionError: the path is no USD file's, or its folder does not exist.
        StageError: the file cannot be written.
    """
    output = check_output_path(path, [], packages=True)
    stage = Usd.Stage.CreateInMemory()
    mesh = _define_mesh(stage, _prim_name(os.fspath(path)), fps, numbers)
    samples = PointSamples(mesh, _times(numbers), lambda size: None)
    samples.begin(len(points), points.shape[1], faces)
    samples.write(slice(0, len(points)), points.astype(np.float32))
    _write_faces(mesh, faces)
    if is_package(output):
        write_package(stage.GetRootLayer(), Collection(), output)
    else:
        export_layer(stage.GetRootLayer(), output)


def export_meshes(path: Path, files: Sequence[str]) -> None:
    """Write the mesh of a stage that `write_mesh_stage` wrote, simplified, as mesh files.

    Args:
        path: The stage.
        files: The file of each of its frames.

    Raises:
        MeshFileError: a file cannot be written.
    """
    stage = Usd.Stage.Open(os.fspath(path))
    mesh = _mesh_of(stage)
    faces = np.asarray(mesh.GetFaceVertexIndicesAttr().Get(), dtype=np.int32).reshape(-1, 3)
    codes = [Usd.TimeCode(time) for time in mesh.GetPointsAttr().GetTimeSamples()] or [Usd.TimeCode.Default()]
    count = len(mesh.GetPointsAttr().Get(codes[0]))

    def frames() -> Iterator[npt.NDArray[np.float32]]:
        for code in codes:
            yield np.asarray(mesh.GetPointsAttr().Get(code), dtype=np.float32)

    write_frames(frames(), faces, count, files, _values(mesh, faces))


def mesh_numbers(path: Path) -> list[int]:
    """The frames of such a stage: its time codes where they are whole, else 1, 2, ..."""
    stage = Usd.Stage.Open(os.fspath(path))
    times = _mesh_of(stage).GetPointsAttr().GetTimeSamples()
    if times and all(time.is_integer() for time in times):
        return [int(time) for time in times]
    return list(range(1, max(len(times), 1) + 1))


def _mesh_of(stage: Usd.Stage) -> UsdGeom.Mesh:
    return UsdGeom.Mesh(stage.GetPrimAtPath(MESH_ROOT).GetChildren()[0])


def _times(numbers: Sequence[int]) -> list[float] | None:
    """Time codes of frames; None for a single one, which is no time sample."""
    return [float(number) for number in numbers] if len(numbers) > 1 else None


def _prim_name(file: str) -> str:
    """A name for the mesh of a file: its own without the number of the frame."""
    stem = Path(file).stem
    name = FRAME_NUMBER.sub("", stem) or stem
    return str(Tf.MakeValidIdentifier(name)) if name.isascii() else "Mesh"


def _define_mesh(stage: Usd.Stage, name: str, fps: float, numbers: Sequence[int]) -> UsdGeom.Mesh:
    """A mesh without points on a new stage, and the metadata of the stage."""
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    # Mesh files have no unit; those that name one (glTF) are in metres.
    UsdGeom.SetStageMetersPerUnit(stage, UsdGeom.LinearUnits.meters)
    stage.SetTimeCodesPerSecond(fps)
    stage.SetFramesPerSecond(fps)
    if len(numbers) > 1:
        stage.SetStartTimeCode(numbers[0])
        stage.SetEndTimeCode(numbers[-1])
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, MESH_ROOT).GetPrim())
    mesh = UsdGeom.Mesh.Define(stage, MESH_ROOT.AppendChild(name))
    # Before points are written: with a subdivision surface come normals.
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    return mesh


def _write_faces(mesh: UsdGeom.Mesh, faces: npt.NDArray[np.int32]) -> None:
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), 3, dtype=np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(np.ascontiguousarray(faces.reshape(-1))))


def _write_values(mesh: UsdGeom.Mesh, sequence: MeshSequence) -> None:
    """Texture coordinates and colours that all files have."""
    primvars = UsdGeom.PrimvarsAPI(mesh)
    if sequence.uv is not None:
        st = primvars.CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.vertex)
        st.Set(Vt.Vec2fArray.FromNumpy(sequence.uv))
    for colors, interpolation in (
        (sequence.vertex_colors, UsdGeom.Tokens.vertex),
        (sequence.face_colors, UsdGeom.Tokens.uniform),
    ):
        if colors is None:
            continue
        rgb = np.ascontiguousarray(colors[:, :3])
        mesh.CreateDisplayColorPrimvar(interpolation).Set(Vt.Vec3fArray.FromNumpy(rgb))
        if (colors[:, 3] < 1.0).any():
            alpha = np.ascontiguousarray(colors[:, 3])
            mesh.CreateDisplayOpacityPrimvar(interpolation).Set(Vt.FloatArray.FromNumpy(alpha))


def _values(mesh: UsdGeom.Mesh, faces: npt.NDArray[np.int32]) -> WrittenValues:
    """The same of a mesh of triangles, for each corner, or for each face where they are uniform."""
    uv = _per_corner(UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st"), faces)
    color, opacity = mesh.GetDisplayColorPrimvar(), mesh.GetDisplayOpacityPrimvar()
    rgb, alpha = _per_corner(color, faces), _per_corner(opacity, faces)
    if rgb is None:
        return WrittenValues(uv)
    alpha = np.ones((*rgb.shape[:2], 1), dtype=np.float32) if alpha is None else alpha
    rgba = np.concatenate([rgb, alpha], axis=2)
    if color.GetInterpolation() == UsdGeom.Tokens.uniform:
        return WrittenValues(uv, face_colors=rgba[:, 0])
    return WrittenValues(uv, rgba)


def _per_corner(primvar: UsdGeom.Primvar, faces: npt.NDArray[np.int32]) -> npt.NDArray[np.float32] | None:
    """Values of each corner, (N, 3, D); None without any."""
    found = primvar.ComputeFlattened() if primvar and primvar.HasAuthoredValue() else None
    if found is None:
        return None
    values = np.asarray(found, dtype=np.float32).reshape(len(found), -1)
    kind = primvar.GetInterpolation()
    if kind == UsdGeom.Tokens.faceVarying:
        return values.reshape(*faces.shape, -1)
    if kind == UsdGeom.Tokens.uniform:
        return np.repeat(values[:, None], 3, axis=1)
    if kind == UsdGeom.Tokens.constant:
        return np.broadcast_to(values[0], (*faces.shape, values.shape[1]))
    return values[faces]
