"""The table of `warpqem compare` that says how texture, shading and colours differ."""

from __future__ import annotations

from typing import TYPE_CHECKING

from warpqem.cli.console import PlainTable

if TYPE_CHECKING:
    from warpqem.measure import Appearance
    from warpqem.usd.commands.compare import PairReport

__all__ = ["appearance_table"]

COLUMNS = ("mean", "95 %", "largest", "unit", "swim %", "swim 95 %", "seam drift %", "stretch", "of reference")

# Below this a figure is the rounding of single precision points.
ROUNDING = 1e-9


def appearance_table(pairs: list[PairReport]) -> PlainTable:
    """A row for each set of texture coordinates, normals and colours of each mesh; what has no value says why."""
    table = PlainTable("texture, shading and colours")
    table.add_column("mesh", overflow="fold")
    table.add_column("values", overflow="fold")
    for name in COLUMNS:
        table.add_column(name, justify="right")
    for pair in pairs:
        if pair.appearance is None:
            continue
        for row in _rows(pair.appearance):
            table.add_row(pair.path, *(value if isinstance(value, str) else _shown(value) for value in row))
        for name, reason in pair.appearance.not_measured.items():
            table.add_note(f"{pair.path}: {name}: none, as {reason}")
    return table


def _rows(found: Appearance) -> list[tuple[str | float | None, ...]]:
    rows: list[tuple[str | float | None, ...]] = []
    for name, uv in found.uvs.items():
        figures = (uv.swim, uv.swim_p95, uv.seam_drift, uv.stretch, uv.stretch_reference)
        rows.append((name, uv.error, uv.error_p95, uv.error_largest, "UV", *figures))
    if found.normals is not None:
        normals = found.normals
        rows.append(("normals", normals.angle, normals.angle_p95, normals.angle_largest, "degrees"))
    for name, color in found.colors.items():
        rows.append((name, color.difference, color.difference_p95, color.difference_largest, "CIEDE2000"))
    return rows


def _shown(value: float | None) -> str:
    """A number of four digits; what is left of rounding is nothing."""
    return "" if value is None else "0" if abs(value) < ROUNDING else f"{value:.4g}"
