"""Errors of texture coordinates, shading normals and colours at samples of two meshes, frame by frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from warpqem.measure.followed_points import Correspondence, MovingMesh, match_islands
from warpqem.measure.sampling import MaterialSamples
from warpqem.measure.surface_values import CornerValues
from warpqem.measure.texture_coordinates import (
    Chart,
    Stretch,
    draw_seam_samples,
    make_chart,
    segment_distances,
    texture_jacobians,
)
from warpqem.mesh.blending import blend

__all__ = ["SEAM_SAMPLES", "ErrorSums", "FieldErrors", "MovingPair", "UvErrors", "UvMeasure", "angles"]

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

# Points on the seams of each mesh.
SEAM_SAMPLES = 500

PERCENTILE = 95.0


@dataclass(frozen=True)
class UvErrors:
    """Errors of one set of texture coordinates.

    Attributes:
        error: root mean square difference between the coordinates at samples of one mesh and at the nearest points of
            the same island of the other, both ways, in units of the coordinates.
        error_p95: the 95th percentile over the samples, each with its root mean square over time.
        error_largest: the largest at any sample in any frame.
        swim: how far the texture moves over the material from where it was in the first frame: root mean square over
            samples of the reference, each at its farthest, in % of the frame's diagonal; None with one frame, or where
            the coordinates cover no area.
        swim_p95: the 95th percentile over these samples.
        stretch: L2 texture stretch of the test mesh, mean over the frames, 1 is the least; None where the coordinates
            cover no area.
        stretch_reference: the same of the reference.
        seam_drift: root mean square distance of the seams of each mesh from the nearest seam of the other, both ways,
            in % of the frame's diagonal; None where one of them has no seam.
        seam_drift_largest: the largest at any sample of a seam in any frame.
    """

    error: float
    error_p95: float
    error_largest: float
    swim: float | None
    swim_p95: float | None
    stretch: float | None
    stretch_reference: float | None
    seam_drift: float | None
    seam_drift_largest: float | None


class MovingPair:
    """Reference and test mesh at one frame, and samples of each."""

    def __init__(self, reference: MovingMesh, test: MovingMesh, samples: tuple[MaterialSamples, MaterialSamples]):
        """Both meshes are at the first frame."""
        self.reference, self.test, self.samples = reference, test, samples

    def show(self, frame: int) -> None:
        """Go to a frame."""
        self.reference.show(frame)
        self.test.show(frame)

    def correspond(self, islands: tuple[Ints, Ints] | None = None) -> tuple[Correspondence, Correspondence]:
        """From the reference to the test mesh, and back; ``islands`` are those of their faces, numbered alike."""
        back = None if islands is None else islands[::-1]
        return (
            Correspondence(self.reference, self.test, self.samples[0], islands),
            Correspondence(self.test, self.reference, self.samples[1], back),
        )

    def read(self, values: tuple[CornerValues, CornerValues], frame: int, width: int) -> tuple[Floats, Floats]:
        """The corner values of both meshes in a frame."""
        one, other = (
            value.at(frame, len(moving.mesh.faces), width)
            for value, moving in zip(values, (self.reference, self.test), strict=True)
        )
        return one, other


class ErrorSums:
    """Figures of errors at S samples over the frames."""

    def __init__(self, power: int) -> None:
        """Errors are averaged over the frames as they are (1) or as root mean squares (2)."""
        self._power = power
        self._sum: Floats = np.zeros(0)
        self._count = 0
        self.largest = 0.0

    def add(self, errors: Floats) -> None:
        """Take a frame (S,)."""
        self._sum = errors**self._power if not self._count else self._sum + errors**self._power
        self._count += 1
        self.largest = max(self.largest, float(errors.max()))

    def figures(self) -> tuple[float, float, float]:
        """Mean over samples and frames, 95th percentile over the samples, and the largest."""
        mean = self._sum / self._count
        root = 1.0 / self._power
        return float(mean.mean() ** root), float(np.percentile(mean**root, PERCENTILE)), self.largest


class FieldErrors:
    """Differences of a field of three numbers at corresponding points, both ways."""

    def __init__(
        self, values: tuple[CornerValues, CornerValues], difference: Callable[[Floats, Floats], Floats]
    ) -> None:
        """``difference`` of (S, 3) and (S, 3) is (S,)."""
        self._values, self._difference = values, difference
        self._sums = ErrorSums(power=1)

    def add(self, pair: MovingPair, ways: tuple[Correspondence, Correspondence], frame: int) -> None:
        """Take the frame that the pair shows."""
        values = pair.read(self._values, frame, 3)
        self._sums.add(np.concatenate([self._difference(*ends) for ends in _both_ways(pair, ways, values)]))

    def figures(self) -> tuple[float, float, float]:
        """See :meth:`ErrorSums.figures`."""
        return self._sums.figures()


class UvMeasure:
    """Errors of one set of texture coordinates, with seams and islands as they are in the first frame."""

    def __init__(self, pair: MovingPair, values: tuple[CornerValues, CornerValues], seed: int) -> None:
        """The pair is at the first frame."""
        self._pair, self._values = pair, values
        moving = (pair.reference, pair.test)
        uvs = pair.read(values, 0, 2)
        charts = [make_chart(mesh.place, uv) for mesh, uv in zip(moving, uvs, strict=True)]
        test_island = match_islands(pair.reference, pair.test, charts[0].island, charts[1].island)
        self._ways = pair.correspond((charts[0].island, test_island))
        self._errors = ErrorSums(power=2)
        self._stretch = [Stretch(mesh.mesh.faces, seed) for mesh in moving]
        self.has_seams = [len(chart.seam) > 0 for chart in charts]
        self._seams = [_Seams(mesh, chart, seed) for mesh, chart in zip(moving, charts, strict=True)]
        self._drift = ErrorSums(power=2)
        self._first: Floats | None = None
        self._farthest = np.zeros(len(pair.samples[0].face))
        self._textured = np.ones(len(self._farthest), dtype=bool)
        self._frames = 0

    def add(self, frame: int) -> None:
        """Take the frame that the pair shows."""
        if self._frames:
            for way in self._ways:
                way.follow()
        self._frames += 1
        uvs = self._pair.read(self._values, frame, 2)
        (own, other), backward = _both_ways(self._pair, self._ways, uvs)
        self._errors.add(np.linalg.norm(np.concatenate([other - own, backward[1] - backward[0]]), axis=1))
        self._add_swim(other - own, uvs[0])
        for stretch, moving, uv in zip(self._stretch, (self._pair.reference, self._pair.test), uvs, strict=True):
            stretch.add(moving.points, uv)
        if all(self.has_seams):
            one, two = self._seams
            self._drift.add(np.concatenate([one.distances(two), two.distances(one)]))

    def errors(self, name: str, reasons: dict[str, str]) -> UvErrors:
        """The figures over all frames; ``reasons`` takes why one has no value."""
        swim = swim_p95 = drift = drift_largest = None
        textured = self._farthest[self._textured]
        if self._frames > 1 and len(textured):
            swim = 100 * float(np.sqrt((textured**2).mean()))
            swim_p95 = 100 * float(np.percentile(textured, PERCENTILE))
        elif self._frames == 1:
            reasons[f"{name}: swim"] = "one frame only"
        else:
            reasons[f"{name}: swim"] = f"{name} covers no area on the reference"
        if all(self.has_seams):
            drift, _, drift_largest = (100 * value for value in self._drift.figures())
        else:
            missing = ("the reference has no", "the test mesh has no")[self.has_seams[0]]
            reasons[f"{name}: seam drift"] = (
                f"{missing if any(self.has_seams) else 'neither mesh has a'} seam of {name}"
            )
        stretches = [stretch.mean() for stretch in self._stretch]
        for side, value in zip(("the reference", "the test mesh"), stretches, strict=True):
            if value is None:
                reasons[f"{name}: stretch"] = f"{name} covers no area on {side}"
        return UvErrors(*self._errors.figures(), swim, swim_p95, stretches[1], stretches[0], drift, drift_largest)

    def _add_swim(self, offset: Floats, uv: Floats) -> None:
        """Take how far the coordinates shown at samples of the reference are from their own (S, 2)."""
        if self._first is None:
            self._first = offset
        mesh, face = self._pair.reference, self._pair.samples[0].face
        jacobian, valid = texture_jacobians(mesh.points[mesh.mesh.faces[face]], uv[face])
        self._textured &= valid
        moved = np.einsum("skw,sw->sk", jacobian, offset - self._first)
        self._farthest = np.maximum(self._farthest, np.linalg.norm(moved, axis=1))


class _Seams:
    """Points on the seams of one mesh."""

    def __init__(self, moving: MovingMesh, chart: Chart, seed: int) -> None:
        self._moving = moving
        self._ends = moving.mesh.faces.ravel()[chart.seam]
        if len(chart.seam):
            self._edge, self._along = draw_seam_samples(moving.points, moving.mesh.faces, chart, SEAM_SAMPLES, seed)

    def segments(self) -> tuple[Floats, Floats]:
        """Their ends (E, 3) in the frame shown."""
        return self._moving.points[self._ends[:, 0]], self._moving.points[self._ends[:, 1]]

    def distances(self, other: _Seams) -> Floats:
        """Of these points from the nearest seam of another mesh."""
        start, end = (ends[self._edge] for ends in self.segments())
        return segment_distances(start + self._along[:, None] * (end - start), *other.segments(), self._moving.device)


def angles(first: Floats, second: Floats) -> Floats:
    """Angles (S,) in degrees between vectors (S, 3); 90 where just one of them has a length, 0 where neither has."""
    across = np.linalg.norm(np.cross(first, second), axis=1)
    along = (first * second).sum(axis=1)
    degrees = np.degrees(np.arctan2(across, along))
    empty = (first == 0).all(axis=1) != (second == 0).all(axis=1)
    found: Floats = np.where(empty, 90.0, degrees)
    return found


def _both_ways(
    pair: MovingPair, ways: tuple[Correspondence, Correspondence], values: tuple[Floats, Floats]
) -> list[tuple[Floats, Floats]]:
    """Values (S, C) at the samples of each mesh, and at the points of the other mesh that correspond to them."""
    ends = []
    for samples, way, own, other in zip(pair.samples, ways, values, values[::-1], strict=True):
        ends.append((blend(own[samples.face], samples.barycentric), blend(other[way.face], way.barycentric)))
    return ends
