"""`warpqem simplify`."""

from __future__ import annotations

import sys
from collections import Counter
from typing import TYPE_CHECKING, Annotated, Any

import typer

from warpqem.cli import messages
from warpqem.cli.console import (
    EXIT_FAILED,
    WIDEST,
    PlainTable,
    error_text,
    load_usd,
    print_message,
    print_table,
    progress_bar,
    quiet_libraries,
    write_json,
)
from warpqem.cli.logs import Quiet, Verbose, start_logging
from warpqem.cli.message_groups import file_size, path_width, shortened_path, with_separators
from warpqem.cli.option_parameters import takes_options
from warpqem.cli.parameters import JsonReport, MeshInput, MeshOutput, ReportPage
from warpqem.cli.problem_lines import grouped_lines
from warpqem.printable import printable
from warpqem.usd.commands.simplify_options import SimplifyOptions

if TYPE_CHECKING:
    from warpqem.pipeline.memory_plan import MemoryPlan
    from warpqem.usd.write.stage_report import PrimReport, StageReport

__all__ = ["EXAMPLES", "run_simplify", "simplify"]

# Under its help; tests run them.
EXAMPLES = (
    "warpqem simplify quadruped_gallop.usdc -o out.usdc --ratio 0.1 --report a.html",
    "warpqem simplify cape_wind.usdc -o cape.usda --max-error 0.2 --lock-borders",
    "warpqem simplify cape_wind.usdc -o levels.usda --lods 0.5,0.2,0.05",
)

# Outputs that a title names.
MAX_NAMED = 4
# Of more meshes the table shows the worst alone; with --verbose all.
MANY_MESHES, WORST_MESHES = 8, 5
# Characters of a path below the table.
NOTE_WIDTH = 40


@takes_options(SimplifyOptions)
def simplify(
    input_file: MeshInput,
    output: MeshOutput,
    options: dict[str, Any],
    fps: Annotated[
        float | None,
        typer.Option(
            hidden=True,
            metavar="RATE",
            rich_help_panel="Input",
            help="With mesh files as IN: frames per second; their numbers are the time codes. [default: 24]",
        ),
    ] = None,
    report: ReportPage = None,
    json: JsonReport = None,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """Simplify every mesh over all its frames.

    Give a count (--ratio or --faces), limits (--max-error, --max-distance, --screen-error), or both; or --lods.

    OUT is a small layer over IN that holds the new meshes; keep the two files together, use --flatten, or a package.
    What does not fit the new meshes is removed, with a warning. Mesh files are the frames of one mesh.
    """
    run_simplify(input_file, output, options, report, json, fps, quiet=quiet, verbose=verbose)


def run_simplify(
    input_file: str,
    output: str,
    options: dict[str, Any],
    page: str | None,
    json: str | None,
    fps: float | None = None,
    *,
    quiet: bool = False,
    verbose: int = 0,
) -> None:
    """Simplify, and say what came of it."""
    messages.quiet = quiet
    start_logging(verbose, None)
    quiet_libraries()
    load_usd()
    from warpqem.errors import OptionError
    from warpqem.files.outputs import named_outputs
    from warpqem.gltf.simplify import is_animated_gltf, simplify_gltf
    from warpqem.mesh_files.file_names import is_mesh_name
    from warpqem.pipeline.memory_plan import parse_bytes
    from warpqem.report.page import check_page_path
    from warpqem.runtime.process_memory import limited_memory
    from warpqem.usd import simplify_stage
    from warpqem.usd.commands.option_values import read_options
    from warpqem.usd.commands.report_page import write_simplify_report
    from warpqem.usd.commands.simplify_meshes import DEFAULT_FPS, simplify_mesh_files

    asked = read_options(options)
    if page is not None:
        check_page_path(page)
    limit = None if asked.memory is None else parse_bytes(asked.memory)
    with limited_memory(limit), progress_bar("reading") as progress:
        others = named_outputs({"--report": page, "--json": json})

        def write_page(report: StageReport) -> None:
            if page is not None and report.output is not None:
                write_simplify_report(page, report, asked, progress)

        shared: dict[str, Any] = {
            "progress": progress,
            "announce": _print_plan if verbose else None,
            "other_outputs": others,
        }
        if is_animated_gltf(input_file):
            if fps is not None:
                raise OptionError("--fps is for mesh files; an animated glTF file has times of its own")
            report = simplify_gltf(input_file, output, asked, before_end=write_page, **shared)
        elif is_mesh_name(input_file):
            rate = DEFAULT_FPS if fps is None else fps
            report = simplify_mesh_files(input_file, output, asked, fps=rate, before_end=write_page, **shared)
        else:
            if fps is not None:
                raise OptionError("--fps is for mesh files; a USD file has a rate of its own")
            report = simplify_stage(input_file, output, asked, **shared)
            write_page(report)
    for kind, text in grouped_lines(report.to_dict(), each=verbose > 0):
        print_message(kind, text)
    if not quiet:
        is_many = len({prim.path for prim in report.prims}) > MANY_MESHES and not verbose
        print_table(_table(report, WORST_MESHES if is_many else None, path_width(json == "-")), to_stderr=json == "-")
    if json is not None:
        write_json(json, report.to_dict())
    if not quiet:
        _print_written(report, page, json)
    if report.failed:
        raise typer.Exit(EXIT_FAILED)


def _print_plan(name: str, plan: MemoryPlan) -> None:
    print_message("plan", f"{name}: {plan}")


def _print_written(report: StageReport, page: str | None, json: str | None) -> None:
    """The last line: what was written, and how large it is."""
    files = report.outputs if len(report.outputs) <= MAX_NAMED else [report.outputs[0], report.outputs[-1]]
    named = [f"{path}, {file_size(path)}" for path in files if file_size(path)]
    if len(report.outputs) > MAX_NAMED:
        named.insert(1, f"{len(report.outputs) - 2} more")
    others = {"report": page if report.output else None, "JSON": json if json != "-" else None}
    named += [f"{what} {path}" for what, path in others.items() if path is not None]
    if named:
        print(f"wrote {printable('; '.join(named))}", file=sys.stderr)


def _level(prim: PrimReport) -> str:
    """Name of the level of detail, empty where there are none."""
    from warpqem.usd.commands.lods import LevelReport

    return prim.level if isinstance(prim, LevelReport) else ""


def _table(report: StageReport, most: int | None = None, width: int = WIDEST) -> PlainTable:
    """The meshes, of many the ``most`` worst ones; their paths have so many characters."""
    table = PlainTable(f"{report.input} -> {_named(report.outputs) or 'nothing written'}")
    levels, worst_first = list(dict.fromkeys(map(_level, report.prims))), report.worst_first
    if any(levels):
        table.add_column("level")
    table.add_column("mesh", overflow="fold")
    measured = any(prim.measured for prim in report.prims)
    errors = ("RMS %", "Hausdorff %", "flips") if measured else ("estimate %",)
    rig = _rig_columns(report.prims)
    for name in ("frames", "faces before", "faces after", *rig, *errors):
        table.add_column(name, justify="right")
    if measured:
        table.add_column("verdict")
    table.add_column("stopped", overflow="ellipsis")
    table.add_column("s", justify="right")
    for level in levels:
        prims = [prim for prim in worst_first if _level(prim) == level]
        rows = [_row(prim, measured, rig) for prim in prims[:most]]
        if len(prims) > 1:
            rows.append(_total(prims, measured, rig))
        for index, row in enumerate(rows):
            # The total stands apart from its meshes, and each level from the next.
            end_section = index == len(rows) - 1 or (len(prims) > 1 and index == len(rows) - 2)
            shown = [shortened_path(row[0], width), *map(with_separators, row[1:])]
            table.add_row(*([level] if level else []), *shown, end_section=end_section)
    for prim in worst_first if most is None else ():
        if prim.measured is not None and prim.measured["reason"]:
            level = f"{_level(prim)}: " if _level(prim) else ""
            path = shortened_path(prim.path, max(width, NOTE_WIDTH))
            table.add_note(f"{prim.measured['verdict']}: {level}{path}: {prim.measured['reason']}")
    if most is not None:
        found = Counter(prim.measured["verdict"] for prim in worst_first if prim.measured is not None)
        table.add_note(f"the worst {most}{' of each level' if any(levels) else ''}; all with -v")
        table.add_note(", ".join(f"{count} {verdict}" for verdict, count in found.items()))
    for column in table.columns:
        # Heads wrap, and a row is a line.
        name, cells = str(column.header), [len(str(cell)) for cell in column._cells]
        column.no_wrap = name in ("mesh", "stopped")
        column.min_width = max([*map(len, name.split()), *(cells if name != "stopped" else ())])
    return table


def _named(outputs: list[str]) -> str:
    """The files that were written, of many the first and the last."""
    return ", ".join(outputs) if len(outputs) <= MAX_NAMED else f"{outputs[0]}, ..., {outputs[-1]}"


def _rig_columns(prims: list[PrimReport]) -> tuple[str, ...]:
    """What is said of joints and blend shapes, where some were to go."""
    joints = ("joints", "influences") if any(prim.joints for prim in prims) else ()
    return (*joints, "shapes") if any(prim.shapes for prim in prims) else joints


def _rig(prim: PrimReport) -> dict[str, str]:
    said = {}
    if prim.joints is not None:
        said["joints"] = f"{prim.joints.after} of {prim.joints.before}"
        said["influences"] = str(prim.joints.influences)
    if prim.shapes is not None:
        said["shapes"] = f"{prim.shapes.after} of {prim.shapes.before}"
    return said


def _total(prims: list[PrimReport], measured: bool, rig: tuple[str, ...]) -> list[str]:
    failed = sum(prim.status == "failed" for prim in prims)
    return [
        f"{len(prims)} meshes",
        "",
        str(sum(prim.faces_before for prim in prims)),
        str(sum(prim.faces_after for prim in prims)),
        *([""] * (len(rig) + (4 if measured else 1))),
        f"{failed} failed" if failed else "",
        f"{sum(prim.seconds for prim in prims):.1f}",
    ]


def _row(prim: PrimReport, measured: bool, rig: tuple[str, ...]) -> list[str]:
    if measured:
        found = prim.measured
        errors = [""] * 4 if found is None else [*map(error_text, (found["rms"], found["hausdorff"], found["flips"]))]
        errors += [] if found is None else [found["verdict"]]
    else:
        errors = ["" if prim.estimate is None else error_text(prim.estimate)]
    stopped = prim.stopped if prim.status == "simplified" else prim.status
    counts = [str(count) if prim.frames else "" for count in (prim.frames, prim.faces_before, prim.faces_after)]
    rigged = [_rig(prim).get(name, "") for name in rig]
    return [prim.path, *counts, *rigged, *errors, stopped or "", f"{prim.seconds:.1f}"]
