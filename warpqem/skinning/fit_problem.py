"""The device side of the skin fit: planes of the clusters, and the solves in batches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from warpqem.decimation.initial_quadrics import CONSTRAINT_WEIGHT
from warpqem.kernels import skin_fit as kernels
from warpqem.mesh.edges import edge_table
from warpqem.mesh.mesh_input import is_proper
from warpqem.mesh.seams import read_seams
from warpqem.place.cluster_rows import sum_repeated
from warpqem.runtime.part_launches import FIRST_ITEM, columns_of, launch_in_parts, rows_of, starts_of

__all__ = ["CandidateRows", "ClusterPlanes", "SkinFit"]

# Rounds of the two solves. See the notes for what more of them bring.
ROUNDS = 6
# Regularisation along the surface, towards where placement put the vertex, relative to the quadric. See the notes.
SURFACE_REGULARISATION = 0.01
# Regularisation of the rest position and of the weights towards where they start, relative to their systems: little
# enough to leave to the poses what they tell apart.
POSITION_REGULARISATION = 1e-3
WEIGHT_REGULARISATION = 1e-3
# Vertices solved for at once, which bounds the scratch memory: a few KB each.
VERTICES_AT_ONCE = 16384


@dataclass(frozen=True)
class CandidateRows:
    """Joints that C vertices may choose from, as compressed rows.

    Attributes:
        start: (C + 1,) int32.
        joint: (M,) int32.
        weight: (M,) float64, the weights to start from.
    """

    start: np.ndarray
    joint: np.ndarray
    weight: np.ndarray


class ClusterPlanes:
    """Faces, border and seam edges of the clusters, each once, weighted by its corners there.

    Args:
        faces: (N, 3) int32, the input's faces.
        vertex_map: (V,) int32, output vertex of each input vertex, -1 for none.
        cluster_count: output vertices C.
        seams: (S, 2) vertex pairs, or None.
        device: Warp device.
    """

    def __init__(self, faces: np.ndarray, vertex_map: np.ndarray, cluster_count: int, seams: Any, device: str) -> None:
        faces = np.ascontiguousarray(faces[is_proper(faces)])
        corner = faces.ravel()
        face_start, face, face_weight = sum_repeated(
            vertex_map[corner], np.arange(len(corner)) // 3, np.ones(len(corner)), cluster_count
        )
        edges = edge_table(faces)
        border = edges.face_count == 1
        seam = np.flatnonzero(read_seams(seams, faces, len(vertex_map)).half_edge)
        triples = np.concatenate(
            [
                np.column_stack([edges.ends[border], edges.opposites[border, 0]]),
                np.stack([np.roll(faces, -k, axis=1).ravel()[seam] for k in range(3)], axis=1),
            ]
        )
        weight = np.repeat([CONSTRAINT_WEIGHT[1], CONSTRAINT_WEIGHT[2]], [border.sum(), len(seam)])
        border_start, edge, border_weight = sum_repeated(
            vertex_map[triples[:, :2].T.ravel()],
            np.tile(np.arange(len(triples)), 2),
            np.tile(weight, 2),
            cluster_count,
        )
        self._starts = (face_start, border_start)
        self._rows = [
            (wp.array(faces[face], dtype=wp.vec3i, device=device), wp.array(face_weight, device=device)),
            (
                wp.array(triples[edge].astype(np.int32).reshape(-1, 3), dtype=wp.vec3i, device=device),
                wp.array(border_weight, device=device),
            ),
        ]
        self._device = device

    def gather(
        self, clusters: slice, points: wp.array, placed: np.ndarray, to_planes: bool
    ) -> tuple[wp.array, wp.array]:
        """``H`` (C, P) and ``y`` (P, C) of some clusters in all poses.

        Args:
            clusters: which ones, C of them.
            points: (P, V) points of the input.
            placed: (P, C, 3), where placement put the vertices.
            to_planes: aim at the least of the quadrics, not at where they were placed.
        """
        count = clusters.stop - clusters.start
        shape = (points.shape[0], count)
        stiffness = wp.empty(shape[::-1], dtype=wp.mat33d, device=self._device)
        goal = wp.empty(shape, dtype=wp.vec3d, device=self._device)
        place = wp.array(np.ascontiguousarray(placed, dtype=np.float64), dtype=wp.vec3d, device=self._device)
        starts = [
            wp.array(start[clusters.start : clusters.stop + 1], dtype=wp.int32, device=self._device)
            for start in self._starts
        ]
        inputs: list[Any] = []
        for start, (item, weight) in zip(starts, self._rows, strict=True):
            inputs += [starts_of(start), item, weight]
        launch_in_parts(
            kernels.gather_planes,
            (count, shape[0]),
            inputs=[*inputs, points, columns_of(place), SURFACE_REGULARISATION, int(to_planes)],
            outputs=[rows_of(stiffness), columns_of(goal)],
            device=self._device,
        )
        return stiffness, goal


class SkinFit:
    """The solves of all vertices over P poses.

    Args:
        transforms: (P, J, 3, 4) float64.
        rows: candidate joints of C vertices.
        rest: (C, 3) float64, rest positions to start from, on a mesh of unit diagonal.
        placed: (P, C, 3), where placement put the vertices, on that mesh.
        offsets: (P, C, 3) offsets of blend shapes in the caller's units, or None.
        unit: what takes the caller's units to that mesh.
        device: Warp device.

    Attributes:
        device: Warp device.
    """

    def __init__(
        self,
        transforms: np.ndarray,
        rows: CandidateRows,
        rest: np.ndarray,
        placed: np.ndarray,
        offsets: np.ndarray | None,
        unit: float,
        device: str,
    ) -> None:
        self._rows, self._rest, self._placed, self.device = rows, rest, placed, device
        self._offsets = None if offsets is None else offsets * unit
        self._rotation = self._array(transforms[..., :3], wp.mat33d)
        self._translation = self._array(transforms[..., 3] * unit, wp.vec3d)

    def _array(self, values: np.ndarray, dtype: Any) -> wp.array:
        return wp.array(np.ascontiguousarray(values), dtype=dtype, device=self.device)

    def solve(
        self, planes: ClusterPlanes, points: np.ndarray, influences: int, to_planes: bool
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, float]:
        """Solve for all vertices.

        Args:
            planes: of the clusters.
            points: (P, V, 3) float32, the input in its poses, on a mesh of unit diagonal.
            influences: joints that move a vertex at most.
            to_planes: see :meth:`ClusterPlanes.gather`.

        Returns:
            rest positions (C, 3), weights of the candidates (M,), E before and after (C,), all float64, and the area of
            all planes over all poses.
        """
        position = wp.array(np.ascontiguousarray(points), dtype=wp.vec3, device=self.device)
        parts, size = [], 0.0
        for first in range(0, len(self._rest), VERTICES_AT_ONCE):
            batch = slice(first, min(first + VERTICES_AT_ONCE, len(self._rest)))
            stiffness, goal = planes.gather(batch, position, self._placed[:, batch], to_planes)
            size += float(np.trace(stiffness.numpy(), axis1=2, axis2=3).sum()) / (1.0 + 3.0 * SURFACE_REGULARISATION)
            parts.append(self._solve_batch(batch, stiffness, goal, influences))
        rest, weight, before, after = (np.concatenate(column) for column in zip(*parts, strict=True))
        return rest, weight, before, after, size

    def _solve_batch(
        self, batch: slice, stiffness: wp.array, goal: wp.array, influences: int
    ) -> tuple[np.ndarray, ...]:
        start = self._rows.start[batch.start : batch.stop + 1]
        row = slice(int(start[0]), int(start[-1]))
        rows = CandidateRows(start - start[0], self._rows.joint[row], self._rows.weight[row])
        offsets = None if self._offsets is None else self._offsets[:, batch]
        return self.solve_rows(rows, self._rest[batch], offsets, stiffness, goal, influences)

    def solve_rows(
        self,
        rows: CandidateRows,
        rest: np.ndarray,
        offsets: np.ndarray | None,
        stiffness: wp.array,
        goal: wp.array,
        influences: int,
    ) -> tuple[np.ndarray, ...]:
        """Solve for R rows, each a vertex with candidate joints; a vertex may be in several rows.

        Args:
            rows: candidate joints of each row.
            rest: (R, 3) float64, rest positions to start from.
            offsets: (P, R, 3) offsets of blend shapes, or None.
            stiffness: (R, P) mat33d.
            goal: (P, R) vec3d.
            influences: joints that move a vertex at most.

        Returns:
            rest positions (R, 3), weights of the candidates (M,), E before and after (R,), all float64.
        """
        device, count = self.device, len(rest)
        problem = kernels.SkinProblem()
        problem.candidate_start = self._array(rows.start, wp.int32)
        problem.candidate = self._array(rows.joint, wp.int32)
        problem.start_weight = self._array(rows.weight, wp.float64)
        problem.start_rest = self._array(rest, wp.vec3d)
        problem.rotation, problem.translation = self._rotation, self._translation
        problem.offset = self._array(np.zeros((0, 0, 3)) if offsets is None else offsets, wp.vec3d)
        problem.stiffness, problem.goal = stiffness, goal
        problem.position_regularisation = POSITION_REGULARISATION
        problem.regularisation_of_weight = WEIGHT_REGULARISATION
        problem.rounds, problem.max_influences = ROUNDS, influences
        scratch = self._scratch(np.diff(rows.start).astype(np.int64))
        solved = wp.empty(count, dtype=wp.vec3d, device=device)
        weight = wp.empty(len(rows.joint), dtype=wp.float64, device=device)
        before, after = (wp.empty(count, dtype=wp.float64, device=device) for _ in range(2))
        outputs = [solved, weight, before, after]
        launch_in_parts(kernels.fit_vertices, count, [problem, scratch, FIRST_ITEM], outputs, device=device)
        return solved.numpy(), weight.numpy(), before.numpy(), after.numpy()

    def _scratch(self, size: np.ndarray) -> kernels.SkinScratch:
        end = np.cumsum(size * size)
        scratch = kernels.SkinScratch()
        scratch.matrix_start = self._array(end - size * size, wp.int32)
        for name in ("gram", "factor"):
            setattr(scratch, name, wp.empty(int(end[-1]), dtype=wp.float64, device=self.device))
        for name in ("first", "second", "regularisation"):
            setattr(scratch, name, wp.empty(int(size.sum()), dtype=wp.float64, device=self.device))
        for name in ("slot", "state"):
            setattr(scratch, name, wp.empty(int(size.sum()), dtype=wp.int32, device=self.device))
        return scratch
