"""What a batch shows while it runs, and at its end."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

from rich.console import Console
from rich.progress import TaskID

from warpqem.batching.engine import Finished, Progressed, Started, Update
from warpqem.batching.job_result import DONE, FAILED, PARTIAL, SKIPPED, BatchResult, report_of
from warpqem.batching.jobs import BatchJob
from warpqem.batching.journal import Journal
from warpqem.cli import messages
from warpqem.cli.batch_messages import failure_text, has_losses
from warpqem.cli.message_groups import file_size
from warpqem.cli.progress_bar import QuietProgress, bar_columns
from warpqem.cli.tables import PlainTable
from warpqem.costs.screen_error import ScreenView
from warpqem.files.file_kinds import kind_of
from warpqem.printable import printable
from warpqem.usd.commands.option_conflicts import GOALS

__all__ = ["BatchDisplay", "dry_run_table", "summary_table"]

# What an asset counts for in the time that is left beside its bytes: to open the smallest takes time too.
BYTES_FOR_OPENING = 2**16
# Failed assets that the closing table names; messages about all of them were printed before.
MAX_NAMED = 20
# Meshes whose verdict is not good that it names, the worst first.
MAX_WORST = 5
# In the order of the closing table.
STATUSES = (DONE, PARTIAL, SKIPPED, FAILED)
# Columns that a terminal without room for all shows last.
SUMMARY_RANKS = {"most memory MB": 3, "process seconds": 2, "faces x frames": 1}


class BatchDisplay:
    """Live progress on stderr; nothing where that is not a terminal."""

    def __init__(self, jobs: Sequence[BatchJob]) -> None:
        console = Console(stderr=True)
        is_hidden = not console.is_terminal or messages.quiet
        self._progress = QuietProgress(*bar_columns(), console=console, transient=True, expand=True, disable=is_hidden)
        self._weights = {job.output: _weight(job) for job in jobs}
        self._count, self._done, self._failed, self._face_frames = len(jobs), 0, 0, 0
        # Until the first asset begins, processes start and kernels are compiled or loaded.
        self._all = self._progress.add_task(
            "starting, kernels are compiled the first time", total=sum(self._weights.values()) or 1
        )
        self._running: dict[str, TaskID] = {}
        self._start = time.perf_counter()

    def __enter__(self) -> BatchDisplay:
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.stop()

    @property
    def seconds(self) -> float:
        """Since the beginning."""
        return time.perf_counter() - self._start

    def update(self, update: Update) -> None:
        """Show an update of the engine."""
        output = update.job.output
        if isinstance(update, Started):
            if output not in self._running:
                self._running[output] = self._progress.add_task(printable(Path(output).name), total=1.0)
        elif isinstance(update, Progressed):
            text = printable(f"{Path(output).name}: {update.text}")
            if output in self._running:
                self._progress.update(self._running[output], completed=update.fraction, description=text)
        elif isinstance(update, Finished):
            self._finish(output, update.result)

    def _finish(self, output: str, result: BatchResult) -> None:
        if output in self._running:
            self._progress.remove_task(self._running.pop(output))
        self._done += 1
        self._failed += not result.ok
        self._face_frames += result.face_frames
        speed = _count(self._face_frames / max(self.seconds, 1e-9))
        failed = f", {self._failed} failed" if self._failed else ""
        text = f"{self._done} of {self._count} assets{failed}, {speed} faces x frames/s"
        self._progress.update(self._all, advance=self._weights[output], description=text)


def dry_run_table(jobs: Sequence[BatchJob], journal: Path | None) -> PlainTable:
    """What would be done.

    Args:
        jobs: The jobs.
        journal: Where to look for what is done; None to take nothing as done.
    """
    done: set[str] = set()
    if journal is not None and journal.exists():
        with Journal(journal) as notes:
            done = {job.output for job in jobs if notes.is_done(job)}
    table = PlainTable(f"{len(jobs) - len(done):,} of {len(jobs):,} assets to be done")
    for name in ("input", "output"):
        table.add_column(name, is_path=True)
    table.add_column("size", "right", rank=1)
    table.add_column("goal")
    table.add_column("state")
    for job in jobs:
        table.add_row(*_dry_run_row(job, job.output in done))
    return table


def _dry_run_row(job: BatchJob, is_done: bool) -> tuple[str, ...]:
    state = "is done" if is_done else "to do" if os.path.isfile(job.input) else kind_of(job.input) or "no such file"
    return job.input, job.output, file_size(job.input), _goal(job), state


def _goal(job: BatchJob) -> str:
    """How far an asset is to be simplified, in the words of the command line."""
    return ", ".join(
        f"{name.replace('_', ' ')} {_value(getattr(job.options, name))}"
        for name in GOALS
        if getattr(job.options, name) not in (None, ())
    )


def _value(value: object) -> str:
    if isinstance(value, tuple):
        return ",".join(map(_value, value))
    if isinstance(value, ScreenView):
        return f"{value.error:g} px"
    return f"{value:g}" if isinstance(value, float) else str(value)


def summary_table(results: Sequence[BatchResult], job_count: int, seconds: float) -> PlainTable:
    """How a batch ended, with the reasons of the assets that failed."""
    table = PlainTable(f"{len(results):,} of {job_count:,} assets in {seconds:,.1f} s")
    table.add_column("")
    for name in ("assets", "faces before", "faces after", "faces x frames", "process seconds", "most memory MB"):
        table.add_column(name, "right", rank=SUMMARY_RANKS.get(name, 0))
    found = {status: [result for result in results if result.status == status] for status in STATUSES}
    rows = [_summary_row(status, some) for status, some in found.items() if some]
    if len(rows) > 1:
        rows.append(_summary_row("total", results))
    for index, row in enumerate(rows):
        table.add_row(*row, end_section=len(rows) > 1 and index == len(rows) - 2)
    _add_verdicts(table, results)
    losing = sum(map(has_losses, results))
    if losing:
        table.add_note(f"{losing} of {len(results)} assets lost what does not fit the new meshes, named above")
    bad = [result for result in results if not result.ok]
    for result in bad[:MAX_NAMED]:
        table.add_note(f"{result.status}: {failure_text(result)}")
    if len(bad) > MAX_NAMED:
        table.add_note(f"and {len(bad) - MAX_NAMED} more that failed, all named above")
    return table


def _summary_row(name: str, results: Sequence[BatchResult]) -> list[str | int]:
    peak = max((result.peak_memory or 0 for result in results), default=0)
    return [
        name,
        len(results),
        sum(result.faces for result in results),
        sum(result.faces_after for result in results),
        _count(sum(result.face_frames for result in results)),
        f"{sum(result.seconds for result in results):,.1f}",
        peak >> 20 if peak else "",
    ]


def _add_verdicts(table: PlainTable, results: Sequence[BatchResult]) -> None:
    """How many meshes are good, and the worst of the others."""
    from warpqem.measure.verdict import WORDS, rank

    found = [
        (result.input, prim["path"], prim["measured"])
        for result in results
        for prim in report_of(result).get("prims", [])
        if prim.get("measured")
    ]
    if not found:
        return
    counts = Counter(measured["verdict"] for _, _, measured in found)
    table.add_note("meshes: " + ", ".join(f"{counts[word]} {word}" for word in WORDS if counts[word]))
    wanting = [entry for entry in found if entry[2]["reason"]]
    wanting.sort(key=lambda entry: rank(entry[2]["verdict"], entry[2]["hausdorff"]))
    for source, path, measured in wanting[:MAX_WORST]:
        table.add_note(f"{measured['verdict']}: {source}: {path}: {measured['reason']}")
    if len(wanting) > MAX_WORST:
        table.add_note(f"and {len(wanting) - MAX_WORST} more that are not good, see --json")


def _weight(job: BatchJob) -> int:
    try:
        return os.path.getsize(job.input) + BYTES_FOR_OPENING
    except OSError:
        return BYTES_FOR_OPENING


def _count(value: float) -> str:
    for size, suffix in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if value >= size:
            return f"{value / size:.3g} {suffix}"
    return f"{value:.3g}"
