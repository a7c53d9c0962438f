"""The table of `warpqem compare` that says how texture, shading and colours differ."""

from __future__ import annotations

from typing import TYPE_CHECKING

from warpqem.cli.console import PlainTable, error_text

if TYPE_CHECKING:
    from warpqem.usd.commands.compare import PairReport

__all__ = ["appearance_table"]


def appearance_table(pairs: list[PairReport]) -> PlainTable:
    """A row for each set of texture coordinates, normals and colours of each mesh; what has no value says why."""
    from warpqem.measure.appearance_rows import APPEARANCE_COLUMNS, APPEARANCE_TITLE, appearance_rows

    table = PlainTable(APPEARANCE_TITLE)
    table.add_column("mesh", overflow="fold")
    table.add_column("values", overflow="fold")
    for name in APPEARANCE_COLUMNS:
        table.add_column(name, justify="right")
    for pair in pairs:
        if pair.appearance is None:
            continue
        for row in appearance_rows(pair.appearance):
            table.add_row(pair.path, *(value if isinstance(value, str) else error_text(value) for value in row))
        for name, reason in pair.appearance.not_measured.items():
            table.add_note(f"{pair.path}: {name}: none, as {reason}")
    return table
