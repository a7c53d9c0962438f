"""``warpqem.simplify``: one topology for a whole animation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from warpqem.arguments import SimplifyOptions
from warpqem.attributes import AttributeField
from warpqem.bounded import simplify_within
from warpqem.checked_frames import check_sink
from warpqem.cost_models import cost_model
from warpqem.device import on_device, resolve_device
from warpqem.frame_stream import FrameSink
from warpqem.measuring import ResultMeasure, measured_on_the_way, with_errors
from warpqem.memory import MemoryPlan, admit_faces
from warpqem.mesh_input import read_mesh
from warpqem.number_input import flag
from warpqem.preparation import Progress, plan_work, prepare
from warpqem.result import Delivery, Outcome, SimplifiedMesh, finish, reached
from warpqem.sharing import FrameShare, check_share

if TYPE_CHECKING:
    from warpqem.face.protect import FaceProtection
    from warpqem.measure.measured import Measured
    from warpqem.motion import MotionWeighting

__all__ = ["plan", "simplify"]


@on_device
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
    memoryless: bool = False,
    vertex_weights: Any = None,
    quadric_scale: Any = None,
    locked: Any = None,
    lock_borders: bool = False,
    keep_components: bool = False,
    seams: Any = None,
    attributes: Sequence[AttributeField] = (),
    face: FaceProtection | None = None,
    motion: MotionWeighting | None = None,
    memory: int | str | None = None,
    sink: FrameSink | None = None,
    share: FrameShare | None = None,
    measure: bool = True,
    device: str | None = None,
    progress: Progress | None = None,
) -> SimplifiedMesh:
    """Simplify an animated mesh to one topology that fits all its frames.

    The result is deterministic: the same input gives the same bits on the same device, also where several threads call
    at once, ``asyncio.to_thread`` included. On a CPU such calls run side by side, a GPU takes one at a time; that holds
    for all public functions.

    Args:
        points: (F, V, 3) or (V, 3) coordinates in any unit: NumPy, Warp, or anything with the array interface or
            DLPack; or a :class:`warpqem.FrameSource`, which is read block by block, twice, and once more for the key
            frames; or a ``trimesh.Trimesh``, then without ``faces``.
        faces: (N, 3) vertex indices.
        ratio: part of the faces to keep, in (0, 1].
        target_faces: faces to keep, at least 1. The result has as many, or one fewer.
        max_error: the largest distance between the input and the result, both ways, at every point and in every frame,
            in % of the diagonal of the input's bounding box in that frame. It is proved, not sampled
            (:mod:`warpqem.kernels.distance_bound`), for the result as it is returned; the number of faces is searched
            for (:mod:`warpqem.bounded`), which takes several times as long as a result by count. At least one of the
            three is needed; with a count, whichever comes first stops.
        metric: "dsd" (default), "qem", "dod", "aqem" or "face"; see :mod:`warpqem.cost_models`.
        coherence: 0 (every frame its own best fit) to 1 (vertices stay on the material).
        key_frames: how many frames decide the order, chosen by their pose; None for all.
        placement: "optimal", or "endpoint" to use vertices of the input only.
        refit: fit the surface as a whole to the input after placing its vertices, see :mod:`warpqem.refit.stage`: a
            better shape for about the time of the rest. No effect with "endpoint".
        memoryless: order by quadrics of the present faces instead of the input's: a better shape in about 1.5 to 2
            times the time, best together with ``refit``; see :mod:`warpqem.kernels.present_quadric`. Not for levels of
            one ordering.
        vertex_weights: (V,) factors from 0 to 1e12 on the cost at each vertex; infinity locks it. A merged vertex gets
            the mean of its ends'.
        quadric_scale: (V,) factors from 0 to 1e12 on each vertex's own quadric (Kho & Garland 2003), which stay with
            its planes as they add up; see :func:`warpqem.morph_weights`. Vertices are placed by the scaled quadrics.
        locked: (V,) bool, or indices, of vertices that keep their position in every frame.
        lock_borders: lock the vertices at edges with one face too.
        keep_components: no component vanishes. Otherwise small ones do as a whole, once collapses have left four faces
            of them or fewer, where the shape misses that less than the next collapses, and where no other collapse is
            legal; the result may then have up to three faces fewer than asked for. A locked vertex keeps its component.
        seams: (S, 2) vertex pairs: edges that values on the surface do not cross, such as UV seams. They stay closed
            polylines of edges near where they were, with the same ends and forks, as long as the shape has something
            to spare: beyond that the islands between them that cost the shape least are given up.
        attributes: UVs and other values on the surface, each with the weight of its error in the order of collapses;
            see :class:`warpqem.AttributeField`. ``max_error`` and ``SimplifiedMesh.error`` stay errors of the shape.
        face: how ``metric="face"`` keeps the feature points of a face, see :class:`warpqem.FaceProtection`; None for
            its defaults.
        motion: how ``metric="aqem"`` finds the joints and what they weigh, see :class:`warpqem.MotionWeighting`; None
            for the ways of its paper.
        memory: bytes that the work may take, beside what the process holds already, or text such as "8G"; None for
            most of what is free. It decides how many frames are in memory at once, and no bit of the result.
        sink: takes the frames of the result, block by block, in place of an array.
        share: lets other processes place some of the frames, see :class:`warpqem.FrameShare`; it decides no bit of the
            result.
        measure: give the result its ``measured`` errors: where it is an array, they are computed when they are first
            asked for, and the result holds on to the input; where there is a sink, on the way to it, for which the
            frames are read once more. It decides no bit of the result.
        device: Warp device; None takes cuda:0 if present, else cpu.
        progress: called with the part done, 0 to 1, and the stage, "read", "order" or "place".

    Raises:
        OptionError: an option outside its range, or options that exclude each other.
        MeshShapeError, NonFinitePointError, FaceIndexError, DegenerateMeshError: see :mod:`warpqem.errors`.
        FeaturePointError: metric "face", and the mesh is none.
        DeviceError: there is no such device.
        MemoryLimitError: it cannot be done in that memory; raised before the work starts.
        UnreachableTargetError: no legal collapse leads to the face count asked for; its ``result`` is what there is.
    """
    options = SimplifyOptions(
        ratio=ratio,
        target_faces=target_faces,
        max_error=max_error,
        metric=metric,
        coherence=coherence,
        key_frames=key_frames,
        placement=placement,
        refit=refit,
        memoryless=memoryless,
        vertex_weights=vertex_weights,
        quadric_scale=quadric_scale,
        locked=locked,
        lock_borders=lock_borders,
        keep_components=keep_components,
        seams=seams,
        attributes=attributes,
        face=face,
        motion=motion,
        memory=memory,
        device=device,
    )
    check_sink(sink)
    check_share(share)
    bounded = max_error is not None
    keep_nodes = bounded and not memoryless
    work = prepare(points, faces, options, keep_frames=sink is None, keep_nodes=keep_nodes, progress=progress)
    measuring: Callable[[SimplifiedMesh], Measured] | None = None
    if flag(measure, "measure"):
        if sink is None:
            measuring = ResultMeasure.of(work.mesh, work.device)
        else:
            work, sink = measured_on_the_way(work, sink)
            measuring = sink.measured
    delivery = Delivery(sink, progress, share)
    if bounded:
        return with_errors(partial(simplify_within, work, options.refits, delivery), measuring)
    ordered = work.order(progress)
    placer, outcome = work.placer(ordered), Outcome.of(ordered)
    # Placing has its own use for the memory of ordering.
    work = work.without_input()
    del ordered
    result = finish(work, placer, outcome, options.refits, delivery)
    return reached(replace(result, measuring=measuring), work.goal.target_faces)


def plan(
    points: Any, faces: Any = None, *, sink: FrameSink | None = None, levels: bool = False, **options: Any
) -> MemoryPlan:
    """What :func:`simplify` would do with these arguments, and the memory for it; no frame is read.

    Args:
        points: as for :func:`simplify`.
        faces: likewise.
        sink: likewise.
        levels: plan for the coarsest level of :func:`order_levels`.
        options: the other options of :func:`simplify`, but for ``progress``.

    Raises:
        MemoryLimitError: it cannot be done in that memory.
        OptionError, MeshShapeError, FaceIndexError, DegenerateMeshError, DeviceError: as for :func:`simplify`.
    """
    check_sink(sink)
    asked = SimplifyOptions(**options).checked()
    spec, levels = cost_model(asked.metric), flag(levels, "levels")
    device = resolve_device(asked.device)
    mesh = read_mesh(points, faces, partial(admit_faces, limit=asked.memory, device=device))
    keep_nodes = levels or (asked.max_error is not None and not asked.memoryless)
    return plan_work(mesh, spec, asked, device, keep_frames=sink is None, keep_nodes=keep_nodes)
