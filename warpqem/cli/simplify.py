"""`warpqem simplify`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from warpqem.cli.console import (
    EXIT_FAILED,
    PlainTable,
    error_text,
    load_usd,
    print_message,
    print_table,
    progress_bar,
    quiet_libraries,
    write_json,
)
from warpqem.cli.option_parameters import takes_options
from warpqem.cli.parameters import JsonReport, MeshInput, MeshOutput, ReportPage
from warpqem.usd.commands.simplify_options import SimplifyOptions

if TYPE_CHECKING:
    from warpqem.pipeline.memory_plan import MemoryPlan
    from warpqem.usd.write.stage_report import PrimReport, StageReport

__all__ = ["EXAMPLES", "run_simplify", "simplify"]

# Under its help; tests run them.
EXAMPLES = (
    "warpqem simplify quadruped_gallop.usdc -o out.usdc --ratio 0.1 --report out.html",
    "warpqem simplify cape_wind.usdc -o cape.usda --max-error 0.2 --lock-borders",
    "warpqem simplify cape_wind.usdc -o far.usda --screen-error 1 --distance 10",
    "warpqem simplify cape_wind.usdc -o levels.usda --lods 0.5,0.2,0.05",
)

# Outputs that a title names.
MAX_NAMED = 4


@takes_options(SimplifyOptions)
def simplify(
    input_file: MeshInput,
    output: MeshOutput,
    options: dict[str, Any],
    fps: Annotated[
        float | None,
        typer.Option(
            hidden=True,
            help="With mesh files as IN: frames per second; their numbers are the time codes. [default: 24]",
        ),
    ] = None,
    report: ReportPage = None,
    json: JsonReport = None,
) -> None:
    """Simplify every mesh over all its frames.

    Give a count (--ratio or --faces), limits (--max-error, --max-distance, --screen-error), or both; or --lods.

    OUT is a small layer over IN that holds the new meshes; keep the two files together, or use --flatten, or name OUT
    as a package (.usdz), which holds all that it needs. Primvars, normals, subsets, skins and blend shapes come along.
    What does not fit the new meshes is removed, with a warning.

    IN may be mesh files, too, one for each frame, such as 'horse-*.ply' in quotes (OBJ, PLY, STL, OFF, GLB, ...): the
    frames of one mesh. OUT is then a file of its own, or mesh files again, such as out/horse_####.ply.

    Exit codes: 0 all done; 1 an error, or some mesh failed; 2 wrong usage; 130 interrupted.
    """
    run_simplify(input_file, output, options, report, json, fps)


def run_simplify(
    input_file: str,
    output: str,
    options: dict[str, Any],
    page: str | None,
    json: str | None,
    fps: float | None = None,
) -> None:
    """Simplify, and say what came of it."""
    quiet_libraries()
    load_usd()
    from warpqem.errors import OptionError
    from warpqem.files.outputs import named_outputs
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

        shared: dict[str, Any] = {"progress": progress, "announce": _print_plan, "other_outputs": others}
        if is_mesh_name(input_file):
            rate = DEFAULT_FPS if fps is None else fps
            report = simplify_mesh_files(input_file, output, asked, fps=rate, before_end=write_page, **shared)
        else:
            if fps is not None:
                raise OptionError("--fps is for mesh files; a USD file has a rate of its own")
            report = simplify_stage(input_file, output, asked, **shared)
            write_page(report)
    _print_problems(report)
    print_table(_table(report), to_stderr=json == "-")
    if json is not None:
        write_json(json, report.to_dict())
    if report.failed:
        raise typer.Exit(EXIT_FAILED)


def _print_plan(name: str, plan: MemoryPlan) -> None:
    print_message("plan", f"{name}: {plan}")


def _level(prim: PrimReport) -> str:
    """Name of the level of detail, empty where there are none."""
    from warpqem.usd.commands.lods import LevelReport

    return prim.level if isinstance(prim, LevelReport) else ""


def _print_problems(report: StageReport) -> None:
    from warpqem.measure.verdict import WARNING_DISTANCE

    for problem in report.problems:
        print_message("warning", problem)
    for note in report.notes:
        print_message("note", note)
    for problem in dict.fromkeys(text for prim in report.prims for text in prim.problems):
        print_message("warning", problem)
    for note in dict.fromkeys(text for prim in report.prims for text in prim.notes):
        print_message("note", note)
    for prim in report.prims:
        level = f"{_level(prim)}: " if _level(prim) else ""
        if prim.dropped:
            print_message(
                "warning", f"{level}{prim.path}: dropped, does not fit the new mesh: {', '.join(prim.dropped)}"
            )
        for line in _gone(prim):
            print_message("note", f"{level}{prim.path}: {line}")
        if prim.symmetry not in (None, "kept"):
            print_message("warning", f"{level}{prim.path}: not kept symmetric: {prim.symmetry}")
        if prim.status == "simplified" and prim.stopped == "no legal collapse":
            print_message(
                "warning", f"{level}{prim.path}: stopped at {prim.faces_after} faces, no legal collapse is left"
            )
        if prim.status == "kept" and prim.message and prim.message.startswith("no geometry"):
            print_message("note", f"{prim.path}: kept: {prim.message}")
        if prim.measured is not None and prim.measured["hausdorff"] > WARNING_DISTANCE:
            print_message("warning", f"{level}{prim.path}: {_distance(prim.measured)}")
        if prim.status == "failed":
            print_message("error", level + (prim.message or prim.path))
    _print_small(report)
    if report.output is None:
        print_message("error", f"nothing written: no mesh of {report.input} could be simplified")


def _gone(prim: PrimReport) -> list[str]:
    """What went of joints and blend shapes, by name."""
    lines = []
    if prim.joints is not None and prim.joints.removed:
        added = f"{prim.joints.added_error:.3g} % of the diagonal to the RMS distance over the poses"
        lines.append(f"without the joints {', '.join(prim.joints.removed)}, which adds {added} (in quadrature)")
    if prim.shapes is not None and prim.shapes.removed:
        lines.append(
            f"without the blend shapes {', '.join(prim.shapes.removed)}; {len(prim.shapes.merged)} of them go on in "
            f"others. RMS distance by this: {prim.shapes.used_error:.3g} % of the diagonal over the animation, "
            f"{prim.shapes.random_error:.3g} % over random weights"
        )
    return lines


def _print_small(report: StageReport) -> None:
    """Name the meshes that stopped early in one line: on a stage of small props it is most of them."""
    stopped = list(dict.fromkeys(prim.path for prim in report.prims if prim.stopped == "max_size_error"))
    if stopped:
        more = f" and {len(stopped) - 1} more" if len(stopped) > 1 else ""
        print_message("note", f"{stopped[0]}{more}: keeps more faces, as the error would pass --max-size-error")


def _table(report: StageReport) -> PlainTable:
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
    table.add_column("stopped")
    table.add_column("seconds", justify="right")
    for level in levels:
        prims = [prim for prim in worst_first if _level(prim) == level]
        rows = [_row(prim, measured, rig) for prim in prims]
        if len(prims) > 1:
            rows.append(_total(prims, measured, rig))
        for index, row in enumerate(rows):
            # The total stands apart from its meshes, and each level from the next.
            end_section = index == len(rows) - 1 or (len(prims) > 1 and index == len(prims) - 1)
            table.add_row(*([level] if level else []), *row, end_section=end_section)
    for prim in worst_first:
        if prim.measured is not None and prim.measured["reason"]:
            level = f"{_level(prim)}: " if _level(prim) else ""
            table.add_note(f"{prim.measured['verdict']}: {level}{prim.path}: {prim.measured['reason']}")
    return table


def _named(outputs: list[str]) -> str:
    """The files that were written, of many the first and the last."""
    return ", ".join(outputs) if len(outputs) <= MAX_NAMED else f"{outputs[0]}, ..., {outputs[-1]}"


def _distance(measured: dict[str, Any]) -> str:
    """How far a mesh is off, for a warning."""
    percent, length = measured["hausdorff"], measured["hausdorff_length"]
    return f"a point is up to {percent:.4g} % of the diagonal ({length:.4g} units) off"


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
