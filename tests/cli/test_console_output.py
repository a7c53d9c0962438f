"""What `warpqem simplify` prints: few lines for many meshes, figures that can be read, a last line that says where."""

from __future__ import annotations

import io
import json
import re
from typing import Any

import pytest
import typer
from hypothesis import given
from hypothesis import strategies as st
from pxr import UsdGeom
from rich.console import Console

from tests.support.cli import run
from tests.support.usd_stages import cloth_stage, define_cloth
from warpqem.cli.main import app
from warpqem.cli.message_groups import file_size, group_messages
from warpqem.cli.tables import PlainTable, shortened_path

PATHS = ("/Root/Worst", "/Root/B", "/Root/C")


def test_equal_messages_of_many_meshes_are_one_line():
    held = [("warning", f"{path}: subdivision dropped") for path in PATHS]
    assert group_messages(held, PATHS) == [("warning", "3 meshes: subdivision dropped")]


def test_of_messages_that_differ_in_numbers_that_of_the_worst_mesh_is_shown():
    off = dict(zip(PATHS, (11.3, 7, 2.5), strict=True))
    held = [("warning", f"{path}: a point is {off[path]} % off") for path in PATHS[::-1]]
    assert group_messages(held, PATHS) == [("warning", "3 meshes, such as /Root/Worst: a point is 11.3 % off")]


def test_thousands_are_one_number():
    held = [("warning", "/Root/B: stopped at 1,024 faces"), ("warning", "/Root/C: stopped at 7 faces")]
    assert group_messages(held, PATHS) == [("warning", "2 meshes, such as /Root/B: stopped at 1,024 faces")]


def test_paths_in_messages_lose_their_beginning_where_asked_and_those_in_errors_do_not():
    paths = [f"/Root/{'Group/' * 20}Mesh{name}" for name in "AB"]
    held = [("note", f"{path}: off by {index}") for index, path in enumerate(paths)]
    held += [("warning", f"{paths[0]}: cut"), ("error", f"{paths[1]}: broken")]
    note, warning, error = (text for _, text in group_messages(held, paths, 40))
    assert re.fullmatch(r"2 meshes, such as \.\.\.(/Group)+/MeshA: off by 0", note)
    assert re.fullmatch(r"\.\.\.(/Group)+/MeshA: cut", warning)
    assert error == f"{paths[1]}: broken"
    assert group_messages(held, paths)[1] == ("warning", f"{paths[0]}: cut")


def test_other_messages_errors_and_levels_stand_for_themselves():
    held = [
        ("note", "kept: 3 clips"),
        ("error", "/Root/B: no points"),
        ("error", "/Root/C: no points"),
        ("warning", "/Root/B: cut"),
        ("warning", "LOD1: /Root/B: off by 3"),
        ("warning", "LOD1: /Root/C: off by 4"),
        ("warning", "LOD2: /Root/C: off by 5"),
    ]
    assert group_messages(held, PATHS) == [
        *held[:4],
        ("warning", "LOD1: 2 meshes, such as /Root/B: off by 3"),
        held[6],
    ]


@given(
    st.lists(
        st.tuples(
            st.sampled_from(["warning", "note", "error"]),
            st.sampled_from([*PATHS, ""]),
            st.sampled_from(["abc", "1", "2", ":", "x"]),
        ),
        max_size=12,
    )
)
def test_no_message_is_lost(parts):
    held = [(kind, f"{path}: {said}" if path else said) for kind, path, said in parts]
    lines = group_messages(held, PATHS)
    # Each kind of message of each mesh is in a line of its own or counted in one.
    assert {kind for kind, _ in lines} == {kind for kind, _ in held}
    for kind, path, said in parts:
        shown = [text for found, text in lines if found == kind]
        assert any(re.sub(r"\d", "#", said) in re.sub(r"\d", "#", text) for text in shown)
        if kind == "error" and path:
            assert f"{path}: {said}" in shown
    assert len(lines) <= len(held)


@given(st.lists(st.text("abcdef_", min_size=1, max_size=9), min_size=1, max_size=9), st.integers(8, 40))
def test_a_shortened_path_keeps_its_end(names, width):
    path = "/" + "/".join(names)
    short = shortened_path(path, width)
    assert len(short) <= max(width, 4)
    assert short == path or (short.startswith("...") and path.endswith(short[3:]))


def shown(table, width=1000):
    console = Console(file=io.StringIO(), width=width)
    console.print(table.rendered(width))
    return [line.rstrip() for line in console.file.getvalue().splitlines()]


def test_counts_have_separators_and_other_cells_stay():
    table = PlainTable("")
    for name in "abcd":
        table.add_column(name, "right")
    table.add_row(1234567, "0.1234", "1234567", 12)
    assert shown(table)[-1].split() == ["1,234,567", "0.1234", "1234567", "12"]


def wide_table():
    table = PlainTable("title")
    table.add_column("mesh", is_path=True)
    for name, rank in (("faces before", 0), ("RMS %", 0), ("jitter %", 1), ("edge length %", 2)):
        table.add_column(name, "right", rank=rank)
    table.add_column("stopped")
    table.add_row("/Root/Group/Body/Hand/Finger", 1234567, "0.1234", "0.00001", "0.54321", "no legal collapse")
    table.add_row("/Root/A", "failed")
    return table


@pytest.mark.parametrize("width", [60, 66, 80, 100, 200])
def test_figures_are_whole_at_any_width_and_what_is_left_out_is_named(width):
    lines = shown(wide_table(), width)
    assert max(map(len, lines)) <= width
    text = "\n".join(lines)
    assert "…" not in text
    for figure in ("1,234,567", "0.1234", "no legal collapse"):
        assert figure in text
    for head, figure in (("jitter", "0.00001"), ("edge", "0.54321")):
        assert (figure in text) == (f"{head}" not in text.split("no room for")[-1] or "no room for" not in text)
    assert "Finger" in text


def test_columns_go_by_their_rank_once_paths_are_short():
    assert not any("no room" in line for line in shown(wide_table(), 67))
    assert "no room for edge length %: see --json" in shown(wide_table(), 60)
    assert any("no room for jitter %, edge length %" in line for line in shown(wide_table(), 56))
    assert "/Root/Group/Body/Hand/Finger" in "".join(shown(wide_table(), 120))


def test_sizes_have_a_unit(tmp_path):
    for size, text in ((0, "0 bytes"), (999, "999 bytes"), (1500, "1.5 KB"), (18_000, "18 KB"), (2_340_000, "2.3 MB")):
        (tmp_path / "file").write_bytes(bytes(size))
        assert file_size(str(tmp_path / "file")) == text
    assert file_size(str(tmp_path / "none")) == ""


@pytest.fixture(scope="module")
def many(tmp_path_factory):
    folder = tmp_path_factory.mktemp("many")
    stage = cloth_stage(folder / "in.usda")
    for index in range(11):
        mesh = define_cloth(stage, f"/Root/Cloth{index}", size=5, times=[1.0, 2.0])
        UsdGeom.Mesh(mesh).CreateCreaseIndicesAttr([0, 1])
        UsdGeom.Mesh(mesh).CreateCreaseLengthsAttr([2])
        UsdGeom.Mesh(mesh).CreateCreaseSharpnessesAttr([3.0])
    stage.Save()
    return folder


def simplified(folder, *more):
    done = run("simplify", folder / "in.usda", "-o", folder / "out.usda", "--ratio", "0.5", "--device", "cpu", *more)
    assert done.exit_code == 0, done.output
    return done


def test_many_meshes_take_few_lines(many):
    done = simplified(many)
    assert len(done.output.splitlines()) <= 25
    assert "plan:" not in done.stderr
    assert re.search(r"11 meshes(, such as [/\w]+)?: dropped, does not fit the new mesh: .*crease", done.stderr)
    assert "the worst 5; all with -v" in done.stdout
    assert done.stderr.splitlines()[-1] == f"wrote {many / 'out.usda'}, {file_size(str(many / 'out.usda'))}"


def test_verbose_says_all(many):
    done = simplified(many, "-v")
    assert done.stderr.count("plan: ") == 12
    assert done.stderr.count("dropped, does not fit") >= 11
    for index in range(11):
        assert f"/Root/Cloth{index} " in done.stdout


def test_quiet_prints_errors_alone(many, tmp_path):
    assert simplified(many, "-q").output == ""
    done = run("simplify", tmp_path / "none.usda", "-o", tmp_path / "out.usda", "--ratio", "0.5", "-q")
    assert done.exit_code == 1
    assert done.output.startswith("error: ")


def test_the_last_line_names_report_and_json(many):
    done = simplified(many, "--report", many / "page.html", "--json", many / "report.json")
    last = done.stderr.splitlines()[-1]
    assert last.endswith(f"; report {many / 'page.html'}; JSON {many / 'report.json'}")


def test_the_program_alone_shows_its_help():
    done = run()
    assert done.exit_code == 0
    assert "simplify" in done.stdout
    assert "error" not in done.stderr


def leaves(command: Any, path: tuple[str, ...] = ()) -> dict[tuple[str, ...], Any]:
    """All commands by the words that name them."""
    below = getattr(command, "commands", {})
    found = {} if below else {path: command}
    for name, other in below.items():
        found |= leaves(other, (*path, name))
    return found


COMMANDS = leaves(typer.main.get_command(app))


@pytest.mark.parametrize("path", COMMANDS, ids=" ".join)
def test_quiet_and_verbose_are_options_of_every_command_and_exclude_each_other(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    options = {option for parameter in COMMANDS[path].params for option in parameter.opts}
    assert options >= {"--quiet", "-q", "--verbose", "-v"}
    needed = [parameter for parameter in COMMANDS[path].params if parameter.required]
    given = [
        text
        for parameter in needed
        for text in ([] if parameter.opts[0][0] != "-" else parameter.opts[:1]) + ["a.usda"]
    ]
    for both in (["-q", "-v"], ["-vv", "--quiet"], ["-qv"]):
        done = run(*path, *given, *both)
        assert (done.exit_code, done.stderr) == (2, "error: --quiet and --verbose exclude each other\n")
    assert list(tmp_path.iterdir()) == []


def test_every_command_that_prints_is_quiet_and_says_what_it_reads(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    run("simplify", tmp_path / "in.usda", "-o", tmp_path / "out.usda", "--ratio", "0.5", "--device", "cpu")
    commands = (
        ("compare", tmp_path / "in.usda", tmp_path / "out.usda", "--device", "cpu", "--json", tmp_path / "found.json"),
        ("features", tmp_path / "in.usda", "-o", tmp_path / "joints.usda", "--device", "cpu"),
        ("render", tmp_path / "in.usda", "-o", tmp_path / "a.png", "--pictures", "1", "--device", "cpu"),
        ("info", tmp_path / "in.usda", "--json", tmp_path / "info.json"),
        ("progressive", "build", tmp_path / "in.usda", "-o", tmp_path / "a.wpqm", "--device", "cpu"),
        ("progressive", "extract", tmp_path / "a.wpqm", "-o", tmp_path / "b.usda", "--ratio", "0.5"),
        ("progressive", "info", tmp_path / "a.wpqm"),
    )
    for command in commands:
        done = run(*command, "-q")
        assert (done.exit_code, done.output) == (0, ""), command
        done = run(*command, "-v")
        assert (
            f"INFO: {next(text for text in command[1:] if str(text).startswith(str(tmp_path)))}: reading" in done.stderr
        )
        assert done.exit_code == 0
    assert run(*commands[0]).stdout
    assert json.loads((tmp_path / "found.json").read_text())
    assert json.loads((tmp_path / "info.json").read_text())
    # Of one run nothing is left to the next.
    assert "INFO" not in run(*commands[3]).output
