"""Make the triangles of a marching-cubes mesh well shaped: collapse to a face count, flip edges, relax on the surface.

The three operations are those of Botsch and Kobbelt, "A remeshing approach to multiresolution modeling" (SGP 2004),
with collapses ordered by edge length over the wanted length instead of a sweep. Feature edges (borders and drawn
curves) are kept: a vertex of a feature only slides along it.
"""

import heapq
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from scenes.implicit import COORDINATE_DECIMALS, Field, Points, dot, project

Faces = NDArray[np.int64]
Size = Callable[[Points], NDArray[np.float64]]
Edge = tuple[int, int]


def edge_key(a: int, b: int) -> Edge:
    """Return the vertex pair in ascending order."""
    return (a, b) if a < b else (b, a)


def split_at_zero(
    points: Points, faces: Faces, values: NDArray[np.float64], where: Callable[[Points], NDArray[np.bool_]]
) -> tuple[Points, Faces, set[Edge]]:
    """Insert vertices where mesh edges cross the zero set of the linear function with vertex `values`.

    Only crossings for which ``where(positions)`` holds are inserted. No value may be zero. Returns the points, the
    faces and the edges along the zero set.
    """
    edges = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    crossed = edges[values[edges[:, 0]] * values[edges[:, 1]] < 0.0]
    share = values[crossed[:, 0]] / (values[crossed[:, 0]] - values[crossed[:, 1]])
    middle = points[crossed[:, 0]] * (1.0 - share[:, None]) + points[crossed[:, 1]] * share[:, None]
    kept = where(middle)
    inserted = {(int(a), int(b)): len(points) + i for i, (a, b) in enumerate(crossed[kept])}
    result: list[list[int]] = []
    curve: set[Edge] = set()
    for face in faces.tolist():
        cut = [inserted.get(edge_key(face[k], face[(k + 1) % 3])) for k in range(3)]
        count = sum(c is not None for c in cut)
        if count == 0:
            result.append(face)
        elif count == 1:
            k = next(i for i in range(3) if cut[i] is not None)
            a, b, c = face[k], face[(k + 1) % 3], face[(k + 2) % 3]
            result += [[a, cut[k], c], [cut[k], b, c]]
        else:
            # The vertex alone on its side of the zero set is the one between the two cut edges.
            k = next(i for i in range(3) if cut[i] is not None and cut[i - 1] is not None)
            a, b, c = face[k], face[(k + 1) % 3], face[(k + 2) % 3]
            right, left = cut[k], cut[k - 1]
            result += [[a, right, left], [right, b, c], [right, c, left]]
            curve.add(edge_key(right, left))
    positions = np.round(np.concatenate([points, middle[kept]]), COORDINATE_DECIMALS)
    return positions, np.array(result, dtype=np.int64), curve


def border_edges(faces: Faces) -> set[Edge]:
    """Return the edges that one face alone has."""
    edges, uses = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0, return_counts=True)
    return {(int(a), int(b)) for a, b in edges[uses == 1]}


def compact(points: Points, faces: Faces) -> tuple[Points, Faces, NDArray[np.int64]]:
    """Drop the vertices no face uses; returns points, faces and the new index of each old vertex (-1: dropped)."""
    used = np.unique(faces)
    index = np.full(len(points), -1, dtype=np.int64)
    index[used] = np.arange(len(used))
    return points[used], index[faces], index


class EdgeCollapser:
    """Collapses the edges that are shortest for their place until a face count is reached."""

    def __init__(self, points: Points, faces: Faces, size: Size, features: set[Edge]) -> None:
        """Index the mesh; `size` gives the wanted edge length at points ``(P, 3)``."""
        self.points = [tuple(p) for p in points.tolist()]
        self.size = size(points).tolist()
        self.faces: list[list[int] | None] = faces.tolist()
        self.around: list[set[int]] = [set() for _ in self.points]
        for index, face in enumerate(self.faces):
            for v in face:
                self.around[v].add(index)
        self.features = set(features)
        self.degree = [0] * len(self.points)
        for edge in self.features:
            for v in edge:
                self.degree[v] += 1
        self.heap: list[tuple[float, int, int]] = []

    def ring(self, v: int) -> set[int]:
        """Return the vertices of the faces around `v`, `v` included."""
        return {w for f in self.around[v] for w in self.faces[f]}

    def push(self, a: int, b: int) -> None:
        """Queue an edge by its length over the wanted length."""
        p, q = self.points[a], self.points[b]
        length = ((p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2) ** 0.5
        # Rounded for the same reason as the coordinates are.
        heapq.heappush(self.heap, (round(2.0 * length / (self.size[a] + self.size[b]), 6), *edge_key(a, b)))

    def place(self, a: int, b: int) -> tuple[int, int, float] | None:
        """Return kept vertex, dropped vertex and the share of the way to the dropped one, or None if not allowed."""
        on_a, on_b = self.degree[a], self.degree[b]
        if on_a and on_b:
            if edge_key(a, b) not in self.features:
                return None
            # Only a vertex in the middle of its curve (degree 2) may go; ends of a curve stay.
            if on_a == 2 and on_b == 2:
                return a, b, 0.5
            return (a, b, 0.0) if on_b == 2 else (b, a, 0.0) if on_a == 2 else None
        if on_a or on_b:
            return (a, b, 0.0) if on_a else (b, a, 0.0)
        return a, b, 0.5

    def turns_over(self, v: int, other: int, target: tuple[float, float, float]) -> bool:
        """Tell whether moving `v` to `target` turns a face without `other` by more than 60 degrees or flattens it."""
        for f in self.around[v]:
            face = self.faces[f]
            if other in face:
                continue
            k = face.index(v)
            b, c = self.points[face[k - 2]], self.points[face[k - 1]]
            before, after = _normal(self.points[v], b, c), _normal(target, b, c)
            dot = before[0] * after[0] + before[1] * after[1] + before[2] * after[2]
            norm = sum(x * x for x in before) * sum(x * x for x in after)
            if dot <= 0.0 or dot * dot < 0.25 * norm:
                return True
        return False

    def collapse(self, a: int, b: int) -> int:
        """Collapse an edge if topology, features and face normals allow it; returns the number of faces removed."""
        shared = self.around[a] & self.around[b]
        placed = self.place(a, b)
        # Link condition (Dey et al. 1999): the ends share just the vertices opposite their edge.
        if not shared or placed is None or len(self.ring(a) & self.ring(b)) != 2 + len(shared):
            return 0
        keep, drop, share = placed
        p, q = self.points[keep], self.points[drop]
        target = tuple(round(x * (1.0 - share) + y * share, COORDINATE_DECIMALS) for x, y in zip(p, q, strict=True))
        if self.turns_over(keep, drop, target) or self.turns_over(drop, keep, target):
            return 0
        for f in shared:
            for v in self.faces[f]:
                self.around[v].discard(f)
            self.faces[f] = None
        for f in self.around[drop]:
            self.faces[f] = [keep if v == drop else v for v in self.faces[f]]
        self.around[keep] |= self.around[drop]
        self.around[drop] = set()
        self.points[keep] = target
        self.size[keep] = self.size[keep] * (1.0 - share) + self.size[drop] * share
        if self.degree[drop]:
            self.move_features(keep, drop)
        for v in sorted(self.ring(keep) - {keep}):
            self.push(keep, v)
        return len(shared)

    def move_features(self, keep: int, drop: int) -> None:
        """Hand the feature edges of `drop` to `keep`; the edge between them goes."""
        self.features.discard(edge_key(keep, drop))
        for v in sorted(self.ring(keep) - {keep}):
            if edge_key(drop, v) in self.features:
                self.features.discard(edge_key(drop, v))
                self.features.add(edge_key(keep, v))
        self.degree[drop] = 0

    def run(self, face_count: int) -> tuple[Points, Faces, set[Edge]]:
        """Collapse until at most `face_count` faces are left; returns compact points, faces and feature edges."""
        edges = {edge_key(f[k], f[k - 1]) for f in self.faces for k in range(3)}
        for a, b in sorted(edges):
            self.push(a, b)
        left = len(self.faces)
        while left > face_count and self.heap:
            cost, a, b = heapq.heappop(self.heap)
            if not self.around[a] & self.around[b]:
                continue
            p, q = self.points[a], self.points[b]
            length = ((p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2) ** 0.5
            if round(2.0 * length / (self.size[a] + self.size[b]), 6) == cost:
                left -= self.collapse(a, b)
        faces = np.array([f for f in self.faces if f is not None], dtype=np.int64)
        points, faces, index = compact(np.array(self.points), faces)
        return points, faces, {edge_key(int(index[a]), int(index[b])) for a, b in self.features}


def _normal(a: tuple, b: tuple, c: tuple) -> tuple[float, float, float]:
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


def _cosine(u: Points, v: Points) -> NDArray[np.float64]:
    return dot(u, v) / np.sqrt(np.maximum(dot(u, u) * dot(v, v), 1e-30))


def _beyond_delaunay(points: Points, faces: Faces) -> list[Edge]:
    """Return the edges between two faces whose opposite angles sum to over 180 degrees."""
    starts, ends, tips = faces.ravel(), faces[:, [1, 2, 0]].ravel(), faces[:, [2, 0, 1]].ravel()
    cosine = _cosine(points[starts] - points[tips], points[ends] - points[tips])
    key = np.minimum(starts, ends) * len(points) + np.maximum(starts, ends)
    order = np.argsort(key, kind="stable")
    first, second = order[:-1], order[1:]
    pair = key[first] == key[second]
    # cos a + cos b < 0 is a + b > 180 degrees; the margin keeps rounding from deciding about squares.
    bad = first[pair][cosine[first[pair]] + cosine[second[pair]] < -1e-4]
    return [edge_key(a, b) for a, b in zip(starts[bad].tolist(), ends[bad].tolist(), strict=True)]


def flip_edges(points: Points, faces: Faces, features: set[Edge]) -> Faces:
    """Flip every edge whose opposite angles sum to over 180 degrees (Delaunay criterion) where the fold allows it."""
    # The number of sweeps is bounded: on a curved surface the criterion alone might cycle.
    for _ in range(4):
        table = faces.tolist()
        owners: dict[Edge, list[int]] = {}
        for index, face in enumerate(table):
            for k in range(3):
                owners.setdefault(edge_key(face[k], face[k - 1]), []).append(index)
        touched: set[int] = set()
        for edge in _beyond_delaunay(points, faces):
            # A face flipped in this sweep has new angles, so its other edges wait for the next one.
            pair = owners[edge]
            if edge not in features and touched.isdisjoint(pair) and _flip(points, table, owners, edge):
                touched.update(pair)
        if not touched:
            break
        faces = np.array(table, dtype=np.int64)
    return faces


def _flip(points: Points, table: list[list[int]], owners: dict[Edge, list[int]], edge: Edge) -> bool:
    a, b = edge
    first, second = owners[edge]
    face = table[first]
    if face[(face.index(a) + 1) % 3] != b:
        first, second = second, first
    c = next(v for v in table[first] if v not in edge)
    d = next(v for v in table[second] if v not in edge)
    if edge_key(c, d) in owners:
        return False
    old = _normal(*points[[a, b, c]].tolist()), _normal(*points[[b, a, d]].tolist())
    new = _normal(*points[[c, d, b]].tolist()), _normal(*points[[d, c, a]].tolist())
    total = [x + y for x, y in zip(*old, strict=True)]
    for normal in new:
        dot = sum(x * y for x, y in zip(normal, total, strict=True))
        # A new face may stand at most 53 degrees (cosine 0.6) off the mean of the old ones.
        if dot <= 0.0 or dot * dot < 0.36 * sum(x * x for x in normal) * sum(x * x for x in total):
            return False
    table[first], table[second] = [c, d, b], [d, c, a]
    owners[edge_key(c, d)] = owners.pop(edge)
    owners[edge_key(a, c)] = [second if f == first else f for f in owners[edge_key(a, c)]]
    owners[edge_key(b, d)] = [first if f == second else f for f in owners[edge_key(b, d)]]
    return True


def vertex_normals(points: Points, faces: Faces) -> Points:
    """Return unit vertex normals ``(V, 3)``, the area-weighted means of the face normals."""
    corner = points[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    total = np.stack(
        [np.bincount(faces.ravel(), np.repeat(normal[:, axis], 3), minlength=len(points)) for axis in range(3)], axis=1
    )
    return total / np.maximum(np.sqrt(dot(total, total)), 1e-30)[:, None]


def relax(points: Points, faces: Faces, size: Size, fixed: NDArray[np.bool_], amount: float = 0.5) -> Points:
    """Move each free vertex in its tangent plane towards the centroid of its faces, weighted by area over size."""
    corner = points[faces]
    centroid = corner.mean(axis=1)
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    weight = np.sqrt(dot(normal, normal)) / size(centroid) ** 2
    flat, total = faces.ravel(), np.zeros((len(points), 4))
    for column, value in enumerate([*(centroid * weight[:, None]).T, weight]):
        total[:, column] = np.bincount(flat, np.repeat(value, 3), minlength=len(points))
    move = total[:, :3] / np.maximum(total[:, 3:], 1e-30) - points
    unit = vertex_normals(points, faces)
    move -= unit * dot(move, unit)[:, None]
    return points + amount * move * ~fixed[:, None]


def well_shaped(
    field: Field, points: Points, faces: Faces, size: Size, face_count: int, features: set[Edge], rounds: int = 6
) -> tuple[Points, Faces, set[Edge]]:
    """Return the mesh of the zero set of `field` with about `face_count` well-shaped faces, and its feature edges."""
    points, faces, features = EdgeCollapser(points, faces, size, features).run(face_count)
    fixed = np.zeros(len(points), dtype=bool)
    fixed[sorted({v for edge in features for v in edge})] = True
    step = float(np.median(size(points)))
    for _ in range(rounds):
        faces = flip_edges(points, faces, features)
        moved = project(field, relax(points, faces, size, fixed), 0.5 * step)
        points = np.where(fixed[:, None], points, moved)
    return points, flip_edges(points, faces, features), features
