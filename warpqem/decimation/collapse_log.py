"""The collapse log on the host."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, fields

import numpy as np
import warp as wp

from warpqem.arguments.array_record import ArrayRecord
from warpqem.kernels import collapse_order as kernels
from warpqem.kernels.mesh_state import CollapseLog
from warpqem.mesh.indexing import put_at
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

    def _round_ends(self) -> np.ndarray:
        """(R,) int, how many collapses there are to the end of each round. Rounds come in order, and are few."""
        rounds = np.arange(self.round_index[-1] + 1) if len(self) else np.empty(0)
        return np.searchsorted(self.round_index, rounds, side="right")

    def recent_errors_at(self, index: np.ndarray) -> np.ndarray:
        """``recent_error`` of some collapses (n,), float32."""
        return self.recent_error.take(index)

    def last_errors(self, vertex: np.ndarray) -> np.ndarray:
        """(n,) float32, in diagonals: what the whole mesh had come to at the last collapse into each vertex (n,) int32.

        0 of vertices that nothing collapsed into.
        """
        count = 1 + max(int(vertex.max(initial=0)), int(self.kept.max(initial=0)))
        last = np.full(count, -1, dtype=np.int32)
        # Of several collapses into a vertex the last one counts: values are assigned in order.
        put_at(last, self.kept, np.arange(len(self), dtype=np.int32))
        index = last.take(vertex)
        found, merged = np.zeros(len(index), dtype=np.float32), np.flatnonzero(index >= 0)
        found[merged] = self.recent_errors_at(index.take(merged))
        return found

    def chosen_later(self, kept: np.ndarray) -> CollapseRecord:
        """The same, of which each of the values is taken when it is first asked for."""
        return _Chosen(self, kept)

    def roots(self, vertex_count: int) -> np.ndarray:
        """(V,) int32, the vertex that each vertex has collapsed into after all collapses."""
        root = np.arange(vertex_count, dtype=np.int32)
        # From the last round to the first: what a vertex went into has its own root by then, as collapses of one round
        # are independent.
        for first, last in reversed(list(itertools.pairwise([0, *self._round_ends().tolist()]))):
            # NumPy takes longer to index by 32 bits than to widen them, and both than the rest.
            removed, kept = self.removed[first:last].astype(np.intp), self.kept[first:last].astype(np.intp)
            root[removed] = root.take(kept)
        return root


class _Read(CollapseRecord):
    """A record as it was read, of which other values are found when they are first asked for: a device waits meanwhile.

    Args:
        faces_and_round: (C,) int32, both in one number.
        values: those that are there, by name.
    """

    def __init__(self, faces_and_round: np.ndarray, **values: np.ndarray) -> None:
        self.__dict__.update(values, _faces_and_round=faces_and_round)

    def made(self) -> CollapseRecord:
        """The same with all of its values."""
        return CollapseRecord(**{name: getattr(self, name) for name in _FIELDS})

    def recent_errors_at(self, index: np.ndarray) -> np.ndarray:
        """See :meth:`CollapseRecord.recent_errors_at`."""
        return _recent_errors(self._total, index + 1)

    def _round_ends(self) -> np.ndarray:
        """See :meth:`CollapseRecord._round_ends`."""
        numbers, bits = self._faces_and_round, int(kernels.FACE_BITS)
        rounds = np.arange(1, (numbers[-1] >> bits) + 2) if len(self) else np.empty(0, dtype=np.int32)
        return np.searchsorted(numbers, (rounds << bits).astype(np.int32))

    def __getattr__(self, name: str) -> np.ndarray:
        values = self.__dict__
        if name == "_total":
            found = _squares_before(values["error"])
        elif name == "recent_error":
            found = _all_recent_errors(self._total)
        elif name == "faces_removed":
            found = self._faces_and_round & ((1 << int(kernels.FACE_BITS)) - 1)
        elif name == "round_index":
            found = self._faces_and_round >> int(kernels.FACE_BITS)
        else:
            raise AttributeError(name)
        values[name] = found
        return found


class _Chosen(CollapseRecord):
    """Some collapses of a record, (C,) bool: most levels of a search are asked for none of their values."""

    def __init__(self, whole: CollapseRecord, kept: np.ndarray) -> None:
        self.__dict__.update(_whole=whole, _index=kept)

    def made(self) -> CollapseRecord:
        """The same with all of its values."""
        return CollapseRecord(**{name: getattr(self, name) for name in _FIELDS})

    def recent_errors_at(self, index: np.ndarray) -> np.ndarray:
        """See :meth:`CollapseRecord.recent_errors_at`."""
        whole: CollapseRecord = self.__dict__["_whole"]
        return whole.recent_errors_at(self._places.take(index))

    @property
    def _places(self) -> np.ndarray:
        """(n,) int, which of the collapses of the whole record they are."""
        values = self.__dict__
        if values["_index"].dtype == bool:
            values["_index"] = np.flatnonzero(values["_index"])
        places: np.ndarray = values["_index"]
        return places

    def __getattr__(self, name: str) -> np.ndarray:
        if name not in _FIELDS:
            raise AttributeError(name)
        values = self.__dict__
        found: np.ndarray = getattr(values["_whole"], name).take(self._places, axis=0)
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
    return _Read(
        faces_and_round,
        kept=kept,
        removed=removed,
        opposites=values[2:4].reshape(-1, 2)[:count],
        cost=cost.view(np.float32),
        error=error.view(np.float32),
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


def _squares_before(error: np.ndarray) -> np.ndarray:
    """(C + 1,) float64, the sum of the squared errors (C,) before each collapse, and of all."""
    total = np.empty(len(error) + 1)
    total[0] = 0.0
    np.square(error, dtype=np.float64, out=total[1:])
    np.cumsum(total, out=total)
    return total


def _recent_errors(total: np.ndarray, count: np.ndarray) -> np.ndarray:
    """(n,) float32, root mean square over the last ``RECENT`` of the first ``count`` (n,) collapses, at least the last.

    ``total`` is what :func:`_squares_before` gives.
    """
    taken = np.maximum((RECENT * count).astype(np.int64), 1)
    mean = total.take(count) - total.take(count - taken)
    np.maximum(mean, 0.0, out=mean)
    mean /= taken
    return np.sqrt(mean, out=mean).astype(np.float32)


def _all_recent_errors(total: np.ndarray) -> np.ndarray:
    """(C,) float32, the same up to each collapse."""
    recent = np.empty(len(total) - 1, dtype=np.float32)
    # Some at a time: new memory for all at once takes longer than the rest.
    for first in range(0, len(recent), AT_ONCE):
        last = min(first + AT_ONCE, len(recent))
        recent[first:last] = _recent_errors(total, np.arange(first + 1, last + 1))
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
