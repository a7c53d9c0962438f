"""How much each vertex matters: cost weights, quadric scales, and the vertices that keep their position."""

from __future__ import annotations

from typing import Any

import numpy as np

from warpqem.arguments.array_input import as_numpy, first_outside, real_array
from warpqem.errors import MeshShapeError, OptionError
from warpqem.mesh.edges import edge_table
from warpqem.mesh.mesh_input import MeshInput, as_vertex_values

__all__ = ["MAX_WEIGHT", "border_vertices", "check_factors", "lock_mask", "read_quadric_scale", "read_weights"]

# Weights above this would leave float32 no room for costs, which then count as forbidden.
MAX_WEIGHT = 1e12


def read_weights(vertex_weights: Any, mesh: MeshInput) -> tuple[np.ndarray, np.ndarray]:
    """Check factors on the cost at each vertex, (V,) numbers or None.

    Returns:
        The factors, (V,) float32, and which vertices an infinite one locks, (V,) bool; their factor is 1.
    """
    if vertex_weights is None:
        return np.ones(mesh.vertex_count, dtype=np.float32), np.zeros(mesh.vertex_count, dtype=bool)
    weights = real_array(
        vertex_weights,
        "vertex_weights",
        (mesh.vertex_count,),
        expected=f"{mesh.vertex_count} numbers, one per vertex",
        bools=True,
    )
    locked = np.isposinf(weights)
    weights = np.where(locked, weights.dtype.type(1), weights)
    hint = "; use locked, or infinity, for vertices that must not move"
    return _factors(as_vertex_values(weights, "vertex_weights", mesh.vertex_count), "vertex_weights", hint), locked


def read_quadric_scale(quadric_scale: Any, mesh: MeshInput) -> np.ndarray:
    """Check factors on the initial quadric of each vertex, (V,) numbers or None; (V,) float32."""
    if quadric_scale is None:
        return np.ones(mesh.vertex_count, dtype=np.float32)
    return _factors(as_vertex_values(quadric_scale, "quadric_scale", mesh.vertex_count), "quadric_scale")


def check_factors(weights: Any, vertex_count: int, origin: str) -> np.ndarray:
    """Check factors that a function gave, (V,) float32; ``origin`` begins the message.

    Raises:
        OptionError: they have another shape, or one is negative, too large or no number.
    """
    try:
        own = as_numpy(weights, origin)
    except MeshShapeError as error:
        raise OptionError(str(error)) from error
    if own.shape != (vertex_count,) or own.dtype.kind not in "fiu":
        raise OptionError(f"{origin} {own.dtype} of shape {own.shape}, expected {vertex_count} numbers")
    outside = np.flatnonzero(~((own >= 0) & (own <= MAX_WEIGHT)))
    if len(outside):
        vertex = int(outside[0])
        raise OptionError(f"{origin} {own[vertex]} at vertex {vertex}, expected 0 to {MAX_WEIGHT:g}")
    return own.astype(np.float32)


def _factors(values: np.ndarray, name: str, hint: str = "") -> np.ndarray:
    """Finite numbers (V,) as float32, if all are in the range of a factor."""
    # Before they are rounded: what is too large would become infinite, and what is hardly negative zero.
    wide = values.astype(np.float64, copy=False)
    outside = np.flatnonzero((wide < 0) | (wide > MAX_WEIGHT))
    if len(outside):
        vertex = int(outside[0])
        raise OptionError(f"{name} must be in [0, {MAX_WEIGHT:g}], got {values[vertex]} at vertex {vertex}{hint}")
    return values.astype(np.float32)


def lock_mask(locked: Any, vertex_count: int) -> np.ndarray:
    """Vertices that keep their position, (V,) bool, from such a mask, from indices, or None for none."""
    mask = np.zeros(vertex_count, dtype=bool)
    if locked is None:
        return mask
    array = as_numpy(locked, "locked")
    if array.dtype == bool:
        if array.shape != (vertex_count,):
            raise OptionError(f"locked must have one entry for each of {vertex_count} vertices, got {array.shape}")
        return array.copy()
    if array.shape == (0,):
        return mask
    if array.ndim != 1 or array.dtype.kind not in "iu":
        raise OptionError(f"locked must be (V,) bool or vertex indices, got shape {array.shape} dtype {array.dtype}")
    outside = first_outside(array, vertex_count)
    if outside is not None:
        raise OptionError(
            f"locked names vertex {array[outside]}, but there are {vertex_count} vertices (index {outside[0]})"
        )
    # As indices these would lock two vertices, over and over.
    if len(array) == vertex_count > 2 and array.max() <= 1:
        raise OptionError(
            f"locked has {vertex_count} integers, one for each vertex, all 0 or 1: a mask must be bool (astype(bool))"
        )
    mask[array] = True
    return mask


def border_vertices(mesh: MeshInput) -> np.ndarray:
    """(V,) bool, the ends of edges with one face."""
    edges = edge_table(mesh.faces)
    mask = np.zeros(mesh.vertex_count, dtype=bool)
    mask[edges.ends[edges.face_count == 1]] = True
    return mask
