"""Importance painted on a mesh: a primvar that scales the cost of collapses at each vertex, or its quadric.

User-guided simplification (Kho & Garland 2003) scales quadrics: the weights stay with the planes as they add up, and
merged vertices go nearer to those that count more. A scaled cost changes the order of collapses alone, and a merged
vertex gets the mean of both weights.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom

from warpqem.costs.weights import MAX_WEIGHT
from warpqem.errors import OptionError, StageError
from warpqem.usd.commands.mesh_job import MeshJob
from warpqem.usd.commands.option_checks import bare_name
from warpqem.usd.read.value_arrays import element_size, primvar_samples

__all__ = ["check_weight_primvar", "painted_options", "painted_weights"]


def check_weight_primvar(prims: Iterable[Usd.Prim], name: str | None) -> None:
    """Check that one of the meshes at least has the primvar.

    Raises:
        OptionError: none has it.
    """
    prims = list(prims)
    if name is not None and prims and not any(_find(prim, name) for prim in prims):
        raise OptionError(f"weight_primvar: none of the {len(prims)} meshes has a primvar {bare_name(name)}")


def painted_options(job: MeshJob, name: str | None, scales: str) -> dict[str, npt.NDArray[Any]]:
    """Options of `warpqem.simplify` for painted weights: vertex_weights, or quadric_scale and locked.

    Args:
        job: The mesh.
        name: Name of the primvar; None for no weights.
        scales: What the weights scale, one of `warpqem.usd.commands.simplify_options.WeightScales`.

    Raises:
        StageError: as for `painted_weights`.
    """
    weights = painted_weights(job, name)
    if weights is None:
        return {}
    if scales == "cost":
        return {"vertex_weights": weights}
    locked = np.isposinf(weights)
    return {"quadric_scale": np.where(locked, 1.0, weights), "locked": locked}


def painted_weights(job: MeshJob, name: str | None) -> npt.NDArray[np.float64] | None:
    """Factors at the vertices of a mesh, (V,), infinite where they are locked; None without the primvar.

    A vertex gets the largest value of its samples, points, faces or corners: what is important at one of them is there.
    A constant one, which may be inherited, says how much the mesh counts beside others.

    Args:
        job: The mesh.
        name: Name of the primvar; None for no weights.

    Raises:
        StageError: the primvar has no number for each point, face or corner, or one that is negative, too large or NaN.
    """
    primvar = None if name is None else _find(job.source.prim, name)
    if primvar is None:
        return None
    path, topology = primvar.GetAttr().GetPath(), job.source.topology
    # Elements that the triangles' corners take their value from, and how many there should be.
    places = {
        UsdGeom.Tokens.constant: (1, np.zeros_like(topology.triangles)),
        UsdGeom.Tokens.uniform: (topology.polygon_count, np.repeat(topology.triangle_polygons[:, None], 3, axis=1)),
        UsdGeom.Tokens.vertex: (job.source.point_count, topology.triangles),
        UsdGeom.Tokens.varying: (job.source.point_count, topology.triangles),
        UsdGeom.Tokens.faceVarying: (topology.corner_count, topology.triangle_corners),
    }
    count, element = places[str(primvar.GetInterpolation())]
    samples = primvar_samples(primvar, element_size(primvar, count))
    if not samples:
        raise StageError(f"{path}: has no values that could be weights")
    weights = np.zeros(job.frames.vertex_count)
    for code, values in samples.items():
        where = "" if code.IsDefault() else f" at time {code.GetValue():g}"
        if values.shape != (count,) or values.dtype.kind not in "fiub":
            raise StageError(
                f"{path}: {len(values)} values of type {primvar.GetTypeName()}{where}, expected a number for each of "
                f"{count} elements ({primvar.GetInterpolation()})"
            )
        numbers = values.astype(np.float64)
        wrong = np.flatnonzero(~((numbers >= 0) & ((numbers <= MAX_WEIGHT) | np.isposinf(numbers))))
        if len(wrong):
            raise StageError(
                f"{path}: value {int(wrong[0])} is {numbers[wrong[0]]:g}{where}; a weight is a number from 0 to "
                f"{MAX_WEIGHT:g}, or infinity to lock the vertex"
            )
        np.maximum.at(weights, job.faces, numbers[element])
    return weights


def _find(prim: Usd.Prim, name: str) -> UsdGeom.Primvar | None:
    """The primvar on the mesh, or a constant one that it inherits."""
    primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance(bare_name(name))
    return primvar if primvar and primvar.HasAuthoredValue() else None
