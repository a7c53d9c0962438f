"""How much each vertex matters: cost weights, quadric scales, and the vertices that keep their position."""

from __future__ import annotations

from typing import Any

import numpy as np

from warpqem.edges import edge_table
from warpqem.errors import OptionError
from warpqem.mesh_input import MeshInput, as_numpy, as_vertex_values

__all__ = ["MOST_WEIGHT", "border_vertices", "check_factors", "lock_mask", "read_quadric_scale", "read_weights"]

# Weights above this would leave float32 no room for costs, which then count as forbidden.
MOST_WEIGHT = 1e12


def read_weights(vertex_weights: Any, mesh: MeshInput) -> tuple[np.ndarray, np.ndarray]:
    """Check factors on the cost at each vertex, (V,) numbers or None.

    Returns:
        The factors, (V,) float32, and which vertices an infinite one locks, (V,) bool; their factor is 1.
    """
    if vertex_weights is None:
        return np.ones(mesh.vertex_count, dtype=np.float32), np.zeros(mesh.vertex_count, dtype=bool)
    weights = as_numpy(vertex_weights)
    locked = np.zeros(mesh.vertex_count, dtype=bool)
    if weights.shape == locked.shape and weights.dtype.kind == "f":
        locked = np.isposinf(weights)
        weights = np.where(locked, 1.0, weights)
    own = as_vertex_values(weights, "vertex_weights", mesh.vertex_count)
    outside = np.flatnonzero((own < 0) | (own > MOST_WEIGHT))
    if len(outside):
        vertex = int(outside[0])
        raise OptionError(
            f"vertex_weights must be in [0, {MOST_WEIGHT:g}], got {own[vertex]} at vertex {vertex}; "
            "use locked, or infinity, for vertices that must not move"
        )
    return own, locked


def check_factors(weights: Any, vertex_count: int, origin: str) -> np.ndarray:
    """Check factors that a function gave, (V,) float32; ``origin`` begins the message.

    Raises:
        OptionError: they have another shape, or one is negative, too large or no number.
    """
    own = np.asarray(weights)
    if own.shape != (vertex_count,) or own.dtype.kind not in "fiu":
        raise OptionError(f"{origin} {own.dtype} of shape {own.shape}, expected {vertex_count} numbers")
    outside = np.flatnonzero(~((own >= 0) & (own <= MOST_WEIGHT)))
    if len(outside):
        vertex = int(outside[0])
        raise OptionError(f"{origin} {own[vertex]} at vertex {vertex}, expected 0 to {MOST_WEIGHT:g}")
    return own.astype(np.float32)


def read_quadric_scale(quadric_scale: Any, mesh: MeshInput) -> np.ndarray:
    """Check factors on the initial quadric of each vertex, (V,) numbers or None; (V,) float32."""
    if quadric_scale is None:
        return np.ones(mesh.vertex_count, dtype=np.float32)
    scale = as_vertex_values(quadric_scale, "quadric_scale", mesh.vertex_count)
    outside = np.flatnonzero((scale < 0) | (scale > MOST_WEIGHT))
    if len(outside):
        vertex = int(outside[0])
        raise OptionError(f"quadric_scale must be in [0, {MOST_WEIGHT:g}], got {scale[vertex]} at vertex {vertex}")
    return scale


def lock_mask(locked: Any, vertex_count: int) -> np.ndarray:
    """Vertices that keep their position, (V,) bool, from such a mask, from indices, or None for none."""
    mask = np.zeros(vertex_count, dtype=bool)
    if locked is None:
        return mask
    array = as_numpy(locked)
    if array.dtype == bool:
        if array.shape != (vertex_count,):
            raise OptionError(f"locked must have one entry for each of {vertex_count} vertices, got {array.shape}")
        return array.copy()
    if array.ndim != 1 or (array.size and array.dtype.kind not in "iu"):
        raise OptionError(f"locked must be (V,) bool or vertex indices, got shape {array.shape} dtype {array.dtype}")
    outside = (array < 0) | (array >= vertex_count)
    if outside.any():
        raise OptionError(f"locked names vertex {array[outside][0]}, but there are {vertex_count} vertices")
    mask[array.astype(np.int64)] = True
    return mask


def border_vertices(mesh: MeshInput) -> np.ndarray:
    """(V,) bool, the ends of edges with one face."""
    edges = edge_table(mesh.faces)
    mask = np.zeros(mesh.vertex_count, dtype=bool)
    mask[edges.ends[edges.face_count == 1]] = True
    return mask
