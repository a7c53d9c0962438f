"""Colours of new vertices: what fits the colours of the surface that each stands for, not the one point it lies on.

Where a colour ends over a single edge, a vertex beside it lies on a mixture of both colours, and would spread it over
its large new faces. The value that deviates least from the faces it stands for is the mean of their linear functions at
its place, weighted by area (Hoppe 1999, "New quadric metric for simplifying meshes with appearance attributes"): the
value that the order of collapses reckons with, see `warpqem.kernels.attribute`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from warpqem.decimation.attribute_quadrics import face_gradients

__all__ = ["fitted_values"]


def fitted_values(
    values: npt.NDArray[Any],
    points: npt.NDArray[np.floating],
    faces: npt.NDArray[np.int32],
    cluster: npt.NDArray[np.int32],
    new_points: npt.NDArray[np.floating],
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
    """Values at the vertices of a simplified mesh that fit those at the corners of the input's faces.

    They lie between the smallest and the largest value of the corners that a vertex stands for, in each channel.

    Args:
        values: (N, 3, C) at the corners of the input's faces.
        points: (V, 3), the input in one pose.
        faces: int32, shape (N, 3); faces that name a vertex twice count nothing.
        cluster: int32, shape (N, 3), the new vertex that each corner's vertex became; -1 for none.
        new_points: (V', 3), the new vertices in that pose.

    Returns:
        float64, shape (V', C), and whether there is a value: a vertex all of whose faces have no area has none.
    """
    corner_values, corners = values.astype(np.float64), points[faces].astype(np.float64)
    area, gradient = face_gradients(corners, corner_values)
    vertex, corner = cluster.ravel(), np.repeat(area, 3)
    used = (vertex >= 0) & (corner > 0)
    vertex, weight = vertex[used], corner[used]
    own = corner_values.reshape(-1, values.shape[-1])[used]
    offset = new_points.astype(np.float64)[vertex] - corners.reshape(-1, 3)[used]
    moved = own + np.einsum("hci,hi->hc", np.repeat(gradient, 3, axis=0)[used], offset)
    count = len(new_points)
    total = np.bincount(vertex, weight, count)
    sums = np.stack([np.bincount(vertex, weight * channel, count) for channel in moved.T], axis=1)
    mean = np.divide(sums, total[:, None], out=np.zeros_like(sums), where=total[:, None] > 0)
    low, high = np.full_like(mean, np.inf), np.full_like(mean, -np.inf)
    np.minimum.at(low, vertex, own)
    np.maximum.at(high, vertex, own)
    found = total > 0
    return np.where(found[:, None], np.clip(mean, low, high), 0.0), found
