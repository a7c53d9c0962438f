"""What a part finds, line by line: printed at once, and kept in a file that outlives a crash."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from benchmarks.report import Row
from benchmarks.settings import Settings

__all__ = ["FAILED", "OK", "Findings", "read_findings"]

# Verdicts. A figure without an expectation has none.
OK, FAILED = "ok", "FAILED"


class Findings:
    """Adds rows to the report.

    Args:
        part: the part that finds.
        settings: what it was asked for.
        file: JSON Lines.

    Attributes:
        settings: what it was asked for.
        device: name of the Warp device.
    """

    def __init__(self, part: str, settings: Settings, device: str, file: Path) -> None:
        self._part, self._file = part, file
        self.settings, self.device = settings, device

    def measured(self, check: str, measured: str, value: float | None = None) -> None:
        """A figure that nothing is expected of."""
        self._add(check, measured, "", "", value)

    def expect(self, check: str, measured: str, expected: str, holds: bool, value: float | None = None) -> None:
        """A figure and what is expected of it."""
        self._add(check, measured, expected, OK if holds else FAILED, value)

    def left_out(self, check: str, why: str) -> None:
        """Something that cannot be done here."""
        self._add(check, why, "", "not run", None)

    def table(self, title: str, rows: list[Row], limits: str) -> None:
        """The kernels beside their floors, and what the floors are of."""
        self._write({"title": title, "rows": [dict(row) for row in rows], "limits": limits})

    def machine(self, machine: dict[str, Any]) -> None:
        """What this runs on."""
        self._write({"machine": machine})

    def _add(self, check: str, measured: str, expected: str, verdict: str, value: float | None) -> None:
        aside = ", ".join(filter(None, (f"expected {expected}" if expected else "", verdict)))
        print(f"  {check}: {measured}{f' ({aside})' if aside else ''}", flush=True)
        row = {"part": self._part, "check": check, "measured": measured, "expected": expected, "verdict": verdict}
        self._write({"row": row | {"value": value}})

    def _write(self, entry: dict[str, Any]) -> None:
        with self._file.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(entry) + "\n")


def read_findings(file: Path) -> list[dict[str, Any]]:
    """The entries of a file, without one that a crash has cut off."""
    entries = []
    for line in file.read_text(encoding="utf-8").splitlines() if file.exists() else ():
        try:
            entries.append(json.loads(line))
        except json.JSONDecodeError:
            break
    return entries
