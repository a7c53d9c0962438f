"""One definition of every option: what is derived from it, and how many a command shows."""

from __future__ import annotations

import ast
import inspect
import math
import re
import subprocess
import sys
import typing
from dataclasses import dataclass, fields

import numpy as np
import pytest
import typer.main
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

import warpqem
import warpqem.usd
from tests.support import meshes
from warpqem.arguments import option_fields as option_fields_module
from warpqem.arguments.limits import Limits
from warpqem.arguments.option_fields import check_options, named_options, option, option_fields
from warpqem.cli.app import app
from warpqem.cli.batch import batch
from warpqem.cli.face import simplify as simplify_face
from warpqem.cli.option_parameters import takes_options
from warpqem.cli.progressive import build, extract
from warpqem.cli.simplify import simplify
from warpqem.errors import OptionError
from warpqem.options import MeshOptions, MethodOptions, SimplifyKeywords
from warpqem.usd import SimplifyOptions
from warpqem.usd.commands.progressive_options import BuildOptions, LevelChoice

POINTS, FACES = meshes.swaying_sphere(2, 3)
# What `--help` shows at most, itself and `--help-all` among them: a screen of text. A new option replaces another.
MAX_SHOWN = 14
# What a command takes in all, likewise.
MAX_TAKEN = {simplify: 64, batch: 76}


@dataclass(frozen=True)
class Sample:
    size: float = option(1.0, "How large.", "MM", Limits(0.0, 2.0, open_low=True))
    count: int | None = option(None, "How many.", "ITEMS", Limits(2))
    kind: typing.Literal["a", "b"] = option("a", "Which.")
    fast: bool = option(False, "Fast.")
    other: object = None


@pytest.mark.parametrize("options", [MeshOptions, SimplifyOptions, BuildOptions, LevelChoice])
def test_defaults_are_as_checking_would_leave_them(options):
    for entry in option_fields(options).values():
        found = option_fields_module._checked(entry, entry.default, option_fields(options))
        assert type(found) is type(entry.default), entry.field
        assert found == entry.default, entry.field


@pytest.mark.parametrize("options", [MeshOptions, SimplifyOptions, BuildOptions, LevelChoice])
def test_every_number_says_its_unit_and_its_range(options):
    for name, entry in named_options(options).items():
        if entry.kind in (int, float):
            assert entry.option.unit, name
            assert entry.option.limits, name
        assert entry.option.help.endswith("."), name


@pytest.mark.parametrize("command", [simplify, batch, build, extract, simplify_face])
def test_help_shows_a_screen_of_options(command):
    signature = inspect.signature(command)
    shown = [
        name
        for name, parameter in signature.parameters.items()
        if not getattr(parameter.annotation.__metadata__[0], "hidden", False)
        and type(parameter.annotation.__metadata__[0]).__name__ == "OptionInfo"
    ]
    # typer adds --help.
    assert len(shown) + 1 <= MAX_SHOWN, shown
    assert len(signature.parameters) <= MAX_TAKEN.get(command, MAX_TAKEN[simplify])


def test_keyword_arguments_are_the_fields_of_the_options():
    assert typing.get_type_hints(MethodOptions).keys() | {"target_faces"} <= SimplifyKeywords.__annotations__.keys()
    assert set(SimplifyKeywords.__annotations__) == {entry.name for entry in fields(MeshOptions)}
    for entry in fields(MeshOptions):
        assert SimplifyKeywords.__annotations__[entry.name].__forward_arg__ == entry.type


def test_an_argument_that_is_no_option_is_a_type_error_that_lists_them():
    for call in (warpqem.simplify, warpqem.plan):
        with pytest.raises(TypeError, match="unexpected keyword argument 'nonsense'; the options are ratio"):
            call(POINTS, FACES, ratio=0.5, nonsense=3)


@pytest.mark.parametrize("package", [warpqem, warpqem.costs, warpqem.usd])
def test_type_checkers_find_each_public_name_in_its_home(package):
    tree = ast.parse(inspect.getsource(package))
    block = next(node for node in tree.body if isinstance(node, ast.If))
    imports = [node for node in block.body if isinstance(node, ast.ImportFrom)]
    rooms = [name.asname for node in imports if node.module == "warpqem" for name in node.names]
    found = {name.asname: node.module for node in imports if node.module != "warpqem" for name in node.names}
    assert rooms == list(getattr(package, "_ROOMS", ()))
    assert found == package._HOMES
    assert set(dir(package)) == {*package.__all__, *getattr(package, "_ROOMS", ())}


@pytest.mark.parametrize("name", ["FrameShare", "help_place"])
def test_a_name_that_was_removed_says_so(name):
    with pytest.raises(AttributeError, match=rf"no attribute '{name}' \(it was removed: "):
        getattr(warpqem, name)
    assert name not in dir(warpqem)


# What a user may write, each line with the code of an error of mypy, or none where it is right.
USES = {
    "simplify(points, faces, ratio=0.5, quality='best')": None,
    "simplify([[0.0, 0.0, 0.0]], [(0, 1, 2)], target_faces=2)": None,
    "simplify(points, faces, ratio=0.5, vertex_weights=np.ones(3), seams=[(0, 1)])": None,
    "simplify(wp.zeros((3, 3)), wp.zeros((1, 3), dtype=wp.int32), max_error=1.0)": None,
    "simplify(trimesh.Trimesh(), ratio=0.5)": None,
    "simplify(warpqem.load('a.obj'), ratio=0.5)": None,
    "shape: tuple[int, ...] = simplify(points, faces, ratio=0.1).points.shape": None,
    "warpqem.face.FaceProtection(weight=2.0)": None,
    "warpqem.costs.AttributeField(points[0])": None,
    "warpqem.measure.compare(points, faces, points, faces).rms.is_integer()": None,
    "warpqem.usd.SimplifyOptions(ratio=0.5)": None,
    "levels: list[warpqem.SimplifiedMesh] = warpqem.simplify_levels(points, faces, ratios=[0.5])": None,
    "simplify(1, 2, nonsense=3)": "call-arg",
    "simplify(1, faces, ratio=0.5)": "arg-type",
    "simplify(points, 2, ratio=0.5)": "arg-type",
    "simplify(points, faces, quality='bset')": "arg-type",
    "simplify(points, faces, ratio='half')": "arg-type",
    "simplify(points, faces, locked=3)": "arg-type",
    "simplify(points, faces, ratio=0.1).points.nonsense": "attr-defined",
    "simplify(points, faces, ratio=0.1).nonsense": "attr-defined",
    "warpqem.plan(points, faces, nonsense=3)": "call-arg",
    "warpqem.build_progressive(points, faces, nonsense=3)": "call-arg",
    "warpqem.usd.SimplifyOptions(nonsense=3)": "call-arg",
    "warpqem.nonsense": "attr-defined",
    "warpqem.usd.nonsense": "attr-defined",
    "warpqem.costs.nonsense": "attr-defined",
    "warpqem.face.nonsense": "attr-defined",
}


def test_a_type_checker_knows_the_public_names_and_their_options(tmp_path):
    pytest.importorskip("mypy")
    file = tmp_path / "uses.py"
    head = (
        "import numpy as np\nimport trimesh\nimport warp as wp\nimport warpqem\nfrom warpqem import simplify\n"
        "points, faces = np.zeros((1, 3, 3)), np.zeros((1, 3))\n"
    )
    file.write_text(head + "\n".join(USES) + "\n")
    command = [
        sys.executable,
        "-m",
        "mypy",
        "--config-file=",  # a user has none of this project
        "--follow-imports=silent",
        "--cache-dir",
        str(tmp_path / "cache"),
        str(file),
    ]
    found = subprocess.run(command, capture_output=True, text=True, check=False).stdout
    codes: dict[int, set[str | None]] = {}
    for line in found.splitlines():
        if ": error:" in line:
            codes.setdefault(int(line.split(":")[1]), set()).add(line.rsplit("[")[-1].rstrip("]"))
    first = head.count("\n") + 1
    wrong = [use for line, (use, code) in enumerate(USES.items(), first) if code not in codes.get(line, {None})]
    assert wrong == [], found


@given(st.floats(allow_nan=True))
def test_limits_hold_no_number_outside(value):
    assert (value in Limits(0.0, 1.0, open_low=True)) == (0.0 < value <= 1.0)
    assert (value in Limits(2.0)) == (2.0 <= value < math.inf)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"size": 0}, r"size must be in \(0, 2\], got 0"),
        ({"size": math.nan}, r"size must be in \(0, 2\], got nan"),
        ({"size": "1"}, r"size must be in \(0, 2\], got '1' \(str\)"),
        ({"count": 1}, "count must be a whole number at least 2, got 1"),
        ({"count": 2.5}, "count must be a whole number at least 2, got 2.5"),
        ({"kind": "c"}, r"kind must be 'a' or 'b', got 'c' \(str\)"),
        ({"fast": "no"}, r"fast must be True or False, got 'no' \(str\)"),
    ],
)
def test_values_outside_of_their_range_are_named(values, message):
    with pytest.raises(OptionError, match=message):
        check_options(Sample(**values))


def test_values_become_numbers_and_flags_of_python():
    found = check_options(Sample(size=np.float32(0.5), count=np.int64(3), fast=np.True_))
    assert found == {"size": 0.5, "count": 3, "kind": "a", "fast": True}
    assert [type(value) for value in found.values()] == [float, int, str, bool]
    assert list(option_fields(Sample)) == list(found)


def test_an_option_of_the_dataclass_is_one_of_the_command():
    @takes_options(Sample)
    def command(options: dict[str, typing.Any]) -> None:
        pass

    taken = inspect.signature(command).parameters
    assert set(taken) == {"size", "count", "kind", "fast", "help_all"}
    assert taken["size"].annotation.__metadata__[0].help == "How large. (in (0, 2])"


def test_help_all_shows_what_help_leaves_out():
    def shown(flag: str) -> str:
        command = [sys.executable, "-m", "warpqem", "simplify", flag]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout

    short, long = shown("--help"), shown("--help-all")
    assert "--quality" in short
    assert "--memoryless" in long
    assert "--coherence" not in short
    assert "--coherence" in long


def commands_of(group: typing.Any, *path: str) -> list[tuple[str, ...]]:
    found = [path]
    for name, command in getattr(group, "commands", {}).items():
        found += commands_of(command, *path, name)
    return found


@pytest.mark.parametrize("command", commands_of(typer.main.get_command(app)), ids=lambda path: " ".join(path) or "all")
def test_every_command_has_a_help_all_with_all_its_options(command):
    short, long = (
        CliRunner().invoke(app, [*command, flag], env={"COLUMNS": "250"}) for flag in ("--help", "--help-all")
    )
    assert (long.exit_code, long.stderr) == (0, "")
    shown = re.findall(r"--[a-z-]+", long.output)
    assert set(re.findall(r"--[a-z-]+", short.output)) <= set(shown)
    own = typer.main.get_command(app)
    for name in command:
        own = own.commands[name]
    options = [parameter for parameter in own.params if parameter.param_type_name == "option"]
    assert {parameter.opts[0] for parameter in options} <= {*shown, "--install-completion", "--show-completion"}


@pytest.mark.parametrize(
    ("given", "refits", "present"),
    [
        ({}, True, True),
        ({"quality": "best"}, True, True),
        ({"quality": "fast"}, False, False),
        ({"refit": False}, False, True),
        ({"memoryless": False}, True, False),
        ({"quality": "fast", "refit": True}, True, False),
        ({"placement": "endpoint"}, False, True),
    ],
)
def test_quality_says_what_single_options_do_not(given, refits, present):
    options = MeshOptions(ratio=0.5, **given).checked()
    assert (options.refits, options.memoryless_orders) == (refits, present)


def test_best_is_refit_of_a_memoryless_order():
    best = warpqem.simplify(POINTS, FACES, ratio=0.3, device="cpu")
    single = warpqem.simplify(POINTS, FACES, ratio=0.3, quality="fast", memoryless=True, refit=True, device="cpu")
    assert best.points.tobytes() == single.points.tobytes()
    assert best.faces.tobytes() == single.faces.tobytes()
