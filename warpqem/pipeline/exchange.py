"""Exchange of collapses: where the surface is furthest from the input, they are taken back for others that cost little.

Ordering prices a collapse by quadrics and by distances in few frames, before vertices are placed and fitted. A handful
of its collapses leave the surface much further from the input than all others do, in some frame. So edges are
collapsed a little further than asked for, and the surface is looked at as it comes out, in many frames: the last
collapse of the largest error at each of the furthest spots is taken back, and for its faces the next ones of the order
are made. What that leaves is a cut through the forest of collapses (:mod:`warpqem.decimation.forest_cut`) with as many
faces; of all that were tried, the one with the least largest distance is kept.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from warpqem.arguments.progress import Progress
from warpqem.decimation.cluster_states import ClusterStates
from warpqem.decimation.collapse_nodes import NodeRecorder
from warpqem.decimation.decimate import DecimatedMesh
from warpqem.decimation.forest_cut import CollapseForest, Cut
from warpqem.decimation.level_roots import RootCounts
from warpqem.decimation.order_steps import OrderSteps
from warpqem.frames.device_frames import DeviceSink, to_device
from warpqem.frames.stream import ArrayFrames, ArraySink, counted_frames
from warpqem.kernels.components import MAX_REMNANT_FACES
from warpqem.measure.face_lists import FacesAround
from warpqem.measure.unit_frames import UnitFrames
from warpqem.mesh.mesh_input import AnimatedMesh
from warpqem.pipeline.cut_levels import Choice, CutLevel, LevelFrames, placer_of
from warpqem.pipeline.key_frames import looked_frames
from warpqem.pipeline.level_distances import LevelDistances
from warpqem.pipeline.prepare import ORDER_END, Prepared, spare_count
from warpqem.pipeline.result import with_frames, without_frames
from warpqem.place.cluster_parts import LevelParts
from warpqem.runtime.device import device_traits

__all__ = ["exchanged", "faces_ahead", "order_with_spare", "spare_faces"]

# The furthest spots of a round are those beyond this part of the largest distance.
NEAR_LARGEST = 0.8
# Exchanging a part of the faces must lower the largest distance by so many times that part: over 11 cells the largest
# distance is 0.72 of that without an exchange, RMS 0.999. If it need not, they are 0.71 and 1.008.
WORTH = 4.0
# Four rounds more gain nothing.
ROUNDS = 8
FACES_PER_COLLAPSE = 2
# Distances below so many times the error of the last collapses are no spots. Above it the largest ones lie at three to
# ten times that.
SPOT = 1.5
# New clusters are placed so often: where they lie decides which input vertices hold them, and how they then lie.
PLACED_TIMES = 2


def spare_faces(work: Prepared, target_faces: int) -> int:
    """The faces to collapse edges down to before some are exchanged; as many as asked for where none can be.

    That is so where faces stand for two, as counts hang on which of them are left.
    """
    repair = work.mesh.repair
    if repair is not None and repair.is_double.any():
        return target_faces
    return target_faces - spare_count(target_faces, len(work.mesh.faces))


def order_with_spare(
    work: Prepared, progress: Progress | None = None, recorder: NodeRecorder | None = None
) -> DecimatedMesh:
    """Collapse edges down to the goal and as far beyond it as exchanging takes."""
    target = work.goal.target_faces
    spare = spare_faces(work, target)
    return work.order(progress, recorder) if spare == target else work.order_to(spare, progress, recorder)


def faces_ahead(work: Prepared) -> FacesAround | None:
    """The faces that exchanging looks for on the host, or None where nothing is exchanged.

    A device with memory of its own orders meanwhile, and would wait for them afterwards.
    """
    target = work.goal.target_faces
    if spare_faces(work, target) == target or not device_traits(work.device).own_memory:
        return None
    around = FacesAround(work.mesh.faces, work.mesh.vertex_count)
    around.make_ahead()
    return around


def exchanged(
    work: Prepared,
    ordered: DecimatedMesh,
    target_faces: int,
    progress: Progress | None = None,
    around: FacesAround | None = None,
) -> DecimatedMesh:
    """A level with so many faces, whose surface is less far from the input at most than that of the order's own.

    Args:
        work: the mesh; its surface is refitted at the end.
        ordered: what ordering left at :func:`spare_faces`.
        target_faces: faces asked for.
        progress: called now and then.
        around: what :func:`faces_ahead` gave; None to make it here.

    Returns:
        ``ordered`` itself where nothing can be exchanged, or it has more faces.
    """
    if spare_faces(work, target_faces) == target_faces or len(ordered.faces) > target_faces:
        return ordered
    return _Search(work, ordered, target_faces, around).run(progress)


class _Search:
    """Cuts of one forest with about the same number of faces."""

    def __init__(
        self, work: Prepared, ordered: DecimatedMesh, target_faces: int, around: FacesAround | None = None
    ) -> None:
        self._whole, self._target = work, target_faces
        log, drops = ordered.log, ordered.drops
        self._around = around = FacesAround(work.mesh.faces, len(ordered.root)) if around is None else around
        self._loose = np.ones(len(ordered.root), dtype=bool)
        self._forest = CollapseForest(log, drops, len(ordered.root))
        own_memory = device_traits(work.device).own_memory
        by_device = own_memory and work.quadric_sums is None
        counts = RootCounts(ordered.root, lambda: around.start) if by_device else None
        self._states = ClusterStates(work.mesh.faces, ordered, self._forest, around.repeated, counts)
        self._steps = OrderSteps(log, drops, len(work.mesh.faces))
        self._step = self._first_step = self._steps.to(target_faces)
        self._first_cut = self._filled(self._prefix())
        if own_memory:
            self._forest.prepare_ahead()
            self._states.find_ahead(self._first_cut)
        self._parts = parts = None if counts is None else _parts_there(work, ordered, around, counts)
        looked, keys = looked_frames(work.key_frames, np.flatnonzero(counted_frames(work.mesh.source)))
        mesh = _clip(work.mesh, looked)
        count = len(looked)
        self._work = replace(work, mesh=mesh, key_frames=np.searchsorted(looked, keys), order_input=None)
        units = UnitFrames(np.broadcast_to(mesh.centre + mesh.origin, (count, 3)), np.full(count, mesh.diagonal))
        every = slice(0, count)
        points = mesh.source.read(every)
        self._frames = LevelFrames(self._work, around, mesh.points(every), points, units, parts)
        # The last place is of vertices without a collapse.
        self._error = np.append(log.error, np.float32(-1.0))
        # Where pruning alone led here there are no collapses.
        limit = SPOT * float(log.recent_errors_at(np.array([len(log) - 1]))[0]) if len(log) else 0.0
        self._distances = LevelDistances(self._work, self._frames, around, limit)

    def run(self, progress: Progress | None) -> DecimatedMesh:
        """The best of the cuts."""
        # Of these no level has any.
        left_out = np.zeros(len(self._forest.log), dtype=bool)
        level = self._first_level()
        largest = least = self._distances.renew(level, None)
        best = level
        for _ in range(ROUNDS):
            chosen = self._collapses_at_spots(level, largest)
            if not len(chosen):
                break
            self._forest.leave_out(left_out, chosen)
            finer = self._finer(left_out)
            if finer is None:
                break
            before, level = level, finer
            moved = self._frames.place(level, before)
            largest = self._distances.renew(level, moved)
            share = FACES_PER_COLLAPSE * (self._step - self._first_step) / self._target
            weighed = largest * math.exp(WORTH * share)
            if weighed < least:
                best, least = level, weighed
            if progress:
                progress(ORDER_END, "order")
        return self._settled(best)

    def _first_level(self) -> CutLevel:
        """The order's own level, placed and refitted roughly."""
        level = self._level(self._first_cut)
        placer = self._work.placer(level.ordered, refit=True)
        device = self._work.device
        array = DeviceSink(device) if device_traits(device).own_memory else ArraySink()
        result = without_frames(self._work, placer, level.ordered)
        with_frames(result, self._work, placer, True, sink=array, roughly=True)
        self._frames.put(level, array.points)
        return level

    def _prefix(self) -> Cut:
        """The beginning of the order that is tried now."""
        collapse_count, drop_count = self._steps.counts(self._step)
        kept = np.zeros(len(self._forest.log), dtype=bool)
        kept[:collapse_count] = True
        return Cut(kept, np.arange(len(self._forest.drops)) < drop_count)

    def _filled(self, cut: Cut) -> Cut:
        """A cut without its last collapses, where a part that was pruned took more faces than those left to spare."""
        forest, none = self._forest, np.empty(0, dtype=np.int64)
        wanted = len(self._whole.mesh.faces) - self._target
        missing = forest.faces_removed(cut) - wanted
        if missing <= int(MAX_REMNANT_FACES):
            return cut
        # A part whose collapses were taken back would be there again. The last place is of vertices that stay.
        owner = forest.drops.vertex_drop[forest.log.kept]
        kept = np.flatnonzero(cut.kept & ~np.append(cut.dropped, False)[owner])
        count = missing // FACES_PER_COLLAPSE
        while count > 0:
            filled = forest.without(cut, kept[-count:], none)
            if forest.faces_removed(filled) >= wanted:
                return filled
            # What needs them is taken back with them.
            count //= 2
        return cut

    def _finer(self, left_out: np.ndarray) -> CutLevel | None:
        """The level of the shortest beginning of the order that has few enough faces without collapses (C,) bool."""
        while True:
            cut = self._forest.without_all(self._prefix(), left_out)
            excess = len(self._whole.mesh.faces) - self._forest.faces_removed(cut) - self._target
            if excess <= 0:
                level = self._level(self._filled(cut))
                # Where collapses around one were taken back, it may take other faces than it took.
                excess = len(level.ordered.faces) - self._target
                if excess <= 0:
                    return level
            if self._step == len(self._steps):
                return None
            self._step = min(self._step + max(1, excess // FACES_PER_COLLAPSE), len(self._steps))

    def _level(self, cut: Cut, known: CutLevel | None = None) -> CutLevel:
        """A level whose clusters are placed by their planes, but for those that ordering left.

        ``known`` is one of the same cut, where it is the last.
        """
        found = self._states.at(cut, None if known is None else known.found)
        return CutLevel(Choice(cut, self._loose), found.ordered, found.last, found)

    def _collapses_at_spots(self, level: CutLevel, largest: float) -> np.ndarray:
        """The last collapse of the largest error at each of the furthest spots."""
        limit = max(NEAR_LARGEST * largest, self._distances.limit)
        last = level.last[self._distances.clusters_at(level, limit)]
        error = self._error[last]
        collapse = np.take_along_axis(last, error.argmax(axis=1)[:, None], axis=1)[:, 0]
        return np.unique(collapse[collapse >= 0])

    def _settled(self, best: CutLevel) -> DecimatedMesh:
        """A level, with its new clusters where their planes have them in the key frames, for what holds them."""
        level, mesh, device = self._level(best.choice.cut, best), self._whole.mesh, self._whole.device
        vertex = self._states.made(level.kept)
        if len(vertex):
            clip = _clip(mesh, self._whole.key_frames)
            points = to_device(clip.points(slice(0, clip.frame_count)), device)
            for _ in range(PLACED_TIMES):
                placed = placer_of(self._whole, self._around, level, vertex, self._parts).place(clip, points)
                self._states.move(vertex, placed.points, level.ordered)
        return level.ordered


def _parts_there(work: Prepared, ordered: DecimatedMesh, around: FacesAround, counts: RootCounts) -> LevelParts:
    """What finds the parts of clusters on the device."""
    corner_vertex = around.corners(work.device)
    return LevelParts(work.mesh.faces, corner_vertex, ordered, work.quadric_scale, counts.of, work.device)


def _clip(mesh: AnimatedMesh, frames: np.ndarray) -> AnimatedMesh:
    """Some frames (n,) of a mesh as a mesh of its own."""
    points = np.concatenate([mesh.source.read(slice(frame, frame + 1)) for frame in frames.tolist()])
    return replace(mesh, source=ArrayFrames(points), held=None)
