"""Cut polygons into triangles: as fans where these cover the polygon once, by ear clipping elsewhere.

Ear clipping is that of mapbox_earcut, as in most renderers and viewers. It leaves out corners on a straight line, whose
edges neighbours may have; they are put back, so that N corners always give N - 2 triangles and no gap opens.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

__all__ = ["ear_clipped", "fans_cover", "polygon_normals", "repeated_polygons"]

# A triangle that is turned over by less than this part of the polygon's area is one that rounding made of a line.
ROUNDING_SHARE = 1e-6


def polygon_normals(points: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Normals of P polygons as long as twice their areas, (P, 3) float64 (Newell 1976).

    Args:
        points: (C, 3), the corners of all polygons one after the other.
        counts: (P,) int, corners of each, at least one.
    """
    first = np.cumsum(counts) - counts
    following = np.arange(1, len(points) + 1)
    following[first + counts - 1] = first
    # About a corner of their own: far from the origin single precision would leave little of the cross products.
    local = points.astype(np.float64) - np.repeat(points[first].astype(np.float64), counts, axis=0)
    normals: np.ndarray = np.add.reduceat(np.cross(local, local[following]), first, axis=0)
    return normals


def fans_cover(points: np.ndarray, triangles: np.ndarray, polygon: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(P,) bool, whether the triangles of each polygon face as it does: then they cover it without an overlap.

    Polygons without an area, or with a point that is not finite, have nothing to overlap.

    Args:
        points: (C, 3), the corners of all polygons.
        triangles: (N, 3) int, corners of each triangle.
        polygon: (N,) int, the polygon that each is a part of.
        normals: (P, 3), see :func:`polygon_normals`.
    """
    a, b, c = (points[triangles[:, k]].astype(np.float64) for k in range(3))
    facing = (np.cross(b - a, c - a) * normals[polygon]).sum(axis=1)
    size = (normals**2).sum(axis=1)
    covered = np.ones(len(normals), dtype=bool)
    covered[polygon[facing < -ROUNDING_SHARE * size[polygon]]] = False
    return covered


def ear_clipped(ring: np.ndarray, normal: np.ndarray) -> np.ndarray | None:
    """Triangles (n - 2, 3) int of a polygon with corners ``ring`` (n, 3), in its winding; None where there are none.

    The polygon may be concave, not quite flat, and may have holes that bridges of two edges lead to. There are none of
    one that overlaps itself.
    """
    # Few meshes have polygons that need it.
    import mapbox_earcut

    axis = int(np.abs(normal).argmax())
    # Without its longest component a normal keeps the polygon's shape best; the order keeps its winding.
    kept = [(axis + 1) % 3, (axis + 2) % 3][:: 1 if normal[axis] > 0 else -1]
    flat = np.ascontiguousarray((ring.astype(np.float64) - ring[0])[:, kept])
    found = mapbox_earcut.triangulate_float64(flat, np.array([len(ring)], dtype=np.uint32)).reshape(-1, 3)
    triangles = [_wound(tuple(map(int, corners)), flat) for corners in found]
    whole = _with_left_out(triangles, len(ring))
    return whole if whole is not None and _covers(whole, flat) else None


def _wound(corners: tuple[int, ...], flat: np.ndarray) -> tuple[int, ...]:
    """The corners counter-clockwise."""
    return corners if _doubled_areas(np.array([corners]), flat)[0] >= 0 else corners[::-1]


def _doubled_areas(triangles: np.ndarray, flat: np.ndarray) -> np.ndarray:
    u, v = (flat[triangles[:, k]] - flat[triangles[:, 0]] for k in (1, 2))
    areas: np.ndarray = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    return areas


def _with_left_out(triangles: list[tuple[int, ...]], count: int) -> np.ndarray | None:
    """The triangles with the corners between the ends of their edges along the rim; None where they do not fit it."""
    while True:
        edges = {(t[k], t[(k + 1) % 3]): (index, k) for index, t in enumerate(triangles) for k in range(3)}
        if len(edges) != 3 * len(triangles):
            return None
        rim = [edge for edge in edges if edge[::-1] not in edges]
        # An edge of the rim that is none of the polygon passes by the corners between its ends.
        long = next(((a, b) for a, b in rim if (a + 1) % count != b), None)
        if long is None:
            break
        index, k = edges[long]
        apex = triangles.pop(index)[(k + 2) % 3]
        chain = [(long[0] + step) % count for step in range((long[1] - long[0]) % count + 1)]
        if apex in chain:
            return None
        triangles += [(a, b, apex) for a, b in itertools.pairwise(chain)]
    return np.array(triangles, dtype=np.int64) if len(triangles) == count - 2 else None


def _covers(triangles: np.ndarray, flat: np.ndarray) -> bool:
    """Whether triangles have the area of their polygon together, and none is turned over."""
    following = np.roll(flat, -1, axis=0)
    area = float((flat[:, 0] * following[:, 1] - flat[:, 1] * following[:, 0]).sum())
    areas = _doubled_areas(triangles, flat)
    return bool((areas >= -ROUNDING_SHARE * area).all() and abs(areas.sum() - area) <= ROUNDING_SHARE * abs(area))


@dataclass(frozen=True)
class RepeatedPolygons:
    """Polygons with the corners of an earlier one in the same order or the reverse, from whichever corner they begin.

    Attributes:
        original: (P,) int64, the first polygon with these corners: itself where there is no earlier one.
        place: (C,) int64, the place in its polygon of each corner, when those of all repeats are put into one order.
        turned: (P,) bool, polygons in which that order is the reverse one.
    """

    original: np.ndarray
    place: np.ndarray
    turned: np.ndarray

    def spread(self, counts: np.ndarray, corners: np.ndarray, polygons: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Cuts of all polygons from those of the originals.

        Args:
            counts: (P,) corners of each polygon.
            corners: (N, 3) int32 corners of the triangles of the originals, counted over all P polygons.
            polygons: (N,) the polygon of each, ascending.

        Returns:
            The corners of the triangles of all polygons, (M, 3) int32, and their polygons, (M,) int32, ascending. A
            repeat has the triangles of its original, wound as it is itself.
        """
        first = np.cumsum(counts, dtype=np.int64) - counts
        triangle_counts = np.maximum(counts.astype(np.int64) - 2, 0)
        all_polygons = np.repeat(np.arange(len(counts)), triangle_counts)
        step = np.arange(len(all_polygons)) - (np.cumsum(triangle_counts) - triangle_counts)[all_polygons]
        source = self.original[all_polygons]
        chosen = corners[np.searchsorted(polygons, source) + step]
        # Where the corner at each place is.
        at_place = np.empty(len(self.place), dtype=np.int64)
        at_place[np.repeat(first, counts) + self.place] = np.arange(len(self.place))
        found = at_place[first[all_polygons][:, None] + self.place[chosen]]
        reverse = self.turned[all_polygons] != self.turned[source]
        found[reverse] = found[reverse][:, ::-1]
        return found.astype(np.int32), all_polygons.astype(np.int32)


def repeated_polygons(counts: np.ndarray, indices: np.ndarray) -> RepeatedPolygons | None:
    """Find polygons of four corners or more that repeat others or are their backs; None where there are none.

    Args:
        counts: (P,) int32, corners of each polygon, not negative.
        indices: (C,) int32, the point of each corner.
    """
    if not (counts > 3).any():
        return None
    first = np.cumsum(counts, dtype=np.int64) - counts
    original = np.arange(len(counts), dtype=np.int64)
    place = np.arange(len(indices), dtype=np.int64) - np.repeat(first, counts)
    turned = np.zeros(len(counts), dtype=bool)
    # Only polygons with the same smallest point and the same sum are compared, so that other meshes cost little.
    for size in np.unique(counts[counts > 3]).tolist():
        chosen = np.flatnonzero(counts == size)
        rings = indices[first[chosen][:, None] + np.arange(size)]
        lowest = rings.argmin(axis=1)
        # 64 bits hold the key of polygons with fewer than two corners for each point; others may share one by chance.
        key = rings.min(axis=1) * np.int64(size) * (int(indices.max()) + 1) + rings.sum(axis=1, dtype=np.int64)
        _, entry, count = np.unique(key, return_inverse=True, return_counts=True)
        alike = np.flatnonzero(count[entry.ravel()] > 1)
        if not len(alike):
            continue
        chosen, rings, lowest = chosen[alike], rings[alike], lowest[alike]
        # From the smallest point on, towards the smaller of its neighbours.
        row = np.arange(len(chosen))
        reverse = rings[row, (lowest + 1) % size] > rings[row, lowest - 1]
        step = np.where(reverse, -1, 1)[:, None] * np.arange(size)
        order = (lowest[:, None] + step) % size
        _, index, entry = np.unique(rings[row[:, None], order], axis=0, return_index=True, return_inverse=True)
        original[chosen] = chosen[index[entry.ravel()]]
        place[first[chosen][:, None] + order] = np.arange(size)
        turned[chosen] = reverse
    if (original == np.arange(len(counts))).all():
        return None
    return RepeatedPolygons(original, place, turned)
