"""Quadrics ``x^T A x + 2 b.x + c`` as triples (A, b, c)."""

from typing import NamedTuple

import numpy as np


class Quadric(NamedTuple):
    A: np.ndarray  # (3, 3)
    b: np.ndarray  # (3,)
    c: float

    def __add__(self, other):
        return Quadric(self.A + other.A, self.b + other.b, self.c + other.c)

    def scaled(self, factor):
        return Quadric(self.A * factor, self.b * factor, self.c * factor)

    def __call__(self, x):
        return float(x @ self.A @ x + 2 * self.b @ x + self.c)


def zero() -> Quadric:
    return Quadric(np.zeros((3, 3)), np.zeros(3), 0.0)


def pack(q: Quadric) -> np.ndarray:
    """The ten floats of the kernels."""
    return np.array([*q.A[np.triu_indices(3)], *q.b, q.c])


def unpack(values: np.ndarray) -> Quadric:
    v = np.asarray(values, dtype=np.float64)
    matrix = np.array([[v[0], v[1], v[2]], [v[1], v[3], v[4]], [v[2], v[4], v[5]]])
    return Quadric(matrix, v[6:9], float(v[9]))


def plane(normal, point, weight=1.0) -> Quadric:
    """``weight`` times the squared distance from the plane through ``point``; ``normal`` need not have length 1."""
    normal = np.asarray(normal, dtype=np.float64)
    length = np.linalg.norm(normal)
    if length == 0:
        return zero()
    n = normal / length
    offset = -n @ point
    return Quadric(np.outer(n, n), offset * n, offset * offset).scaled(weight)


def shifted(q: Quadric, d) -> Quadric:
    """The same function of space, written about an origin moved by ``d``."""
    return Quadric(q.A, q.b + q.A @ d, q(np.asarray(d)))


def minimiser(q: Quadric, epsilon: float) -> np.ndarray:
    """``argmin Q(x) + epsilon tr(A) |x|^2``."""
    return np.linalg.solve(q.A + epsilon * np.trace(q.A) * np.eye(3), -q.b)


def tangential_minimiser(q: Quadric, epsilon: float) -> np.ndarray:
    """``argmin Q(x) + epsilon x^T (tr(A) I - A) x``."""
    return np.linalg.solve(q.A + epsilon * (np.trace(q.A) * np.eye(3) - q.A), -q.b)


def border_half_edges(faces) -> list[tuple[int, int, int]]:
    """(tail, head, opposite corner) of the half-edges without an opposite half-edge."""
    directed = {(int(f[k]), int(f[(k + 1) % 3])) for f in faces for k in range(3)}
    return [
        (int(f[k]), int(f[(k + 1) % 3]), int(f[(k + 2) % 3]))
        for f in faces
        for k in range(3)
        if (int(f[(k + 1) % 3]), int(f[k])) not in directed
    ]


def face_plane(p, q, r, origin) -> Quadric:
    """A face's plane weighted by its area, about ``origin``."""
    cross = np.cross(q - p, r - p)
    return plane(cross, p - origin, 0.5 * np.linalg.norm(cross))


def border_plane(p, q, r, origin, weight=1.0) -> Quadric:
    """The plane through ``p q`` perpendicular to the face ``p q r``, weighted by the squared length of ``p q``."""
    return plane(np.cross(q - p, np.cross(q - p, r - p)), p - origin, weight * float((q - p) @ (q - p)))


def vertex_quadrics(points, faces, border_weight=1.0, origin=None) -> list[Quadric]:
    """Quadric of every vertex in one frame (V, 3), about itself, or about ``origin`` (V, 3) where given."""
    x = np.asarray(points, dtype=np.float64)
    o = x if origin is None else np.asarray(origin, dtype=np.float64)
    result = [zero() for _ in x]
    for a, b, c in np.asarray(faces):
        for v in (a, b, c):
            result[v] += face_plane(x[a], x[b], x[c], o[v])
    for a, b, c in border_half_edges(faces):
        for v in (a, b):
            result[v] += border_plane(x[a], x[b], x[c], o[v], border_weight)
    return result
