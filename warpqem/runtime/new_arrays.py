"""New arrays, made in next to no time where they are small and on a CPU.

Warp takes 5 to 20 microseconds to make one, and a mesh of some hundred faces needs hundreds. On a CPU a small array
here is a copy of one that Warp made of the same type, over memory of NumPy's.
"""

from __future__ import annotations

import ctypes
import functools
import math
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.runtime.device import device_traits

__all__ = ["clone", "empty", "full", "like", "part", "row", "uploaded", "zeros"]

Shape = int | tuple[int, ...] | list[int]

# Bytes from which on the time is that of the memory.
SMALL = 2**16
# What a kernel gets of an array: address, that of its gradient, extents and strides of up to four axes, number of axes.
DESCRIPTOR = struct.Struct("=QQ4i4iHHxxxx")
DESCRIPTOR_TYPE = type(wp.array(dtype=wp.int32).__ctype__())
assert DESCRIPTOR.size == ctypes.sizeof(DESCRIPTOR_TYPE)
NO_AXES = (0, 0, 0, 0)


@dataclass(frozen=True)
class _Kind:
    """Arrays of one type and number of axes.

    Attributes:
        attributes: of an array of Warp's of this kind.
        item: NumPy's type of an element, or of its components.
        inner: the shape of an element, () of a number.
        item_bytes: bytes of an element.
    """

    attributes: dict[str, Any]
    item: np.dtype[Any]
    inner: tuple[int, ...]
    item_bytes: int

    def over(self, memory: Any, shape: tuple[int, ...]) -> wp.array:
        """An array of this kind over memory of NumPy's, as large and contiguous, which it holds."""
        return self.at(ctypes.addressof(ctypes.c_char.from_buffer(memory)), memory, shape)

    def at(self, address: int, memory: Any, shape: tuple[int, ...]) -> wp.array:
        """An array of this kind at an address within contiguous memory, which it holds."""
        size, stride = shape[0], self.item_bytes
        strides: tuple[int, ...] = ()
        for extent in shape[:0:-1]:
            strides = (stride, *strides)
            stride *= extent
            size *= extent
        made: wp.array = object.__new__(wp.array)
        values = made.__dict__
        values.update(self.attributes)
        strides = (stride, *strides)
        values["ptr"], values["shape"], values["strides"] = address, shape, strides
        # Nearly all are given to a kernel or a struct: Warp takes three times as long to describe them.
        axes = len(shape)
        extents = *shape, *NO_AXES[axes:], *strides, *NO_AXES[axes:]
        values["ctype"] = DESCRIPTOR_TYPE.from_buffer_copy(DESCRIPTOR.pack(address, 0, *extents, axes, 0))
        values["size"], values["capacity"] = size, size * self.item_bytes
        # Not Warp's: as long as the array or a view of it lives, its memory does.
        values["memory"] = memory
        return made


_kinds: dict[tuple[Any, int], _Kind] = {}


def _kind(dtype: Any, axes: int) -> _Kind:
    key = (dtype, axes)
    kind = _kinds.get(key)
    if kind is None:
        shape = (1,) * axes
        one = wp.empty(shape, dtype=dtype, device="cpu")
        values = one.numpy()
        # Of one that does not free its memory.
        attributes = dict(vars(wp.array(ptr=one.ptr, dtype=dtype, shape=shape, device="cpu")))
        kind = _kinds[key] = _Kind(attributes, values.dtype, values.shape[axes:], values.nbytes)
    return kind


def _shape(shape: Shape) -> tuple[int, ...]:
    return tuple(map(int, shape)) if isinstance(shape, (tuple, list)) else (int(shape),)


def _is_quick(device: wp.DeviceLike) -> bool:
    return not device_traits(str(device)).own_memory


def _over_new_memory(make: Callable[..., Any], shape: Shape, dtype: Any, device: wp.DeviceLike) -> wp.array | None:
    """A small array on a CPU over bytes that ``make`` makes; None for others."""
    if not _is_quick(device):
        return None
    extents = _shape(shape)
    kind = _kind(dtype, len(extents))
    size = math.prod(extents) * kind.item_bytes
    if size == 0:
        return _without_elements(dtype, extents)
    return kind.over(make(size, dtype=np.uint8), extents) if size <= SMALL else None


def _without_elements(dtype: Any, shape: tuple[int, ...]) -> wp.array:
    """An array without memory: a copy of one that Warp has made."""
    made: wp.array = object.__new__(wp.array)
    made.__dict__.update(_empty_attributes(dtype, shape))
    return made


@functools.lru_cache(maxsize=256)
def _empty_attributes(dtype: Any, shape: tuple[int, ...]) -> dict[str, Any]:
    return {**vars(wp.empty(shape, dtype=dtype, device="cpu")), "deleter": None}


def empty(shape: Shape, dtype: Any, device: wp.DeviceLike) -> wp.array:
    """What ``wp.empty`` gives."""
    made = _over_new_memory(np.empty, shape, dtype, device)
    return wp.empty(shape, dtype=dtype, device=device) if made is None else made


def like(array: wp.array) -> wp.array:
    """What ``wp.empty_like`` gives, of an array on its device."""
    return empty(array.shape, dtype=array.dtype, device=array.device)


def zeros(shape: Shape, dtype: Any, device: wp.DeviceLike) -> wp.array:
    """What ``wp.zeros`` gives."""
    made = _over_new_memory(np.zeros, shape, dtype, device)
    return wp.zeros(shape, dtype=dtype, device=device) if made is None else made


def full(shape: Shape, value: float, dtype: Any, device: wp.DeviceLike) -> wp.array:
    """What ``wp.full`` gives; an element is a number."""
    if _is_quick(device):
        extents = _shape(shape)
        kind = _kind(dtype, len(extents))
        size = math.prod(extents) * kind.item_bytes
        if 0 < size <= SMALL and not kind.inner:
            return kind.over(np.full(extents, value, dtype=kind.item), extents)
    return wp.full(shape, value, dtype=dtype, device=device)


def uploaded(values: npt.ArrayLike, dtype: Any, device: wp.DeviceLike, *, copy: bool = True) -> wp.array:
    """What ``wp.array`` gives for values (..., shape of an element): a copy of them.

    Without ``copy``, large ones may be theirs where their memory does: neither is changed then.
    """
    if _is_quick(device):
        given = np.shape(values)
        inner = _kind(dtype, 1).inner
        axes = len(given) - len(inner)
        if axes > 0 and given[axes:] == inner:
            kind = _kind(dtype, axes)
            size = math.prod(given[:axes]) * kind.item_bytes
            if size == 0:
                return _without_elements(dtype, given[:axes])
            if size <= SMALL:
                return kind.over(np.array(values, dtype=kind.item, order="C"), given[:axes])
    return wp.array(values, dtype=dtype, device=device, copy=copy)


def clone(array: wp.array) -> wp.array:
    """What ``wp.clone`` gives, of an array on its device."""
    if not (array.is_contiguous and _is_quick(array.device)):
        return wp.clone(array)
    made = like(array)
    if array.size:
        ctypes.memmove(made.ptr, array.ptr, array.strides[-1] * array.size)
    return made


def part(array: wp.array, first: int, last: int) -> wp.array:
    """``array[first:last]``: consecutive rows of an array, of the same memory."""
    shape = array.shape
    if not (array.is_contiguous and 0 <= first < last <= shape[0] and _is_quick(array.device)):
        return array[first:last]
    return _kind(array.dtype, len(shape)).at(array.ptr + first * array.strides[0], array, (last - first, *shape[1:]))


def row(array: wp.array, index: int) -> wp.array:
    """``array[index]`` of an array of several axes: one of its rows, of the same memory."""
    shape = array.shape
    if not (array.is_contiguous and 0 <= index < shape[0] and array.size and _is_quick(array.device)):
        return array[index]
    return _kind(array.dtype, len(shape) - 1).at(array.ptr + index * array.strides[0], array, shape[1:])
