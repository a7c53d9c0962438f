"""`warpqem batch`."""

from __future__ import annotations

import json as json_lines
import logging
import sys
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from enum import Enum
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from warpqem.arguments.limits import ABOVE_0, COUNT, Limits
from warpqem.cli.console import EXIT_FAILED, EXIT_INTERRUPTED, print_message
from warpqem.cli.crash_guard import interruptible
from warpqem.cli.loading import loading
from warpqem.cli.logs import LogJson, start_logging, takes_verbosity
from warpqem.cli.number_parameters import number, whole
from warpqem.cli.option_parameters import takes_options
from warpqem.cli.progress_bar import progress_bar
from warpqem.cli.tables import print_table
from warpqem.errors import OptionError, StageError
from warpqem.usd.commands.simplify_options import SimplifyOptions

if TYPE_CHECKING:
    from warpqem.batching.engine import Engine
    from warpqem.batching.job_result import BatchResult
    from warpqem.batching.jobs import BatchJob
    from warpqem.batching.manifest import Manifest, WrongLine

__all__ = ["EXAMPLES", "batch"]

# Under its help; tests run them.
EXAMPLES = (
    "warpqem batch 'talking*.usdc' cape_wind.usdc -o small --ratio 0.2 --jobs 1 --json results.jsonl",
    "warpqem batch 'talking*.usdc' cape_wind.usdc -o small --ratio 0.2 --resume",
)


class EngineName(str, Enum):
    """Where assets are done."""

    local = "local"
    ray = "ray"


class OutputFormat(str, Enum):
    """Kinds of files to write."""

    usd = "usd"
    usda = "usda"
    usdc = "usdc"
    usdz = "usdz"


@takes_verbosity
@takes_options(SimplifyOptions, hidden=("frames", "prim", "bake", "flatten"))
def batch(
    inputs: Annotated[
        list[str],
        typer.Argument(
            metavar="INPUT...",
            help="USD files, folders, patterns in quotes such as 'shots/**/*.usd', or one manifest (.jsonl, .csv): "
            "lines with input, output and any option by its name.",
        ),
    ],
    output: Annotated[
        str,
        typer.Option(
            "--output",
            "-o",
            metavar="DIR",
            rich_help_panel="Output",
            help="Folder for the outputs; the folders of INPUT are kept.",
        ),
    ],
    options: dict[str, Any],
    output_format: Annotated[
        OutputFormat | None,
        typer.Option(
            "--format",
            hidden=True,
            metavar="usd|usda|usdc|usdz",
            rich_help_panel="Output",
            help="Kind of the outputs; by default that of each input.",
        ),
    ] = None,
    resume: Annotated[
        bool,
        typer.Option(
            "--resume",
            rich_help_panel="Output",
            help="Leave out what is done already from the same files with the same options.",
        ),
    ] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", rich_help_panel="Output", help="Say what would be done, and do nothing.")
    ] = False,
    jobs: Annotated[
        int | None,
        typer.Option(
            metavar="COUNT",
            parser=whole(COUNT),
            rich_help_panel="Machine",
            help="Processes on this machine; by default one for each core, with GPUs no more than four for each.",
        ),
    ] = None,
    timeout: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            parser=number(ABOVE_0, "SECONDS"),
            rich_help_panel="Machine",
            help="Stop an asset that takes longer, and go on without it.",
        ),
    ] = None,
    retries: Annotated[
        int,
        typer.Option(
            hidden=True,
            metavar="COUNT",
            parser=whole(Limits(0)),
            rich_help_panel="Machine",
            help="How often to begin anew what has lost its process.",
        ),
    ] = 1,
    engine: Annotated[
        EngineName,
        typer.Option(
            hidden=True,
            metavar="local|ray",
            rich_help_panel="Machine",
            help="Processes on this machine, or tasks on a Ray cluster.",
        ),
    ] = EngineName.local,
    address: Annotated[
        str | None,
        typer.Option(
            hidden=True,
            metavar="HOST",
            rich_help_panel="Machine",
            help="With --engine ray: the cluster; auto for that of this machine.",
        ),
    ] = None,
    cpus: Annotated[
        float,
        typer.Option(
            hidden=True,
            metavar="CORES",
            parser=number(ABOVE_0),
            rich_help_panel="Machine",
            help="With --engine ray: CPU cores of an asset.",
        ),
    ] = 1.0,
    gpus: Annotated[
        float | None,
        typer.Option(
            hidden=True,
            metavar="GPUS",
            parser=number(Limits(0)),
            rich_help_panel="Machine",
            help="With --engine ray: GPUs of an asset, such as 0.25; by default 1 if any.",
        ),
    ] = None,
    json: Annotated[
        str | None,
        typer.Option(
            "--json",
            metavar="FILE",
            rich_help_panel="Output",
            help="Write a line of JSON for each asset to FILE, or to stdout for -.",
        ),
    ] = None,
    report: Annotated[
        str | None,
        typer.Option(
            "--report",
            metavar="FILE",
            rich_help_panel="Output",
            help="Write an overview (.html) with pictures; it opens offline.",
        ),
    ] = None,
    quiet: bool = False,
    verbose: int = 0,
    log_json: LogJson = None,
) -> None:
    """Simplify many assets, each as `warpqem simplify` does; one that fails costs the others nothing.

    Give goals as to simplify, here or in the manifest.

    Exit codes: 0 all done; 1 an error, or some asset or mesh failed; 2 wrong usage; 130 interrupted.
    """
    with loading():
        from warpqem.batching.jobs import check_jobs
        from warpqem.batching.journal import JOURNAL_NAME
        from warpqem.batching.output_check import check_batch_outputs
        from warpqem.batching.run_batch import batch as run_batch
        from warpqem.cli.batch_display import BatchDisplay, summary_table
        from warpqem.cli.batch_messages import print_written
        from warpqem.files.outputs import InputFile, named_outputs
        from warpqem.report.page import check_page_path

    if report is not None:
        check_page_path(report)
    folder = Path(output)
    work, wrong = _find_jobs(inputs, folder, options, None if output_format is None else f".{output_format.value}")
    journal = folder / JOURNAL_NAME
    others = named_outputs({"--json": json, "--log-json": log_json, "--report": report})
    check_jobs(work, others).check(InputFile(path, "a manifest") for path in _manifests(inputs))
    if dry_run:
        check_batch_outputs(work, [*others, *named_outputs({"journal": journal})])
        _show_plan(work, wrong, journal if resume else None, to_stderr=json == "-")
        return
    chosen = _engine(engine, options, jobs=jobs, timeout=timeout, retries=retries, ray=(address, cpus, gpus))
    display = BatchDisplay(work)
    updates = run_batch(work, chosen, journal=journal, resume=resume, on_update=display.update, other_outputs=others)
    # Nothing has been written up to here.
    start_logging(verbose, log_json)
    _make_folder(folder)
    count = len(work) + len(wrong)
    with interruptible(), _lines(json) as write, display:
        results, interrupted = _collect(wrong, updates, write, verbose > 0)
        seconds = display.seconds
    if not quiet:
        print_table(summary_table(results, count, seconds), to_stderr=json == "-")
    if interrupted:
        print_message("error", f"interrupted after {len(results)} of {count} assets; go on with --resume")
        raise typer.Exit(EXIT_INTERRUPTED)
    if report is not None:
        _write_overview(report, results, options)
    if not quiet:
        print_written(folder, results, report, json)
    if not all(result.ok for result in results):
        raise typer.Exit(EXIT_FAILED)


def _show_plan(work: list[BatchJob], wrong: list[WrongLine], journal: Path | None, to_stderr: bool) -> None:
    """Say what would be done."""
    from warpqem.cli.batch_display import dry_run_table

    for line in wrong:
        print_message("error", line.message)
    print_table(dry_run_table(work, journal), to_stderr)
    if wrong:
        raise typer.Exit(EXIT_FAILED)


def _collect(
    wrong: list[WrongLine],
    updates: Generator[BatchResult, None, None],
    write: Callable[[BatchResult], None],
    each: bool,
) -> tuple[list[BatchResult], bool]:
    """The results of all assets as they come, and whether an interrupt ended that.

    Args:
        wrong: Lines of manifests that are no jobs.
        updates: The results of the others.
        write: Called with each result.
        each: Print a line for each mesh.
    """
    from warpqem.cli.batch_messages import result_lines

    results: list[BatchResult] = []
    try:
        for result in chain((line.result() for line in wrong), updates):
            results.append(result)
            write(result)
            for kind, text in result_lines(result, each):
                print_message(kind, text)
    except KeyboardInterrupt:
        return results, True
    finally:
        updates.close()
    return results, False


def _write_overview(path: str, results: list[BatchResult], options: dict[str, Any]) -> None:
    from warpqem.usd.commands.overview import write_overview

    with progress_bar("drawing") as progress:
        found = [result.to_dict() for result in results]
        write_overview(path, found, tuple(options["prim"] or ()), options["device"], progress)


def _manifests(inputs: list[str]) -> list[str]:
    from warpqem.batching.manifest import MANIFEST_SUFFIXES

    return [text for text in inputs if Path(text).suffix.lower() in MANIFEST_SUFFIXES]


def _find_jobs(
    inputs: list[str], folder: Path, options: dict[str, Any], suffix: str | None
) -> tuple[list[BatchJob], list[WrongLine]]:
    """The jobs, and the lines of manifests without one."""
    from warpqem.batching.jobs import BatchJob, find_files, output_path
    from warpqem.batching.manifest import read_lines
    from warpqem.usd.commands.option_values import read_options

    lists = _manifests(inputs)
    files = [text for text in inputs if text not in lists]
    work: list[BatchJob] = []
    wrong: list[WrongLine] = []
    for path in lists:
        manifest = read_lines(path, folder, options, suffix)
        _check_wrong(manifest, options)
        work += manifest.jobs
        wrong += manifest.wrong
    if files:
        shared = read_options(options)
        for file in find_files(files, leave_out=folder):
            work.append(BatchJob(str(file.path), output_path(folder, file.relative, suffix), shared))
    return work, wrong


def _check_wrong(manifest: Manifest, options: dict[str, Any]) -> None:
    """Refuse a manifest whose lines are wrong by the options of the command line, and with --strict any wrong line.

    Raises:
        OptionError: see above.
    """
    from warpqem.usd.commands.option_values import read_options

    if manifest.wrong and options["strict"]:
        raise OptionError(manifest.wrong[0].message)
    if not manifest.jobs:
        try:
            read_options(options)
        except OptionError as error:
            if all(line.reason == str(error) for line in manifest.wrong):
                raise OptionError(manifest.wrong[0].message) from error


def _engine(
    name: EngineName,
    options: dict[str, Any],
    *,
    jobs: int | None,
    timeout: float | None,
    retries: int,
    ray: tuple[str | None, float, float | None],
) -> Engine:
    if name is EngineName.ray:
        from warpqem.batching.ray_engine import RayEngine

        if jobs is not None:
            raise OptionError("--jobs is for --engine local; on Ray --cpus and --gpus say how many run at once")
        address, cpus, gpus = ray
        return RayEngine(address, cpus, gpus, timeout, options["memory"], retries)
    from warpqem.batching.local_engine import LocalEngine

    if ray != (None, 1.0, None):
        raise OptionError("--address, --cpus and --gpus need --engine ray")
    return LocalEngine(jobs, timeout, options["memory"], retries, options["device"])


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StageError(f"{folder}: the folder cannot be made ({error.strerror})") from error


def _line(result: BatchResult) -> str:
    try:
        return json_lines.dumps(result.to_dict(), allow_nan=False)
    except ValueError:
        # A number of the report is none that JSON has. That must not cost the line, nor the rest of the batch.
        return json_lines.dumps({**result.to_dict(), "report": None}, allow_nan=False)


@contextmanager
def _lines(target: str | None) -> Iterator[Callable[[BatchResult], None]]:
    """A function that writes a result as a line."""
    if target is None:
        yield lambda result: None
        return
    try:
        file = sys.stdout if target == "-" else open(target, "w", encoding="utf-8")  # noqa: SIM115
    except OSError as error:
        raise StageError(f"{target}: cannot be written ({error.strerror})") from error

    def write(result: BatchResult) -> None:
        try:
            file.write(_line(result) + "\n")
            file.flush()
        except OSError as error:
            logging.getLogger(__name__).error("%s: cannot be written (%s)", target, error.strerror)

    try:
        yield write
    finally:
        if file is not sys.stdout:
            file.close()
