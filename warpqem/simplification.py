"""``warpqem.simplify``: one topology for a whole animation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from warpqem.arguments import Goal, check_options, read_goal
from warpqem.attributes import AttributeField, channel_count, weighted_corner_values
from warpqem.cost_models import CostModelSpec, cost_model
from warpqem.device import resolve_device
from warpqem.errors import UnreachableTargetError
from warpqem.finishing import place_frames, place_refitted
from warpqem.frame_blocks import frame_blocks, pack_frames
from warpqem.frame_stream import ArraySink, FrameSink, read_ahead
from warpqem.importance import border_vertices, lock_mask, read_quadric_scale, read_weights
from warpqem.kernels.topology import CORNER, LOCKED, SEAM
from warpqem.key_frames import KeyFrameChoice
from warpqem.memory import MemoryNeeds, MemoryPlan, plan_memory
from warpqem.mesh_input import AnimatedMesh, MeshInput, measure_mesh, read_mesh
from warpqem.motion import MotionWatch
from warpqem.order.log import CollapseRecord
from warpqem.order.stage import OrderInput, OrderSettings, order_collapses
from warpqem.place.stage import Placer, PlaceSettings
from warpqem.seams import Seams, read_seams

__all__ = ["SimplifiedMesh", "plan", "simplify"]

Progress = Callable[[float, str], None]

# Where reading for the first time and ordering end in the progress; placing takes the rest.
READ_END = 0.05
ORDER_END = 0.7
# Ordering follows the material no more stiffly than this: beyond it the order loses shape and gains no steadiness.
ORDER_EPSILON = 0.05


@dataclass(frozen=True)
class SimplifiedMesh:
    """What :func:`simplify` returns.

    Attributes:
        points: (F, V', 3) float32, in the input's coordinates; where a sink took the frames, the first one, (1, V', 3).
        faces: (N', 3) int32.
        vertex_map: (V,) int32, input vertex to the output vertex it collapsed into; -1 for a vertex without a face.
        face_map: (N',) int32, the input face that each output face goes on from.
        stopped: "target", "max_error" or "no legal collapse".
        error: % of the bounding-box diagonal, the largest RMS distance over key frames, among all collapses, of a
            merged vertex from the planes of the faces it stands for.
        flips: (F,) int32, output faces that face away from the input there.
        log: the collapses, for levels of detail.
        key_frames: (K,) int, the frames that decided the order.
        diagonal: largest bounding-box diagonal of a frame of the input, in its units.
        plan: the blocks of frames it was done in, and the memory for it.
    """

    points: np.ndarray
    faces: np.ndarray
    vertex_map: np.ndarray
    face_map: np.ndarray
    stopped: str
    error: float
    flips: np.ndarray
    log: CollapseRecord
    key_frames: np.ndarray
    diagonal: float
    plan: MemoryPlan


def simplify(
    points: Any,
    faces: Any = None,
    *,
    ratio: float | None = None,
    target_faces: int | None = None,
    max_error: float | None = None,
    metric: str = "dsd",
    coherence: float = 0.5,
    key_frames: int | None = 16,
    placement: str = "optimal",
    refit: bool = False,
    vertex_weights: Any = None,
    quadric_scale: Any = None,
    locked: Any = None,
    lock_borders: bool = False,
    seams: Any = None,
    attributes: Sequence[AttributeField] = (),
    memory: int | str | None = None,
    sink: FrameSink | None = None,
    device: str | None = None,
    progress: Progress | None = None,
) -> SimplifiedMesh:
    """Simplify an animated mesh to one topology that fits all its frames.

    The result is deterministic: the same input gives the same bits on the same device.

    Args:
        points: (F, V, 3) or (V, 3) coordinates in any unit: NumPy, Warp, or anything with the array interface or
            DLPack; or a :class:`warpqem.FrameSource`, which is read block by block, twice, and once more for the key
            frames; or a ``trimesh.Trimesh``, then without ``faces``.
        faces: (N, 3) vertex indices.
        ratio: part of the faces to keep, in (0, 1].
        target_faces: faces to keep, at least 1. The result has as many, or one fewer.
        max_error: stop before an edge collapse whose error (see ``SimplifiedMesh.error``) exceeds this, in % of the
            bounding-box diagonal. At least one of the three is needed; with a count, whichever comes first stops.
        metric: "dsd" (default), "qem", "dod" or "aqem"; see :mod:`warpqem.cost_models`.
        coherence: 0 (every frame its own best fit) to 1 (vertices stay on the material).
        key_frames: how many frames decide the order, chosen by their pose; None for all.
        placement: "optimal", or "endpoint" to use vertices of the input only.
        refit: fit the surface as a whole to the input after placing its vertices, see :mod:`warpqem.refit.stage`: a
            better shape for about the time of the rest. No effect with "endpoint".
        vertex_weights: (V,) factors from 0 to 1e12 on the cost at each vertex; infinity locks it. A merged vertex gets
            the mean of its ends'.
        quadric_scale: (V,) factors from 0 to 1e12 on each vertex's own quadric (Kho & Garland 2003), which stay with
            its planes as they add up; see :func:`warpqem.morph_weights`. Vertices are placed by the scaled quadrics.
        locked: (V,) bool, or indices, of vertices that keep their position in every frame.
        lock_borders: lock the vertices at edges with one face too.
        seams: (S, 2) vertex pairs: edges that values on the surface do not cross, such as UV seams. They stay closed
            polylines of edges near where they were, with the same ends and forks, as long as the shape has something
            to spare: beyond that the islands between them that cost the shape least are given up.
        attributes: UVs and other values on the surface, each with the weight of its error in the order of collapses;
            see :class:`warpqem.AttributeField`. ``max_error`` and ``SimplifiedMesh.error`` stay errors of the shape.
        memory: bytes that the work may take, beside what the process holds already, or text such as "8G"; None for
            most of what is free. It decides how many frames are in memory at once, and no bit of the result.
        sink: takes the frames of the result, block by block, in place of an array.
        device: Warp device; None takes cuda:0 if present, else cpu.
        progress: called with the part done, 0 to 1, and the stage, "read", "order" or "place".

    Raises:
        OptionError: an option outside its range, or options that exclude each other.
        MeshShapeError, NonFinitePointError, FaceIndexError, DegenerateMeshError: see :mod:`warpqem.errors`.
        DeviceError: there is no such device.
        MemoryLimitError: it cannot be done in that memory; raised before the work starts.
        UnreachableTargetError: no legal collapse leads to the face count asked for; its ``result`` is what there is.
    """
    spec = cost_model(metric)
    goal_options = (ratio, target_faces, max_error)
    check_options(goal_options, coherence, key_frames, placement)
    device = resolve_device(device)
    given = read_mesh(points, faces)
    goal = read_goal(len(given.faces), *goal_options)
    refit = refit and placement != "endpoint"
    planned = _plan(given, spec, goal, key_frames, attributes, refit, sink is None, memory, device)
    seam = read_seams(seams, given.faces, given.vertex_count)
    factors, pinned = read_weights(vertex_weights, given)
    pinned |= lock_mask(locked, given.vertex_count)
    if lock_borders:
        pinned |= border_vertices(given)
    scale = read_quadric_scale(quadric_scale, given)
    values = weighted_corner_values(attributes, given)
    mesh, keys, weights = _look_through(given, spec, planned, factors, progress, device)
    order_input = _order_input(spec, mesh, keys, weights, scale, seam, pinned, values, device)
    ordered = order_collapses(
        order_input,
        OrderSettings(
            target_faces=goal.target_faces,
            error_limit=goal.max_error / 100.0,
            epsilon=min(_epsilon(coherence), ORDER_EPSILON),
            endpoint=placement == "endpoint",
            deformation_weight=spec.deformation_weight,
        ),
        device,
        _order_progress(progress, len(mesh.faces), goal.target_faces),
    )
    settings = PlaceSettings(_epsilon(coherence), _regularisation(coherence), placement == "endpoint")
    placer = Placer(mesh.faces, ordered, order_input.quadric_scale, pinned, settings, device)
    log, face_map, stopped = ordered.log, ordered.face_map, ordered.stopped
    # Placing has its own use for this memory.
    del order_input, ordered
    error = float(log.error.max(initial=0.0))
    array = ArraySink()
    blocks = frame_blocks(mesh.frame_count, mesh.vertex_count, planned.block_frames)
    common = (mesh, placer, array if sink is None else sink, blocks, _place_progress(progress, mesh.frame_count))
    if refit and placer.free.any():
        on_disk = planned.scratch_bytes > 0
        finished = place_refitted(*common, key_frames=keys, error=error, on_disk=on_disk, device=device)
    else:
        finished = place_frames(*common)
    result = SimplifiedMesh(
        points=array.points if sink is None else finished.first,
        faces=placer.faces,
        vertex_map=placer.vertex_map,
        face_map=mesh.face_index[face_map],
        stopped=stopped,
        error=100.0 * error,
        flips=finished.flips,
        log=log,
        key_frames=keys,
        diagonal=mesh.diagonal,
        plan=planned,
    )
    if goal.target_faces > 0 and result.stopped == "no legal collapse":
        raise UnreachableTargetError(
            f"{len(result.faces)} faces are left and no edge collapse is legal, {goal.target_faces} were asked for",
            result,
        )
    return result


def plan(
    points: Any,
    faces: Any = None,
    *,
    ratio: float | None = None,
    target_faces: int | None = None,
    max_error: float | None = None,
    metric: str = "dsd",
    key_frames: int | None = 16,
    placement: str = "optimal",
    refit: bool = False,
    attributes: Sequence[AttributeField] = (),
    memory: int | str | None = None,
    sink: FrameSink | None = None,
    device: str | None = None,
) -> MemoryPlan:
    """What :func:`simplify` would do with these arguments, and the memory for it; no frame is read.

    Raises:
        MemoryLimitError: it cannot be done in that memory.
        OptionError, MeshShapeError, FaceIndexError, DegenerateMeshError, DeviceError: as for :func:`simplify`.
    """
    spec = cost_model(metric)
    check_options((ratio, target_faces, max_error), 0.0, key_frames, placement)
    device = resolve_device(device)
    given = read_mesh(points, faces)
    goal = read_goal(len(given.faces), ratio, target_faces, max_error)
    refit = refit and placement != "endpoint"
    return _plan(given, spec, goal, key_frames, attributes, refit, sink is None, memory, device)


def _plan(
    mesh: MeshInput,
    spec: CostModelSpec,
    goal: Goal,
    key_frames: int | None,
    attributes: Sequence[AttributeField],
    refit: bool,
    keep_frames: bool,
    memory: int | str | None,
    device: str,
) -> MemoryPlan:
    frame_count, face_count = mesh.frame_count, len(mesh.faces)
    used_count = int(mesh.used.sum())
    most_keys = 1 if spec.single_frame else key_frames
    key_count = frame_count if most_keys is None else min(frame_count, int(most_keys))
    # A surface has about half as many vertices as faces; where borders are, or many small pieces, more. With an error
    # limit alone, nothing need go.
    output = min(used_count, goal.target_faces + 2) if goal.target_faces else used_count
    return plan_memory(
        MemoryNeeds(
            frame_count=frame_count,
            vertex_count=mesh.vertex_count,
            face_count=face_count,
            used_count=used_count,
            key_frames=key_count,
            output_vertices=output,
            value_bytes=mesh.source.dtype.itemsize,
            channels=channel_count(attributes),
            trajectories=spec.deformation_weight > 0,
            refit=refit,
            keep_frames=keep_frames,
        ),
        memory,
        device,
    )


def _look_through(
    given: MeshInput,
    spec: CostModelSpec,
    planned: MemoryPlan,
    factors: np.ndarray,
    progress: Progress | None,
    device: str,
) -> tuple[AnimatedMesh, np.ndarray, np.ndarray]:
    """Read all frames once: the mesh's size, its key frames (K,), and the weight of the cost at each vertex (V,)."""
    choice = KeyFrameChoice(given, planned.key_frames)
    motion = MotionWatch(given, device) if spec.uses_motion_features else None
    observers = [choice] if motion is None else [choice, motion]
    mesh = measure_mesh(given, observers, planned.block_frames, _read_progress(progress, given.frame_count))
    return mesh, choice.choose(), factors if motion is None else motion.features().weight * factors


def _order_input(
    spec: CostModelSpec,
    mesh: AnimatedMesh,
    keys: np.ndarray,
    weights: np.ndarray,
    scale: np.ndarray,
    seam: Seams,
    pinned: np.ndarray,
    attributes: np.ndarray | None,
    device: str,
) -> OrderInput:
    flags = np.where(pinned, int(LOCKED), 0) | np.where(seam.on_seam, int(SEAM), 0)
    flags |= np.where(seam.corner, int(CORNER), 0)
    return OrderInput(
        faces=mesh.faces,
        key_position=pack_frames(mesh.chosen_points(keys), device, centre=mesh.centre, scale=1 / mesh.diagonal),
        key_count=len(keys),
        vertex_flags=flags.astype(np.int32),
        quadric_scale=scale,
        cost_weight=weights,
        seam=seam.half_edge,
        trajectories=_trajectories(mesh) if spec.deformation_weight > 0 else None,
        attributes=attributes,
    )


def _trajectories(mesh: AnimatedMesh) -> np.ndarray:
    """Every frame of every vertex, in diagonals: (V, F, 3) float32, so that a vertex's trajectory is contiguous."""
    trajectories = np.empty((mesh.vertex_count, mesh.frame_count, 3), dtype=np.float32)
    for frames, points in read_ahead(mesh.points, frame_blocks(mesh.frame_count, mesh.vertex_count)):
        trajectories[:, frames] = mesh.to_unit(points).transpose(1, 0, 2)
    return trajectories


def _epsilon(coherence: float) -> float:
    """Pull towards the anchor: 1e-3, the least that float32 solves safely, at 0; 0.3 at one half; 100 at 1."""
    return 10.0 ** (5.0 * coherence - 3.0)


def _regularisation(coherence: float) -> float:
    """Pull of anchor weights towards equal ones: 0.005 at coherence 0, 0.05 at one half, 0.5 at 1."""
    return 0.005 * 100.0**coherence


def _read_progress(progress: Progress | None, frame_count: int) -> Callable[[int], None] | None:
    if progress is None:
        return None
    return lambda done: progress(READ_END * done / frame_count, "read")


def _order_progress(progress: Progress | None, face_count: int, target: int) -> Callable[[int], None] | None:
    if progress is None:
        return None
    share = ORDER_END - READ_END
    # The last collapse may take one face more than asked for.
    return lambda live: progress(
        READ_END + share * min(1.0, (face_count - live) / max(1, face_count - target)), "order"
    )


def _place_progress(progress: Progress | None, frame_count: int) -> Callable[[int], None] | None:
    if progress is None:
        return None
    return lambda done: progress(ORDER_END + (1.0 - ORDER_END) * done / frame_count, "place")
