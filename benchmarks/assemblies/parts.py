"""Closed parts that assemblies are built of: boxes, surfaces of revolution, tubes, and rigid motions for them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

__all__ = ["Builder", "Part", "bent", "box", "moved", "revolved", "ring", "tube", "turned"]

Points = NDArray[np.float64]


@dataclass(frozen=True)
class Part:
    """A closed piece at rest: points (V, 3) and faces (N, 3), counter-clockwise from outside."""

    points: Points
    faces: NDArray[np.int32]

    def mapped(self, place: Callable[[Points], Points]) -> Part:
        """The same piece with each point (V, 3) where the function takes it."""
        return Part(place(self.points), self.faces)

    def at(self, *offset: float) -> Part:
        """The same piece, shifted."""
        return Part(self.points + np.array(offset), self.faces)

    def scaled(self, *factor: float) -> Part:
        """The same piece, larger by one positive factor or one along each axis."""
        return Part(self.points * np.array(factor), self.faces)

    def turned(self, axis: str, angle: float) -> Part:
        """The same piece, turned about an axis through the origin, in radians."""
        return Part(self.points @ turned(axis, angle)[:3, :3].T, self.faces)


def _between_rows(upper: NDArray[np.intp], lower: NDArray[np.intp]) -> NDArray[np.intp]:
    """Faces between two closed rings of points."""
    a, b, c, d = upper, np.roll(upper, -1), np.roll(lower, -1), lower
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def _stack(rings: Points, ends: Sequence[Points] | None) -> Part:
    """A skin over rings (R, C, 3), the last one at the top; a point at either end closes it, none joins the ends."""
    rows, columns = rings.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    pairs = [(i + 1, i) for i in range(rows - 1)] + ([(0, rows - 1)] if ends is None else [])
    faces = [_between_rows(index[lower], index[upper]) for upper, lower in pairs]
    points = [rings.reshape(-1, 3)]
    if ends is not None:
        for number, (point, border) in enumerate(zip(ends, (index[0], index[-1]), strict=True)):
            tip = np.full(columns, rows * columns + number)
            following = np.roll(border, -1)
            corners = [tip, following, border] if number == 0 else [tip, border, following]
            faces.append(np.stack(corners, axis=1))
            points.append(point[None])
    return Part(np.concatenate(points), np.concatenate(faces).astype(np.int32))


def revolved(profile: Sequence[tuple[float, float]] | Points, columns: int) -> Part:
    """A closed surface of revolution about z of (radius, height), from the bottom up, with flat caps."""
    radius, height = np.asarray(profile, dtype=np.float64).T
    angle = 2 * np.pi * np.arange(columns) / columns
    circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    rings = radius[:, None, None] * circle + height[:, None, None] * np.array([0, 0, 1.0])
    return _stack(rings, [np.array([0, 0, height[0]]), np.array([0, 0, height[-1]])])


def ring(profile: Sequence[tuple[float, float]] | Points, columns: int) -> Part:
    """A washer or torus about z: a closed cross-section of (radius, height), counter-clockwise."""
    radius, height = np.asarray(profile, dtype=np.float64).T
    angle = 2 * np.pi * np.arange(columns) / columns
    circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    return _stack(radius[:, None, None] * circle + height[:, None, None] * np.array([0, 0, 1.0]), None)


def tube(curve: Points, radius: NDArray[np.float64] | float, columns: int) -> Part:
    """A tube with caps along a curve (R, 3) that is nowhere parallel to (1, 2, 3)."""
    along = np.gradient(curve, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(along, np.array([1.0, 2.0, 3.0]))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    other = np.cross(along, across)
    angle = 2 * np.pi * np.arange(columns) / columns
    circle = np.cos(angle)[None, :, None] * across[:, None] + np.sin(angle)[None, :, None] * other[:, None]
    size = np.broadcast_to(radius, len(curve))[:, None, None]
    return _stack(curve[:, None] + size * circle, [curve[0], curve[-1]])


def box(size: Sequence[float], cells: Sequence[int]) -> Part:
    """A box about the origin whose sides are grids of so many squares along each axis."""
    corners, faces, count = [], [], 0
    for axis in range(3):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        rows, columns = cells[first] + 1, cells[second] + 1
        i, j = (g.ravel() for g in np.mgrid[:rows, :columns])
        lower, left = (g.ravel() for g in np.mgrid[: rows - 1, : columns - 1])
        a = lower * columns + left
        b, c, d = a + columns, a + columns + 1, a + 1
        quads = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
        for end in (0, cells[axis]):
            grid = np.zeros((rows * columns, 3), dtype=np.int64)
            grid[:, axis], grid[:, first], grid[:, second] = end, i, j
            corners.append(grid)
            faces.append((quads if end else quads[:, ::-1]) + count)
            count += len(grid)
    unique, vertex = np.unique(np.concatenate(corners), axis=0, return_inverse=True)
    points = (unique / np.array(cells) - 0.5) * np.array(size)
    return Part(points, vertex.reshape(-1)[np.concatenate(faces)].astype(np.int32))


def moved(x: float, y: float, z: float) -> Points:
    """(4, 4) shift, for column vectors."""
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


def turned(axis: str, angle: float | Points) -> Points:
    """(..., 4, 4) turn about ``x``, ``y`` or ``z`` through the origin, by an angle or one for each frame."""
    angle = np.asarray(angle, dtype=np.float64)
    matrix = np.zeros((*angle.shape, 4, 4))
    matrix[..., range(4), range(4)] = 1.0
    i, j = [(1, 2), (2, 0), (0, 1)]["xyz".index(axis)]
    matrix[..., i, i] = matrix[..., j, j] = np.cos(angle)
    matrix[..., j, i], matrix[..., i, j] = np.sin(angle), -np.sin(angle)
    return matrix


def bent(axis: str, angle: Points, pivot: Sequence[float]) -> Points:
    """(F, 4, 4) turn about an axis through a point: a joint."""
    x, y, z = pivot
    return moved(x, y, z) @ turned(axis, angle) @ moved(-x, -y, -z)


@dataclass
class Builder:
    """Parts of an assembly and their rigid motions."""

    frame_count: int
    points: list[NDArray[np.float32]] = field(default_factory=list)
    faces: list[NDArray[np.int32]] = field(default_factory=list)
    vertex_count: int = 0

    def add(self, part: Part, motion: Points | None = None) -> None:
        """One more part, moved by (4, 4) or (F, 4, 4) for column vectors."""
        matrix = np.broadcast_to(np.eye(4) if motion is None else motion, (self.frame_count, 4, 4))
        self.add_frames(part.points @ matrix[:, :3, :3].transpose(0, 2, 1) + matrix[:, None, :3, 3], part.faces)

    def add_frames(self, points: Points, faces: NDArray[np.int32]) -> None:
        """One more part of points (F, V, 3)."""
        self.points.append(points.astype(np.float32))
        self.faces.append(faces + np.int32(self.vertex_count))
        self.vertex_count += points.shape[1]
