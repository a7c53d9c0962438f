"""Arrays of a device on the host, several at once: the host waits for a device once."""

from __future__ import annotations

import numpy as np
import warp as wp

from warpqem.runtime import new_arrays
from warpqem.runtime.device import device_traits

__all__ = ["read_together"]

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
    sizes = [array.size * wp.types.type_size_in_bytes(array.dtype) for array in arrays]
    if any(size % ITEM for size in sizes):
        raise ValueError(f"arrays of {', '.join(map(str, sizes))} bytes, expected words of {ITEM}")
    counts = [size // ITEM for size in sizes]
    joined = new_arrays.empty(sum(counts), dtype=wp.int32, device=device)
    ends = np.cumsum(counts)
    for array, count, end in zip(arrays, counts, ends.tolist(), strict=True):
        if count:
            numbers = wp.array(ptr=array.ptr, dtype=wp.int32, shape=(count,), device=device)
            wp.copy(joined, numbers, dest_offset=end - count, count=count)
    parts = np.split(joined.numpy(), ends[:-1])
    return [_as_in(array, part) for array, part in zip(arrays, parts, strict=True)]


def _as_in(array: wp.array, numbers: np.ndarray) -> np.ndarray:
    """Numbers (n,) int32 with the type and shape that an array has in NumPy."""
    kind = wp.dtype_to_numpy(getattr(array.dtype, "_wp_scalar_type_", array.dtype))
    found: np.ndarray = numbers.view(kind).reshape(*array.shape, *getattr(array.dtype, "_shape_", ()))
    return found
