"""What puts clusters of input vertices where they belong: gathered from an ordered mesh, then placed block by block."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from warpqem.decimation.decimate import DecimatedMesh
from warpqem.decimation.initial_quadrics import CONSTRAINT_WEIGHT
from warpqem.decimation.quadric_sums import QuadricSums
from warpqem.mesh.mesh_input import AnimatedMesh
from warpqem.place.anchors import Anchors, fit_anchors, nearest_anchors
from warpqem.place.block_placer import BlockPlacer, ClusterData, PlacedBlocks
from warpqem.place.cluster_rows import gather_faces, match_keys, sum_repeated
from warpqem.place.stiffness import (
    MIN_REGULARISATION,
    MIN_STIFFNESS,
    choose_softness,
    recent_errors,
    softer_choices,
    stiffness_by_size,
)

__all__ = ["ClusterPlacer", "PlaceSettings"]


@dataclass(frozen=True)
class PlaceSettings:
    """How vertices are placed.

    Attributes:
        epsilon: regularisation of a cluster of ``REGULARISED_SIZE`` vertices towards its material anchor, relative
            to the quadric; higher is steadier.
        regularisation: stiffness of its anchor's weights towards equal ones.
        endpoint: every output vertex is an input vertex.
        loose: (V,) bool, input vertices whose clusters are placed by their quadrics, with the least
            regularisation; None for none.
        evened: soften all clusters where stiffness costs the whole mesh much. A cluster's place then depends on the
            others, so that levels of a progressive mesh, which share clusters, do without.
    """

    epsilon: float
    regularisation: float
    endpoint: bool
    loose: np.ndarray | None = None
    evened: bool = False


class ClusterPlacer:
    """Places one vertex for each of some disjoint clusters of input vertices, in any block of frames.

    Args:
        faces: (N, 3) int32, the input's faces.
        ordered: result of decimation; at each of ``kept``, its state when that vertex stood for its cluster.
        kept: (C,) int32, the input vertex that each cluster goes by.
        cluster: (V,) int32, the cluster of each input vertex, -1 where there is none.
        quadric_scale: (V,) float32, scale of each input vertex's quadric.
        pinned: (V,) bool, input vertices that keep their position, beside those that are not manifold.
        settings: see :class:`PlaceSettings`.
        device: Warp device.
        sums: quadrics of other vertices that count at a vertex too; None for none.

    Attributes:
        vertex_count: clusters C.
        free: (C,) bool, vertices that may leave the place that their quadrics give them: those that stand for several
            input vertices, are not pinned, and no corner of a seam.
        on_seam: (C,) bool, vertices that stand for one on a seam.
        nearest: (C,) int32, an input vertex of each cluster near to its anchor.
        copied_count: vertices M that are copies of an input vertex.
        copied: (M,) int32 on the device, these vertices.
        clusters: what placing a block of frames takes.
        device: Warp device.
    """

    def __init__(
        self,
        faces: np.ndarray,
        ordered: DecimatedMesh,
        kept: np.ndarray,
        cluster: np.ndarray,
        quadric_scale: np.ndarray,
        pinned: np.ndarray,
        settings: PlaceSettings,
        device: str,
        sums: QuadricSums | None = None,
    ) -> None:
        self._settings, self.device = settings, device
        self._cluster = cluster
        self.vertex_count = len(kept)
        pinned = pinned | ordered.non_manifold
        size = np.bincount(cluster[cluster >= 0], minlength=len(kept))
        stiffness, regularisation = stiffness_by_size(size, settings.epsilon, settings.regularisation)
        if settings.loose is not None:
            loose = np.unique(cluster[settings.loose & (cluster >= 0)])
            stiffness[loose], regularisation[loose] = MIN_STIFFNESS, MIN_REGULARISATION
        if settings.endpoint:
            anchors = nearest_anchors(ordered, cluster, len(kept))
            solved = np.zeros(len(kept), dtype=np.int32)
        else:
            anchors = fit_anchors(ordered, kept, cluster, regularisation)
            anchors = _pin(anchors, kept, pinned)
            # A vertex alone in its cluster lies on all its planes: it is its own optimum.
            solved = ((size > 1) & ~pinned[kept]).astype(np.int32)
        # Corners of seams keep the place that their own planes and seams give them.
        at_corner = np.zeros(len(kept), dtype=bool)
        at_corner[cluster[(ordered.line_rank == 2) & (cluster >= 0)]] = True
        self.free = (solved == 1) & ~at_corner
        self.on_seam = _on_seam(faces, ordered.constrained, cluster, len(kept))
        self.nearest = anchors.vertex[_heaviest(anchors)]
        # An anchor that is one input vertex, not solved for, is copied, so that it keeps its bits.
        single = np.flatnonzero((solved == 0) & (np.maximum.reduceat(anchors.weight, anchors.start[:-1]) == 1.0))
        self.copied_count = len(single)
        self.clusters = ClusterData(
            corner_vertex=faces.ravel(),
            rows={
                **self._gather_clusters(faces, ordered.constrained, quadric_scale, anchors, sums),
                "solved": solved,
                "stiffness": stiffness,
            },
            copied_from=self.nearest[single],
            copied=single,
        )
        self._blocks = BlockPlacer(self.clusters, device)
        self.copied = self._blocks.copied
        if not settings.endpoint:
            choices = softer_choices(stiffness)
            error, area = self._blocks.measure_stiffness(ordered.key_position, choices)
            chosen = choose_softness(error, area, recent_errors(ordered.log, kept), evened=settings.evened)
            self._blocks.set_stiffness(choices[np.arange(len(kept)), chosen])

    def _gather_clusters(
        self,
        faces: np.ndarray,
        constrained: np.ndarray,
        quadric_scale: np.ndarray,
        anchors: Anchors,
        sums: QuadricSums | None,
    ) -> dict[str, np.ndarray]:
        """Faces, border and seam edges of each cluster, each once, weighted by its corners there.

        Those at other vertices that ``sums`` names are apart, or have a larger weight.
        """
        corner_vertex = faces.ravel()
        face_start, face, face_weight = gather_faces(
            self._cluster[corner_vertex], quadric_scale[corner_vertex], self.vertex_count, self.device
        )
        half_edge = np.flatnonzero(constrained)
        weight = np.where(constrained[half_edge] == 1, CONSTRAINT_WEIGHT[1], CONSTRAINT_WEIGHT[2])
        ends = np.concatenate([half_edge, half_edge - half_edge % 3 + (half_edge + 1) % 3])
        end_vertex = corner_vertex[ends]
        # Cluster, half-edge and weight.
        border = (
            self._cluster[end_vertex],
            np.concatenate([half_edge, half_edge]),
            np.concatenate([weight, weight]) * quadric_scale[end_vertex],
        )
        other: tuple[np.ndarray, np.ndarray, np.ndarray] = (
            np.empty(0, dtype=np.int32),
            np.empty(0, dtype=np.int64),
            np.empty(0),
        )
        if sums is not None:
            owner = self._cluster[sums.entry_row]
            entry, corner = match_keys(sums.vertex, corner_vertex)
            other = (owner[entry], corner // 3, sums.weight[entry] * quadric_scale[corner_vertex[corner]])
            entry, end = match_keys(sums.vertex, end_vertex)
            joined = (owner[entry], border[1][end], sums.weight[entry] * border[2][end])
            rows, items, weights = (np.concatenate(pair) for pair in zip(border, joined, strict=True))
            border = (rows, items, weights)
        other_start, other_face, other_weight = sum_repeated(*other, self.vertex_count)
        border_start, border_half_edge, border_weight = sum_repeated(*border, self.vertex_count)
        return {
            "member_start": anchors.start,
            "member": anchors.vertex,
            "member_weight": anchors.weight,
            "face_start": face_start,
            "face": faces[face],
            "face_weight": face_weight,
            "other_start": other_start,
            "other": faces[other_face],
            "other_weight": other_weight,
            "border_start": border_start,
            "border": border_half_edge,
            "border_weight": border_weight,
        }

    def place(self, mesh: AnimatedMesh, points: wp.array, packed: wp.array | None = None) -> PlacedBlocks:
        """Place some frames of the mesh, given about its origin: (n, V) points; see :class:`BlockPlacer`."""
        return self._blocks.place(mesh, points, packed)


def _on_seam(faces: np.ndarray, constrained: np.ndarray, cluster: np.ndarray, cluster_count: int) -> np.ndarray:
    """(C,) bool, clusters that hold a vertex of a seam. Seam edges are marked in both their faces."""
    owner = cluster[faces.ravel()[np.flatnonzero(constrained >= 2)]]
    on_seam = np.zeros(cluster_count, dtype=bool)
    on_seam[owner[owner >= 0]] = True
    return on_seam


def _heaviest(anchors: Anchors) -> np.ndarray:
    """Index into ``anchors.vertex`` of the member with the largest weight, per anchor (C,)."""
    cluster = np.repeat(np.arange(len(anchors.start) - 1), np.diff(anchors.start))
    largest = np.flatnonzero(anchors.weight == np.maximum.reduceat(anchors.weight, anchors.start[:-1])[cluster])
    return largest[np.unique(cluster[largest], return_index=True)[1]]


def _pin(anchors: Anchors, kept: np.ndarray, pinned: np.ndarray) -> Anchors:
    """Anchor each pinned vertex to itself alone, also where it is not among the nearest members of its cluster."""
    vertex, weight = anchors.vertex.copy(), anchors.weight.copy()
    cluster = np.repeat(np.arange(len(kept)), np.diff(anchors.start))
    weight[pinned[kept][cluster]] = 0.0
    first = anchors.start[:-1][pinned[kept]]
    vertex[first] = kept[pinned[kept]]
    weight[first] = 1.0
    return Anchors(anchors.start, vertex, weight)
