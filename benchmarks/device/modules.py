"""All kernels compiled, or found compiled, and loaded."""

from __future__ import annotations

import time

import warp as wp

from benchmarks.device.findings import Findings
from warpqem.runtime.launches import load_kernel
from warpqem.runtime.precompile import Compiled, binary_path, compile_modules, gpu_modules

__all__ = ["run"]

# On a CPU loading is a matter of this project's tests: a few modules show that it works.
FEW = 2


def run(found: Findings) -> None:
    """Compile what is not there, all at once; then load all."""
    device = wp.get_device(found.device)
    modules = gpu_modules()
    if device.is_cuda:
        _compile(found, modules, device.arch)
    else:
        found.left_out("compiled for a GPU", "this is a CPU")
        modules = modules[:FEW]
    start = time.perf_counter()
    for module in modules:
        load_kernel(next(iter(module.kernels.values())), found.device)
    wp.synchronize_device(device)
    found.measured(f"{len(modules)} modules loaded", f"{time.perf_counter() - start:.2f} s")


def _compile(found: Findings, modules: list[wp.Module], arch: int) -> None:
    missing = [module for module in modules if not binary_path(module, arch).exists()]

    def report(done: int, total: int, compiled: Compiled) -> None:
        print(f"  {done} of {total}: {compiled.name}, {compiled.seconds:.1f} s", flush=True)

    start, cpu = time.perf_counter(), time.process_time()
    made = compile_modules(arch, missing, report)
    failed = [f"{one.name}: {one.error}" for one in made if one.error is not None]
    took = f", {time.perf_counter() - start:.1f} s, {time.process_time() - cpu:.0f} s of CPU time" if missing else ""
    text = "; ".join(failed) or f"{len(modules) - len(missing)} there, {len(missing)} compiled{took}"
    found.expect(f"kernels for sm_{arch}", text, "all compile", not failed)
