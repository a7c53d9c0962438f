"""The inversion test of animated mesh simplification based on motion features (Yang et al. 2019), equation 7."""

import numpy as np


def inversion_sum(before, after, weight_before, weight_after) -> float:
    """``sum_f n(t)^T n(t') sqrt(A(t) A(t') w_t w_t')`` of a triangle before and after a collapse.

    ``before`` and ``after`` are (F, 3, 3) corners; a triangle weighs as much as its three vertices together. Below zero
    the collapse is forbidden.
    """
    total = 0.0
    for old, new in zip(np.float64(before), np.float64(after), strict=True):
        normals = [np.cross(t[1] - t[0], t[2] - t[0]) for t in (old, new)]
        areas = [0.5 * np.linalg.norm(n) for n in normals]
        n, m = (normal / np.linalg.norm(normal) for normal in normals)
        total += n @ m * np.sqrt(areas[0] * areas[1] * sum(weight_before) * sum(weight_after))
    return total
