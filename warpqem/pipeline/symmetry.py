"""Simplify a mirror-symmetric mesh to one that is mirror-symmetric too.

One half is simplified, cut along the mirror plane: on its own poses and on the reflected poses of the other half, so
that both count alike although the motion need not be symmetric. Its mirror image is the other half. In every pose a
vertex of either half is where its own poses put it; one on the plane is half way between the two. No collapse makes an
inner edge between two vertices of the plane, which both halves would have, and nothing else can tie them in a knot.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from warpqem.arguments.array_input import is_empty
from warpqem.arguments.array_types import ArrayInput, Points
from warpqem.arguments.progress import CancelToken, Progress, ProgressInput, listener, with_progress_bar
from warpqem.costs.attributes import checked_fields
from warpqem.costs.models import cost_model
from warpqem.costs.weights import border_vertices, lock_mask, read_quadric_scale, read_weights
from warpqem.decimation.collapse_log import CollapseRecord
from warpqem.errors import OptionError, UnreachableTargetError
from warpqem.frames.checked_frames import check_sink
from warpqem.frames.stream import ArrayFrames, ArraySink, FrameSink
from warpqem.kernels.topology import MIRROR
from warpqem.mesh.edges import edge_key
from warpqem.mesh.mesh_input import MeshInput, finite_points, read_mesh
from warpqem.mesh.seams import read_seams, seam_ends
from warpqem.options import MeshOptions, SimplifyKeywords, read_keywords
from warpqem.pipeline.bound_sink import BoundSink, ExceededError
from warpqem.pipeline.coarsest import find_coarsest
from warpqem.pipeline.measure_result import ResultMeasure, with_errors
from warpqem.pipeline.mirror import Mirror, MirrorPlane, find_mirror
from warpqem.pipeline.prepare import prepare
from warpqem.pipeline.result import SimplifiedMesh, finish, in_input_terms, reached, written_faces
from warpqem.repair.mended_mesh import repaired_mesh, repaired_options
from warpqem.runtime.device import on_device, resolve_device

if TYPE_CHECKING:
    from typing_extensions import Unpack


__all__ = ["simplify_symmetric"]


@with_progress_bar
@on_device
def simplify_symmetric(
    points: Points,
    faces: ArrayInput,
    symmetry: str | MirrorPlane | Mirror = "auto",
    *,
    sink: FrameSink | None = None,
    progress: ProgressInput = None,
    cancel: CancelToken | None = None,
    **options: Unpack[SimplifyKeywords],
) -> SimplifiedMesh:
    """Simplify a mirror-symmetric mesh so that the result has the same mirror plane.

    Args:
        points: (F, V, 3) or (V, 3), as for :func:`warpqem.simplify`; the first frame is the symmetric pose, unless
            ``symmetry`` is a mirror found in another one. The half is kept in memory.
        faces: (N, 3) vertex indices.
        symmetry: see :func:`warpqem.find_mirror`, or what that returned.
        sink: as for :func:`warpqem.simplify`.
        progress: likewise.
        cancel: likewise.
        options: the other options of :func:`warpqem.simplify`. Of weights, scales and locks that differ between two
            mirror images the larger counts for both, and seams of either are seams of both.

    Returns:
        The result: the vertices and faces of one half come first. It has up to three faces fewer than asked for, as
        both halves have the same number. The log is that of both halves, collapse by collapse and image by image.

    Raises:
        OptionError: the mesh is not symmetric; else as for :func:`warpqem.simplify`.
    """
    check_sink(sink)
    listen = listener(progress, cancel)
    asked = read_keywords(options)
    read = read_mesh(points, faces)
    given = repaired_mesh(read, resolve_device(asked.device))
    asked = repaired_options(asked, read, given)
    frames = finite_points(given.source.read(slice(0, given.frame_count)))
    mirror = symmetry if isinstance(symmetry, Mirror) else find_mirror(frames[0], given.faces, symmetry)
    mirror = _of_proper_faces(mirror, given)
    # Those of a sink are not measured.
    measuring = None
    if sink is None:
        measuring = ResultMeasure(ArrayFrames(frames), given.given_faces, resolve_device(asked.device))
    if not asked.bounded:
        return with_errors(lambda: _simplify_half(_Half(given, frames, mirror, asked), sink, listen), measuring)
    return with_errors(lambda: _simplify_within(given, frames, mirror, asked, sink, listen), measuring)


def _simplify_within(
    given: MeshInput,
    frames: np.ndarray,
    mirror: Mirror,
    asked: MeshOptions,
    sink: FrameSink | None,
    progress: Progress | None,
) -> SimplifiedMesh:
    """The fewest faces that hold the distance asked for, see :mod:`warpqem.pipeline.bounded`."""
    goal, device = asked.goal(len(given.faces)), resolve_device(asked.device)
    limit, diagonal, stuck = goal.limit, _diagonal(frames[:, given.used]), False

    def options(count: int) -> MeshOptions:
        return replace(asked, ratio=None, target_faces=count, max_error=None, max_distance=None)

    def attempt(count: int) -> SimplifiedMesh | None:
        nonlocal stuck
        array = ArraySink()
        checked = BoundSink(array, given, limit, diagonal, device)
        try:
            result = _simplify_half(_Half(given, frames, mirror, options(count)), checked, None)
        except ExceededError:
            return None
        except UnreachableTargetError as error:
            # No level has fewer faces than this one, which the search therefore ends with.
            if error.result is None:
                raise
            result, stuck = error.result, True
        return replace(result, points=array.points)

    face_count, least = len(given.faces), max(2, goal.target_faces)
    result = find_coarsest(attempt, face_count, start=face_count // 2, least=least, limit=limit, progress=progress)
    if sink is not None:
        sink.begin(given.frame_count, result.points.shape[1], result.faces)
        sink.write(slice(0, given.frame_count), result.points)
        result = replace(result, points=result.points[:1])
    if stuck:
        return reached(replace(result, stopped="no legal collapse"), goal.target_faces)
    if len(result.faces) == face_count:
        limit.check_provable()
    at_target = goal.target_faces > 0 and len(result.faces) <= goal.target_faces
    return result if at_target or result.stopped == "max_size_error" else replace(result, stopped="max_error")


def _simplify_half(half: _Half, sink: FrameSink | None, progress: Progress | None) -> SimplifiedMesh:
    """Simplify one half, and put both together."""
    flags = np.where(half.on_plane, int(MIRROR), 0).astype(np.int32)
    work = prepare(half.frames, half.faces, half.options, vertex_flags=flags, progress=progress)
    ordered = work.order(progress)
    placed = ArraySink()
    part = finish(work, ordered, half.options.refits, sink=placed, progress=progress)
    return reached(half.whole(part, placed.points, sink), half.target)


def _of_proper_faces(mirror: Mirror, given: MeshInput) -> Mirror:
    """The mirror of the faces with three different vertices, where it was found with the others too."""
    counts = len(mirror.vertex), len(mirror.face)
    if counts == (given.vertex_count, len(given.faces)):
        return mirror
    if counts != (given.vertex_count, given.input_face_count):
        raise OptionError(
            f"symmetry: the mirror is one of {counts[0]} vertices and {counts[1]} faces, the mesh has "
            f"{given.vertex_count} and {given.input_face_count}"
        )
    new = np.full(given.input_face_count, -1, dtype=np.int64)
    new[given.face_index] = np.arange(len(given.faces))
    half = new[mirror.half]
    return replace(mirror, face=new[mirror.face[given.face_index]], half=half[half >= 0])


class _Half:
    """One half of a mesh as a mesh of its own, and the way back.

    Attributes:
        frames: (2 F, H, 3), its vertices in all poses, and the reflected images of these in all poses.
        faces: (M, 3) int32.
        on_plane: (H,) bool.
        options: what to prepare it with.
        target: faces of the whole asked for; 0 for none.
    """

    def __init__(self, given: MeshInput, frames: np.ndarray, mirror: Mirror, options: MeshOptions) -> None:
        self._given, self._mirror, self._frame_count = given, mirror, len(frames)
        faces = given.faces[mirror.half]
        self._vertex, index = np.unique(faces, return_inverse=True)
        self._image = mirror.vertex[self._vertex]
        self.faces = index.reshape(-1, 3).astype(np.int32)
        self.on_plane = self._image == self._vertex
        images = mirror.plane.reflect(frames[:, self._image]).astype(frames.dtype)
        self.frames = np.concatenate([frames[:, self._vertex], images])
        self._diagonal = _diagonal(frames[:, given.used])
        self._own_diagonal = _diagonal(self.frames)
        self.target = options.goal(len(given.faces)).target_faces
        self.options = replace(options, **self._goal(options), **self._importance(options), **self._values(options))

    def _goal(self, options: MeshOptions) -> dict[str, Any]:
        """Half of the faces."""
        target, repair = self.target, self._given.repair
        if repair is not None and target:
            # Those with a back count twice; it has as large a part in what is left, or somewhat less.
            target = target * len(repair.back) // repair.count_with_backs(np.arange(len(repair.back)))
        return {"ratio": None, "target_faces": max(1, target // 2) if target else options.target_faces}

    def _importance(self, options: MeshOptions) -> dict[str, Any]:
        """Weights and locks at the half's vertices: of two images the larger."""
        given, here = self._given, self._vertex
        weights, locked = read_weights(options.vertex_weights, given)
        locked |= lock_mask(options.locked, given.vertex_count)
        if options.lock_borders:
            # Of the whole mesh: the cut along the plane is no border.
            locked |= border_vertices(given)
        scale = read_quadric_scale(options.quadric_scale, given)
        # Points are found on the whole face.
        face = options.face
        if cost_model(options.metric).keeps_face:
            from warpqem.face.protect import FaceProtection

            place = np.full(given.vertex_count, -1, dtype=np.int64)
            place[self._image], place[here] = np.arange(len(here)), np.arange(len(here))
            face = (FaceProtection() if face is None else face).located(given)
            face = replace(face, features=face.features and face.features.moved(place))
        return {
            "vertex_weights": np.maximum(weights[here], weights[self._image]),
            "quadric_scale": np.maximum(scale[here], scale[self._image]),
            "locked": locked[here] | locked[self._image],
            "lock_borders": False,
            "face": face,
            # A pruned component could not be glued to its image.
            "keep_components": True,
        }

    def _values(self, options: MeshOptions) -> dict[str, Any]:
        """Seams and attributes of the half."""
        given, here = self._given, self._vertex
        rows = given.face_index[self._mirror.half]
        values = checked_fields(options.attributes, given)[0]
        fields = [
            replace(field, values=array[rows] if array.ndim == 3 else array[here])
            for field, array in zip(options.attributes, values, strict=True)
        ]
        seams = options.seams
        if seams is None or is_empty(seams):
            return {"attributes": fields, "seams": None}
        read_seams(seams, given.faces, given.vertex_count)
        pairs = seam_ends(seams, given.vertex_count)
        pairs = np.concatenate([pairs, self._mirror.vertex[pairs]])
        place = np.full(given.vertex_count, -1, dtype=np.int64)
        place[here] = np.arange(len(here))
        pairs = place[pairs]
        pairs = pairs[(pairs >= 0).all(axis=1)]
        count = len(here)
        edges = edge_key(self.faces.ravel(), np.roll(self.faces, -1, axis=1).ravel(), count)
        pairs = pairs[np.isin(edge_key(pairs[:, 0], pairs[:, 1], count), edges)]
        return {"attributes": fields, "seams": np.unique(np.sort(pairs, axis=1), axis=0)}

    def whole(self, part: SimplifiedMesh, points: np.ndarray, sink: FrameSink | None) -> SimplifiedMesh:
        """The whole result of that of the half, whose points in all its frames are given."""
        given, mirror, frame_count = self._given, self._mirror, self._frame_count
        count = points.shape[1]
        on_plane = np.zeros(count, dtype=bool)
        on_plane[part.vertex_map[self.on_plane]] = True
        image = np.where(on_plane, np.arange(count), count + np.cumsum(~on_plane) - 1).astype(np.int32)
        images = mirror.plane.reflect(points[frame_count:])
        own = points[:frame_count].copy()
        own[:, on_plane] = 0.5 * (own[:, on_plane].astype(np.float64) + images[:, on_plane])
        joined = np.concatenate([own, images[:, ~on_plane].astype(np.float32)], axis=1)
        faces = np.concatenate([part.faces, image[part.faces][:, ::-1]]).astype(np.int32)
        source = mirror.half[part.face_map]
        vertex_map = np.full(given.vertex_count, -1, dtype=np.int32)
        vertex_map[self._image] = image[part.vertex_map]
        vertex_map[self._vertex] = part.vertex_map
        faces, face_map = written_faces(given, faces, np.concatenate([source, mirror.face[source]]))
        if sink is not None:
            sink.begin(frame_count, joined.shape[1], faces)
            sink.write(slice(0, frame_count), joined)
        size = self._own_diagonal / self._diagonal
        return SimplifiedMesh(
            points=joined if sink is None else joined[:1],
            faces=faces,
            **in_input_terms(given, vertex_map),
            face_map=face_map,
            stopped=part.stopped,
            error=part.error * size,
            flips=part.flips[:frame_count] + part.flips[frame_count:],
            log=self._whole_log(part.log, size),
            key_frames=np.unique(part.key_frames % frame_count),
            diagonal=self._diagonal,
            plan=part.plan,
            rounding=part.rounding * size,
        )

    def _whole_log(self, log: CollapseRecord, size: float) -> CollapseRecord:
        """Every collapse and, one round later, its image; a vertex of the plane is its own."""
        on_plane = self.on_plane.copy()
        here, image = self._vertex, self._image.copy()
        rows: list[tuple[int, int, int, int, int, int, int]] = []
        opposites = np.where(log.opposites >= 0, log.opposites, 0)
        for i, (kept, removed) in enumerate(zip(log.kept.tolist(), log.removed.tolist(), strict=True)):
            left, right = opposites[i]
            second = here[right] if log.opposites[i, 1] >= 0 else -1
            at_round, faces = 2 * int(log.round_index[i]) - 1, int(log.faces_removed[i])
            if on_plane[kept] and on_plane[removed]:
                # The cut is no border of the whole: the face beyond the edge is the image of the one before it.
                rows.append((here[kept], here[removed], here[left], image[left], 2 * faces, i, at_round))
                continue
            rows.append((here[kept], here[removed], here[left], second, faces, i, at_round))
            other = image[right] if log.opposites[i, 1] >= 0 else -1
            if on_plane[removed]:
                rows.append((here[kept], image[kept], other, image[left], faces, i, at_round + 1))
            else:
                rows.append((image[kept], image[removed], other, image[left], faces, i, at_round + 1))
            if on_plane[removed] or on_plane[kept]:
                on_plane[kept] = True
                image[kept] = here[kept]
        table = np.array(rows, dtype=np.int64).reshape(-1, 7)
        table = table[np.lexsort((table[:, 5], table[:, 6]))]
        flip = (table[:, 2] < 0) & (table[:, 3] >= 0)
        table[flip, 2], table[flip, 3] = table[flip, 3], -1
        index = table[:, 5]
        return CollapseRecord(
            kept=table[:, 0].astype(np.int32),
            removed=table[:, 1].astype(np.int32),
            opposites=table[:, 2:4].astype(np.int32),
            faces_removed=table[:, 4].astype(np.int32),
            cost=(log.cost[index] * size**4).astype(np.float32),
            error=(log.error[index] * size).astype(np.float32),
            round_index=table[:, 6].astype(np.int32),
            recent_error=(log.recent_error[index] * size).astype(np.float32),
        )


def _diagonal(frames: np.ndarray) -> float:
    """Largest bounding-box diagonal of a frame."""
    return float(np.linalg.norm(np.ptp(frames.astype(np.float64), axis=1), axis=1).max())
