"""The ways of a CUDA device on Warp's CPU device, so that what would break on a GPU breaks where there is none.

``CUDA_SEMANTICS=forward``, ``reversed`` or ``shuffled`` before pytest turns it on (see ``conftest.py``):

- the threads of a launch run in that order; shuffled is another order in every launch, the same in every run;
- warpqem works as on a GPU: frames in blocks of one, many threads over a work list, no split launches, captured graphs;
- ``array.numpy()`` and ``wp.array(data)`` copy, and ``numpy()`` fails during a capture;
- memory of ``wp.empty`` holds garbage;
- a captured graph holds no reference to its arrays: launching it after one of them is gone is an error;
- memory that is allocated in the body of a captured loop or branch is an error, also by Warp's own functions.

It changes Warp's code generator, so it is made for one version. Kernels get a cache of their own.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import mmap
import os
import tempfile
import weakref
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import warp as wp
from warp._src import codegen

import warpqem.runtime.device

__all__ = [
    "ORDERS",
    "VERSION",
    "AllocationInLoopError",
    "FreedArrayError",
    "Traffic",
    "counted",
    "install",
    "set_order",
]

VERSION = "1.19"
ORDERS = {"forward": 0, "reversed": 1, "shuffled": 2}
# Threads of a launch over a work list: few, since each costs time here, and a prime, so that shares are uneven.
LAUNCH_THREADS = 61
# Kernels read the order at this address: compiled code is the same for all of them, and can be cached. Far from where
# Linux puts heaps, stacks and libraries.
PAGE = 0x1000_0000_0000
GARBAGE = 0xA5

_IN_ORDER = """    for (size_t task_index = 0; task_index < dim->size; ++task_index)
    {{
"""
# Thread k of n is (a k + b) mod n, a without a common divisor with n.
_PERMUTED = f"""    volatile int* const order_page = (volatile int*){PAGE:#x}ull;
    const size_t thread_count = dim->size;
    size_t order_factor = 1, order_shift = 0;
    if (order_page[0] == 1 && thread_count > 1) {{{{ order_factor = order_shift = thread_count - 1; }}}}
    if (order_page[0] == 2 && thread_count > 2) {{{{
        const size_t order_seed = ((size_t)(unsigned)(order_page[1]++) + 1) * 0x9E3779B97F4A7C15ull;
        order_factor = 1 + (order_seed >> 20) % (thread_count - 1);
        order_shift = (order_seed >> 40) % thread_count;
        for (;; order_factor = 1 + order_factor % (thread_count - 1)) {{{{
            size_t divisor = order_factor, rest = thread_count;
            while (rest) {{{{ const size_t next = divisor % rest; divisor = rest; rest = next; }}}}
            if (divisor == 1) break;
        }}}}
    }}}}
    for (size_t thread_rank = 0; thread_rank < thread_count; ++thread_rank)
    {{{{
        const size_t task_index = (thread_rank * order_factor + order_shift) % thread_count;
"""


# Functions of Warp that allocate on a CUDA device, which the CPU does not show.
ALLOCATING = ("array_inner", "array_scan", "array_sum", "runlength_encode")


class FreedArrayError(RuntimeError):
    """A graph is launched, and an array that it uses is gone."""


class AllocationInLoopError(RuntimeError):
    """Memory is allocated in the body of a loop or branch of a graph."""


@dataclass
class Traffic:
    """What passes between the host and the device: times that the host waits, what it reads, graphs launched."""

    readbacks: int = 0
    values_read: int = 0
    bytes_read: int = 0
    graph_launches: int = 0


_traffic = Traffic()


@contextlib.contextmanager
def counted() -> Iterator[Traffic]:
    """Count the traffic within."""
    global _traffic
    before, _traffic = _traffic, Traffic()
    try:
        yield _traffic
    finally:
        _traffic = before


def install(order: str) -> None:
    """Turn it on for the rest of the process, before any kernel is compiled.

    Raises:
        ValueError: there is no such order.
        RuntimeError: this is another version of Warp.
    """
    if order not in ORDERS:
        raise ValueError(f"CUDA_SEMANTICS={order}: expected one of {', '.join(ORDERS)}")
    if not wp.__version__.startswith(f"{VERSION}.") or _IN_ORDER not in codegen.cpu_module_template_forward:
        raise RuntimeError(f"CUDA semantics are made for Warp {VERSION}, this is {wp.__version__}")
    _map_page()
    set_order(order)
    codegen.cpu_module_template_forward = codegen.cpu_module_template_forward.replace(_IN_ORDER, _PERMUTED)
    wp.config.kernel_cache_dir = str(Path(tempfile.gettempdir()) / f"warpqem-cuda-semantics-{os.getuid()}-{VERSION}")
    # Kernels are compiled for the CPU, one module after the other.
    traits = replace(warpqem.runtime.device.GPU, launch_threads=LAUNCH_THREADS, compiles_together=False)
    warpqem.runtime.device._TRAITS["cpu"] = traits
    _copy_arrays()
    _fill_with_garbage()
    _hold_no_references()
    _refuse_allocation()


def set_order(order: str) -> None:
    """The order of threads from now on, one of ``ORDERS``."""
    ctypes.c_int.from_address(PAGE).value = ORDERS[order]


def _map_page() -> None:
    libc = ctypes.CDLL(None)
    libc.mmap.restype = ctypes.c_void_p
    libc.mmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t, *[ctypes.c_int] * 3, ctypes.c_long]
    fixed = 0x100000  # MAP_FIXED_NOREPLACE of Linux
    flags = mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | fixed
    if libc.mmap(PAGE, mmap.PAGESIZE, mmap.PROT_READ | mmap.PROT_WRITE, flags, -1, 0) != PAGE:
        raise RuntimeError(f"no page to be had at {PAGE:#x} for the order of threads")


def _copy_arrays() -> None:
    numpy, init = wp.array.numpy, wp.array.__init__

    def copied(self: wp.array) -> np.ndarray:
        if wp.get_device("cpu").is_capturing:
            raise RuntimeError("numpy() while a graph is captured: a GPU cannot synchronise then")
        _traffic.readbacks += 1
        _traffic.values_read += self.size
        _traffic.bytes_read += self.size * wp.types.type_size_in_bytes(self.dtype)
        return np.array(numpy(self), copy=True)

    def made(self: wp.array, data: object = None, *args: object, **kwargs: object) -> None:
        init(self, np.array(data, copy=True) if isinstance(data, np.ndarray) else data, *args, **kwargs)

    wp.array.numpy, wp.array.__init__ = copied, made


def _fill_with_garbage() -> None:
    empty = wp.empty

    def filled(*args: object, **kwargs: object) -> wp.array:
        array = empty(*args, **kwargs)
        if array.ptr and array.is_contiguous and not array.device.is_capturing:
            ctypes.memset(array.ptr, GARBAGE, array.size * wp.types.type_size_in_bytes(array.dtype))
        return array

    wp.empty = filled


def _hold_no_references() -> None:
    end, launch = wp.ScopedCapture.__exit__, wp.capture_launch
    used: weakref.WeakKeyDictionary[wp.Graph, list[weakref.ref]] = weakref.WeakKeyDictionary()

    def ended(self: wp.ScopedCapture, *args: object) -> object:
        result = end(self, *args)
        recorded = getattr(self.graph, "_apic_capture", None)
        if recorded is not None:
            used[self.graph] = [weakref.ref(base) for *_, base in recorded._regions.values()]
            recorded._regions = {}
        return result

    def launched(graph: wp.Graph, *args: object, **kwargs: object) -> None:
        gone = sum(array() is None for array in used.get(graph, ()))
        if gone:
            raise FreedArrayError(f"{gone} arrays of a captured graph are freed")
        _traffic.graph_launches += 1
        launch(graph, *args, **kwargs)

    wp.ScopedCapture.__exit__, wp.capture_launch = ended, launched


def _refuse_allocation() -> None:
    device, depth = wp.get_device("cpu"), 0

    def within(body: Callable | None) -> Callable | None:
        if body is None:
            return None

        def run(**kwargs: object) -> None:
            nonlocal depth
            depth += device.is_capturing
            try:
                body(**kwargs)
            finally:
                depth -= device.is_capturing

        return run

    def checked(function: Callable, name: str) -> Callable:
        @functools.wraps(function)
        def run(*args: object, **kwargs: object) -> object:
            if depth:
                raise AllocationInLoopError(f"{name} in the body of a captured loop allocates memory")
            return function(*args, **kwargs)

        return run

    branch, loop, allocator = wp.capture_if, wp.capture_while, device.default_allocator
    wp.capture_if = lambda condition, on_true=None, on_false=None, **kwargs: branch(
        condition, within(on_true), within(on_false), **kwargs
    )
    wp.capture_while = lambda condition, body, **kwargs: loop(condition, within(body), **kwargs)
    allocator.allocate = checked(allocator.allocate, "a new array")
    for name in ALLOCATING:
        setattr(wp.utils, name, checked(getattr(wp.utils, name), name))
