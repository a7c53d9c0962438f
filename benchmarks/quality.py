"""How good a result is, measured with warpqem.measure, for one topology and for one in each frame."""

from __future__ import annotations

import numpy as np

from benchmarks.simplified import Simplified
from benchmarks.work import Work
from warpqem.measure import Comparison, compare
from warpqem.measure.checked_meshes import check_sequence, frame_scale
from warpqem.measure.closest_points import ClosestPointSearch
from warpqem.measure.comparison import JITTER_SAMPLES, JITTER_WINDOW
from warpqem.measure.sampling import draw_material_samples, place
from warpqem.measure.temporal import SecondDifference, in_face_frame
from warpqem.runtime.device import resolve_device

__all__ = ["Quality", "measure_quality"]

SAMPLES = 20000
# Frames that distances are measured on, evenly spread.
FRAMES = 8

Quality = dict[str, float | int | None]


def measure_quality(work: Work, result: Simplified, device: str | None = None) -> Quality:
    """Distances in % of the bounding-box diagonal, and what the motion does to the surface.

    Slide and edge-length error follow vertices and edges through time, so they are None where every frame has its
    own; jitter follows the surface and exists for both.
    """
    if result.shares_topology:
        points = np.stack(result.points)
        return _figures(
            compare(work.points, work.faces, points, result.faces[0], samples=SAMPLES, frames=FRAMES, device=device),
            len(result.faces[0]),
        )
    chosen = np.unique(np.linspace(0, len(work.points) - 1, FRAMES).round().astype(int))
    frames = [
        compare(work.points[t], work.faces, result.points[t], result.faces[t], samples=SAMPLES, device=device)
        for t in chosen
    ]
    return {
        "faces": round(float(np.mean([len(f) for f in result.faces]))),
        "rms": float(np.mean([f.rms for f in frames])),
        "hausdorff": float(max(f.hausdorff for f in frames)),
        "edge_length_error": None,
        "slide": None,
        "jitter": _jitter(work, result, resolve_device(device)),
        "flips": float(np.mean([f.flips for f in frames])),
    }


def _figures(comparison: Comparison, faces: int) -> Quality:
    return {
        "faces": faces,
        "rms": comparison.rms,
        "hausdorff": comparison.hausdorff,
        "edge_length_error": comparison.edge_length_error,
        "slide": comparison.slide,
        "jitter": comparison.jitter,
        "flips": comparison.flips,
    }


def _jitter(work: Work, result: Simplified, device: str) -> float | None:
    """Jitter as warpqem.measure defines it, in %, against meshes that have their own faces in each frame."""
    reference = check_sequence(work.points, work.faces, "reference")
    centre, diagonal = frame_scale(reference)
    # The same samples as warpqem.measure draws.
    samples = draw_material_samples(reference, JITTER_SAMPLES, 0, "reference")
    face, barycentric = samples.face, samples.barycentric
    first = max(0, (len(reference.points) - JITTER_WINDOW) // 2)
    jitter = SecondDifference()
    for t in range(first, min(len(reference.points), first + JITTER_WINDOW)):
        scaled, simplified = ((x - centre[t]) / diagonal[t] for x in (reference.points[t], result.points[t]))
        faces = result.faces[t].astype(np.int64)
        source = place(scaled, reference.faces, face, barycentric)
        closest = ClosestPointSearch(faces, device, "test").closest(simplified, source, t)
        offset = place(simplified, faces, closest.face, closest.barycentric) - source
        jitter.add(diagonal[t] * in_face_frame(offset, scaled, reference.faces, face))
    value = jitter.root_mean_square()
    return None if value is None else 100 * value / float(diagonal.mean())
