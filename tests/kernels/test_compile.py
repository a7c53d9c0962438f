"""Every kernel module compiles for GPUs, also on machines without one."""

import pytest
import warp as wp

from warpqem.runtime.precompile import gpu_modules

ARCHITECTURES = [80, 90]
MODULES = [module.name for module in gpu_modules()]


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
