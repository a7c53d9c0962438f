"""Exchange of collapses: where the surface is furthest from the input, they are taken back for others that cost little.

Ordering prices a collapse by quadrics and by distances in few frames, before vertices are placed and fitted. A handful
of its collapses leave the surface much further from the input than all others do, in some frame. So edges are
collapsed a little further than asked for, and the surface is looked at as it comes out, in the key frames: the last
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
from warpqem.decimation.order_steps import OrderSteps
from warpqem.frames.device_frames import to_device
from warpqem.frames.stream import ArrayFrames, ArraySink
from warpqem.measure.far_points import FacesAround, furthest_from, unique_pairs
from warpqem.measure.unit_frames import UnitBlock, UnitFrames
from warpqem.mesh.mesh_input import AnimatedMesh
from warpqem.pipeline.cut_levels import Choice, CutLevel, LevelFrames, placer_of
from warpqem.pipeline.prepare import ORDER_END, Prepared, spare_count
from warpqem.pipeline.result import with_frames, without_frames

__all__ = ["exchanged", "order_with_spare", "spare_faces"]

# The furthest spots of a round are those beyond this part of the largest distance.
NEAR_LARGEST = 0.8
# Exchanging a part of the faces must lower the largest distance by so many times that part: over 11 cells the largest
# distance is 0.72 of that without an exchange, RMS 0.999. If it need not, they are 0.71 and 1.008.
WORTH = 4.0
# Four rounds more gain nothing.
ROUNDS = 8
FACES_PER_COLLAPSE = 2
# Frames that are looked at.
MAX_FRAMES = 16
# Distances below so many times the error of the last collapses are no spots. Above it the largest ones lie at three to
# ten times that.
SPOT = 1.5
# Nor are those below this part of the largest distance at vertices of the input before: hardly a mesh comes so far.
MIN_SHARE = 0.5
# Points of a face of the result: its middle and those of its edges.
SAMPLES = np.array([[1, 1, 1], [1.5, 1.5, 0], [0, 1.5, 1.5], [1.5, 0, 1.5]], dtype=np.float32) / 3
# Faces of the result whose points are looked at at once: some 50 MB of them.
FACES_AT_ONCE = 16384
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


def exchanged(
    work: Prepared, ordered: DecimatedMesh, target_faces: int, progress: Progress | None = None
) -> DecimatedMesh:
    """A level with so many faces, whose surface is less far from the input at most than that of the order's own.

    Args:
        work: the mesh; its surface is refitted at the end.
        ordered: what ordering left at :func:`spare_faces`.
        target_faces: faces asked for.
        progress: called now and then.

    Returns:
        ``ordered`` itself where nothing can be exchanged, or it has more faces.
    """
    if spare_faces(work, target_faces) == target_faces or len(ordered.faces) > target_faces:
        return ordered
    return _Search(work, ordered, target_faces).run(progress)


class _Search:
    """Cuts of one forest with about the same number of faces."""

    def __init__(self, work: Prepared, ordered: DecimatedMesh, target_faces: int) -> None:
        self._whole, self._target = work, target_faces
        log, drops = ordered.log, ordered.drops
        self._forest = CollapseForest(log, drops, len(ordered.root))
        self._states = ClusterStates(work.mesh.faces, ordered, self._forest)
        self._steps = OrderSteps(log, drops, len(work.mesh.faces))
        self._step = self._first_step = self._steps.to(target_faces)
        keys = work.key_frames
        keys = keys[np.unique(np.linspace(0, len(keys) - 1, min(MAX_FRAMES, len(keys))).astype(int))]
        mesh = _clip(work.mesh, keys)
        count = len(keys)
        self._work = replace(work, mesh=mesh, key_frames=np.arange(count), order_input=None)
        middle = np.broadcast_to(mesh.centre + mesh.origin, (count, 3))
        self._units = UnitFrames(middle, np.full(count, mesh.diagonal))
        every = slice(0, count)
        self._frames = LevelFrames(self._work, mesh.points(every), mesh.source.read(every), self._units)
        self._limit = SPOT * float(log.recent_error[-1])
        vertex_count, face_count = len(ordered.root), len(mesh.faces)
        # How far each input vertex is, and each face of a level, by the input face that it goes on from.
        self._far_vertex = np.zeros(vertex_count, dtype=np.float32)
        self._far_face = np.zeros(face_count, dtype=np.float32)
        self._corners = np.full((face_count, 3), -1, dtype=np.int32)
        self._around = FacesAround(mesh.faces, vertex_count)

    def run(self, progress: Progress | None) -> DecimatedMesh:
        """The best of the cuts."""
        left_out = np.empty(0, dtype=np.int64)
        level = self._first_level()
        largest = least = self._furthest(level, None)
        best = level.choice.cut
        for _ in range(ROUNDS):
            chosen = np.setdiff1d(self._collapses_at_spots(level, largest), left_out)
            if not len(chosen):
                break
            left_out = np.union1d(left_out, chosen)
            finer = self._finer(left_out)
            if finer is None:
                break
            before, level = level, finer
            moved = self._frames.place(level, before)
            largest = self._furthest(level, moved)
            share = FACES_PER_COLLAPSE * (self._step - self._first_step) / self._target
            weighed = largest * math.exp(WORTH * share)
            if weighed < least:
                best, least = level.choice.cut, weighed
            if progress:
                progress(ORDER_END, "order")
        return self._settled(best)

    def _first_level(self) -> CutLevel:
        """The order's own level, placed and refitted."""
        level = self._level(self._prefix())
        placer = self._work.placer(level.ordered, refit=True)
        settings = replace(self._work.place_settings, softening=placer.softening)
        self._work = replace(self._work, place_settings=settings)
        array = ArraySink()
        result = without_frames(self._work, placer, level.ordered)
        with_frames(result, self._work, placer, True, sink=array)
        self._frames.put(level, array.points)
        return level

    def _prefix(self) -> Cut:
        """The beginning of the order that is tried now."""
        collapse_count, drop_count = self._steps.counts(self._step)
        kept = np.arange(len(self._forest.log)) < collapse_count
        return Cut(kept, np.arange(len(self._forest.drops)) < drop_count)

    def _finer(self, left_out: np.ndarray) -> CutLevel | None:
        """The level of the shortest beginning of the order that has few enough faces without some collapses."""
        none = np.empty(0, dtype=np.int64)
        while True:
            cut = self._forest.without(self._prefix(), left_out, none)
            excess = len(self._whole.mesh.faces) - self._forest.faces_removed(cut) - self._target
            if excess <= 0:
                level = self._level(cut)
                # Where collapses around one were taken back, it may take other faces than it took.
                excess = len(level.ordered.faces) - self._target
                if excess <= 0:
                    return level
            if self._step == len(self._steps):
                return None
            self._step = min(self._step + max(1, excess // FACES_PER_COLLAPSE), len(self._steps))

    def _level(self, cut: Cut) -> CutLevel:
        """A level whose clusters are placed by their planes, but for those that ordering left."""
        ordered = self._states.at(cut)
        loose = np.ones(len(ordered.root), dtype=bool)
        return CutLevel(Choice(cut, loose), ordered, self._forest.last_collapses(cut))

    def _furthest(self, level: CutLevel, moved: np.ndarray | None) -> float:
        """The largest distance of a level, of which some vertices moved since the last one; None for all."""
        ordered = level.ordered
        face = ordered.face_map
        changed = (self._corners[face] != ordered.faces).any(axis=1)
        if moved is not None:
            is_moved = np.zeros(len(ordered.root), dtype=bool)
            is_moved[moved] = True
            changed |= is_moved[ordered.faces].any(axis=1)
        self._corners[face] = ordered.faces
        changed = np.flatnonzero(changed)
        near = np.zeros(len(ordered.root), dtype=bool)
        near[ordered.faces[changed]] = True
        here = level.is_kept[ordered.root] & self._work.mesh.used
        vertex = np.flatnonzero(near[ordered.root] & here)
        self._far_vertex[vertex] = self._vertex_distances(level, vertex)
        if moved is None:
            self._limit = max(self._limit, MIN_SHARE * float(self._far_vertex.max()))
        for start in range(0, len(changed), FACES_AT_ONCE):
            part = changed[start : start + FACES_AT_ONCE]
            self._far_face[face[part]] = self._face_distances(level, part)
        return max(float(self._far_vertex[here].max(initial=0.0)), float(self._far_face[face].max(initial=0.0)))

    def _vertex_distances(self, level: CutLevel, vertex: np.ndarray) -> np.ndarray:
        """How far input vertices (n,) are from the faces around those that they went to, two rings of them."""
        around = FacesAround(level.ordered.faces, len(level.ordered.root))
        root, frames, device = level.ordered.root[vertex], self._frames, self._work.device
        blocks = frames.reference, frames.test
        found = furthest_from(*blocks, around, vertex, root, (around.start, around.face), self._limit, device)
        far = np.flatnonzero(found > self._limit)
        if len(far):
            lists = around.second_ring(root[far])
            found[far] = furthest_from(*blocks, around, vertex[far], np.arange(len(far)), lists, self._limit, device)
        return found

    def _face_distances(self, level: CutLevel, row: np.ndarray) -> np.ndarray:
        """How far points of faces (n,) of a level are from the input faces of their vertices' clusters."""
        ordered = level.ordered
        faces = ordered.faces[row]
        held = self._held_faces(ordered, faces)
        corners = np.repeat(np.arange(len(row)), 3), faces.ravel()
        found = self._from_clusters(faces, held, corners)
        far = np.flatnonzero(found > self._limit)
        if len(far):
            around = FacesAround(ordered.faces, len(ordered.root))
            face, place = around.of(faces[far].ravel())
            pair = unique_pairs(np.repeat(place // 3, 3), ordered.faces[face].ravel())
            held = self._held_faces(ordered, pair[1])
            found[far] = self._from_clusters(faces[far], held, pair)
        return found

    def _held_faces(self, ordered: DecimatedMesh, vertex: np.ndarray) -> tuple[FacesAround, np.ndarray]:
        """The input faces at the members of some clusters: as lists over the kept vertices, and what they are."""
        wanted = np.zeros(len(ordered.root), dtype=bool)
        wanted[vertex] = True
        corners = ordered.root[self._work.mesh.faces]
        face = np.flatnonzero(wanted[corners].any(axis=1))
        return FacesAround(corners[face], len(ordered.root)), face

    def _from_clusters(
        self, faces: np.ndarray, held: tuple[FacesAround, np.ndarray], pair: tuple[np.ndarray, np.ndarray]
    ) -> np.ndarray:
        """How far the points of faces (n, 3) are from the input faces of clusters: pairs of a face and a vertex."""
        lists, own = held
        row, vertex = pair
        face, place = lists.of(vertex)
        counts = np.bincount(row[place], minlength=len(faces))
        start = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
        points = np.einsum("sk,fnkc->fnsc", SAMPLES, self._frames.points_at(faces))
        points = points.reshape(len(points), -1, 3)
        samples = UnitBlock(points, self._units, self._work.device)
        index = np.arange(points.shape[1])
        near = own[face].astype(np.int32)
        found = furthest_from(
            samples, self._frames.reference, self._around, index, index // len(SAMPLES), (start, near), self._limit,
            self._work.device,
        )  # fmt: skip
        return found.reshape(-1, len(SAMPLES)).max(axis=1)

    def _collapses_at_spots(self, level: CutLevel, largest: float) -> np.ndarray:
        """The last collapse of the largest error at each of the furthest spots."""
        ordered = level.ordered
        limit = max(NEAR_LARGEST * largest, self._limit)
        vertex = np.flatnonzero((self._far_vertex > limit) & level.is_kept[ordered.root] & self._work.mesh.used)
        face, _ = self._around.of(vertex)
        corners = np.concatenate(
            [ordered.root[self._work.mesh.faces[face]], ordered.faces[self._far_face[ordered.face_map] > limit]]
        )
        last = level.last[corners]
        error = np.append(self._forest.log.error, -1.0)[last]
        collapse = np.take_along_axis(last, error.argmax(axis=1)[:, None], axis=1)[:, 0]
        return np.unique(collapse[collapse >= 0])

    def _settled(self, cut: Cut) -> DecimatedMesh:
        """A level whose new clusters lie where their planes have them in the key frames, for what holds them."""
        level, mesh, device = self._level(cut), self._whole.mesh, self._whole.device
        vertex = self._states.made(level.kept)
        if len(vertex):
            clip = _clip(mesh, self._whole.key_frames)
            points = to_device(clip.points(slice(0, clip.frame_count)), device)
            for _ in range(PLACED_TIMES):
                placed = placer_of(self._whole, level, vertex).place(clip, points)
                self._states.move(vertex, placed.points.numpy(), level.ordered)
        return level.ordered


def _clip(mesh: AnimatedMesh, frames: np.ndarray) -> AnimatedMesh:
    """Some frames (n,) of a mesh as a mesh of its own."""
    points = np.concatenate([mesh.source.read(slice(frame, frame + 1)) for frame in frames.tolist()])
    return replace(mesh, source=ArrayFrames(points), held=None)
