"""What is wrong with, or worth knowing of, the meshes of a file: the same lines by `simplify` and by `batch`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from warpqem.arguments.figures import rounded_up
from warpqem.cli.flag_names import flags_of_options, with_flags
from warpqem.cli.message_groups import group_messages, message_path_width
from warpqem.usd.commands.simplify_options import SimplifyOptions

__all__ = ["grouped_lines", "problem_lines"]

# Kind of a message, such as "warning", and its text.
Line = tuple[str, str]


def problem_lines(report: Mapping[str, Any]) -> list[Line]:
    """The messages about a file, see `warpqem.usd.write.stage_report.StageReport.to_dict`; each once."""
    prims = report["prims"]
    lines: list[Line] = [("warning", text) for text in report["problems"]]
    lines += [("note", text) for text in report["notes"]]
    lines += [("warning", text) for prim in prims for text in prim["problems"]]
    lines += [("note", text) for prim in prims for text in prim["notes"]]
    for prim in prims:
        place = f"{_level(prim)}{prim['path']}"
        lines += [(kind, f"{place}: {text}") for kind, text in _mesh_lines(prim)]
        if prim["status"] == "failed":
            lines.append(("error", _level(prim) + (prim["message"] or prim["path"])))
    if report["output"] is None:
        lines.append(("error", f"nothing written: no mesh of {report['input']} could be simplified"))
    flags = flags_of_options(SimplifyOptions)
    return list(dict.fromkeys((kind, with_flags(text, flags)) for kind, text in lines))


def grouped_lines(report: Mapping[str, Any], each: bool = False) -> list[Line]:
    """The same, where equal messages of many meshes are one.

    Args:
        report: The report.
        each: Leave them as they are.
    """
    lines = problem_lines(report)
    paths = dict.fromkeys(prim["path"] for prim in sorted(report["prims"], key=_badness))
    return lines if each else group_messages(lines, list(paths), message_path_width())


def _badness(prim: Mapping[str, Any]) -> tuple[int, tuple[int, float]]:
    """What meshes are sorted by, the worst first, as in the table."""
    from warpqem.measure.verdict import rank

    if prim["measured"] is None:
        return 0 if prim["status"] == "failed" else 2, (0, 0.0)
    return 1, rank(prim["measured"]["verdict"], prim["measured"]["hausdorff"])


def _level(prim: Mapping[str, Any]) -> str:
    return f"{prim['level']}: " if prim.get("level") else ""


def _mesh_lines(prim: Mapping[str, Any]) -> Iterator[Line]:
    from warpqem.measure.verdict import WARNING_DISTANCE

    if prim["dropped"]:
        yield "warning", f"dropped, does not fit the new mesh: {', '.join(prim['dropped'])}"
    for line in _removed(prim):
        yield "note", line
    if prim["symmetry"] not in (None, "kept"):
        yield "warning", f"not kept symmetric: {prim['symmetry']}"
    if prim["status"] == "simplified" and prim["stopped"] == "no legal collapse":
        yield "warning", f"stopped at {prim['faces_after']:,} faces, no legal collapse is left"
    if prim["status"] == "kept" and (prim["message"] or "").startswith("no geometry"):
        yield "note", f"kept: {prim['message']}"
    if prim["measured"] is not None and prim["measured"]["hausdorff"] > WARNING_DISTANCE:
        percent, length = prim["measured"]["hausdorff"], prim["measured"]["hausdorff_length"]
        yield "warning", f"a point is up to {rounded_up(percent)} % of the diagonal ({rounded_up(length)} units) off"
    if prim["stopped"] == "max_size_error":
        yield "note", "more faces kept, as the estimate of the error would pass --max-size-error"


def _removed(prim: Mapping[str, Any]) -> Iterator[str]:
    """What went of joints and blend shapes, by name."""
    joints, shapes = prim["joints"], prim["shapes"]
    if joints is not None and joints["removed"]:
        added = f"{joints['added_error']:.3g} % of the diagonal to the RMS distance over the poses"
        yield f"without the joints {', '.join(joints['removed'])}, which adds {added} (in quadrature)"
    if shapes is not None and shapes["removed"]:
        merged = f"; {len(shapes['merged'])} of them go on in others" if shapes["merged"] else ""
        yield (
            f"without the blend shapes {', '.join(shapes['removed'])}{merged}. "
            f"RMS distance by this: {shapes['used_error']:.3g} % of the diagonal over the animation, "
            f"{shapes['random_error']:.3g} % over random weights"
        )
