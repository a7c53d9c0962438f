"""Warp devices: which one to run on, how its kind works, and whose turn it is."""

from __future__ import annotations

import contextlib
import functools
import os
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, ParamSpec, TypeVar

import numpy as np
import warp as wp

from warpqem.errors import DeviceError
from warpqem.kernels.lanes import WIDE
from warpqem.runtime.thread_limit import thread_scope
from warpqem.runtime.warp_messages import quiet_start

__all__ = [
    "DeviceTraits",
    "array_device",
    "device_traits",
    "device_turn",
    "on_device",
    "resolve_device",
    "share_memory",
    "turns_released",
]

P = ParamSpec("P")
R = TypeVar("R")


@dataclass(frozen=True)
class DeviceTraits:
    """How launches work on a kind of device. Code asks for these, never for the kind itself.

    Attributes:
        block_width: frames that one thread works on side by side, see :mod:`warpqem.kernels.lanes`.
        warp_threads: threads that run in step.
        launch_threads: threads of a launch over a work list, each of which takes every so many of its items.
        in_order: the threads of a launch run one after the other, in the order of their index.
        splits_launches: a launch runs on one core, so a long one is split over the cores of the machine.
        captures: recorded launches are captured as a graph. Nothing else may use the device meanwhile.
        compiles_together: the first launch that finds no compiled code compiles all kernels, several at once.
        own_memory: arrays of the host are copied to the device, which takes longer than most of what is done there.
        graph_loops: a graph may hold loops and branches; on a device without captures, what stands for one.
    """

    block_width: int
    warp_threads: int
    launch_threads: int
    in_order: bool
    splits_launches: bool
    captures: bool
    compiles_together: bool
    own_memory: bool
    graph_loops: bool


# On a CPU, Warp's captures are one for the whole process, and a recorded launch takes 3 microseconds without one.
CPU = DeviceTraits(
    block_width=WIDE,
    warp_threads=1,
    launch_threads=1,
    in_order=True,
    splits_launches=True,
    captures=False,
    compiles_together=False,
    own_memory=False,
    graph_loops=True,
)
# 65536 threads are enough to fill any GPU of today.
GPU = DeviceTraits(
    block_width=1,
    warp_threads=32,
    launch_threads=65536,
    in_order=False,
    splits_launches=False,
    captures=True,
    compiles_together=True,
    own_memory=True,
    graph_loops=True,
)

_TRAITS = {"cpu": CPU, "cuda": GPU}


# Kinds of devices in DLPack: CUDA memory, and CUDA memory that the host sees too.
DLPACK_CUDA = (2, 13)

_starting = threading.Lock()
_started = False


def _start_warp() -> None:
    """Start Warp in one thread: threads that came to it at once would each start it."""
    global _started
    if _started:
        return
    with _starting:
        if not _started:
            with quiet_start():
                wp.init()
            _started = True


def device_traits(device: str) -> DeviceTraits:
    """How launches work on a Warp device."""
    if not _started:
        _start_warp()
    if device == "cpu" or wp.get_device(device).is_cpu:
        return _TRAITS["cpu"]
    traits = _TRAITS["cuda"]
    return traits if wp.is_conditional_graph_supported() else replace(traits, graph_loops=False)


def resolve_device(device: str | None = None) -> str:
    """Name of the Warp device to run on.

    Args:
        device: Warp device name such as ``"cpu"``, ``"cuda"`` or ``"cuda:1"``; None takes ``"cuda:0"`` where there is a
            CUDA device and ``"cpu"`` elsewhere.

    Raises:
        DeviceError: this machine has no such device; the message names the devices that exist.
    """
    _start_warp()
    if device is None:
        return "cuda:0" if wp.is_cuda_available() else "cpu"
    try:
        return wp.get_device(device).alias
    except (ValueError, RuntimeError, TypeError) as error:
        existing = ", ".join(d.alias for d in wp.get_devices())
        raise DeviceError(f"no Warp device {device!r} on this machine; it has: {existing}") from error


def array_device(value: Any) -> str | None:
    """Name of the device that an array is on, if it has memory of its own; None for every other argument.

    An array that has the CUDA array interface and no DLPack does not say which GPU it is on: Warp's current one.

    Raises:
        DeviceError: the array is on a GPU, and Warp finds none.
    """
    if isinstance(value, np.ndarray):
        return None
    if isinstance(value, (wp.array, wp.indexedarray)):
        device: str | None = None if value.device is None else value.device.alias
    else:
        device = _exchange_device(value)
    return device if device is not None and device_traits(device).own_memory else None


def _exchange_device(value: Any) -> str | None:
    """The GPU of an array that is not Warp's."""
    if hasattr(type(value), "__dlpack_device__"):
        try:
            kind, index = value.__dlpack_device__()
        except Exception:
            # It raises that again where the array is read, and there it has a name.
            return None
        return resolve_device(f"cuda:{int(index)}") if int(kind) in DLPACK_CUDA else None
    return resolve_device("cuda") if hasattr(type(value), "__cuda_array_interface__") else None


class _Turn:
    """A reentrant lock that its thread can let go for a while, however often it holds it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.owner: int | None = None
        self._depth = 0

    def take(self, depth: int = 1) -> None:
        if self.owner != threading.get_ident():
            self._lock.acquire()
            self.owner = threading.get_ident()
        self._depth += depth

    def give(self, depth: int = 1) -> None:
        self._depth -= depth
        if self._depth == 0:
            self.owner = None
            self._lock.release()

    @property
    def depth(self) -> int:
        return self._depth


# By device; filled under _filling.
_turns: dict[str, _Turn] = {}
_filling = threading.Lock()


def _free_locks() -> None:
    """Free all locks and turns in a forked process, which has none of the threads that held them."""
    global _filling, _starting
    _filling, _starting = threading.Lock(), threading.Lock()
    _turns.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_free_locks)


@contextlib.contextmanager
def device_turn(device: str | None = None) -> Iterator[str]:
    """Work on a device within; gives its name.

    A device that captures graphs takes one thread at a time: what another thread did meanwhile would become part of the
    graph. Other devices take any number.

    Raises:
        DeviceError: there is no such device, or the caller's own capture of a graph is under way on it.
    """
    name = resolve_device(device)
    if not device_traits(name).captures:
        _refuse_capture(name)
        yield name
        return
    with _filling:
        if name not in _turns:
            _keep_freed_memory(name)
        turn = _turns.setdefault(name, _Turn())
    turn.take()
    try:
        _refuse_capture(name)
        yield name
    finally:
        turn.give()


def _keep_freed_memory(name: str) -> None:
    """Keep memory that is freed for later arrays: else a GPU gives it back to the system whenever the host waits.

    A threshold that the caller has set stays.
    """
    device = wp.get_device(name)
    if device.is_cuda and wp.is_mempool_enabled(device) and wp.get_mempool_release_threshold(device) == 0:
        # All of the device's memory.
        wp.set_mempool_release_threshold(device, 1.0)


def share_memory(device: str, processes: int) -> None:
    """Keep no more than its part of the memory that is freed in this process, one of so many that share a device."""
    there = wp.get_device(resolve_device(device))
    if processes > 1 and there.is_cuda and wp.is_mempool_enabled(there):
        wp.set_mempool_release_threshold(there, 1.0 / processes)


def _refuse_capture(name: str) -> None:
    if wp.get_device(name).is_capturing:
        raise DeviceError(f"a graph is being captured on {name}: end the capture before calling warpqem")


@contextlib.contextmanager
def turns_released() -> Iterator[None]:
    """Give this thread's turns away within: for waiting for the caller's code, which may use warpqem on its own."""
    own = [(turn, turn.depth) for turn in list(_turns.values()) if turn.owner == threading.get_ident()]
    for turn, depth in own:
        turn.give(depth)
    try:
        yield
    finally:
        for turn, depth in own:
            turn.take(depth)


def on_device(function: Callable[P, R]) -> Callable[P, R]:
    """Run a public function in a turn of the device that its keyword ``device`` names.

    Where that is None, and its first argument is an array on a device, the function gets that device.
    """

    @functools.wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        device = kwargs.get("device")
        if device is None:
            there = array_device(args[0] if args else kwargs.get("points"))
            if there is not None:
                kwargs["device"] = device = there
        name = device if isinstance(device, str) else None if device is None else str(device)
        with thread_scope(), device_turn(name):
            return function(*args, **kwargs)

    return run
