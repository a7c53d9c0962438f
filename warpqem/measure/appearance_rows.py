"""The rows of tables on texture, shading and colours: the same ones on the command line and on pages."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from warpqem.measure.appearance import Appearance

__all__ = ["APPEARANCE_COLUMNS", "APPEARANCE_TITLE", "appearance_rows"]

APPEARANCE_TITLE = "Texture, shading and colours"
# What the rows hold after the name of the values.
APPEARANCE_COLUMNS = (
    "mean",
    "95 %",
    "largest",
    "unit",
    "swim %",
    "swim 95 %",
    "seam drift %",
    "stretch",
    "of reference",
)

# Below this a figure is the rounding of single precision points.
ROUNDING = 1e-9


def appearance_rows(found: Appearance) -> list[tuple[str | float | None, ...]]:
    """A row for each set of texture coordinates, the normals, and each set of colours: its name, then the columns.

    What is left of rounding is 0; None stands for what has no value.
    """
    rows: list[tuple[str | float | None, ...]] = []
    for name, uv in found.uvs.items():
        figures = (uv.swim, uv.swim_p95, uv.seam_drift, uv.stretch, uv.stretch_reference)
        rows.append((name, uv.error, uv.error_p95, uv.error_largest, "UV", *figures))
    normals = {} if found.normals is None else {"normals": found.normals}
    for fields, unit in ((normals, "degrees"), (found.colors, "CIEDE2000")):
        rows += [(name, one.mean, one.p95, one.largest, unit, *[None] * 5) for name, one in fields.items()]
    return [
        tuple(0.0 if isinstance(value, float) and abs(value) < ROUNDING else value for value in row) for row in rows
    ]
