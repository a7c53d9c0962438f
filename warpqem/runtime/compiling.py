"""When kernels are compiled: whoever listens learns it before it begins, as the first run on a device takes long."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import warp as wp

__all__ = ["compile_listener", "compiling"]

# Suffixes of compiled code in Warp's kernel cache, of a CPU and of a GPU.
BINARIES = {False: (".o",), True: (".cubin", ".ptx")}

# Called with True before a module is compiled, and with False when it is loaded; from the thread that does it.
Listener = Callable[[bool], None]
_listeners: list[Listener] = []


@contextlib.contextmanager
def compile_listener(listen: Listener) -> Iterator[None]:
    """Let a function know within when kernels begin to be compiled, and when they are there."""
    _listeners.append(listen)
    try:
        yield
    finally:
        _listeners.remove(listen)


@contextlib.contextmanager
def compiling(module: wp.Module, device: str) -> Iterator[None]:
    """Load a module within, and inform those who listen if it is not compiled yet."""
    told = list(_listeners) if _listeners and not _is_compiled(module, device) else []
    for listen in told:
        listen(True)
    try:
        yield
    finally:
        for listen in told:
            listen(False)


def _is_compiled(module: wp.Module, device: str) -> bool:
    """Whether Warp's kernel cache has code of a module for a kind of device."""
    # Whoever listens may do so before Warp is loaded.
    import warp as wp

    is_gpu = bool(wp.get_device(device).is_cuda)
    # Code for a CPU is that of blocks of one thread; None stands for the blocks of a GPU.
    folder = Path(str(wp.config.kernel_cache_dir)) / module.get_module_identifier(None if is_gpu else 1)
    suffixes = BINARIES[is_gpu]
    return folder.is_dir() and any(file.suffix in suffixes for file in folder.iterdir())
