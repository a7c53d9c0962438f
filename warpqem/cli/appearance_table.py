"""The table of `warpqem compare` that says how texture, shading and colours differ."""

from __future__ import annotations

from typing import TYPE_CHECKING

from warpqem.cli.tables import PlainTable, error_text

if TYPE_CHECKING:
    from warpqem.usd.commands.compare import PairReport

__all__ = ["appearance_table"]

# Figures that a terminal has no room for are left out from the end of this.
LAST_SHOWN = ("seam drift %", "stretch", "of reference", "swim %", "swim 95 %")


def appearance_table(pairs: list[PairReport]) -> PlainTable:
    """A row for each set of texture coordinates, normals and colours of each mesh; what has no value says why."""
    from warpqem.measure.appearance_rows import APPEARANCE_COLUMNS, APPEARANCE_TITLE, appearance_rows

    table = PlainTable(APPEARANCE_TITLE)
    table.add_column("mesh", is_path=True)
    table.add_column("values", is_path=True)
    for name in APPEARANCE_COLUMNS:
        table.add_column(name, "right", rank=LAST_SHOWN.index(name) + 1 if name in LAST_SHOWN else 0)
    for pair in pairs:
        if pair.appearance is None:
            continue
        for row in appearance_rows(pair.appearance):
            table.add_row(pair.path, *(value if isinstance(value, str) else error_text(value) for value in row))
        for name, reason in pair.appearance.not_measured.items():
            table.add_note(f"{pair.path}: {name}: none, as {reason}")
    return table
