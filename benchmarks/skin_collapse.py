"""Collapse edges of a skinned mesh in passes, by any :class:`benchmarks.skin_order.Order`, on the host.

A pass takes an independent set among the cheapest few percent of the edges, as :mod:`warpqem.decimation.passes`
does, with the rules of :mod:`warpqem.kernels.legality` for manifolds, flips (in no pose) and distances of merged
vertices.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.skin_order import TINY, Order, Rows
from warpqem.mesh.edges import edge_key, edge_table

__all__ = ["Collapsed", "collapse_edges", "squared_distances"]

# As in the order of warpqem: part of the edges that a pass looks at, and the fewest.
CANDIDATE_FRACTION, MIN_CANDIDATES = 0.05, 32
# As there: a face may not turn by more than 78 degrees; what the squared distance of merged vertices from the faces
# left costs; and how much more than its cost an edge may turn out to cost.
TURN_COSINE, GAP_COST, COST_SLACK = 0.2, 2.0, 1.2
# Squared normals below this belong to faces without an orientation.
NO_AREA = 1e-28


@dataclass(frozen=True)
class Collapsed:
    """What is left.

    Attributes:
        faces: (N', 3) int32, over the vertices left.
        face_map: (N',) int32, the input faces that they were.
        vertex: (C,) int, the input vertex that each vertex left goes by.
        vertex_map: (V,) int32, the vertex left that each input vertex went into; -1 for none.
    """

    faces: np.ndarray
    face_map: np.ndarray
    vertex: np.ndarray
    vertex_map: np.ndarray


class _Mesh:
    """Faces by vertex, and the rules of :mod:`warpqem.kernels.legality` that need no more than them."""

    def __init__(self, faces: np.ndarray, points: np.ndarray) -> None:
        vertex_count = len(points)
        self.faces = faces.copy()
        self.parent = np.arange(vertex_count)
        self.members = [[vertex] for vertex in range(vertex_count)]
        self.points = points.copy()
        corner = points[faces]
        area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1) / 6.0
        self.area = np.bincount(faces.ravel(), np.repeat(area, 3), minlength=vertex_count)
        self.alive = np.ones(len(faces), dtype=bool)
        self.faces_of: list[set[int]] = [set() for _ in range(vertex_count)]
        for face, corners in enumerate(faces.tolist()):
            for vertex in corners:
                self.faces_of[vertex].add(face)
        edges = edge_table(faces)
        self.non_manifold = np.zeros(vertex_count, dtype=bool)
        self.non_manifold[edges.ends[edges.face_count > 2]] = True
        for vertex in np.unique(faces).tolist():
            # A fan has as many neighbours as faces inside, one more at a border.
            self.non_manifold[vertex] |= len(self.ring(vertex)) - len(self.faces_of[vertex]) not in (0, 1)

    def ring(self, vertex: int) -> set[int]:
        return set(self.faces[list(self.faces_of[vertex])].ravel().tolist()) - {vertex}

    def on_border(self, vertex: int) -> bool:
        return len(self.ring(vertex)) != len(self.faces_of[vertex])

    def is_legal(self, u: int, v: int, posed: np.ndarray, target: np.ndarray) -> bool:
        shared = self.faces_of[u] & self.faces_of[v]
        if (
            self.non_manifold[u]
            or self.non_manifold[v]
            or len(self.faces_of[u]) + len(self.faces_of[v]) <= 2 * len(shared)
        ):
            return False
        opposites = set(self.faces[list(shared)].ravel().tolist()) - {u, v}
        if self.ring(u) & self.ring(v) != opposites or (len(shared) == 2 and self.on_border(u) and self.on_border(v)):
            return False
        if any(
            len(self.faces_of[opposite_vertex]) <= (1 if self.on_border(opposite_vertex) else 3)
            for opposite_vertex in opposites
        ):
            return False
        corners = self.faces[list((self.faces_of[u] | self.faces_of[v]) - shared)]
        old = posed[corners]
        new = np.where(((corners == u) | (corners == v))[..., None, None], target, old)
        n, m = (np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]) for x in (old, new))
        turned = (n * m).sum(axis=2) <= TURN_COSINE * np.linalg.norm(n, axis=2) * np.linalg.norm(m, axis=2)
        return not (turned & ((n**2).sum(axis=2) > NO_AREA)).any()

    def gap(self, u: int, v: int, posed: np.ndarray, target: np.ndarray) -> float:
        """Area times squared distance of the merged vertices from the faces left around them, in the first pose."""
        corners = self.faces[list((self.faces_of[u] | self.faces_of[v]) - (self.faces_of[u] & self.faces_of[v]))]
        triangles = np.where(((corners == u) | (corners == v))[..., None], target[0], posed[corners, 0])
        members = self.members[u] + self.members[v]
        return float((self.area[members] * squared_distances(self.points[members], triangles).min(axis=1)).sum())

    def collapse(self, u: int, v: int) -> None:
        """Let v become u."""
        shared = self.faces_of[u] & self.faces_of[v]
        for face in shared:
            self.alive[face] = False
            for vertex in self.faces[face].tolist():
                self.faces_of[vertex].discard(face)
        for face in self.faces_of[v]:
            self.faces[face][self.faces[face] == v] = u
        self.faces_of[u] |= self.faces_of[v]
        self.faces_of[v] = set()
        self.members[u] += self.members[v]
        self.parent[v] = u

    def left(self) -> Collapsed:
        parent = self.parent
        while not np.array_equal(parent, parent[parent]):
            parent = parent[parent]
        face_map = np.flatnonzero(self.alive).astype(np.int32)
        vertex, faces = np.unique(self.faces[face_map], return_inverse=True)
        index = np.full(len(parent), -1, dtype=np.int32)
        index[vertex] = np.arange(len(vertex))
        return Collapsed(faces.reshape(-1, 3).astype(np.int32), face_map, vertex, index[parent])


class _Costs:
    """Rows of all edges, kept from pass to pass."""

    def __init__(self, order: Order) -> None:
        self._order, vertex_count = order, len(order.posed)
        self._key = np.zeros(0, dtype=np.int64)
        self.ends = np.zeros((0, 2), dtype=np.int32)
        self.rows: Rows = {}
        self.suspended = np.zeros(0, dtype=bool)
        self.changed, self.near = np.ones(vertex_count, dtype=bool), np.ones(vertex_count, dtype=bool)

    def update(self, faces: np.ndarray) -> None:
        """Cost the edges of these faces (N, 3) that have a changed end; those near a change are no longer suspended."""
        self.ends = edge_table(faces).ends
        key = edge_key(self.ends[:, 0], self.ends[:, 1], len(self.changed))
        kept, old = np.zeros(len(key), dtype=bool), np.zeros(len(key), dtype=np.int64)
        if len(self._key):
            old = np.searchsorted(self._key, key).clip(max=len(self._key) - 1)
            kept = ~self.changed[self.ends].any(axis=1) & (self._key[old] == key)
        if kept.all():
            merged = {name: values[:0] for name, values in self.rows.items()}
        else:
            merged = self._order.merged(self.ends[~kept, 0], self.ends[~kept, 1])
        for name, fresh in merged.items():
            values = self.rows[name][old] if kept.any() else np.empty_like(fresh, shape=(len(key), *fresh.shape[1:]))
            values[~kept] = fresh
            self.rows[name] = values
        still = kept & ~self.near[self.ends].any(axis=1)
        still[still] = self.suspended[old[still]]
        self._key, self.suspended = key, still
        self.changed[:], self.near[:] = False, False

    def candidates(self, fraction: float) -> tuple[list[int], bool]:
        """The cheapest edges that are not suspended, and whether they are all of them."""
        left = np.flatnonzero(~self.suspended)
        count = min(max(MIN_CANDIDATES, int(fraction * len(self.ends))), len(left))
        order = np.argsort(self.rows["cost"][left], kind="stable")
        return left[order[:count]].tolist(), count == len(left)


def collapse_edges(order: Order, faces: np.ndarray, targets: Sequence[int]) -> Iterator[Collapsed]:
    """Collapse edges until the targets are met.

    Args:
        order: says what merged vertices are, and holds those left.
        faces: (N, 3), proper.
        targets: face counts, falling.

    Yields:
        what is left at each target, or where no edge is legal.
    """
    mesh, costs = _Mesh(faces, order.posed[:, 0]), _Costs(order)
    fraction = CANDIDATE_FRACTION
    for target in targets:
        while mesh.alive.sum() > target:
            costs.update(mesh.faces[mesh.alive])
            chosen, are_all = costs.candidates(fraction)
            collapsed, costlier = _collapse_some(order, mesh, costs, chosen, target)
            if are_all and not collapsed + costlier:
                break
            fraction = CANDIDATE_FRACTION if collapsed else min(1.0, 4 * fraction)
        yield mesh.left()


def _collapse_some(order: Order, mesh: _Mesh, costs: _Costs, chosen: list[int], target: int) -> tuple[int, int]:
    """Collapse those edges that are legal and share no face; how many did, and how many turned out to cost more."""
    taken: set[int] = set()
    collapsed = costlier = 0
    for edge in chosen:
        u, v = costs.ends[edge].tolist()
        around = mesh.faces_of[u] | mesh.faces_of[v]
        if mesh.alive.sum() <= target or around & taken:
            continue
        row = {name: values[edge] for name, values in costs.rows.items()}
        if not mesh.is_legal(u, v, order.posed, row["posed"]):
            costs.suspended[edge] = True
            continue
        cost = GAP_COST * order.posed.shape[1] * mesh.gap(u, v, order.posed, row["posed"])
        if cost > COST_SLACK * row["cost"]:
            costs.rows["cost"][edge] = cost
            costlier += 1
            continue
        taken |= around
        mesh.collapse(u, v)
        order.commit(u, v, row)
        ring = [u, *mesh.ring(u)]
        costs.near[ring] = True
        costs.changed[ring if order.memoryless else u] = True
        if order.memoryless:
            for vertex in ring:
                order.renew(vertex, mesh.faces[list(mesh.faces_of[vertex])])
        collapsed += 1
    return collapsed, costlier


def squared_distances(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(n, m), of points (n, 3) from triangles (m, 3, 3)."""
    best = np.full((len(points), len(triangles)), np.inf)
    inside = np.ones(best.shape, dtype=bool)
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    for k in range(3):
        a, edge = triangles[:, k], triangles[:, (k + 1) % 3] - triangles[:, k]
        away = points[:, None] - a
        t = ((away * edge).sum(axis=2) / np.maximum((edge**2).sum(axis=1), TINY)).clip(0.0, 1.0)
        best = np.minimum(best, ((away - t[..., None] * edge) ** 2).sum(axis=2))
        inside &= (np.cross(edge, away) * normal).sum(axis=2) > 0.0
    height = ((points[:, None] - triangles[:, 0]) * normal).sum(axis=2)
    square = np.maximum((normal**2).sum(axis=1), TINY)
    return np.where(inside, height**2 / square, best)
