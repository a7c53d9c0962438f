"""Arrays of a device on the host, several at once: the host waits for a device once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from warpqem.runtime import new_arrays
from warpqem.runtime.device import device_traits

__all__ = ["joined", "read_together"]

# Bytes of a word.
ITEM = 4


def read_together(*arrays: wp.array) -> list[np.ndarray]:
    """What ``numpy()`` of each gives, by one copy to the host.

    Args:
        arrays: those of one device, contiguous, of whole words: of numbers of four or eight bytes or of vectors of
            them, or four bytes, eight and so on of smaller ones.

    Raises:
        ValueError: one is of no whole words.
    """
    device = arrays[0].device
    if len(arrays) == 1 or not device_traits(str(device)).own_memory:
        return [array.numpy() for array in arrays]
    ends = np.cumsum(_words(arrays))
    parts = np.split(joined(arrays).numpy(), ends[:-1])
    return [_as_in(array, part) for array, part in zip(arrays, parts, strict=True)]


def joined(arrays: Sequence[wp.array]) -> wp.array:
    """One array of the device, of int32, that holds the words of all; for which see :func:`read_together`."""
    device, counts = arrays[0].device, _words(arrays)
    found = new_arrays.empty(sum(counts), dtype=wp.int32, device=device)
    end = 0
    for array, count in zip(arrays, counts, strict=True):
        if count:
            numbers = wp.array(ptr=array.ptr, dtype=wp.int32, shape=(count,), device=device)
            wp.copy(found, numbers, dest_offset=end, count=count)
        end += count
    return found


def _words(arrays: Sequence[wp.array]) -> list[int]:
    """How many each has.

    Raises:
        ValueError: one is of no whole words.
    """
    sizes = [array.size * wp.types.type_size_in_bytes(array.dtype) for array in arrays]
    if any(size % ITEM for size in sizes):
        raise ValueError(f"arrays of {', '.join(map(str, sizes))} bytes, expected words of {ITEM}")
    return [size // ITEM for size in sizes]


def _as_in(array: wp.array, numbers: np.ndarray) -> np.ndarray:
    """Numbers (n,) int32 with the type and shape that an array has in NumPy."""
    kind = wp.dtype_to_numpy(getattr(array.dtype, "_wp_scalar_type_", array.dtype))
    found: np.ndarray = numbers.view(kind).reshape(*array.shape, *getattr(array.dtype, "_shape_", ()))
    return found
