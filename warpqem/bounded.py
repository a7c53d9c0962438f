"""Simplify as far as a distance allows: the fewest faces whose surface is proved to be within it, in every frame."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from warpqem.device import device_turn
from warpqem.errors import OptionError
from warpqem.frame_stream import ArraySink, FrameSink, NoFrames, SharedFrames, counted_frames
from warpqem.measure.bound import DistanceBound, Excess
from warpqem.mesh_input import MeshInput
from warpqem.order.levels import OrderedLevels
from warpqem.order.nodes import NodeRecorder
from warpqem.order.stage import OrderedMesh
from warpqem.preparation import ORDER_END, Prepared, Progress
from warpqem.result import Delivery, Outcome, SimplifiedMesh, finish, reached

__all__ = ["BoundSink", "ExceededError", "find_coarsest", "simplify_within", "start_count"]

# The largest distance is some times the largest error of a collapse, a mean over frames: where the search begins.
DISTANCE_PER_ERROR = 4.0
# The search begins with steps of so many times the faces, and ends where it knows the count to so much.
FIRST_STEP = 1.5
LAST_STEP = 1.06
# Times that one level is placed again, with the vertices around what is too far placed by their quadrics alone.
MAX_REPAIRS = 3
# Faces that may be too far for that, as part of the input's, or so many: beyond it, fewer collapses are what helps.
MAX_SPOTS, FEW_SPOTS = 0.01, 256


class ExceededError(Exception):
    """A distance does not hold; ``excess`` says where. Never seen by callers of the package."""

    def __init__(self, excess: Excess) -> None:
        super().__init__()
        self.excess = excess


class BoundSink:
    """Passes frames on, and raises an :class:`ExceededError` at the first that is too far from the input.

    Args:
        sink: takes the frames.
        mesh: the input.
        limit: distance as part of the diagonal of the input's bounding box in each frame.
        diagonal: the largest diagonal, which stands for that of a frame without extent.
        device: Warp device.
    """

    def __init__(self, sink: FrameSink, mesh: MeshInput, limit: float, diagonal: float, device: str) -> None:
        self._sink, self._mesh, self._limit, self._diagonal, self._device = sink, mesh, limit, diagonal, device
        self._bound: DistanceBound | None = None
        self._counted = counted_frames(mesh.source)

    def begin(self, frame_count: int, vertex_count: int, faces: np.ndarray) -> None:
        """Begin a mesh of so many frames."""
        self._sink.begin(frame_count, vertex_count, faces)
        self._bound = DistanceBound(self._mesh.faces, faces, self._limit, self._device)

    def write(self, frames: slice, points: np.ndarray) -> None:
        """Check consecutive frames."""
        self._sink.write(frames, points)
        reference = self._mesh.source.read(frames)
        assert self._bound is not None
        with device_turn(self._device):
            for index, frame in enumerate(range(frames.start, frames.stop)):
                if not self._counted[frame]:
                    continue
                own = reference[index].astype(np.float64)
                low, high = own[self._mesh.used].min(axis=0), own[self._mesh.used].max(axis=0)
                middle, unit = (low + high) / 2, float(np.linalg.norm(high - low)) or self._diagonal
                placed = points[index].astype(np.float64)
                excess = self._bound.excess(frame, (own - middle) / unit, (placed - middle) / unit)
                if excess is not None:
                    raise ExceededError(excess)


def find_coarsest(
    attempt: Callable[[int], SimplifiedMesh | None],
    face_count: int,
    *,
    start: int,
    least: int,
    limit: float,
    progress: Progress | None,
) -> SimplifiedMesh:
    """The level with the fewest faces that holds a distance, to some percent.

    Args:
        attempt: the level of so many faces; None where it does not hold.
        face_count: faces of the input.
        start: where to begin.
        least: the fewest faces to try.
        limit: the distance, for the message.
        progress: called after each level.

    Raises:
        OptionError: the input itself does not hold, as single precision does not place it so well.
    """
    good: SimplifiedMesh | None = None
    bad, count, left = 0, start, 1.0 - ORDER_END
    while True:
        found = attempt(count)
        # Each level takes about half of what is left.
        left /= 2
        if progress:
            progress(1.0 - left, "place")
        if found is not None:
            good = found
        elif count >= face_count:
            raise OptionError(f"max_error {100 * limit:g} %: single precision does not place the input itself so well")
        else:
            bad = count
        if good is None:
            count = min(math.ceil(count * FIRST_STEP), face_count)
            continue
        reached_count = len(good.faces)
        if found is not None and reached_count > count:
            # No legal collapse leads further.
            return good
        if reached_count <= least or reached_count - bad <= 1:
            return good
        # The input itself is no answer as long as there may be another.
        if reached_count <= bad * LAST_STEP and reached_count < face_count:
            return good
        count = round(math.sqrt(reached_count * bad)) if bad else max(math.floor(reached_count / FIRST_STEP), least)


def start_count(ordered: OrderedMesh, face_count: int, limit: float) -> int:
    """Faces where the errors of the collapses say that a distance may be reached."""
    log = ordered.log
    within = np.maximum.accumulate(log.error) * DISTANCE_PER_ERROR <= limit
    return max(face_count - int(log.faces_removed[: int(within.sum())].sum()), len(ordered.faces))


@dataclass(frozen=True)
class _Level:
    """How one level is placed.

    Attributes:
        count: the faces asked for.
        ordered: the topology.
        loose: (V,) bool, vertices that are placed loosely; None for none.
    """

    count: int
    ordered: OrderedMesh
    loose: np.ndarray | None = None


class _Levels:
    """Levels of one mesh, placed and checked one by one."""

    def __init__(self, work: Prepared, refit: bool, ordered: Callable[[int], OrderedMesh], keep: bool) -> None:
        self._work, self._refit, self._ordered, self._keep = work, refit, ordered, keep
        self._limit = work.goal.max_error / 100.0
        # The last level that held.
        self.held: _Level | None = None

    def attempt(self, count: int) -> SimplifiedMesh | None:
        """The level of so many faces, if it holds the distance."""
        level = _Level(count, self._ordered(count))
        for _ in range(MAX_REPAIRS + 1):
            array, mesh = ArraySink(), self._work.mesh
            kept = array if self._keep else NoFrames()
            sink = BoundSink(kept, mesh, self._limit, mesh.diagonal, self._work.device)
            try:
                result = self.place(level, Delivery(sink))
            except ExceededError as error:
                looser = self._looser(level, error.excess)
                if looser is None:
                    return None
                level = looser
            else:
                self.held = level
                return replace(result, points=array.points) if self._keep else result
        return None

    def place(self, level: _Level, delivery: Delivery) -> SimplifiedMesh:
        """Place a level."""
        work = replace(self._work, place_settings=replace(self._work.place_settings, loose=level.loose))
        return finish(work, work.placer(level.ordered), Outcome.of(level.ordered), self._refit, delivery)

    def place_held(self, delivery: Delivery) -> SimplifiedMesh:
        """Place the level that held once more. Levels share arrays, which those tried after it have changed."""
        assert self.held is not None
        return self.place(replace(self.held, ordered=self._ordered(self.held.count)), delivery)

    def _looser(self, level: _Level, excess: Excess) -> _Level | None:
        """The level with vertices around what is too far placed loosely; None where that cannot help."""
        faces, root = self._work.mesh.faces, level.ordered.root
        if len(excess.test_faces) + len(excess.reference_faces) > max(FEW_SPOTS, MAX_SPOTS * len(faces)):
            return None
        wanted = np.zeros(len(root), dtype=bool)
        wanted[root[faces[excess.reference_faces]]] = True
        # Output faces stand in the order of the ordered ones.
        wanted[level.ordered.faces[excess.test_faces]] = True
        wanted = wanted[root]
        if level.loose is not None:
            wanted |= level.loose
            if (wanted == level.loose).all():
                return None
        return replace(level, loose=wanted)


def simplify_within(work: Prepared, refit: bool, delivery: Delivery) -> SimplifiedMesh:
    """Simplify a mesh to the fewest faces, at least those of its goal, whose surface holds the goal's distance.

    Collapses are ordered once, and the number of faces is searched: each level is placed, refitted where that is asked
    for, and its distance from the input, both ways and in all frames, proved with :class:`DistanceBound` or refuted.

    Raises:
        OptionError: the limit is below what single precision places.
        UnreachableTargetError: as for :func:`warpqem.simplify`.
    """
    # One thread reads the frames to be placed, another those to compare with.
    work = replace(work, mesh=replace(work.mesh, source=SharedFrames(work.mesh.source)))
    recorder = None if work.order_settings.memoryless else NodeRecorder()
    coarsest = work.order(delivery.progress, recorder)
    face_count, limit = len(work.mesh.faces), work.goal.max_error / 100.0
    if recorder is None:
        # Each level has present faces of its own.
        levels = _Levels(work, refit, lambda count: work.with_target(count).order(), delivery.sink is None)
    else:
        known = OrderedLevels(work.mesh.faces, coarsest, recorder)
        levels = _Levels(work, refit, lambda count: known.at(known.steps_to(count)), delivery.sink is None)
    result = find_coarsest(
        levels.attempt,
        face_count,
        start=start_count(coarsest, face_count, limit),
        least=len(coarsest.faces),
        limit=limit,
        progress=delivery.progress,
    )
    if delivery.sink is not None:
        result = levels.place_held(delivery)
    if len(result.faces) > len(coarsest.faces):
        return replace(result, stopped="max_error")
    return reached(result, work.goal.target_faces)
