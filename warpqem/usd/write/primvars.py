"""Transfer primvars, normals and other arrays of a mesh to its new points, faces and corners."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from operator import itemgetter
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Sdf, Tf, Usd, UsdGeom, Vt

from warpqem.usd.checks.usd_errors import first_line
from warpqem.usd.read.flat_shading import facet_normals
from warpqem.usd.read.mesh_seams import DISPLAY_COLORS
from warpqem.usd.read.value_arrays import (
    Samples,
    anchored,
    blocked_codes,
    element_size,
    from_numpy,
    is_continuous,
    is_normal,
    is_of_one_type,
    is_quaternion,
    primvar_samples,
    reads_as_indices,
    sample_codes,
    to_numpy,
)
from warpqem.usd.write.attribute_transfer import AttributeTransfer, Rows
from warpqem.usd.write.fitted_values import fit_transferred, kind_of_values
from warpqem.usd.write.lost_directions import with_directions
from warpqem.usd.write.remove_properties import Dropped, block

__all__ = ["name_arrays", "transfer_motion", "transfer_normals", "transfer_primvars"]

POINT_INTERPOLATIONS = (UsdGeom.Tokens.vertex, UsdGeom.Tokens.varying)
# Elements of a mesh by the interpolation of what has a value for each.
ELEMENTS = {
    "point": UsdGeom.Tokens.vertex,
    "face": UsdGeom.Tokens.uniform,
    "corner": UsdGeom.Tokens.faceVarying,
}
# What USD raises for a value that it does not take.
UNWRITABLE = (Tf.ErrorException, TypeError, ValueError)
PARTNERS = {"skel:jointIndices": "skel:jointWeights", "skel:jointWeights": "skel:jointIndices"}
MOTION_ATTRIBUTES = ("velocities", "accelerations")

# Called with the bytes of every sample that was authored.
Saved = Callable[[int], None]


def transfer_primvars(prim: Usd.Prim, transfer: AttributeTransfer, dropped: Dropped, saved: Saved) -> None:
    """Bring all primvars that are authored on a mesh to its new topology, at all their samples.

    Constant ones stay. Point values that differ between welded points become faceVarying. Real numbers are blended;
    other values are those of the nearest input element. Primvars whose length does not fit their interpolation are
    dropped, and those of a skin left to others.
    """
    for primvar in UsdGeom.PrimvarsAPI(prim).GetPrimvars():
        name, interpolation = str(primvar.GetPrimvarName()), str(primvar.GetInterpolation())
        if interpolation == UsdGeom.Tokens.constant or not primvar.HasAuthoredValue():
            continue
        if name in PARTNERS:
            if not UsdGeom.PrimvarsAPI(prim).GetPrimvar(PARTNERS[name]).HasAuthoredValue():
                # One without the other is no skin, so that nothing has written it for the new points.
                block(primvar.GetAttr(), dropped)
                dropped.names.append(f"primvars:{name} without {PARTNERS[name]}")
            continue
        with _dropped_where_refused(primvar.GetAttr(), f"primvars:{name} ({interpolation})", dropped):
            if not _transfer_primvar(prim, primvar, transfer, dropped, saved):
                block(primvar.GetAttr(), dropped)
                dropped.names.append(f"primvars:{name} ({interpolation})")
        if primvar.GetAttr().GetPath() in dropped.blocked:
            block(primvar.GetIndicesAttr(), dropped)


@contextmanager
def _dropped_where_refused(attribute: Usd.Attribute, name: str, dropped: Dropped) -> Iterator[None]:
    """Drop an attribute that USD does not take: it is no matter of the mesh, let alone of the others."""
    try:
        yield
    except UNWRITABLE as error:
        block(attribute, dropped)
        dropped.names.append(f"{name}: {first_line(error)}")


def _transfer_primvar(
    prim: Usd.Prim, primvar: UsdGeom.Primvar, transfer: AttributeTransfer, dropped: Dropped, saved: Saved
) -> bool:
    """Bring one primvar to the new topology; false if its values do not fit the old one."""
    name, interpolation = str(primvar.GetPrimvarName()), str(primvar.GetInterpolation())
    original = UsdGeom.PrimvarsAPI(transfer.prim).GetPrimvar(name)
    count = transfer.input_count(interpolation)
    size = element_size(original, count)
    samples = primvar_samples(original, size)
    if samples is None or count is None or any(len(values) != count for values in samples.values()):
        return False
    if primvar.GetUnauthoredValuesIndex() >= 0:
        # It is an entry of the old values.
        primvar.SetUnauthoredValuesIndex(-1)
        dropped.names.append(f"unauthoredValuesIndex of primvars:{name}")
    rows, corner_row = _rows(transfer, primvar.GetAttr().GetName(), interpolation)
    if _is_fitted(original, interpolation) and corner_row is None:
        transferred = samples.map(lambda values: transfer.colors(values).astype(values.dtype))
    else:
        transferred = _transfer(original.GetAttr(), samples, rows, name == "normals")
    kind = kind_of_values(original)
    if kind is not None and (kind != "normals" or transfer.normals == "fit"):
        transferred, corner_row = _fitted(
            transfer, str(primvar.GetAttr().GetName()), kind, interpolation, samples, transferred, corner_row
        )
    transferred, corner_row = _with_facets(prim, transfer, primvar.GetAttr().GetName(), transferred, corner_row)
    if name == "normals":
        row = _row_of_corners(transfer, interpolation, corner_row)
        title = str(primvar.GetAttr().GetName())
        transferred = with_directions(UsdGeom.Mesh(prim), transfer.faces, title, transferred, row, dropped)
    indices = primvar.GetIndicesAttr()
    if corner_row is not None and indices and not reads_as_indices(indices):
        # Indices of another type can be none of USD's.
        transferred, corner_row = transferred.map(itemgetter(corner_row.ravel())), None
        primvar.SetInterpolation(UsdGeom.Tokens.faceVarying)
    if corner_row is not None:
        transferred, corner_row = _merge_equal(transferred, corner_row)
    _write_values(primvar.GetAttr(), transferred, saved, size)
    if size != primvar.GetElementSize():
        primvar.SetElementSize(size)
    if corner_row is not None:
        # CreateIndicesAttr gives an invalid attribute for the first indices before USD 25.02.
        primvar.SetIndices(Vt.IntArray.FromNumpy(np.ascontiguousarray(corner_row.ravel())))
        primvar.SetInterpolation(UsdGeom.Tokens.faceVarying)
    else:
        block(indices, dropped)
    return True


def transfer_normals(mesh: UsdGeom.Mesh, transfer: AttributeTransfer, dropped: Dropped, saved: Saved) -> None:
    """Bring the `normals` of a mesh to its new topology; a mesh without any gets none."""
    attribute = mesh.GetNormalsAttr()
    if not attribute.HasAuthoredValue():
        return
    interpolation = str(mesh.GetNormalsInterpolation())
    if interpolation == UsdGeom.Tokens.constant:
        return
    original = transfer.prim.GetAttribute("normals")
    samples = _samples_of_length(original, transfer.input_count(interpolation))
    if samples is None:
        block(attribute, dropped)
        dropped.names.append(f"normals ({interpolation})")
        return
    rows, corner_row = _rows(transfer, "normals", interpolation)
    with _dropped_where_refused(attribute, f"normals ({interpolation})", dropped):
        transferred = _transfer(original, samples, rows, True)
        if transfer.normals == "fit" and interpolation != UsdGeom.Tokens.uniform:
            transferred, corner_row = _fitted(
                transfer, "normals", "normals", interpolation, samples, transferred, corner_row
            )
        if corner_row is not None:
            # The attribute has no indices, so that each corner has its own entry.
            transferred = transferred.map(itemgetter(corner_row.ravel()))
            corner_row = np.arange(corner_row.size, dtype=np.int32).reshape(corner_row.shape)
            mesh.SetNormalsInterpolation(UsdGeom.Tokens.faceVarying)
        transferred, corner_row = _with_facets(mesh.GetPrim(), transfer, "normals", transferred, corner_row)
        row = _row_of_corners(transfer, interpolation, corner_row)
        transferred = with_directions(mesh, transfer.faces, "normals", transferred, row, dropped)
        _write_values(attribute, transferred, saved)


def _fitted(transfer: AttributeTransfer, name: str, *values: Any) -> tuple[Samples, npt.NDArray[np.int32] | None]:
    """What :func:`fit_transferred` gives.

    Raises:
        RuntimeError: it fails: as the error it is it would pass for a value that USD does not take, and the attribute
            would be dropped.
    """
    try:
        return fit_transferred(transfer, name, *values)
    except (TypeError, ValueError) as error:
        raise RuntimeError(f"{type(error).__name__} in the fit of {name}: {error}") from error


def _row_of_corners(
    transfer: AttributeTransfer, interpolation: str, corner_row: npt.NDArray[np.int32] | None
) -> npt.NDArray[np.int32] | None:
    """(N', 3) int32, the value that each corner of the new faces has; None where each face has one."""
    if corner_row is None and interpolation != UsdGeom.Tokens.uniform:
        return transfer.faces
    return corner_row


def transfer_motion(
    prim: Usd.Prim, transfer: AttributeTransfer, point_times: list[float], dropped: Dropped, saved: Saved
) -> None:
    """Bring velocities and accelerations to the new points where they have samples with the points, and only there."""
    for name in MOTION_ATTRIBUTES:
        attribute = prim.GetAttribute(name)
        if not attribute.HasAuthoredValue():
            continue
        original = transfer.prim.GetAttribute(name)
        samples = _samples_of_length(original, transfer.point_count)
        if samples is None or attribute.GetTimeSamples() != point_times:
            block(attribute, dropped)
            dropped.names.append(name)
            continue
        with _dropped_where_refused(attribute, name, dropped):
            _write_values(attribute, _transfer(original, samples, transfer.vertices()), saved)


def name_arrays(prim: Usd.Prim, transfer: AttributeTransfer, dropped: Dropped) -> None:
    """Name arrays that no schema of the mesh knows and that have as many entries as it has points, faces or corners.

    They stay as they are: whether they belong to these elements, or just happen to be as long, nothing says.
    """
    known = set(prim.GetPrimDefinition().GetPropertyNames())
    for attribute in prim.GetAuthoredAttributes():
        name = attribute.GetName()
        if name in known or not attribute.GetTypeName().isArray or UsdGeom.Primvar.IsPrimvar(attribute):
            continue
        # Indices of a primvar are no primvar; they and those of a skin are transferred with what they belong to.
        if name.startswith(("primvars:", "skel:")):
            continue
        # What was transferred has another length by now.
        for element, interpolation in ELEMENTS.items():
            if _samples_of_length(attribute, transfer.input_count(interpolation)):
                dropped.names.append(f"the order of {name} (an entry for each old {element}; make it a primvar)")
                break


def _rows(transfer: AttributeTransfer, name: str, interpolation: str) -> tuple[Rows, npt.NDArray[np.int32] | None]:
    """Where values come from, and for those that are to be faceVarying the row of each output corner."""
    if interpolation == UsdGeom.Tokens.faceVarying:
        return transfer.corners(name)
    if interpolation in POINT_INTERPOLATIONS and transfer.is_cut(name):
        return transfer.corners(name, of_points=True)
    if interpolation == UsdGeom.Tokens.uniform:
        return transfer.polygons(), None
    return transfer.vertices(), None


def _is_fitted(primvar: UsdGeom.Primvar, interpolation: str) -> bool:
    """True of display colours and opacities at points."""
    name = str(primvar.GetAttr().GetName())
    is_real = is_continuous(primvar.GetAttr().Get(Usd.TimeCode.EarliestTime()))
    return name in DISPLAY_COLORS and interpolation in POINT_INTERPOLATIONS and is_real


def _samples_of_length(attribute: Usd.Attribute, count: int | None) -> Samples | None:
    codes = sample_codes(attribute)
    if not is_of_one_type(attribute, codes):
        return None
    for code in codes:
        values = to_numpy(attribute.Get(code))
        if values is None or len(values) != count:
            return None

    def read(code: Usd.TimeCode) -> npt.NDArray[Any]:
        values = to_numpy(attribute.Get(code))
        assert values is not None
        return values

    return Samples(codes, read)


def _transfer(original: Usd.Attribute, samples: Samples, rows: Rows, unit_length: bool = False) -> Samples:
    """The values of every sample on the new mesh; ``original`` is the attribute on the input."""
    like = next((original.Get(code) for code in samples), None)
    if not is_continuous(like):
        return Samples(list(samples), lambda code: rows.pick(_anchored(original, code, samples[code])))
    if is_quaternion(like):
        return samples.map(lambda values: rows.blend_directions(values, signed=False).astype(values.dtype))
    if unit_length or is_normal(original.GetTypeName()):
        return samples.map(lambda values: rows.blend_directions(values).astype(values.dtype))
    return samples.map(lambda values: rows.blend(values).astype(values.dtype))


def _with_facets(
    prim: Usd.Prim,
    transfer: AttributeTransfer,
    name: str,
    transferred: Samples,
    corner_row: npt.NDArray[np.int32] | None,
) -> tuple[Samples, npt.NDArray[np.int32] | None]:
    """The same where flat-shaded faces have normals of their own, and the row of each corner."""
    signs = transfer.facets(name)
    if signs is None:
        return transferred, corner_row
    points = UsdGeom.Mesh(prim).GetPointsAttr()

    def change(code: Usd.TimeCode) -> npt.NDArray[Any]:
        values = transferred[code]
        at_faces = values if corner_row is None else values[corner_row]
        pose = points.Get(code) or points.Get(Usd.TimeCode.EarliestTime())
        own = facet_normals(at_faces, np.asarray(pose, dtype=np.float64), transfer.faces, signs)
        return own.reshape(-1, 3).astype(values.dtype)

    own_row = None if corner_row is None else np.arange(corner_row.size, dtype=np.int32).reshape(corner_row.shape)
    return Samples(list(transferred), change), own_row


def _merge_equal(samples: Samples, corner_row: npt.NDArray[np.int32]) -> tuple[Samples, npt.NDArray[np.int32]]:
    """Make rows that are equal in all samples one."""
    label = np.zeros(int(corner_row.max(initial=-1)) + 1, dtype=np.int64)
    for values in samples.values():
        # Names of strings and the like are as different as they are.
        flat = values.astype(str) if values.dtype == object else values
        _, rank = np.unique(flat.reshape(len(flat), -1), axis=0, return_inverse=True)
        _, label = np.unique(label * (len(flat) + 1) + rank.ravel(), return_inverse=True)
        label = label.ravel()
    _, kept, row = np.unique(label, return_index=True, return_inverse=True)
    # In the order of first use, as before.
    order = np.argsort(kept)
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    merged = place[row.ravel()].astype(np.int32)[corner_row]
    return samples.map(itemgetter(kept[order])), merged


def _write_values(attribute: Usd.Attribute, samples: Samples, saved: Saved, element_size: int = 1) -> None:
    """Author every sample."""
    # Read before anything is written: the first sample written hides those of weaker layers.
    like, blocked = next((attribute.Get(code) for code in samples), None), blocked_codes(attribute)
    default, declared = attribute.Get(), attribute.GetTypeName().defaultValue
    if hasattr(type(declared), "FromNumpy"):
        # A file may hold values of another type than the schema declares, such as whole numbers.
        like = declared
    for code, values in samples.items():
        written = from_numpy(values, like, element_size)
        attribute.Set(written, code)
        if default is not None and Usd.TimeCode.Default() not in samples:
            # Else the old one would show through at the default time.
            attribute.Set(written)
            default = None
        saved(values.nbytes)
    for code in blocked:
        attribute.Set(Sdf.ValueBlock(), code)


def _anchored(attribute: Usd.Attribute, code: Usd.TimeCode, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Asset paths made independent of the layer they come from; other values as they are."""
    if str(attribute.GetTypeName()) != "asset[]":
        return values
    layer = attribute.GetPropertyStack(code)[0].layer
    return np.frompyfunc(lambda value: anchored(value, layer), 1, 1)(values)
