"""Calls of kernels on a CPU, prepared once for each kernel.

``wp.launch`` looks at the kernel, its module, the device and every argument anew: 20 microseconds, of which a mesh of
some hundred faces pays hundreds. Here a kernel's compiled function and the structure of its arguments are kept from
what Warp itself records (``wp.Launch``), so that a launch takes 3, and one that is repeated 0.2.
"""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import warp as wp

__all__ = ["PackedCall", "know_call", "packed_call", "prepared_call", "prepared_copy", "prepared_zero"]

# Scalars that Warp converts by itself, bit by bit.
CONVERTED = (wp.float16, wp.bfloat16)
# Extents of launches are unsigned, and the indices of threads signed.
MAX_THREADS = 2**31

# What a kernel gets of an array.
ARRAY = type(wp.array(dtype=wp.int32).__ctype__())

# A compiled kernel.
FUNCTION = ctypes.CFUNCTYPE(None)

# On a CPU blocks have one thread. Where a module keeps the code of such blocks.
BLOCK_THREADS = 1
CPU_CODE = (None, BLOCK_THREADS)


@dataclass(frozen=True)
class PackedCall:
    """A launch of a kernel in memory: whoever keeps it keeps its code, and no array.

    Attributes:
        function: the code, which takes addresses of the next two.
        address: where it is.
        bounds: the extents of the launch.
        arguments: what the kernel gets.
    """

    function: Any
    address: int
    bounds: ctypes.Structure
    arguments: ctypes.Structure

    def run(self) -> None:
        """Launch the kernel."""
        self.function(ctypes.byref(self.bounds), ctypes.byref(self.arguments))


# None for kernels whose arguments need Warp's own look at them.
_calls: dict[wp.Kernel, _Call | None] = {}


class _Call:
    """A kernel's function, and what its arguments are packed into.

    Args:
        command: a launch as Warp recorded it.
    """

    def __init__(self, command: wp.Launch) -> None:
        arguments = command.kernel.adj.args
        fields = [(one.label, type(packed)) for one, packed in zip(arguments, command.params[1:], strict=True)]
        self._packed = type("Arguments", (ctypes.Structure,), {"_fields_": fields})
        # Of arrays the type of their elements and the number of axes; True for structs, False for other values.
        self._kinds = [
            (one.type.dtype, one.type.ndim) if packed is ARRAY else (_is_struct(one.type), 0)
            for one, (_, packed) in zip(arguments, fields, strict=True)
        ]
        self._bounds: Any = type(command.bounds)
        self._axes = len(command.bounds.shape)
        # The code, and the hashes that Warp looked at for it.
        self._module, self._code = command.kernel.module, command.module_exec
        self._hashes = self._module.hashers.get(BLOCK_THREADS)
        # One of its own, which holds the code: Warp's does not, and a recorded call may outlive the module's code.
        address = ctypes.cast(command.hooks.forward, ctypes.c_void_p).value
        assert address is not None
        self._address = address
        self._function = FUNCTION(address)
        self._function.code = self._code  # type: ignore[attr-defined]  # any may be set

    @property
    def is_current(self) -> bool:
        """Whether the code is what Warp would run: a module that has changed since is compiled anew.

        Warp forgets the hashes of a module when it changes; those that are taken then are others, even if no code has
        been loaded for them yet.
        """
        module, hashes = self._module, self._hashes
        return (
            hashes is not None
            and module.hashers.get(BLOCK_THREADS) is hashes
            and module.execs.get(CPU_CODE) is self._code
        )

    def prepared(self, dim: tuple[int, ...], arguments: Sequence[Any]) -> Callable[[], object] | None:
        """What launches the kernel; None where Warp has to look at the arguments.

        It holds the code, and no array.
        """
        packed = self._pack(dim, arguments)
        return (
            None if packed is None else partial(self._function, _kept_bounds(self._bounds, dim), ctypes.byref(packed))
        )

    def packed(self, dim: tuple[int, ...], arguments: Sequence[Any]) -> PackedCall | None:
        """The same at known addresses."""
        packed = self._pack(dim, arguments)
        return None if packed is None else PackedCall(self._function, self._address, self._bounds(dim), packed)

    def _pack(self, dim: tuple[int, ...], arguments: Sequence[Any]) -> ctypes.Structure | None:
        """What the kernel gets; None where Warp has to look at the arguments."""
        size = 1
        for extent in dim:
            size *= extent
        if len(dim) != self._axes or not 0 < size < MAX_THREADS or len(arguments) != len(self._kinds):
            return None
        values = []
        for value, (kind, axes) in zip(arguments, self._kinds, strict=True):
            if axes:
                if type(value) is not wp.array or value.dtype is not kind or value.ndim != axes:
                    return None
                # Kept by the array from the first time on.
                values.append(value.ctype or value.__ctype__())
            else:
                values.append(value.__ctype__() if kind else value)
        try:
            packed: ctypes.Structure = self._packed(*values)
        except TypeError:
            # A struct of another kind, or a number of another type: Warp converts it, or says what is wrong.
            return None
        return packed


@functools.lru_cache(maxsize=1024)
def _kept_bounds(kind: Any, dim: tuple[int, ...]) -> Any:
    """The extents of a launch for a call; kernels only read them."""
    return ctypes.byref(kind(dim))


def _is_struct(declared: Any) -> bool:
    return hasattr(declared, "vars")


def _is_plain(command: wp.Launch) -> bool:
    """Whether a kernel's arguments are regular arrays, structs, vectors and numbers only."""
    types = [one.type for one in command.kernel.adj.args]
    return all(
        type(packed) is ARRAY or _is_struct(declared) or (isinstance(declared, type) and declared not in CONVERTED)
        for declared, packed in zip(types, command.params[1:], strict=True)
    )


def prepared_call(kernel: wp.Kernel, dim: int | Sequence[int], arguments: Sequence[Any]) -> Callable[[], object] | None:
    """What launches a kernel on a CPU that does not capture, as often as it is called; whoever keeps it keeps arrays.

    None where Warp has to look at it: of a kernel that is not known yet or has changed, for arguments that are not just
    what it takes, or for no threads.
    """
    call = _calls.get(kernel)
    if call is None or not call.is_current:
        return None
    return call.prepared((dim,) if isinstance(dim, (int, np.integer)) else tuple(dim), arguments)


def packed_call(kernel: wp.Kernel, dim: int, arguments: Sequence[Any]) -> PackedCall | None:
    """The same at known addresses; whoever keeps it has to keep the arrays."""
    call = _calls.get(kernel)
    return None if call is None or not call.is_current else call.packed((dim,), arguments)


def know_call(kernel: wp.Kernel, command: wp.Launch) -> None:
    """Take what later launches of a kernel need from one that Warp has recorded."""
    known = _calls.get(kernel)
    if kernel not in _calls or (known is not None and not known.is_current):
        _calls[kernel] = _Call(command) if _is_plain(command) and not kernel.is_generic else None


def prepared_copy(target: wp.array, source: wp.array, source_offset: int, count: int) -> Callable[[], object]:
    """What copies ``count`` elements to the beginning of an array on a CPU; whoever keeps it keeps the arrays."""
    item = source.strides[-1]
    plain = target.is_contiguous and source.is_contiguous and target.strides[-1] == item
    if not plain or not (0 < count <= target.size and source_offset + count <= source.size):
        return partial(wp.copy, target, source, 0, source_offset, count)
    return partial(ctypes.memmove, target.ptr, source.ptr + item * source_offset, item * count)


def prepared_zero(array: wp.array) -> Callable[[], object]:
    """What fills an array on a CPU with zeros; whoever keeps it keeps the array."""
    if not array.is_contiguous or array.size == 0:
        return partial(array.zero_)
    return partial(ctypes.memset, array.ptr, 0, array.strides[-1] * array.size)
