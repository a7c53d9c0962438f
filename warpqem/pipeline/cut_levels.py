"""Levels of a search within a distance: what decides each, its mesh, and where its vertices lie in some frames."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from warpqem.decimation.cluster_states import ClusterLevel
from warpqem.decimation.decimate import DecimatedMesh
from warpqem.decimation.forest_cut import Cut
from warpqem.frames.device_frames import take_vertices, to_device
from warpqem.measure.face_lists import FacesAround
from warpqem.measure.unit_frames import ChangingBlock, UnitBlock, UnitFrames
from warpqem.pipeline.prepare import Prepared
from warpqem.place.block_placer import pack_block
from warpqem.place.cluster_parts import ClusterParts, LevelParts
from warpqem.place.clusters import ClusterPlacer
from warpqem.runtime import new_arrays

__all__ = ["Choice", "CutLevel", "LevelFrames", "placer_of"]


@dataclass(frozen=True)
class Choice:
    """What decides a level.

    Attributes:
        cut: its collapses.
        loose: (V,) bool, input vertices whose clusters are placed by their quadrics, with the least weight of the
            anchor.
        held: (V,) bool, input vertices whose clusters a refit leaves as placed; None for none.
    """

    cut: Cut
    loose: np.ndarray
    held: np.ndarray | None = None


class CutLevel:
    """One level: what decides it, and the mesh. Its vertices have the numbers of the input vertices they go by.

    Attributes:
        choice: what decides it.
        ordered: its topology.
        kept: (C,) int32, the input vertices that its clusters go by, ascending.
        last: (V,) int, the last collapse of each cluster, see :func:`warpqem.decimation.forest_cut.last_collapses`.
        is_kept: (V,) bool, the same vertices.
        found: what is known of it, None for no more than that.
        root_index: (V,) ``ordered.root`` as NumPy takes indices, which else makes a copy each time.
    """

    def __init__(
        self,
        choice: Choice,
        ordered: DecimatedMesh,
        last: np.ndarray,
        found: ClusterLevel | None = None,
    ) -> None:
        self.choice, self.ordered, self.last, self.found = choice, ordered, last, found
        self._root_there = None if found is None else found.root_there
        if found is None:
            self.root_index = ordered.root.astype(np.intp)
            self.is_kept = np.zeros(len(ordered.root), dtype=bool)
            self.is_kept[ordered.faces] = True
        else:
            self.root_index, self.is_kept = found.root_index, found.is_kept
        self.kept = np.flatnonzero(self.is_kept).astype(np.int32)

    @property
    def root_there(self) -> wp.array:
        """(V,) int32, ``ordered.root`` on the device."""
        if self._root_there is None:
            device = self.ordered.position.device
            self._root_there = new_arrays.uploaded(self.ordered.root, dtype=wp.int32, device=device)
        return self._root_there

    def unmoved(self, before: CutLevel) -> np.ndarray:
        """(V,) bool, kept vertices whose clusters and placement are those of another level."""
        unmoved: np.ndarray = (self.last == before.last) & before.is_kept
        if self.choice.loose is not before.choice.loose:
            unmoved &= self.choice.loose == before.choice.loose
        return unmoved


class LevelFrames:
    """Frames of the input, and of the levels one after another; of each only what moved is placed.

    Args:
        work: the mesh.
        around: its faces.
        about: (n, V, 3) float32, its frames about its origin.
        own: the same in the caller's coordinates.
        units: what brings them to unit size.
        parts: finds what belongs to clusters of levels on the device; None for the host.

    Attributes:
        reference: the input at unit size.
        test: the level that was placed last.
        level_points: (n, V) points on the device, the same in the caller's coordinates.
    """

    def __init__(
        self,
        work: Prepared,
        around: FacesAround,
        about: np.ndarray,
        own: np.ndarray,
        units: UnitFrames,
        parts: LevelParts | None = None,
    ) -> None:
        self._parts = parts
        self._work, self._around, self._about = work, around, to_device(about, work.device)
        self._packed = pack_block(work.mesh, self._about, work.device)
        self.reference = UnitBlock(own, units, work.device)
        self.test = ChangingBlock(about.shape[:2], units, work.device)
        self.level_points = wp.empty(about.shape[:2], dtype=wp.vec3, device=work.device)

    def __len__(self) -> int:
        return len(self.level_points)

    def place(self, level: CutLevel, before: CutLevel | None) -> np.ndarray:
        """Place a level where it is not as the one before, None for none.

        Returns:
            (M,) int32, the vertices that it placed.
        """
        mesh = self._work.mesh
        moved = level.kept if before is None else level.kept[~level.unmoved(before)[level.kept]]
        if len(moved):
            placer = placer_of(self._work, self._around, level, moved, self._parts)
            self._put(moved, placer.place(mesh, self._about, self._packed).restored(mesh))
        return moved

    def put(self, level: CutLevel, points: np.ndarray | wp.array) -> None:
        """Put a level where it is, (n, C, 3) or (n, C) points on the device, in the caller's coordinates."""
        self._put(level.kept, to_device(points, self._work.device))

    def _put(self, vertex: np.ndarray, points: wp.array) -> None:
        index = new_arrays.uploaded(vertex, dtype=wp.int32, device=self._work.device)
        wp.copy(wp.indexedarray(self.level_points, [None, index]), points)
        self.test.put(index, points)

    def points(self, level: CutLevel) -> np.ndarray:
        """The level, (n, C, 3), in the caller's coordinates."""
        kept = new_arrays.uploaded(level.kept, dtype=wp.int32, device=self._work.device)
        points: np.ndarray = take_vertices(self.level_points, kept).numpy()
        return points


def placer_of(
    work: Prepared, around: FacesAround, level: CutLevel, kept: np.ndarray, parts: LevelParts | None = None
) -> ClusterPlacer:
    """What places the clusters of a level that go by some vertices (M,); ``parts`` finds what belongs to them."""
    ordered = level.ordered
    if parts is not None:
        found = parts.of(ordered.root, level.root_there, kept)
    else:
        found, ordered = _parts_of(work, around, level, kept)
    settings = replace(work.place_settings, loose=level.choice.loose)
    return ClusterPlacer(
        ordered, kept, found, work.quadric_scale, work.pinned, settings, work.device, work.quadric_sums
    )


def _parts_of(
    work: Prepared, around: FacesAround, level: CutLevel, kept: np.ndarray
) -> tuple[ClusterParts, DecimatedMesh]:
    """What belongs to the same clusters, found on the host, and the level with the faces that this takes."""
    ordered, faces = level.ordered, work.mesh.faces
    index = np.full(len(work.mesh.used), -1, dtype=np.int32)
    index[kept] = np.arange(len(kept), dtype=np.int32)
    cluster = index.take(level.root_index)
    if work.quadric_sums is None:
        # Only faces around count.
        near = around.at(cluster >= 0)
        faces = faces.take(near, axis=0)
        ordered = replace(ordered, constrained=ordered.constrained.reshape(-1, 3).take(near, axis=0).ravel())
    parts = ClusterParts.of(faces, ordered, cluster, len(kept), work.quadric_scale, work.device)
    return parts, ordered
