"""Every kernel of a simplification beside the least that its work can take on this card."""

from __future__ import annotations

import warp as wp

import warpqem
from benchmarks.cards import H200, card_of
from benchmarks.device.data import main_work
from benchmarks.device.findings import Findings
from benchmarks.kernels import kernel_rows
from benchmarks.launches import profile_launches
from benchmarks.work import Work, torus_work

__all__ = ["run"]

# Few enough frames that all are key frames: ordering is most of the work.
LARGE, QUICK_LARGE = (1_000_000, 16), (2_000, 4)


def run(found: Findings) -> None:
    """A table for the main mesh, and one for a large one, where kernels and not launches count."""
    settings = found.settings
    name = wp.get_device(found.device).name
    card = card_of(name)
    if card is None:
        found.left_out("floors of this card", f"{name} is not in benchmarks/cards.py: those of an H200 instead")
        card = H200
    else:
        found.measured("floors of this card", card.limits)
    for work in (main_work(settings), torus_work(*(QUICK_LARGE if settings.quick else LARGE), settings.ratio)):
        simplify_once(work, found.device)
        with profile_launches() as profile:
            simplify_once(work, found.device)
        rows = kernel_rows(profile, card)
        total = rows[-1]
        floors = f"floor {total['floor_ms']:.3f} ms, with launches {total['launch_floor_ms']:.3f} ms"
        text = f"{total['milliseconds']:.2f} ms in {total['launches']} launches, {floors}"
        found.measured(f"kernels of {work.name}", text, total["milliseconds"])
        found.table(f"Kernels: {work.name}, {work.size}", rows, card.limits)


def simplify_once(work: Work, device: str) -> None:
    """Simplify with the default options."""
    warpqem.simplify(work.points, work.faces, target_faces=work.target_faces, device=device)
