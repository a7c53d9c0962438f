"""Simplify as far as a distance allows: about the fewest faces whose surface is proved to be within it, in every frame.

Edges are collapsed once. A level is a cut through the forest of these collapses (:mod:`warpqem.order.cut`): first all
of them, whose errors, means over frames, are well within the limit. It is placed and bounded
(:class:`warpqem.measure.bound.DistanceBound`); where a face is not proved to be within the limit, the last collapse of
the largest error there is left out, and the next cut is bounded where it differs. So a spot holds back itself alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from warpqem.device import device_turn
from warpqem.errors import OptionError
from warpqem.frame_stream import ArraySink, FrameSink, NoFrames, SharedFrames
from warpqem.measure.bound import DistanceBound, Excess, UnitBlock, UnitFrames
from warpqem.mesh_input import MeshInput
from warpqem.order.cut import CollapseForest, Cut
from warpqem.order.levels import OrderedLevels
from warpqem.order.nodes import NodeRecorder
from warpqem.order.stage import OrderedMesh
from warpqem.place.stage import Placer
from warpqem.preparation import ORDER_END, Prepared, Progress
from warpqem.result import Delivery, Outcome, SimplifiedMesh, finish, reached

__all__ = ["BoundSink", "ExceededError", "simplify_within"]

# Errors of collapses are means over frames and faces; the largest distance is so many times as large or more.
DISTANCE_PER_ERROR = 3.0
# Errors below may be those of single precision, which on flat parts are all there is: they hold nothing back.
NO_ERROR = 1.0e-4
# Where the largest error of a collapse around is less than so many times below the limit, it is not the shape of fewer
# faces that is too far, but vertices that follow the material: these are placed loosely.
LOOSE_BELOW = 8.0
# Frames that a level is bounded in first, far apart in pose: as many as are looked at together.
FIRST_FRAMES = 8


class ExceededError(Exception):
    """A distance does not hold; ``excess`` says where. Never seen by callers of the package."""

    def __init__(self, excess: Excess) -> None:
        super().__init__()
        self.excess = excess


class _Frames:
    """Frames of the input at unit size, the last block kept.

    Args:
        mesh: the input.
        diagonal: the largest diagonal, which stands for that of a frame without extent.
        device: Warp device.
    """

    def __init__(self, mesh: MeshInput, diagonal: float, device: str) -> None:
        self._mesh, self._diagonal, self._device = mesh, diagonal, device
        self._kept: tuple[object, UnitFrames, UnitBlock] | None = None

    def block(self, frames: slice) -> tuple[UnitFrames, UnitBlock]:
        """Consecutive frames."""
        key = frames.start, frames.stop
        if self._kept is None or self._kept[0] != key:
            points = self._mesh.source.read(frames)
            units = self.units(points)
            self._kept = key, units, UnitBlock(points, units, self._device)
        return self._kept[1:]

    def units(self, points: npt.NDArray[np.floating]) -> UnitFrames:
        """What brings frames (n, V, 3) to unit size."""
        used = points if self._mesh.used.all() else points[:, self._mesh.used]
        low, high = used.min(axis=1).astype(np.float64), used.max(axis=1).astype(np.float64)
        unit = np.linalg.norm(high - low, axis=1)
        return UnitFrames((low + high) / 2, np.where(unit > 0.0, unit, self._diagonal))


class BoundSink:
    """Passes frames on, and looks for those that are too far from the input.

    Args:
        sink: takes the frames.
        mesh: the input.
        limit: distance as part of the diagonal of the input's bounding box in each frame.
        diagonal: the largest diagonal, which stands for that of a frame without extent.
        device: Warp device.
    """

    def __init__(self, sink: FrameSink, mesh: MeshInput, limit: float, diagonal: float, device: str) -> None:
        self._sink, self._mesh, self._limit, self._device = sink, mesh, limit, device
        self._frames = _Frames(mesh, diagonal, device)
        self._bound: DistanceBound | None = None

    def begin(self, frame_count: int, vertex_count: int, faces: np.ndarray) -> None:
        """Begin a mesh of so many frames."""
        self._sink.begin(frame_count, vertex_count, faces)
        self._bound = DistanceBound(self._mesh.faces, faces, self._limit, self._device)

    def write(self, frames: slice, points: np.ndarray) -> None:
        """Check consecutive frames.

        Raises:
            ExceededError: one is too far.
        """
        self._sink.write(frames, points)
        assert self._bound is not None
        with device_turn(self._device):
            units, reference = self._frames.block(frames)
            excess = self._bound.excess_of_blocks(
                frames.start, reference, UnitBlock(points, units, self._device), enough=0
            )
        if excess is not None:
            raise ExceededError(excess)


@dataclass(frozen=True)
class _Choice:
    """What decides a level.

    Attributes:
        cut: its collapses.
        loose: (V,) bool, input vertices whose clusters are placed by their quadrics, with the least pull.
    """

    cut: Cut
    loose: np.ndarray


@dataclass(frozen=True)
class _Level:
    """One level: what decides it, and the mesh."""

    choice: _Choice
    ordered: OrderedMesh
    placer: Placer


class _BoundFrames:
    """Bounds the frames of a level as they come, keeps where they are too far, and passes them on."""

    def __init__(self, sink: FrameSink, frames: _Frames, bound: DistanceBound, device: str) -> None:
        self._sink, self._frames, self._bound, self._device = sink, frames, bound, device
        self.excess: list[Excess] = []

    def begin(self, frame_count: int, vertex_count: int, faces: np.ndarray) -> None:
        """Pass it on."""
        self._sink.begin(frame_count, vertex_count, faces)

    def write(self, frames: slice, points: np.ndarray) -> None:
        """Bound consecutive frames."""
        self._sink.write(frames, points)
        with device_turn(self._device):
            units, reference = self._frames.block(frames)
            found = self._bound.excess_of_blocks(frames.start, reference, UnitBlock(points, units, self._device))
        if found is not None:
            self.excess.append(found)


class _Search:
    """Cuts of one mesh, bounded one after another.

    Args:
        work: the mesh.
        refit: whether levels are refitted.
        known: all levels of its ordering.
        forest: the collapses.
    """

    def __init__(self, work: Prepared, refit: bool, known: OrderedLevels, forest: CollapseForest) -> None:
        self._work, self._refit, self._known, self._forest = work, refit, known, forest
        self._limit = work.goal.max_error / 100.0
        self._frames = _Frames(work.mesh, work.mesh.diagonal, work.device)
        self._bound: DistanceBound | None = None
        self._level: _Level | None = None

    def run(self, keep: bool, progress: Progress | None) -> tuple[_Choice, SimplifiedMesh]:
        """The level that holds, and its result; with its points where they are to be kept."""
        left = 1.0 - ORDER_END
        choice = _Choice(self._forest.whole(), np.zeros(len(self._work.mesh.used), dtype=bool))
        if self._refit or self._work.mesh.frame_count > FIRST_FRAMES:
            choice = self._within_some(choice)
            if self._bound is not None:
                self._bound.look_again()
        while True:
            level = self._level_of(choice)
            array = ArraySink()
            sink = _BoundFrames(array if keep else NoFrames(), self._frames, self._bound_of(level), self._work.device)
            result = self._finish(level, Delivery(sink))
            if progress:
                # Nobody knows how many levels there are going to be: each takes half of what is left.
                left /= 2
                progress(1.0 - left, "place")
            if not sink.excess:
                return choice, replace(result, points=array.points) if keep else result
            for excess in sink.excess:
                choice = self._finer(level, choice, excess)

    def place(self, choice: _Choice, delivery: Delivery) -> SimplifiedMesh:
        """The result of a level."""
        return self._finish(self._level_of(choice), delivery)

    def _finish(self, level: _Level, delivery: Delivery) -> SimplifiedMesh:
        return finish(self._work, level.placer, Outcome.of(level.ordered), self._refit, delivery)

    def _within_some(self, choice: _Choice) -> _Choice:
        """The level that holds in some frames, far apart in pose, before it is refitted."""
        mesh, keys = self._work.mesh, self._work.key_frames
        chosen = keys[np.unique(np.linspace(0, len(keys) - 1, FIRST_FRAMES).astype(int))]
        own = np.concatenate([mesh.source.read(slice(frame, frame + 1)) for frame in chosen.tolist()])
        about, units = mesh.chosen_points(chosen), self._frames.units(own)
        reference = UnitBlock(own, units, self._work.device)
        while True:
            level = self._level_of(choice)
            points = level.placer.original_points(mesh, level.placer.place(mesh, about))
            block = UnitBlock(points, units, self._work.device)
            excess = self._bound_of(level).excess_of_blocks(0, reference, block)
            if excess is None:
                return choice
            choice = self._finer(level, choice, excess)

    def _level_of(self, choice: _Choice) -> _Level:
        ordered, work = self._known.at_cut(choice.cut), self._work
        work = replace(work, place_settings=replace(work.place_settings, loose=choice.loose))
        return _Level(choice, ordered, work.placer(ordered))

    def _bound_of(self, level: _Level) -> DistanceBound:
        """What bounds a level, with what is known from the one before."""
        work, ordered, placer = self._work, level.ordered, level.placer
        # A face of the level at each vertex.
        near = np.full(len(work.mesh.used), -1, dtype=np.int32)
        near[ordered.faces.ravel()] = np.repeat(np.arange(len(ordered.faces), dtype=np.int32), 3)
        near = near[ordered.root[work.mesh.faces[:, 0]]]
        near[ordered.face_map] = np.arange(len(ordered.faces))
        if self._bound is None or self._level is None:
            bound = DistanceBound(work.mesh.faces, placer.faces, self._limit, work.device, near, ordered.face_map)
        else:
            before = self._level.ordered
            index = np.full(len(work.mesh.faces), -1, dtype=np.int64)
            index[before.face_map] = np.arange(len(before.faces))
            old = index[ordered.face_map]
            old[old >= 0] = np.where(
                (before.faces[old[old >= 0]] == ordered.faces[old >= 0]).all(axis=1), old[old >= 0], -1
            )
            # A vertex lies where its cluster and its last collapse put it.
            last, last_before = (self._forest.last_collapses(lvl.choice.cut) for lvl in (level, self._level))
            still = (last == last_before) & (level.choice.loose == self._level.choice.loose)
            same = (old >= 0) & still[ordered.faces].all(axis=1) & (not self._refit)
            bound = self._bound.succeeded_by(placer.faces, old, same, ordered.face_map, near)
        self._bound, self._level = bound, level
        return bound

    def _finer(self, level: _Level, choice: _Choice, excess: Excess) -> _Choice:
        """A choice that is to come nearer around what is too far.

        Raises:
            OptionError: there is none.
        """
        ordered, forest = level.ordered, self._forest
        faces = self._work.mesh.faces[excess.reference_faces]
        vertex_drop = ordered.drops.vertex_drop[faces[:, 0]]
        lost, faces = vertex_drop[vertex_drop >= 0], faces[vertex_drop < 0]
        corners = np.concatenate([ordered.root[faces], ordered.faces[excess.test_faces]])
        last = forest.last_collapses(level.choice.cut)[corners]
        error = np.where(last >= 0, forest.log.error[last], -1.0)
        largest = error.argmax(axis=1)[:, None]
        collapses = np.take_along_axis(last, largest, axis=1)[:, 0]
        if (collapses < 0).any():
            limit = self._work.goal.max_error
            raise OptionError(f"max_error {limit:g} %: single precision does not place the input itself so well")
        # Clusters of several vertices follow the material.
        merged = (last >= 0) & ~choice.loose[corners]
        small = np.take_along_axis(error, largest, axis=1)[:, 0] <= max(self._limit / LOOSE_BELOW, NO_ERROR)
        loosen = merged.any(axis=1) & small
        loose = choice.loose.copy()
        loose[corners[loosen]] = True
        dropped = np.flatnonzero(level.choice.cut.dropped)[np.unique(lost)]
        return _Choice(forest.without(choice.cut, np.unique(collapses[~loosen]), dropped), loose)


def simplify_within(work: Prepared, refit: bool, delivery: Delivery) -> SimplifiedMesh:
    """Simplify a mesh to about the fewest faces, at least those of its goal, whose surface holds the goal's distance.

    Raises:
        OptionError: the limit is below what single precision places.
        UnreachableTargetError: as for :func:`warpqem.simplify`.
    """
    # One thread reads the frames to be placed, another those to compare with.
    work = replace(work, mesh=replace(work.mesh, source=SharedFrames(work.mesh.source)))
    recorder = NodeRecorder()
    furthest = max(work.goal.max_error / 100.0 / DISTANCE_PER_ERROR, NO_ERROR)
    work = replace(work, order_settings=replace(work.order_settings, error_limit=furthest))
    coarsest = work.order(delivery.progress, recorder)
    forest = CollapseForest(coarsest.log, coarsest.drops, len(coarsest.root))
    search = _Search(work, refit, OrderedLevels(work.mesh.faces, coarsest, recorder), forest)
    choice, result = search.run(delivery.sink is None, delivery.progress)
    if delivery.sink is not None:
        # Levels share arrays, which those tried after it have changed.
        result = search.place(choice, delivery)
    if not (choice.cut.kept.all() and choice.cut.dropped.all()):
        return replace(result, stopped="max_error")
    return reached(result, work.goal.target_faces)
