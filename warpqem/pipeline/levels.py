"""Levels of detail from one decimation. They nest, up to the few collapses that each exchanges with a refit."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from warpqem.arguments.array_types import ArrayInput, MeshPoints
from warpqem.arguments.number_input import flag, shown, whole_number
from warpqem.arguments.progress import CancelToken, Progress, ProgressInput, listener, with_progress_bar
from warpqem.decimation.collapse_log import CollapseRecord
from warpqem.decimation.collapse_nodes import NodeRecorder
from warpqem.decimation.decimate import DecimatedMesh
from warpqem.decimation.replay import OrderedLevels
from warpqem.errors import OptionError, UnreachableTargetError
from warpqem.frames.checked_frames import check_sink
from warpqem.frames.stream import FrameSink
from warpqem.mesh.mesh_input import read_mesh
from warpqem.options import LevelKeywords, MeshOptions, check_ratio, read_keywords, target_count
from warpqem.pipeline.exchange import exchanged, order_with_spare, spare_faces
from warpqem.pipeline.measure_result import ResultMeasure
from warpqem.pipeline.memory_plan import admit_faces
from warpqem.pipeline.prepare import ORDER_END, Prepared, prepare
from warpqem.pipeline.result import SimplifiedMesh, finish, reached
from warpqem.repair.mended_mesh import faces_for
from warpqem.runtime.device import array_device, device_turn, on_device, resolve_device
from warpqem.runtime.thread_limit import limit_threads, thread_scope, worthwhile_threads

if TYPE_CHECKING:
    from typing_extensions import Unpack


__all__ = ["LevelOrder", "order_levels", "simplify_levels"]


class LevelOrder:
    """A mesh whose edges were collapsed once, and whose levels are placed one by one.

    Made by :func:`order_levels`.
    """

    def __init__(self, work: Prepared, options: MeshOptions, progress: Progress | None) -> None:
        self._options, recorder = options, NodeRecorder()
        self._ordered = (order_with_spare if options.exchanges else Prepared.order)(work, progress, recorder)
        self._levels = OrderedLevels(work.mesh.faces, self._ordered, recorder)
        self._least, self._work = work.goal.target_faces, work.without_input()

    def __repr__(self) -> str:
        frames = self._work.mesh.frame_count
        return f"LevelOrder({self._least} to {self.face_count} faces, {frames} frame{'s' * (frames != 1)})"

    @property
    def face_count(self) -> int:
        """Faces of the input, without those that name a vertex twice or repeat another."""
        repair, count = self._work.mesh.repair, len(self._work.mesh.faces)
        return count if repair is None else repair.count_with_backs(np.arange(count))

    @property
    def log(self) -> CollapseRecord:
        """All collapses down to the coarsest level."""
        return self._levels.log

    @property
    def diagonal(self) -> float:
        """Largest bounding-box diagonal of a frame of the input, in its units."""
        return self._work.mesh.diagonal

    @property
    def key_frames(self) -> np.ndarray:
        """(K,) int, the frames that decided which edges collapse."""
        return self._work.key_frames

    @property
    def held_bytes(self) -> int:
        """What it keeps in memory for its levels, without the frames."""
        return self._levels.held_bytes

    @with_progress_bar
    def level(
        self,
        target_faces: int,
        *,
        sink: FrameSink | None = None,
        progress: ProgressInput = None,
        cancel: CancelToken | None = None,
    ) -> SimplifiedMesh:
        """What :func:`warpqem.simplify` gives for so many faces, to the bit, unless that orders the mesh again.

        It does where a part of many faces, which collapses cannot make small, had to go at last. Levels share one
        order, and those after it may then have far fewer faces than asked for.

        Args:
            target_faces: at least as many as were asked for at first, where decimation ended.
            sink: takes the frames of the result, block by block, in place of an array; the result is not measured then.
            progress: called with the part done, 0 to 1, and the stage "place"; True for a bar.
            cancel: as for :func:`warpqem.simplify`.

        Raises:
            OptionError: fewer faces than decimation went down to, or an argument of the wrong type.
            UnreachableTargetError: no legal collapse leads to it; its ``result`` is what there is.
            CancelledError: ``cancel`` was set.
        """
        expected = f"a whole number of at least {self._least}, which edges were collapsed down to"
        target_faces = whole_number(target_faces, "target_faces", least=self._least, expected=expected)
        check_sink(sink)
        listen = listener(progress, cancel)
        with thread_scope(), device_turn(self._work.device):
            limit_threads(worthwhile_threads(len(self._work.mesh.faces), self._work.mesh.frame_count))
            ordered = self._level_of(self._base_faces(target_faces), listen)
            device = self._work.result_device if sink is None else None
            result = finish(self._work, ordered, self._options.refits, sink=sink, device=device, progress=listen)
        if len(result.faces) <= target_faces:
            # No matter what ended the order there.
            result = replace(result, stopped="target")
        result = replace(result, log=result.log.made())
        if sink is None:
            result = replace(result, measuring=ResultMeasure.of(self._work.mesh, self._work.device))
        return reached(result, target_faces)

    def _level_of(self, face_count: int, progress: Progress | None) -> DecimatedMesh:
        """The mesh with so many faces, those on the back of others not counted."""
        levels, work = self._levels, self._work
        if not self._options.exchanges:
            return levels.at(levels.steps_to(face_count))
        return exchanged(work, levels.at(levels.steps_to(spare_faces(work, face_count))), face_count, progress)

    def _base_faces(self, target_faces: int) -> int:
        """The faces to decimate down to, so that with those on their backs there are so many."""
        mesh = self._work.mesh
        if mesh.repair is None or not mesh.repair.is_double.any():
            return target_faces
        return faces_for(self._ordered, mesh, target_faces)


@with_progress_bar
@on_device
def order_levels(
    points: MeshPoints,
    faces: ArrayInput | None = None,
    *,
    target_faces: int,
    keep_frames: bool = True,
    progress: ProgressInput = None,
    cancel: CancelToken | None = None,
    **options: Unpack[LevelKeywords],
) -> LevelOrder:
    """Collapse the edges of an animated mesh down to its coarsest level.

    Args:
        points: as for :func:`warpqem.simplify`.
        faces: likewise.
        target_faces: faces of the coarsest level.
        keep_frames: plan memory for the frames of one level; not where all levels are to have a sink.
        progress: called with the part done, 0 to 1, and the stage, "read" or "order"; True for a bar.
        cancel: as for :func:`warpqem.simplify`.
        options: other keyword arguments of :func:`warpqem.simplify`, but for its goals and ``sink``.

    Raises:
        OptionError: also for an option that does not apply.
        WarpqemError: the other errors of :func:`warpqem.simplify`, but for an unreachable target.

    Examples:
        Levels of one order, at any count down to the coarsest:

        >>> import numpy as np, trimesh, warpqem
        >>> ball = trimesh.creation.icosphere(subdivisions=3)
        >>> points = np.stack([ball.vertices * (1, 1, 1 + 0.2 * step) for step in range(4)])
        >>> order = warpqem.order_levels(points, ball.faces, target_faces=100)
        >>> [len(order.level(count).faces) for count in (640, 100)]
        [640, 100]
    """
    refused = {"ratio", "max_error", "sink"} & set(options)
    if refused:
        raise OptionError(f"{', '.join(sorted(refused))}: not with levels")
    asked = read_keywords(options, target_faces=target_faces)
    keep_frames = flag(keep_frames, "keep_frames")
    listen = listener(progress, cancel)
    work = prepare(points, faces, asked, keep_frames=keep_frames, keep_nodes=True, progress=listen)
    return LevelOrder(work, asked, listen)


@with_progress_bar
@on_device
def simplify_levels(
    points: MeshPoints,
    faces: ArrayInput | None = None,
    *,
    ratios: Sequence[float],
    progress: ProgressInput = None,
    cancel: CancelToken | None = None,
    **options: Unpack[LevelKeywords],
) -> list[SimplifiedMesh]:
    """Simplify an animated mesh to several levels that nest: edges are collapsed once, each level is placed on its own.

    Every level has the bits of :func:`simplify` with its ratio, unless that orders the mesh again, see
    :meth:`LevelOrder.level`. Where no legal collapse leads to a level, it is the
    coarsest mesh there is, and its ``stopped`` says so. For any level at all see :func:`warpqem.build_progressive`.

    Args:
        points: as for :func:`simplify`.
        faces: likewise.
        ratios: part of the faces that each level keeps, in (0, 1].
        progress: called with the part done, 0 to 1, and the stage, "read", "order" or "place"; True for a bar.
        cancel: as for :func:`simplify`.
        options: other keyword arguments of :func:`simplify`, but for its goals and ``sink``.

    Raises:
        OptionError: also where there is no ratio, or an option that does not apply.
        WarpqemError: the other errors of :func:`simplify`, but for an unreachable target.

    Examples:
        >>> import numpy as np, trimesh, warpqem
        >>> ball = trimesh.creation.icosphere(subdivisions=3)
        >>> points = np.stack([ball.vertices * (1, 1, 1 + 0.2 * step) for step in range(4)])
        >>> levels = warpqem.simplify_levels(points, ball.faces, ratios=(0.5, 0.25, 0.1))
        >>> [len(level.faces) for level in levels]
        [640, 320, 128]
    """
    parts = _checked_ratios(ratios)
    if "target_faces" in options:
        raise OptionError("target_faces: not with ratios")
    listen = listener(progress, cancel)
    device = resolve_device(options.get("device"))
    there = None if array_device(points) is None else device
    mesh = read_mesh(points, faces, partial(admit_faces, limit=options.get("memory"), device=device), there)
    targets = [target_count(ratio, len(mesh.faces)) for ratio in parts]
    order = order_levels(mesh, target_faces=min(targets), progress=listen, **options)
    results = []
    for index, target in enumerate(targets):
        part = None if listen is None else _part_of(listen, index, len(parts))
        try:
            results.append(order.level(target, progress=part))
        except UnreachableTargetError as error:
            if error.result is None:
                raise
            results.append(error.result)
    return results


def _checked_ratios(ratios: Any) -> list[float]:
    # Text is a sequence too, of its letters.
    if isinstance(ratios, str) or not isinstance(ratios, Iterable):
        raise OptionError(f"ratios must be a list of numbers, got {shown(ratios)}")
    parts = [check_ratio(ratio) for ratio in ratios]
    if not parts:
        raise OptionError("levels need ratios")
    return parts


def _part_of(progress: Progress, index: int, count: int) -> Progress:
    """The progress of placing one of several levels."""

    def part(fraction: float, stage: str) -> None:
        done = (index + (fraction - ORDER_END) / (1.0 - ORDER_END)) / count
        progress(ORDER_END + (1.0 - ORDER_END) * done, stage)

    return part
