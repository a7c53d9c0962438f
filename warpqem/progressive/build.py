"""Build a progressive mesh: order once down to the base mesh, then place every vertex that ever was, in all frames."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from warpqem.arguments.array_types import ArrayInput, MeshPoints
from warpqem.arguments.number_input import whole_number
from warpqem.arguments.progress import CancelToken, Progress, ProgressInput, listener, with_progress_bar
from warpqem.decimation.collapse_nodes import NodeRecorder
from warpqem.decimation.replay import OrderedLevels
from warpqem.errors import OptionError
from warpqem.frames.device_frames import to_device
from warpqem.frames.stream import read_ahead
from warpqem.options import MethodKeywords, read_keywords
from warpqem.pipeline.prepare import ORDER_END, Prepared, prepare
from warpqem.pipeline.result import written_faces
from warpqem.place.cluster_parts import ClusterParts
from warpqem.place.clusters import ClusterPlacer
from warpqem.progressive.progressive_mesh import ProgressiveMesh
from warpqem.progressive.vertex_splits import SplitTopology
from warpqem.runtime.device import on_device

if TYPE_CHECKING:
    from typing_extensions import Unpack


__all__ = ["build_progressive"]


# Options of other functions that a progressive mesh has no use for.
REFUSED = frozenset({"ratio", "target_faces", "max_error", "max_distance", "refit", "sink", "share", "keep_components"})


@with_progress_bar
@on_device
def build_progressive(
    points: MeshPoints,
    faces: ArrayInput | None = None,
    *,
    base_faces: int | None = None,
    progress: ProgressInput = None,
    cancel: CancelToken | None = None,
    **options: Unpack[MethodKeywords],
) -> ProgressiveMesh:
    """Every level of an animated mesh from one run (progressive deforming meshes, Huang et al. 2006).

    A vertex of any level is placed over all frames from its own cluster of input vertices, as :func:`warpqem.simplify`
    does, so a level does not depend on how it was reached: it has the faces of the result for its face count with all
    components kept, and with ``quality`` "fast" its bits. Where topology is mended (:mod:`warpqem.repair`),
    its vertices are those of the input, and behind them the copies of those that were cut.

    Args:
        points: as for :func:`warpqem.simplify`.
        faces: likewise.
        base_faces: where to stop; None for as few faces as legal collapses lead to.
        progress: called with the part done, 0 to 1, and the stage, "read", "order" or "place"; True for a bar.
        cancel: as for :func:`warpqem.simplify`.
        options: keyword arguments of :func:`warpqem.simplify`, but for its goals, ``refit``, ``keep_components`` and
            ``sink``. ``quality`` decides the order only: "best" exchanges collapses of a single result and fits its
            surface, but here a vertex has one place in all levels that it is in, by the quadrics that its collapse had.

    Raises:
        OptionError: also for an option that does not apply.
        WarpqemError: the other errors of :func:`warpqem.simplify`, but for an unreachable target: the base mesh then
            has more faces than asked for.

    Examples:
        >>> import numpy as np, trimesh, warpqem
        >>> ball = trimesh.creation.icosphere(subdivisions=3)
        >>> points = np.stack([ball.vertices * (1, 1, 1 + 0.2 * step) for step in range(4)])
        >>> mesh = warpqem.build_progressive(points, ball.faces)
        >>> [len(mesh.level(faces=count).faces) for count in (1000, 300)]
        [1000, 300]
    """
    refused = REFUSED & set(options)
    if refused:
        raise OptionError(f"{', '.join(sorted(refused))}: not with a progressive mesh, which has all levels")
    # A mesh of one face is the least there is.
    target = 1 if base_faces is None else whole_number(base_faces, "base_faces")
    asked = read_keywords(options, target_faces=target, keep_components=True)
    listen = listener(progress, cancel)
    work = prepare(points, faces, asked, keep_nodes=True, progress=listen)
    recorder = NodeRecorder()
    ordered = work.order(listen, recorder)
    levels = OrderedLevels(work.mesh.faces, ordered, recorder)
    mesh = work.mesh
    written, face_index = written_faces(mesh, mesh.faces, np.arange(len(mesh.faces)))
    topology = SplitTopology.from_log(written, face_index, mesh.vertex_count, levels.log)
    return ProgressiveMesh(topology, _place_all(work, levels, topology, listen))


def _place_all(work: Prepared, levels: OrderedLevels, topology: SplitTopology, progress: Progress | None) -> np.ndarray:
    """Positions (F, B + 2 C, 3) float32 of all rows in the caller's coordinates."""
    mesh = work.mesh
    placed = np.empty((mesh.frame_count, len(topology.row_vertex), 3), dtype=np.float32)
    # The row of the vertex that a collapse merged is the one that its split ends.
    row_of_collapse = topology.parent_row[::-1]
    single = np.flatnonzero(topology.row_end == topology.split_count)
    placers = [
        (
            row_of_collapse[merged.collapse],
            ClusterPlacer(
                merged.ordered,
                merged.kept,
                ClusterParts.of(
                    mesh.faces, merged.ordered, merged.cluster, len(merged.kept), work.quadric_scale, work.device
                ),
                work.quadric_scale,
                work.pinned,
                work.place_settings,
                work.device,
                work.quadric_sums,
            ),
        )
        for merged in levels.merged_clusters()
    ]
    for frames, points in read_ahead(mesh.points, work.blocks):
        placed[frames, single] = points[:, topology.row_vertex[single]] + mesh.origin
        on_device = to_device(points, work.device)
        for row, placer in placers:
            placed[frames, row] = placer.place(mesh, on_device).original_points(mesh)
        if progress:
            progress(ORDER_END + (1.0 - ORDER_END) * frames.stop / mesh.frame_count, "place")
    return placed
