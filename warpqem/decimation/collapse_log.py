"""The collapse log on the host."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, fields

import numpy as np
import warp as wp

from warpqem.arguments.array_record import ArrayRecord
from warpqem.kernels import collapse_order as kernels
from warpqem.kernels.mesh_state import CollapseLog
from warpqem.runtime import new_arrays
from warpqem.runtime.device import device_traits
from warpqem.runtime.launches import launch

__all__ = ["CollapseRecord", "new_log", "read_log"]

# Share of the collapses so far whose errors say how far the mesh is from the input. Over 68 cells the root mean square
# of the last sixteenth is 0.2 to 1.6, mostly 0.7 to 1.3, of what the quadrics of all clusters have in the end.
RECENT = 1.0 / 16.0


@dataclass(frozen=True, eq=False, repr=False)
class CollapseRecord(ArrayRecord):
    """Edge collapses in the order of application (C of them): by round, then by cost.

    Collapses of one round are independent, so the mesh after any prefix is valid. A higher face count gives a prefix of
    the log of a lower one, with the same settings, where no collapses are exchanged: with quality "fast".

    Attributes:
        kept: (C,) int32 input vertex that goes on, at a new position.
        removed: (C,) int32 input vertex that ends.
        opposites: (C, 2) int32, the vertices opposite the edge, as the order found them: where collapses around it were
            exchanged, others may be there. The second is -1 at a border.
        faces_removed: (C,) int32, 1 at a border, else 2.
        cost: (C,) float32, sum over key frames of area x squared distance on a mesh of unit diagonal, weighted.
        error: (C,) float32, RMS distance over key frames, in diagonals, of the vertex from its cluster's planes.
        round_index: (C,) int32, the round of reservations, from 1.
        recent_error: (C,) float32, root mean square of ``error`` over the last collapses up to each: what the mesh as a
            whole had come to there, see :data:`RECENT`.
    """

    kept: np.ndarray
    removed: np.ndarray
    opposites: np.ndarray
    faces_removed: np.ndarray
    cost: np.ndarray
    error: np.ndarray
    round_index: np.ndarray
    recent_error: np.ndarray

    def __len__(self) -> int:
        return len(self.kept)

    def head(self, count: int) -> CollapseRecord:
        """The first ``count`` collapses."""
        return CollapseRecord(**{field.name: getattr(self, field.name)[:count] for field in fields(self)})

    def chosen(self, kept: np.ndarray) -> CollapseRecord:
        """Some of the collapses, (C,) bool."""
        return CollapseRecord(**{field.name: getattr(self, field.name)[kept] for field in fields(self)})

    def roots(self, vertex_count: int) -> np.ndarray:
        """(V,) int32, the vertex that each vertex has collapsed into after all collapses."""
        root = np.arange(vertex_count, dtype=np.int32)
        # From the last round to the first: what a vertex went into has its own root by then, as collapses of one round
        # are independent.
        ends = [0, *(np.flatnonzero(np.diff(self.round_index)) + 1).tolist(), len(self)]
        for first, last in reversed(list(itertools.pairwise(ends))):
            root[self.removed[first:last]] = root[self.kept[first:last]]
        return root


# The arrays of a log in rows of four bytes each, so that one copy brings all of it to the host.
_INTEGERS = ("kept", "removed", "left_opposite", "right_opposite", "faces_removed", "round_index")
_NUMBERS = ("cost", "error")


def new_log(capacity: int, device: str) -> tuple[CollapseLog, wp.array]:
    """An empty log on the device, and the rows (8, capacity) int32 that its arrays are."""
    log, rows = (
        CollapseLog(),
        new_arrays.empty((len(_INTEGERS) + len(_NUMBERS), capacity), dtype=wp.int32, device=device),
    )
    log.count, log.round_count = (new_arrays.zeros(1, dtype=wp.int32, device=device) for _ in range(2))
    for index, name in enumerate(_INTEGERS):
        setattr(log, name, new_arrays.row(rows, index))
    for index, name in enumerate(_NUMBERS, len(_INTEGERS)):
        setattr(log, name, new_arrays.row(rows, index).view(wp.float32))
    return log, rows


def read_log(rows: wp.array, count: int) -> CollapseRecord:
    """Fetch ``count`` collapses; those of a round, which threads log in any order, are put in order of their cost."""
    device = rows.device
    if not count:
        values = np.empty((len(rows), 0), dtype=np.int32)
    else:
        slot = _order_on_host(rows, count) if device_traits(str(device)).in_order else _order_by_sorts(rows, count)
        ordered = new_arrays.empty(len(rows) * count, dtype=wp.int32, device=device)
        launch(kernels.gather_log, count, [rows, slot], [ordered], device=device)
        values = ordered.numpy().reshape(len(rows), count)
    by_name = dict(zip(_INTEGERS, values, strict=False))
    cost, error = (row.view(np.float32) for row in values[len(_INTEGERS) :])
    return CollapseRecord(
        kept=by_name["kept"],
        removed=by_name["removed"],
        opposites=values[2:4].reshape(-1, 2),
        faces_removed=by_name["faces_removed"],
        cost=cost,
        error=error,
        round_index=by_name["round_index"],
        recent_error=_recent_error(error),
    )


def _order_on_host(rows: wp.array, count: int) -> wp.array:
    """The order by round, cost and removed vertex, (C,) int32: a sort of plain numbers for each round."""
    values = rows.numpy()[:, :count]
    removed, cost = values[_INTEGERS.index("removed")], values[len(_INTEGERS)].view(np.float32)
    order = _sorted_rounds(values[_INTEGERS.index("round_index")], cost, removed, rows.shape[1])
    return new_arrays.uploaded(order, dtype=wp.int32, device=rows.device)


def _order_by_sorts(rows: wp.array, count: int) -> wp.array:
    """The same by two sorts on the device, the second of which keeps the order of what is equal."""
    device, removed, rounds = rows.device, rows[_INTEGERS.index("removed")], rows[_INTEGERS.index("round_index")]
    # A sort works between the two halves.
    keys, round_keys, slots = (
        new_arrays.empty(2 * count, dtype=dtype, device=device) for dtype in (wp.int64, wp.int32, wp.int32)
    )
    cost = rows[len(_INTEGERS)].view(wp.float32)
    launch(kernels.key_collapses, count, [cost, removed], [keys, slots], device=device)
    # The sign bit is never set.
    wp.utils.radix_sort_pairs(keys, slots, count, 0, 63)
    launch(kernels.key_rounds, count, [slots, rounds], [round_keys], device=device)
    wp.utils.radix_sort_pairs(round_keys, slots, count, 0, 31)
    return slots[:count]


def _recent_error(error: np.ndarray) -> np.ndarray:
    """(C,) float32, root mean square over the last ``RECENT`` of the collapses up to each, at least itself."""
    total = np.zeros(len(error) + 1)
    np.cumsum(np.square(error, dtype=np.float64), out=total[1:])
    count = np.arange(1, len(error) + 1)
    taken = np.maximum((RECENT * count).astype(np.int64), 1)
    difference = total[1:] - total[count - taken]
    mean: np.ndarray = np.sqrt(np.maximum(difference, 0.0, out=difference) / taken)
    return mean.astype(np.float32)


def _sorted_rounds(round_index: np.ndarray, cost: np.ndarray, removed: np.ndarray, vertex_count: int) -> np.ndarray:
    """The order by round, cost and removed vertex (C,); rounds come in order, and no vertex is removed twice.

    So each round is one sort of plain numbers: the bits of a positive cost, which ascend with it, then the vertex.
    """
    slot = np.empty(vertex_count, dtype=np.int64)
    slot[removed] = np.arange(len(removed))
    key = cost.view(np.uint32).astype(np.uint64) << np.uint64(32) | removed.astype(np.uint64)
    first = np.flatnonzero(np.diff(round_index)) + 1
    for part in np.split(key, first):
        part.sort()
    return slot[(key & np.uint64(0xFFFFFFFF)).astype(np.int64)]
