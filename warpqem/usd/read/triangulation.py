"""Read the polygons of a mesh and cut them into triangles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom

from warpqem.errors import StageError, VaryingTopologyError
from warpqem.mesh.edges import edge_key
from warpqem.mesh.polygons import ear_clipped, fans_cover, polygon_normals, repeated_polygons

__all__ = ["TriangulatedFaces", "fan_triangulate", "read_topology"]


# Rounds in which polygons are turned to be cut from another corner. A quadrilateral has two cuts; larger polygons have
# more, and a few rounds are enough for what meets in practice.
MAX_TURNS = 8


@dataclass(frozen=True)
class TriangulatedFaces:
    """The faces of a mesh, the same at every time.

    Attributes:
        triangles: int32, shape (N, 3), indices into the authored points, authored winding, all corners different.
        triangle_polygons: int32, shape (N,), the authored face that each triangle is a part of.
        triangle_corners: int32, shape (N, 3), the entry of faceVertexIndices that each corner is.
        polygon_count: number of authored faces.
        corner_count: number of entries of faceVertexIndices.
        hole_count: number of authored faces marked as holes; they have no triangles.
        degenerate_count: number of triangles left out because they name a point twice.
    """

    triangles: npt.NDArray[np.int32]
    triangle_polygons: npt.NDArray[np.int32]
    triangle_corners: npt.NDArray[np.int32]
    polygon_count: int
    corner_count: int
    hole_count: int
    degenerate_count: int


def fan_triangulate(
    counts: npt.NDArray[np.int32], apexes: npt.NDArray[np.int64] | None = None
) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
    """Cut polygons into triangles that share one corner of the polygon.

    A polygon `p0 p1 ... pk` becomes `(p0 p1 p2) (p0 p2 p3) ...`, so the winding stays. Polygons with fewer than three
    corners cover nothing and give no triangle.

    Args:
        counts: int32, shape (P,), corners of each polygon, not negative.
        apexes: int64, shape (P,), the corner of each polygon that its triangles share; None for the first.

    Returns:
        The corners of each triangle, counted over all polygons (int32, shape (N, 3)), and its polygon (int32,
        shape (N,)).
    """
    if apexes is None and (counts == 3).all():
        # As most meshes are.
        return np.arange(3 * len(counts), dtype=np.int32).reshape(-1, 3), np.arange(len(counts), dtype=np.int32)
    triangles_per_polygon = np.maximum(counts.astype(np.int64) - 2, 0)
    polygons = np.repeat(np.arange(len(counts)), triangles_per_polygon)
    first_corner = np.cumsum(counts, dtype=np.int64) - counts
    first_triangle = np.cumsum(triangles_per_polygon) - triangles_per_polygon
    step = np.arange(len(polygons)) - first_triangle[polygons]
    local = np.stack([np.zeros_like(step), step + 1, step + 2], axis=1)
    if apexes is not None:
        local = (local + apexes[polygons][:, None]) % counts[polygons][:, None]
    corners = first_corner[polygons][:, None] + local
    return corners.astype(np.int32).reshape(-1, 3), polygons.astype(np.int32)


def _choose_apexes(counts: npt.NDArray[np.int32], indices: npt.NDArray[np.int32]) -> npt.NDArray[np.int64]:
    """Corners to cut polygons from, so that a cut does not fall on an edge or a cut of other polygons where avoidable.

    Two quadrilaterals that fold over the same diagonal, or a pocket of polygons around one, would give an edge with
    more than two triangles, which the polygons do not have.
    """
    apexes = np.zeros(len(counts), dtype=np.int64)
    # A round turns one polygon at each such edge by one corner.
    for _ in range(min(int(counts.max(initial=0)), MAX_TURNS)):
        corners, polygons = fan_triangulate(counts, apexes)
        triangles = indices[corners]
        key = edge_key(triangles.ravel(), np.roll(triangles, -1, axis=1).ravel(), int(indices.max(initial=0)) + 1)
        _, entry, count = np.unique(key, return_inverse=True, return_counts=True)
        # Of the three edges of a triangle in a fan only the first and the last can be cuts.
        half_polygon = np.repeat(polygons, 3)
        same = np.zeros(len(polygons) * 3, dtype=bool)
        first = np.r_[False, polygons[1:] == polygons[:-1]]
        same[0::3], same[2::3] = first, np.r_[first[1:], False]
        crowded = same & (count[entry.ravel()] > 2)
        if not crowded.any():
            break
        _, chosen = np.unique(entry.ravel()[crowded][::-1], return_index=True)
        turned = np.unique(half_polygon[crowded][::-1][chosen])
        apexes[turned] = (apexes[turned] + 1) % counts[turned]
    return apexes


def _cut_alike(
    counts: npt.NDArray[np.int32], indices: npt.NDArray[np.int32], points: npt.NDArray[np.floating[Any]] | None
) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
    """Cut polygons, those that repeat another or are its back along the same diagonals.

    Otherwise the triangles of a repeat would be none of its original: nothing would be found to repeat, and every edge
    would have the faces of both.
    """
    repeated = repeated_polygons(counts, indices)
    if repeated is None:
        return _cut(counts, indices, points)
    own = np.flatnonzero(repeated.original == np.arange(len(counts)))
    ring = np.flatnonzero(np.isin(np.repeat(np.arange(len(counts)), counts), own))
    corners, polygons = _cut(counts[own], indices[ring], points)
    return repeated.spread(counts, ring[corners], own[polygons])


def _cut(
    counts: npt.NDArray[np.int32], indices: npt.NDArray[np.int32], points: npt.NDArray[np.floating[Any]] | None
) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
    """Cut polygons as fans, and those that a fan does not cover, such as concave ones, by ear clipping.

    Args:
        counts: int32, shape (P,), corners of each polygon, not negative.
        indices: int32, shape (C,), the point of each corner.
        points: shape (V, 3), the pose that decides; None to cut all as fans.

    Returns:
        As `fan_triangulate`.
    """
    if not (counts > 3).any():
        return fan_triangulate(counts)
    corners, polygons = fan_triangulate(counts, _choose_apexes(counts, indices))
    if points is None:
        return corners, polygons
    large = np.flatnonzero(counts > 3)
    place = points[indices]
    first = np.cumsum(counts, dtype=np.int64) - counts
    finite = np.isfinite(place).all(axis=1)
    large = large[_all_of(finite, counts, large)]
    if not len(large):
        return corners, polygons
    number = np.full(len(counts), -1, dtype=np.int64)
    number[large] = np.arange(len(large))
    ring = np.repeat(number >= 0, counts)
    normals = polygon_normals(place[ring], counts[large])
    inside = np.flatnonzero(number[polygons] >= 0)
    covered = fans_cover(place, corners[inside], number[polygons[inside]], normals)
    first_triangle = np.searchsorted(polygons, large)
    for index in np.flatnonzero(~covered).tolist():
        polygon = large[index]
        triangles = ear_clipped(place[first[polygon] : first[polygon] + counts[polygon]], normals[index])
        if triangles is not None:
            corners[first_triangle[index] : first_triangle[index] + len(triangles)] = first[polygon] + triangles
    return corners, polygons


def _all_of(flag: npt.NDArray[np.bool_], counts: npt.NDArray[np.int32], chosen: npt.NDArray[np.int64]) -> Any:
    """Whether the flag is set at all corners of each chosen polygon."""
    missing = np.bincount(np.repeat(np.arange(len(counts)), counts)[~flag], minlength=len(counts))
    return missing[chosen] == 0


def read_topology(
    mesh: UsdGeom.Mesh, point_count: int, points: npt.NDArray[np.floating[Any]] | None = None
) -> TriangulatedFaces:
    """Read and check the faces of a mesh.

    Args:
        mesh: The mesh.
        point_count: Number of points the faces may refer to.
        points: shape (point_count, 3), the pose in which it is decided how polygons are cut; None to cut all as fans.

    Raises:
        StageError: faceVertexCounts or faceVertexIndices is missing, blocked, inconsistent or out of range; the message
            names prim, attribute and time.
        VaryingTopologyError: one of them changes over time.
    """
    counts = _constant_array(mesh.GetFaceVertexCountsAttr())
    indices = _constant_array(mesh.GetFaceVertexIndicesAttr())
    path = mesh.GetPath()
    if counts.size and counts.min() < 0:
        face = int(counts.argmin())
        raise StageError(f"{path}.faceVertexCounts: face {face} has {counts[face]} corners")
    if counts.sum(dtype=np.int64) != len(indices):
        raise StageError(
            f"{path}.faceVertexCounts: the counts sum to {counts.sum(dtype=np.int64)}, "
            f"but faceVertexIndices has {len(indices)} entries"
        )
    outside = np.flatnonzero((indices < 0) | (indices >= point_count))
    if outside.size:
        corner = int(outside[0])
        face = int(np.searchsorted(np.cumsum(counts), corner, side="right"))
        raise StageError(
            f"{path}.faceVertexIndices: face {face} refers to point {indices[corner]}, "
            f"but there are {point_count} points ({outside.size} such corners)"
        )
    corners, polygons = _cut_alike(counts, indices, points)
    holes = _hole_faces(mesh, len(counts))
    if holes.size:
        kept = ~np.isin(polygons, holes)
        corners, polygons = corners[kept], polygons[kept]
    triangles = indices[corners]
    proper = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    return TriangulatedFaces(
        triangles=triangles[proper],
        triangle_polygons=polygons[proper],
        triangle_corners=corners[proper],
        polygon_count=len(counts),
        corner_count=len(indices),
        hole_count=len(holes),
        degenerate_count=int((~proper).sum()),
    )


def _constant_array(attribute: Usd.Attribute) -> npt.NDArray[np.int32]:
    """The value of an integer array attribute that must be the same at all its samples."""
    times = attribute.GetTimeSamples() or [Usd.TimeCode.Default()]
    first: npt.NDArray[np.int32] | None = None
    for time in times:
        value = attribute.Get(time)
        if value is None:
            raise StageError(f"{attribute.GetPath()}: no value at time {_name(time)} (missing or blocked)")
        array = _integers(attribute, value, time)
        if first is None:
            first = array
        elif not np.array_equal(first, array):
            raise VaryingTopologyError(
                f"{attribute.GetPath()}: changes at time {_name(time)}; "
                "a mesh whose topology varies over time cannot be simplified"
            )
    assert first is not None
    return first


def _integers(attribute: Usd.Attribute, value: object, time: float | Usd.TimeCode) -> npt.NDArray[np.int32]:
    """A value as int32, shape (n,); a file may declare the attribute as anything."""
    array = np.asarray(value)
    if array.ndim != 1 or not hasattr(type(value), "FromNumpy") or array.dtype.kind not in "iu":
        raise StageError(f"{attribute.GetPath()}: {type(value).__name__} at time {_name(time)}, no array of integers")
    limits = np.iinfo(np.int32)
    if array.size and (array.min() < limits.min or array.max() > limits.max):
        largest = array.max() if array.max() > limits.max else array.min()
        raise StageError(f"{attribute.GetPath()}: {largest} at time {_name(time)}, no integer of 32 bits")
    return array.astype(np.int32)


def _hole_faces(mesh: UsdGeom.Mesh, polygon_count: int) -> npt.NDArray[np.int32]:
    value = mesh.GetHoleIndicesAttr().Get()
    if value is None:
        return np.zeros(0, dtype=np.int32)
    holes = np.unique(_integers(mesh.GetHoleIndicesAttr(), value, Usd.TimeCode.Default()))
    if holes.size and (holes[0] < 0 or holes[-1] >= polygon_count):
        wrong = holes[0] if holes[0] < 0 else holes[-1]
        raise StageError(f"{mesh.GetPath()}.holeIndices: face {wrong} does not exist ({polygon_count} faces)")
    return holes


def _name(time: float | Usd.TimeCode) -> str:
    return f"{time:g}" if isinstance(time, float) else "default"
