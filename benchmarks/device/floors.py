"""Every kernel of a simplification beside the least that its work can take on this card."""

from __future__ import annotations

from typing import Any

import warp as wp

import warpqem
from benchmarks.cards import H200, Card, card_of
from benchmarks.device.data import main_work
from benchmarks.device.findings import Findings
from benchmarks.kernels import kernel_rows
from benchmarks.launches import profile_launches
from benchmarks.report import Row
from benchmarks.work import Work, torus_work

__all__ = ["run"]

# Few enough frames that all are key frames: ordering is most of the work.
LARGE, QUICK_LARGE = (1_000_000, 16), (2_000, 4)


# Kernels that the quality fast does not use.
FURTHER = {
    "best": {"quality": "best"},
    "dod": {"quality": "fast", "metric": "dod"},
    "aqem": {"quality": "fast", "metric": "aqem"},
}


def run(found: Findings) -> None:
    """A table for the main mesh, one for a large one, where kernels and not launches count, one for further options."""
    settings = found.settings
    name = wp.get_device(found.device).name
    card = card_of(name)
    if card is None:
        found.left_out("floors of this card", f"{name} is not in benchmarks/cards.py: those of an H200 instead")
        card = H200
    else:
        found.measured("floors of this card", card.limits)
    main = main_work(settings)
    known: set[str] = set()
    for work in (main, torus_work(*(QUICK_LARGE if settings.quick else LARGE), settings.ratio)):
        rows = _rows(found, work, card, quality="fast")
        known |= {row["kernel"] for row in rows}
        found.table(f"Kernels: {work.name}, {work.size}", rows, card.limits)
    further = []
    for name, options in FURTHER.items():
        new = [row for row in _rows(found, main, card, **options) if row["kernel"] not in known]
        known |= {row["kernel"] for row in new}
        further += [{**row, "kernel": f"{row['kernel']} ({name})"} for row in new]
    found.table(f"Kernels of further options: {main.name}", further, card.limits)


def _rows(found: Findings, work: Work, card: Card, **options: Any) -> list[Row]:
    """The kernels of one simplification, after one that has loaded them."""
    simplify_once(work, found.device, **options)
    with profile_launches() as profile:
        simplify_once(work, found.device, **options)
    rows = kernel_rows(profile, card)
    total = rows[-1]
    floors = f"floor {total['floor_ms']:.3f} ms, with launches {total['launch_floor_ms']:.3f} ms"
    text = f"{total['milliseconds']:.2f} ms in {total['launches']} launches, {floors}"
    name = ", ".join([work.name, *options.values()])
    found.measured(f"kernels of {name}", text, total["milliseconds"])
    uncounted = [row["kernel"] for row in rows if row["floor_ms"] is None]
    found.expect(f"kernels of {name} with a floor", ", ".join(uncounted) or "all", "all", not uncounted)
    return rows


def simplify_once(work: Work, device: str, **options: Any) -> None:
    """Simplify."""
    warpqem.simplify(work.points, work.faces, target_faces=work.target_faces, device=device, **options)
