"""The mesh of the head: neck cut open, lids drawn, lips slit along their contact line, a mouth pocket behind them."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from scenes import head_shape
from scenes.implicit import Points, surface
from scenes.remesh import Faces, border_edges, compact, split_at_zero, well_shaped

# Grid step of marching cubes in centimetres: lids and lips come out at 1 to 2 steps thickness.
SPACING = 0.2
# Loops of faces from one lip through the pocket to the other, and the depth of the pocket in centimetres.
POCKET_ROWS = 8
POCKET_DEPTH = 2.6
POCKET_HALF_HEIGHT = 0.6


@dataclass(frozen=True)
class HeadMesh:
    """The mesh and its mouth.

    `points` ``(V, 3)``, `faces` ``(N, 3)``. `upper_lip` and `lower_lip` ``(M,)`` are the vertices of the contact
    line from the right to the left corner, the same vertex at both ends and pairs in one place between.
    `pocket` ``(M - 2, R)`` holds the vertices inside the mouth, each row from the upper to the lower lip.
    """

    points: Points
    faces: Faces
    upper_lip: NDArray[np.int64]
    lower_lip: NDArray[np.int64]
    pocket: NDArray[np.int64]


def _near_mouth(points: Points) -> NDArray[np.bool_]:
    return (np.abs(points[:, 0]) < head_shape.MOUTH_HALF_WIDTH) & (points[:, 2] > 6.0)


def _near_lids(points: Points) -> NDArray[np.bool_]:
    offset = np.stack([np.abs(points[:, 0]), points[:, 1], points[:, 2]], axis=1) - head_shape.EYE
    reach = head_shape.EYE_RADIUS + head_shape.LID_THICKNESS + 0.15
    return ((offset**2).sum(axis=1) < reach**2) & (np.abs(offset[:, 0]) < head_shape.EYE_HALF_WIDTH)


def _above_contact(points: Points) -> NDArray[np.float64]:
    above = points[:, 1] - head_shape.contact_line(points[:, 0])
    # The cut needs every vertex on one side or the other.
    return np.where(above == 0.0, 1e-9, above)


def build(face_count: int) -> HeadMesh:
    """Return the head with about `face_count` faces, pocket of the mouth included."""
    field = head_shape.head()
    points, faces = surface(field, head_shape.LOWER, head_shape.UPPER, SPACING)
    points, faces, _ = split_at_zero(
        points, faces, points[:, 1] - head_shape.NECK_CUT, lambda p: np.ones(len(p), dtype=bool)
    )
    above = points[faces][:, :, 1].mean(axis=1) > head_shape.NECK_CUT
    points, faces, _ = compact(points, faces[above])
    # The cut of the mouth is far from the lids: their edges stay as they are.
    points, faces, lids = split_at_zero(points, faces, head_shape.lid_opening(points), _near_lids)
    points, faces, mouth = split_at_zero(points, faces, _above_contact(points), _near_mouth)
    # About 20 columns of the contact line with two faces in each row.
    pocket_faces = 20 * 2 * POCKET_ROWS
    features = mouth | lids | border_edges(faces)
    points, faces, features = well_shaped(
        field, points, faces, head_shape.edge_size, face_count - pocket_faces, features
    )
    return _open_mouth(points, faces, features)


def _open_mouth(points: Points, faces: Faces, features: set[tuple[int, int]]) -> HeadMesh:
    """Part the mesh along the contact line and sew the pocket between the two lips."""
    on_line = np.abs(points[:, 1] - head_shape.contact_line(points[:, 0])) < 0.02
    on_line &= (np.abs(points[:, 0]) < head_shape.MOUTH_HALF_WIDTH + 0.01) & (points[:, 2] > 6.0)
    path = np.array(sorted({v for edge in features if on_line[list(edge)].all() for v in edge}))
    path = path[np.argsort(points[path, 0], kind="stable")]
    inner = path[1:-1]
    lower = path.copy()
    lower[1:-1] = len(points) + np.arange(len(inner))
    renamed = np.arange(len(points))
    renamed[inner] = lower[1:-1]
    # A face belongs to the lower lip if its vertices off the line lie below the line.
    off_line = ~np.isin(faces, path)
    height = points[faces][:, :, 1] - head_shape.contact_line(points[faces][:, :, 0])
    below = (height * off_line).sum(axis=1) < 0.0
    touches = np.isin(faces, inner).any(axis=1)
    faces = np.where((touches & below)[:, None], renamed[faces], faces)
    points = np.concatenate([points, points[inner]])
    pocket_points, pocket, pocket_faces = _pocket(points, path, lower)
    return HeadMesh(np.concatenate([points, pocket_points]), np.concatenate([faces, pocket_faces]), path, lower, pocket)


def _pocket(points: Points, upper: NDArray, lower: NDArray) -> tuple[Points, NDArray[np.int64], Faces]:
    """Return points, their table by column and row, and the faces of the pocket between the lips.

    Behind the lips the pocket widens to the mouth cavity; it narrows to nothing at the corners.
    """
    inner = points[upper[1:-1]]
    width = (1.0 - (inner[:, 0] / head_shape.MOUTH_HALF_WIDTH) ** 2).clip(0.0, 1.0) ** 0.5
    around = np.pi * np.arange(1, POCKET_ROWS) / POCKET_ROWS
    depth = POCKET_DEPTH * np.sin(around) * width[:, None]
    height = POCKET_HALF_HEIGHT * np.sin(2.0 * around) * width[:, None]
    rows = np.repeat(inner[:, None], len(around), axis=1)
    rows[:, :, 2] -= depth
    rows[:, :, 1] += height
    # The pocket follows the arch of the teeth: it gets narrower inwards.
    rows[:, :, 0] *= 1.0 - 0.12 * depth / POCKET_DEPTH
    table = len(points) + np.arange(rows.shape[0] * rows.shape[1]).reshape(rows.shape[:2])
    loops = np.concatenate([upper[1:-1, None], table, lower[1:-1, None]], axis=1)
    faces: list[list[int]] = []
    for row in range(POCKET_ROWS):
        right, left = loops[0], loops[-1]
        faces.append([int(upper[0]), int(right[row + 1]), int(right[row])])
        faces.append([int(upper[-1]), int(left[row]), int(left[row + 1])])
        for a, b in pairwise(loops):
            faces.append([int(a[row]), int(a[row + 1]), int(b[row])])
            faces.append([int(b[row]), int(a[row + 1]), int(b[row + 1])])
    return rows.reshape(-1, 3), table, np.array(faces, dtype=np.int64)
