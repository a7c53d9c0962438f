"""Lists of assets with options of their own, as JSON Lines or CSV."""

from __future__ import annotations

import codecs
import csv
import io
import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from warpqem.batching.job_result import FAILED, BatchResult
from warpqem.batching.jobs import BatchJob, output_path
from warpqem.errors import OptionError
from warpqem.files.file_kinds import check_regular
from warpqem.printable import FIRST_BYTE, LAST_BYTE
from warpqem.usd.commands.option_values import override_options, read_options

__all__ = ["MANIFEST_SUFFIXES", "Manifest", "WrongLine", "read_lines", "read_manifest"]

MANIFEST_SUFFIXES = (".jsonl", ".ndjson", ".csv")
# Columns that are no options.
INPUT, OUTPUT = "input", "output"
# Lines that one row of CSV may go over, by quoted line breaks; a quote that is never closed costs one line.
MAX_ROW_LINES = 100


@dataclass(frozen=True)
class WrongLine:
    """A line of a manifest that no job can be made of.

    Attributes:
        manifest: The file.
        line: Its number, from 1.
        reason: What is wrong with it.
        input: The input it names, as far as it does.
    """

    manifest: str
    line: int
    reason: str
    input: str | None = None

    @property
    def message(self) -> str:
        """Which line, and what is wrong with it."""
        return f"manifest {self.manifest}, line {self.line}: {self.reason}"

    def result(self) -> BatchResult:
        """The line as an asset that failed."""
        return BatchResult(
            self.input or self.manifest, "", FAILED, error=OptionError.__name__, message=self.message, attempts=0
        )


@dataclass(frozen=True)
class Manifest:
    """What is in a manifest.

    Attributes:
        jobs: The jobs of its lines.
        wrong: Lines without one.
    """

    jobs: list[BatchJob]
    wrong: list[WrongLine]


def read_manifest(
    path: str | os.PathLike[str], folder: Path, options: Mapping[str, Any], suffix: str | None = None
) -> list[BatchJob]:
    """Read the jobs of a manifest of which every line is right; see `read_lines`.

    Raises:
        OptionError: the file cannot be read, or a line is wrong; the message names the line.
    """
    manifest = read_lines(path, folder, options, suffix)
    if manifest.wrong:
        raise OptionError(manifest.wrong[0].message)
    return manifest.jobs


def read_lines(
    path: str | os.PathLike[str], folder: Path, options: Mapping[str, Any], suffix: str | None = None
) -> Manifest:
    """Read a manifest, and find the lines that are wrong.

    Each line or row has `input`, a path that is relative to the manifest, may have `output`, a path below the output
    folder, and may have any option of `warpqem simplify` by its name.

    Args:
        path: A file of JSON objects, one a line, or a CSV file with a header.
        folder: The folder of the outputs.
        options: Values of the options for lines that do not say otherwise.
        suffix: Suffix of outputs that are not named; None for that of the input.

    Raises:
        OptionError: the file cannot be read, names no asset, or is CSV with a wrong header.
    """
    path = Path(path)
    name = os.fspath(path)
    check_regular(path, OptionError, f"manifest {name}")
    try:
        # Bytes that are no UTF-8 are found in the line they are in.
        text = path.read_bytes().removeprefix(codecs.BOM_UTF8).decode("utf-8", "surrogateescape")
    except OSError as error:
        raise OptionError(f"manifest {name}: cannot be read ({error.strerror})") from error
    jobs: dict[int, BatchJob] = {}
    wrong: list[WrongLine] = []
    for line, row in (_csv_rows if path.suffix.lower() == ".csv" else _json_rows)(name, text):
        try:
            jobs[line] = _job(row, path.absolute().parent, folder, options, suffix)
        except OptionError as error:
            source = row.get(INPUT) if isinstance(row, Mapping) else None
            named = os.path.abspath(path.absolute().parent / source) if isinstance(source, str) and source else None
            wrong.append(WrongLine(name, line, str(error), named))
    wrong += _collisions(name, jobs)
    if not jobs and not wrong:
        raise OptionError(f"manifest {name}: it names no asset")
    return Manifest(list(jobs.values()), sorted(wrong, key=lambda one: one.line))


def _collisions(name: str, jobs: dict[int, BatchJob]) -> list[WrongLine]:
    """Take out the jobs that would write over an input, or over the output of an earlier line."""
    inputs = {os.path.realpath(job.input) for job in jobs.values()}
    writers: dict[str, int] = {}
    wrong = []
    for line, job in list(jobs.items()):
        place = os.path.realpath(job.output)
        if place in inputs:
            reason = f"output {job.output}: this is an input, which is never overwritten"
        elif place in writers:
            reason = f"output {job.output}: line {writers[place]} writes it, too"
        else:
            writers[place] = line
            continue
        wrong.append(WrongLine(name, line, reason, job.input))
        del jobs[line]
    return wrong


def _job(
    row: Mapping[str, Any] | OptionError, base: Path, folder: Path, options: Mapping[str, Any], suffix: str | None
) -> BatchJob:
    if isinstance(row, OptionError):
        raise row
    source = row.get(INPUT)
    if not isinstance(source, str) or not source:
        raise OptionError("there is no input")
    _check_path(INPUT, source)
    given = override_options(options, {name: value for name, value in row.items() if name not in (INPUT, OUTPUT)})
    output = _output(row.get(OUTPUT), source, folder, suffix)
    return BatchJob(os.path.abspath(base / source), output, read_options(given))


def _output(output: Any, source: str, folder: Path, suffix: str | None) -> str:
    if output in (None, ""):
        # An input beside or below the manifest keeps its place; one from elsewhere has none to keep.
        relative = Path(os.path.normpath(source))
        outside = relative.is_absolute() or relative.parts[0] == ".."
        return output_path(folder, Path(relative.name) if outside else relative, suffix)
    if not isinstance(output, str):
        raise OptionError(f"output {output!r}: expected a path")
    _check_path(OUTPUT, output)
    place = os.path.abspath(folder / output)
    if not Path(place).is_relative_to(folder.absolute()):
        raise OptionError(f"output {output}: outside of {folder}")
    return place


def _check_path(name: str, path: str) -> None:
    """Refuse what no system has files of the name of."""
    try:
        os.fsencode(path)
    except UnicodeEncodeError as error:
        raise OptionError(f"{name} {path!r}: no name of a file ({error.reason})") from error
    if "\0" in path:
        raise OptionError(f"{name} {path!r}: no name of a file (it holds a zero byte)")


def _check_text(text: str) -> None:
    if any(FIRST_BYTE <= ord(character) <= LAST_BYTE for character in text):
        raise OptionError("bytes that are no UTF-8")


def _json_rows(name: str, text: str) -> Iterator[tuple[int, Mapping[str, Any] | OptionError]]:
    for number, line in enumerate(text.split("\n"), start=1):
        if line.strip():
            yield number, _json_row(line)


def _json_row(line: str) -> Mapping[str, Any] | OptionError:
    try:
        _check_text(line)
        row = json.loads(line)
    except OptionError as error:
        return error
    except (ValueError, RecursionError) as error:
        return OptionError(f"no JSON ({error})")
    if not isinstance(row, dict):
        return OptionError('expected an object, such as {"input": "a.usd"}')
    return row


def _csv_rows(name: str, text: str) -> Iterator[tuple[int, Mapping[str, Any] | OptionError]]:
    """Rows by the number of the line they begin in; after one that is no CSV the next line begins a row."""
    lines = list(io.StringIO(text, newline=None))
    head: list[str] | None = None
    at = 0
    while at < len(lines):
        number = at + 1
        reader = csv.reader(lines[at : at + MAX_ROW_LINES], strict=True)
        try:
            values = next(reader)
            at += reader.line_num
            _check_text("".join(values))
        except (csv.Error, OptionError) as error:
            reason = str(error) if isinstance(error, OptionError) else f"no CSV ({error})"
            if head is None:
                where = f"line {number}, where the names of the columns belong"
                raise OptionError(f"manifest {name}: cannot be read ({where}: {reason})") from error
            at = max(at, number)
            yield number, OptionError(reason)
            continue
        if not any(values):
            continue
        if head is None:
            head = values
        elif len(values) > len(head):
            yield number, OptionError("more values than the header has names")
        else:
            yield number, dict(zip(head, values, strict=False))
