"""Fit values of primvars and normals to the input's surface, once they have been transferred to the new mesh."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom

from warpqem.attribute_fit.texture import fit_texture, reference_signs
from warpqem.attribute_fit.values import (
    NormalErrors,
    fit_normals,
    fit_smooth_values,
    normal_errors,
    normal_misfits,
    own_normals,
    split_normals,
)
from warpqem.mesh.directions import unit_vectors
from warpqem.usd.read.texture_coordinates import is_uv
from warpqem.usd.read.value_arrays import Samples, is_continuous, is_normal, is_quaternion
from warpqem.usd.write.attribute_transfer import AttributeTransfer
from warpqem.usd.write.spread import spread

__all__ = ["fit_normal_offsets", "fit_transferred", "kind_of_values"]

Kind = Literal["normals", "texture", "smooth"]
CornerRows = npt.NDArray[np.int32]

# Samples over time that decide where normals are split: far more than it takes to see an edge.
MAX_SPLIT_SAMPLES = 8
POINT_INTERPOLATIONS = (UsdGeom.Tokens.vertex, UsdGeom.Tokens.varying)


@dataclass(frozen=True)
class _Normals:
    """Normals at a time, all of length one.

    Attributes:
        wanted: float64, shape (E, 3), of the input.
        start: float64, shape (R, 3), transferred.
        misfit: float64, shape (N', 3, 3), what these miss, see :func:`warpqem.attribute_fit.values.normal_misfits`.
    """

    wanted: npt.NDArray[np.float64]
    start: npt.NDArray[np.float64]
    misfit: npt.NDArray[np.float64]


def kind_of_values(primvar: UsdGeom.Primvar) -> Kind | None:
    """How a primvar is fitted; None for values between which nothing lies, and for those of faces."""
    value = primvar.GetAttr().Get(Usd.TimeCode.EarliestTime())
    if str(primvar.GetInterpolation()) not in (*POINT_INTERPOLATIONS, UsdGeom.Tokens.faceVarying):
        return None
    if not is_continuous(value) or is_quaternion(value):
        return None
    if is_normal(primvar.GetTypeName()) or str(primvar.GetPrimvarName()) == "normals":
        return "normals"
    return "texture" if is_uv(primvar) else "smooth"


def fit_transferred(
    transfer: AttributeTransfer,
    name: str,
    kind: Kind,
    interpolation: str,
    samples: Samples,
    transferred: Samples,
    corner_row: CornerRows | None,
) -> tuple[Samples, CornerRows | None]:
    """Fit transferred values.

    Args:
        transfer: Where they come from.
        name: The attribute.
        kind: What they are.
        interpolation: Of the input.
        samples: Those of the input.
        transferred: What became of them at points, or at rows that ``corner_row`` names.
        corner_row: int32, shape (N', 3); None for values at points.

    Returns:
        The fitted ones, and the row of each corner; normals at points may have become values at corners. Normals
        that would be further from the input's stay as transferred.
    """
    first = next(iter(transferred.values()))
    if first[:1].size not in ((3,) if kind == "normals" else (2,) if kind == "texture" else range(1, 17)):
        return transferred, corner_row
    layout = transfer.layout(name, interpolation in POINT_INTERPOLATIONS, corner_row, kind != "normals")

    def start(code: Usd.TimeCode) -> npt.NDArray[np.float64]:
        return _flat(transferred[code])

    if kind != "normals":

        def fitted(code: Usd.TimeCode) -> npt.NDArray[Any]:
            like, values = transferred[code], _flat(samples[code])
            if not np.isfinite(values).all():
                # Painted weights may be infinite, and nothing lies between those and others.
                return like
            if kind == "texture":
                signs = reference_signs(layout, values, transfer.source_faces, transfer.turned_faces)
                found = fit_texture(transfer.faces, layout, values, start(code), signs)
            else:
                found = fit_smooth_values(layout, values, start(code))
            return found.reshape(like.shape).astype(like.dtype)

        return Samples(list(transferred), fitted), corner_row
    chosen = spread(list(transferred), MAX_SPLIT_SAMPLES)

    def normals_at(code: Usd.TimeCode) -> _Normals:
        wanted, begin = unit_vectors(_flat(samples[code])), unit_vectors(start(code))
        return _Normals(wanted, begin, normal_misfits(layout, wanted, begin))

    known = {code: normals_at(code) for code in chosen}
    own = (own_normals(layout, one.misfit, one.start) for one in known.values())
    split, row = split_normals(transfer.faces, layout, own)

    def fitted_normals(code: Usd.TimeCode, given: _Normals) -> npt.NDArray[Any]:
        return fit_normals(split, given.misfit, given.start[row]).astype(transferred[code].dtype)

    held = {code: fitted_normals(code, one) for code, one in known.items()}
    errors, both_ways = [], replace(layout, input_samples=transfer.input_samples())
    for code, one in known.items():
        kept, fitted_ones = one.start[layout.corner_row], held[code][split.corner_row]
        errors.append(normal_errors(both_ways, one.wanted, kept, fitted_ones))
    before, after = (NormalErrors.over_poses(one) for one in zip(*errors, strict=True))
    if not after.is_within(before):
        # Of a few faces a fit may be off by more on average, where an edge that went draws all of it aside.
        return transferred, corner_row

    def held_or_fitted(code: Usd.TimeCode) -> npt.NDArray[Any]:
        return held[code] if code in held else fitted_normals(code, normals_at(code))

    return Samples(list(transferred), held_or_fitted), corner_row if split is layout else split.corner_row


def fit_normal_offsets(
    transfer: AttributeTransfer, offsets: npt.NDArray[np.float32], start: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Fit what a blend shape adds to normals.

    Args:
        transfer: Where it comes from.
        offsets: float32, shape (P, 3), at the points of the input.
        start: float64, shape (V', 3), transferred; points without any get none.
    """
    if not np.isfinite(offsets).all():
        return start
    layout = transfer.layout("normalOffsets", True, None)
    return fit_smooth_values(layout, _flat(offsets), start, (start != 0).any(axis=1))


def _flat(values: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    return values.reshape(len(values), -1).astype(np.float64)
