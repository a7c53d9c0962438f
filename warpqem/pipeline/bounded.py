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

from warpqem.decimation.collapse_nodes import NodeRecorder
from warpqem.decimation.decimate import DecimatedMesh
from warpqem.decimation.forest_cut import CollapseForest, Cut
from warpqem.decimation.replay import OrderedLevels
from warpqem.errors import OptionError
from warpqem.frames.stream import ArraySink, FrameSink, NoFrames, SharedFrames
from warpqem.measure.bound import DistanceBound, Excess
from warpqem.measure.unit_frames import UnitBlock, UnitFrames
from warpqem.mesh.mesh_input import AnimatedMesh
from warpqem.pipeline.bound_sink import LimitFrames
from warpqem.pipeline.memory_plan import KEPT_BYTES, stage_frames
from warpqem.pipeline.prepare import ORDER_END, Prepared, Progress
from warpqem.pipeline.result import SimplifiedMesh, finish, in_input_terms, reached, written_faces
from warpqem.place.clusters import ClusterPlacer
from warpqem.repair.mended_mesh import faces_for
from warpqem.runtime.device import device_turn

__all__ = ["simplify_within"]

# Errors of collapses are means over frames and faces; the largest distance is so many times as large or more. The first
# level is where the limit is this many times the error; where few faces are too far, the next is tried. The further the
# first level goes, the fewer faces the search ends with, as each spot goes back as far as it needs, and the longer that
# takes.
DISTANCE_PER_ERROR = (3.0, 2.0, 1.5)
# So few, as a part of the faces looked at: of so many one, in so many frames, far apart in pose.
FEW = 0.005
SAMPLED_FACES = 8
SAMPLED_FRAMES = 8
# Errors below may be those of single precision, which on flat parts are all there is: they hold nothing back.
NO_ERROR = 1.0e-4
# Where the largest error of a collapse around is less than so many times below the limit, it is not the shape of fewer
# faces that is too far, but vertices that follow the material: these are placed loosely.
LOOSE_BELOW = 8.0
# Where so small a part of the faces is too far, that is left to the stage with more frames, and in the last one spots
# go back by so many collapses at once, as each step costs as much as ten of these.
VERY_FEW = 0.002
MAX_GENERATIONS = 2


@dataclass(frozen=True)
class _Choice:
    """What decides a level.

    Attributes:
        cut: its collapses.
        loose: (V,) bool, input vertices whose clusters are placed by their quadrics, with the least weight of the
            anchor.
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

    def __len__(self) -> int:
        return len(self._points)

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
        self, sink: FrameSink, frames: LimitFrames, bound: DistanceBound, device: str, proved: np.ndarray | None
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
        known: all levels of its decimation.
        forest: the collapses.
    """

    def __init__(self, work: Prepared, refit: bool, known: OrderedLevels, forest: CollapseForest) -> None:
        self._work, self._refit, self._known, self._forest = work, refit, known, forest
        limit = work.goal.limit
        self._limit = limit.relative(work.mesh.diagonal)
        self._frames = LimitFrames(work.mesh, limit, work.mesh.diagonal, work.device)
        self._bound: DistanceBound | None = None
        self._level: _Level | None = None

    def run(self, keep: bool, progress: Progress | None) -> tuple[_Choice, SimplifiedMesh]:
        """The level that holds, and its result; with its points where they are to be kept."""
        left, mesh = 1.0 - ORDER_END, self._work.mesh
        loose = np.zeros(len(mesh.used), dtype=bool)
        starts = [max(self._limit / part, NO_ERROR) for part in DISTANCE_PER_ERROR]
        choice = self._first_choice([_Choice(self._forest.within(error), loose) for error in starts])
        whole = not self._refit and 12 * mesh.frame_count * mesh.vertex_count <= KEPT_BYTES
        count = stage_frames(mesh.vertex_count)
        if not whole or 2 * count < mesh.frame_count:
            choice = self._within(choice, self._some_frames(count), int(VERY_FEW * len(mesh.faces)))
        proved: np.ndarray | None = None
        if whole:
            block = self._block(slice(0, mesh.frame_count))
            choice = self._within(choice, block, 0)
            assert self._level is not None
            proved = block.points(self._level)
        elif self._bound is not None:
            self._bound.look_again()
        while True:
            level = self._level_of(choice)
            array = ArraySink()
            bound = self._bound_of(level)
            sink = _BoundFrames(array if keep else NoFrames(), self._frames, bound, self._work.device, proved)
            result = self._finish(level, sink)
            if progress:
                # The number of levels is unknown: each takes half of what is left.
                left /= 2
                progress(1.0 - left, "place")
            if not sink.excess and not sink.differs:
                return choice, replace(result, points=array.points) if keep else result
            if sink.differs:
                proved = None
                self._bound_of(level).look_again()
                continue
            for excess in sink.excess:
                choice = self._finer(level, choice, excess, 1)

    def place(self, choice: _Choice, sink: FrameSink, mesh: AnimatedMesh, progress: Progress | None) -> SimplifiedMesh:
        """The result of a level, in the terms of the mesh as it is given."""
        return self._finish(self._level_of(choice), sink, mesh, progress)

    def _finish(
        self, level: _Level, sink: FrameSink, mesh: AnimatedMesh | None = None, progress: Progress | None = None
    ) -> SimplifiedMesh:
        work = self._work_of(level)
        work = work if mesh is None else replace(work, mesh=mesh)
        return finish(work, level.ordered, self._refit, sink=sink, progress=progress)

    def _work_of(self, level: _Level) -> Prepared:
        settings = replace(self._work.place_settings, loose=level.choice.loose)
        return replace(self._work, place_settings=settings)

    def _some_frames(self, count: int) -> _Block:
        """Some frames, far apart in pose."""
        mesh, keys = self._work.mesh, self._work.key_frames
        chosen = keys if count <= len(keys) else np.arange(mesh.frame_count)
        chosen = chosen[np.unique(np.linspace(0, len(chosen) - 1, count).astype(int))]
        own = np.concatenate([mesh.source.read(slice(frame, frame + 1)) for frame in chosen.tolist()])
        return _Block(self._work, mesh.chosen_points(chosen), own, self._frames.units(own, chosen))

    def _block(self, frames: slice) -> _Block:
        own = self._work.mesh.source.read(frames)
        units = self._frames.units(own, np.arange(frames.start, frames.stop))
        return _Block(self._work, self._work.mesh.points(frames), own, units)

    def _first_choice(self, choices: Sequence[_Choice]) -> _Choice:
        """The first one in which more than few faces are too far, or the last one, as some of the faces show."""
        block = self._some_frames(min(SAMPLED_FRAMES, self._work.mesh.frame_count))
        before: _Level | None = None
        for choice in choices[:-1]:
            level = self._level_of(choice)
            bound = self._bound_of(level)
            self._place(level, before, block)
            looked_at = bound.look_at_some(SAMPLED_FACES)
            excess = bound.excess_of_blocks(0, block.reference, block.test(level))
            if excess is not None and excess.face_count > FEW * looked_at:
                return choice
            before = level
        return choices[-1]

    def _within(self, choice: _Choice, block: _Block, enough: int) -> _Choice:
        """The level that holds in some frames, before it is refitted, but for so many faces."""
        small = 0
        # Levels before may have been placed in other frames.
        before: _Level | None = None
        if self._bound is not None:
            self._bound.look_again()
        while True:
            level = self._level_of(choice)
            bound = self._bound_of(level)
            self._place(level, before, block)
            excess = bound.excess_of_blocks(0, block.reference, block.test(level))
            if excess is None:
                return choice
            if excess.face_count <= VERY_FEW * len(self._work.mesh.faces):
                small = min(small + 1, MAX_GENERATIONS)
            choice = self._finer(level, choice, excess, small)
            if excess.face_count <= enough:
                return choice
            before = level

    def _place(self, level: _Level, before: _Level | None, block: _Block) -> None:
        """Place a level in some frames, in which another one was placed before."""
        moved = level.kept if before is None else level.kept[~level.unmoved(before)[level.kept]]
        if len(moved):
            block.place(self._placer_of(level, moved), moved)

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

    def _finer(self, level: _Level, choice: _Choice, excess: Excess, generations: int) -> _Choice:
        """A choice that is to come nearer around what is too far, by so many generations of collapses.

        Raises:
            OptionError: there is none.
        """
        ordered, forest = level.ordered, self._forest
        faces = self._work.mesh.faces[excess.reference_faces]
        vertex_drop = ordered.drops.vertex_drop[faces[:, 0]]
        lost, faces = vertex_drop[vertex_drop >= 0], faces[vertex_drop < 0]
        corners = np.concatenate([ordered.root[faces], ordered.faces[excess.test_faces]])
        last = level.last[corners]
        # The number at the end is of vertices without a collapse; there may be no collapse at all.
        error = np.append(forest.log.error, -1.0)[last]
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
        left_out = forest.with_parts(np.unique(collapses[~loosen]), generations - 1)
        return _Choice(forest.without(choice.cut, left_out, dropped), loose)


def simplify_within(
    work: Prepared, refit: bool, *, sink: FrameSink | None = None, progress: Progress | None = None
) -> SimplifiedMesh:
    """Simplify a mesh to about the fewest faces, at least those of its goal, whose surface holds the goal's distance.

    Raises:
        OptionError: the limit is below what single precision places, and nothing can be removed within it.
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
    # A count is one of both sides.
    coarsest = replace(work, mesh=whole.mesh).order(progress, recorder)
    known = OrderedLevels(work.mesh.faces, coarsest, recorder)
    if repair is not None and work.goal.target_faces and repair.is_double.any():
        coarsest = known.at(known.steps_to(faces_for(coarsest, whole.mesh, work.goal.target_faces)))
        known = OrderedLevels(work.mesh.faces, coarsest, recorder)
    forest = CollapseForest(coarsest.log, coarsest.drops, len(coarsest.root))
    search = _Search(work, refit, known, forest)
    choice, result = search.run(sink is None, progress)
    if sink is not None:
        # Levels share arrays, which those tried after it have changed.
        result = search.place(choice, sink, whole.mesh, progress)
    elif repair is not None:
        face, row = np.unique(whole.mesh.face_index, return_index=True)
        faces, face_map = written_faces(whole.mesh, result.faces, row[np.searchsorted(face, result.face_map)])
        result = replace(result, faces=faces, face_map=face_map, **in_input_terms(whole.mesh, result.vertex_map))
    if not (choice.cut.kept.all() and choice.cut.dropped.all()):
        result = replace(result, stopped="max_error")
    if result.stopped == "max_error" and not (choice.cut.kept.any() or choice.cut.dropped.any()):
        work.goal.limit.check_provable()
    return reached(result, work.goal.target_faces)
