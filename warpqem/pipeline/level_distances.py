"""How far a level and the input are from each other in some frames, as faces around show: anew where the level changed.

Looked at are vertices of the input, points of those of its faces that are larger than the level's, and points of the
level's faces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warpqem.measure.far_points import FacesAround, furthest_from, longest_edges, unique_pairs
from warpqem.measure.unit_frames import UnitBlock, UnitFrames
from warpqem.pipeline.cut_levels import CutLevel, LevelFrames
from warpqem.pipeline.prepare import Prepared

__all__ = ["LevelDistances"]

# Points of a face: its middle and those of its edges.
SAMPLES = np.array([[1, 1, 1], [1.5, 1.5, 0], [0, 1.5, 1.5], [1.5, 0, 1.5]], dtype=np.float32) / 3
# Faces of the input whose longest edge in any frame is so many times the mean of those of the level have points of
# their own: nothing says that what lies over such a face is near to it, just as its vertices are. With 0.7 times the
# same spots are found.
LARGE = 1.5
# No distances matter below this part of the largest one at vertices of the input in the first level: hardly a mesh
# comes so far.
MIN_SHARE = 0.5
# Faces whose points are looked at at once: some 50 MB of them.
FACES_AT_ONCE = 8192


@dataclass(frozen=True)
class _Side:
    """Faces of one surface, and those that may be nearest to a cluster.

    Attributes:
        block: frames of its points.
        faces: what its faces' corners are.
        of_cluster: faces at each cluster, in rows.
        face: the face that each of them is; None where they are the same.
    """

    block: UnitBlock
    faces: FacesAround
    of_cluster: FacesAround
    face: np.ndarray | None = None

    def near(self, pair: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """The rows, and a face for each, of pairs of a row and a cluster."""
        found, place = self.of_cluster.of(pair[1])
        return pair[0][place], found if self.face is None else self.face[found]


class LevelDistances:
    """The distances between the input and the levels of a search.

    Args:
        work: the mesh, with no other frames than those to look at.
        points: (n, V, 3), all its frames.
        frames: of the levels.
        units: what brings them to unit size.
        limit: distances within it, in diagonals, are looked at no closer.

    Attributes:
        limit: the same, or a part of the largest distance of the first level.
    """

    def __init__(
        self, work: Prepared, points: np.ndarray, frames: LevelFrames, units: UnitFrames, limit: float
    ) -> None:
        self._mesh, self._device = work.mesh, work.device
        self._points, self._frames, self._units, self.limit = points, frames, units, limit
        vertex_count, face_count = points.shape[1], len(work.mesh.faces)
        self._around = FacesAround(work.mesh.faces, vertex_count)
        # How far each input vertex is, each large input face, and each face of a level, by the input face that it goes
        # on from.
        self._far_vertex = np.zeros(vertex_count, dtype=np.float32)
        self._large = np.empty(0, dtype=np.int64)
        self._far_large = np.empty(0, dtype=np.float32)
        self._far_face = np.zeros(face_count, dtype=np.float32)
        self._corners = np.full((face_count, 3), -1, dtype=np.int32)

    def renew(self, level: CutLevel, moved: np.ndarray | None) -> float:
        """The largest distance of a level, of which some vertices moved since the last one; None for all.

        At least the limit.
        """
        ordered = level.ordered
        if moved is None:
            self._choose_large(level)
        changed = self._changed(level, moved)
        near = np.zeros(len(ordered.root), dtype=bool)
        near[ordered.faces[changed]] = True
        is_near, here = near[ordered.root], self._here(level)
        around = FacesAround(ordered.faces, len(ordered.root))
        side = _Side(self._frames.test, around, around)
        vertex = np.flatnonzero(is_near & here)
        self._far_vertex[vertex] = self._vertex_distances(level, side, vertex)
        if moved is None:
            self.limit = max(self.limit, MIN_SHARE * float(self._far_vertex.max(initial=0.0)))
        corners = self._mesh.faces[self._large]
        is_large_here = here[corners].all(axis=1)
        self._far_large[~is_large_here] = 0.0
        row = np.flatnonzero(is_near[corners].any(axis=1) & is_large_here)
        clusters = ordered.root[corners[row]]
        self._far_large[row] = self._sampled(self._points, corners[row], clusters, around, side)
        held = self._held_side(level, near)
        faces, face = ordered.faces[changed], ordered.face_map[changed]
        self._far_face[face] = self._sampled(self._frames.level_points, faces, faces, around, held)
        found = self._far_vertex[here], self._far_large, self._far_face[ordered.face_map]
        return max(self.limit, *(float(part.max(initial=0.0)) for part in found))

    def _choose_large(self, level: CutLevel) -> None:
        """The input faces that are larger than those of the first level."""
        corner_vertex = self._around.corner_vertex.reshape(-1, 3)
        own = longest_edges(self._frames.reference, corner_vertex, self._device)
        mean = float(longest_edges(self._frames.test, level.ordered.faces, self._device).mean())
        self._large = np.flatnonzero(own > LARGE * mean)
        self._far_large = np.zeros(len(self._large), dtype=np.float32)

    def _changed(self, level: CutLevel, moved: np.ndarray | None) -> np.ndarray:
        """The faces of a level that are not what they were."""
        ordered = level.ordered
        face = ordered.face_map
        changed = (self._corners[face] != ordered.faces).any(axis=1)
        if moved is None:
            changed[:] = True
        else:
            is_moved = np.zeros(len(ordered.root), dtype=bool)
            is_moved[moved] = True
            changed |= is_moved[ordered.faces].any(axis=1)
        self._corners[face] = ordered.faces
        return np.flatnonzero(changed)

    def _here(self, level: CutLevel) -> np.ndarray:
        """(V,) bool, input vertices that a level has something of."""
        here: np.ndarray = level.is_kept[level.ordered.root] & self._mesh.used
        return here

    def _vertex_distances(self, level: CutLevel, side: _Side, vertex: np.ndarray) -> np.ndarray:
        """How far input vertices (n,) are from the faces around those that they went to, two rings of them."""
        root, around = level.ordered.root[vertex], side.faces
        blocks = self._frames.reference, side.block
        lists = (around.start, around.face)
        found = furthest_from(*blocks, around, vertex, root, lists, self.limit, self._device)
        far = np.flatnonzero(found > self.limit)
        if len(far):
            lists = around.second_ring(root[far])
            row = np.arange(len(far))
            found[far] = furthest_from(*blocks, around, vertex[far], row, lists, self.limit, self._device)
        return found

    def _held_side(self, level: CutLevel, wanted: np.ndarray) -> _Side:
        """The input, by the faces at the members of clusters that are wanted (V,) or next to these."""
        ordered = level.ordered
        next_to = wanted.copy()
        next_to[ordered.faces[wanted[ordered.faces].any(axis=1)]] = True
        corners = ordered.root[self._mesh.faces]
        face = np.flatnonzero(next_to[corners].any(axis=1))
        return _Side(self._frames.reference, self._around, FacesAround(corners[face], len(ordered.root)), face)

    def _sampled(
        self,
        points: np.ndarray,
        faces: np.ndarray,
        clusters: np.ndarray,
        around: FacesAround,
        side: _Side,
    ) -> np.ndarray:
        """How far points of faces (m, 3) of (n, V, 3) are from what a side has at their clusters (m, 3).

        ``around`` has the faces of the level at each of its clusters.
        """
        level_faces = around.corner_vertex.reshape(-1, 3)
        found = np.empty(len(faces), dtype=np.float32)
        for first in range(0, len(faces), FACES_AT_ONCE):
            part = slice(first, first + FACES_AT_ONCE)
            corner, cluster = points[:, faces[part]], clusters[part]
            pair = np.repeat(np.arange(len(cluster)), 3), cluster.ravel()
            found_here = self._from_near(corner, side, pair)
            far = np.flatnonzero(found_here > self.limit)
            if len(far):
                # The nearest face may be at a cluster next to these.
                face, place = around.of(cluster[far].ravel())
                pair = unique_pairs(np.repeat(place // 3, 3), level_faces[face].ravel())
                found_here[far] = self._from_near(corner[:, far], side, pair)
            found[part] = found_here
        return found

    def _from_near(self, corner: np.ndarray, side: _Side, pair: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """How far points of faces, by their corners (n, m, 3, 3), are from the faces at clusters: pairs, by row."""
        row, near = side.near(pair)
        counts = np.bincount(row, minlength=corner.shape[1])
        start = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
        points = np.einsum("sk,fnkc->fnsc", SAMPLES, corner)
        samples = UnitBlock(points.reshape(len(points), -1, 3), self._units, self._device)
        index = np.arange(samples.vertex_count)
        lists = start, near.astype(np.int32)
        of_face = index // len(SAMPLES)
        found = furthest_from(samples, side.block, side.faces, index, of_face, lists, self.limit, self._device)
        return found.reshape(-1, len(SAMPLES)).max(axis=1)

    def clusters_at(self, level: CutLevel, limit: float) -> np.ndarray:
        """(m, 3) int32, three clusters at each place that is further away than a limit."""
        root, faces = level.ordered.root, self._mesh.faces
        face, _ = self._around.of(np.flatnonzero((self._far_vertex > limit) & self._here(level)))
        large = self._large[self._far_large > limit]
        own = level.ordered.faces[self._far_face[level.ordered.face_map] > limit]
        return np.concatenate([root[faces[face]], root[faces[large]], own])
