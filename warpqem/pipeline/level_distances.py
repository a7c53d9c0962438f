"""How far a level and the input are from each other in some frames, as faces around show: anew where the level changed.

Looked at are vertices of the input, points of those of its faces that are larger than the level's, points of the
level's faces, and its vertices.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from warpqem.measure.far_points import FacesAround, PointsAndFaces, furthest_from, longest_edges, unique_pairs
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
        lists: where each cluster starts, (V+1,) int32, and its faces, int32.
    """

    block: UnitBlock
    faces: FacesAround
    lists: tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class _Vertices:
    """Input vertices (n,), each with the vertex of the level that it went to, and the faces around that."""

    reference: UnitBlock
    side: _Side
    vertex: np.ndarray
    root: np.ndarray
    points_of_each: ClassVar[int] = 1

    @property
    def count(self) -> int:
        """Vertices n."""
        return len(self.vertex)

    def around(self, chosen: np.ndarray | None) -> Iterator[PointsAndFaces]:
        """The points and the faces around; with one ring more for those that are ``chosen``, indices (m,)."""
        point, cluster, lists = self.vertex, self.root, self.side.lists
        if chosen is not None:
            lists = self.side.faces.second_ring(cluster[chosen])
            point, cluster = point[chosen], np.arange(len(chosen))
        yield PointsAndFaces.at(self.reference, self.side.block, self.side.faces, point, cluster, lists)


@dataclass(frozen=True)
class _Faces:
    """Faces (m, 3) of ``points`` (n, V, 3), with the clusters (m, 3) at which a side has what may be nearest.

    ``level_around`` has the faces of the level at each of its clusters; ``units`` bring points to unit size.
    """

    points: np.ndarray
    faces: np.ndarray
    clusters: np.ndarray
    side: _Side
    level_around: FacesAround
    units: UnitFrames
    device: str
    points_of_each: ClassVar[int] = len(SAMPLES)

    @property
    def count(self) -> int:
        """Faces m."""
        return len(self.faces)

    def around(self, chosen: np.ndarray | None) -> Iterator[PointsAndFaces]:
        """The points and the faces around; with one ring more for those that are ``chosen``, indices (m,)."""
        level_faces = self.level_around.corner_vertex.reshape(-1, 3)
        rows = np.arange(self.count) if chosen is None else chosen
        for first in range(0, len(rows), FACES_AT_ONCE):
            part = rows[first : first + FACES_AT_ONCE]
            cluster = self.clusters[part].ravel()
            start = np.arange(0, len(cluster) + 1, 3)
            if chosen is not None:
                # The nearest face may be at a cluster next to these.
                face, place = self.level_around.of(cluster)
                row, cluster = unique_pairs(np.repeat(place // 3, 3), level_faces[face].ravel())
                start = np.searchsorted(row, np.arange(len(part) + 1))
            yield self._samples(self.points[:, self.faces[part]], (start, cluster))

    def _samples(self, corner: np.ndarray, clusters: tuple[np.ndarray, np.ndarray]) -> PointsAndFaces:
        """Points of faces, by their corners (n, m, 3, 3), and the faces at clusters of each: lists."""
        points = np.einsum("sk,fnkc->fnsc", SAMPLES, corner)
        samples = UnitBlock(points.reshape(len(points), -1, 3), self.units, self.device)
        index = np.arange(samples.vertex_count)
        own = index // len(SAMPLES)
        return PointsAndFaces(samples, self.side.block, self.side.faces, index, own, clusters, self.side.lists)


@dataclass(frozen=True)
class _LevelVertices:
    """Vertices (n,) of the level, with the faces of the input at their clusters: one that sticks out of the input is
    further away than any point inside its faces.
    """

    frames: UnitBlock
    side: _Side
    vertex: np.ndarray
    level_around: FacesAround
    points_of_each: ClassVar[int] = 1

    @property
    def count(self) -> int:
        """Vertices n."""
        return len(self.vertex)

    def around(self, chosen: np.ndarray | None) -> Iterator[PointsAndFaces]:
        """The points and the faces around; with one ring more for those that are ``chosen``, indices (m,)."""
        side = self.side
        if chosen is None:
            yield PointsAndFaces.at(self.frames, side.block, side.faces, self.vertex, self.vertex, side.lists)
            return
        point, every = self.vertex[chosen], np.arange(len(chosen) + 1)
        face, place = self.level_around.of(point)
        row, cluster = unique_pairs(np.repeat(place, 3), self.level_around.corner_vertex.reshape(-1, 3)[face].ravel())
        clusters = np.searchsorted(row, every), cluster
        yield PointsAndFaces(self.frames, side.block, side.faces, point, every[:-1], clusters, side.lists)


_Looked = _Vertices | _Faces | _LevelVertices


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
        # How far each input vertex is, each large input face, each face of a level, by the input face that it goes on
        # from, and each of its vertices.
        self._far_vertex = np.zeros(vertex_count, dtype=np.float32)
        self._large = np.empty(0, dtype=np.int64)
        self._far_large = np.empty(0, dtype=np.float32)
        self._far_face = np.zeros(face_count, dtype=np.float32)
        self._far_kept = np.zeros(vertex_count, dtype=np.float32)
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
        side = _Side(self._frames.test, around, (around.start, around.face))
        vertex = np.flatnonzero(is_near & here)
        vertices = _Vertices(self._frames.reference, side, vertex, ordered.root[vertex])
        corners = self._mesh.faces[self._large]
        is_large_here = here[corners].all(axis=1)
        self._far_large[~is_large_here] = 0.0
        row = np.flatnonzero(is_near[corners].any(axis=1) & is_large_here)
        clusters = ordered.root[corners[row]]
        large = _Faces(self._points, corners[row], clusters, side, around, self._units, self._device)
        held = self._held_side(level, near)
        faces, face = ordered.faces[changed], ordered.face_map[changed]
        own = _Faces(self._frames.level_points, faces, faces, held, around, self._units, self._device)
        kept = _LevelVertices(self._frames.test, held, np.unique(faces), around)
        if moved is None:
            # How far vertices are decides how closely the rest is looked at.
            (self._far_vertex[vertex],) = self._distances(vertices)
            self.limit = max(self.limit, MIN_SHARE * float(self._far_vertex.max(initial=0.0)))
            found = self._distances(large, own, kept)
        else:
            self._far_vertex[vertex], *found = self._distances(vertices, large, own, kept)
        self._far_large[row], self._far_face[face], self._far_kept[kept.vertex] = found
        parts = self._far_vertex[here], self._far_large, self._far_face[ordered.face_map], self._far_kept[level.kept]
        return max(self.limit, *(float(part.max(initial=0.0)) for part in parts))

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

    def _distances(self, *looked: _Looked) -> list[np.ndarray]:
        """How far each is; the device is waited for twice, whatever is looked at."""
        found = self._found(looked, [None] * len(looked))
        far = [np.flatnonzero(distance > self.limit) for distance in found]
        for distance, index, again in zip(found, far, self._found(looked, far), strict=True):
            distance[index] = again
        return found

    def _found(self, looked: Sequence[_Looked], chosen: Sequence[np.ndarray | None]) -> list[np.ndarray]:
        """The distances of those that are chosen, None for all, from the faces around them."""
        counts = [one.count if index is None else len(index) for one, index in zip(looked, chosen, strict=True)]
        points = [count * one.points_of_each for one, count in zip(looked, counts, strict=True)]
        given = (
            around
            for one, index, count in zip(looked, chosen, counts, strict=True)
            if count
            for around in one.around(index)
        )
        found = np.split(furthest_from(given, sum(points), self.limit, self._device), np.cumsum(points)[:-1])
        return [part.reshape(-1, one.points_of_each).max(axis=1) for part, one in zip(found, looked, strict=True)]

    def _held_side(self, level: CutLevel, wanted: np.ndarray) -> _Side:
        """The input, by the faces at the members of clusters that are wanted (V,) or next to these."""
        ordered = level.ordered
        next_to = wanted.copy()
        next_to[ordered.faces[wanted[ordered.faces].any(axis=1)]] = True
        corners = ordered.root[self._mesh.faces]
        face = np.flatnonzero(next_to[corners].any(axis=1))
        at_clusters = FacesAround(corners[face], len(ordered.root))
        lists = at_clusters.start, face[at_clusters.face].astype(np.int32)
        return _Side(self._frames.reference, self._around, lists)

    def clusters_at(self, level: CutLevel, limit: float) -> np.ndarray:
        """(m, 3) int32, three clusters at each place that is further away than a limit."""
        root, faces = level.ordered.root, self._mesh.faces
        face, _ = self._around.of(np.flatnonzero((self._far_vertex > limit) & self._here(level)))
        large = self._large[self._far_large > limit]
        own = level.ordered.faces[self._far_face[level.ordered.face_map] > limit]
        kept = level.kept[self._far_kept[level.kept] > limit]
        return np.concatenate([root[faces[face]], root[faces[large]], own, np.repeat(kept[:, None], 3, axis=1)])
