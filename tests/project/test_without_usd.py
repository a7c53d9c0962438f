"""The core without USD, and what is said where USD is missing, broken or too old."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from warpqem.requirements import requirements_beside_usd
from warpqem.usd.checks.library import MODULES, OLDEST_USD

ROOT = Path(__file__).resolve().parents[2]
SCENE = str(ROOT / "scenes" / "cape_wind.usdc")

MISSING = "USD is not installed for"


def python(*arguments: str, first: Path) -> subprocess.CompletedProcess[str]:
    """Run Python with a folder that is looked at before all others for modules."""
    paths = [str(first), str(ROOT), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))}
    command = [sys.executable, *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, env=environment, cwd=first)


@pytest.fixture
def no_usd(tmp_path):
    """A folder that hides USD from every Python process that is started with it."""
    (tmp_path / "sitecustomize.py").write_text("import sys\nsys.modules['pxr'] = None\n")
    return tmp_path


def make_usd(folder: Path, sources: dict[str, str]) -> None:
    """A `pxr` with every module that is needed; the others are empty."""
    (folder / "pxr").mkdir()
    for name in ("__init__", *MODULES):
        (folder / "pxr" / f"{name}.py").write_text(sources.get(name, ""))


def test_core_works_on_arrays(no_usd):
    code = """
import numpy as np, trimesh, warpqem
mesh = trimesh.creation.icosphere(subdivisions=3)
faces = len(mesh.faces)
assert len(warpqem.simplify(mesh, ratio=0.5, device="cpu").faces) <= faces // 2
frames = np.stack([mesh.vertices, 1.1 * mesh.vertices])
assert len(warpqem.simplify(frames, mesh.faces, ratio=0.5, device="cpu").faces) <= faces // 2
levels = warpqem.simplify_levels(frames, mesh.faces, ratios=(0.5, 0.25), device="cpu")
assert [len(level.faces) <= share * faces for level, share in zip(levels, (0.5, 0.25))] == [True, True]
progressive = warpqem.build_progressive(frames, mesh.faces, device="cpu")
from warpqem.progressive import load, save
save(progressive, "sphere.wpqm")
assert np.array_equal(load("sphere.wpqm").level(20).points, progressive.level(20).points)
from warpqem.measure import compare
assert compare(frames, mesh.faces, levels[0].points, levels[0].faces, samples=500, device="cpu").rms < 5.0
import sys
assert sys.modules["pxr"] is None
"""
    done = python("-c", code, first=no_usd)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("arguments", [("--version",), ("--help",), ("simplify", "--help"), ("batch", "--help")])
def test_commands_say_what_they_are(no_usd, arguments):
    done = python("-m", "warpqem", *arguments, first=no_usd)
    assert (done.returncode, done.stderr) == (0, "")
    assert "warpqem" in done.stdout


def test_every_command_on_stages_names_what_is_missing(no_usd):
    commands = [
        f"simplify {SCENE} -o out.usda --ratio 0.5",
        f"batch {SCENE} -o out --ratio 0.5",
        f"info {SCENE}",
        f"compare {SCENE} {SCENE}",
        f"render {SCENE} -o out.png",
        f"features {SCENE} -o out.usda",
        f"view {SCENE} --no-browser",
        f"face detect {SCENE}",
        f"face simplify {SCENE} -o out.usda --ratio 0.5",
        f"face retarget {SCENE} {SCENE} -o out.usda",
        f"progressive build {SCENE} -o out.wpqm",
        "progressive extract in.wpqm -o out.usda --ratio 0.5",
    ]
    code = f"""
from warpqem.cli.main import app
for command in {commands!r}:
    try:
        app(command.split(), prog_name="warpqem")
    except SystemExit as stop:
        print(stop.code)
"""
    done = python("-c", code, first=no_usd)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["1"] * len(commands), done.stderr
    errors = done.stderr.splitlines()
    assert len(errors) == len(commands), done.stderr
    for line in errors:
        assert line.startswith(f"error: {MISSING} {sys.executable}"), line
        assert "pip install usd-core" in line
        assert "Houdini, Maya, Blender or Omniverse Kit" in line
    assert sorted(path.name for path in no_usd.iterdir() if path.name != "__pycache__") == ["sitecustomize.py"]


def test_python_functions_on_stages_name_what_is_missing(no_usd):
    code = """
import warpqem, warpqem.usd
from warpqem.errors import UsdLibraryError
for name in ("simplify_stage", "compare_stages", "CompareOptions", "inspect_stage", "color_features"):
    try:
        getattr(warpqem.usd, name)
    except UsdLibraryError as error:
        print(error)
try:
    warpqem.batch([warpqem.BatchJob("in.usda", "out.usda", warpqem.usd.SimplifyOptions(ratio=0.5))])
except ImportError as error:
    print(error)
from warpqem.batching.ray_engine import _perform
job = warpqem.BatchJob("in.usda", "out.usda", warpqem.usd.SimplifyOptions(ratio=0.5))
result = _perform(job, {"CPU": 1.0}, "mark")
assert (result.status, result.error) == ("failed", "UsdLibraryError")
print(result.message.removeprefix("in.usda: "))
"""
    done = python("-c", code, first=no_usd)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert [line.startswith(MISSING) for line in lines] == [True] * 7, lines


def test_usd_that_is_too_old_is_named_with_its_version_and_place(tmp_path):
    make_usd(tmp_path, {"Usd": "def GetVersion():\n    return (0, 23, 11)\n"})
    done = python("-m", "warpqem", "info", SCENE, first=tmp_path)
    assert done.returncode == 1
    assert done.stderr.startswith(
        f"error: USD at {tmp_path / 'pxr'} (part of no package that pip has installed) is USD 23.11, "
    )
    assert "at least 24.03" in done.stderr


def reason(folder: Path) -> str:
    """What warpqem says about the `pxr` in a folder."""
    done = python("-c", "from warpqem.usd.checks.library import need_usd\nneed_usd()", first=folder)
    assert done.returncode == 1
    return done.stderr.splitlines()[-1]


@pytest.mark.parametrize(
    ("sources", "cause"),
    [
        ({"Tf": "from pxr import _tf"}, "ImportError: cannot import name '_tf'"),
        ({"Sdf": "raise RuntimeError('symbol lookup error')"}, "RuntimeError: symbol lookup error"),
        ({}, "AttributeError: module 'pxr.Usd' has no attribute 'GetVersion'"),
    ],
)
def test_usd_that_cannot_be_loaded_is_named_with_its_place_and_the_cause(tmp_path, sources, cause):
    make_usd(tmp_path, sources)
    place = f"USD at {tmp_path / 'pxr'} (part of no package that pip has installed)"
    assert f"UsdLibraryError: {place} cannot be loaded ({cause}" in reason(tmp_path)


def install(folder: Path, name: str) -> None:
    """What pip writes about a package that has brought the `pxr` in a folder."""
    about = folder / f"{name.replace('-', '_')}-1.2.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.2\n")
    (about / "RECORD").write_text("pxr/__init__.py,,\n")


def test_package_that_has_brought_a_broken_usd_is_to_be_installed_again(tmp_path):
    make_usd(tmp_path, {"Tf": "from pxr import _tf"})
    install(tmp_path, "usd-exchange")
    text = reason(tmp_path)
    assert f"USD at {tmp_path / 'pxr'} (usd-exchange 1.2) cannot be loaded" in text
    assert text.endswith("pip install --upgrade --force-reinstall usd-exchange")


def test_packages_that_overwrite_each_other_are_all_named(tmp_path):
    make_usd(tmp_path, {"Tf": "from pxr import _tf"})
    for name in ("usd-core", "usd-exchange"):
        install(tmp_path, name)
    text = reason(tmp_path)
    assert "(usd-core 1.2 and usd-exchange 1.2) cannot be loaded" in text
    assert text.endswith("uninstall all of them and install one")


def test_oldest_usd_is_the_bound_of_the_package():
    tomllib = pytest.importorskip("tomllib", reason="Python 3.10 has no TOML reader")
    bounds = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["dependencies"]
    assert f"usd-core>={'.'.join(map(str, OLDEST_USD))}" in bounds


def test_requirements_are_those_of_the_package_without_usd_and_extras(monkeypatch):
    lines = [
        "numpy>=1.26",
        "usd-core>=24.3",
        'scipy>=1.11; extra == "face"',
        "usd-core-tools>=1",
        "a; python_version<'4'",
    ]
    monkeypatch.setattr("warpqem.requirements.requires", lambda name: lines)
    assert requirements_beside_usd() == ["numpy>=1.26", "usd-core-tools>=1", "a; python_version<'4'"]


def test_requirements_are_printed_where_none_of_them_is_installed(no_usd):
    # Without site-packages: only what the checkout and the standard library have, and what pip wrote about warpqem.
    install(no_usd, "warpqem")
    with (no_usd / "warpqem-1.2.dist-info" / "METADATA").open("a") as file:
        file.write('Requires-Dist: numpy>=1.26\nRequires-Dist: usd-core>=24.3\nRequires-Dist: ray; extra == "ray"\n')
    done = python("-S", "-m", "warpqem.requirements", first=no_usd)
    assert (done.returncode, done.stdout, done.stderr) == (0, "numpy>=1.26\n", "")
