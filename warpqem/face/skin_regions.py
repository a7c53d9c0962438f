"""Which parts of a face mesh are its skin, and how it moves apart from the head."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warpqem.mesh.components import lowest_members
from warpqem.mesh.edges import edge_table

__all__ = ["FaceSkin", "border_vertices_of", "find_skin", "head_motion", "without_head_motion"]

# Eyeballs are about as deep as they are wide; lashes, tear fluid and covers are sheets and strips.
ROUND = 0.6
# Frames that the rigid motion is fitted to again with what moves least, and that part of the vertices.
RIGID_ROUNDS, STIFF_PART = 4, 0.4


@dataclass(frozen=True)
class FaceSkin:
    """The skin of a face mesh.

    Attributes:
        faces: (N, 3) int, faces of the skin.
        seen: (M, 3) int, faces of the skin and of what lies in it like an eyeball: what a look from the front sees.
        vertices: (n,) int, vertices of the skin.
        border: (b,) int, those of them at an open border.
    """

    faces: np.ndarray
    seen: np.ndarray
    vertices: np.ndarray
    border: np.ndarray


def find_skin(points: np.ndarray, faces: np.ndarray) -> FaceSkin:
    """The component with the largest area is the skin; round ones beside it are eyes (points (V, 3), faces (N, 3))."""
    label = lowest_members(len(points), faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2))[faces[:, 0]]
    corner = points[faces]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    names, part = np.unique(label, return_inverse=True)
    skin = int(np.bincount(part, weights=area).argmax())
    seen = part == skin
    for other in range(len(names)):
        if other != skin and _is_round(points[np.unique(faces[part == other])]):
            seen |= part == other
    own = faces[part == skin]
    return FaceSkin(own, faces[seen], np.unique(own), border_vertices_of(own))


def border_vertices_of(faces: np.ndarray) -> np.ndarray:
    """(b,) int, ends of edges with one face."""
    edges = edge_table(faces)
    return np.unique(edges.ends[edges.face_count == 1])


def _is_round(points: np.ndarray) -> bool:
    extent = np.ptp(points, axis=0)
    return bool(extent.min() > ROUND * extent.max())


def without_head_motion(points: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Frames (F, V, 3) turned and moved so that the stiff part of the face stays where it is in the first one."""
    rotation, shift = head_motion(points, vertices)
    return np.asarray(np.einsum("fvi,fji->fvj", points, rotation) + shift[:, None])


def head_motion(points: np.ndarray, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotations (F, 3, 3) and shifts (F, 3) that bring the head in frames (F, V, 3) to where it is in the first one.

    The part that moves least is found together with the motion: a rigid fit to all vertices, then to those that it
    leaves nearest, and so on.
    """
    first = points[0].astype(np.float64)
    rotations, shifts = [], []
    for posed in points.astype(np.float64):
        chosen = vertices
        for _ in range(RIGID_ROUNDS):
            rotation, shift = _rigid(posed[chosen], first[chosen])
            rest = np.linalg.norm(posed[vertices] @ rotation.T + shift - first[vertices], axis=1)
            chosen = vertices[rest <= np.quantile(rest, STIFF_PART)]
        rotations.append(rotation)
        shifts.append(shift)
    return np.array(rotations), np.array(shifts)


def _rigid(source: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The rotation and shift that bring the source (n, 3) nearest to the target (n, 3) (Kabsch 1976)."""
    a, b = source.mean(axis=0), target.mean(axis=0)
    u, _, v = np.linalg.svd((source - a).T @ (target - b))
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(v.T @ u.T)) or 1.0])
    rotation = v.T @ flip @ u.T
    return rotation, b - rotation @ a
