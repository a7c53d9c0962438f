"""``images``: how much the shipped scenes look like themselves at 25, 10 and 5 % of their faces.

`warpqem compare --images` of each scene and its simplified file: as `--quality fast` and `best` write it, and as `best`
does with normals. The scenes have none, and are shaded by their faces; a file that has some gets fitted ones always.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from benchmarks.machine import describe_machine
from benchmarks.report import Column, Report, Row, Table
from benchmarks.settings import Settings
from warpqem.measure.image_similarity import Similarity
from warpqem.usd import CompareOptions, SimplifyOptions, compare_stage_images, simplify_stage

__all__ = ["run"]

SCENES = Path(__file__).resolve().parent.parent / "scenes"
RATIOS, QUICK_RATIOS = (0.25, 0.1, 0.05), (0.1,)
QUICK_SIZE = 32
WAYS: dict[str, dict[str, str]] = {
    "fast": {"quality": "fast"},
    "best": {"quality": "best"},
    "best, --normals fit": {"quality": "best", "normals": "fit"},
}

COLUMNS = (
    Column("scene", "scene"),
    Column("percent", "faces %", "d"),
    Column("way", "simplified"),
    Column("gray", "gray PSNR dB", ".2f"),
    Column("gray_ssim", "SSIM", ".4f"),
    Column("shading", "shading PSNR dB", ".2f"),
    Column("textured", "textured PSNR dB", ".2f"),
    Column("textured_ssim", "SSIM", ".4f"),
    Column("silhouette", "silhouettes", ".4f"),
)


def run(settings: Settings) -> Report:
    """Pictures of each scene, or of one file."""
    report = Report("images", "How much scenes look like themselves", describe_machine(["warpqem"]))
    paths = sorted(SCENES.glob("*.usdc")) if settings.usd is None else [settings.usd]
    rows = [row for path in (paths[:1] if settings.quick else paths) for row in _rows(path, settings)]
    report.tables.append(Table("Pictures of the input and of the result", COLUMNS, rows))
    return report


def _rows(path: Path, settings: Settings) -> list[Row]:
    rows: list[Row] = []
    size = {"size": QUICK_SIZE} if settings.quick else {}
    prims = (settings.prim,) if settings.prim else ()
    for ratio in QUICK_RATIOS if settings.quick else RATIOS:
        for way, options in WAYS.items():
            with tempfile.TemporaryDirectory() as folder:
                output = Path(folder) / f"{path.stem}.usdc"
                chosen = SimplifyOptions(ratio=ratio, prims=prims, measure=False, device=settings.device, **options)
                simplify_stage(path, output, chosen)
                [found] = compare_stage_images(
                    path, output, CompareOptions(device=settings.device, prims=prims), **size
                )
            if found.score is None:
                raise RuntimeError(f"{path}: {found.message}")
            row: Row = {"scene": path.stem, "percent": round(100 * ratio), "way": way}
            gray, textured = _figures(found.score.gray), _figures(found.score.textured)
            row["shading"] = _figures(found.score.shading)[0]
            row |= {"gray": gray[0], "gray_ssim": gray[1], "textured": textured[0], "textured_ssim": textured[1]}
            rows.append({**row, "silhouette": found.score.silhouette})
    return rows


def _figures(found: Similarity | None) -> tuple[float | None, float | None]:
    return (None, None) if found is None else (found.psnr, found.ssim)
