"""The wedges of a mesh with attributes, and each vertex's first attribute quadric."""

from __future__ import annotations

import numpy as np
import warp as wp

from warpqem.kernels.mesh_state import Point, Quadric, Wedges
from warpqem.runtime import new_arrays

__all__ = ["build_wedges", "face_gradients"]

# A face whose height is below this part of its longest side has no gradient across that float32 positions could tell:
# the values would seem to change without bound, and the vertices at a sliver to be held for ever.
SLIVER = 1e-3


def build_wedges(corner_vertex: wp.array, key_position: wp.array, values: np.ndarray | None, key_count: int) -> Wedges:
    """Wedges for :mod:`warpqem.kernels.attribute`.

    The collapse order weighs the attribute error as if it were the same in each of the K key frames.

    Args:
        corner_vertex: (3N,) int32.
        key_position: (V, B) blocks of points, in diagonals; the first key frame is the reference.
        values: (N, 3, C) float, the attributes at the corners, times their weights; None for none.
        key_count: key frames K.
    """
    wedges, device = Wedges(), key_position.device
    if values is None:
        wedges.channel_count = 0
        wedges.corner_wedge = new_arrays.empty(0, dtype=wp.int32, device=device)
        return wedges
    vertex_count, faces = len(key_position), corner_vertex.numpy().reshape(-1, 3)
    points = key_position[:, :1].numpy()[:, 0, :, 0].astype(np.float64)
    # Differences count, not values: float32 is finest about the middle.
    corner_value = (values - values.mean(axis=(0, 1))).reshape(faces.size, -1) * np.sqrt(key_count)
    corner_wedge, first = _share_values(faces.ravel(), corner_value)
    area, gradient = face_gradients(points[faces], corner_value.reshape(*faces.shape, -1))
    corner_area, corner_gradient = np.repeat(area, 3), np.repeat(gradient, 3, axis=0)
    weighted = corner_area[:, None, None] * corner_gradient
    wedge_area = np.bincount(corner_wedge, corner_area)
    # Where no face has an area the sum is zero too.
    divisor = np.where(wedge_area > 0, wedge_area, 1.0)[:, None, None]
    mean = _sum_rows(corner_wedge, weighted, len(first)) / divisor
    spread = corner_gradient - mean[corner_wedge]
    row, column = np.triu_indices(3)
    matrix = np.einsum("h,hci,hcj->hij", corner_area, spread, spread)[:, row, column]
    quadric = np.zeros((vertex_count, 10), dtype=np.float32)
    quadric[:, :6] = _sum_rows(faces.ravel(), matrix, vertex_count)
    wedges.channel_count = corner_value.shape[1]
    wedges.corner_wedge = new_arrays.uploaded(corner_wedge, dtype=wp.int32, device=device)
    wedges.area = new_arrays.uploaded(wedge_area, dtype=wp.float32, device=device)
    wedges.origin = _columns(points[faces.ravel()[first]], Point, device)
    wedges.value = new_arrays.uploaded(corner_value[first], dtype=wp.float32, device=device)
    wedges.gradient = _columns(mean, Point, device)
    wedges.position = _columns(points, Point, device)
    wedges.quadric = _columns(quadric, Quadric, device)
    return wedges


def _columns(values: np.ndarray, dtype: type, device: str) -> wp.array:
    """Blocks of one frame: (...) of (D, 1) matrices from (..., D)."""
    return new_arrays.uploaded(values[..., None].astype(np.float32), dtype=dtype, device=device)


def _share_values(corner_vertex: np.ndarray, corner_value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The wedge of each corner (3N,) and one corner of each wedge (W,)."""
    order = np.lexsort((*corner_value.T, corner_vertex))
    new = np.ones(len(order), dtype=bool)
    new[1:] = corner_vertex[order[1:]] != corner_vertex[order[:-1]]
    new[1:] |= (corner_value[order[1:]] != corner_value[order[:-1]]).any(axis=1)
    wedge = np.empty(len(order), dtype=np.int64)
    wedge[order] = np.cumsum(new) - 1
    return wedge, order[new]


def face_gradients(corners: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Area (N,) and gradients (N, C, 3) of the linear functions with ``values`` (N, 3, C) at ``corners`` (N, 3, 3)."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(first, second)
    square = (normal**2).sum(axis=1)
    longest = np.max([(first**2).sum(axis=1), (second**2).sum(axis=1), ((second - first) ** 2).sum(axis=1)], axis=0)
    # |normal| = height x longest side.
    square = np.where(square > (SLIVER * longest) ** 2, square, np.inf)
    across = np.stack([np.cross(second, normal), np.cross(normal, first)], axis=1) / square[:, None, None]
    gradient = np.einsum("nkc,nki->nci", values[:, 1:] - values[:, :1], across)
    return 0.5 * np.linalg.norm(normal, axis=1), gradient


def _sum_rows(index: np.ndarray, rows: np.ndarray, count: int) -> np.ndarray:
    """Sums of ``rows`` (M, ...) that share an index, (count, ...)."""
    flat = rows.reshape(len(rows), -1)
    sums = [np.bincount(index, column, minlength=count) for column in flat.T]
    return np.stack(sums, axis=1).reshape(count, *rows.shape[1:])
