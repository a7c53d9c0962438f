"""Is the device's result right: the same bits every time, and as good as the CPU's."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np

import warpqem
from benchmarks.device.data import QUALITIES, cpu_figures, figures_of, main_work, packed_figures, small_work, works
from benchmarks.device.findings import Findings
from benchmarks.work import Work

__all__ = ["fingerprint", "quality", "same_bits"]

RUNS = 3
# What goes different ways through the kernels: single frames, the deformation term, motion features, quadrics of the
# present faces with the refit, a limit of the error.
OPTIONS: dict[str, dict[str, Any]] = {
    "best": {"quality": "best"},
    "fast": {"quality": "fast"},
    "first frame (qem)": {"quality": "fast", "metric": "qem"},
    "deformation (dod)": {"quality": "fast", "metric": "dod"},
    "motion features (aqem)": {"quality": "fast", "metric": "aqem"},
}
# How much larger than the CPU's the RMS distance may be. A device orders collapses of equal cost in another way; on
# small meshes that alone is several percent.
MAX_RMS, MAX_RMS_QUICK = 1.01, 1.1


def fingerprint(work: Work, device: str, **options: Any) -> str:
    """A hash of all bits of a result."""
    result = warpqem.simplify(work.points, work.faces, target_faces=work.target_faces, device=device, **options)
    digest = hashlib.sha256()
    for array in (result.points, result.faces, result.vertex_map):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:12]


def same_bits(found: Findings) -> None:
    """Three runs of each option give the same bits."""
    work = main_work(found.settings)
    for name, options in OPTIONS.items():
        given = small_work(found.settings) if name in ("deformation (dod)", "motion features (aqem)") else work
        hashes = [fingerprint(given, found.device, **options) for _ in range(RUNS)]
        same = len(set(hashes)) == 1
        found.expect(f"{given.name}, {name}", hashes[0] if same else " ".join(hashes), f"{RUNS} times the same", same)


def quality(found: Findings) -> None:
    """The RMS distance of each mesh is that of the CPU, or smaller."""
    packed = packed_figures(found.settings)
    most = MAX_RMS_QUICK if found.settings.quick else MAX_RMS
    for work in works(found.settings):
        for name in QUALITIES:
            check = f"RMS of {work.name}, {name}"
            reference = cpu_figures(work, name, packed)
            if reference is None:
                found.left_out(check, "no CPU compiler here, and no figures in --data")
                continue
            expected, where = reference
            own = figures_of(work, name, found.device)
            ratio = own["rms"] / expected["rms"]
            text = f"{own['rms']:.4f} %, {own['faces']} faces, {ratio:.4f} times the CPU's"
            limit = f"at most {most} times {expected['rms']:.4f} % (CPU, {where}), {expected['faces']} faces"
            found.expect(check, text, limit, ratio <= most and own["faces"] <= work.target_faces, ratio)
