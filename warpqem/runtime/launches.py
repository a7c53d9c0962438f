"""Launches of kernels: once, or recorded to be run again and again."""

from __future__ import annotations

import contextlib
import gc
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import warp as wp

from warpqem.runtime.compiling import compiling
from warpqem.runtime.cpu_calls import PackedCall, know_call, packed_call, prepared_call, prepared_copy, prepared_zero
from warpqem.runtime.device import device_traits
from warpqem.runtime.warp_messages import quiet_loading

__all__ = ["Recorder", "compile_module", "launch", "load_kernel", "packed_launch"]

# Modules by device that are compiled and loaded. Threads that came to a module at once would each compile it, and load
# it under the same name.
_loaded: set[tuple[wp.Module, str]] = set()
_loading = threading.RLock()


def _renew_lock() -> None:
    """Free the lock in a forked process, which has none of the threads that held it."""
    global _loading
    _loading = threading.RLock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_renew_lock)


def load_kernel(kernel: wp.Kernel, device: wp.DeviceLike) -> None:
    """Compile and load the module of a kernel, in one thread.

    Where a GPU has no code of it yet, that of all modules is compiled at once: one after the other takes a minute.
    """
    key = (kernel.module, str(device))
    if key in _loaded:
        return
    with _loading:
        if key not in _loaded:
            with quiet_loading(), _machine_code(), compiling(kernel.module, str(device)):
                if device_traits(str(device)).compiles_together:
                    _compile_all(kernel.module, wp.get_device(device).arch)
                wp.load_module(kernel.module, device, max_workers=0)
            _loaded.add(key)


def compile_module(module: wp.Module) -> None:
    """Compile a module for the CPU and load it, where many are: those who listen are not informed of each."""
    with _loading, quiet_loading():
        wp.load_module(module, "cpu", max_workers=0)


@contextlib.contextmanager
def _machine_code() -> Iterator[None]:
    """Let Warp load machine code, which may have been compiled ahead of time, and not PTX, which the driver compiles.

    By itself Warp takes PTX where the driver is as new as its compiler, and machine code elsewhere.
    """
    asked = wp.config.cuda_output
    wp.config.cuda_output = asked or "cubin"
    try:
        yield
    finally:
        wp.config.cuda_output = asked


def _compile_all(module: wp.Module, arch: int) -> None:
    """Compile all modules for a GPU, if this one is not compiled yet."""
    from warpqem.runtime.precompile import Compiled, binary_path, compile_modules, gpu_modules

    # GPUs newer than Warp's compiler, and formats that the caller has asked for, are left to Warp.
    own = wp.config.cuda_output != "cubin" or wp.config.cuda_arch_suffix is not None
    if own or arch not in wp.get_cuda_supported_archs() or binary_path(module, arch).exists():
        return

    def show(done: int, total: int, compiled: Compiled) -> None:
        if wp.config.log_level <= wp.LOG_INFO:
            result = "(compiled)" if compiled.error is None else f"(error: {compiled.error})"
            wp.get_logger().info(f"Kernels for sm_{arch}: {done} of {total}, module {compiled.name} {result}")

    modules = gpu_modules()
    if module not in modules:
        return
    missing = [other for other in modules if not binary_path(other, arch).exists()]
    # What does not compile is an error where it is needed: then Warp raises it.
    compile_modules(arch, missing, report=show)


def launch(
    kernel: wp.Kernel,
    dim: int | Sequence[int],
    inputs: Sequence[Any],
    outputs: Sequence[Any] = (),
    *,
    device: wp.DeviceLike,
) -> None:
    """Launch a kernel, from any thread."""
    load_kernel(kernel, device)
    if device_traits(str(device)).captures:
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=device)
        return
    call = _cpu_call(kernel, dim, [*inputs, *outputs], device)
    if call is not None:
        call()


def _cpu_call(
    kernel: wp.Kernel, dim: int | Sequence[int], arguments: Sequence[Any], device: wp.DeviceLike
) -> Callable[[], object] | None:
    """What launches a loaded kernel on a CPU; None for no threads."""
    ready = prepared_call(kernel, dim, arguments)
    if ready is not None:
        return ready
    command = wp.launch(kernel, dim=dim, inputs=arguments, device=device, record_cmd=True)
    if command is None:
        return None
    know_call(kernel, command)
    recorded: Callable[[], object] = command.launch
    return recorded


def packed_launch(kernel: wp.Kernel, dim: int, arguments: Sequence[Any]) -> PackedCall:
    """What launches a kernel on a CPU, at known addresses.

    Raises:
        TypeError: there are no threads, or arguments that only Warp can look at.
    """
    load_kernel(kernel, "cpu")
    call = packed_call(kernel, dim, arguments)
    if call is None:
        command = wp.launch(kernel, dim=dim, inputs=arguments, device="cpu", record_cmd=True)
        if command is not None:
            know_call(kernel, command)
            call = packed_call(kernel, dim, arguments)
    if call is None:
        raise TypeError(
            f"kernel {kernel.key} cannot be launched by {dim} threads, or takes arguments that only Warp can look at"
        )
    return call


class Recorder:
    """Operations on a device, recorded in the order given, and run as often as asked.

    It holds every array that they use: a captured CUDA graph knows addresses only.
    """

    def __init__(self, device: str) -> None:
        self._device = device
        self._operations: list[Callable[[], object]] = []
        # Arrays, and structs of them.
        self._held: list[Any] = []

    def launch(self, kernel: wp.Kernel, dim: int, inputs: Sequence[Any], outputs: Sequence[Any] = ()) -> None:
        """Launch a kernel. Structs must not be changed afterwards: devices differ in whether a launch sees it."""
        load_kernel(kernel, self._device)
        arguments = [*inputs, *outputs]
        if device_traits(self._device).captures:
            call = wp.launch(kernel, dim=dim, inputs=arguments, device=self._device, record_cmd=True).launch
        else:
            call = _cpu_call(kernel, dim, arguments, self._device)
        if call is not None:
            self._add(call, *arguments)

    def copy(self, target: wp.array, source: wp.array, *, source_offset: int = 0, count: int | None = None) -> None:
        """Copy ``count`` items, or all."""
        count = len(source) if count is None else count
        if device_traits(self._device).captures:
            operation: Callable[[], object] = partial(wp.copy, target, source, 0, source_offset, count)
        else:
            operation = prepared_copy(target, source, source_offset, count)
        self._add(operation, target, source)

    def zero(self, array: wp.array) -> None:
        """Fill with zeros."""
        self._add(array.zero_ if device_traits(self._device).captures else prepared_zero(array), array)

    def scan(self, target: wp.array, source: wp.array) -> None:
        """Sums of the items before each one."""
        self._add(partial(wp.utils.array_scan, source, target, inclusive=False), target, source)

    def sort_pairs(self, keys: wp.array, values: wp.array, count: int, bits: int) -> None:
        """Sort ``count`` keys, int32 or int64, that differ in the lower ``bits`` at most, and values along with them.

        Equal keys keep their order. Both arrays have room for twice as many.
        """
        self._add(partial(wp.utils.radix_sort_pairs, keys, values, count, 0, bits), keys, values)

    def branch(self, condition: wp.array, taken: Recorder) -> None:
        """Run what another recorder has recorded where ``condition`` (1,) int32 is not zero at that time."""
        body = partial(_run_all, tuple(taken._operations))
        self._add(partial(wp.capture_if, condition, body), condition, *taken._held)

    def finish(self) -> Callable[[], None]:
        """What runs the operations; on a device that captures, as one graph."""
        return self._finish(partial(_run_all, tuple(self._operations), tuple(self._held)))

    def finish_loop(self, running: wp.array) -> Callable[[], None]:
        """What runs the operations again and again as long as ``running`` (1,) int32 is not zero.

        Nothing may be allocated in between; :meth:`scan` does so. A device that captures needs ``graph_loops``.
        """
        self._held.append(running)
        return self._finish(
            partial(wp.capture_while, running, partial(_run_all, tuple(self._operations), tuple(self._held)))
        )

    def _finish(self, run: Callable[[], None]) -> Callable[[], None]:
        if not device_traits(self._device).captures:
            return run
        with _no_collection(), wp.ScopedCapture(device=self._device) as capture:
            run()
        # Most launches have the same structs.
        held = {id(argument): argument for argument in self._held}.values()
        arrays = [array for argument in held for array in _arrays_of(argument)]
        return partial(_run_graph, capture.graph, _unique(arrays))

    def _add(self, operation: Callable[[], object], *arguments: Any) -> None:
        self._operations.append(operation)
        self._held += arguments


class DirectRecorder(Recorder):
    """Runs operations as they are given, for what is done once: a graph takes a GPU longer to make than to run."""

    def launch(self, kernel: wp.Kernel, dim: int, inputs: Sequence[Any], outputs: Sequence[Any] = ()) -> None:
        """Launch a kernel."""
        launch(kernel, dim, inputs, outputs, device=self._device)

    def _add(self, operation: Callable[[], object], *arguments: Any) -> None:
        operation()


@contextlib.contextmanager
def _no_collection() -> Iterator[None]:
    """Collect no garbage within: an array that is freed while a graph is captured becomes a node of it."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


def _arrays_of(argument: Any) -> list[wp.array]:
    """The arrays in an argument of a kernel: itself, or the members of a struct."""
    if isinstance(argument, wp.array):
        return [argument]
    members = argument._cls.vars if hasattr(argument, "_cls") else ()
    return [array for name in members for array in _arrays_of(getattr(argument, name))]


def _unique(arrays: Sequence[wp.array]) -> tuple[wp.array, ...]:
    return tuple({id(array): array for array in arrays}.values())


def _run_all(operations: Sequence[Callable[[], object]], arrays: Sequence[Any] = ()) -> None:
    """Run operations; ``arrays`` are what they use, held as long as they can be run."""
    for operation in operations:
        operation()


def _run_graph(graph: wp.Graph, arrays: tuple[wp.array, ...]) -> None:
    """Launch a graph; ``arrays`` are what it uses, held as long as it can be run."""
    wp.capture_launch(graph)
