"""Masks and skin weights that follow the surface: diffusion of labels over a mesh."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, diags
from scipy.sparse.linalg import splu


def diffuse(points: NDArray, faces: NDArray, values: NDArray, reach: NDArray) -> NDArray[np.float64]:
    """Return `values` ``(V, S)`` smoothed over the surface, each vertex over the length `reach` ``(V,)``.

    Solves ``(M / reach^2 + L) w = M / reach^2 values`` with the vertex areas M and the cotangent Laplacian L, one
    implicit step of heat flow, as the bone heat of Baran and Popovic, "Automatic rigging and animation of 3D
    characters" (SIGGRAPH 2007). Values spread along the surface only, never through the air between two legs.
    Negative cotangents are cut to zero, so the result stays within the range of the values.
    """
    vertex_count = len(points)
    corner = np.asarray(points, float)[faces]
    rows, columns, entries = [], [], []
    double_area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    for k in range(3):
        u, v = corner[:, k - 2] - corner[:, k], corner[:, k - 1] - corner[:, k]
        half_cotangent = np.maximum((u * v).sum(axis=1) / np.maximum(double_area, 1e-30), 0.0) / 2.0
        a, b = faces[:, k - 2], faces[:, k - 1]
        rows += [a, b]
        columns += [b, a]
        entries += [half_cotangent, half_cotangent]
    shape = (vertex_count, vertex_count)
    adjacency = coo_matrix((np.concatenate(entries), (np.concatenate(rows), np.concatenate(columns))), shape).tocsc()
    laplacian = diags(np.asarray(adjacency.sum(axis=1)).ravel()) - adjacency
    area = np.bincount(faces.ravel(), np.repeat(double_area / 6.0, 3), minlength=vertex_count)
    hold = area / np.asarray(reach, float) ** 2
    return splu((laplacian + diags(hold)).tocsc()).solve(hold[:, None] * values)


def strongest_influences(weights: NDArray, count: int = 4) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Return the `count` largest columns of `weights` ``(V, J)`` per row and their values, made to sum to one.

    Both results are ``(V, count)``, largest first. Weights under 1 percent are set to zero before.
    """
    # Rounded, and sorted stably, so that equal weights keep the order of the joints on every machine.
    kept = np.round(np.where(weights < 0.01, 0.0, weights), 9)
    order = np.argsort(-kept, axis=1, kind="stable")[:, :count]
    values = np.take_along_axis(kept, order, axis=1)
    values /= values.sum(axis=1, keepdims=True)
    return order.astype(np.int32), values.astype(np.float32)
