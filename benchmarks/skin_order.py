"""What a merged vertex of a skinned mesh is and costs: by ``E(v, a)``, or free in every pose.

"Simplification of articulated meshes" (Landreneau & Schaefer 2009): every candidate edge gets the rest position ``v``
and the weights ``a`` that together minimise ``E(v, a) = sum_j p_j^T Q_j p_j``, ``p_j = sum_k a_k M_k^j v``, over the
quadrics of both ends in every pose ``j``. That minimum is its cost, and the merged vertex keeps ``v`` and ``a``. The
minima are those of :mod:`warpqem.kernels.skin_fit`, for all edges that changed at once, in float64.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import warp as wp

from warpqem.kernels.skin_fit import REACH
from warpqem.mesh.edges import edge_table
from warpqem.skinning.fit_problem import SURFACE_REGULARISATION, CandidateRows, SkinFit
from warpqem.skinning.linear_skin import LinearSkin, blend_influences

__all__ = ["JointOrder", "Order", "PoseOrder", "PoseQuadrics", "Rows", "pose_quadrics"]

# What an edge's squared length counts beside its cost, relative to the quadric: the order where the surface is flat.
LENGTH_COST = 1e-6
TINY = 1e-30

Rows = dict[str, np.ndarray]


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
        H = self.A + (SURFACE_REGULARISATION * trace + TINY)[..., None, None] * np.eye(3)
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
    border = np.column_stack([edges.ends, edges.opposites[:, 0]])[edges.face_count == 1]
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

    posed: np.ndarray  # (V, P, 3), the vertices
    memoryless: bool  # quadrics are those of the present faces

    def merged(self, u: np.ndarray, v: np.ndarray) -> Rows:
        """For pairs of vertices, (n, ...): "cost" and "posed" of what they become, and what else it has."""

    def commit(self, u: int, v: int, row: Rows) -> None:
        """Vertex u becomes one row of :meth:`merged`."""

    def renew(self, vertex: int, faces: np.ndarray) -> None:
        """Make the quadric of a vertex that of its faces (n, 3)."""


class PoseOrder:
    """Merged vertices are free in every pose (``dsd``)."""

    reach = np.inf

    def __init__(self, poses: np.ndarray, faces: np.ndarray, memoryless: bool = False) -> None:
        self.quadrics = pose_quadrics(poses, faces)
        self.memoryless = memoryless
        self.posed = np.ascontiguousarray(poses.transpose(1, 0, 2), dtype=np.float64)

    def merged(self, u: np.ndarray, v: np.ndarray) -> Rows:
        """See :class:`Order`."""
        pair = self.quadrics.pair(u, v)
        _, posed = pair.least(0.5 * (self.posed[u] + self.posed[v]), self.reach)
        return {"cost": pair.at(posed) + self._length_cost(pair, u, v), "posed": posed}

    def commit(self, u: int, v: int, row: Rows) -> None:
        """See :class:`Order`."""
        for of_pose in (self.quadrics.A, self.quadrics.b, self.quadrics.c):
            of_pose[u] += of_pose[v]
        self.posed[u] = row["posed"]

    def renew(self, vertex: int, faces: np.ndarray) -> None:
        """See :class:`Order`."""
        used, index = np.unique(faces, return_inverse=True)
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

    def merged(self, u: np.ndarray, v: np.ndarray) -> Rows:
        """See :class:`Order`; "rest" (n, 3) and "weights" (n, J) too."""
        pair = self.quadrics.pair(u, v)
        # From the best point of the edge, which poses and skin share.
        along = self.posed[v] - self.posed[u]
        slope = np.einsum("npij,npj->npi", pair.A, self.posed[u]) + pair.b
        bend = np.einsum("npi,npij,npj->n", along, pair.A, along, optimize=True)
        t = np.where(bend > TINY, -(along * slope).sum(axis=(1, 2)) / np.maximum(bend, TINY), 0.5).clip(0.0, 1.0)[
            :, None
        ]
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

    def commit(self, u: int, v: int, row: Rows) -> None:
        """See :class:`Order`."""
        super().commit(u, v, row)
        self.rest[u], self.weights[u] = row["rest"], row["weights"]

    def skin(self, vertices: np.ndarray, influences: int) -> LinearSkin:
        """The skin of some vertices, their largest weights alone."""
        rows = np.broadcast_to(np.arange(self.weights.shape[1], dtype=np.int32), (len(vertices), self.weights.shape[1]))
        index, share = np.arange(len(vertices))[:, None], np.ones((len(vertices), 1))
        joints, weights = blend_influences(rows, self.weights[vertices], index, share, influences)
        return LinearSkin(self.rest[vertices], joints, weights)
