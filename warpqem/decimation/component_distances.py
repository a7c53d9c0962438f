"""What the loss of a component would show: how far its surface is from the components that stay."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import warp as wp

from warpqem.kernels import component_distance as kernels
from warpqem.runtime import new_arrays
from warpqem.runtime.part_launches import launch_in_parts, rows_of

__all__ = ["MAX_FRAMES", "ComponentDistances", "least_losses"]

# Key frames that distances are taken in, evenly spread: parts that come near to others do so in few of them.
MAX_FRAMES = 3
# Vertices that stand for the surface of a component, evenly spread over its vertices.
MAX_SAMPLES = 16
# What lies on another component, such as a label, shows by itself: it counts as if it were off by so much of its size.
MIN_DISTANCE_PER_SIZE = 0.05
# Vertices of other components that are looked at where none of those stays that were found near: evenly spread.
MAX_OTHERS = 20000
# The first box of a search reaches so many times the size of the component, in each direction.
FIRST_BOX = 0.125


class ComponentDistances:
    """Area-weighted squared distances of components from others, as the input has them.

    Distances of what is left would differ by the error of the collapses so far, which is far less than what matters.

    Args:
        points: (K', V, 3) float32, the input in some key frames.
        faces: (N, 3) int32.
        component: (V,) int, the component of each vertex, from 0.
        weight: (V,) float32, scale of the quadric of each vertex.
        device: Warp device.
    """

    def __init__(
        self, points: np.ndarray, faces: np.ndarray, component: np.ndarray, weight: np.ndarray, device: str
    ) -> None:
        is_used = np.zeros(len(component), dtype=bool)
        is_used[faces] = True
        used = np.flatnonzero(is_used)
        order = used[np.argsort(component[used], kind="stable")]
        count = np.bincount(component[order], minlength=int(component.max(initial=0)) + 1)
        self._first = np.concatenate([[0], np.cumsum(np.minimum(count, MAX_SAMPLES))])
        start = np.concatenate([[0], np.cumsum(count)])[:-1]
        number = np.arange(self._first[-1]) - np.repeat(self._first[:-1], np.diff(self._first))
        step = np.repeat(count / np.maximum(1, np.minimum(count, MAX_SAMPLES)), np.diff(self._first))
        sample = order[np.repeat(start, np.diff(self._first)) + (number * step).astype(np.int64)]
        self._points, self._used, self._sample = points, order, sample
        self._start, self._count = start, count
        shape = (len(points), len(sample), int(kernels.NEAR_COMPONENTS))
        self._near, self._squared = np.empty(shape, dtype=np.int32), np.empty(shape, dtype=np.float32)
        self._area, self._min_squared = np.empty((len(points), len(count))), np.empty((len(points), len(count)))
        indices = new_arrays.uploaded(faces.ravel(), dtype=wp.int32, device=device)
        own = new_arrays.uploaded(component.astype(np.int32), dtype=wp.int32, device=device)
        chosen = new_arrays.uploaded(sample.astype(np.int32), dtype=wp.int32, device=device)
        for frame, positions in enumerate(points):
            self._area[frame] = _areas(positions, faces, component, weight, len(count))
            size = _sizes(positions[order], start, count)
            self._min_squared[frame] = _min_squared(size)
            mesh = wp.Mesh(points=new_arrays.uploaded(positions, dtype=wp.vec3, device=device), indices=indices)
            near = new_arrays.empty(shape[1:], dtype=wp.int32, device=device)
            squared = new_arrays.empty(shape[1:], dtype=wp.float32, device=device)
            radius = FIRST_BOX * np.maximum(size, np.finfo(np.float32).eps)[component[sample]]
            launch_in_parts(
                kernels.find_near_components,
                len(sample),
                [mesh.id, own, rows_of(chosen), rows_of(new_arrays.uploaded(radius, dtype=wp.float32, device=device))],
                [rows_of(near), rows_of(squared)],
                device=device,
            )
            self._near[frame], self._squared[frame] = near.numpy(), squared.numpy()

    def loss(self, component: int, stays: np.ndarray) -> tuple[float, float]:
        """Mean over frames of a component's area, and of its area times the mean squared distance from what stays.

        The distance is at least a part of its size.

        ``stays`` (C,) bool are the components that are left. Where none of those that were found near a sample stays,
        it is as far as the nearest vertex of the others.
        """
        rows = slice(self._first[component], self._first[component + 1])
        near, squared = self._near[:, rows], self._squared[:, rows]
        squared = np.where((near >= 0) & stays[near], squared, np.inf).min(axis=2)
        if np.isinf(squared).any():
            squared = np.where(np.isinf(squared), self._from_vertices(rows, stays), squared)
        area = self._area[:, component]
        mean_squared = np.maximum(squared.mean(axis=1), self._min_squared[:, component])
        return float(area.mean()), float((area * mean_squared).mean())

    def _from_vertices(self, rows: slice, stays: np.ndarray) -> np.ndarray:
        """(K', S) squared distances of samples from vertices of components that stay."""
        place = self._places_of(stays)
        # One coordinate after another, each of all vertices together: a tenth of the time of one vertex after another.
        others, samples = self._axes.take(place, axis=2), self._points[:, self._sample[rows]].transpose(2, 0, 1)
        # Where nothing stays, it is as far as the mesh is large.
        squared = np.ones(samples.shape[1:])
        for i in range(samples.shape[2]):
            x, y, z = (axis - own[:, i, None] for axis, own in zip(others, samples, strict=True))
            squared[:, i] = (x * x + y * y + z * z).min(axis=1, initial=np.inf if len(place) else 1.0)
        return squared

    @cached_property
    def _axes(self) -> np.ndarray:
        """(3, K', U) the coordinates of all vertices in use, component after component."""
        return np.ascontiguousarray(self._points[:, self._used].transpose(2, 0, 1))

    def _places_of(self, chosen: np.ndarray) -> np.ndarray:
        """Where vertices of chosen components (C,) bool are in :attr:`_axes`.

        At most twice :data:`MAX_OTHERS`, evenly spread over all of them. A look at every vertex, as often as components
        go, would take the square of the time on a mesh of many.
        """
        component = np.flatnonzero(chosen)
        end = np.cumsum(self._count[component])
        total = int(end[-1]) if len(end) else 0
        number = np.arange(0, total, max(1, total // MAX_OTHERS))
        before = self._start[component] + self._count[component] - end
        places: np.ndarray = number + before[np.searchsorted(end, number, side="right")]
        return places


def least_losses(
    points: np.ndarray, faces: np.ndarray, component: np.ndarray, weight: np.ndarray, chosen: np.ndarray
) -> np.ndarray:
    """(D,) what the loss of each chosen component (D,) is at least, wherever the others are: without a search.

    The other arguments are those of :class:`ComponentDistances`.
    """
    number = np.full(int(component.max(initial=0)) + 1, -1, dtype=np.int64)
    number[chosen] = np.arange(len(chosen))
    own = number[component]
    faces = faces[own[faces[:, 0]] >= 0]
    vertex = np.unique(faces)
    order = vertex[np.argsort(own[vertex], kind="stable")]
    count = np.bincount(own[order], minlength=len(chosen))
    start = np.cumsum(count) - count
    losses = [
        _areas(frame, faces, own, weight, len(chosen)) * _min_squared(_sizes(frame[order], start, count))
        for frame in points
    ]
    least: np.ndarray = np.mean(losses, axis=0)
    return least


def _min_squared(size: np.ndarray) -> np.ndarray:
    squared: np.ndarray = (MIN_DISTANCE_PER_SIZE * size) ** 2
    return squared


def _areas(points: np.ndarray, faces: np.ndarray, component: np.ndarray, weight: np.ndarray, count: int) -> np.ndarray:
    """(C,) area of each component, each face times the scale of its corners."""
    corner = points[faces].astype(np.float64)
    cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    area = 0.5 * np.linalg.norm(cross, axis=1) * weight[faces].mean(axis=1)
    areas: np.ndarray = np.bincount(component[faces[:, 0]], area, count)
    return areas


def _sizes(points: np.ndarray, start: np.ndarray, count: np.ndarray) -> np.ndarray:
    """(C,) largest extent of each component, whose points lie together."""
    size = np.zeros(len(count))
    filled = count > 0
    begin = start[filled]
    high, low = (bound.reduceat(points, begin, axis=0) for bound in (np.maximum, np.minimum))
    size[filled] = (high - low).max(axis=1)
    return size
