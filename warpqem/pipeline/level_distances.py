"""How far a level and the input are from each other in some frames, as faces around show: anew where the level changed.

Looked at are vertices of the input, points of those of its faces that are larger than the level's, points of the
level's faces, and its vertices.
"""

from __future__ import annotations

import numpy as np

from warpqem.measure.face_lists import FacesAround
from warpqem.measure.large_faces import LargeFaces, large_faces
from warpqem.measure.surface_places import (
    InputVertices,
    Places,
    SampledFaces,
    Side,
    SimplifiedVertices,
    furthest_of,
    furthest_with_large,
    input_side,
)
from warpqem.mesh.grouping import any_corner
from warpqem.pipeline.cut_levels import CutLevel, LevelFrames
from warpqem.pipeline.prepare import Prepared
from warpqem.runtime.device import device_traits

__all__ = ["LevelDistances"]

# No distances matter below this part of the largest one at vertices of the input in the first level: hardly a mesh
# comes so far.
MIN_SHARE = 0.5


class LevelDistances:
    """The distances between the input and the levels of a search.

    Args:
        work: the mesh, with no other frames than those to look at.
        frames: its frames and those of the levels.
        around: its faces.
        limit: distances within it, in diagonals, are looked at no closer.

    Attributes:
        limit: the same, or a part of the largest distance of the first level.
    """

    def __init__(self, work: Prepared, frames: LevelFrames, around: FacesAround, limit: float) -> None:
        self._mesh, self._device = work.mesh, work.device
        self._frames, self.limit = frames, limit
        vertex_count, face_count = work.mesh.vertex_count, len(work.mesh.faces)
        self._around = around
        # How far each input vertex is, each large input face, each face of a level, by the input face that it goes on
        # from, and each of its vertices.
        self._far_vertex = np.zeros(vertex_count, dtype=np.float32)
        self._large = np.empty(0, dtype=np.int64)
        self._far_large = np.empty(0, dtype=np.float32)
        self._far_face = np.zeros(face_count, dtype=np.float32)
        self._far_kept = np.zeros(vertex_count, dtype=np.float32)
        # Of these the level's own faces, and its vertices.
        self._far_own = self._far_corner = np.empty(0, dtype=np.float32)

    def renew(self, level: CutLevel, moved: np.ndarray | None) -> float:
        """The largest distance of a level, of which some vertices moved since the last one; None for all.

        At least the limit.
        """
        ordered = level.ordered
        input_lanes, level_lanes = self._frames.reference.lanes, self._frames.test.lanes
        # Where the host would wait for which input faces are large, it asks for that along with how far they are.
        is_listed = moved is None and device_traits(self._device).own_memory
        if moved is None and not is_listed:
            self._choose_large(level)
        changed = self._changed(level, moved)
        faces, face = ordered.faces.take(changed, axis=0), ordered.face_map.take(changed)
        near = np.zeros(len(ordered.root), dtype=bool)
        near[faces.ravel()] = True
        is_near, here = near.take(level.root_index), self._here(level)
        around = FacesAround(ordered.faces, len(ordered.root))
        side = Side(level_lanes, around, around)
        vertex = np.flatnonzero(is_near & here)
        vertices = InputVertices(input_lanes, side, vertex, ordered.root[vertex])
        there = self._input_side(level, near)
        own = SampledFaces(level_lanes, faces, faces, there, around)
        kept = SimplifiedVertices(level_lanes, there, np.flatnonzero(near), around)
        places = vertices, own, kept
        if is_listed:
            found = self._renew_listed(level, places, side, here)
        else:
            found = self._renew_known(level, places, side, here, is_near, moved is None)
        self._far_vertex[vertex], self._far_face[face], self._far_kept[kept.vertex] = found
        # What is not there now is looked at again when it is.
        self._far_vertex *= here
        self._far_own, self._far_corner = self._far_face.take(ordered.face_map), self._far_kept.take(level.kept)
        parts = self._far_vertex, self._far_large, self._far_own, self._far_corner
        return max(self.limit, *(float(part.max(initial=0.0)) for part in parts))

    def _renew_known(
        self,
        level: CutLevel,
        places: tuple[InputVertices, SampledFaces, SimplifiedVertices],
        side: Side,
        here: np.ndarray,
        is_near: np.ndarray,
        is_first: bool,
    ) -> list[np.ndarray]:
        """How far places are; those of large faces ``here`` (V,), known and next to ``is_near`` (V,), are put down."""
        corners = self._mesh.faces[self._large]
        is_large_here = here[corners].all(axis=1)
        self._far_large[~is_large_here] = 0.0
        row = np.flatnonzero(is_near[corners].any(axis=1) & is_large_here)
        corners = corners[row]
        large = SampledFaces(self._frames.reference.lanes, corners, level.ordered.root[corners], side, side.faces)
        if is_first:
            # How far vertices of the first level are decides how closely the rest is looked at.
            found = self._distances(places[0])
            self._raise_limit(found[0])
            found += self._distances(large, *places[1:])
        else:
            found = self._distances(places[0], large, *places[1:])
        self._far_large[row] = found.pop(1)
        return found

    def _renew_listed(
        self,
        level: CutLevel,
        places: tuple[InputVertices, SampledFaces, SimplifiedVertices],
        side: Side,
        here: np.ndarray,
    ) -> list[np.ndarray]:
        """The same of the first level, with large faces that the device lists: all is looked at equally closely.

        That finds the same.
        """
        lanes, root = self._frames.reference.lanes, level.ordered.root
        test, there = self._frames.test.lanes, level.root_there
        listed = LargeFaces(lanes, self._around, test, level.ordered.faces, there, self._device)
        of_listed = SampledFaces(lanes, listed.corners, listed.clusters, side, side.faces)
        (*found, far), rows = furthest_with_large(places, of_listed, listed, self.limit, self._device)
        self._large = rows[1 : 1 + rows[0]].astype(np.int64)
        if rows[0] > listed.room:
            self._choose_large(level)
            corners = self._mesh.faces[self._large]
            (far,) = self._distances(SampledFaces(lanes, corners, root[corners], side, side.faces))
        self._far_large = np.where(here[self._mesh.faces[self._large]].all(axis=1), far[: len(self._large)], 0.0)
        self._raise_limit(found[0])
        return found

    def _raise_limit(self, far: np.ndarray) -> None:
        """Take no closer a look than a part of the largest distance of vertices of the input."""
        self.limit = max(self.limit, MIN_SHARE * float(far.max(initial=0.0)))

    def _choose_large(self, level: CutLevel) -> None:
        """The input faces that are larger than those of the first level."""
        reference, test = self._frames.reference.lanes, self._frames.test.lanes
        self._large = large_faces(reference, self._around, test, level.ordered.faces, self._device)
        self._far_large = np.zeros(len(self._large), dtype=np.float32)

    def _changed(self, level: CutLevel, moved: np.ndarray | None) -> np.ndarray:
        """The faces of a level that are not what they were."""
        ordered = level.ordered
        if moved is None:
            return np.arange(len(ordered.faces))
        # A face with other corners has one at a cluster with other vertices, which moved.
        is_moved = np.zeros(len(ordered.root), dtype=bool)
        is_moved[moved] = True
        return np.flatnonzero(any_corner(is_moved.take(ordered.faces)))

    def _here(self, level: CutLevel) -> np.ndarray:
        """(V,) bool, input vertices that a level has something of."""
        here: np.ndarray = level.is_kept.take(level.root_index) & self._mesh.used
        return here

    def _distances(self, *places: Places) -> list[np.ndarray]:
        """How far each is, no closer than the limit."""
        return furthest_of(places, [np.full(one.count, self.limit) for one in places], self._device)

    def _input_side(self, level: CutLevel, wanted: np.ndarray) -> Side:
        """The input, by the faces at the members of clusters that are wanted (V,) or next to these."""
        ordered, lanes, count = level.ordered, self._frames.reference.lanes, len(level.ordered.root)
        if device_traits(self._device).own_memory:
            return input_side(lanes, self._around, level.root_there, count)
        next_to = wanted.copy()
        next_to[ordered.faces[any_corner(wanted[ordered.faces])]] = True
        return input_side(lanes, self._around, ordered.root, count, self._around.at(next_to[ordered.root]))

    def clusters_at(self, level: CutLevel, limit: float) -> np.ndarray:
        """(m, 3) int32, three clusters at each place of the level looked at last that is further away than a limit."""
        root, faces = level.ordered.root, self._mesh.faces
        face, _ = self._around.of(np.flatnonzero(self._far_vertex > limit))
        large = self._large[self._far_large > limit]
        own = level.ordered.faces.take(np.flatnonzero(self._far_own > limit), axis=0)
        kept = level.kept[self._far_corner > limit]
        return np.concatenate([root[faces[face]], root[faces[large]], own, np.repeat(kept[:, None], 3, axis=1)])
