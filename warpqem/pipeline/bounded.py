"""Simplify as far as a distance allows: about the fewest faces whose surface is proved to be within it, in every frame.

Edges are collapsed once. A level is a cut through the forest of these collapses
(:mod:`warpqem.decimation.forest_cut`): first those whose errors, means over frames, are well within the limit. It is
placed; where a vertex of the input is too far from the faces around the one that it went to, the last collapse of the
largest error there is left out, and the next cut is looked at where it differs. Cuts in which hardly a vertex is too
far are bounded (:class:`warpqem.measure.bound.DistanceBound`), which takes longer and proves it; where a face is not
proved to be within the limit, the same is done. So a spot holds back itself alone. A refit comes last, and leaves those
vertices as placed which it would take too far (:mod:`warpqem.pipeline.bounded_frames`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from warpqem.arguments.progress import Progress
from warpqem.decimation.collapse_nodes import NodeRecorder
from warpqem.decimation.forest_cut import CollapseForest
from warpqem.decimation.replay import OrderedLevels
from warpqem.errors import OptionError
from warpqem.frames.stream import ArraySink, FrameSink, NoFrames, SharedFrames
from warpqem.measure.bound import DistanceBound, Excess
from warpqem.measure.face_lists import FacesAround
from warpqem.measure.piece_proof import SINGLE_MARGIN
from warpqem.measure.surface_places import InputVertices, Side, furthest_of
from warpqem.mesh.mesh_input import AnimatedMesh
from warpqem.pipeline.bound_sink import LimitFrames
from warpqem.pipeline.bounded_frames import BoundedFrames, HeldVertices, SettledFrames
from warpqem.pipeline.cut_levels import Choice, CutLevel, LevelFrames
from warpqem.pipeline.memory_plan import KEPT_BYTES, stage_frames
from warpqem.pipeline.place_frames import Settling
from warpqem.pipeline.prepare import ORDER_END, Prepared
from warpqem.pipeline.result import (
    SimplifiedMesh,
    in_input_terms,
    reached,
    with_frames,
    without_frames,
    written_faces,
)

__all__ = ["simplify_within"]

# Errors of collapses are means over frames and faces; the largest distance is so many times as large or more. The first
# level is where the limit is this many times the error; where few faces are too far, the next is tried. The further the
# first level goes, the fewer faces the search ends with, as each spot goes back as far as it needs, and the longer that
# takes.
DISTANCE_PER_ERROR = (2.0, 1.5)
# So few, as a part of the faces looked at: of so many one, in so many frames, far apart in pose.
FEW = 0.005
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


class _Steps:
    """How far a search is: the number of its levels is unknown, so that each takes half of what is left."""

    def __init__(self, progress: Progress | None) -> None:
        self._progress, self._left = progress, 1.0 - ORDER_END

    def done(self) -> None:
        """One more is placed in all frames."""
        self._left /= 2
        if self._progress:
            self._progress(1.0 - self._left, "place")


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
        self._around = FacesAround(work.mesh.faces, len(work.mesh.used))
        self._bound: DistanceBound | None = None
        self._level: CutLevel | None = None

    def run(self, keep: bool, progress: Progress | None) -> tuple[Choice, SimplifiedMesh]:
        """The level that holds, and its result; with its points where they are to be kept."""
        mesh, steps = self._work.mesh, _Steps(progress)
        loose = np.zeros(len(mesh.used), dtype=bool)
        starts = [max(self._limit / part, NO_ERROR) for part in DISTANCE_PER_ERROR]
        choices = [Choice(self._forest.within(error), loose) for error in starts]
        if self._refit:
            self._work = self._softened(choices[0])
        choice = self._first_choice(choices)
        whole = 12 * mesh.frame_count * mesh.vertex_count <= KEPT_BYTES
        block = self._block(slice(0, mesh.frame_count)) if whole else self._some_frames(stage_frames(mesh.vertex_count))
        choice = self._nearer(choice, block)
        while True:
            choice = self._within(choice, block, 0 if whole else int(VERY_FEW * len(mesh.faces)))
            assert self._level is not None
            assert self._bound is not None
            proved = block.points(self._level) if whole else None
            if not whole:
                self._bound.look_again()
            if not (whole and self._refit):
                choice, result = self._placed(choice, keep, proved, steps)
            if not self._refit:
                return choice, result
            level, array = self._level_of(choice), ArraySink()
            sink = array if keep else NoFrames()
            near = self._near_faces(level)
            settled = SettledFrames(sink, self._frames, self._bound_of(level), level, self._work.device, near)
            result = self._finish(level, settled, settling=settled)
            steps.done()
            if not settled.excess:
                choice = replace(choice, held=settled.choice_held())
                return choice, replace(result, points=array.points) if keep else result
            for excess in settled.excess:
                choice = self._finer(level, choice, excess, 1)

    def _placed(
        self, choice: Choice, keep: bool, proved: np.ndarray | None, steps: _Steps
    ) -> tuple[Choice, SimplifiedMesh]:
        """The level that holds in all frames as it is placed, and its result; some may be ``proved`` already."""
        keep = keep and not self._refit
        while True:
            level, array = self._level_of(choice), ArraySink()
            bound = self._bound_of(level)
            sink = BoundedFrames(array if keep else NoFrames(), self._frames, bound, level, self._work.device, proved)
            result = self._finish(level, sink, refit=False)
            steps.done()
            if not sink.excess and not sink.differs:
                return choice, replace(result, points=array.points) if keep else result
            if sink.differs:
                proved = None
                bound.look_again()
                continue
            for excess in sink.excess:
                choice = self._finer(level, choice, excess, 1)

    def place(self, choice: Choice, sink: FrameSink, mesh: AnimatedMesh, progress: Progress | None) -> SimplifiedMesh:
        """The result of a level, in the terms of the mesh as it is given."""
        level = self._level_of(choice)
        return self._finish(level, sink, mesh, progress, settling=HeldVertices(level))

    def _finish(
        self,
        level: CutLevel,
        sink: FrameSink,
        mesh: AnimatedMesh | None = None,
        progress: Progress | None = None,
        *,
        refit: bool = True,
        settling: Settling | None = None,
    ) -> SimplifiedMesh:
        work = self._work_of(level)
        work = work if mesh is None else replace(work, mesh=mesh)
        refit = refit and self._refit
        placer = work.placer(level.ordered)
        result = without_frames(work, placer, level.ordered)
        return with_frames(result, work, placer, refit, sink=sink, progress=progress, settling=settling)

    def _softened(self, choice: Choice) -> Prepared:
        """The mesh with clusters that are as soft in all levels as a refit has those of a first one.

        What a refit leaves as placed is then what was proved, and levels share their clusters.
        """
        placer = self._work.placer(self._level_of(choice).ordered, refit=True)
        return replace(self._work, place_settings=replace(self._work.place_settings, softening=placer.softening))

    def _work_of(self, level: CutLevel) -> Prepared:
        settings = replace(self._work.place_settings, loose=level.choice.loose)
        return replace(self._work, place_settings=settings)

    def _some_frames(self, count: int) -> LevelFrames:
        """Some frames, far apart in pose."""
        mesh, keys = self._work.mesh, self._work.key_frames
        chosen = keys if count <= len(keys) else np.arange(mesh.frame_count)
        chosen = chosen[np.unique(np.linspace(0, len(chosen) - 1, count).astype(int))]
        own = np.concatenate([mesh.source.read(slice(frame, frame + 1)) for frame in chosen.tolist()])
        return LevelFrames(self._work, self._around, mesh.chosen_points(chosen), own, self._frames.units(own, chosen))

    def _block(self, frames: slice) -> LevelFrames:
        own = self._work.mesh.source.read(frames)
        units = self._frames.units(own, np.arange(frames.start, frames.stop))
        return LevelFrames(self._work, self._around, self._work.mesh.points(frames), own, units)

    def _first_choice(self, choices: Sequence[Choice]) -> Choice:
        """The first one in which more than few vertices are too far in some frames, or the last one."""
        block = self._some_frames(min(SAMPLED_FRAMES, self._work.mesh.frame_count))
        before: CutLevel | None = None
        for choice in choices[:-1]:
            level = self._level_of(choice)
            far, looked_at = self._far_vertices(level, before, block)
            if len(far) > FEW * looked_at:
                return choice
            before = level
        return choices[-1]

    def _nearer(self, choice: Choice, block: LevelFrames) -> Choice:
        """A choice in which hardly a vertex of the input is too far, in some frames."""
        before: CutLevel | None = None
        while True:
            level = self._level_of(choice)
            far, _ = self._far_vertices(level, before, block)
            if not len(far):
                return choice
            choice = self._finer_at(level, choice, far)
            before = level

    def _far_vertices(self, level: CutLevel, before: CutLevel | None, block: LevelFrames) -> tuple[np.ndarray, int]:
        """Place a level where it is not as the one before, and look at the vertices of the input there.

        Returns:
            Those that are too far from the faces around the vertex that they went to, and how many were looked at.
        """
        root = level.ordered.root
        moved = np.zeros(len(root), dtype=bool)
        moved[block.place(level, before)] = True
        faces = level.ordered.faces
        around = np.zeros(len(root), dtype=bool)
        around[faces[moved[faces].any(axis=1)]] = True
        # A vertex on its own stays where it is.
        vertex = np.flatnonzero(around[root] & (level.last[root] >= 0))
        near = FacesAround(faces, len(root))
        side = Side(block.test.lanes, near, near)
        limit = self._limit + SINGLE_MARGIN
        places = InputVertices(block.reference.lanes, side, vertex, root[vertex])
        (found,) = furthest_of([places], [np.full(len(vertex), limit)], self._work.device)
        return vertex[found > limit], len(vertex)

    def _within(self, choice: Choice, block: LevelFrames, enough: int) -> Choice:
        """The level that holds in some frames, before it is refitted, but for so many faces."""
        small = 0
        # Levels before may have been placed in other frames.
        before: CutLevel | None = None
        if self._bound is not None:
            self._bound.look_again()
        while True:
            level = self._level_of(choice)
            bound = self._bound_of(level)
            block.place(level, before)
            excess = bound.excess_of_blocks(0, block.reference, block.test)
            if excess is None:
                return choice
            if excess.face_count <= VERY_FEW * len(self._work.mesh.faces):
                small = min(small + 1, MAX_GENERATIONS)
            choice = self._finer(level, choice, excess, small)
            if excess.face_count <= enough:
                return choice
            before = level

    def _level_of(self, choice: Choice) -> CutLevel:
        if self._level is not None and choice is self._level.choice:
            return self._level
        return CutLevel(choice, self._known.at_cut(choice.cut), self._forest.last_collapses(choice.cut))

    def _bound_of(self, level: CutLevel) -> DistanceBound:
        """What bounds a level, with what is known from the one before."""
        work, ordered = self._work, level.ordered
        if self._bound is not None and self._level is level:
            return self._bound
        near = self._near_faces(level)
        if self._bound is None or self._level is None:
            bound = DistanceBound(work.mesh.faces, ordered.faces, self._limit, work.device, near, ordered.face_map)
        else:
            before = self._level.ordered
            index = np.full(len(work.mesh.faces), -1, dtype=np.int64)
            index[before.face_map] = np.arange(len(before.faces))
            old = index[ordered.face_map]
            there = np.flatnonzero(old >= 0)
            old[there[(before.faces[old[there]] != ordered.faces[there]).any(axis=1)]] = -1
            same = (old >= 0) & level.unmoved(self._level)[ordered.faces].all(axis=1)
            bound = self._bound.succeeded_by(ordered.faces, old, same, ordered.face_map, near)
        self._bound, self._level = bound, level
        return bound

    def _near_faces(self, level: CutLevel) -> np.ndarray:
        """A face (N,) of a level near each face of the input."""
        faces, ordered = self._work.mesh.faces, level.ordered
        # At each vertex of the level one of its faces.
        near = np.full(len(self._work.mesh.used), -1, dtype=np.int32)
        near[ordered.faces.ravel()] = np.repeat(np.arange(len(ordered.faces), dtype=np.int32), 3)
        near = near[ordered.root[faces[:, 0]]]
        near[ordered.face_map] = np.arange(len(ordered.faces))
        return near

    def _finer_at(self, level: CutLevel, choice: Choice, vertices: np.ndarray) -> Choice:
        """A choice that is to come nearer around vertices of the input that have gone to others, by a collapse each."""
        root = level.ordered.root
        face, row = self._around.of(vertices)
        corners = root[self._work.mesh.faces[face]]
        # Of the faces at each vertex that with the largest error.
        error = np.append(self._forest.log.error, -1.0)[level.last[corners]].max(axis=1)
        order = np.lexsort((error, row))
        chosen = order[np.append(row[order][1:] != row[order][:-1], True)]
        finer = self._without(level, choice, corners[chosen], np.empty(0, dtype=np.int64), 1)
        assert finer is not None, "a vertex that has gone to another one went by a collapse"
        return finer

    def _finer(self, level: CutLevel, choice: Choice, excess: Excess, generations: int) -> Choice:
        """A choice that is to come nearer around what is too far, by so many generations of collapses.

        Raises:
            OptionError: there is none.
        """
        ordered = level.ordered
        faces = self._work.mesh.faces[excess.reference_faces]
        vertex_drop = ordered.drops.vertex_drop[faces[:, 0]]
        lost, faces = vertex_drop[vertex_drop >= 0], faces[vertex_drop < 0]
        corners = np.concatenate([ordered.root[faces], ordered.faces[excess.test_faces]])
        dropped = np.flatnonzero(level.choice.cut.dropped)[np.unique(lost)]
        finer = self._without(level, choice, corners, dropped, generations)
        if finer is None:
            raise OptionError(
                f"{self._work.goal.limit}: single precision does not place the input itself so well "
                f"(frame {excess.frame})"
            )
        return finer

    def _without(
        self, level: CutLevel, choice: Choice, corners: np.ndarray, dropped: np.ndarray, generations: int
    ) -> Choice | None:
        """A choice without the last collapse of the largest error at each of some faces, and some prunings.

        Args:
            level: a level.
            choice: what decides it, or the next one.
            corners: (n, 3) int, vertices of the level, of which one is to go back.
            dropped: prunings (indices) to leave out.
            generations: so many generations of collapses are left out.

        Returns:
            None where there is no such collapse.
        """
        forest = self._forest
        last = level.last[corners]
        # The number at the end is of vertices without a collapse; there may be no collapse at all.
        error = np.append(forest.log.error, -1.0)[last]
        largest = error.argmax(axis=1)[:, None]
        collapses = np.take_along_axis(last, largest, axis=1)[:, 0]
        if (collapses < 0).any():
            return None
        # Clusters of several vertices follow the material.
        merged = (last >= 0) & ~choice.loose[corners]
        small = np.take_along_axis(error, largest, axis=1)[:, 0] <= max(self._limit / LOOSE_BELOW, NO_ERROR)
        loosen = merged.any(axis=1) & small
        loose = choice.loose.copy()
        loose[corners[loosen]] = True
        left_out = forest.with_parts(np.unique(collapses[~loosen]), generations - 1)
        return Choice(forest.without(choice.cut, left_out, dropped), loose)


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
