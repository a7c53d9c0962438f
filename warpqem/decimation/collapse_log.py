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

__all__ = ["CollapseRecord", "log_of", "new_log", "ordered_log", "read_log"]

# Share of the collapses so far whose errors say how far the mesh is from the input. Over 68 cells the root mean square
# of the last sixteenth is 0.2 to 1.6, mostly 0.7 to 1.3, of what the quadrics of all clusters have in the end.
RECENT = 1.0 / 16.0
# Collapses whose recent errors are found at once: their numbers stay in the cache.
AT_ONCE = 8192


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
        index = np.flatnonzero(kept)
        return CollapseRecord(**{field.name: getattr(self, field.name).take(index, axis=0) for field in fields(self)})

    def made(self) -> CollapseRecord:
        """The same with all of its values."""
        return self

    def chosen_later(self, kept: np.ndarray) -> CollapseRecord:
        """The same, of which each of the values is taken when it is first asked for."""
        return _Chosen(self, kept)

    def roots(self, vertex_count: int) -> np.ndarray:
        """(V,) int32, the vertex that each vertex has collapsed into after all collapses."""
        root = np.arange(vertex_count, dtype=np.int32)
        # From the last round to the first: what a vertex went into has its own root by then, as collapses of one round
        # are independent.
        ends = [0, *(np.flatnonzero(np.diff(self.round_index)) + 1).tolist(), len(self)]
        for first, last in reversed(list(itertools.pairwise(ends))):
            root[self.removed[first:last]] = root.take(self.kept[first:last])
        return root


class _Chosen(CollapseRecord):
    """Some collapses of a record, (C,) bool: most levels of a search are asked for none of their values."""

    def __init__(self, whole: CollapseRecord, kept: np.ndarray) -> None:
        self.__dict__.update(_whole=whole, _index=kept)

    def made(self) -> CollapseRecord:
        """The same with all of its values."""
        return CollapseRecord(**{name: getattr(self, name) for name in _FIELDS})

    def __getattr__(self, name: str) -> np.ndarray:
        if name not in _FIELDS:
            raise AttributeError(name)
        values = self.__dict__
        if values["_index"].dtype == bool:
            values["_index"] = np.flatnonzero(values["_index"])
        found: np.ndarray = getattr(values["_whole"], name).take(values["_index"], axis=0)
        values[name] = found
        return found


_FIELDS = tuple(field.name for field in fields(CollapseRecord))

# The arrays of a log in rows of four bytes each, so that one copy brings all of it to the host.
_INTEGERS = ("kept", "removed", "left_opposite", "right_opposite", "faces_removed", "round_index")
_NUMBERS = ("cost", "error")
ROWS = int(kernels.ROWS)


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
        setattr(log, name, new_arrays.shaped(rows, (capacity,), wp.float32, first=index * capacity))
    return log, rows


def read_log(rows: wp.array, count: int, vertex: wp.array | None = None) -> CollapseRecord:
    """Fetch ``count`` collapses; those of a round, which threads log in any order, are put in order of their cost.

    ``vertex`` (V,) int32 on the device says which vertices of the input theirs are; None for the same.
    """
    device = rows.device
    if not count:
        return log_of(np.empty(0, dtype=np.int32), 0)
    ordered = new_arrays.empty(ROWS * count, dtype=wp.int32, device=device)
    slot = _order_on_host(rows, count) if device_traits(str(device)).in_order else _order_by_sorts(rows, count)
    there = new_arrays.uploaded([count], dtype=wp.int32, device=device)
    launch(kernels.gather_log, count, [rows, slot, there, _numbers(vertex, device)], [ordered], device=device)
    return log_of(ordered.numpy(), count)


def ordered_log(rows: wp.array, count: wp.array, room: int, vertex: wp.array | None = None) -> wp.array:
    """The same on the device, with room for so many: (7 room,) int32, for :func:`log_of`; ``count`` is (1,) int32."""
    device = rows.device
    ordered = new_arrays.zeros(ROWS * room, dtype=wp.int32, device=device)
    if room:
        slot = _slots_by_sorts(rows, count, rows.shape[1])[:room]
        launch(kernels.gather_log, room, [rows, slot, count, _numbers(vertex, device)], [ordered], device=device)
    return ordered


def _numbers(vertex: wp.array | None, device: wp.Device) -> wp.array:
    """The vertices of the input; none where they are the same."""
    return new_arrays.empty(0, dtype=wp.int32, device=device) if vertex is None else vertex


def log_of(ordered: np.ndarray, count: int) -> CollapseRecord:
    """The log of ``count`` collapses in (7 room,) int32, as :func:`ordered_log` has them."""
    values = ordered.reshape(ROWS, -1)
    kept, removed, faces_and_round, cost, error = (values[row, :count] for row in (0, 1, 4, 5, 6))
    bits = int(kernels.FACE_BITS)
    return CollapseRecord(
        kept=kept,
        removed=removed,
        opposites=values[2:4].reshape(-1, 2)[:count],
        faces_removed=faces_and_round & ((1 << bits) - 1),
        cost=cost.view(np.float32),
        error=error.view(np.float32),
        round_index=faces_and_round >> bits,
        recent_error=_recent_error(error.view(np.float32)),
    )


def _order_on_host(rows: wp.array, count: int) -> wp.array:
    """The order by round, cost and removed vertex, (C,) int32: a sort of plain numbers for each round."""
    values = rows.numpy()[:, :count]
    removed, cost = values[_INTEGERS.index("removed")], values[len(_INTEGERS)].view(np.float32)
    order = _sorted_rounds(values[_INTEGERS.index("round_index")], cost, removed, rows.shape[1])
    return new_arrays.uploaded(order, dtype=wp.int32, device=rows.device)


def _order_by_sorts(rows: wp.array, count: int) -> wp.array:
    """The same by two sorts on the device, the second of which keeps the order of what is equal."""
    there = new_arrays.uploaded([count], dtype=wp.int32, device=rows.device)
    return _slots_by_sorts(rows, there, count)


def _slots_by_sorts(rows: wp.array, count: wp.array, capacity: int) -> wp.array:
    """(capacity,) int32, the slots of ``count`` (1,) collapses in order, then others, all below a capacity."""
    device, removed, rounds = rows.device, rows[_INTEGERS.index("removed")], rows[_INTEGERS.index("round_index")]
    # A sort works between the two halves.
    keys, round_keys, slots = (
        new_arrays.empty(2 * capacity, dtype=dtype, device=device) for dtype in (wp.int64, wp.int32, wp.int32)
    )
    cost = rows[len(_INTEGERS)].view(wp.float32)
    launch(kernels.key_collapses, capacity, [cost, removed, count], [keys, slots], device=device)
    # The sign bit is never set.
    wp.utils.radix_sort_pairs(keys, slots, capacity, 0, 63)
    launch(kernels.key_rounds, capacity, [slots, rounds, count], [round_keys], device=device)
    wp.utils.radix_sort_pairs(round_keys, slots, capacity, 0, 31)
    return slots[:capacity]


def _recent_error(error: np.ndarray) -> np.ndarray:
    """(C,) float32, root mean square over the last ``RECENT`` of the collapses up to each, at least itself."""
    total = np.zeros(len(error) + 1)
    np.square(error, dtype=np.float64, out=total[1:])
    np.cumsum(total, out=total)
    recent = np.empty(len(error), dtype=np.float32)
    # Some at a time: new memory for all at once takes longer than the rest.
    for first in range(0, len(error), AT_ONCE):
        last = min(first + AT_ONCE, len(error))
        count = np.arange(first + 1, last + 1)
        taken = np.maximum((RECENT * count).astype(np.int64), 1)
        mean = total[first + 1 : last + 1] - total.take(count - taken)
        np.maximum(mean, 0.0, out=mean)
        mean /= taken
        recent[first:last] = np.sqrt(mean, out=mean)
    return recent


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
