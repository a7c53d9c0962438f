"""The largest distance between two surfaces in motion, frame by frame: at any point, not at samples only."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.measure.cells import Cells
from warpqem.measure.patches import Found, Patches, bound_frames, pack_points, search_patches, vertex_distances
from warpqem.runtime import new_arrays

__all__ = ["LargestDistance"]

# What is added to a bound in single precision: several times its rounding on a mesh of unit diagonal.
BOUND_MARGIN = 1e-6
# Patches that held the largest distances of late, whose corners are looked at before any search: mostly it is there in
# the next frames, too, and patches are not searched for what is known.
LEADING = 32
# Patches of a frame that are searched before all others, those with the highest bounds: where the largest distance
# wanders, samples miss it by a tenth, and a thousand patches would be searched for that tenth.
HIGHEST = 16
# Where no more than so many times as many are above what is known, all of them are.
MANY = 4
# The pieces of a search that finds this much more than was known are smaller than they need to be, and are cut again.
CUT_AGAIN = 1.2
# Patches are no longer replaced by their pieces when there are this many times as many as after the first cut.
MAX_GROWTH = 8

Doubles = npt.NDArray[np.float64]


class _Direction:
    """The patches of one mesh against the other, and what bounds them in the frames of a block."""

    def __init__(self, own: Cells, other: Cells, device: str) -> None:
        self.own, self.other, self._device = own, other, device
        # Rows beyond the count are room for more.
        self._patches, self._count = Patches.whole(own.first_face), own.face_count
        self._bound = np.empty((0, 0), dtype=np.float32)
        self._points: tuple[wp.array, wp.array] | None = None
        self.leading = self._patches.rows(slice(0))
        self._most = 0
        # The least that was known in a frame of the block before.
        self.enough = 0.0
        self.near_face = new_arrays.full(own.face_count, -1, dtype=wp.int32, device=device)

    def search_all(self, floor: Doubles, *, cut: bool) -> Found:
        """Search all patches in the first frame."""
        cell = np.zeros(self._count, dtype=np.int32) if self.own.mesh_count == 1 else self.own.mesh_of_face
        patches = self._patches.rows(slice(self._count))
        return search_patches(self.own, self.other, patches, cell, floor, self._device, cut=cut)

    def raise_to_all(self, found: Doubles, bound: Doubles) -> None:
        """Search all patches in the first frame, and note what each cell holds: what is found, and what bounds it."""
        result, cell = self.search_all(found, cut=False), self.own.mesh_of_face
        np.maximum.at(found, cell, result.low)
        np.maximum.at(bound, cell, result.high)

    def cut_first(self, floor: float) -> float:
        """Cut the faces so that each patch is near one face in the first cell; the largest distance, or the floor."""
        # The more is known, the larger the pieces, and what is furthest is mostly a vertex.
        distance, face = vertex_distances(self.own, self.other, self._device)
        floor = max(floor, float(distance.max()))
        self.leading = self._patches.rows(np.unique(face[np.argsort(-distance, kind="stable")[:LEADING]]))
        found = self.search_all(np.array([floor]), cut=True)
        low = float(found.low.max())
        if low > CUT_AGAIN * floor:
            self._patches = Patches(self._patches.face, self._patches.place, found.hint)
            found = self.search_all(np.array([low]), cut=True)
        self._patches, self._count = found.pieces, len(found.pieces)
        self._most = MAX_GROWTH * self._count
        return low

    def take_over(self, way: _Direction) -> None:
        """Begin with the patches that the search of another one has come to."""
        self._count = way._count
        self._patches = way._patches.rows(slice(self._count)).copy()
        self.leading = way.leading
        self._most = MAX_GROWTH * self._count

    def show(self, points: tuple[wp.array, wp.array]) -> None:
        """Go to a block of frames, packed."""
        self._points = points
        # The first patch of each face stays its first one.
        face, row = np.unique(self._patches.face[: self._count], return_index=True)
        near = np.full(self.own.face_count, -1, dtype=np.int32)
        near[face] = self._patches.hint[row, 0]
        self.near_face = new_arrays.uploaded(near, dtype=wp.int32, device=self._device)
        # (F, P): 0 where a patch was searched.
        self._bound = self._bounded(self._patches.rows(slice(self._count)))

    def _bounded(self, patches: Patches) -> npt.NDArray[np.float32]:
        assert self._points is not None
        found = bound_frames(self.own, self.other, patches, self._points, self.enough, self._device)
        found += np.float32(BOUND_MARGIN)
        return found

    def beyond(self, frames: slice, floor: Doubles, *, lowest: bool) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
        """Patches (n,) whose bound is above the floor (F,) of a frame, and that frame (n,), patch by patch.

        ``frames`` are those of the block that the cells show. With ``lowest``, of the frames of a patch only the one
        where the floor is lowest.
        """
        bound = self._bound[frames, : self._count]
        # Rounded up, a floor would be above what it is not.
        above = bound > np.nextafter(floor.astype(np.float32), np.float32(0))[:, None]
        patch = np.flatnonzero(above.any(axis=0))
        if lowest:
            return patch, np.where(above[:, patch], floor[:, None], np.inf).argmin(axis=0)
        index, frame = np.nonzero(above[:, patch].T)
        return patch[index], frame

    def highest(self, frames: slice, floor: Doubles) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
        """A few patches (n,) of each frame with the highest bounds, above its floor (F,), and that frame (n,).

        None where not many are above it.
        """
        bound = self._bound[frames, : self._count]
        above = bound > floor[:, None]
        if np.count_nonzero(above) <= MANY * HIGHEST * len(floor):
            return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
        # Those of neighbours are alike: one of each part of the surface.
        size = -(-self._count // HIGHEST)
        part = range(0, self._count, size)
        patch = np.stack([first + bound[:, first : first + size].argmax(axis=1) for first in part], axis=1)
        frame, index = np.nonzero(np.take_along_axis(above, patch, axis=1))
        return patch[frame, index], frame

    def search(
        self, patch: npt.NDArray[Any], frame: npt.NDArray[Any], first: int, floor: Doubles, *, cut: bool
    ) -> Found:
        """Search patches, each in one of the cells' frames, and with ``cut`` put their pieces in their place.

        ``first`` is the block's frame in the first cell, ``floor`` (n,) that of each cell.
        """
        grows = cut and self._count < self._most
        patches = self._patches.rows(patch)
        found = search_patches(self.own, self.other, patches, frame, floor, self._device, cut=grows)
        self._bound[first + frame, patch] = 0
        above = np.flatnonzero(found.low > floor[frame])
        if len(above):
            above = above[np.argsort(-found.low[above], kind="stable")][:LEADING]
            self.leading = patches.rows(above)
        if grows:
            bound = self._bounded(found.pieces)
            # Where a patch has been searched, its pieces have.
            bound[self._bound[:, patch[found.owner]] == 0] = 0
            self._replace(patch, found, bound)
        return found

    def _replace(self, patch: npt.NDArray[Any], found: Found, bound: npt.NDArray[np.float32]) -> None:
        """Put the first piece of each patch in its place, and the others behind all."""
        is_first = np.append(True, found.owner[1:] != found.owner[:-1])
        count = self._count + int((~is_first).sum())
        if count > len(self._patches):
            self._patches = self._patches.grown(2 * count)
        if count > self._bound.shape[1]:
            larger = np.empty((len(self._bound), 2 * count), dtype=np.float32)
            larger[:, : self._count] = self._bound[:, : self._count]
            self._bound = larger
        rows = patch[found.owner]
        rows[~is_first] = np.arange(self._count, count)
        self._patches.put(rows, found.pieces)
        self._bound[:, rows] = bound
        self._count = count


class LargestDistance:
    """Finds the largest distance in each frame, both ways.

    In a block of frames, all patches are bounded at once by the faces that they were near to before; those that may
    hold more than what is known are searched by branch and bound (:mod:`warpqem.kernels.largest_distance`), and give
    way to the pieces that they were cut into, which fit this frame and mostly the next ones.

    Args:
        reference: one mesh.
        test: the other one.
        frame_count: frames to come.
        device: Warp device.
        overall: whether only the largest of all frames is asked for: then a frame is searched for what is beyond that
            of the frames before.
        like: a search of the same frames that is always a step ahead, with whose patches this one begins; None for
            none.
    """

    def __init__(
        self,
        reference: Cells,
        test: Cells,
        frame_count: int,
        device: str,
        *,
        overall: bool = False,
        like: LargestDistance | None = None,
    ) -> None:
        self._ways = (_Direction(reference, test, device), _Direction(test, reference, device))
        self._frame_count, self._device, self._overall, self._like = frame_count, device, overall, like
        # The largest so far.
        self._largest = 0.0
        self._block: tuple[Doubles, Doubles] | None = None
        self._is_cut = False
        self._least = np.inf

    def begin_block(self, reference: Doubles, test: Doubles) -> None:
        """Take a block of frames, (F, U, 3) and (F, W, 3) of unit diagonal about the origin."""
        self._block = (reference, test)
        for way in self._ways:
            way.enough = self._largest if self._overall else 0.0 if np.isinf(self._least) else self._least
        self._least = np.inf
        if self._is_cut:
            self._show()

    def _show(self) -> None:
        assert self._block is not None
        one, two = (pack_points(points, self._device) for points in self._block)
        for way, points in zip(self._ways, ((one, two), (two, one)), strict=True):
            way.show(points)

    def find(self, frames: slice, sampled: Doubles) -> Doubles:
        """The largest distance in frames of the block that the cells show, (n,); some are known from samples (n,).

        Of several meshes in one frame it is that of each mesh.

        It is no smaller than that of any point, and at most a thousandth larger than that of one. Where only the
        largest of all frames is asked for, that of a frame is no smaller than in the frames before.
        """
        if self._frame_count == 1:
            found, bound = sampled.copy(), sampled.copy()
            for way in self._ways:
                way.raise_to_all(found, bound)
            return np.maximum(found, bound)
        if self._overall:
            sampled = np.full_like(sampled, max(self._largest, float(sampled.max())))
        found, bound = sampled.copy(), sampled.copy()
        if not self._is_cut:
            self._begin(found)
            self._is_cut = True
            self._show()
        if not self._overall:
            for way in self._ways:
                self._search_patches(way, *way.highest(frames, found), frames, found, bound, cut=False)
        for way in self._ways:
            self._search(way, frames, found, bound)
            if self._overall:
                found[:] = found.max()
        self._largest = max(self._largest, float(found.max()))
        self._least = min(self._least, float(found.min()))
        return np.maximum(found, bound)

    def _begin(self, found: Doubles) -> None:
        """Cut both meshes into patches in the first of some frames, and note what is found there."""
        for number, way in enumerate(self._ways):
            if self._like is not None:
                way.take_over(self._like._ways[number])
                continue
            found[0] = way.cut_first(float(found[0]))
            if self._overall:
                found[:] = found.max()

    def near_faces(self, side: int) -> wp.array:
        """(N,) int32, a face of the other mesh near to each face of one, 0 the reference, mostly; -1 for none."""
        return self._ways[side].near_face

    def leading_corners(self, side: int, frames: slice) -> tuple[npt.NDArray[Any], Doubles]:
        """Points of a mesh (0 the reference, 1 the test mesh) that may be among the furthest in frames of the block.

        Returns:
            Faces (n, C) and barycentric coordinates of their second and third corner (n, C, 2).
        """
        leading = self._ways[side].leading
        face = np.repeat(leading.face, 3)
        count = frames.stop - frames.start
        return np.tile(face, (count, 1)), np.tile(leading.place.reshape(-1, 2), (count, 1, 1))

    def _search(self, way: _Direction, frames: slice, found: Doubles, bound: Doubles) -> None:
        """Search patches that may hold more than what was found, and note what they hold.

        First each in one frame, which its pieces then fit, and mostly the others, too; then in all that are left.
        """
        for lowest in (True, False):
            patch, frame = way.beyond(frames, found, lowest=lowest)
            self._search_patches(way, patch, frame, frames, found, bound, cut=lowest)

    @staticmethod
    def _search_patches(
        way: _Direction,
        patch: npt.NDArray[Any],
        frame: npt.NDArray[Any],
        frames: slice,
        found: Doubles,
        bound: Doubles,
        *,
        cut: bool,
    ) -> None:
        """Search patches (n,) in a frame each, and note what they hold."""
        if len(patch):
            result = way.search(patch, frame, frames.start, found, cut=cut)
            np.maximum.at(found, frame, result.low)
            np.maximum.at(bound, frame, result.high)
