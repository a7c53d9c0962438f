"""Kernels of a CPU compiled ahead of time, several at once, and found by Warp afterwards."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import warp as wp
from typer.testing import CliRunner

from tests.support.usd_stages import cloth_stage
from warpqem.cli.main import app
from warpqem.runtime import cpu_kernels
from warpqem.runtime.compiling import compile_listener, cpu_code_path, is_compiled
from warpqem.runtime.cpu_kernels import compile_ahead, compile_needed, cpu_modules

ROOT = Path(__file__).resolve().parents[2]
# The two that compile fastest.
SMALL = [
    module for module in cpu_modules() if module.name in ("warpqem.kernels.face_check", "warpqem.kernels.attribute")
]


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty kernel cache."""
    wp.init()
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path / "cache"))
    monkeypatch.setattr(wp.config, "log_level", wp.LOG_WARNING)
    return tmp_path / "cache"


def test_modules_are_those_for_the_width_of_a_cpu():
    names = {module.name for module in cpu_modules()}
    assert {"warpqem.kernels.edge_cost.width_8", "warpqem.kernels.topology", "warpqem.kernels.refit"} <= names
    assert [name for name in names if name.endswith("width_1")] == []


@pytest.mark.parametrize("workers", [1, 2])
def test_what_is_missing_is_compiled_once(cache, workers):
    # Those that this process has loaded are not compiled by it again: another one does.
    assert [is_compiled(module, "cpu") for module in SMALL] == [False, False]
    code = f"""
import sys
import warp as wp
from warpqem.runtime.cpu_kernels import compile_ahead, cpu_modules
wp.config.log_level = wp.LOG_WARNING
wp.init()
wp.config.kernel_cache_dir = sys.argv[1]
small = [module for module in cpu_modules() if module.name in {[module.name for module in SMALL]}]
seen = []
for _ in range(2):
    made = compile_ahead(small, lambda done, total, one: seen.append((done, total)), workers={workers})
    new = sum(one.seconds > 0 for one in made)
    print(sorted(one.name for one in made), all(one.path.exists() for one in made), new)
print(seen)
"""
    done = subprocess.run([sys.executable, "-c", code, str(cache)], capture_output=True, text=True, check=False)
    names = sorted(module.name for module in SMALL)
    assert done.stdout.splitlines() == [
        f"{names} True 2",
        f"{names} True 0",
        "[(1, 2), (2, 2), (1, 2), (2, 2)]",
    ], done.stderr
    assert [is_compiled(module, "cpu") for module in SMALL] == [True, True]


def test_other_processors_code_is_not_taken_for_ones_own(cache):
    path = cpu_code_path(SMALL[0])
    path.parent.mkdir(parents=True)
    (path.parent / f"{path.name.split('.cpu')[0]}.cpu00000000.o").touch()
    assert not is_compiled(SMALL[0], "cpu")
    path.touch()
    assert is_compiled(SMALL[0], "cpu")


def test_a_module_that_does_not_compile_is_named_and_the_others_go_on(cache, monkeypatch):
    def refuse(module, *_, **__):
        if module is SMALL[0]:
            raise RuntimeError("no such instruction")
        cpu_code_path(module).parent.mkdir(parents=True)
        cpu_code_path(module).touch()

    monkeypatch.setattr(wp, "load_module", refuse)
    counts = []
    with compile_listener(lambda begins: None, lambda done, total: counts.append((done, total))):
        broken, whole = compile_ahead(SMALL, workers=1)
    assert (broken.path, str(broken.error)) == (None, "no such instruction")
    assert whole.path.exists()
    assert counts == [(0, 2), (1, 2), (2, 2)]


def test_a_process_that_ends_leaves_its_module_to_this_one(cache, monkeypatch):
    monkeypatch.setattr(sys, "executable", str(Path(sys.executable).parent / "python-that-is-not-there"))
    done = []
    monkeypatch.setattr(wp, "load_module", lambda module, *_, **__: done.append(module))
    assert len(compile_ahead(SMALL, workers=3)) == 2
    assert done == SMALL


@pytest.mark.parametrize("quality", ["fast", "best"])
def test_a_first_run_compiles_ahead_what_it_needs_and_nothing_else(quality, tmp_path):
    code = """
import sys
import warp as wp
from warpqem.runtime import cpu_kernels, launches
from warpqem.usd import SimplifyOptions, simplify_stage
wp.config.log_level = wp.LOG_WARNING
asked = []
cpu_kernels.is_compiled = lambda module, device: False
cpu_kernels.compile_ahead = asked.extend
options = SimplifyOptions(ratio=0.2, quality=sys.argv[1], device="cpu")
# A large mesh, and a small one.
for file in sys.argv[3:]:
    simplify_stage(file, sys.argv[2], options)
asked, used = ({module.name for module in modules} for modules in (asked, [module for module, _ in launches._loaded]))
print(sorted(asked - used), sorted(used - asked))
"""
    cloth_stage(tmp_path / "cloth.usda")
    files = [str(ROOT / "scenes" / "cape_wind.usdc"), str(tmp_path / "cloth.usda")]
    arguments = [quality, str(tmp_path / "out.usdc"), *files]
    done = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=False)
    assert done.stdout.split() == ["[]", "[]"], done.stderr


def test_nothing_is_compiled_ahead_where_all_is_there(monkeypatch):
    monkeypatch.setattr(cpu_kernels, "is_compiled", lambda module, device: True)
    monkeypatch.setattr(cpu_kernels, "compile_ahead", lambda modules: pytest.fail("compiled again"))
    compile_needed(refits=True, measured=True)


def test_command_fills_a_folder_that_is_warps_cache_elsewhere(tmp_path):
    code = """
import sys
from warpqem.runtime import cpu_kernels
modules = cpu_kernels.cpu_modules
cpu_kernels.cpu_modules = lambda: [m for m in modules() if m.name == "warpqem.kernels.face_check"]
from warpqem.cli.app import app
app(sys.argv[1:], prog_name="warpqem")
"""
    folder = str(tmp_path / "cache")
    done = subprocess.run(
        [sys.executable, "-c", code, "warmup", "--cache", folder], capture_output=True, text=True, check=False
    )
    assert "1 modules: 1 compiled" in done.stdout, done.stderr
    assert f"WARP_CACHE_PATH={folder}" in done.stdout
    look = """
import warp as wp
wp.config.log_level = wp.LOG_WARNING
wp.init()
from warpqem.runtime.compiling import is_compiled
from warpqem.runtime.cpu_kernels import cpu_modules
print([m.name for m in cpu_modules() if is_compiled(m, "cpu")])
"""
    environment = {**os.environ, "WARP_CACHE_PATH": folder}
    found = subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, check=True, env=environment)
    assert found.stdout.strip() == "['warpqem.kernels.face_check']"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--arch", "ampere"], "--arch: 'ampere' is no architecture"),
        (["--no-cpu", "--arch", "42"], "architecture 42: Warp"),
        (["--cache", __file__], f"--cache: {__file__} cannot be made"),
    ],
)
def test_command_refuses_what_it_cannot_do(arguments, message):
    done = CliRunner().invoke(app, ["warmup", *arguments])
    assert done.exit_code == 2
    assert message in done.stderr


def test_flags_of_kernels_name_no_kind_of_processor():
    # Clang takes -march=native everywhere; names of extensions it takes for one kind of processor.
    flags = {flag for module in cpu_modules() for flag in (module.options["cpu_compiler_flags"] or "").split()}
    assert flags <= {"-march=native", "-mllvm=-inline-threshold=9000", "-mllvm=-unroll-full-max-count=4"}
    sources = "".join(path.read_text("utf-8") for path in (ROOT / "kernels").glob("*.py"))
    assert [name for name in ("immintrin", "_mm256", "_mm512", "avx", "sse4") if name in sources.lower()] == []
