"""What a batch prints of each asset: the lines of `warpqem simplify`, each with its file in front."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import warpqem.errors
from warpqem.batching.engine import TIMED_OUT, WORKER_LOST
from warpqem.batching.job_result import DONE, PARTIAL, BatchResult, report_of
from warpqem.cli.flag_names import flags_of_options, with_flags
from warpqem.cli.message_groups import files_size
from warpqem.cli.problem_lines import grouped_lines
from warpqem.printable import printable
from warpqem.usd.commands.simplify_options import SimplifyOptions

__all__ = ["failure_text", "has_losses", "print_written", "result_lines"]

# Notes and warnings of one asset that are shown; errors and losses are shown all.
MAX_LINES = 20
# Errors whose message says all; of others, which are defects or come from libraries, the name is shown, too.
PLAIN_ERRORS = {*warpqem.errors.__all__, MemoryError.__name__, TIMED_OUT, WORKER_LOST}
# Begins a message about what is lost.
LOSS = "dropped, does not fit"


def has_losses(result: BatchResult) -> bool:
    """Whether something of an asset did not fit a new mesh."""
    return any(prim["dropped"] for prim in _prims(result))


def failure_text(result: BatchResult) -> str:
    """Why an asset failed, with its file."""
    message = with_flags(result.message or result.input, flags_of_options(SimplifyOptions))
    return message if result.error in PLAIN_ERRORS else f"{result.error}: {message}"


def result_lines(result: BatchResult, each: bool = False) -> list[tuple[str, str]]:
    """Kinds and texts of what to print of an asset.

    Args:
        result: What became of it.
        each: With a line for each mesh; otherwise meshes of which the same is said share one.
    """
    report = report_of(result)
    if not report:
        return [] if result.ok else [("error", failure_text(result))]
    lines = grouped_lines(report, each)
    shown = lines
    if not each:
        short = [line for line in lines if line[0] != "error" and LOSS not in line[1]]
        left_out = set(short[MAX_LINES:])
        shown = [line for line in lines if line not in left_out]
        if left_out:
            shown.append(("note", f"and {len(left_out)} more notes, see --json"))
    return [(kind, text if result.input in text else f"{result.input}: {text}") for kind, text in shown]


def print_written(folder: Path, results: Sequence[BatchResult], page: str | None, json: str | None) -> None:
    """The last line: what was written, and how large it is."""
    made = [result for result in results if result.status in (DONE, PARTIAL)]
    files = [file for result in made for file in report_of(result).get("outputs") or [result.output]]
    count = f"{len(files):,} file{'' if len(files) == 1 else 's'} in {folder}"
    named = [f"{count}, {files_size(files)}"] if files else []
    others = {"report": page, "JSON": json if json != "-" else None}
    named += [f"{what} {path}" for what, path in others.items() if path is not None]
    if named:
        print(f"wrote {printable('; '.join(named))}", file=sys.stderr)


def _prims(result: BatchResult) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = report_of(result).get("prims", [])
    return found
