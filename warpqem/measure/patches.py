"""Parts of a moving surface, each with faces of the other surface that it stays near to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.frames.blocks import pack_frames
from warpqem.kernels import largest_distance as kernels
from warpqem.kernels import surface_distance
from warpqem.kernels.distance_screen import SCREEN_HINTS, ScreenPatches, bound_patches
from warpqem.kernels.near_faces import HINTS
from warpqem.measure.cells import Cells
from warpqem.runtime import new_arrays
from warpqem.runtime.cpu_threads import run_parts, split_range, thread_count
from warpqem.runtime.device import device_traits
from warpqem.runtime.launches import launch
from warpqem.runtime.part_launches import FIRST_ITEM, launch_in_parts

__all__ = ["Found", "Patches", "bound_frames", "pack_points", "search_patches", "vertex_distances"]

# Patches that are worth a thread.
MIN_PART = 512
# Pieces that there is room for at first, for each patch that is searched and each face of the other mesh.
PIECES_PER_FACE = 3
# Looks at pieces, for each face of both meshes, that patches may take that are given up at first. Some 4 find what a
# plane of 2 faces is from one of 100000.
LOOKS_PER_FACE = 16

Doubles = npt.NDArray[np.float64]
Singles = npt.NDArray[np.float32]
Ints = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Patches:
    """Parts of the faces of a mesh that together are the whole of it, in all frames.

    Attributes:
        face: (P,) int32, counted from the first one of the mesh.
        place: (P, 6) float64, barycentric coordinates of corners 1 and 2 of the face, at three corners.
        hint: (P, HINTS) int32, faces of the other mesh that were near before, the last one first, -1 for none.
    """

    face: npt.NDArray[np.int32]
    place: Doubles
    hint: npt.NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.face)

    @classmethod
    def whole(cls, first_face: Ints) -> Patches:
        """The faces themselves, of which nothing is known, of meshes that begin at some (M+1,)."""
        face_count = int(first_face[-1])
        face = np.arange(face_count, dtype=np.int32)
        if len(first_face) > 2:
            face -= np.repeat(first_face[:-1], np.diff(first_face)).astype(np.int32)
        place = np.tile([0.0, 0.0, 1.0, 0.0, 0.0, 1.0], (face_count, 1))
        hint = np.full((face_count, int(HINTS)), -1, dtype=np.int32)
        return cls(face, place, hint)

    @classmethod
    def joined(cls, parts: Sequence[Patches]) -> Patches:
        """One after another."""
        return cls(*(np.concatenate(values) for values in zip(*(vars(part).values() for part in parts), strict=True)))

    def rows(self, chosen: npt.NDArray[np.integer] | npt.NDArray[np.bool_] | slice) -> Patches:
        """Some of them."""
        return Patches(self.face[chosen], self.place[chosen], self.hint[chosen])

    def copy(self) -> Patches:
        """The same in arrays of their own."""
        return Patches(*(values.copy() for values in vars(self).values()))

    def grown(self, capacity: int) -> Patches:
        """The same at the beginning of larger arrays."""
        larger = Patches(*(np.empty((capacity, *values.shape[1:]), values.dtype) for values in vars(self).values()))
        larger.put(slice(len(self)), self)
        return larger

    def put(self, rows: npt.NDArray[np.integer] | slice, patches: Patches) -> None:
        """Put others in the place of some."""
        for mine, given in zip(vars(self).values(), vars(patches).values(), strict=True):
            mine[rows] = given


@dataclass(frozen=True)
class Found:
    """What a search of n patches gives, see :func:`warpqem.kernels.largest_distance.largest_distances`.

    Attributes:
        low: (n,) distance of a point, or the floor.
        high: (n,) what no distance is above, where that is above ``low``; else 0.
        hint: (n, HINTS) int32, faces that were near last.
        pieces: what the patches were cut into, where pieces were asked for.
        owner: (M,) which of the patches each piece is of, ascending.
    """

    low: Doubles
    high: Doubles
    hint: npt.NDArray[np.int32]
    pieces: Patches
    owner: Ints


def pack_points(points: Doubles, device: str) -> wp.array:
    """Frames (F, U, 3) of a mesh of unit diagonal as :func:`bound_frames` takes them."""
    width = device_traits(device).block_width
    return pack_frames(np.ascontiguousarray(points, dtype=np.float32), device, width=width)


def bound_frames(
    own: Cells, other: Cells, patches: Patches, points: tuple[wp.array, wp.array], enough: float, device: str
) -> Singles:
    """What the distances of patches of ``own`` from ``other`` are not above in any frame, but for rounding, (F, P).

    ``points`` are the frames of both, packed. Frames that fill up the last block are included. Below ``enough`` a bound
    is not made smaller.
    """
    width = device_traits(device).block_width
    screen = ScreenPatches()
    screen.face = new_arrays.uploaded(patches.face, dtype=wp.int32, device=device)
    screen.place = new_arrays.uploaded(patches.place, dtype=wp.float32, device=device)
    hint = np.ascontiguousarray(patches.hint[:, : int(SCREEN_HINTS)])
    screen.hint = new_arrays.uploaded(hint, dtype=wp.int32, device=device)
    block_count = points[0].shape[1]
    bound = new_arrays.empty((len(patches), block_count * width), dtype=wp.float32, device=device)
    launch_in_parts(
        bound_patches[width],
        (len(patches), block_count),
        inputs=[*points, own.corner_vertex, other.corner_vertex, screen, float(enough), FIRST_ITEM],
        outputs=[bound],
        device=device,
        min_items=MIN_PART,
    )
    # Frame by frame, as they are asked for.
    found: Singles = np.ascontiguousarray(bound.numpy().T)
    return found


def vertex_distances(own: Cells, other: Cells, device: str) -> tuple[Doubles, Ints]:
    """Distances (U,) of the vertices of ``own`` from ``other`` in the first cell, and a face (U,) of each."""
    _, corner = np.unique(own.faces, return_index=True)
    # Barycentric coordinates of the second and third corner.
    place = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])[corner % 3]
    distance, angle = (new_arrays.empty(len(corner), dtype=wp.float64, device=device) for _ in range(2))
    face = new_arrays.uploaded(corner // 3, dtype=wp.int32, device=device)
    inputs = [own.surface, other.surface, own.table, other.table]
    inputs += [face, new_arrays.uploaded(place, dtype=wp.vec2d, device=device), 0, len(corner)]
    inputs.append(new_arrays.empty(0, dtype=wp.int32, device=device))
    near = new_arrays.empty(len(corner), dtype=wp.int32, device=device)
    launch_in_parts(
        surface_distance.sample_distances,
        len(corner),
        inputs=[*inputs, FIRST_ITEM],
        outputs=[distance, angle, near],
        device=device,
        min_items=MIN_PART,
    )
    return distance.numpy(), corner // 3


def search_patches(
    own: Cells,
    other: Cells,
    patches: Patches,
    cell: npt.NDArray[np.integer],
    floor: Doubles,
    device: str,
    *,
    cut: bool,
) -> Found:
    """Search patches of ``own``, each in one of the cells (n,), for what is beyond a floor (C,) in that cell.

    With ``cut``, the pieces are kept that the patches had to be cut into. Those of one mesh come one after another, and
    are searched as they are alone.
    """
    found = _search_once(own, other, patches, cell, floor, device, cut=cut)
    known = floor.copy()
    np.maximum.at(known, cell, found.low)
    items = np.flatnonzero(_is_given_up(found, known[cell]))
    if not len(items):
        return found
    # Large faces over thousands of small ones: what bounds them is their own size, which says nothing. Their pieces
    # are patches of their own.
    low, high, hint = found.low.copy(), found.high.copy(), found.hint
    high[items] = 0.0
    is_whole = np.ones(len(patches), dtype=bool)
    is_whole[items] = False
    whole = is_whole[found.owner]
    done = [(found.pieces.rows(whole), found.owner[whole])]
    several = own.mesh_count > 1
    for mesh in np.unique(cell[items]).tolist() if several else [0]:
        item = items[cell[items] == mesh] if several else items
        size = sum(one.faces_of(mesh).stop - one.faces_of(mesh).start for one in (own, other))
        looks_left, rest = LOOKS_PER_FACE * size, patches.rows(item)
        while len(rest):
            found = _search_once(own, other, rest, cell[item], known, device, cut=True)
            np.maximum.at(low, item, found.low)
            np.maximum.at(known, cell[item], found.low)
            given_up = _is_given_up(found, known[cell[item]])
            looks_left -= int(kernels.MAX_PIECES) * int(given_up.sum())
            if looks_left < 0:
                given_up[:] = False
            np.maximum.at(high, item[~given_up], found.high[~given_up])
            again = given_up[found.owner]
            done.append((found.pieces.rows(~again), item[found.owner[~again]]))
            rest, item = found.pieces.rows(again), item[found.owner[again]]
    if not cut:
        return Found(low, high, hint, patches.rows(slice(0)), np.zeros(0, dtype=np.int64))
    owner = np.concatenate([one for _, one in done])
    order = np.argsort(owner, kind="stable")
    return Found(low, high, hint, Patches.joined([pieces for pieces, _ in done]).rows(order), owner[order])


def _is_given_up(found: Found, known: Doubles) -> npt.NDArray[np.bool_]:
    """Which patches (n,) the search has given up, where ``known`` (n,) is the largest distance found in their cell."""
    is_given_up: npt.NDArray[np.bool_] = found.high > known * (1.0 + float(kernels.TOLERANCE)) + float(kernels.ROUNDING)
    return is_given_up


def _search_once(
    own: Cells,
    other: Cells,
    patches: Patches,
    cell: npt.NDArray[np.integer],
    floor: Doubles,
    device: str,
    *,
    cut: bool,
) -> Found:
    """Search each patch, but give those up that have to be cut into too many pieces."""
    runs = _runs(own, cell)
    parts = split_range(len(runs) - 1, min(thread_count(device), max(1, len(patches) // MIN_PART)))
    items = kernels.SearchItems()
    items.face = new_arrays.uploaded(patches.face, dtype=wp.int32, device=device)
    items.place = new_arrays.uploaded(patches.place, dtype=wp.float64, device=device)
    items.hint = new_arrays.uploaded(patches.hint, dtype=wp.int32, device=device)
    items.cell = new_arrays.uploaded(cell, dtype=wp.int32, device=device)
    items.run = new_arrays.uploaded(runs, dtype=wp.int32, device=device)
    inputs = [own.surface, other.surface, own.table, other.table]
    inputs += [new_arrays.uploaded(floor, dtype=wp.float64, device=device), items]
    low, high = (new_arrays.empty(len(patches), dtype=wp.float64, device=device) for _ in range(2))
    hint = new_arrays.empty(patches.hint.shape, dtype=wp.int32, device=device)
    room = max(1, PIECES_PER_FACE * (len(patches) + other.face_count)) if cut else 0
    while True:
        pieces = _piece_room(len(parts), room, device)

        def search(index: int, part: slice, pieces: kernels.FoundPieces = pieces) -> None:
            launch(
                kernels.largest_distances,
                dim=part.stop - part.start,
                inputs=[*inputs, index, part.start],
                outputs=[pieces, low, high, hint],
                device=device,
            )

        run_parts([partial(search, index, part) for index, part in enumerate(parts)])
        needed = int(pieces.count.numpy().max(initial=0))
        if not cut or needed <= room:
            break
        room = needed
    return Found(low.numpy(), high.numpy(), hint.numpy(), *_read_pieces(patches, pieces, room, cut))


def _runs(own: Cells, cell: npt.NDArray[np.integer]) -> Ints:
    """Where runs begin of patches in cells (n,), (R+1,): none goes on from one mesh to another."""
    place = np.arange(len(cell))
    if own.mesh_count > 1:
        place -= np.searchsorted(cell, cell)
    return np.append(np.flatnonzero(place % int(kernels.RUN) == 0), len(cell))


def _piece_room(part_count: int, room: int, device: str) -> kernels.FoundPieces:
    """Room for so many pieces of each part."""
    count = part_count * room
    pieces = kernels.FoundPieces()
    pieces.count = new_arrays.zeros(part_count, dtype=wp.int32, device=device)
    pieces.item = new_arrays.empty(count, dtype=wp.int32, device=device)
    pieces.place = new_arrays.empty((count, 6), dtype=wp.float64, device=device)
    pieces.hint = new_arrays.empty((count, int(HINTS)), dtype=wp.int32, device=device)
    return pieces


def _read_pieces(patches: Patches, pieces: kernels.FoundPieces, room: int, cut: bool) -> tuple[Patches, Ints]:
    if not cut:
        return patches.rows(slice(0)), np.zeros(0, dtype=np.int64)
    rows = np.concatenate([part * room + np.arange(count) for part, count in enumerate(pieces.count.numpy())])
    item = pieces.item.numpy()[rows]
    # A patch is cut by one thread, in order; threads come in any order.
    order = np.argsort(item, kind="stable")
    rows, item = rows[order], item[order].astype(np.int64)
    return Patches(patches.face[item], pieces.place.numpy()[rows], pieces.hint.numpy()[rows]), item
