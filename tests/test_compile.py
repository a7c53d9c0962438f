"""Every kernel module compiles for GPUs, also on machines without one."""

import importlib
import pkgutil

import pytest
import warp as wp

import warpqem.kernels

ARCHITECTURES = [80, 90]
MODULES = [m.name for m in pkgutil.iter_modules(warpqem.kernels.__path__)]


def kernels_of(module) -> list[str]:
    return [name for name, value in vars(module).items() if isinstance(value, wp.Kernel)]


@pytest.mark.parametrize("name", MODULES)
def test_module_compiles_for_gpus(name, tmp_path):
    module = importlib.import_module(f"warpqem.kernels.{name}")
    if not kernels_of(module):
        pytest.skip("functions and structs only: they are compiled with the kernels that use them")
    written = wp.compile_aot_module(module, arch=ARCHITECTURES, module_dir=tmp_path, use_ptx=True)
    for architecture in ARCHITECTURES:
        ptx = next(p for p in written if f"sm{architecture}" in p.name)
        assert f".target sm_{architecture}" in ptx.read_text()
