"""Read what a mesh is textured, shaded and coloured by, at the corners of its triangles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom

from warpqem.measure.surface_values import CornerValues, SurfaceValues
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.texture_coordinates import is_uv
from warpqem.usd.read.value_arrays import blocked_codes, primvar_samples, sample_codes, to_numpy

__all__ = ["compare_as_posed", "surface_values"]

Read = Callable[[Usd.TimeCode], npt.NDArray[np.floating]]


class _UnusableError(Exception):
    """Values that cannot be compared; the message says why."""


def surface_values(source: MeshSource, times: Sequence[float] | None) -> SurfaceValues:
    """Texture coordinates, shading normals and colours of a mesh, those it inherits included.

    Texture coordinates are the primvars of such a type, or pairs of floats by one of the usual names; colours the
    primvars of a colour type. `primvars:normals` goes before `normals`, as in rendering. What does not fit the mesh is
    named in `unusable`.

    Args:
        source: The mesh.
        times: Time code of each frame; None for one frame at the default time.
    """
    uvs: dict[str, Any] = {}
    colors: dict[str, Any] = {}
    unusable: dict[str, str] = {}
    for primvar in UsdGeom.PrimvarsAPI(source.prim).FindPrimvarsWithInheritance():
        name = str(primvar.GetPrimvarName())
        kind = uvs if is_uv(primvar) else colors if str(primvar.GetTypeName().role) == "Color" else None
        if kind is None:
            continue
        try:
            kind[name] = _primvar_values(source, primvar, times, 2 if kind is uvs else 3)
        except _UnusableError as error:
            unusable[name] = str(error)
    try:
        normals = _normals(source, times)
    except _UnusableError as error:
        normals, unusable["normals"] = None, str(error)
    return SurfaceValues(uvs, normals, colors, unusable)


def compare_as_posed(sources: Sequence[MeshSource], values: Sequence[SurfaceValues]) -> list[SurfaceValues]:
    """The values of two meshes without normals that stand for different poses.

    Normals on a mesh that a skeleton deforms are those of its rest pose: those of two such meshes can be compared with
    each other, but not with those of a mesh whose points move by themselves.
    """
    if len({source.has_skin_binding for source in sources}) == 1:
        return list(values)
    reason = "normals are those of the rest pose, on a mesh that a skeleton or blend shapes deform"
    return [
        SurfaceValues(found.uvs, None, found.colors, {**found.unusable, "normals": reason})
        if source.has_skin_binding and found.normals is not None
        else found
        for source, found in zip(sources, values, strict=True)
    ]


def _normals(source: MeshSource, times: Sequence[float] | None) -> CornerValues | None:
    primvar = UsdGeom.PrimvarsAPI(source.prim).GetPrimvar("normals")
    if primvar and primvar.HasAuthoredValue():
        return _primvar_values(source, primvar, times, 3)
    attribute = source.mesh.GetNormalsAttr()
    codes = sample_codes(attribute)
    if not codes:
        return None
    if blocked_codes(attribute):
        raise _UnusableError(f"normals have no value at time {blocked_codes(attribute)[0].GetValue():g}")
    index = _corner_index(source, str(source.mesh.GetNormalsInterpolation()), "normals")

    def read(code: Usd.TimeCode) -> npt.NDArray[np.floating]:
        return _numbers(to_numpy(attribute.Get(code)), "normals", code, 3, *index)

    return _corner_values("normals", codes, read, times)


def _primvar_values(
    source: MeshSource, primvar: UsdGeom.Primvar, times: Sequence[float] | None, width: int
) -> CornerValues:
    name, attribute, indices = str(primvar.GetPrimvarName()), primvar.GetAttr(), primvar.GetIndicesAttr()
    samples = primvar_samples(primvar)
    if samples is None:
        raise _UnusableError(f"{name} has no values, or indices that are not of its values")
    blocked = blocked_codes(attribute)
    if blocked:
        raise _UnusableError(f"{name} has no value at time {blocked[0].GetValue():g}")
    place = _corner_index(source, str(primvar.GetInterpolation()), name)
    indexed = bool(indices and indices.HasAuthoredValue())

    def read(code: Usd.TimeCode) -> npt.NDArray[np.floating]:
        values = to_numpy(attribute.Get(code), primvar.GetElementSize())
        index = to_numpy(indices.Get(code)) if indexed else None
        if values is not None and index is not None:
            if len(index) and (index.min() < 0 or index.max() >= len(values)):
                raise _UnusableError(f"{name} has indices that are not of its values at time {code}")
            values = values[index]
        return _numbers(values, name, code, width, *place)

    return _corner_values(name, list(samples), read, times)


def _corner_values(name: str, codes: Sequence[Usd.TimeCode], read: Read, times: Sequence[float] | None) -> CornerValues:
    """Values in every frame; those of all samples are looked at first.

    Raises:
        _UnusableError: some do not fit.
    """
    only = read(codes[0])
    if len(codes) == 1:
        return CornerValues(name, lambda _: only)
    for code in codes[1:]:
        read(code)
    if times is None:
        default = read(Usd.TimeCode.Default())
        return CornerValues(name, lambda _: default)
    return CornerValues(name, lambda frame: read(Usd.TimeCode(times[frame])))


def _corner_index(source: MeshSource, interpolation: str, name: str) -> tuple[npt.NDArray[np.integer], int]:
    """Which value each corner of the triangles has (N, 3), and how many values there are to be."""
    topology = source.topology
    tokens = UsdGeom.Tokens
    shape = topology.triangles.shape
    index: npt.NDArray[np.integer]
    if interpolation == tokens.constant:
        index, count = np.zeros(shape, dtype=np.int64), 1
    elif interpolation == tokens.uniform:
        index, count = np.broadcast_to(topology.triangle_polygons[:, None], shape), topology.polygon_count
    elif interpolation in (tokens.vertex, tokens.varying):
        index, count = topology.triangles, source.point_count
    elif interpolation == tokens.faceVarying:
        index, count = topology.triangle_corners, topology.corner_count
    else:
        raise _UnusableError(f"{name} has the interpolation {interpolation}, which is none of a mesh")
    # As the triangles are compared: counter-clockwise.
    return (index[:, ::-1] if source.left_handed else index), count


def _numbers(
    values: npt.NDArray[np.generic] | None,
    name: str,
    code: Usd.TimeCode,
    width: int,
    index: npt.NDArray[np.integer],
    count: int,
) -> npt.NDArray[np.floating]:
    """Values at the corners of the triangles, (N, 3, width) float64.

    Raises:
        _UnusableError: there are too few or too many, they are no vectors of that many real numbers, or not finite.
    """
    when = "the default time" if code.IsDefault() else f"time {code.GetValue():g}"
    if values is None or values.dtype.kind != "f" or values.ndim != 2 or values.shape[1] < width:
        raise _UnusableError(f"{name} has no vectors of {width} real numbers at {when}")
    if len(values) != count:
        raise _UnusableError(f"{name} has {len(values)} values at {when}, {count} are needed")
    corners: npt.NDArray[np.floating] = values[index][..., :width].astype(np.float64)
    wrong = np.flatnonzero(~np.isfinite(corners).all(axis=(1, 2)))
    if len(wrong):
        raise _UnusableError(f"{name} has a value that is not finite at {when}, in triangle {wrong[0]}")
    return corners
