"""``warpqem.simplify``: one topology for a whole animation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from warpqem.arguments import check_options, check_ratio, read_goal, target_count
from warpqem.attributes import AttributeField
from warpqem.cost_models import cost_model
from warpqem.device import resolve_device
from warpqem.errors import OptionError, UnreachableTargetError
from warpqem.finishing import place_frames, place_refitted
from warpqem.frame_stream import ArraySink, FrameSink
from warpqem.memory import MemoryPlan
from warpqem.mesh_input import read_mesh
from warpqem.order.levels import OrderedLevels
from warpqem.order.log import CollapseRecord
from warpqem.order.nodes import NodeRecorder
from warpqem.order.stage import OrderedMesh
from warpqem.place.stage import Placer
from warpqem.preparation import ORDER_END, Prepared, Progress, plan_work, prepare

__all__ = ["SimplifiedMesh", "plan", "simplify", "simplify_levels"]


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
    work = prepare(
        points,
        faces,
        ratio=ratio,
        target_faces=target_faces,
        max_error=max_error,
        metric=metric,
        coherence=coherence,
        key_frames=key_frames,
        placement=placement,
        refit=refit,
        vertex_weights=vertex_weights,
        quadric_scale=quadric_scale,
        locked=locked,
        lock_borders=lock_borders,
        seams=seams,
        attributes=attributes,
        memory=memory,
        keep_frames=sink is None,
        device=device,
        progress=progress,
    )
    ordered = work.order(progress)
    placer, outcome = work.placer(ordered), _Outcome.of(ordered)
    # Placing has its own use for the memory of ordering.
    work = work.without_input()
    del ordered
    result = _finish(work, placer, outcome, refit, sink, progress)
    if work.goal.target_faces > 0 and result.stopped == "no legal collapse":
        raise UnreachableTargetError(
            f"{len(result.faces)} faces are left and no edge collapse is legal, "
            f"{work.goal.target_faces} were asked for",
            result,
        )
    return result


def simplify_levels(
    points: Any,
    faces: Any = None,
    *,
    ratios: Sequence[float],
    refit: bool = False,
    progress: Progress | None = None,
    **options: Any,
) -> list[SimplifiedMesh]:
    """Simplify an animated mesh to several levels that nest: edges are collapsed once, each level is placed on its own.

    Every level has the bits of :func:`simplify` with its ratio. Where no legal collapse leads to a level, it is the
    coarsest mesh there is, and its ``stopped`` says so. For any level at all see :func:`warpqem.build_progressive`.

    Args:
        points: as for :func:`simplify`.
        faces: likewise.
        ratios: part of the faces that each level keeps, in (0, 1].
        refit: refit each level on its own.
        progress: called with the part done, 0 to 1, and the stage, "read", "order" or "place".
        options: other keyword arguments of :func:`simplify`, but for its goals and ``sink``.

    Raises:
        OptionError: also where there is no ratio, or an option that does not apply.
        WarpqemError: the other errors of :func:`simplify`, but for an unreachable target.
    """
    refused = {"ratio", "target_faces", "max_error", "sink"} & set(options)
    if refused or not len(ratios):
        raise OptionError(f"{', '.join(sorted(refused))}: not with levels" if refused else "levels need ratios")
    for ratio in ratios:
        check_ratio(ratio)
    work = prepare(points, faces, ratio=min(ratios), refit=refit, progress=progress, **options)
    recorder = NodeRecorder()
    levels = OrderedLevels(work.mesh.faces, work.order(progress, recorder), recorder)
    results = []
    for index, ratio in enumerate(ratios):
        ordered = levels.at(levels.collapses_to(target_count(ratio, len(work.mesh.faces))))
        part = None if progress is None else _part_of(progress, index, len(ratios))
        results.append(_finish(work, work.placer(ordered), _Outcome.of(ordered), refit, None, part))
    return results


@dataclass(frozen=True)
class _Outcome:
    """What a result says of its ordering."""

    log: CollapseRecord
    face_map: np.ndarray
    stopped: str

    @classmethod
    def of(cls, ordered: OrderedMesh) -> _Outcome:
        return cls(ordered.log, ordered.face_map, ordered.stopped)


def _finish(
    work: Prepared, placer: Placer, outcome: _Outcome, refit: bool, sink: FrameSink | None, progress: Progress | None
) -> SimplifiedMesh:
    """Place all frames, and refit them where that is asked for."""
    mesh = work.mesh
    error = float(outcome.log.error.max(initial=0.0))
    array = ArraySink()
    common = (mesh, placer, array if sink is None else sink, work.blocks, _place_progress(progress, mesh.frame_count))
    if refit and not work.place_settings.endpoint and placer.free.any():
        on_disk = work.plan.scratch_bytes > 0
        finished = place_refitted(*common, key_frames=work.key_frames, error=error, on_disk=on_disk, device=work.device)
    else:
        finished = place_frames(*common)
    return SimplifiedMesh(
        points=array.points if sink is None else finished.first,
        faces=placer.faces,
        vertex_map=placer.vertex_map,
        face_map=mesh.face_index[outcome.face_map],
        stopped=outcome.stopped,
        error=100.0 * error,
        flips=finished.flips,
        log=outcome.log,
        key_frames=work.key_frames,
        diagonal=mesh.diagonal,
        plan=work.plan,
    )


def plan(
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
    check_options((ratio, target_faces, max_error), coherence, key_frames, placement)
    device = resolve_device(device)
    given = read_mesh(points, faces)
    goal = read_goal(len(given.faces), ratio, target_faces, max_error)
    refit = refit and placement != "endpoint"
    return plan_work(given, spec, goal, key_frames, attributes, refit, sink is None, memory, device)


def _place_progress(progress: Progress | None, frame_count: int) -> Callable[[int], None] | None:
    if progress is None:
        return None
    return lambda done: progress(ORDER_END + (1.0 - ORDER_END) * done / frame_count, "place")


def _part_of(progress: Progress, index: int, count: int) -> Progress:
    """The progress of placing one of several levels."""

    def part(fraction: float, stage: str) -> None:
        done = (index + (fraction - ORDER_END) / (1.0 - ORDER_END)) / count
        progress(ORDER_END + (1.0 - ORDER_END) * done, stage)

    return part
