"""Every kernel module compiles for GPUs, also on machines without one."""

from pathlib import Path

import pytest
import warp as wp

from warpqem.runtime.precompile import gpu_modules

MODULES = [module.name for module in gpu_modules()]


def compiled(name: str, architectures: list[int], folder: Path) -> None:
    written = wp.compile_aot_module(name, arch=architectures, module_dir=folder, use_ptx=True)
    for architecture in architectures:
        ptx = next(p for p in written if f"sm{architecture}" in p.name)
        assert f".target sm_{architecture}" in ptx.read_text()


@pytest.mark.parametrize("name", MODULES)
def test_module_compiles_for_gpus(name, tmp_path):
    compiled(name, [90], tmp_path)


# The compiler's front end takes the time, and the same for each; what the code says of an architecture, it says here.
def test_modules_compile_for_the_architectures_of_some_years(tmp_path):
    compiled("warpqem.kernels.motion", [75, 80, 86, 90, 100], tmp_path)


@pytest.mark.parametrize("width", [1, 8])
def test_width_has_a_module_of_its_own(width):
    from warpqem.kernels.edge_cost import compute_all_costs, update_moved_costs

    assert compute_all_costs[width].module is update_moved_costs[width].module
    assert {len(kernel.overloads) for kernel in compute_all_costs[width].module.kernels.values()} == {1}
