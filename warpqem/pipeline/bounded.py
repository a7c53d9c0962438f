"""Simplify as far as a distance allows: about the fewest faces whose surface is proved to be within it, in every frame.

Edges are collapsed once. A level is a cut through the forest of these collapses
(:mod:`warpqem.decimation.forest_cut`): first those whose errors, means over frames, are well within the limit. It is
placed and bounded (:class:`warpqem.measure.bound.DistanceBound`); where a face is not proved to be within the limit,
the last collapse of the largest error there is left out, and the next cut is bounded where it differs. So a spot holds
back itself alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from warpqem.arguments.distance_limit import DistanceLimit
from warpqem.decimation.collapse_nodes import NodeRecorder
from warpqem.decimation.decimate import DecimatedMesh
from warpqem.decimation.forest_cut import CollapseForest, Cut
from warpqem.decimation.replay import OrderedLevels
from warpqem.errors import OptionError
from warpqem.frames.stream import ArraySink, FrameSink, NoFrames, SharedFrames, counted_frames
from warpqem.measure.bound import DistanceBound, Excess, UnitBlock, UnitFrames
from warpqem.mesh.mesh_input import AnimatedMesh, MeshInput
from warpqem.pipeline.prepare import ORDER_END, Prepared, Progress
from warpqem.pipeline.result import Delivery, Outcome, SimplifiedMesh, finish, in_input_terms, reached, written_faces
from warpqem.place.clusters import ClusterPlacer
from warpqem.repair.mended_mesh import faces_for
from warpqem.runtime.device import device_turn

__all__ = ["BoundSink", "ExceededError", "simplify_within"]

# Errors of collapses are means over frames and faces; the largest distance is so many times as large or more.
# The first level is where the limit is this many times the error; where few faces are too far, the next is tried.
DISTANCE_PER_ERROR = (3.0, 2.0, 1.5)
# So few, as a part of the input's faces.
FEW = 0.005
# Errors below may be those of single precision, which on flat parts are all there is: they hold nothing back.
NO_ERROR = 1.0e-4
# Where the largest error of a collapse around is less than so many times below the limit, it is not the shape of fewer
# faces that is too far, but vertices that follow the material: these are placed loosely.
LOOSE_BELOW = 8.0
# Frames that a level is bounded in first, far apart in pose: as many as are looked at together.
FIRST_FRAMES = 8
# Frames of so many bytes are kept, so that of the next level only what has moved is placed.
KEPT_BYTES = 16 * 2**20
# A frame in which nobody sees the mesh is bounded as if it were so many times smaller: nothing in it is too far.
UNSEEN = 1e9


class ExceededError(Exception):
    """A distance does not hold; ``excess`` says where. Never seen by callers of the package."""

    def __init__(self, excess: Excess) -> None:
        super().__init__()
        self.excess = excess


class _Frames:
    """Frames of the input at a size of one or less, in which the limit is the same in all; the last block is kept.

    Args:
        mesh: the input.
        limit: distance.
        diagonal: the largest diagonal, which stands for that of a frame without extent.
        device: Warp device.
    """

    def __init__(self, mesh: MeshInput, limit: DistanceLimit, diagonal: float, device: str) -> None:
        self._mesh, self._limit, self._diagonal, self._device = mesh, limit, diagonal, device
        self._counted = counted_frames(mesh.source)
        self._kept: tuple[object, UnitFrames, UnitBlock] | None = None

    def block(self, frames: slice) -> tuple[UnitFrames, UnitBlock]:
        """Consecutive frames."""
        key = frames.start, frames.stop
        if self._kept is None or self._kept[0] != key:
            points = self._mesh.source.read(frames)
            units = self.units(points, np.arange(frames.start, frames.stop))
            self._kept = key, units, UnitBlock(points, units, self._device)
        return self._kept[1:]

    def units(self, points: npt.NDArray[np.floating], frames: npt.NDArray[np.integer]) -> UnitFrames:
        """What brings frames (n, V, 3) to unit size, those in which nobody sees the mesh to next to none."""
        used = points if self._mesh.used.all() else points[:, self._mesh.used]
        low, high = used.min(axis=1).astype(np.float64), used.max(axis=1).astype(np.float64)
        diagonal = np.linalg.norm(high - low, axis=1)
        diagonal = np.where(diagonal > 0.0, diagonal, self._diagonal)
        units = self._limit.units(diagonal, self._diagonal)
        return UnitFrames((low + high) / 2, np.where(self._counted[frames], units, UNSEEN * units))


class BoundSink:
    """Passes frames on, and looks for those that are too far from the input.

    Args:
        sink: takes the frames.
        mesh: the input.
        limit: distance.
        diagonal: the largest diagonal, which stands for that of a frame without extent.
        device: Warp device.
    """

    def __init__(self, sink: FrameSink, mesh: MeshInput, limit: DistanceLimit, diagonal: float, device: str) -> None:
        self._sink, self._mesh, self._limit, self._device = sink, mesh, limit.relative(diagonal), device
        self._frames = _Frames(mesh, limit, diagonal, device)
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


class _Level:
    """One level: what decides it, and the mesh.

    Attributes:
        choice: what decides it.
        ordered: its topology.
        kept: (C,) int32, the input vertices that its clusters go by, ascending.
        faces: (N', 3) int32 over these.
        last: (V,) int, the last collapse of each cluster, see :func:`warpqem.decimation.forest_cut.last_collapses`.
    """

    def __init__(self, choice: _Choice, ordered: DecimatedMesh, last: np.ndarray) -> None:
        self.choice, self.ordered, self.last = choice, ordered, last
        self.kept, faces = np.unique(ordered.faces, return_inverse=True)
        self.faces = faces.reshape(-1, 3).astype(np.int32)

    def unmoved(self, before: _Level) -> np.ndarray:
        """(V,) bool, kept vertices whose clusters and placement are those of another level."""
        unmoved: np.ndarray = (self.last == before.last) & (self.choice.loose == before.choice.loose)
        there = np.zeros(len(unmoved), dtype=bool)
        there[before.kept] = True
        return unmoved & there


class _Block:
    """Frames of the input, and of the levels one after another; of each only what moved is placed."""

    def __init__(self, work: Prepared, about: np.ndarray, own: np.ndarray, units: UnitFrames) -> None:
        self._work, self._about, self._units = work, about, units
        self.reference = UnitBlock(own, units, work.device)
        self._points = np.empty(about.shape, dtype=np.float32)

    def place(self, placer: ClusterPlacer, kept: np.ndarray) -> None:
        """Place the clusters that go by some vertices."""
        self._points[:, kept] = placer.original_points(self._work.mesh, placer.place(self._work.mesh, self._about))

    def points(self, level: _Level) -> np.ndarray:
        """The level, (n, C, 3)."""
        points: np.ndarray = self._points[:, level.kept]
        return points

    def test(self, level: _Level) -> UnitBlock:
        """The level at unit size."""
        return UnitBlock(self.points(level), self._units, self._work.device)


class _BoundFrames:
    """Bounds the frames of a level as they come, keeps where they are too far, and passes them on.

    ``proved`` (F, C, 3) are frames that have been bounded: those that come with the same bits are not bounded again,
    and ``differs`` says whether some did not.
    """

    def __init__(
        self, sink: FrameSink, frames: _Frames, bound: DistanceBound, device: str, proved: np.ndarray | None
    ) -> None:
        self._sink, self._frames, self._bound, self._device = sink, frames, bound, device
        self._proved, self.differs = proved, False
        self.excess: list[Excess] = []

    def begin(self, frame_count: int, vertex_count: int, faces: np.ndarray) -> None:
        """Pass it on."""
        self._sink.begin(frame_count, vertex_count, faces)

    def write(self, frames: slice, points: np.ndarray) -> None:
        """Bound consecutive frames."""
        self._sink.write(frames, points)
        if self._proved is not None:
            self.differs |= not np.array_equal(self._proved[frames], points)
            return
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
        limit = work.goal.limit
        self._limit = limit.relative(work.mesh.diagonal)
        self._frames = _Frames(work.mesh, limit, work.mesh.diagonal, work.device)
        self._bound: DistanceBound | None = None
        self._level: _Level | None = None

    def run(self, keep: bool, progress: Progress | None) -> tuple[_Choice, SimplifiedMesh]:
        """The level that holds, and its result; with its points where they are to be kept."""
        left, mesh = 1.0 - ORDER_END, self._work.mesh
        loose = np.zeros(len(mesh.used), dtype=bool)
        starts = [max(self._limit / part, NO_ERROR) for part in DISTANCE_PER_ERROR]
        choice, *coarser = [_Choice(self._forest.within(error), loose) for error in starts]
        if self._refit or mesh.frame_count > 2 * FIRST_FRAMES:
            choice, coarser = self._within(choice, self._first_block(), coarser), []
        proved: np.ndarray | None = None
        if not self._refit and 12 * mesh.frame_count * mesh.vertex_count <= KEPT_BYTES:
            block = self._block(slice(0, mesh.frame_count))
            choice = self._within(choice, block, coarser)
            assert self._level is not None
            proved = block.points(self._level)
        elif self._bound is not None:
            self._bound.look_again()
        while True:
            level = self._level_of(choice)
            array = ArraySink()
            bound = self._bound_of(level)
            sink = _BoundFrames(array if keep else NoFrames(), self._frames, bound, self._work.device, proved)
            result = self._finish(level, Delivery(sink))
            if progress:
                # Nobody knows how many levels there are going to be: each takes half of what is left.
                left /= 2
                progress(1.0 - left, "place")
            if not sink.excess and not sink.differs:
                return choice, replace(result, points=array.points) if keep else result
            if sink.differs:
                proved = None
                self._bound_of(level).look_again()
                continue
            for excess in sink.excess:
                choice = self._finer(level, choice, excess)

    def place(self, choice: _Choice, delivery: Delivery, mesh: AnimatedMesh) -> SimplifiedMesh:
        """The result of a level, in the terms of the mesh as it is given."""
        return self._finish(self._level_of(choice), delivery, mesh)

    def _finish(self, level: _Level, delivery: Delivery, mesh: AnimatedMesh | None = None) -> SimplifiedMesh:
        work = self._work_of(level)
        work = work if mesh is None else replace(work, mesh=mesh)
        return finish(work, work.placer(level.ordered), Outcome.of(level.ordered), self._refit, delivery)

    def _work_of(self, level: _Level) -> Prepared:
        settings = replace(self._work.place_settings, loose=level.choice.loose)
        return replace(self._work, place_settings=settings)

    def _first_block(self) -> _Block:
        """Some frames, far apart in pose."""
        mesh, keys = self._work.mesh, self._work.key_frames
        chosen = keys[np.unique(np.linspace(0, len(keys) - 1, FIRST_FRAMES).astype(int))]
        own = np.concatenate([mesh.source.read(slice(frame, frame + 1)) for frame in chosen.tolist()])
        return _Block(self._work, mesh.chosen_points(chosen), own, self._frames.units(own, chosen))

    def _block(self, frames: slice) -> _Block:
        own = self._work.mesh.source.read(frames)
        units = self._frames.units(own, np.arange(frames.start, frames.stop))
        return _Block(self._work, self._work.mesh.points(frames), own, units)

    def _within(self, choice: _Choice, block: _Block, coarser: Sequence[_Choice]) -> _Choice:
        """The level that holds in some frames, before it is refitted.

        ``coarser`` are tried in place of the first one, as long as few faces are too far.
        """
        next_choices = iter(coarser)
        before: _Level | None = None
        if self._bound is not None:
            self._bound.look_again()
        while True:
            level = self._level_of(choice)
            bound = self._bound_of(level)
            moved = level.kept if before is None else level.kept[~level.unmoved(before)[level.kept]]
            if len(moved):
                placer = self._placer_of(level, moved)
                block.place(placer, moved)
            excess = bound.excess_of_blocks(0, block.reference, block.test(level))
            count = 0 if excess is None else len(excess.reference_faces) + len(excess.test_faces)
            following = next(next_choices, None) if count <= FEW * len(self._work.mesh.faces) else None
            if following is not None:
                choice = following
            elif excess is None:
                return choice
            else:
                next_choices = iter(())
                choice = self._finer(level, choice, excess)
            before = level

    def _placer_of(self, level: _Level, kept: np.ndarray) -> ClusterPlacer:
        """What places the clusters that go by some vertices."""
        work = self._work_of(level)
        index = np.full(len(work.mesh.used), -1, dtype=np.int32)
        index[kept] = np.arange(len(kept), dtype=np.int32)
        cluster = index[level.ordered.root]
        return ClusterPlacer(
            work.mesh.faces,
            level.ordered,
            kept,
            cluster,
            work.quadric_scale,
            work.pinned,
            work.place_settings,
            work.device,
            work.quadric_sums,
        )

    def _level_of(self, choice: _Choice) -> _Level:
        if self._level is not None and choice is self._level.choice:
            return self._level
        return _Level(choice, self._known.at_cut(choice.cut), self._forest.last_collapses(choice.cut))

    def _bound_of(self, level: _Level) -> DistanceBound:
        """What bounds a level, with what is known from the one before."""
        work, ordered = self._work, level.ordered
        if self._bound is not None and self._level is level:
            return self._bound
        # A face of the level at each vertex.
        near = np.full(len(work.mesh.used), -1, dtype=np.int32)
        near[ordered.faces.ravel()] = np.repeat(np.arange(len(ordered.faces), dtype=np.int32), 3)
        near = near[ordered.root[work.mesh.faces[:, 0]]]
        near[ordered.face_map] = np.arange(len(ordered.faces))
        if self._bound is None or self._level is None:
            bound = DistanceBound(work.mesh.faces, level.faces, self._limit, work.device, near, ordered.face_map)
        else:
            before = self._level.ordered
            index = np.full(len(work.mesh.faces), -1, dtype=np.int64)
            index[before.face_map] = np.arange(len(before.faces))
            old = index[ordered.face_map]
            there = np.flatnonzero(old >= 0)
            old[there[(before.faces[old[there]] != ordered.faces[there]).any(axis=1)]] = -1
            same = (old >= 0) & level.unmoved(self._level)[ordered.faces].all(axis=1) & (not self._refit)
            bound = self._bound.succeeded_by(level.faces, old, same, ordered.face_map, near)
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
        last = level.last[corners]
        error = np.where(last >= 0, forest.log.error[last], -1.0)
        largest = error.argmax(axis=1)[:, None]
        collapses = np.take_along_axis(last, largest, axis=1)[:, 0]
        if (collapses < 0).any():
            raise OptionError(
                f"{self._work.goal.limit}: single precision does not place the input itself so well "
                f"(frame {excess.frame})"
            )
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
    whole = replace(work, mesh=replace(work.mesh, source=SharedFrames(work.mesh.source)))
    # Faces on the backs of others are added at the end: they are as far away as those.
    repair = whole.mesh.repair
    work = replace(whole, mesh=replace(whole.mesh, repair=None))
    # All levels of one order: a vertex is placed alike wherever it is the same cluster.
    recorder = NodeRecorder(as_merged=True)
    furthest = max(work.goal.limit.relative(work.mesh.diagonal) / min(DISTANCE_PER_ERROR), NO_ERROR)
    work = replace(work, order_settings=replace(work.order_settings, error_limit=furthest))
    coarsest = work.order(delivery.progress, recorder)
    known = OrderedLevels(work.mesh.faces, coarsest, recorder)
    if repair is not None and work.goal.target_faces and repair.is_double.any():
        coarsest = known.at(known.steps_to(faces_for(coarsest, whole.mesh, work.goal.target_faces)))
        known = OrderedLevels(work.mesh.faces, coarsest, recorder)
    forest = CollapseForest(coarsest.log, coarsest.drops, len(coarsest.root))
    search = _Search(work, refit, known, forest)
    choice, result = search.run(delivery.sink is None, delivery.progress)
    if delivery.sink is not None:
        # Levels share arrays, which those tried after it have changed.
        result = search.place(choice, delivery, whole.mesh)
    elif repair is not None:
        face, row = np.unique(whole.mesh.face_index, return_index=True)
        faces, face_map = written_faces(whole.mesh, result.faces, row[np.searchsorted(face, result.face_map)])
        result = replace(result, faces=faces, face_map=face_map, **in_input_terms(whole.mesh, result.vertex_map))
    if not (choice.cut.kept.all() and choice.cut.dropped.all()):
        return replace(result, stopped="max_error")
    return reached(result, work.goal.target_faces)
