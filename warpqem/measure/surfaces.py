"""Two surfaces in motion, measured against each other a few frames at a time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.errors import DegenerateMeshError
from warpqem.kernels import surface_distance as kernels
from warpqem.kernels.distance_bound import HINTS, Surface
from warpqem.measure.per_frame import FrameErrors
from warpqem.runtime.cpu_threads import launch_parts, run_parts, split_range, thread_count
from warpqem.runtime.launches import launch

__all__ = ["SurfaceComparison", "sample_count"]

# Samples on each surface, over all frames together: the mean over the frames is then off by less than 1 %.
ALL_SAMPLES = 2**15
# Samples on each surface in one frame: at most so many, which one frame takes to be known as well; and at least so
# many, so that the larger of the two directions is known.
MAX_SAMPLES, MIN_SAMPLES = 20000, 64
# Samples that tell the root mean square distances of both directions apart to about a percent.
DECIDING_SAMPLES = 8192
# Frames are put together until they have so many faces, or are so many: a launch then takes long enough to be worth its
# start, and a hierarchy over them is built in a few milliseconds.
GROUP_FACES, MAX_GROUP = 2**14, 32
# Pieces that there is room for at first, for each face of both meshes.
PIECES_PER_FACE = 2
# Patches that are searched before the others.
LEADING = 64
# Samples and triangles that are worth a thread.
MIN_PART = 512
# A face with less area than this fraction of the squared diagonal has no normal that means anything.
DEGENERATE_AREA = 1e-14

Doubles = npt.NDArray[np.float64]


def sample_count(frame_count: int) -> int:
    """Samples on each surface in each of so many frames, where none are asked for."""
    return min(MAX_SAMPLES, max(MIN_SAMPLES, math.ceil(ALL_SAMPLES / frame_count)))


@dataclass
class _Samples:
    """Distances (G, S) and angles (G, S) of the samples of one surface in the frames of a group."""

    distance: Doubles
    angle: Doubles


@dataclass
class _Found:
    """What a search gives: see :func:`warpqem.kernels.surface_distance.largest_distances`."""

    low: wp.array
    high: wp.array
    piece: kernels.MeshPatches
    piece_count: wp.array


class _Cells:
    """One mesh on the device, in a group of frames: each frame is a cell of one mesh.

    Args:
        faces: (N, 3) int.
        group: frames G.
        name: what messages call the mesh.
        device: Warp device.
    """

    def __init__(self, faces: npt.NDArray[np.integer], group: int, name: str, device: str) -> None:
        self.name, self._group, self._device = name, group, device
        # Points without a face are no part of the surface.
        self.used = np.unique(faces)
        self.faces = np.searchsorted(self.used, faces).astype(np.int32)
        self.face_count = len(faces)
        first_point = len(self.used) * np.arange(group, dtype=np.int32)
        corners = (self.faces.ravel() + first_point[:, None]).ravel()
        self.surface = Surface()
        self.surface.corner_vertex = wp.array(corners, dtype=wp.int32, device=device)
        whole = np.tile([0.0, 0.0, 1.0, 0.0, 0.0, 1.0], (self.face_count, 1))
        hint = np.full((self.face_count, int(HINTS)), -1, dtype=np.int32)
        self.patches = _patches(np.arange(self.face_count), whole, hint, device)
        # The patches with the largest distances of late.
        self.leading: kernels.MeshPatches | None = None
        # The face of the other mesh nearest to the middle of each face, when it was last looked for; -1 for none.
        self.nearest = wp.full(self.face_count, -1, dtype=wp.int32, device=device)
        self._mesh: wp.Mesh | None = None

    def move(self, points: Doubles) -> None:
        """Show a group of frames (G, V, 3).

        The hierarchy is built once and refitted to the others: which of several faces as near as each other is found
        then depends on the first frames, and on nothing else.
        """
        flat = points.reshape(-1, 3)
        self.surface.points = wp.array(flat, dtype=wp.vec3d, device=self._device)
        single = wp.array(flat.astype(np.float32), dtype=wp.vec3, device=self._device)
        if self._mesh is None:
            self._mesh = wp.Mesh(points=single, indices=self.surface.corner_vertex)
        else:
            # Setting the points refits the hierarchy.
            self._mesh.points = single
        self.surface.mesh = self._mesh.id

    def lead(self, low: Doubles, floor: Doubles) -> None:
        """Note the patches with the largest distances, of those (n, P) that are above the floor (n,) of a frame."""
        above = np.where(low > floor[:, None], low, 0.0).max(axis=0)
        rows = np.flatnonzero(above)
        if len(rows):
            rows = rows[np.argsort(-above[rows], kind="stable")][:LEADING]
            patches = self.patches
            face, place, hint = (array.numpy()[rows] for array in (patches.face, patches.place, patches.hint))
            self.leading = _patches(face, place, hint, self._device)

    def areas(self) -> Doubles:
        """Face areas (G, N)."""
        area = wp.empty(self._group * self.face_count, dtype=wp.float64, device=self._device)
        launch(kernels.face_areas, dim=len(area), inputs=[self.surface], outputs=[area], device=self._device)
        found: Doubles = area.numpy().reshape(self._group, -1)
        return found


def _patches(
    face: npt.NDArray[np.integer], place: Doubles, hint: npt.NDArray[np.int32], device: str
) -> kernels.MeshPatches:
    patches = kernels.MeshPatches()
    patches.face = wp.array(face, dtype=wp.int32, device=device)
    patches.place = wp.array(place, dtype=wp.float64, device=device)
    patches.hint = wp.array(hint, dtype=wp.int32, device=device)
    return patches


def _forward_is_larger(ahead: Doubles, back: Doubles, samples: int) -> npt.NDArray[np.bool_]:
    """In which frames (n,) the first of two root mean square distances is to be taken for the larger one.

    Of two figures with noise the larger is too large in the mean. So neighbouring frames decide together, as many as
    have enough samples to tell the two apart.
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
    """Measures a test mesh against a reference, in one frame after another.

    In each frame, samples of both surfaces are drawn in proportion to area, in strata, and differently in each frame.
    The largest distance is searched for over both surfaces in all frames, by branch and bound
    (:mod:`warpqem.kernels.surface_distance`): it holds at every point, not at samples only. Equal frames give equal
    bits, however they come in blocks.

    Args:
        reference_faces: (N, 3) int.
        test_faces: (M, 3) int.
        frame_count: frames to come, at least 1.
        samples: samples on each surface in each frame.
        seed: seed of the samples.
        device: Warp device.

    Attributes:
        group: frames that are measured at once.
        sample_count: samples on each surface in each frame.
        test_faces: faces of the test mesh.
    """

    def __init__(
        self,
        reference_faces: npt.NDArray[np.integer],
        test_faces: npt.NDArray[np.integer],
        frame_count: int,
        samples: int,
        seed: int,
        device: str,
    ) -> None:
        largest = max(len(reference_faces), len(test_faces))
        self.group = max(1, min(MAX_GROUP, GROUP_FACES // largest, frame_count))
        self._reference = _Cells(reference_faces, self.group, "reference", device)
        self._test = _Cells(test_faces, self.group, "test", device)
        self.test_faces = len(test_faces)
        self.sample_count, self._seed, self._device = samples, seed, device
        self._rows: list[dict[str, npt.NDArray[Any]]] = []
        self._diagonals: list[Doubles] = []
        self._frame_count, self._seen = frame_count, 0

    def add(self, frames: Sequence[int], reference: npt.NDArray[Any], test: npt.NDArray[Any]) -> None:
        """Measure a group of frames: ``group`` of them, or fewer at the end.

        Args:
            frames: their numbers.
            reference: (n, V, 3) points of the reference.
            test: (n, W, 3) points of the test mesh.

        Raises:
            DegenerateMeshError: a frame of the reference has no extent, or of either mesh no area.
        """
        own, other = (
            mesh.astype(np.float64)[:, cells.used] for mesh, cells in ((reference, self._reference), (test, self._test))
        )
        low, high = own.min(axis=1), own.max(axis=1)
        diagonal = np.linalg.norm(high - low, axis=1)
        if not (diagonal > 0).all():
            raise DegenerateMeshError(f"reference points: no extent in frame {frames[int(np.argmin(diagonal))]}")
        middle = (low + high)[:, None] / 2
        own, other = ((points - middle) / diagonal[:, None, None] for points in (own, other))
        place = self._cell_places(max(float(np.abs(own).max()), float(np.abs(other).max())))
        missing = self.group - len(frames)
        for cells, points in ((self._reference, own), (self._test, other)):
            # Cells without a frame of their own show the last one.
            points = np.concatenate([points, np.repeat(points[-1:], missing, axis=0)]) if missing else points
            cells.move(points + place[:, None])
        self._diagonals.append(diagonal)
        self._measure(frames)
        self._seen += len(frames)

    def _cell_places(self, reach: float) -> Doubles:
        """Middles (G, 3) of the cells: so far apart that a mesh is nearer to its own points than any other cell is."""
        side = math.ceil(round(self.group ** (1 / 3), 6))
        index = np.stack(np.unravel_index(np.arange(self.group), (side, side, side)), axis=1)
        # Points of a cell are within 2 sqrt(3) reaches of each other, and the next cell begins 2 reaches before its
        # middle is reached.
        return (index - (side - 1) / 2) * (6.0 * reach)

    def _measure(self, frames: Sequence[int]) -> None:
        count = len(frames)
        reference, test = self._reference, self._test
        areas = [cells.areas() for cells in (reference, test)]
        for cells, area in zip((reference, test), areas, strict=True):
            empty = ~area.any(axis=1)
            if empty.any():
                raise DegenerateMeshError(
                    f"{cells.name} mesh: every face has zero area in frame {frames[int(np.argmax(empty))]}"
                )
        ahead = self._sampled(reference, test, areas[0], frames, 0)
        back = self._sampled(test, reference, areas[1], frames, 1)
        largest = self._largest(np.maximum(ahead.distance.max(axis=1), back.distance.max(axis=1)))
        rms = [np.sqrt((one.distance**2).mean(axis=1)) for one in (ahead, back)]
        self._rows.append(
            {
                "frame": np.array(frames, dtype=np.int64),
                "hausdorff": 100 * largest,
                "mean": 100 * (ahead.distance.mean(axis=1) + back.distance.mean(axis=1)) / 2,
                "rms_forward": 100 * rms[0],
                "rms_backward": 100 * rms[1],
                "normal_deviation": (ahead.angle.mean(axis=1) + back.angle.mean(axis=1)) / 2,
                "flips": self._flips(count),
                "degenerate_faces": (areas[1][:count] <= DEGENERATE_AREA).sum(axis=1),
            }
        )

    def _sampled(self, own: _Cells, other: _Cells, areas: Doubles, frames: Sequence[int], side: int) -> _Samples:
        count = len(frames)
        face, place = self._draw(areas[:count], frames, side)
        face += (own.face_count * np.arange(count))[:, None]
        shape = face.shape
        inputs = [
            own.surface,
            other.surface,
            wp.array(face.ravel(), dtype=wp.int32, device=self._device),
            wp.array(place.reshape(-1, 2), dtype=wp.vec2d, device=self._device),
        ]
        distance, angle = (wp.empty(face.size, dtype=wp.float64, device=self._device) for _ in range(2))
        self._launch(kernels.sample_distances, face.size, inputs, [distance, angle])
        found = _Samples(distance.numpy().reshape(shape), angle.numpy().reshape(shape))
        if (found.distance < 0).any():
            frame = frames[int(np.argmax((found.distance < 0).any(axis=1)))]
            raise DegenerateMeshError(f"{other.name} mesh: every face is degenerate in frame {frame}")
        return found

    def _draw(self, areas: Doubles, frames: Sequence[int], side: int) -> tuple[npt.NDArray[np.int64], Doubles]:
        """Faces (n, S) and barycentric coordinates of their second and third corner (n, S, 2).

        The area before a sample, in the order of the faces, is drawn in as many strata as there are samples. What is
        left of it within the face is the first number of the square-root map of Osada et al., "Shape Distributions"
        (2002), equation 1, so that the strata go on within the faces.
        """
        total = np.cumsum(areas, axis=1)
        face = np.empty((len(areas), self.sample_count), dtype=np.int64)
        first, second = np.empty(face.shape), np.empty(face.shape)
        stratum = np.arange(self.sample_count)
        for row, frame in enumerate(frames):
            random = np.random.default_rng([self._seed, frame, side])
            drawn = (stratum + random.random(self.sample_count)) * (total[row, -1] / self.sample_count)
            # Rounding may put the last one beyond the last face with an area.
            last = int(np.searchsorted(total[row], total[row, -1]))
            face[row] = np.searchsorted(total[row], drawn, side="right").clip(0, last)
            area = areas[row, face[row]]
            first[row] = np.clip(1.0 - (total[row, face[row]] - drawn) / area, 0.0, 1.0)
            second[row] = random.random(self.sample_count)
        root = np.sqrt(first)
        return face, np.stack([root * (1.0 - second), root * second], axis=-1)

    def _largest(self, sampled: Doubles) -> Doubles:
        """The largest distance in each frame of a group (n,), where samples at such distances are known."""
        pairs = (self._reference, self._test), (self._test, self._reference)
        found, bound = sampled.copy(), sampled
        if self._seen == 0 and self._frame_count > 1:
            for own, other in pairs:
                found[:1] = self._cut(own, other, found[:1])
        for own, other in pairs:
            # Where it was in the frames before, it mostly is in these. The more is found at once, the less is left.
            if own.leading is not None:
                found = np.maximum(found, self._search(own, other, found, own.leading).low.numpy().max(axis=1))
        for own, other in pairs:
            result = self._search(own, other, found)
            low, high = result.low.numpy(), result.high.numpy()
            own.lead(low, found)
            found, bound = np.maximum(found, low.max(axis=1)), np.maximum(bound, high.max(axis=1))
        return np.maximum(found, bound)

    def _cut(self, own: _Cells, other: _Cells, floor: Doubles) -> Doubles:
        """Cut the faces of ``own`` to patches that are as large as one face of ``other`` is enough for.

        Returns:
            (1,) the largest distance in the first frame, or the floor.
        """
        # The first frame shows how. The larger the distance that is known, the larger the patches.
        floor = self._search(own, other, floor).low.numpy().max(axis=1)
        room = max(1, PIECES_PER_FACE * (own.face_count + other.face_count))
        hint = own.patches.hint.numpy().copy()
        while True:
            found = self._search(own, other, floor, room=room)
            counts = found.piece_count.numpy()
            if counts.max() <= room:
                break
            # Again as it was, so that the patches do not depend on the number of parts.
            own.patches.hint.assign(hint)
            room = int(counts.max())
        rows = np.concatenate([part * room + np.arange(count) for part, count in enumerate(counts)])
        face = found.piece.face.numpy()[rows]
        # A face is cut by one thread; threads come in any order.
        order = np.argsort(face, kind="stable")
        rows = rows[order]
        place, hint = found.piece.place.numpy()[rows], found.piece.hint.numpy()[rows]
        own.patches = _patches(face[order], place, hint, self._device)
        return floor

    def _search(
        self,
        own: _Cells,
        other: _Cells,
        floor: Doubles,
        patches: kernels.MeshPatches | None = None,
        room: int = 0,
    ) -> _Found:
        """Search some patches of ``own``, or all, for what is beyond a floor (n,) in each frame.

        The pieces they are cut into are kept where there is room for so many in each part.
        """
        patches = own.patches if patches is None else patches
        count, patch_count = len(floor), len(patches.face)
        runs = -(-patch_count // int(kernels.RUN))
        parts = split_range(runs, min(thread_count(self._device), max(1, patch_count // MIN_PART)))
        low, high = (wp.empty((count, patch_count), dtype=wp.float64, device=self._device) for _ in range(2))
        piece = kernels.MeshPatches()
        piece.face = wp.empty(len(parts) * room, dtype=wp.int32, device=self._device)
        piece.place = wp.empty((len(parts) * room, 6), dtype=wp.float64, device=self._device)
        piece.hint = wp.empty((len(parts) * room, int(HINTS)), dtype=wp.int32, device=self._device)
        piece_count = wp.zeros(len(parts), dtype=wp.int32, device=self._device)
        inputs = [own.surface, other.surface, own.face_count, other.face_count, count]
        inputs.append(wp.array(floor, dtype=wp.float64, device=self._device))

        def search(index: int, part: slice) -> None:
            launch(
                kernels.largest_distances,
                dim=part.stop - part.start,
                inputs=[*inputs, index, part.start, patches, piece_count],
                outputs=[piece, low, high],
                device=self._device,
            )

        run_parts([partial(search, index, part) for index, part in enumerate(parts)])
        return _Found(low, high, piece, piece_count)

    def _flips(self, count: int) -> npt.NDArray[np.int64]:
        test, reference = self._test, self._reference
        flipped = wp.empty((count, test.face_count), dtype=wp.int32, device=self._device)
        sizes = [test.face_count, reference.face_count, count]
        inputs = [test.surface, reference.surface, *sizes, DEGENERATE_AREA, test.nearest]
        self._launch(kernels.find_flips, test.face_count, inputs, [flipped])
        total: npt.NDArray[np.int64] = flipped.numpy().sum(axis=1, dtype=np.int64)
        return total

    def _launch(self, kernel: wp.Kernel, count: int, inputs: list[Any], outputs: list[wp.array]) -> None:
        def one(part: slice) -> None:
            launch(
                kernel,
                dim=part.stop - part.start,
                inputs=[*inputs, part.start],
                outputs=outputs,
                device=self._device,
            )

        launch_parts(one, count, self._device, MIN_PART)

    def per_frame(self) -> FrameErrors:
        """The errors of the frames so far."""
        found = {name: np.concatenate([row[name] for row in self._rows]) for name in self._rows[0]}
        ahead, back = found["rms_forward"], found["rms_backward"]
        found["rms"] = np.where(_forward_is_larger(ahead, back, self.sample_count), ahead, back)
        return FrameErrors(**found)

    def diagonals(self) -> Doubles:
        """Bounding-box diagonals (n,) of the reference in the frames so far, in its units."""
        return np.concatenate(self._diagonals)
