"""``registers``: what each kernel takes of a GPU's thread, by ``ptxas``; no kernel may keep registers in memory.

``ptxas`` comes with a CUDA toolkit or by ``pip install nvidia-cuda-nvcc``; it has to know the version of the PTX that
Warp's compiler writes.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sysconfig
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import warp as wp

from benchmarks.machine import describe_host
from benchmarks.report import Column, Report, Row, Table
from benchmarks.settings import Settings
from warpqem.runtime.precompile import gpu_modules

__all__ = ["find_ptxas", "kernel_registers", "run"]

ARCHITECTURE = 90
# Warp's names of kernels end in a hash and this.
_KERNEL = re.compile(r"Compiling entry function '(\w+?)_[0-9a-f]+_cuda_kernel_forward'")
_SPILLED = re.compile(r"(\d+) bytes spill stores")
_USED = re.compile(r"Used (\d+) registers")


def find_ptxas() -> Path | None:
    """The program: of the package ``nvidia-cuda-nvcc``, else on PATH; None where there is none."""
    packages = Path(sysconfig.get_paths()["purelib"])
    found = sorted(packages.glob("nvidia/cu*/bin/ptxas"))
    on_path = shutil.which("ptxas")
    return found[-1] if found else Path(on_path) if on_path else None


def kernel_registers(module: wp.Module, ptxas: Path) -> list[Row]:
    """Registers of each kernel of a module, and bytes of registers that it keeps in memory.

    Raises:
        SystemExit: ``ptxas`` does not take what Warp's compiler writes.
    """
    with tempfile.TemporaryDirectory() as folder:
        written = wp.compile_aot_module(module, arch=[ARCHITECTURE], module_dir=folder, use_ptx=True)
        source = next(path for path in map(Path, written) if path.suffix == ".ptx")
        # Warp ends the text with a zero.
        source.write_bytes(source.read_bytes().rstrip(b"\0"))
        command = [str(ptxas), "-v", f"-arch=sm_{ARCHITECTURE}", str(source), "-o", str(Path(folder) / "code")]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{ptxas}: {done.stderr.strip().splitlines()[0]}; a newer one: pip install nvidia-cuda-nvcc")
    return list(_rows(module.name, done.stderr))


def _rows(module_name: str, text: str) -> Iterator[Row]:
    name, spilled = "", 0
    for line in text.splitlines():
        if found := _KERNEL.search(line):
            name = found[1]
        elif found := _SPILLED.search(line):
            spilled = int(found[1])
        elif name and (found := _USED.search(line)):
            yield {"module": module_name, "kernel": name, "registers": int(found[1]), "spilled": spilled}
            name = ""


def run(settings: Settings) -> Report:
    """All kernels that a GPU runs, those with most registers first."""
    ptxas = find_ptxas()
    if ptxas is None:
        raise FileNotFoundError("there is no ptxas: pip install nvidia-cuda-nvcc")
    modules = gpu_modules()[: 1 if settings.quick else None]
    with ThreadPoolExecutor() as pool:
        rows = [row for found in pool.map(lambda module: kernel_registers(module, ptxas), modules) for row in found]
    rows.sort(key=lambda row: (-int(row["registers"]), str(row["kernel"])))
    columns = (
        Column("kernel", "kernel"),
        Column("module", "module"),
        Column("registers", "registers", "d"),
        Column("spilled", "bytes spilled", "d"),
    )
    spilling = [str(row["kernel"]) for row in rows if row["spilled"]]
    report = Report("registers", f"Registers on sm_{ARCHITECTURE}", describe_host([]))
    report.tables = [Table("Kernels", columns, rows)]
    report.notes = [f"{len(rows)} kernels, {len(spilling)} keep registers in memory"]
    report.failed = [f"{name} keeps registers in memory" for name in spilling]
    return report
