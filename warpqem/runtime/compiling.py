"""When kernels are compiled: whoever listens learns it before it begins, as the first run on a device takes long."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import warp as wp

__all__ = ["compile_listener", "compiling", "compiling_ahead", "cpu_code_path", "is_compiled"]

# Suffixes of compiled code in Warp's kernel cache, of a GPU.
GPU_BINARIES = (".cubin", ".ptx")

# Called with True before a module is compiled, and with False when it is loaded; from the thread that does it.
Listener = Callable[[bool], None]
# Called with the modules that are done, and how many there are, where many are compiled at once.
Counter = Callable[[int, int], None]
_listeners: list[Listener] = []
_counters: list[Counter] = []


@contextlib.contextmanager
def compile_listener(listen: Listener, counter: Counter | None = None) -> Iterator[None]:
    """Let functions know within when kernels begin to be compiled, when they are there, and how many of them are."""
    _listeners.append(listen)
    counters = [] if counter is None else [counter]
    _counters.extend(counters)
    try:
        yield
    finally:
        _listeners.remove(listen)
        for added in counters:
            _counters.remove(added)


@contextlib.contextmanager
def compiling_ahead() -> Iterator[Counter]:
    """Compile many modules within, and inform those who listen; gives what to call with how many are done, of all."""
    told, counters = list(_listeners), list(_counters)

    def count(done: int, total: int) -> None:
        for counter in counters:
            counter(done, total)

    for listen in told:
        listen(True)
    try:
        yield count
    finally:
        for listen in told:
            listen(False)


@contextlib.contextmanager
def compiling(module: wp.Module, device: str) -> Iterator[None]:
    """Load a module within, and inform those who listen if it is not compiled yet."""
    told = list(_listeners) if _listeners and not is_compiled(module, device) else []
    for listen in told:
        listen(True)
    try:
        yield
    finally:
        for listen in told:
            listen(False)


def is_compiled(module: wp.Module, device: str) -> bool:
    """Whether Warp's kernel cache has code of a module for a kind of device."""
    # Whoever listens may do so before Warp is loaded.
    import warp as wp

    used = wp.get_device(device)
    if not used.is_cuda:
        return cpu_code_path(module).is_file()
    folder = Path(str(wp.config.kernel_cache_dir)) / module.get_module_identifier()
    return folder.is_dir() and any(file.suffix in GPU_BINARIES for file in folder.iterdir())


def cpu_code_path(module: wp.Module) -> Path:
    """Where Warp looks for a module's code for this CPU: its name says for which processors it is."""
    import warp as wp

    # Code for a CPU is that of blocks of one thread.
    folder = Path(str(wp.config.kernel_cache_dir)) / module.get_module_identifier(1)
    return folder / module._get_compile_output_name(wp.get_device("cpu"), block_dim=1)
