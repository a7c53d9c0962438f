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

    def least(self, near: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """``H`` (n, P, 3, 3) and where the quadric pulled towards ``near`` is least, at most the fit's reach from it."""
        trace = np.trace(self.A, axis1=2, axis2=3)
        H = self.A + (SURFACE_PULL * trace + TINY)[..., None, None] * np.eye(3)
        slope = np.einsum("npij,npj->npi", self.A, near) + self.b
        away = np.linalg.solve(H, slope[..., None])[..., 0]
        reach = float(REACH) * np.sqrt(trace / (3.0 * np.pi))
        share = np.minimum(1.0, reach / np.maximum(np.linalg.norm(away, axis=2), TINY))
        return H, near - share[..., None] * away


def pose_quadrics(poses: np.ndarray, faces: np.ndarray) -> PoseQuadrics:
    """Planes of faces by area and of border edges by squared length, at their vertices, of points (P, V, 3)."""
    pose_count, vertex_count = poses.shape[:2]
    edges = edge_table(faces)
    border = np.column_stack([edges.ends, edges.wings[:, 0]])[edges.face_count == 1]
    sums = PoseQuadrics(
        np.zeros((vertex_count, pose_count, 3, 3)),
        np.zeros((vertex_count, pose_count, 3)),
        np.zeros((vertex_count, pose_count)),
    )
    for pose, point in enumerate(poses.astype(np.float64)):
        cross = np.cross(point[faces[:, 1]] - point[faces[:, 0]], point[faces[:, 2]] - point[faces[:, 0]])
        edge = point[border[:, 1]] - point[border[:, 0]]
        across = np.cross(edge, np.cross(edge, point[border[:, 2]] - point[border[:, 0]]))
        for vertices, normal, weight in (
            (faces, cross, 0.5 * np.linalg.norm(cross, axis=1)),
            (border[:, :2], across, (edge**2).sum(axis=1)),
        ):
            n = normal / np.maximum(np.linalg.norm(normal, axis=1), TINY)[:, None]
            d = -(n * point[vertices[:, 0]]).sum(axis=1)
            for corner in vertices.T:
                np.add.at(sums.A[:, pose], corner, np.einsum("f,fi,fj->fij", weight, n, n))
                np.add.at(sums.b[:, pose], corner, (weight * d)[:, None] * n)
                np.add.at(sums.c[:, pose], corner, weight * d * d)
    return sums


class Order(Protocol):
    """What merged vertices are, and what they cost."""

    posed: np.ndarray  # (V, P, 3)

    def merged(self, u: np.ndarray, v: np.ndarray) -> dict[str, np.ndarray]:
        """For pairs of vertices, (n, ...): "cost" and "posed" of what they become, and what else it has."""

    def commit(self, u: int, v: int, row: dict[str, np.ndarray]) -> None:
        """Vertex u becomes one row of :meth:`merged`."""


class PoseOrder:
    """Merged vertices are free in every pose (``dsd``)."""

    def __init__(self, poses: np.ndarray, faces: np.ndarray) -> None:
        self.quadrics = pose_quadrics(poses, faces)
        self.posed = np.ascontiguousarray(poses.transpose(1, 0, 2), dtype=np.float64)

    def merged(self, u: np.ndarray, v: np.ndarray) -> dict[str, np.ndarray]:
        """See :class:`Order`."""
        pair = self.quadrics.pair(u, v)
        _, posed = pair.least(0.5 * (self.posed[u] + self.posed[v]))
        return {"cost": pair.at(posed) + self._length_cost(pair, u, v), "posed": posed}

    def commit(self, u: int, v: int, row: dict[str, np.ndarray]) -> None:
        """See :class:`Order`."""
        for of_pose in (self.quadrics.A, self.quadrics.b, self.quadrics.c):
            of_pose[u] += of_pose[v]
        self.posed[u] = row["posed"]

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

    def __init__(
        self, skin: LinearSkin, transforms: np.ndarray, faces: np.ndarray, influences: int, device: str
    ) -> None:
        self._transforms, self._influences, self._device = transforms, influences, device
        self.rest = skin.rest.copy()
        self.weights = np.zeros((len(skin.rest), transforms.shape[1]))
        np.add.at(self.weights, (np.arange(len(skin.rest))[:, None], skin.joints), skin.weights)
        super().__init__(self._pose(self.rest, self.weights).transpose(1, 0, 2), faces)

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
        stiffness, goal = pair.least(self._pose(rest, weights))
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

    def __init__(self, faces: np.ndarray, vertex_count: int) -> None:
        self.faces = faces.copy()
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
    mesh = _Mesh(faces, vertex_count)
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
            collapsed = 0
            for edge in np.argsort(cost, kind="stable")[:count].tolist():
                u, v = ends[edge].tolist()
                star = mesh.star[u] | mesh.star[v]
                if live <= target or star & taken:
                    continue
                row = {name: values[edge] for name, values in rows.items()}
                if not mesh.is_legal(u, v, order.posed, row["posed"]):
                    asleep[edge] = True
                    continue
                taken |= star
                live -= mesh.collapse(u, v)
                order.commit(u, v, row)
                parent[v] = u
                changed[u] = True
                near[[u, *mesh.ring(u)]] = True
                collapsed += 1
            if not collapsed and count == int(np.isfinite(cost).sum()):
                break
            fraction = CAP_FRACTION if collapsed else min(1.0, 4 * fraction)
        yield mesh.left(parent)


def _spliced(old: np.ndarray | None, index: np.ndarray, kept: np.ndarray, fresh: np.ndarray) -> np.ndarray:
    """Rows of ``old`` where kept, of ``fresh`` elsewhere."""
    if old is None:
        return fresh
    values = old[index]
    values[~kept] = fresh
    return values
