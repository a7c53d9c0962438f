"""``warpqem.simplify``: one topology for a whole animation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from warpqem.arguments.array_types import ArrayInput, MeshPoints
from warpqem.arguments.number_input import flag
from warpqem.arguments.progress import CancelToken, ProgressInput, listener, with_progress_bar
from warpqem.costs.models import cost_model
from warpqem.frames.checked_frames import check_sink
from warpqem.frames.stream import FrameSink
from warpqem.mesh.mesh_input import read_mesh
from warpqem.options import SimplifyKeywords, read_keywords
from warpqem.pipeline.bounded import simplify_within
from warpqem.pipeline.exchange import exchanged, faces_ahead, order_with_spare
from warpqem.pipeline.measure_result import ResultMeasure, measured_on_the_way, with_errors
from warpqem.pipeline.memory_plan import MemoryPlan, admit_faces
from warpqem.pipeline.prepare import plan_work, prepare
from warpqem.pipeline.result import SimplifiedMesh, reached, with_frames, without_frames
from warpqem.repair.mended_mesh import repaired_mesh, repaired_options
from warpqem.runtime.device import array_device, on_device, resolve_device

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from warpqem.measure.measured import Measured

__all__ = ["plan", "simplify"]


@with_progress_bar
@on_device
def simplify(
    points: MeshPoints,
    faces: ArrayInput | None = None,
    *,
    sink: FrameSink | None = None,
    measure: bool = True,
    progress: ProgressInput = None,
    cancel: CancelToken | None = None,
    **options: Unpack[SimplifyKeywords],
) -> SimplifiedMesh:
    """Simplify an animated mesh to one topology that fits all its frames.

    The result is deterministic: the same input gives the same bits on the same device, also where several threads call
    at once, ``asyncio.to_thread`` included. On a CPU such calls run side by side, a GPU takes one at a time; that holds
    for all public functions.

    Faces may repeat, in either winding, face this way and that, or meet three and more at an edge: decimation works on
    a mended copy of the topology, and ``SimplifiedMesh.notes`` says what was found. What has two sides keeps both, and
    each connected part gets the winding that most of its faces have.

    Args:
        points: (F, V, 3) or (V, 3) coordinates in any unit: NumPy, Warp, or anything with the array interface or
            DLPack; or a :class:`warpqem.FrameSource`, which is read block by block, twice, and up to four times more
            for the key frames; or a ``trimesh.Trimesh``, or what :func:`warpqem.load` gives, then without ``faces``. An
            array on a GPU stays there: without ``device`` that is where it is simplified, and where the arrays of the
            result are.
        faces: (N, 3) vertex indices.
        sink: takes the frames of the result, block by block, in place of an array.
        measure: give the result its ``measured`` errors: where it is an array, they are computed when they are first
            asked for, and the result holds on to the input; where there is a sink, on the way to it, for which the
            frames are read once more. It decides no bit of the result.
        progress: called with the part done, 0 to 1, and the stage, "read", "order" or "place"; True for a bar.
        cancel: ends the call from another thread, such as a ``threading.Event``, where ``progress`` would be called.
        options: how far and how to simplify: the fields of :class:`warpqem.options.MeshOptions`, explained there. At
            least one of ``ratio``, ``target_faces`` and ``max_error`` is needed; with a count, whichever comes first
            stops.

    Raises:
        TypeError: there is no such option.
        OptionError: an option outside its range, or options that exclude each other.
        MeshShapeError, NonFinitePointError, FaceIndexError, DegenerateMeshError: see :mod:`warpqem.errors`.
        FeaturePointError: metric "face", and the mesh is none.
        DeviceError: there is no such device.
        MemoryLimitError: it cannot be done in that memory; raised before the work starts.
        CancelledError: ``cancel`` was set.
        UnreachableTargetError: no legal collapse leads to the face count asked for; its ``result`` is what there is.

    Examples:
        A ball that swells over four frames:

        >>> import numpy as np, trimesh, warpqem
        >>> ball = trimesh.creation.icosphere(subdivisions=3)
        >>> points = np.stack([ball.vertices * (1, 1, 1 + 0.2 * step) for step in range(4)])
        >>> result = warpqem.simplify(points, ball.faces, ratio=0.1)
        >>> result.points.shape, result.faces.shape, result.stopped
        ((4, 66, 3), (128, 3), 'target')
    """
    asked = read_keywords(options)
    check_sink(sink)
    listen = listener(progress, cancel)
    bounded = asked.bounded
    measure = flag(measure, "measure")
    work = prepare(
        points,
        faces,
        asked,
        keep_frames=sink is None,
        keep_nodes=bounded,
        measured=measure and sink is not None,
        progress=listen,
    )
    measuring: Callable[[SimplifiedMesh], Measured] | None = None
    if measure:
        if sink is None:
            measuring = ResultMeasure.of(work.mesh, work.device)
        else:
            work, sink = measured_on_the_way(work, sink)
            measuring = sink.measured
    device = work.result_device if sink is None else None
    if bounded:
        within = partial(simplify_within, work, asked.refits, sink=sink, progress=listen)
        return with_errors(within, measuring, device)
    around = faces_ahead(work) if asked.exchanges else None
    ordered = order_with_spare(work, listen) if asked.exchanges else work.order(listen)
    # What follows needs the memory of decimation.
    work = work.without_input()
    if asked.exchanges:
        ordered = exchanged(work, ordered, work.goal.target_faces, listen, around)
    placer = work.placer(ordered, refit=asked.refits)
    result = without_frames(work, placer, ordered)
    del ordered
    result = with_frames(result, work, placer, asked.refits, sink=sink, device=device, progress=listen)
    return reached(replace(result, log=result.log.made(), measuring=measuring), work.goal.target_faces)


def plan(
    points: MeshPoints,
    faces: ArrayInput | None = None,
    *,
    sink: FrameSink | None = None,
    levels: bool = False,
    measure: bool = True,
    **options: Unpack[SimplifyKeywords],
) -> MemoryPlan:
    """What :func:`simplify` would do with these arguments, and the memory for it; no frame is read.

    Args:
        points: as for :func:`simplify`.
        faces: likewise.
        sink: likewise.
        levels: plan for the coarsest level of :func:`order_levels`.
        measure: as for :func:`simplify`.
        options: the other options of :func:`simplify`, but for ``progress`` and ``cancel``.

    Raises:
        MemoryLimitError: it cannot be done in that memory.
        OptionError, MeshShapeError, FaceIndexError, DegenerateMeshError, DeviceError: as for :func:`simplify`.

    Examples:
        >>> import numpy as np, trimesh, warpqem
        >>> ball = trimesh.creation.icosphere(subdivisions=3)
        >>> points = np.stack([ball.vertices * (1, 1, 1 + 0.2 * step) for step in range(4)])
        >>> plan = warpqem.plan(points, ball.faces, ratio=0.1, memory="1G")
        >>> plan.peak_bytes < 10**9
        True
    """
    check_sink(sink)
    asked = read_keywords(options)
    spec, levels = cost_model(asked.metric), flag(levels, "levels")
    there = array_device(points)
    device = resolve_device(there if asked.device is None else asked.device)
    given = read_mesh(
        points,
        faces,
        partial(admit_faces, limit=asked.memory, device=device),
        None if there is None else device,
    )
    mesh = repaired_mesh(given, device)
    asked = repaired_options(asked, given, mesh)
    keep_nodes = levels or asked.bounded
    measured = flag(measure, "measure") and sink is not None and not levels
    return plan_work(mesh, spec, asked, device, keep_frames=sink is None, keep_nodes=keep_nodes, measured=measured)
