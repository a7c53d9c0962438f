"""Reports: one JSON file with everything, one Markdown file with the tables."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

__all__ = ["Column", "Report", "Table", "markdown_table", "write_report"]

Row = Mapping[str, Any]


@dataclass(frozen=True)
class Column:
    """A column of a table: the key of its values, its heading, and how a number is written (a format spec)."""

    key: str
    heading: str
    spec: str = ""


@dataclass(frozen=True)
class Table:
    """Rows under a title; every key of a row goes into the JSON, the columns into the Markdown."""

    title: str
    columns: Sequence[Column]
    rows: Sequence[Row]


@dataclass
class Report:
    """What one command measured.

    Attributes:
        name: of the files, without an ending.
        title: heading.
        machine: from :func:`benchmarks.machine.describe_machine`.
        tables: what was measured.
        notes: sentences under the tables: what was left out, and why.
        level: of the heading, 1 for a page of its own, 2 for a section of one.
        failed: what did not hold; anything makes the command end with exit code 1.
    """

    name: str
    title: str
    machine: Mapping[str, Any]
    tables: list[Table] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    level: int = 1
    failed: list[str] = field(default_factory=list)


def _cell(value: Any, spec: str) -> str:
    if value is None:
        return "-"
    return format(value, spec) if isinstance(value, (int, float)) else str(value).replace("|", "\\|")


def markdown_table(table: Table) -> str:
    """The table in Markdown; numbers to the right, None as a dash."""
    lines = [
        "| " + " | ".join(column.heading for column in table.columns) + " |",
        "|" + "|".join("---:" if column.spec else "---" for column in table.columns) + "|",
    ]
    for row in table.rows:
        lines.append("| " + " | ".join(_cell(row.get(c.key), c.spec) for c in table.columns) + " |")
    return "\n".join(lines)


def _machine_lines(machine: Mapping[str, Any]) -> list[str]:
    versions = ", ".join(f"{name} {version}" for name, version in machine["versions"].items())
    gpus = ", ".join(machine["gpus"]) or "none"
    return [
        f"- {machine['cpu']}, {machine['cores']} cores, {machine['memory_gb']} GB; GPU: {gpus}; {machine['system']}",
        f"- load before and after: {machine['load'][0]}, {machine.get('load_after', ['?'])[0]} (1 minute)",
        f"- Python {machine['python']}, {versions}; commit {machine['commit'] or 'unknown'}",
    ]


def write_report(report: Report, folder: Path) -> tuple[Path, Path]:
    """Write ``NAME.md`` and ``NAME.json`` into the folder; their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    hashes = report.level * "#"
    text = [f"{hashes} {report.title}", "", *_machine_lines(report.machine)]
    for table in report.tables:
        text += ["", f"{hashes}# {table.title}", "", markdown_table(table)]
    if report.notes:
        text += ["", *(f"- {note}" for note in report.notes)]
    markdown, data = folder / f"{report.name}.md", folder / f"{report.name}.json"
    markdown.write_text("\n".join(text) + "\n", encoding="utf-8")
    content = {
        "title": report.title,
        "machine": report.machine,
        "tables": [{"title": t.title, "rows": [dict(row) for row in t.rows]} for t in report.tables],
        "notes": report.notes,
        "failed": report.failed,
    }
    data.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return markdown, data
