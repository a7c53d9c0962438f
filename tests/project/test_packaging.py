"""What is shipped, and which part of the code may import which."""

import ast
import importlib.metadata
import os
import re
import subprocess
import sys
import tarfile
import zipfile
from functools import cache
from pathlib import Path
from shutil import copy, copytree, ignore_patterns

import pytest

ROOT = Path(__file__).resolve().parents[2]
KERNELS, PACKAGE = ROOT / "kernels", ROOT / "warpqem"
# The layers above the core, and what only they may use.
UPPER = {"usd", "gltf", "batching", "cli", "__main__.py"}
UPPER_ONLY = {"pxr", "typer", "rich", "ray", "warpqem.usd", "warpqem.gltf", "warpqem.batching", "warpqem.cli"}
KERNEL_FILES = sorted(KERNELS.glob("*.py"))
CORE_FILES = [
    p
    for p in sorted(PACKAGE.rglob("*.py"))
    if not UPPER & set(p.relative_to(PACKAGE).parts) and "kernels" not in p.parts
]


@cache
def nodes_of(path) -> list[ast.AST]:
    """The syntax tree of a file, which several checks look through."""
    return list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))


@cache
def for_type_checkers(path) -> set[int]:
    """Which of them only a type checker reads."""
    blocks = [n for n in nodes_of(path) if isinstance(n, ast.If) and ast.unparse(n.test) == "TYPE_CHECKING"]
    return {id(n) for block in blocks for n in ast.walk(block)}


def imported(path) -> set[str]:
    """Modules that a file imports, anywhere in it."""
    names = set()
    for node in nodes_of(path):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def within(name, packages) -> bool:
    return any(name == p or name.startswith(p + ".") for p in packages)


def setuptools_version() -> int:
    """Major version of the installed setuptools, 0 where there is none."""
    try:
        return int(importlib.metadata.version("setuptools").split(".")[0])
    except importlib.metadata.PackageNotFoundError:
        return 0


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Folder with the source distribution of a copy of the checkout, and a wheel made of that; without network."""
    if setuptools_version() < 77:
        pytest.skip("building needs setuptools 77 or later (see build-system.requires), which is not installed")
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        copy(ROOT / name, source)
    for name in ("kernels", "warpqem", "tests", "scenes"):
        copytree(
            ROOT / name, source / name, symlinks=True, ignore=ignore_patterns("__pycache__", "*.usdc", "node_modules")
        )
    # Without a choice between them, the wheel is built from the source distribution.
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(out), str(source)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return out


@pytest.fixture(scope="module")
def wheel_names(built):
    """Names of the files in the wheel."""
    with zipfile.ZipFile(next(built.glob("*.whl"))) as wheel:
        return set(wheel.namelist())


def test_source_distribution_holds_no_link(built):
    with tarfile.open(next(built.glob("*.tar.gz"))) as archive:
        assert [member.name for member in archive if member.issym() or member.islnk()] == []


def test_installed_wheel_works_without_the_checkout(built, tmp_path):
    site = tmp_path / "site"
    install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target", str(site)]
    subprocess.run([*install, str(next(built.glob("*.whl")))], check=True, capture_output=True)
    code = (
        "import warpqem; print(warpqem.__file__); "
        "warpqem.simplify([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], ratio=1, device='cpu')"
    )
    environment = {**os.environ, "PYTHONPATH": str(site)}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, env=environment, check=True
    )
    assert done.stdout.splitlines()[0] == str(site / "warpqem" / "__init__.py")


def test_wheel_holds_every_kernel_module(wheel_names):
    assert {f"warpqem/kernels/{p.name}" for p in KERNEL_FILES} <= wheel_names


def test_wheel_holds_every_module_of_the_package(wheel_names):
    modules = {p.relative_to(ROOT).as_posix() for p in PACKAGE.rglob("*.py")}
    assert modules <= wheel_names


def test_wheel_is_marked_as_typed(wheel_names):
    assert "warpqem/py.typed" in wheel_names


def test_wheel_holds_nothing_but_the_package(wheel_names):
    tops = {name.split("/")[0] for name in wheel_names}
    assert {t for t in tops if not t.endswith(".dist-info")} == {"warpqem"}


def test_wheel_holds_the_licence(wheel_names):
    assert any(re.search(r"dist-info/.*LICENSE$", name) for name in wheel_names)


def test_wheel_holds_what_reports_are_made_of_with_its_licence_and_no_more(wheel_names):
    assets = {f"warpqem/report/assets/{p.name}" for p in (PACKAGE / "report" / "assets").iterdir()}
    assert assets == {name for name in wheel_names if name.startswith("warpqem/report/") and not name.endswith(".py")}
    assert any(re.search(r"dist-info/.*three\.LICENSE$", name) for name in wheel_names)


def test_every_directory_of_modules_is_a_listed_package():
    tomllib = pytest.importorskip("tomllib", reason="Python 3.10 has no TOML reader")
    listed = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"])
    found = {".".join(p.parent.relative_to(ROOT).parts) for p in PACKAGE.rglob("*.py")} | {"warpqem.kernels"}
    assert found == listed


def test_every_package_has_an_init_file():
    directories = {p.parent for p in PACKAGE.rglob("*.py")}
    assert [d for d in directories if not (d / "__init__.py").exists()] == []


@pytest.mark.parametrize("path", KERNEL_FILES, ids=lambda p: p.name)
def test_kernels_import_no_host_code(path):
    assert [
        n for n in imported(path) if not within(n, {"warp", "math", "typing", "collections", "warpqem.kernels"})
    ] == []


@pytest.mark.parametrize("path", KERNEL_FILES, ids=lambda p: p.name)
def test_kernels_keep_their_annotations(path):
    assert "__future__.annotations" not in imported(path)


# The front door names what is public in all layers.
@pytest.mark.parametrize(
    "path", sorted(set(CORE_FILES) - {PACKAGE / "__init__.py"}), ids=lambda p: p.relative_to(PACKAGE).as_posix()
)
def test_core_imports_nothing_from_the_layers_above(path):
    # A bar is drawn where a caller of the core asks for one, and loaded there.
    allowed = {"rich"} if path == PACKAGE / "arguments" / "progress.py" else set()
    assert [n for n in imported(path) if within(n, UPPER_ONLY - allowed)] == []


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=lambda p: p.relative_to(PACKAGE).as_posix())
def test_trimesh_is_imported_by_the_readers_and_writers_of_mesh_files_alone(path):
    # For type checkers alone a result names its class.
    left_out = for_type_checkers(path)
    nodes = [n for n in nodes_of(path) if isinstance(n, ast.Import) and id(n) not in left_out]
    names = {alias.name for node in nodes for alias in node.names}
    assert "trimesh" not in names or path.parent.name == "mesh_files"


@pytest.mark.parametrize(
    "path", sorted((PACKAGE / "usd").rglob("*.py")), ids=lambda p: p.relative_to(PACKAGE).as_posix()
)
def test_usd_layer_does_not_import_the_command_line(path):
    assert [n for n in imported(path) if within(n, {"warpqem.cli", "typer", "rich"})] == []


# Rooms from the ground up; one imports those before it. What a type checker alone reads does not count.
FLOORS = [
    "errors",
    "printable",
    "requirements",
    "runtime",
    "files",
    "arguments",
    "frames",
    "mesh",
    "normal_maps",
    "decimation",
    "costs",
    "options",
    "repair",
    "place",
    "measure",
    "refit",
    "picture",
    "mesh_files",
    "face",
    "pipeline",
    "attribute_fit",
    "skinning",
    "progressive",
    "report",
    "usd.checks",
    "usd.layers",
    "usd.read",
    "usd.write",
    "usd.commands",
    "usd",
    "gltf",
    "batching",
    "cli",
]


def room_of(module) -> str:
    """The room of a module of the package, given without `warpqem.`."""
    parts = module.split(".")
    return ".".join(parts[:2]) if parts[0] == "usd" and ".".join(parts[:2]) in FLOORS else parts[0]


def imported_when_run(path) -> set[str]:
    """Modules of the package that a file imports, but for those that only a type checker reads."""
    left_out = for_type_checkers(path)
    nodes = [n for n in nodes_of(path) if isinstance(n, ast.ImportFrom) and id(n) not in left_out]
    return {n.module.removeprefix("warpqem.") for n in nodes if n.module.startswith("warpqem.")}


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=lambda p: p.relative_to(PACKAGE).as_posix())
def test_no_room_imports_one_above_it(path):
    if path.parent == PACKAGE and path.stem in ("__init__", "__main__"):
        return
    own = room_of(".".join(path.relative_to(PACKAGE).with_suffix("").parts).removesuffix(".__init__"))
    floor = FLOORS.index(own)
    others = {room_of(module) for module in imported_when_run(path)} - {own, "kernels"}
    assert {other for other in others if FLOORS.index(other) > floor} == set()


@pytest.mark.parametrize("path", sorted((ROOT / "tests").rglob("*.py")), ids=lambda p: p.relative_to(ROOT).as_posix())
def test_no_test_imports_another(path):
    assert [name for name in imported(path) if name.startswith("tests.") and ".test_" in name] == []


def test_every_room_has_a_floor():
    rooms = {p.name for p in PACKAGE.iterdir() if p.is_dir() and (p / "__init__.py").exists()} - {"kernels"}
    files = {p.stem for p in PACKAGE.glob("*.py")} - {"__init__", "__main__"}
    assert {floor.split(".")[0] for floor in FLOORS} == rooms | files


def loaded_by(statement) -> set[str]:
    """Top-level modules that are loaded after a statement in a fresh interpreter."""
    code = f"{statement}\nimport sys\nprint('\\n'.join({{m.split('.')[0] for m in sys.modules}}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    return set(done.stdout.split())


@pytest.mark.parametrize("path", CORE_FILES, ids=lambda p: p.stem)
def test_kernels_are_launched_through_one_module(path):
    # Which loads their modules in one thread, and holds what captured graphs use.
    own = {"launch", "launch_tiled", "load_module", "force_load", "ScopedCapture", "capture_begin", "capture_launch"}
    calls = {node.attr for node in nodes_of(path) if isinstance(node, ast.Attribute)}
    assert path.name == "launches.py" or not calls & own or not any(f"wp.{n}(" in path.read_text("utf-8") for n in own)


def test_importing_the_package_loads_neither_usd_nor_warp():
    assert loaded_by("import warpqem") & {"pxr", "warp", "numpy", "typer", "rich"} == set()


def test_using_the_core_does_not_load_usd():
    assert loaded_by("from warpqem import simplify, motion_features") & {"pxr", "typer", "rich", "trimesh"} == set()


def test_loading_mesh_files_needs_no_usd():
    assert loaded_by("from warpqem import load") & {"pxr", "trimesh"} == set()
