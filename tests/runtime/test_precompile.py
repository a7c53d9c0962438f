"""Kernels compiled for GPUs that this machine does not have, and found by Warp where there is one."""

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
import warp as wp
from warp._src.context import Device

from warpqem.errors import OptionError
from warpqem.runtime import launches, precompile
from warpqem.runtime.launches import _compile_all, _machine_code
from warpqem.runtime.precompile import binary_path, compile_modules, gpu_modules

ROOT = Path(__file__).resolve().parents[2]
ARCH = 90
# The two that compile fastest.
SMALL = [module for module in gpu_modules() if module.name in ("warpqem.kernels.transfer", "warpqem.kernels.motion")]


@wp.kernel
def use_something_else(a: wp.array[wp.float32]):
    a[wp.tid()] = 1.0


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty kernel cache."""
    wp.init()
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path / "cache"))
    monkeypatch.setattr(wp.config, "log_level", wp.LOG_WARNING)
    return tmp_path / "cache"


def gpu(driver: tuple[int, int], arch: int = ARCH) -> Device:
    """What Warp asks of a GPU before it loads a module."""
    device = object.__new__(Device)
    device.ordinal, device.is_cubin_supported, device.arch = 0, True, arch
    device.alias = "cuda:0"
    device.runtime = SimpleNamespace(driver_version=driver, toolkit_version=wp.get_cuda_toolkit_version())
    return device


def is_found(module: wp.Module, device: Device) -> bool:
    """Whether Warp takes a module for a device from the cache: it says so before it would compile."""
    name, arch = module._get_compile_output_name(device), module._get_compile_arch(device)
    folder = Path(wp.config.kernel_cache_dir) / module.get_module_identifier()
    return all((folder / file).exists() for file in (name, module._get_meta_name())) and not module._compile(
        device, folder, name, arch
    )


def test_modules_are_all_that_hold_kernels_and_none_for_the_width_of_a_cpu():
    names = [module.name for module in gpu_modules()]
    assert len(names) == len(set(names)) > 25
    assert {"warpqem.kernels.edge_cost.width_1", "warpqem.kernels.motion", "warpqem.kernels.refit"} <= set(names)
    assert [name for name in names if name.endswith("width_8")] == []


@pytest.mark.parametrize("driver", [(12, 4), (13, 0), (13, 4), (14, 1)])
def test_warp_finds_what_was_compiled_whatever_the_driver(driver, cache):
    compile_modules(ARCH, SMALL)
    with _machine_code():
        assert [is_found(module, gpu(driver)) for module in SMALL] == [True, True]
        assert not is_found(SMALL[0], gpu(driver, 80))


def test_a_new_driver_would_have_warp_look_for_something_else(cache):
    compile_modules(ARCH, SMALL[:1])
    assert not is_found(SMALL[0], gpu((99, 0)))


def test_names_do_not_depend_on_what_else_is_imported():
    code = """
import warp as wp
from warpqem import simplify
from warpqem.decimation.pass_steps import PassSteps
wp.config.log_level = wp.LOG_WARNING
for module in wp._src.context.user_modules.values():
    if module.name.startswith("warpqem.kernels.") and module.kernels:
        print(module.get_module_identifier())
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    few = set(done.stdout.split())
    every = {module.get_module_identifier() for module in gpu_modules()}
    assert len(few & every) > 10
    assert {name for name in few - every if "width_8" not in name} == set()


def test_what_is_there_is_not_compiled_again(cache):
    assert all(made.seconds > 0 for made in compile_modules(ARCH, SMALL))
    before = {made.path: made.path.stat().st_mtime_ns for made in compile_modules(ARCH, SMALL)}
    assert all(made.seconds == 0 for made in compile_modules(ARCH, SMALL))
    assert before == {path: path.stat().st_mtime_ns for path in before}


def test_progress_names_each_module_once(cache):
    seen = []
    compile_modules(ARCH, SMALL, report=lambda done, total, made: seen.append((done, total, made.name)))
    assert [entry[:2] for entry in seen] == [(1, 2), (2, 2)]
    assert {entry[2] for entry in seen} == {module.name for module in SMALL}


def test_a_module_that_does_not_compile_is_named_and_the_others_go_on(cache, monkeypatch):
    compile_aot = wp.compile_aot_module

    def refuse(module, **options):
        if module is SMALL[0]:
            raise RuntimeError("no such instruction")
        return compile_aot(module, **options)

    monkeypatch.setattr(wp, "compile_aot_module", refuse)
    broken, whole = sorted(compile_modules(ARCH, SMALL), key=lambda made: made.name != SMALL[0].name)
    assert (broken.path, str(broken.error)) == (None, "no such instruction")
    assert whole.path.exists()


def test_an_architecture_that_warp_does_not_know_is_refused():
    with pytest.raises(OptionError, match=r"architecture 42: Warp .* compiles for .*90"):
        compile_modules(42)


def run(*arguments: str, cache: str = "") -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "WARP_CACHE_PATH": cache}
    environment = {name: value for name, value in environment.items() if value}
    return subprocess.run(arguments, capture_output=True, text=True, check=False, env=environment)


def test_command_fills_a_folder_that_is_warps_cache_elsewhere(tmp_path):
    code = """
import sys
from warpqem.runtime import precompile
modules = precompile.gpu_modules
precompile.gpu_modules = lambda: [m for m in modules() if m.name == "warpqem.kernels.transfer"]
sys.exit(precompile.main(sys.argv[1:]))
"""
    folder = str(tmp_path / "cache")
    done = run(sys.executable, "-c", code, "--arch", "sm_90", "--arch", "80", "--out", folder)
    assert done.returncode == 0, done.stderr
    assert "sm_80: 1 modules, 0.0 MB" in done.stdout
    assert f"WARP_CACHE_PATH={folder}" in done.stdout
    look = f"""
import warp as wp
wp.config.log_level = wp.LOG_WARNING
from warpqem.runtime.precompile import binary_path, gpu_modules
module = next(m for m in gpu_modules() if m.name == "warpqem.kernels.transfer")
print([binary_path(module, arch).exists() for arch in (80, {ARCH}, 75)])
"""
    assert run(sys.executable, "-c", look, cache=folder).stdout.strip() == "[True, True, False]"


@pytest.mark.skipif(wp.is_cuda_available(), reason="this machine has a GPU")
def test_command_without_a_gpu_asks_for_an_architecture(capsys):
    with pytest.raises(SystemExit) as stop:
        precompile.main([])
    assert stop.value.code == 2
    assert "name an architecture, such as --arch 90" in capsys.readouterr().err


@pytest.mark.parametrize("wrong", ["ampere", "42"])
def test_command_refuses_what_is_no_architecture(wrong, capsys):
    with pytest.raises(SystemExit) as stop:
        precompile.main(["--arch", wrong])
    assert stop.value.code == 2
    assert wrong in capsys.readouterr().err


def test_first_launch_on_a_gpu_compiles_all_that_is_missing(cache, monkeypatch):
    monkeypatch.setattr(precompile, "gpu_modules", lambda: SMALL)
    compile_modules(ARCH, SMALL[:1])
    first = binary_path(SMALL[0], ARCH).stat().st_mtime_ns
    with _machine_code():
        _compile_all(SMALL[1], ARCH)
    assert [binary_path(module, ARCH).exists() for module in SMALL] == [True, True]
    assert binary_path(SMALL[0], ARCH).stat().st_mtime_ns == first


def test_progress_of_the_first_launch_goes_where_warps_messages_go(cache, monkeypatch):
    monkeypatch.setattr(precompile, "gpu_modules", lambda: SMALL)
    monkeypatch.setattr(wp.config, "log_level", wp.LOG_INFO)
    lines = []
    monkeypatch.setattr(wp, "get_logger", lambda: SimpleNamespace(info=lines.append))
    with _machine_code():
        _compile_all(SMALL[0], ARCH)
    assert [line.startswith(f"Kernels for sm_90: {n} of 2, module warpqem.kernels.") for n, line in enumerate(lines, 1)]
    assert [line.endswith("(compiled)") for line in lines] == [True, True]


@pytest.mark.parametrize("case", ["compiled", "ptx", "unknown", "not ours"])
def test_first_launch_leaves_the_rest_to_warp(case, cache, monkeypatch):
    compile_modules(ARCH, SMALL[:1])
    if case == "ptx":
        monkeypatch.setattr(wp.config, "cuda_output", "ptx")
    module = {"compiled": SMALL[0], "not ours": use_something_else.module}.get(case, SMALL[1])
    asked = []
    monkeypatch.setattr(precompile, "compile_modules", lambda *arguments, **_: asked.append(arguments))
    with _machine_code():
        _compile_all(module, 42 if case == "unknown" else ARCH)
    assert asked == []


@pytest.mark.parametrize("asked", [None, "ptx", "cubin"])
def test_format_asked_for_by_the_caller_stays(asked, monkeypatch):
    monkeypatch.setattr(wp.config, "cuda_output", asked)
    with _machine_code():
        assert wp.config.cuda_output == (asked or "cubin")
    assert wp.config.cuda_output == asked


def test_kernels_of_a_gpu_are_compiled_before_they_are_loaded(monkeypatch):
    done = []
    monkeypatch.setattr(launches, "_loaded", set())
    monkeypatch.setattr(launches, "device_traits", lambda device: SimpleNamespace(compiles_together=True))
    monkeypatch.setattr(launches, "_compile_all", lambda module, arch: done.append("compile"))
    monkeypatch.setattr(wp, "load_module", lambda *_, **__: done.append(f"load {wp.config.cuda_output}"))
    monkeypatch.setattr(wp.config, "cuda_output", None)
    monkeypatch.setattr(wp, "get_device", lambda device: SimpleNamespace(arch=ARCH))
    for _ in range(2):
        launches.load_kernel(use_something_else, "cuda:0")
    assert done == ["compile", "load cubin"]
