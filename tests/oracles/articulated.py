"""``E(v, a)`` of "Simplification of articulated meshes" (Landreneau & Schaefer 2009), as the paper writes it.

``E(v, a) = sum_j p_j^T Q_j p_j`` with ``p_j = sum_k a_k M_k^j v``; points are homogeneous and ``Q_j`` is 4x4: the
planes of the faces of all vertices that were merged, in pose ``j``.
"""

import numpy as np


def plane_quadric(pose, faces, vertices):
    """``Q`` (4, 4): planes of a pose (V, 3), by area, once for each of the vertices that a face has."""
    total = np.zeros((4, 4))
    x = pose.astype(np.float64)
    for face in faces[np.isin(faces, vertices).any(axis=1)]:
        cross = np.cross(x[face[1]] - x[face[0]], x[face[2]] - x[face[0]])
        length = np.linalg.norm(cross)
        plane = np.append(cross, -cross @ x[face[0]]) / length
        total += np.isin(face, vertices).sum() * 0.5 * length * np.outer(plane, plane)
    return total


def skinned(transforms, rest, weights):
    """``p_j`` (P, 4), with transforms (P, J, 3, 4) and weights (J,)."""
    point = np.einsum("k,pkij,j->pi", weights, transforms, np.append(rest, 1.0))
    return np.column_stack([point, np.ones(len(point))])


def energy(quadrics, transforms, rest, weights):
    """``E(v, a)``, with quadrics (P, 4, 4)."""
    point = skinned(transforms, rest, weights)
    return float(np.einsum("pi,pij,pj->", point, quadrics, point))
