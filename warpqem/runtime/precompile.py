"""Kernels compiled ahead of time: GPU code made on a machine without a GPU, for an image or another machine.

python -m warpqem.runtime.precompile --arch 90 --out FOLDER

FOLDER is a kernel cache of Warp: where ``WARP_CACHE_PATH`` names it, a GPU of that architecture compiles nothing. It
belongs to one version of Warp and of warpqem: a kernel that has changed has another name there, and is compiled anew.
"""

from __future__ import annotations

import argparse
import importlib
import os
import pkgutil
import sys
import time
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

import warp as wp

import warpqem.kernels
from warpqem.errors import OptionError, WarpqemError
from warpqem.runtime.device import GPU

__all__ = ["Compiled", "binary_path", "compile_modules", "gpu_modules", "kernel_modules", "main", "read_architecture"]


@dataclass(frozen=True)
class Compiled:
    """What came of one module.

    Attributes:
        name: of the Warp module.
        path: its binary; None if it does not compile.
        seconds: that it took; 0 where the binary was there.
        error: why it does not compile.
    """

    name: str
    path: Path | None
    seconds: float
    error: Exception | None = None


Report = Callable[[int, int, Compiled], None]


def gpu_modules() -> list[wp.Module]:
    """The Warp modules with the kernels that a GPU runs, by name."""
    return kernel_modules(GPU.block_width)


def kernel_modules(width: int, files: Collection[str] | None = None) -> list[wp.Module]:
    """The Warp modules with the kernels of a device that has blocks of so many frames, by name.

    ``files`` are the files of kernels to look at; None for all.
    """
    modules = set()
    every = (file.name for file in pkgutil.iter_modules(warpqem.kernels.__path__))
    for file in every if files is None else files:
        for value in vars(importlib.import_module(f"{warpqem.kernels.__name__}.{file}")).values():
            # Kernels of frames in blocks come in one form for each width.
            kernel = value.get(width) if isinstance(value, dict) else value
            if isinstance(kernel, wp.Kernel):
                modules.add(kernel.module)
    return sorted(modules, key=lambda module: module.name)


def binary_path(module: wp.Module, arch: int) -> Path:
    """Where Warp looks for a module's code for GPUs of an architecture, such as 90 for ``sm_90``."""
    wp.init()
    name = module.get_module_identifier()
    return Path(str(wp.config.kernel_cache_dir)) / name / f"{name}.sm{arch}.cubin"


def compile_modules(
    arch: int, modules: Sequence[wp.Module] | None = None, report: Report | None = None, workers: int | None = None
) -> list[Compiled]:
    """Compile modules into Warp's kernel cache, several at once; those that are there are left.

    Args:
        arch: architecture of the GPU, such as 90 for ``sm_90``.
        modules: None for all of :func:`gpu_modules`.
        report: gets how many are done, of how many, and the one that is, as they are done.
        workers: threads; None for one for each core.

    Raises:
        OptionError: Warp does not compile for this architecture.
    """
    if arch not in wp.get_cuda_supported_archs():
        known = ", ".join(map(str, wp.get_cuda_supported_archs())) or "none"
        raise OptionError(f"architecture {arch}: Warp {wp.__version__} compiles for {known}")
    modules = gpu_modules() if modules is None else list(modules)
    # The longest first, so that the last one does not keep one core busy for long.
    modules = sorted(modules, key=lambda module: -len(module.kernels))
    results = []
    with ThreadPoolExecutor(max_workers=workers or _core_count()) as pool:
        for future in as_completed([pool.submit(_compile, module, arch) for module in modules]):
            results.append(future.result())
            if report is not None:
                report(len(results), len(modules), results[-1])
    return sorted(results, key=lambda result: result.name)


def _compile(module: wp.Module, arch: int) -> Compiled:
    start = time.perf_counter()
    path = binary_path(module, arch)
    there = path.exists()
    try:
        wp.compile_aot_module(module, arch=[arch], use_ptx=False)
    except Exception as error:  # of any kind: Warp's, the compiler's, or that of a full disk
        return Compiled(module.name, None, time.perf_counter() - start, error)
    return Compiled(module.name, path, 0.0 if there else time.perf_counter() - start)


def _core_count() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def read_architecture(text: str) -> int:
    """The number of an architecture from its name, such as ``sm_90``.

    Raises:
        ValueError: it is no architecture.
    """
    try:
        return int(text.lower().removeprefix("sm_").removeprefix("sm"))
    except ValueError:
        raise ValueError(f"{text!r} is no architecture: expected a number such as 90") from None


def _architecture(text: str) -> int:
    try:
        return read_architecture(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _print(done: int, total: int, module: Compiled) -> None:
    what = (
        f"failed: {module.error}" if module.path is None else f"{module.seconds:.1f} s" if module.seconds else "there"
    )
    print(f"{done:3} of {total}  {module.name}: {what}", flush=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """Compile for the architectures asked for; the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m warpqem.runtime.precompile",
        description="Compile all GPU kernels of warpqem ahead of time. This machine needs no GPU.",
    )
    parser.add_argument(
        "--arch",
        type=_architecture,
        action="append",
        help="architecture: 80 (A100), 86, 89 (L40, RTX 40), 90 (H100, H200), 100 (B200), 120 (RTX 50); more than one "
        "may be given. By default those of this machine's GPUs",
    )
    parser.add_argument(
        "--out",
        type=Path,
        help="folder of the kernel cache, for WARP_CACHE_PATH; by default the cache that Warp uses here",
    )
    given = parser.parse_args(arguments)
    if given.out is not None:
        wp.config.kernel_cache_dir = str(given.out)
    wp.config.log_level = wp.LOG_WARNING
    wp.init()
    architectures = sorted(set(given.arch or [device.arch for device in wp.get_cuda_devices()]))
    if not architectures:
        parser.error("this machine has no GPU: name an architecture, such as --arch 90")
    start = time.process_time()
    failed = False
    for arch in architectures:
        try:
            made = compile_modules(arch, report=_print)
        except WarpqemError as error:
            parser.error(str(error))
        size = sum(module.path.stat().st_size for module in made if module.path is not None)
        failed |= any(module.path is None for module in made)
        print(f"sm_{arch}: {len(made)} modules, {size / 1e6:.1f} MB")
    print(f"{time.process_time() - start:.0f} s of CPU time; in {wp.config.kernel_cache_dir}")
    if given.out is not None:
        print(f"to use them: WARP_CACHE_PATH={given.out}")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
