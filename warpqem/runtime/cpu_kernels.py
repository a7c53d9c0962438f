"""Kernels of a CPU compiled before they are needed, on all cores: by themselves they come one after the other.

Each core but one gets a process. Threads would not do: LLVM holds the flags of a module for the whole process, so that
two that were compiled at once could be made with each other's flags, and give other bits.

``python -m warpqem.runtime.cpu_kernels FOLDER`` is such a process: it compiles the modules that its input names, line
by line, into that kernel cache, and answers each.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain
from pathlib import Path

import warp as wp

from warpqem.runtime.compiling import compiling_ahead, cpu_code_path, is_compiled
from warpqem.runtime.cpu_threads import thread_count
from warpqem.runtime.device import CPU
from warpqem.runtime.launches import compile_module
from warpqem.runtime.precompile import Compiled, kernel_modules

__all__ = ["compile_ahead", "compile_needed", "cpu_modules"]

# Modules that every simplification of a file takes, those that take longest to compile first, so that the last one
# does not keep one core busy for long.
ALWAYS = (
    "placement.width_8",
    "legality.width_8",
    "edge_cost.width_8",
    "collapse.width_8",
    "topology",
    "lanes.width_8",
    "anchor.width_8",
    "independent_set",
    "plane_quadrics.width_8",
    "pass_control",
    "collapse",
    "cluster_rows",
    "anchor",
    "components",
    "placement",
    "collapse_order",
    "initial_members",
    "clean_topology",
    "attribute",
    "faces_left",
    "constrained_edges",
    "face_check",
    "attribute.width_8",
    "initial_members.width_8",
    "native_program",
)
# What more the qualities take, measuring, and values on the surface.
FAST = ("edge_cost",)
BEST = (
    "surface_pairs",
    "surface_limits",
    "memoryless_quadric.width_8",
    "refit",
    "element_solve",
    "material_frame",
    "distance_points.width_8",
)
MEASURED = ("surface_distance", "largest_distance", "distance_screen.width_8")
VALUES = ("attribute_fit", "transfer", "surface_walk", "turned_triangles")
# A CPU has other kernels for what these do, or the host does it.
GPU_ONLY = ("shared_collapse", "softness", "large_faces", "face_lists")
PREFIX = "warpqem.kernels."
# Seconds between two looks at what other processes have done.
WAIT = 0.05

Report = Callable[[int, int, Compiled], None]


def cpu_modules() -> list[wp.Module]:
    """The Warp modules with the kernels that a CPU runs, by name."""
    return [module for module in kernel_modules(CPU.block_width) if _file_of(module.name) not in GPU_ONLY]


def _file_of(name: str) -> str:
    """The file in the folder of kernels that a Warp module is from."""
    return name.removeprefix(PREFIX).split(".")[0]


def _modules_named(names: Iterable[str]) -> list[wp.Module]:
    """Modules by their names behind the prefix; no other file of kernels is loaded."""
    names = list(names)
    found = {module.name: module for module in kernel_modules(CPU.block_width, {_file_of(name) for name in names})}
    return [found[PREFIX + name] for name in names]


def compile_needed(refits: bool, measured: bool) -> None:
    """Compile what simplifying a file without a skin takes on a CPU, on all cores, unless that has been done.

    Args:
        refits: whether its quality is "best".
        measured: whether the result is measured.
    """
    groups = [ALWAYS, BEST if refits else FAST, *([MEASURED] if measured else [])]
    # Whether they are there takes longer to learn than to look at one of each, all of which are needed.
    if not all(is_compiled(module, "cpu") for module in _modules_named(group[0] for group in groups)):
        compile_ahead(_modules_named([*chain(*groups), *VALUES]))


def compile_ahead(
    modules: Sequence[wp.Module], report: Report | None = None, workers: int | None = None
) -> list[Compiled]:
    """Compile modules for the CPU into Warp's kernel cache, several at once; those that are there are left.

    Args:
        modules: the longest first.
        report: gets how many are done, of how many, and the one that is, in the caller's thread.
        workers: cores; None for all.
    """
    missing = [module for module in modules if not is_compiled(module, "cpu")]
    results = [Compiled(module.name, cpu_code_path(module), 0.0) for module in modules if module not in missing]
    if report is not None:
        for number, result in enumerate(results, 1):
            report(number, len(modules), result)
    if not missing:
        return results
    with compiling_ahead() as count:
        count(0, len(missing))
        cores = thread_count("cpu") if workers is None else workers
        for number, made in enumerate(_compiled(missing, min(cores, len(missing))), 1):
            results.append(made)
            count(number, len(missing))
            if report is not None:
                report(len(results), len(modules), made)
    return results


def _compiled(modules: Sequence[wp.Module], cores: int) -> Iterator[Compiled]:
    """Compile modules in this process and in others; gives each when it is done."""
    left, done = deque(modules), deque[Compiled]()
    # In an application, what runs may be no Python that takes a module's name.
    others = cores - 1 if Path(sys.executable or "").name.startswith("python") else 0
    helpers = [threading.Thread(target=_ask, args=(left, done), daemon=True) for _ in range(others)]
    for helper in helpers:
        helper.start()
    try:
        # Where a process has ended, what it was asked for is left.
        while left or done or any(helper.is_alive() for helper in helpers):
            if left:
                with contextlib.suppress(IndexError):
                    done.append(_compile(left.popleft()))
            elif not done:
                time.sleep(WAIT)
            while done:
                yield done.popleft()
    finally:
        # Where the caller has had enough, each process ends after the module that it is at.
        left.clear()


def _compile(module: wp.Module) -> Compiled:
    start = time.perf_counter()
    try:
        compile_module(module)
    except Exception as error:  # of any kind: Warp's, the compiler's, or that of a full disk
        return Compiled(module.name, None, time.perf_counter() - start, error)
    return Compiled(module.name, cpu_code_path(module), time.perf_counter() - start)


def _ask(left: deque[wp.Module], done: deque[Compiled]) -> None:
    """Have another process compile modules, one after the other; it ends when its input does."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    try:
        process = subprocess.Popen(
            [sys.executable, "-m", "warpqem.runtime.cpu_kernels", str(wp.config.kernel_cache_dir)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env=environment,
        )
    except OSError:  # no memory, or no more processes
        return
    assert process.stdin is not None
    assert process.stdout is not None
    with process, process.stdin, process.stdout:
        while True:
            try:
                module = left.popleft()
            except IndexError:
                return
            answer = ""
            try:
                print(module.name, file=process.stdin, flush=True)
                answer = process.stdout.readline()
            except OSError:  # it has ended
                pass
            if not answer:
                # This process compiles it where it is needed.
                left.append(module)
                return
            seconds, error = json.loads(answer)
            path = cpu_code_path(module) if error is None else None
            done.append(Compiled(module.name, path, seconds, None if error is None else RuntimeError(error)))


def _serve(cache: str) -> None:
    """Compile what the input names, into a kernel cache."""
    wp.config.log_level = wp.LOG_WARNING
    wp.init()
    # While it starts, Warp puts its version behind the name of a folder.
    wp.config.kernel_cache_dir = cache
    every = {module.name: module for module in cpu_modules()}
    for line in sys.stdin:
        made = _compile(every[line.strip()])
        print(json.dumps([made.seconds, None if made.error is None else str(made.error)]), flush=True)


if __name__ == "__main__":
    _serve(sys.argv[1])
