"""What puts clusters of input vertices where they belong: gathered from an ordered mesh, then placed block by block."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import warp as wp

from warpqem.decimation.decimate import DecimatedMesh
from warpqem.decimation.initial_quadrics import CONSTRAINT_WEIGHT
from warpqem.decimation.quadric_sums import QuadricSums
from warpqem.kernels import cluster_rows as kernels
from warpqem.mesh.mesh_input import AnimatedMesh
from warpqem.mesh.seams import half_edge_ends
from warpqem.place.anchors import fit_anchors, nearest_anchors
from warpqem.place.block_placer import BlockPlacer, ClusterData, PlacedBlocks
from warpqem.place.cluster_parts import ClusterParts
from warpqem.place.cluster_rows import match_keys, sum_repeated
from warpqem.place.softness import chosen_stiffness
from warpqem.place.stiffness import (
    MIN_REGULARISATION,
    MIN_STIFFNESS,
    softer_choices,
    stiffness_by_size,
)
from warpqem.runtime import new_arrays
from warpqem.runtime.device import device_traits
from warpqem.runtime.part_launches import FIRST_ITEM, launch_in_parts, rows_of

__all__ = ["ClusterPlacer", "PlaceSettings"]

# What the plane of a seam weighs where a vertex is placed. In the order it weighs more: collapses that bend a seam are
# not taken back, while the refit fits seams to seams. Three times as much costs 1 % of the distance of characters.
SEAM_WEIGHT = 0.1


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
        coherence_cost: soften all clusters until stiffness adds little to the mean squared distance of the whole mesh,
            and on where vertices hardly wander further for it, see
            :func:`warpqem.place.stiffness.cost_of_coherence`. A cluster's place then depends on the others, so that
            levels of a progressive mesh, which share clusters, do without: infinite.
        softening: halvings of the stiffness that all clusters have at least.
    """

    epsilon: float
    regularisation: float
    endpoint: bool
    loose: np.ndarray | None = None
    coherence_cost: float = math.inf
    softening: int = 0


class ClusterPlacer:
    """Places one vertex for each of some disjoint clusters of input vertices, in any block of frames.

    Args:
        ordered: result of decimation; at each of ``kept``, its state when that vertex stood for its cluster.
        kept: (C,) int32, the input vertex that each cluster goes by.
        parts: the clusters, and what belongs to them.
        quadric_scale: (V,) float32, scale of each input vertex's quadric.
        pinned: (V,) bool, input vertices that keep their position, beside those that are not manifold.
        settings: see :class:`PlaceSettings`.
        device: Warp device.
        sums: quadrics of other vertices that count at a vertex too; None for none.

    Attributes:
        vertex_count: clusters C.
        free: (C,) bool, vertices that may leave the place that their quadrics give them: those that stand for several
            input vertices, are not pinned, and no corner of a seam.
        seam: half-edges of the input's seams, both of each edge.
        on_seam: (C,) bool, vertices that stand for one on a seam.
        border: half-edges of the input without an opposite one.
        is_open: (C,) bool, vertices at which there may be such half-edges of the output.
        nearest: (C,) int32 on the device, an input vertex of each cluster near to its anchor.
        copied_count: vertices M that are copies of an input vertex.
        copied: (M,) int32 on the device, these vertices.
        clusters: what placing a block of frames takes.
        device: Warp device.
    """

    def __init__(
        self,
        ordered: DecimatedMesh,
        kept: np.ndarray,
        parts: ClusterParts,
        quadric_scale: np.ndarray,
        pinned: np.ndarray,
        settings: PlaceSettings,
        device: str,
        sums: QuadricSums | None = None,
    ) -> None:
        self._settings, self.device = settings, device
        self.vertex_count = len(kept)
        non_manifold = ordered.non_manifold[kept]
        pinned = pinned[kept] | non_manifold
        clusters, faces, corner_vertex = parts.clusters, parts.faces, parts.corner_vertex
        size = clusters.size
        stiffness, regularisation = stiffness_by_size(size, settings.epsilon, settings.regularisation)
        if settings.loose is not None:
            loose = _loose_clusters(settings.loose, parts)
            stiffness[loose], regularisation[loose] = MIN_STIFFNESS, MIN_REGULARISATION
        if settings.endpoint:
            anchors = nearest_anchors(ordered, clusters)
            solved, held = np.zeros(len(kept), dtype=np.int32), np.zeros(len(kept), dtype=bool)
        else:
            anchors = fit_anchors(ordered, kept, clusters, regularisation)
            # A vertex alone in its cluster lies on all its planes: it is its own optimum.
            solved, held = ((size > 1) & ~pinned).astype(np.int32), pinned
        self.nearest = anchors.finish(kept, held)
        # Corners of seams keep the place that their own planes and seams give them.
        self.free = (solved == 1) & (clusters.highest_rank != 2)
        half_edge, kind = parts.half_edge, parts.kind
        self.seam = half_edge[kind >= 2]
        # Both their faces have them.
        self.on_seam = _holding(parts.owner(faces.ravel()[self.seam]), len(kept))
        self.border = half_edge[kind % 2 == 1]
        self.is_open = _holding(parts.owner(half_edge_ends(faces, self.border)), len(kept)) | non_manifold
        weight = np.where(kind == 1, CONSTRAINT_WEIGHT[1], SEAM_WEIGHT)
        self.clusters = ClusterData(
            corner_vertex=corner_vertex,
            rows={
                "member_start": anchors.start,
                "member": anchors.vertex,
                "member_weight": anchors.weight,
                **_face_rows(parts),
                **_other_planes(parts, weight, len(kept), quadric_scale, sums),
                "solved": solved,
                "stiffness": stiffness,
            },
        )
        self._blocks = BlockPlacer(self.clusters, device)
        self._softest: wp.array | None = None
        choices = softer_choices(stiffness)
        # Where no cluster has a choice, the device is not asked.
        if not settings.endpoint and (choices[:, 0] > choices[:, -1]).any():
            there = new_arrays.uploaded(choices, dtype=wp.float32, device=device, copy=False)
            sums = self._blocks.measure_stiffness(ordered.key_position, ordered.key_count, there)
            recent = ordered.log.last_errors(kept)
            chosen = chosen_stiffness(sums, there, recent, settings.coherence_cost, settings.softening)
            self._softest = chosen.softest
            self._blocks.set_stiffness(chosen.stiffness)
        # A vertex that is not solved for is copied, so that it keeps its bits: the one that its anchor is.
        copied = np.flatnonzero(solved == 0)
        copied_from = self.nearest.numpy() if settings.endpoint else kept[copied]
        self._blocks.copy_vertices(copied_from, copied)
        self.copied, self.copied_count = self._blocks.copied, len(copied)

    @property
    def softening(self) -> int:
        """Halvings of the stiffness that all clusters have at least; the device is asked."""
        return self._settings.softening if self._softest is None else int(self._softest.numpy()[0])

    def place(self, mesh: AnimatedMesh, points: wp.array, packed: wp.array | None = None) -> PlacedBlocks:
        """Place some frames of the mesh, given about its origin: (n, V) points; see :class:`BlockPlacer`."""
        return self._blocks.place(mesh, points, packed)


def _loose_clusters(loose: np.ndarray, parts: ClusterParts) -> np.ndarray | slice:
    """The clusters of input vertices (V,) bool that are placed loosely; none is without a vertex."""
    if loose.all():
        return slice(None)
    owner = parts.owner(np.flatnonzero(loose))
    return owner[owner >= 0]


def _holding(owner: np.ndarray, cluster_count: int) -> np.ndarray:
    """(C,) bool, clusters that hold one of some input vertices, of which these are the owners; -1 for none."""
    holding = np.zeros(cluster_count, dtype=bool)
    holding[owner[owner >= 0]] = True
    return holding


def _face_rows(parts: ClusterParts) -> dict[str, wp.array]:
    """What the rows of the faces of clusters are; where the host would wait for how many, with room for any number."""
    faces, corner_vertex, room = parts.own_faces, parts.corner_vertex, parts.room
    device = corner_vertex.device
    if room is None:
        room = len(corner_vertex) if device_traits(str(device)).own_memory else int(faces.total.numpy()[0])
    face, weight = faces.listed(room)
    corners = new_arrays.empty(room, dtype=wp.vec3i, device=device)
    if room:
        inputs = [rows_of(face), corner_vertex, faces.total, FIRST_ITEM]
        launch_in_parts(kernels.gather_corners, room, inputs, [rows_of(corners)], device=device)
    return {"face_start": faces.start, "face": corners, "face_weight": weight}


def _other_planes(
    parts: ClusterParts,
    weight: np.ndarray,
    cluster_count: int,
    quadric_scale: np.ndarray,
    sums: QuadricSums | None,
) -> dict[str, np.ndarray]:
    """Border and seam half-edges of each cluster, each once, weighted by its ends there; what the rows of them are.

    Faces and half-edges at other vertices that ``sums`` names are rows of their own, or have a larger weight.
    """
    faces, half_edge = parts.faces, parts.half_edge
    corner_vertex = faces.ravel()
    ends = np.concatenate([half_edge, half_edge - half_edge % 3 + (half_edge + 1) % 3])
    end_vertex = corner_vertex[ends]
    # Cluster, half-edge and weight.
    border = (
        parts.owner(end_vertex),
        np.concatenate([half_edge, half_edge]),
        np.concatenate([weight, weight]) * quadric_scale[end_vertex],
    )
    other: tuple[np.ndarray, np.ndarray, np.ndarray] = (
        np.empty(0, dtype=np.int32),
        np.empty(0, dtype=np.int64),
        np.empty(0),
    )
    if sums is not None:
        owner = parts.owner(sums.entry_row)
        entry, corner = match_keys(sums.vertex, corner_vertex)
        other = (owner[entry], corner // 3, sums.weight[entry] * quadric_scale[corner_vertex[corner]])
        entry, end = match_keys(sums.vertex, end_vertex)
        joined = (owner[entry], border[1][end], sums.weight[entry] * border[2][end])
        rows, items, weights = (np.concatenate(pair) for pair in zip(border, joined, strict=True))
        border = (rows, items, weights)
    other_start, other_face, other_weight = sum_repeated(*other, cluster_count)
    border_start, border_half_edge, border_weight = sum_repeated(*border, cluster_count)
    return {
        "other_start": other_start,
        "other": faces[other_face],
        "other_weight": other_weight,
        "border_start": border_start,
        "border": border_half_edge,
        "border_weight": border_weight,
    }
