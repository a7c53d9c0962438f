"""The table of `warpqem simplify`: what came of each mesh, of many the worst."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from warpqem.cli.flag_names import flags_of_options, with_flags
from warpqem.cli.tables import PlainTable, error_text, shortened_path, upper_text
from warpqem.usd.commands.simplify_options import SimplifyOptions

if TYPE_CHECKING:
    from warpqem.usd.write.stage_report import PrimReport, StageReport

__all__ = ["MAX_NAMED", "simplify_table"]

# Outputs that a title names.
MAX_NAMED = 4
# Of more meshes the table shows the worst alone.
MANY_MESHES, WORST_MESHES = 8, 5
# Characters of a path below the table.
NOTE_WIDTH = 40
# What a terminal without room for all columns shows last, beside what figures mean.
RANKS = {"s": 3, "frames": 2, "flips": 1}


def simplify_table(report: StageReport, all_meshes: bool = False) -> PlainTable:
    """The meshes, the worst first.

    Args:
        report: What came of them.
        all_meshes: Show all, however many there are.
    """
    is_many = len({prim.path for prim in report.prims}) > MANY_MESHES and not all_meshes
    table = PlainTable(f"{report.input} -> {_named(report.outputs) or 'nothing written'}")
    levels, worst_first = list(dict.fromkeys(map(_level, report.prims))), report.worst_first
    measured, rig = any(prim.measured for prim in report.prims), _rig_columns(report.prims)
    _add_columns(table, any(levels), measured, rig)
    for level in levels:
        prims = [prim for prim in worst_first if _level(prim) == level]
        rows = [_row(prim, measured, rig) for prim in prims[: WORST_MESHES if is_many else None]]
        if len(prims) > 1:
            rows.append(_total(prims, measured, rig))
        for index, row in enumerate(rows):
            # The total stands apart from its meshes, and each level from the next.
            end_section = index == len(rows) - 1 or (len(prims) > 1 and index == len(rows) - 2)
            table.add_row(*([level] if level else []), *row, end_section=end_section)
    for prim in () if is_many else worst_first:
        if prim.measured is not None and prim.measured["reason"]:
            level = f"{_level(prim)}: " if _level(prim) else ""
            path = shortened_path(prim.path, NOTE_WIDTH)
            table.add_note(f"{prim.measured['verdict']}: {level}{path}: {prim.measured['reason']}")
    if is_many:
        found = Counter(prim.measured["verdict"] for prim in worst_first if prim.measured is not None)
        counts = ", ".join(f"{count:,} {verdict}" for verdict, count in found.items())
        which = f"the worst {WORST_MESHES}{' of each level' if any(levels) else ''}; all with -v"
        table.add_note(f"{which}; {counts}" if counts else which)
    return table


def _add_columns(table: PlainTable, levels: bool, measured: bool, rig: tuple[str, ...]) -> None:
    if levels:
        table.add_column("level")
    table.add_column("mesh", is_path=True)
    errors = ("RMS %", "Hausdorff %", "flips") if measured else ("estimate %",)
    for name in ("frames", "faces before", "faces after", *rig, *errors):
        table.add_column(name, "right", rank=RANKS.get(name, 0))
    if measured:
        table.add_column("verdict")
    table.add_column("stopped")
    table.add_column("s", "right", rank=RANKS["s"])


def _level(prim: PrimReport) -> str:
    """Name of the level of detail, empty where there are none."""
    from warpqem.usd.commands.lods import LevelReport

    return prim.level if isinstance(prim, LevelReport) else ""


def _named(outputs: list[str]) -> str:
    """The files that were written, of many the first and the last."""
    return ", ".join(outputs) if len(outputs) <= MAX_NAMED else f"{outputs[0]}, ..., {outputs[-1]}"


def _rig_columns(prims: list[PrimReport]) -> tuple[str, ...]:
    """What is said of joints and blend shapes, where some were to go."""
    joints = ("joints", "influences") if any(prim.joints for prim in prims) else ()
    return (*joints, "shapes") if any(prim.shapes for prim in prims) else joints


def _rig(prim: PrimReport) -> dict[str, str]:
    said = {}
    if prim.joints is not None:
        said["joints"] = f"{prim.joints.after} of {prim.joints.before}"
        said["influences"] = str(prim.joints.influences)
    if prim.shapes is not None:
        said["shapes"] = f"{prim.shapes.after} of {prim.shapes.before}"
    return said


def _total(prims: list[PrimReport], measured: bool, rig: tuple[str, ...]) -> list[str | int]:
    failed = sum(prim.status == "failed" for prim in prims)
    return [
        f"{len(prims)} meshes",
        "",
        sum(prim.faces_before for prim in prims),
        sum(prim.faces_after for prim in prims),
        *([""] * (len(rig) + (4 if measured else 1))),
        f"{failed} failed" if failed else "",
        f"{sum(prim.seconds for prim in prims):.1f}",
    ]


def _row(prim: PrimReport, measured: bool, rig: tuple[str, ...]) -> list[str | int]:
    if measured:
        found = prim.measured
        errors = [""] * 4
        if found is not None:
            errors = [error_text(found["rms"]), upper_text(found["hausdorff"]), error_text(found["flips"])]
            errors.append(found["verdict"])
    else:
        errors = ["" if prim.estimate is None else error_text(prim.estimate)]
    stopped = prim.stopped if prim.status == "simplified" else prim.status
    counts: list[str | int] = [
        count if prim.frames else "" for count in (prim.frames, prim.faces_before, prim.faces_after)
    ]
    rigged = [_rig(prim).get(name, "") for name in rig]
    shown = with_flags(stopped or "", flags_of_options(SimplifyOptions))
    return [prim.path, *counts, *rigged, *errors, shown, f"{prim.seconds:.1f}"]
