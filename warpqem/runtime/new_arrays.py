"""New arrays, made in next to no time where they are small and on a CPU.

Warp takes 5 to 20 microseconds to make one, and a mesh of some hundred faces needs hundreds. On a CPU a small array
here is a copy of one that Warp made of the same type and shape, over memory of NumPy's.
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

__all__ = ["clone", "copy", "empty", "full", "like", "part", "row", "shaped", "uploaded", "zeros"]

Shape = int | tuple[int, ...] | list[int]

# Bytes from which on the time is that of the memory.
SMALL = 2**16
# Types and shapes that are kept: a mesh has some hundred.
KEPT_FORMS = 4096
# What a kernel gets of an array: its address and that of its gradient; extents and strides, number of axes, flags.
MAX_AXES = 4
ADDRESSES = struct.Struct("=QQ")
EXTENTS = struct.Struct("=4i4iHHxxxx")
DESCRIPTOR = type(wp.array(dtype=wp.int32).__ctype__())


@dataclass(frozen=True)
class _Form:
    """Arrays of one type and shape, contiguous.

    Attributes:
        attributes: of an array of Warp's of this form, which does not free its memory.
        extents: what a kernel gets of it behind the addresses.
        size: bytes.
        item: NumPy's type of an element, or of its components.
        inner: the shape of an element, () of a number.
    """

    attributes: dict[str, Any]
    extents: bytes
    size: int
    item: np.dtype[Any]
    inner: tuple[int, ...]

    @property
    def is_small(self) -> bool:
        """Whether Warp takes longer for it than its memory does."""
        return self.size <= SMALL

    def over(self, memory: Any) -> wp.array:
        """An array of this form over memory of NumPy's, as large and contiguous, which it holds."""
        return self.at(ctypes.addressof(ctypes.c_char.from_buffer(memory)) if self.size else None, memory)

    def at(self, address: int | None, memory: Any) -> wp.array:
        """An array of this form at an address within memory, which it holds; None for one without elements."""
        made: wp.array = object.__new__(wp.array)
        values = made.__dict__
        values.update(self.attributes)
        values["ptr"] = address
        # Nearly all are given to a kernel or a struct: Warp takes three times as long to describe them.
        values["ctype"] = DESCRIPTOR.from_buffer_copy(ADDRESSES.pack(address or 0, 0) + self.extents)
        # Not Warp's: as long as the array or a view of it lives, its memory does.
        values["memory"] = memory
        return made


@functools.cache
def _unit_form(dtype: Any, axes: int) -> _Form:
    """That of an array of one element, as Warp makes it."""
    shape = (1,) * axes
    one = wp.empty(shape, dtype=dtype, device="cpu")
    values = one.numpy()
    # Of one that does not free its memory. The address is put in its place later.
    made = wp.array(ptr=one.ptr, dtype=dtype, shape=shape, device="cpu")
    return _Form(dict(vars(made)), b"", values.nbytes, values.dtype, values.shape[axes:])


@functools.lru_cache(maxsize=KEPT_FORMS)
def _form(dtype: Any, shape: int | tuple[int, ...]) -> _Form:
    extents = tuple(map(int, shape)) if isinstance(shape, tuple) else (int(shape),)
    axes = len(extents)
    unit = _unit_form(dtype, axes)
    strides = [unit.size] * axes
    for axis in range(axes - 1, 0, -1):
        strides[axis - 1] = strides[axis] * extents[axis]
    size = strides[0] * extents[0]
    attributes = {**unit.attributes, "shape": extents, "strides": tuple(strides)}
    attributes |= {"size": size // unit.size if size else 0, "capacity": size}
    rest = (0,) * (MAX_AXES - axes)
    return _Form(attributes, EXTENTS.pack(*extents, *rest, *strides, *rest, axes, 0), size, unit.item, unit.inner)


def _form_of(dtype: Any, shape: Shape) -> _Form:
    return _form(dtype, tuple(shape) if isinstance(shape, list) else shape)


def _is_quick(device: wp.DeviceLike) -> bool:
    return not device_traits(str(device)).own_memory


def _over_new_memory(make: Callable[..., Any], shape: Shape, dtype: Any, device: wp.DeviceLike) -> wp.array | None:
    """A small array on a CPU over bytes that ``make`` makes; None for others."""
    if not _is_quick(device):
        return None
    form = _form_of(dtype, shape)
    return form.over(make(form.size, dtype=np.uint8)) if form.is_small else None


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
        form = _form_of(dtype, shape)
        if form.is_small and not form.inner:
            return form.over(np.full(form.attributes["shape"], value, dtype=form.item))
    return wp.full(shape, value, dtype=dtype, device=device)


def uploaded(values: npt.ArrayLike, dtype: Any, device: wp.DeviceLike, *, copy: bool = True) -> wp.array:
    """What ``wp.array`` gives for values (..., shape of an element): a copy of them.

    Without ``copy``, large ones may be theirs where their memory does: neither is changed then.
    """
    if _is_quick(device):
        given = np.shape(values)
        inner = _form(dtype, 1).inner
        axes = len(given) - len(inner)
        if axes > 0 and given[axes:] == inner:
            form = _form(dtype, given[:axes])
            if form.is_small:
                return form.over(np.array(values, dtype=form.item, order="C"))
    return wp.array(values, dtype=dtype, device=device, copy=copy)


def clone(array: wp.array) -> wp.array:
    """What ``wp.clone`` gives, of an array on its device."""
    if not (array.is_contiguous and _is_quick(array.device)):
        return wp.clone(array)
    made = like(array)
    if array.size:
        ctypes.memmove(made.ptr, array.ptr, array.strides[-1] * array.size)
    return made


def copy(target: wp.array, source: wp.array) -> None:
    """What ``wp.copy`` does, of arrays of one type and shape."""
    plain = target.is_contiguous and source.is_contiguous and target.size == source.size > 0
    if plain and _is_quick(target.device) and _is_quick(source.device):
        ctypes.memmove(target.ptr, source.ptr, source.strides[-1] * source.size)
    else:
        wp.copy(target, source)


def part(array: wp.array, first: int, last: int) -> wp.array:
    """``array[first:last]``: consecutive rows of an array, of the same memory."""
    shape = array.shape
    if not (array.is_contiguous and 0 <= first < last <= shape[0] and array.size and _is_quick(array.device)):
        return array[first:last]
    return _form(array.dtype, (last - first, *shape[1:])).at(array.ptr + first * array.strides[0], array)


def row(array: wp.array, index: int) -> wp.array:
    """``array[index]`` of an array of several axes: one of its rows, of the same memory."""
    shape = array.shape
    if not (array.is_contiguous and 0 <= index < shape[0] and array.size and _is_quick(array.device)):
        return array[index]
    return _form(array.dtype, shape[1:]).at(array.ptr + index * array.strides[0], array)


def shaped(array: wp.array, shape: tuple[int, ...], dtype: Any = None, first: int = 0) -> wp.array:
    """An array of another shape over the memory of a contiguous one, from its item ``first`` on.

    Of another type, too, if ``dtype`` is given: one whose components are as large as the items.
    """
    kind = array.dtype if dtype is None else dtype
    if array.is_contiguous and _is_quick(array.device):
        form, item = _form(kind, shape), array.strides[-1]
        if form.size and item * first + form.size <= item * array.size:
            return form.at(array.ptr + item * first, array)
    inner = () if kind is array.dtype else getattr(kind, "_shape_", ())
    some: wp.array = array.flatten()[first : first + math.prod(shape) * math.prod(inner)].reshape((*shape, *inner))
    return some if kind is array.dtype else some.view(kind)
