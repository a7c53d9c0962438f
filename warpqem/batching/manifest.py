"""Lists of assets with options of their own, as JSON Lines or CSV."""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from warpqem.batching.jobs import BatchJob, output_path
from warpqem.errors import OptionError
from warpqem.usd.option_values import override_options, read_options

__all__ = ["MANIFEST_SUFFIXES", "read_manifest"]

MANIFEST_SUFFIXES = (".jsonl", ".ndjson", ".csv")
# Columns that are no options.
INPUT, OUTPUT = "input", "output"


def read_manifest(
    path: str | os.PathLike[str], folder: Path, options: Mapping[str, Any], suffix: str | None = None
) -> list[BatchJob]:
    """Read the jobs of a manifest.

    Each line or row has `input`, a path that is relative to the manifest, may have `output`, a path below the output
    folder, and may have any option of `warpqem simplify` by its name.

    Args:
        path: A file of JSON objects, one a line, or a CSV file with a header.
        folder: The folder of the outputs.
        options: Values of the options for lines that do not say otherwise.
        suffix: Suffix of outputs that are not named; None for that of the input.

    Raises:
        OptionError: the file cannot be read, or a line is wrong; the message names the line.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise OptionError(f"manifest {path}: cannot be read ({error})") from error
    jobs = []
    for line, row in (_csv_rows if path.suffix.lower() == ".csv" else _json_rows)(path, text):
        try:
            jobs.append(_job(row, path.absolute().parent, folder, options, suffix))
        except OptionError as error:
            raise OptionError(f"manifest {path}, line {line}: {error}") from error
    if not jobs:
        raise OptionError(f"manifest {path}: it names no asset")
    return jobs


def _job(row: Mapping[str, Any], base: Path, folder: Path, options: Mapping[str, Any], suffix: str | None) -> BatchJob:
    source = row.get(INPUT)
    if not isinstance(source, str) or not source:
        raise OptionError("there is no input")
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
    place = os.path.abspath(folder / output)
    if not Path(place).is_relative_to(folder.absolute()):
        raise OptionError(f"output {output}: outside of {folder}")
    return place


def _json_rows(path: Path, text: str) -> Iterator[tuple[int, Mapping[str, Any]]]:
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip():
            continue
        try:
            row = json.loads(line)
        except (json.JSONDecodeError, RecursionError) as error:
            raise OptionError(f"manifest {path}, line {number}: no JSON ({error})") from error
        if not isinstance(row, dict):
            raise OptionError(f'manifest {path}, line {number}: expected an object, such as {{"input": "a.usd"}}')
        yield number, row


def _csv_rows(path: Path, text: str) -> Iterator[tuple[int, Mapping[str, Any]]]:
    reader = csv.DictReader(io.StringIO(text), restkey="", strict=True)
    try:
        for row in reader:
            if "" in row:
                raise OptionError(f"manifest {path}, line {reader.line_num}: more values than the header has names")
            yield reader.line_num, row
    except csv.Error as error:
        raise OptionError(f"manifest {path}, line {reader.line_num}: no CSV ({error})") from error
