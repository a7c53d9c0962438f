"""Every kernel module compiles for GPUs, also on machines without one."""

import importlib
import pkgutil

import pytest
import warp as wp

import warpqem.kernels

ARCHITECTURES = [80, 90]
PYTHON_MODULES = [m.name for m in pkgutil.iter_modules(warpqem.kernels.__path__)]


def modules_for_gpus(name: str) -> list[str]:
    """The Warp modules that hold the kernels of a file, those for the width of blocks on a GPU among them."""
    values = vars(importlib.import_module(f"warpqem.kernels.{name}")).values()
    kernels = [v for v in values if isinstance(v, wp.Kernel)]
    kernels += [v[1] for v in values if isinstance(v, dict) and isinstance(v.get(1), wp.Kernel)]
    return sorted({kernel.module.name for kernel in kernels})


MODULES = [module for name in PYTHON_MODULES for module in modules_for_gpus(name)]


@pytest.mark.parametrize("name", MODULES)
def test_module_compiles_for_gpus(name, tmp_path):
    written = wp.compile_aot_module(name, arch=ARCHITECTURES, module_dir=tmp_path, use_ptx=True)
    for architecture in ARCHITECTURES:
        ptx = next(p for p in written if f"sm{architecture}" in p.name)
        assert f".target sm_{architecture}" in ptx.read_text()


@pytest.mark.parametrize("width", [1, 8])
def test_width_has_a_module_of_its_own(width):
    from warpqem.kernels.edge_cost import compute_all_costs, update_moved_costs

    assert compute_all_costs[width].module is update_moved_costs[width].module
    assert {len(kernel.overloads) for kernel in compute_all_costs[width].module.kernels.values()} == {1}
