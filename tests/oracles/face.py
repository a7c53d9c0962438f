"""Equation 1 of multiresolution facial animation in float64: ``e_i = w Q(v_i) + sum_j w Q(v_j)``."""

import numpy as np

from tests.oracles.quadrics import Quadric, shifted, vertex_quadrics


def neighbours(faces, vertex: int, ring: int) -> set[int]:
    """Vertices up to so many edges away from one, without itself."""
    reached = {vertex}
    for _ in range(ring):
        reached |= {int(v) for face in np.asarray(faces) if reached & set(face.tolist()) for v in face}
    return reached - {vertex}


def equation_one(points, faces, vertex: int, weight: float, ring: int = 1) -> Quadric:
    """The quadric of a feature point in one frame (V, 3), about itself."""
    x = np.asarray(points, dtype=np.float64)
    own = vertex_quadrics(x, faces)
    total = own[vertex].scaled(weight)
    for near in sorted(neighbours(faces, vertex, ring)):
        total += shifted(own[near], x[vertex] - x[near]).scaled(weight)
    return total
