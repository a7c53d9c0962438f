"""The attribute error of merged vertices, from the faces that they stand for."""

import numpy as np


def face_function(corners, values):
    """``(area, G (C, 3), d (C,))`` of the linear functions ``G x + d`` with ``values`` (3, C) at ``corners`` (3, 3)."""
    corners, values = np.asarray(corners, dtype=np.float64), np.asarray(values, dtype=np.float64)
    first, second = corners[1] - corners[0], corners[2] - corners[0]
    normal = np.cross(first, second)
    gradient = np.linalg.solve(
        np.array([first, second, normal]), np.array([values[1] - values[0], values[2] - values[0], 0 * values[0]])
    ).T
    return np.linalg.norm(normal) / 2, gradient, values[0] - gradient @ corners[0]


class AttributeClusters:
    """Wedges and what has merged into them, by name only: every figure is taken from the input faces anew.

    Args:
        points: (V, 3), the reference frame.
        faces: (N, 3).
        values: (N, 3, C).
    """

    def __init__(self, points, faces, values):
        self.function = [face_function(points[face], v) for face, v in zip(faces, values, strict=True)]
        names = [(int(v), *row) for v, row in zip(faces.ravel(), values.reshape(faces.size, -1).tolist(), strict=True)]
        index = {name: i for i, name in enumerate(dict.fromkeys(names))}
        self.corner_wedge = np.array([index[name] for name in names])
        self.wedge_vertex = np.array([name[0] for name in index])
        self.corner_vertex = faces.ravel().copy()

    def _merged(self, u, v):
        """The wedge of each corner once the faces at ``u v`` have joined their wedges."""
        wedge = self.corner_wedge.copy()
        for corners in np.arange(len(wedge)).reshape(-1, 3):
            at = {int(self.corner_vertex[c]): c for c in corners}
            if len(at) == 3 and u in at and v in at:
                wedge[wedge == wedge[at[v]]] = wedge[at[u]]
        return wedge

    def merge(self, u, v):
        """Collapse ``v`` into ``u``."""
        self.corner_wedge = self._merged(u, v)
        self.corner_vertex[self.corner_vertex == v] = u

    def error(self, u, v, x):
        """Sum over the wedges of the merged vertex of ``min_s sum_f area_f |a_f(x) - s|^2``."""
        wedge = self._merged(u, v)
        total = 0.0
        here = np.isin(self.corner_vertex, [u, v])
        for w in np.unique(wedge[here]):
            functions = [self.function[c // 3] for c in np.flatnonzero(here & (wedge == w))]
            area = np.array([f[0] for f in functions])
            value = np.array([f[1] @ x + f[2] for f in functions])
            total += (area[:, None] * (value - area @ value / area.sum()) ** 2).sum()
        return total
