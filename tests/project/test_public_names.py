"""The public names: where they are, that nothing takes their place, and what type checkers make of them."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

import warpqem

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("warpqem", *(f"warpqem.{room}" for room in warpqem._ROOMS))

# In a new process, where no module is loaded yet: loading a submodule sets it as an attribute of its package.
LOAD_ALL = """
import importlib, inspect, pkgutil, sys
import warpqem
packages = [importlib.import_module(name) for name in sys.argv[1:]]
for found in pkgutil.walk_packages(warpqem.__path__, "warpqem."):
    # The one is a command, the other runs inside Blender alone.
    if not found.name.endswith(("__main__", ".blender_script")):
        importlib.import_module(found.name)
for package in packages:
    for name in package.__all__:
        first, second = getattr(package, name), getattr(package, name)
        assert first is second or isinstance(first, str), f"{package.__name__}.{name}"
        room = package is warpqem and name in warpqem._ROOMS
        assert inspect.ismodule(first) == room, f"{package.__name__}.{name} is {first}"
        if name.islower() and not room and not name.startswith("__"):
            assert callable(first), f"{package.__name__}.{name} is {first}"
"""


@pytest.mark.parametrize("first", ["public names", "submodules"])
def test_no_loaded_submodule_takes_the_place_of_a_public_name(first):
    code = LOAD_ALL
    if first == "public names":
        code = code.replace(
            "for found in",
            "[getattr(package, name) for package in packages for name in package.__all__]\nfor found in",
            1,
        )
    done = subprocess.run([sys.executable, "-c", code, *PACKAGES], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_functions_work_twice_after_all_rooms_are_loaded(tmp_path):
    code = (
        "import warpqem, warpqem.batching.run_batch, warpqem.pipeline.levels, warpqem.progressive.build\n"
        "points = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]\nfaces = [[0, 1, 2], [0, 2, 3]]\n"
        "for _ in range(2):\n"
        "    warpqem.plan(points, faces, ratio=1.0, device='cpu')\n"
        "    warpqem.simplify(points, faces, ratio=1.0, device='cpu')\n"
        "    warpqem.simplify_levels(points, faces, ratios=[1.0], device='cpu')\n"
        "    warpqem.order_levels(points, faces, target_faces=2, device='cpu')\n"
        "    warpqem.build_progressive(points, faces, device='cpu')\n"
        "    warpqem.motion_features(points, faces, device='cpu')\n"
        "    warpqem.costs.morph_weights(points, [points, points])\n"
        "    warpqem.measure.compare(points, faces, points, faces, samples=10, device='cpu')\n"
        "    assert list(warpqem.batch([])) == []\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", PACKAGES)
def test_every_room_lists_its_public_names(name):
    room = importlib.import_module(name)
    assert len(set(room.__all__)) == len(room.__all__)
    assert set(room.__all__) <= set(dir(room))
    assert all(hasattr(room, public) for public in room.__all__)


def test_rooms_are_there_without_an_import_of_their_own():
    code = "import warpqem; warpqem.face.FaceProtection; warpqem.errors.OptionError; warpqem.skinning.fit_skin"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("name", warpqem._MOVED)
def test_old_names_at_the_root_work_and_name_their_new_home(name):
    home = warpqem._MOVED[name]
    with pytest.warns(DeprecationWarning, match=rf"^warpqem\.{name} is now {home}\.{name}$") as caught:
        found = getattr(warpqem, name)
    assert found is getattr(importlib.import_module(home), name)
    assert name in importlib.import_module(home).__all__
    assert name not in warpqem.__all__
    assert caught[0].filename == __file__


def test_old_name_of_the_options_of_a_mesh_works_and_names_the_new_one():
    options = importlib.import_module("warpqem.options")
    with pytest.warns(DeprecationWarning, match=r"^warpqem\.options\.SimplifyOptions is now MeshOptions$") as caught:
        found = options.SimplifyOptions
    assert found is options.MeshOptions
    assert caught[0].filename == __file__


def test_no_two_classes_share_a_name():
    # Private ones aside, which a module has to itself.
    found: dict[str, list[str]] = {}
    for path in sorted(path for path in (ROOT / "warpqem").rglob("*.py") if "kernels" not in path.parts):
        for name in re.findall(r"^class ([A-Z]\w*)", path.read_text(), re.MULTILINE):
            found.setdefault(name, []).append(str(path.relative_to(ROOT)))
    assert len(found) > 100
    assert {name: paths for name, paths in found.items() if len(paths) > 1} == {}


@pytest.mark.parametrize("package", ["warpqem", "warpqem.costs", "warpqem.options", "warpqem.usd"])
def test_a_name_that_is_nowhere_is_an_attribute_error(package):
    with pytest.raises(AttributeError, match=f"module '{package}' has no attribute 'nonsense'"):
        getattr(importlib.import_module(package), "nonsense")  # noqa: B009
