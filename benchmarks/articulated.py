"""Order of collapses of a skinned mesh by ``E(v, a)`` ("Simplification of articulated meshes", Landreneau & Schaefer).

A study beside the product: warpqem orders collapses by the quadrics of the poses and fits the skin of the vertices that
are left (:mod:`warpqem.skinning.fit`). Here every candidate edge gets the rest position ``v`` and the weights ``a``
that together minimise ``E(v, a) = sum_j p_j^T Q_j p_j``, ``p_j = sum_k a_k M_k^j v``, over both ends' quadrics in every
pose ``j``; that minimum is its cost, and the merged vertex keeps ``v`` and ``a``. :class:`PoseOrder` is the control:
the same loop, the merged vertex free in every pose.

The minima are those of :mod:`warpqem.kernels.skin_fit`, for all edges that changed at once. Which of the cheapest edges
collapse is decided on the host, edge by edge. Meshes are of unit diagonal, all in float64.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import warp as wp

from warpqem.edges import edge_key, edge_table
from warpqem.kernels.skin_fit import REACH
from warpqem.skinning.problem import SURFACE_PULL, CandidateRows, SkinFit
from warpqem.skinning.skin import LinearSkin

__all__ = ["Collapsed", "JointOrder", "Order", "PoseOrder", "PoseQuadrics", "collapse_edges", "pose_quadrics"]

# As in the order of warpqem: part of the edges that a pass looks at, and the fewest.
CAP_FRACTION, LEAST_CANDIDATES = 0.05, 32
# As there: a face may not turn by more than 78 degrees in any pose.
TURN_COSINE = 0.2
# What an edge's squared length counts beside its cost, relative to the quadric: the order where the surface is flat.
LENGTH_COST = 1e-6
# As in warpqem.kernels.legality: what the squared distance of merged vertices from the faces left costs, and how much
# more than its cost an edge may turn out to cost.
GAP_COST, DEARER = 2.0, 1.2
TINY = 1e-30


@dataclass
class PoseQuadrics:
    """Quadrics ``p^T A p + 2 b.p + c`` of n vertices in P poses: A (n, P, 3, 3), b (n, P, 3), c (n, P)."""

    A: np.ndarray
    b: np.ndarray
    c: np.ndarray

    def pair(self, u: np.ndarray, v: np.ndarray) -> PoseQuadrics:
        """The sums for pairs of vertices."""
        return PoseQuadrics(self.A[u] + self.A[v], self.b[u] + self.b[v], self.c[u] + self.c[v])

    def at(self, points: np.ndarray) -> np.ndarray:
        """(n,), the sum over poses at points (n, P, 3)."""
        square = np.einsum("npi,npij,npj->n", points, self.A, points, optimize=True)
        total: np.ndarray = square + 2.0 * (self.b * points).sum(axis=(1, 2)) + self.c.sum(axis=1)
        return np.maximum(total, 0.0)

    def least(self, near: np.ndarray, most: float) -> tuple[np.ndarray, np.ndarray]:
        """``H`` (n, P, 3, 3) and where the quadric pulled towards ``near`` is least, at most so many radii from it."""
        trace = np.trace(self.A, axis1=2, axis2=3)
        H = self.A + (SURFACE_PULL * trace + TINY)[..., None, None] * np.eye(3)
        slope = np.einsum("npij,npj->npi", self.A, near) + self.b
        away = np.linalg.solve(H, slope[..., None])[..., 0]
        reach = most * np.sqrt(trace / (3.0 * np.pi))
        share = np.minimum(1.0, reach / np.maximum(np.linalg.norm(away, axis=2), TINY))
        return H, near - share[..., None] * away


def pose_quadrics(poses: np.ndarray, faces: np.ndarray, only: int | None = None) -> PoseQuadrics:
    """Planes of faces by area and of border edges by squared length at their vertices, of points (P, V, 3).

    ``only`` names the one vertex that is wanted, all of whose faces are given.
    """
    edges = edge_table(faces)
    border = np.column_stack([edges.ends, edges.wings[:, 0]])[edges.face_count == 1]
    if only is not None:
        border = border[(border[:, :2] == only).any(axis=1)]
    x = poses.astype(np.float64)
    cross = np.cross(x[:, faces[:, 1]] - x[:, faces[:, 0]], x[:, faces[:, 2]] - x[:, faces[:, 0]])
    edge = x[:, border[:, 1]] - x[:, border[:, 0]]
    across = np.cross(edge, np.cross(edge, x[:, border[:, 2]] - x[:, border[:, 0]]))
    count = x.shape[1] if only is None else 1
    total = PoseQuadrics(*(np.zeros((count, len(x), *shape)) for shape in ((3, 3), (3,), ())))
    for vertices, normal, weight in (
        (faces, cross, 0.5 * np.linalg.norm(cross, axis=2)),
        (border[:, :2], across, (edge**2).sum(axis=2)),
    ):
        n = (normal / np.maximum(np.linalg.norm(normal, axis=2), TINY)[..., None]).transpose(1, 0, 2)
        d, w = -(n * x[:, vertices[:, 0]].transpose(1, 0, 2)).sum(axis=2), weight.T
        planes = (w[..., None, None] * n[..., None] * n[..., None, :], (w * d)[..., None] * n, w * d * d)
        for name, values in zip(("A", "b", "c"), planes, strict=True):
            for corner in vertices.T:
                if only is None:
                    np.add.at(getattr(total, name), corner, values)
                else:
                    getattr(total, name)[0] += values[corner == only].sum(axis=0)
    return total


class Order(Protocol):
    """What merged vertices are, and what they cost."""

    posed: np.ndarray  # (V, P, 3)
    memoryless: bool

    def merged(self, u: np.ndarray, v: np.ndarray) -> dict[str, np.ndarray]:
        """For pairs of vertices, (n, ...): "cost" and "posed" of what they become, and what else it has."""

    def commit(self, u: int, v: int, row: dict[str, np.ndarray]) -> None:
        """Vertex u becomes one row of :meth:`merged`."""


class PoseOrder:
    """Merged vertices are free in every pose (``dsd``)."""

    reach = np.inf

    def __init__(self, poses: np.ndarray, faces: np.ndarray, memoryless: bool = False) -> None:
        self.quadrics = pose_quadrics(poses, faces)
        self.memoryless = memoryless
        self.posed = np.ascontiguousarray(poses.transpose(1, 0, 2), dtype=np.float64)

    def merged(self, u: np.ndarray, v: np.ndarray) -> dict[str, np.ndarray]:
        """See :class:`Order`."""
        pair = self.quadrics.pair(u, v)
        _, posed = pair.least(0.5 * (self.posed[u] + self.posed[v]), self.reach)
        return {"cost": pair.at(posed) + self._length_cost(pair, u, v), "posed": posed}

    def commit(self, u: int, v: int, row: dict[str, np.ndarray]) -> None:
        """See :class:`Order`."""
        for of_pose in (self.quadrics.A, self.quadrics.b, self.quadrics.c):
            of_pose[u] += of_pose[v]
        self.posed[u] = row["posed"]

    def renew(self, vertex: int, star: np.ndarray) -> None:
        """Make the quadric of a vertex that of its faces (n, 3)."""
        used, index = np.unique(star, return_inverse=True)
        own = int(np.searchsorted(used, vertex))
        around = pose_quadrics(self.posed[used].transpose(1, 0, 2), index.reshape(-1, 3), own)
        for name in ("A", "b", "c"):
            getattr(self.quadrics, name)[vertex] = getattr(around, name)[0]

    def _length_cost(self, pair: PoseQuadrics, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        square = ((self.posed[u] - self.posed[v]) ** 2).sum(axis=2)
        cost: np.ndarray = LENGTH_COST * (np.trace(pair.A, axis1=2, axis2=3) * square).sum(axis=1)
        return cost


class JointOrder(PoseOrder):
    """Merged vertices have one rest position and one set of weights in all poses.

    Args:
        skin: of the input, float64, its rest points the first pose.
        transforms: (P, J, 3, 4).
        faces: (N, 3).
        influences: joints that move a vertex at most.
        device: Warp device.
    """

    reach = float(REACH)

    def __init__(
        self,
        skin: LinearSkin,
        transforms: np.ndarray,
        faces: np.ndarray,
        influences: int,
        device: str,
        memoryless: bool = False,
    ) -> None:
        self._transforms, self._influences, self._device = transforms, influences, device
        self.rest = skin.rest.copy()
        self.weights = np.zeros((len(skin.rest), transforms.shape[1]))
        np.add.at(self.weights, (np.arange(len(skin.rest))[:, None], skin.joints), skin.weights)
        super().__init__(self._pose(self.rest, self.weights).transpose(1, 0, 2), faces, memoryless)

    def _pose(self, rest: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """(n, P, 3)."""
        pose_count, joint_count = self._transforms.shape[:2]
        blend = weights @ self._transforms.transpose(1, 0, 2, 3).reshape(joint_count, -1)
        blend = blend.reshape(len(rest), pose_count, 3, 4)
        posed: np.ndarray = np.einsum("npij,nj->npi", blend[..., :3], rest) + blend[..., 3]
        return posed

    def merged(self, u: np.ndarray, v: np.ndarray) -> dict[str, np.ndarray]:
        """See :class:`Order`; "rest" (n, 3) and "weights" (n, J) too."""
        pair = self.quadrics.pair(u, v)
        # From the best point of the edge, which poses and skin share.
        along = self.posed[v] - self.posed[u]
        slope = np.einsum("npij,npj->npi", pair.A, self.posed[u]) + pair.b
        bend = np.einsum("npi,npij,npj->n", along, pair.A, along, optimize=True)
        t = np.where(bend > TINY, -(along * slope).sum(axis=(1, 2)) / np.maximum(bend, TINY), 0.5).clip(0.0, 1.0)[:, None]
        rest = (1.0 - t) * self.rest[u] + t * self.rest[v]
        weights = (1.0 - t) * self.weights[u] + t * self.weights[v]
        stiffness, goal = pair.least(self._pose(rest, weights), self.reach)
        row, joint = np.nonzero((self.weights[u] > 0) | (self.weights[v] > 0))
        start = np.searchsorted(row, np.arange(len(u) + 1)).astype(np.int32)
        rows = CandidateRows(start, joint.astype(np.int32), weights[row, joint])
        fit = SkinFit(self._transforms, rows, rest, goal.transpose(1, 0, 2), None, 1.0, self._device)
        fitted, weight, *_ = fit._solve_batch(
            slice(0, len(u)),
            wp.array(np.ascontiguousarray(stiffness), dtype=wp.mat33d, device=self._device),
            wp.array(np.ascontiguousarray(goal.transpose(1, 0, 2)), dtype=wp.vec3d, device=self._device),
            self._influences,
        )
        best = np.zeros_like(weights)
        best[row, joint] = weight
        posed = self._pose(fitted, best)
        cost = pair.at(posed) + self._length_cost(pair, u, v)
        return {"cost": cost, "posed": posed, "rest": fitted, "weights": best}

    def commit(self, u: int, v: int, row: dict[str, np.ndarray]) -> None:
        """See :class:`Order`."""
        super().commit(u, v, row)
        self.rest[u], self.weights[u] = row["rest"], row["weights"]


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
    """Faces with stars, and the rules of :mod:`warpqem.kernels.legality` that need no more than them."""

    def __init__(self, faces: np.ndarray, points: np.ndarray) -> None:
        vertex_count = len(points)
        self.faces = faces.copy()
        self.members = [[vertex] for vertex in range(vertex_count)]
        self.points = points.copy()
        corner = points[faces]
        area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1) / 6.0
        self.area = np.bincount(faces.ravel(), np.repeat(area, 3), minlength=vertex_count)
        self.alive = np.ones(len(faces), dtype=bool)
        self.star: list[set[int]] = [set() for _ in range(vertex_count)]
        for face, corners in enumerate(faces.tolist()):
            for vertex in corners:
                self.star[vertex].add(face)
        edges = edge_table(faces)
        self.frozen = np.zeros(vertex_count, dtype=bool)
        self.frozen[edges.ends[edges.face_count > 2]] = True
        for vertex in np.unique(faces).tolist():
            # A fan has as many neighbours as faces inside, one more at a border.
            self.frozen[vertex] |= len(self.ring(vertex)) - len(self.star[vertex]) not in (0, 1)

    def ring(self, vertex: int) -> set[int]:
        return set(self.faces[list(self.star[vertex])].ravel().tolist()) - {vertex}

    def on_border(self, vertex: int) -> bool:
        return len(self.ring(vertex)) != len(self.star[vertex])

    def is_legal(self, u: int, v: int, posed: np.ndarray, target: np.ndarray) -> bool:
        shared = self.star[u] & self.star[v]
        if self.frozen[u] or self.frozen[v] or len(self.star[u]) + len(self.star[v]) <= 2 * len(shared):
            return False
        wings = set(self.faces[list(shared)].ravel().tolist()) - {u, v}
        if self.ring(u) & self.ring(v) != wings or (len(shared) == 2 and self.on_border(u) and self.on_border(v)):
            return False
        if any(len(self.star[wing]) <= (1 if self.on_border(wing) else 3) for wing in wings):
            return False
        corners = self.faces[list((self.star[u] | self.star[v]) - shared)]
        old = posed[corners]
        new = np.where(((corners == u) | (corners == v))[..., None, None], target, old)
        n, m = (np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]) for x in (old, new))
        turned = (n * m).sum(axis=2) <= TURN_COSINE * np.linalg.norm(n, axis=2) * np.linalg.norm(m, axis=2)
        return not (turned & (np.linalg.norm(n, axis=2) > 1e-14)).any()

    def gap(self, u: int, v: int, posed: np.ndarray, target: np.ndarray) -> float:
        """Area times squared distance of the merged vertices from the faces left around them, in the first pose."""
        corners = self.faces[list((self.star[u] | self.star[v]) - (self.star[u] & self.star[v]))]
        triangles = np.where(((corners == u) | (corners == v))[..., None], target[0], posed[corners, 0])
        members = self.members[u] + self.members[v]
        return float((self.area[members] * squared_distances(self.points[members], triangles).min(axis=1)).sum())

    def collapse(self, u: int, v: int) -> int:
        """Let v become u; the faces removed."""
        shared = self.star[u] & self.star[v]
        for face in shared:
            self.alive[face] = False
            for vertex in self.faces[face].tolist():
                self.star[vertex].discard(face)
        for face in self.star[v]:
            self.faces[face][self.faces[face] == v] = u
        self.star[u] |= self.star[v]
        self.star[v] = set()
        self.members[u] += self.members[v]
        return len(shared)

    def left(self, parent: np.ndarray) -> Collapsed:
        while not np.array_equal(parent, parent[parent]):
            parent = parent[parent]
        face_map = np.flatnonzero(self.alive).astype(np.int32)
        vertex, faces = np.unique(self.faces[face_map], return_inverse=True)
        index = np.full(len(parent), -1, dtype=np.int32)
        index[vertex] = np.arange(len(vertex))
        return Collapsed(faces.reshape(-1, 3).astype(np.int32), face_map, vertex, index[parent])


def collapse_edges(order: Order, faces: np.ndarray, targets: list[int]) -> Iterator[Collapsed]:
    """Collapse edges in passes, each an independent set among the cheapest few percent.

    Args:
        order: says what merged vertices are, and holds those left.
        faces: (N, 3), proper.
        targets: face counts, falling.

    Yields:
        what is left at each target, or where no edge is legal.
    """
    vertex_count = len(order.posed)
    mesh = _Mesh(faces, order.posed[:, 0])
    parent = np.arange(vertex_count)
    known = np.zeros(0, dtype=np.int64)
    rows: dict[str, np.ndarray] = {}
    asleep = np.zeros(0, dtype=bool)
    changed, near = np.ones(vertex_count, dtype=bool), np.ones(vertex_count, dtype=bool)
    live, fraction = len(faces), CAP_FRACTION
    for target in targets:
        while live > target:
            ends = edge_table(mesh.faces[mesh.alive]).ends
            key = edge_key(ends[:, 0], ends[:, 1], vertex_count)
            old = np.searchsorted(known, key).clip(max=max(len(known) - 1, 0))
            kept = ~changed[ends].any(axis=1) & (known[old] == key if len(known) else False)
            fresh = order.merged(*ends[~kept].T)
            rows = {name: _spliced(rows.get(name), old, kept, values) for name, values in fresh.items()}
            asleep = kept & ~near[ends].any(axis=1) & (asleep[old] if len(known) else False)
            known = key
            changed[:], near[:] = False, False
            cost = np.where(asleep, np.inf, rows["cost"])
            count = min(max(LEAST_CANDIDATES, int(fraction * len(key))), int(np.isfinite(cost).sum()))
            taken: set[int] = set()
            collapsed = collapsed_or_dearer = 0
            for edge in np.argsort(cost, kind="stable")[:count].tolist():
                u, v = ends[edge].tolist()
                star = mesh.star[u] | mesh.star[v]
                if live <= target or star & taken:
                    continue
                row = {name: values[edge] for name, values in rows.items()}
                if not mesh.is_legal(u, v, order.posed, row["posed"]):
                    asleep[edge] = True
                    continue
                price = GAP_COST * len(order.posed[0]) * mesh.gap(u, v, order.posed, row["posed"])
                if price > DEARER * rows["cost"][edge]:
                    rows["cost"][edge] = price
                    collapsed_or_dearer += 1
                    continue
                taken |= star
                live -= mesh.collapse(u, v)
                order.commit(u, v, row)
                parent[v] = u
                ring = [u, *mesh.ring(u)]
                near[ring] = True
                changed[ring if order.memoryless else u] = True
                if order.memoryless:
                    for w in ring:
                        order.renew(w, mesh.faces[list(mesh.star[w])])
                collapsed += 1
            if not collapsed + collapsed_or_dearer and count == int(np.isfinite(cost).sum()):
                break
            fraction = CAP_FRACTION if collapsed else min(1.0, 4 * fraction)
        yield mesh.left(parent)


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


def _spliced(old: np.ndarray | None, index: np.ndarray, kept: np.ndarray, fresh: np.ndarray) -> np.ndarray:
    """Rows of ``old`` where kept, of ``fresh`` elsewhere."""
    if old is None:
        return fresh
    values = old[index]
    values[~kept] = fresh
    return values
