"""The table of `warpqem compare --images` that says how alike pictures of both files are."""

from __future__ import annotations

from typing import TYPE_CHECKING

from warpqem.cli.tables import PlainTable

if TYPE_CHECKING:
    from warpqem.measure.image_similarity import Similarity
    from warpqem.usd.commands.compare_images import ImageReport

__all__ = ["image_table"]


def image_table(reports: list[ImageReport]) -> PlainTable:
    """A row for gray pictures and one for those with colours and textures, of each level."""
    table = PlainTable("Pictures")
    levels = any(report.level for report in reports)
    for head in (["level"] if levels else []) + ["surface"]:
        table.add_column(head)
    for head in ("PSNR dB", "SSIM", "silhouettes"):
        table.add_column(head, "right")
    for report in reports:
        name = [report.level or ""] if levels else []
        score = report.score
        if score is None:
            table.add_row(*name, "failed")
            continue
        overlap = "none" if score.silhouette is None else f"{score.silhouette:.4f}"
        table.add_row(*name, "gray", *_cells(score.gray, "nothing is seen"), overlap)
        table.add_row(*name, "shading", *_cells(score.shading, "none"), "")
        table.add_row(*name, "textured", *_cells(score.textured, "none"), end_section=levels)
    scores = [report.score for report in reports if report.score is not None]
    if scores:
        one = scores[0]
        table.add_note(
            f"{one.frame_count} x {one.view_count} pictures of {one.size} x {one.size} pixels; over the pixels that "
            "either file covers, of shading those that both do"
        )
    return table


def _cells(found: Similarity | None, missing: str) -> tuple[str, str]:
    if found is None:
        return missing, ""
    return "equal" if found.psnr is None else f"{found.psnr:.2f}", f"{found.ssim:.4f}"
