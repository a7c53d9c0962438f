"""What belongs to clusters of input vertices: these, the faces at them, and their edges of borders and seams."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.decimation.decimate import DecimatedMesh
from warpqem.kernels import cluster_rows as kernels
from warpqem.place.anchors import Clusters
from warpqem.place.cluster_rows import ClusterFaces
from warpqem.runtime import new_arrays
from warpqem.runtime.ahead import done_ahead
from warpqem.runtime.part_launches import launch_in_parts, rows_of

__all__ = ["ClusterParts", "LevelParts"]


@dataclass(frozen=True)
class ClusterParts:
    """Clusters, and what belongs to them.

    Attributes:
        faces: (N, 3) int32, those of the input around them at least.
        corner_vertex: (3N,) int32 on the device, the same.
        clusters: the clusters C.
        own_faces: the faces of each.
        room: (cluster, face) pairs at most; None where the host does not know.
        half_edge: (h,) int, half-edges of ``faces`` on borders and seams, ascending.
        kind: (h,) int8, 1 at borders, 2 at seams.
        owner: gives the cluster (n,) int of some input vertices (n,) int, -1 for none.
    """

    faces: np.ndarray
    corner_vertex: wp.array
    clusters: Clusters
    own_faces: ClusterFaces
    room: int | None
    half_edge: np.ndarray
    kind: np.ndarray
    owner: Callable[[np.ndarray], np.ndarray]

    @classmethod
    def of(
        cls,
        faces: np.ndarray,
        ordered: DecimatedMesh,
        cluster: np.ndarray,
        cluster_count: int,
        quadric_scale: np.ndarray,
        device: str,
    ) -> ClusterParts:
        """Those of clusters of which the host knows the vertices.

        Args:
            faces: see above; ``ordered.constrained`` is of these.
            ordered: result of decimation.
            cluster: (V,) int32, the cluster of each input vertex, -1 where there is none.
            cluster_count: clusters C.
            quadric_scale: (V,) float32, scale of each input vertex's quadric.
            device: Warp device.
        """
        clusters = Clusters.of(cluster, ordered.line_rank, cluster_count, device)
        corner_vertex = new_arrays.uploaded(faces.ravel(), dtype=wp.int32, device=device, copy=False)
        scale = new_arrays.uploaded(quadric_scale, dtype=wp.float32, device=device, copy=False)
        own_faces = _own_faces(corner_vertex, clusters.cluster, scale, cluster_count)
        half_edge = np.flatnonzero(ordered.constrained)
        kind = ordered.constrained.take(half_edge)
        return cls(faces, corner_vertex, clusters, own_faces, None, half_edge, kind, cluster.take)


class LevelParts:
    """The same of clusters of levels of one search, found on a device with memory of its own.

    Args:
        faces: (N, 3) int32, the input's.
        corner_vertex: (3N,) int32 on the device, the same.
        ordered: the level that all are near to.
        quadric_scale: (V,) float32, scale of each input vertex's quadric.
        counts: gives of some roots (n,) of the level asked for last how many vertices each stands for, (n,) int32, and
            how many corners of faces these have.
        device: Warp device.
    """

    def __init__(
        self,
        faces: np.ndarray,
        corner_vertex: wp.array,
        ordered: DecimatedMesh,
        quadric_scale: np.ndarray,
        counts: Callable[[np.ndarray], tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]],
        device: str,
    ) -> None:
        self._faces, self._corner_vertex, self._counts, self._device = faces, corner_vertex, counts, device
        self._row, self._line_rank = (
            new_arrays.uploaded(values, dtype=wp.int32, device=device) for values in (ordered.row, ordered.line_rank)
        )
        self._scale = new_arrays.uploaded(quadric_scale, dtype=wp.float32, device=device)
        self._lines = done_ahead(partial(_lines, ordered))

    def of(self, root: np.ndarray, root_there: wp.array, kept: npt.NDArray[np.int32]) -> ClusterParts:
        """Those of the clusters that go by some vertices (C,), ascending.

        Args:
            root: (V,) int32, the vertex that each input vertex collapsed into.
            root_there: the same on the device.
            kept: these vertices.
        """
        count, corner_vertex = len(kept), self._corner_vertex
        size, corners = self._counts(kept)
        cluster = self._clusters(root_there, kept)
        row = new_arrays.like(root_there)
        wp.copy(row, wp.indexedarray(self._row, [root_there]))
        half_edge, kind, ranked, rank = self._lines()
        owner = partial(_owner, root, kept)
        of_ranked = owner(ranked)
        inside = np.flatnonzero(of_ranked >= 0)
        clusters = Clusters.known(cluster, self._line_rank, size, of_ranked[inside], rank[inside], row)
        corner_count = int(corners.sum())
        own_faces = _own_faces(corner_vertex, cluster, self._scale, count, corner_count)
        return ClusterParts(self._faces, corner_vertex, clusters, own_faces, corner_count, half_edge, kind, owner)

    def _clusters(self, root_there: wp.array, kept: npt.NDArray[np.int32]) -> wp.array:
        """(V,) int32, the place of each vertex's root among those kept, -1 for none."""
        device, cluster = self._device, new_arrays.like(root_there)
        index = new_arrays.full(len(root_there), -1, dtype=wp.int32, device=device)
        every = np.arange(len(kept), dtype=np.int32)
        chosen, place = (new_arrays.uploaded(values, dtype=wp.int32, device=device) for values in (kept, every))
        wp.copy(wp.indexedarray(index, [chosen]), place)
        wp.copy(cluster, wp.indexedarray(index, [root_there]))
        return cluster


def _lines(ordered: DecimatedMesh) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Half-edges on borders and seams with their kind, and vertices of a rank above 0 with it."""
    half_edge, ranked = np.flatnonzero(ordered.constrained), np.flatnonzero(ordered.line_rank > 0)
    return half_edge, ordered.constrained.take(half_edge), ranked, ordered.line_rank.take(ranked)


def _owner(root: np.ndarray, kept: np.ndarray, vertex: np.ndarray) -> npt.NDArray[np.int64]:
    """The place of the roots of some vertices (n,) among those kept (C,), ascending, one at least; -1 for others."""
    end = root.take(vertex)
    place = np.minimum(np.searchsorted(kept, end), len(kept) - 1)
    return np.where(kept.take(place) == end, place, -1)


def _own_faces(
    corner_vertex: wp.array, cluster: wp.array, scale: wp.array, cluster_count: int, corner_count: int | None = None
) -> ClusterFaces:
    """Faces of each cluster, each once, weighted by its corners there, of which there may be a known number."""
    device, every_corner = corner_vertex.device, len(corner_vertex)
    corner_cluster = new_arrays.empty(every_corner, dtype=wp.int32, device=device)
    corner_weight = new_arrays.empty(every_corner, dtype=wp.float32, device=device)
    inputs, outputs = [rows_of(corner_vertex), cluster, scale], [rows_of(corner_cluster), rows_of(corner_weight)]
    launch_in_parts(kernels.label_corners, every_corner, inputs, outputs, device=device)
    return ClusterFaces(corner_cluster, corner_weight, cluster_count, corner_count)
