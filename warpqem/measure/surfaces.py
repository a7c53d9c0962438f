"""Two surfaces in motion, measured against each other a few frames at a time; or many pairs of them in one frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.errors import DegenerateMeshError
from warpqem.kernels import surface_distance as kernels
from warpqem.kernels.lanes import WIDE
from warpqem.measure.cells import Cells, Joined, cell_places
from warpqem.measure.collapsed import collapsed_frames, distance_apart
from warpqem.measure.largest import LargestDistance
from warpqem.measure.per_frame import FrameErrors
from warpqem.measure.sample_draws import Draws, SampleDraws
from warpqem.runtime import new_arrays
from warpqem.runtime.part_launches import FIRST_ITEM, launch_in_parts

__all__ = ["SMALL_FACES", "SurfaceComparison", "sample_count"]

# Samples on each surface, over all frames together: on 13 sequences the mean over the frames is then off by 0.6 %, and
# by 1.5 % at most.
ALL_SAMPLES = 2**15
# Samples on each surface in one frame: at most so many, which one frame takes to be known as well; and at least so
# many, so that the larger of the two directions is known.
MAX_SAMPLES, MIN_SAMPLES = 20000, 64
# A mesh of few faces is known from fewer: so many for each face of the larger mesh, and at least so many. On 120 small
# meshes the root mean square distance is then off by 0.5 % in the middle, and by 2.5 % at most, with three seeds each
# (`python -m benchmarks samples`).
FACE_SAMPLES, MIN_MESH_SAMPLES = 4, 2000
# Meshes of so many faces have the same number of samples in one frame.
SMALL_FACES = MIN_MESH_SAMPLES // FACE_SAMPLES
# Before the first frame, this part of all samples, and no more than so many, show where the samples of the figures are
# to lie: with 85 instead of 2500 of them, the error of a horse that lost its ear is off by 1.9 % instead of 0.9.
PILOT_PART, MAX_PILOT = 12, 2500
# Samples that distinguish the root mean square distances of both directions to about a percent.
DECIDING_SAMPLES = 4096
# Frames are put together as cells until they have so many faces, or are so many: a launch then takes long enough to be
# worth its start, and the hierarchy over them stays in the processor's cache.
CELL_FACES, MAX_CELLS = 2**14, 32
# Frames that come at once fill a vector register, unless they have more faces than this together.
BLOCK_FACES = 2**21
# Samples and triangles that are worth a thread.
MIN_PART = 512
# A face with less area than this fraction of the squared diagonal has no normal that means anything.
DEGENERATE_AREA = 1e-14

Doubles = npt.NDArray[np.float64]


def sample_count(frame_count: int, face_count: int) -> int:
    """Samples on each surface in each of so many frames, where none are asked for.

    Args:
        frame_count: frames that are measured.
        face_count: faces of the mesh that has more of them.
    """
    most = min(MAX_SAMPLES, max(MIN_MESH_SAMPLES, FACE_SAMPLES * face_count))
    return min(most, max(MIN_SAMPLES, math.ceil(ALL_SAMPLES / frame_count)))


@dataclass(frozen=True)
class _Samples:
    """Distances, angles and weights (n, S) of the samples of one surface in n frames, and the largest distance (n,)."""

    distance: Doubles
    angle: Doubles
    weight: Doubles
    largest: Doubles

    def mean(self, values: Doubles) -> Doubles:
        """The mean over the area (n,) of values at the samples (n, S)."""
        found: Doubles = (values * self.weight).mean(axis=1)
        return found

    @property
    def mean_angle(self) -> Doubles:
        """The mean angle over the area (n,), relative to the weights: samples are not dense where angles are large."""
        found: Doubles = self.mean(self.angle) / self.weight.mean(axis=1)
        return found


def _forward_is_larger(ahead: Doubles, back: Doubles, samples: int) -> npt.NDArray[np.bool_]:
    """In which frames (n,) the first of two root mean square distances is to be taken for the larger one.

    Of two figures with noise the larger is too large in the mean. So neighbouring frames decide together, as many as
    have enough samples to distinguish the two.
    """
    total = ahead + back
    difference = np.divide(ahead - back, total, out=np.zeros_like(total), where=total > 0)
    reach = min(len(total) - 1, math.ceil(DECIDING_SAMPLES / samples) // 2)
    sums = np.concatenate([[0.0], np.cumsum(difference)])
    frame = np.arange(len(total))
    first, last = np.maximum(frame - reach, 0), np.minimum(frame + reach + 1, len(total))
    decided: npt.NDArray[np.bool_] = sums[last] - sums[first] >= 0
    return decided


class SurfaceComparison:
    """Measures a test mesh against a reference, in one frame after another; or several against one each in one frame.

    Rows of figures are frames, or meshes.

    In each frame, samples of both surfaces are drawn in strata, differently in each frame, half of them in proportion
    to area and half where the distances of samples before were large, and weighted for that
    (:mod:`warpqem.measure.sample_draws`). The largest distance is searched for over both surfaces in all frames, by
    branch and bound (:mod:`warpqem.kernels.largest_distance`): it holds at every point, not at samples only. Equal
    frames give equal bits, however they come in blocks.

    Args:
        reference: the reference, or M of them.
        test: the test mesh, or as many.
        frame_count: frames to come, at least 1; 1 for several meshes.
        samples: samples on each surface in each frame.
        seed: seed of the samples.
        device: Warp device.
        overall: whether of the largest distances only that of all frames is asked for, which takes a third of the time.

    Attributes:
        group: frames that are measured at once.
        collapsed: numbers of the frames so far in which either mesh is collapsed to a point or a line, and how far the
            two are apart there, in the units of the points: such a frame has no errors.
        sample_count: samples on each surface in each frame.
        test_faces: faces (M,) of each test mesh.
    """

    def __init__(
        self,
        reference: Joined,
        test: Joined,
        frame_count: int,
        samples: int,
        seed: int,
        device: str,
        *,
        overall: bool = False,
    ) -> None:
        largest = max(len(reference.faces), len(test.faces))
        self._cells = max(1, min(MAX_CELLS, CELL_FACES // largest, frame_count))
        self.group = max(self._cells, min(WIDE, BLOCK_FACES // largest, frame_count))
        self._reference = Cells(reference, self._cells, "reference", device)
        self._test = Cells(test, self._cells, "test", device)
        surfaces = self._reference, self._test, frame_count, device
        self._largest = LargestDistance(*surfaces, overall=True)
        # In one frame it is the same.
        self._in_frames = None if overall or frame_count == 1 else LargestDistance(*surfaces, like=self._largest)
        self.collapsed: dict[int, float] = {}
        self._mesh_count = self._test.mesh_count
        self._overall = np.zeros(self._mesh_count)
        self._draws: list[SampleDraws] = []
        # All samples of a surface, and frames whose samples have been learned from.
        self._all_samples, self._learned = samples * frame_count, 0
        self.test_faces = np.diff(test.first_face)
        self.sample_count, self._seed, self._device = samples, seed, device
        self._rows: list[dict[str, npt.NDArray[Any]]] = []
        self._diagonals: list[Doubles] = []

    def add(self, frames: Sequence[int], reference: npt.NDArray[Any], test: npt.NDArray[Any]) -> None:
        """Measure a group of frames: ``group`` of them, or fewer at the end.

        Args:
            frames: their numbers.
            reference: (n, V, 3) points of the reference.
            test: (n, W, 3) points of the test mesh.

        Raises:
            DegenerateMeshError: all faces of a mesh are too thin in a frame; or one of several meshes is collapsed.
        """
        own, other = (
            mesh.astype(np.float64)[:, cells.used] for mesh, cells in ((reference, self._reference), (test, self._test))
        )
        sides = ((own, self._reference), (other, self._test))
        one, two = (collapsed_frames(points, cells.faces, cells.first_face) for points, cells in sides)
        flat = one | two
        if flat.any() and self._mesh_count > 1:
            raise DegenerateMeshError("one of several meshes is collapsed to a point or a line")
        for index in np.flatnonzero(flat).tolist():
            self.collapsed[int(frames[index])] = distance_apart(own[index], other[index])
        if flat.all():
            return
        if flat.any():
            frames = [frame for frame, gone in zip(frames, flat.tolist(), strict=True) if not gone]
            own, other = own[~flat], other[~flat]
        low, high = self._reference.bounds(own)
        diagonal = np.linalg.norm(high - low, axis=2)
        middle = (low + high) / 2
        own, other = (
            (points - cells.of_points(middle)) / cells.of_points(diagonal[:, :, None])
            for points, cells in ((own, self._reference), (other, self._test))
        )
        self._diagonals.append(diagonal.ravel())
        places = cell_places(self._cells, max(float(np.abs(own).max()), float(np.abs(other).max())))
        for largest in self._searches:
            largest.begin_block(own, other)
        for first in range(0, len(frames), self._cells):
            part = slice(first, min(first + self._cells, len(frames)))
            self._reference.move(own[part], places)
            self._test.move(other[part], places)
            if not self._draws:
                self._draws = [
                    SampleDraws(points[0][cells.faces], self._seed, side, cells.first_face)
                    for side, (points, cells) in enumerate(((own, self._reference), (other, self._test)))
                ]
            self._measure(frames[part], part)

    def _measure(self, frames: Sequence[int], part: slice) -> None:
        """Measure the frames that the cells show, a part of the block."""
        count = len(frames)
        reference, test = self._reference, self._test
        areas = [cells.areas() for cells in (reference, test)]
        for cells, area in zip((reference, test), areas, strict=True):
            empty = ~np.logical_or.reduceat(area, cells.first_face[:-1], axis=1).all(axis=1)
            if empty.any():
                raise DegenerateMeshError(
                    f"{cells.name} mesh: every face has zero area in frame {frames[int(np.argmax(empty))]}"
                )
        ahead = self._sampled(reference, test, areas[0], frames, part, 0)
        back = self._sampled(test, reference, areas[1], frames, part, 1)
        sampled = np.maximum(ahead.distance.max(axis=1), back.distance.max(axis=1))
        self._learned += count
        largest = self._largest.find(part, sampled)
        self._overall = np.maximum(self._overall, largest.reshape(-1, self._mesh_count).max(axis=0))
        if self._in_frames is not None:
            largest = self._in_frames.find(part, np.maximum(ahead.largest, back.largest))
        rms = [np.sqrt(one.mean(one.distance**2)) for one in (ahead, back)]
        self._rows.append(
            {
                "frame": np.repeat(np.array(frames, dtype=np.int64), self._mesh_count),
                "hausdorff": 100 * largest,
                "mean": 100 * (ahead.mean(ahead.distance) + back.mean(back.distance)) / 2,
                "rms_forward": 100 * rms[0],
                "rms_backward": 100 * rms[1],
                "normal_deviation": (ahead.mean_angle + back.mean_angle) / 2,
                "flips": self._flips(count),
                "degenerate_faces": self._counted(areas[1][:count] <= DEGENERATE_AREA),
            }
        )

    def _sampled(
        self, own: Cells, other: Cells, areas: Doubles, frames: Sequence[int], part: slice, side: int
    ) -> _Samples:
        """Samples of one surface in the frames that the cells show, each as dense as the ones before ask for."""
        draws, learned, done = self._draws[side], self._learned, 0

        def draw(some: slice, count: int, *, pilot: bool) -> _Samples:
            """Draw in some of the frames, and learn from what is found."""
            drawn = draws.draw(areas[some], frames[some], count, pilot=pilot)
            samples = self._looked_at(own, other, drawn, frames[some], some.start, part, side)
            draws.learn(drawn, samples.distance)
            return samples

        if not learned:
            draw(slice(0, 1), max(1, min(MAX_PILOT, self._all_samples // PILOT_PART)), pilot=True)
        found = []
        while done < len(frames):
            # As many frames as there were before at most, so that also few groups of many frames learn.
            some = slice(done, min(len(frames), done + max(1, learned + done)))
            found.append(draw(some, self.sample_count, pilot=False))
            done = some.stop
        return _Samples(*(np.concatenate([getattr(samples, name) for samples in found]) for name in vars(found[0])))

    def _looked_at(
        self, own: Cells, other: Cells, drawn: Draws, frames: Sequence[int], cell: int, part: slice, side: int
    ) -> _Samples:
        """What samples of some frames find; the first of these is in cell ``cell``, where ``part`` is in the cells."""
        face, place = drawn.face, drawn.place
        if self._in_frames is not None:
            # Points that may be among the furthest are looked at on the way.
            shown = slice(part.start + cell, part.start + cell + len(frames))
            also_face, also_place = self._in_frames.leading_corners(side, shown)
            face, place = np.concatenate([face, also_face], axis=1), np.concatenate([place, also_place], axis=1)
        shape = face.shape
        inputs = [
            own.surface,
            other.surface,
            own.table,
            other.table,
            new_arrays.uploaded(face.ravel(), dtype=wp.int32, device=self._device),
            new_arrays.uploaded(place.reshape(-1, 2), dtype=wp.vec2d, device=self._device),
            cell * self._mesh_count,
            shape[1],
            self._largest.near_faces(side),
        ]
        distance, angle = (new_arrays.empty(face.size, dtype=wp.float64, device=self._device) for _ in range(2))
        near = new_arrays.empty(face.size, dtype=wp.int32, device=self._device)
        self._launch(kernels.sample_distances, face.size, inputs, [distance, angle, near])
        degrees = angle.numpy().reshape(shape)
        against = degrees > 90.0
        if against.any():
            # Faces are counted from the first one of a mesh, and rows are its.
            first = [np.resize(cells.first_face[:-1], len(face))[:, None] for cells in (own, other)]
            either = own.winding.either[first[0] + face] | other.winding.either[first[1] + near.numpy().reshape(shape)]
            degrees = np.where(against & either, 180.0 - degrees, degrees)
        found = distance.numpy().reshape(shape)
        if (found < 0).any():
            frame = frames[int(np.argmax((found < 0).any(axis=1))) // self._mesh_count]
            raise DegenerateMeshError(f"{other.name} mesh: every face is degenerate in frame {frame}")
        samples = slice(drawn.face.shape[1])
        angles = degrees[:, samples]
        return _Samples(found[:, samples], angles, drawn.weight, found.max(axis=1))

    def _flips(self, count: int) -> npt.NDArray[np.int64]:
        """Faces (n,) that oppose the reference in the frames shown, or of each mesh."""
        test, reference = self._test, self._reference
        opposed = new_arrays.empty((count, test.face_count), dtype=wp.int32, device=self._device)
        cell = new_arrays.uploaded(test.mesh_of_face, dtype=wp.int32, device=self._device)
        inputs = [test.surface, reference.surface, test.table, reference.table, cell, count]
        self._launch(kernels.find_flips, test.face_count, [*inputs, DEGENERATE_AREA, test.nearest], [opposed])
        face = opposed.numpy()
        flipped = face >= 0
        if flipped.any():
            # Of two sides of a sheet, one faces as the reference does.
            flipped &= ~test.winding.both
        if flipped.any():
            there = face + reference.first_face[test.mesh_of_face]
            flipped[flipped] = ~reference.winding.either[there[flipped]]
        return self._counted(flipped)

    def _counted(self, flags: npt.NDArray[np.bool_]) -> npt.NDArray[np.int64]:
        """How many faces of the test mesh are flagged (n, N) in each frame, or of each mesh."""
        counts: npt.NDArray[np.int64] = np.add.reduceat(flags, self._test.first_face[:-1], axis=1, dtype=np.int64)
        return counts.ravel()

    def _launch(self, kernel: wp.Kernel, count: int, inputs: list[Any], outputs: list[wp.array]) -> None:
        launch_in_parts(kernel, count, [*inputs, FIRST_ITEM], outputs, device=self._device, min_items=MIN_PART)

    @property
    def _searches(self) -> list[LargestDistance]:
        return [search for search in (self._largest, self._in_frames) if search is not None]

    def largest(self, mesh: int = 0) -> float:
        """The largest distance in the frames so far, in % of the diagonal: at most a thousandth above that of a point.

        It is the same whether those of single frames are asked for or not.
        """
        return 100 * float(self._overall[mesh])

    def per_frame(self, mesh: int = 0) -> FrameErrors:
        """The errors of a mesh in the frames so far; no largest distance of a frame is above :meth:`largest`.

        Raises:
            DegenerateMeshError: a mesh is collapsed in all of them.
        """
        if not self._rows:
            raise DegenerateMeshError("a mesh is collapsed to a point or a line in every frame")
        step = self._mesh_count
        found = {name: np.concatenate([row[name] for row in self._rows])[mesh::step] for name in self._rows[0]}
        ahead, back = found["rms_forward"], found["rms_backward"]
        found["hausdorff"] = np.minimum(found["hausdorff"], self.largest(mesh))
        found["rms"] = np.where(_forward_is_larger(ahead, back, self.sample_count), ahead, back)
        return FrameErrors(**found)

    def diagonals(self, mesh: int = 0) -> Doubles:
        """Bounding-box diagonals (n,) of a reference in the frames so far, in its units."""
        return np.concatenate(self._diagonals)[mesh :: self._mesh_count]
