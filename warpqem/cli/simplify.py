"""`warpqem simplify`."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any

import typer

from warpqem.arguments.limits import ABOVE_0
from warpqem.cli.console import EXIT_FAILED, print_message, write_json
from warpqem.cli.loading import loading
from warpqem.cli.logs import takes_verbosity
from warpqem.cli.message_groups import file_size
from warpqem.cli.number_parameters import number
from warpqem.cli.option_parameters import takes_options
from warpqem.cli.parameters import JsonReport, MeshInput, MeshOutput, ReportPage
from warpqem.cli.problem_lines import grouped_lines
from warpqem.cli.progress_bar import progress_bar
from warpqem.cli.simplify_table import MAX_NAMED, simplify_table
from warpqem.cli.tables import print_table
from warpqem.printable import printable
from warpqem.usd.commands.simplify_options import SimplifyOptions

if TYPE_CHECKING:
    from warpqem.pipeline.memory_plan import MemoryPlan
    from warpqem.usd.write.stage_report import StageReport

__all__ = ["EXAMPLES", "run_simplify", "simplify"]

# Under its help; tests run them.
EXAMPLES = (
    "warpqem simplify quadruped_gallop.usdc -o out.usdc --ratio 0.1 --report a.html",
    "warpqem simplify cape_wind.usdc -o cape.usda --max-error 0.2 --lock-borders",
    "warpqem simplify cape_wind.usdc -o levels.usda --lods 0.5,0.2,0.05",
)


@takes_verbosity
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
            parser=number(ABOVE_0),
            rich_help_panel="Input",
            help="With mesh files as IN: frames per second; their numbers are the time codes. [default: 24]",
        ),
    ] = None,
    report: ReportPage = None,
    json: JsonReport = None,
    quiet: bool = False,
    verbose: int = 0,
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
    with progress_bar("loading") as progress:
        report = _simplified(input_file, output, options, page, json, fps, _print_plan if verbose else None, progress)
    for kind, text in grouped_lines(report.to_dict(), each=verbose > 0):
        print_message(kind, text)
    if not quiet:
        print_table(simplify_table(report, all_meshes=verbose > 0), to_stderr=json == "-")
    if json is not None:
        write_json(json, report.to_dict())
    if not quiet:
        _print_written(report, page, json)
    if report.failed:
        raise typer.Exit(EXIT_FAILED)


def _simplified(
    input_file: str,
    output: str,
    options: dict[str, Any],
    page: str | None,
    json: str | None,
    fps: float | None,
    announce: Callable[[str, MemoryPlan], None] | None,
    progress: Callable[[float, str], None],
) -> StageReport:
    """Simplify a file of any kind, and write the page of its report."""
    with loading():
        from warpqem.errors import OptionError
        from warpqem.files.outputs import named_outputs
        from warpqem.gltf.inventory import is_animated_gltf
        from warpqem.mesh_files.file_names import is_mesh_name
        from warpqem.runtime.memory import parse_bytes
        from warpqem.runtime.process_memory import limited_memory
        from warpqem.usd import simplify_stage
        from warpqem.usd.commands.option_values import read_options

    asked = read_options(options)
    if page is not None:
        with loading():
            from warpqem.report.page import check_page_path

        check_page_path(page)

    def write_page(report: StageReport) -> None:
        if page is not None and report.output is not None:
            from warpqem.usd.commands.report_page import write_simplify_report

            write_simplify_report(page, report, asked, progress)

    progress(0.0, "reading")
    with limited_memory(None if asked.memory is None else parse_bytes(asked.memory)):
        others = named_outputs({"--report": page, "--json": json})
        shared: dict[str, Any] = {"progress": progress, "announce": announce, "other_outputs": others}
        if is_animated_gltf(input_file):
            if fps is not None:
                raise OptionError("--fps is for mesh files; an animated glTF file has times of its own")
            from warpqem.gltf.simplify import simplify_gltf

            return simplify_gltf(input_file, output, asked, before_end=write_page, **shared)
        if is_mesh_name(input_file):
            from warpqem.usd.commands.simplify_meshes import DEFAULT_FPS, simplify_mesh_files

            rate = DEFAULT_FPS if fps is None else fps
            return simplify_mesh_files(input_file, output, asked, fps=rate, before_end=write_page, **shared)
        if fps is not None:
            raise OptionError("--fps is for mesh files; a USD file has a rate of its own")
        report = simplify_stage(input_file, output, asked, **shared)
        write_page(report)
        return report


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
