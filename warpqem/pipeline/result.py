"""The result of simplifying: the last steps to it from a decimated mesh."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warpqem.arguments.array_record import ArrayRecord
from warpqem.arguments.progress import Progress
from warpqem.decimation.collapse_log import CollapseRecord
from warpqem.decimation.decimate import DecimatedMesh
from warpqem.errors import UnreachableTargetError
from warpqem.frames.device_frames import DeviceSink
from warpqem.frames.stream import ArraySink, FrameSink
from warpqem.mesh.mesh_input import MeshInput
from warpqem.mesh.rounding import rounding_lines
from warpqem.pipeline.memory_plan import MemoryPlan
from warpqem.pipeline.place_frames import Placing, Settling, place_frames, place_refitted
from warpqem.pipeline.prepare import ORDER_END, Prepared
from warpqem.place.place import Placer
from warpqem.repair.mended_mesh import MeshRepair
from warpqem.runtime.device import device_turn

if TYPE_CHECKING:
    import trimesh

    from warpqem.measure.measured import Measured

__all__ = [
    "SimplifiedMesh",
    "finish",
    "in_input_terms",
    "on_result_device",
    "reached",
    "with_frames",
    "without_frames",
    "written_faces",
]


# What is on the device that the points were on.
DEVICE_ARRAYS = ("points", "faces", "vertex_map", "face_map")


@dataclass(frozen=True, eq=False, repr=False)
class SimplifiedMesh(ArrayRecord):
    """What :func:`simplify` returns.

    Where the points were an array on a GPU, and no sink took the frames, ``points``, ``faces``, ``vertex_map`` and
    ``face_map`` are Warp arrays of the same shapes and types there, ready on every stream; see :meth:`numpy`.

    Attributes:
        points: (F, V', 3) float32, in the input's coordinates; where a sink took the frames, the first one, (1, V', 3).
        faces: (N', 3) int32.
        vertex_map: (V,) int32, input vertex to the output vertex it collapsed into; -1 for a vertex without a face. Of
            a vertex that was cut, see ``repair``, that of one sheet of the surface.
        face_map: (N',) int32, the input face that each output face goes on from.
        stopped: "target", "max_error", "max_size_error" or "no legal collapse".
        error: the estimate from the costs of collapses, in % of the bounding-box diagonal: the largest RMS
            distance, among all collapses, of a merged vertex from the planes of the faces it stands for, over key
            frames, or of the input vertices it stands for from the faces around it, in the first one. It is neither a
            bound nor a measured distance; see ``measured``.
        flips: (F,) int32, output faces that face away from the planes they stand for there: an estimate; faces that
            oppose the input are ``measured.flips``.
        log: the collapses, for levels of detail; where the topology was mended, on the vertices of ``repair``.
        key_frames: (K,) int, the frames that decided which edges collapse.
        diagonal: largest bounding-box diagonal of a frame of the input, in its units.
        components_removed: components of the input that were pruned, see ``keep_components``.
        plan: the blocks of frames it was done in, and the memory for it.
        repair: what was mended of the input's topology before, see :mod:`warpqem.repair`; None where it was clean.
        copy_map: (V',) int32, the output vertex of each vertex of ``repair``; None without one.
        refitted: whether the surface was fitted to the input as a whole, see ``refit`` of :func:`warpqem.simplify`.
        measuring: what measures it, see ``measured``; None for nothing.
        rounding: how far single precision moves ``points`` of an input in double precision, at most, in % of
            ``diagonal``; 0 of an input in single precision. Far from the origin that is much: ``notes`` says so.
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
    components_removed: int = 0
    repair: MeshRepair | None = None
    copy_map: np.ndarray | None = None
    refitted: bool = False
    measuring: Callable[[SimplifiedMesh], Measured] | None = field(default=None, repr=False, compare=False)
    rounding: float = 0.0

    def __repr__(self) -> str:
        frames, vertices = self.points.shape[:2]
        return (
            f"SimplifiedMesh({len(self.faces)} faces, {vertices} vertices, {frames} frame{'s' * (frames != 1)}, "
            f"stopped={self.stopped!r}, estimate={self.error:.3g} %)"
        )

    def _repr_png_(self) -> bytes:
        """The picture that a notebook shows: three frames over time, or the mesh from three sides."""
        from warpqem.picture.preview import preview

        here = self.numpy()
        return preview(here.points, here.faces)

    def numpy(self) -> SimplifiedMesh:
        """The same result with all arrays on the host; the result itself where they are."""
        if isinstance(self.points, np.ndarray):
            return self
        with device_turn(self.points.device.alias):
            return replace(self, **{name: getattr(self, name).numpy() for name in DEVICE_ARRAYS})

    @property
    def estimate(self) -> float:
        """The same as ``error``, under the name that says what it is."""
        return self.error

    @functools.cached_property
    def measured(self) -> Measured | None:
        """The measured errors, both ways and over all frames; None where nothing was to be measured.

        Frames in memory are measured when this is first asked for, against the input, which must not have been changed
        since. Those that a sink took were measured on their way.

        Raises:
            DegenerateMeshError: a frame has no extent or no area, so there is nothing to measure by.
        """
        return None if self.measuring is None else self.measuring(self)

    def corner_clusters(self, faces: np.ndarray) -> np.ndarray:
        """(N, 3) int32, the output vertex of each corner of the input's ``faces`` (N, 3), -1 for none."""
        if self.repair is None or self.copy_map is None:
            clusters: np.ndarray = self.numpy().vertex_map[faces]
            return clusters
        return self.repair.corner_clusters(self.copy_map)

    @property
    def notes(self) -> list[str]:
        """What was mended of the input's topology, and what single precision takes of its shape, in words."""
        mended = [] if self.repair is None else self.repair.findings.lines()
        return [*mended, *rounding_lines(self.rounding)]

    def save(self, path: str | os.PathLike[str], numbers: Sequence[int] | None = None, fps: float = 24.0) -> list[str]:
        """Write the frames in ``points``: as one USD file, or as mesh files, which trimesh writes.

        Args:
            path: .usd, .usda, .usdc or .usdz; or .ply, .obj, .stl, .off or .glb, with a row of # for the number of the
                frame where there are several, such as "out/horse_####.ply". Files that are there are replaced.
            numbers: (F,) the number of each frame, such as ``MeshSequence.numbers``; None for 1, 2, ... In a USD file
                they are time codes.
            fps: time codes per second of a USD file.

        Returns:
            The files.

        Raises:
            OptionError: the suffix is another one, or frames have no place in the name.
            MeshFileError, StageError: a file cannot be written.
        """
        from warpqem.mesh_files.saving import save_frames

        here = self.numpy()
        return save_frames(here.points, here.faces, path, numbers, fps)

    def to_trimesh(self, frame: int = 0) -> trimesh.Trimesh:
        """One frame as a ``trimesh.Trimesh``, its vertices and faces in their order."""
        from warpqem.mesh_files.writing import as_trimesh

        here = self.numpy()
        return as_trimesh(here.points[frame], here.faces)


def on_result_device(result: SimplifiedMesh, device: str | None) -> SimplifiedMesh:
    """The result with its arrays on the device; None for the host, where those of ``result`` but its points are."""
    if device is None:
        return result
    arrays = {
        name: wp.array(values, device=device)
        for name in DEVICE_ARRAYS
        if isinstance(values := getattr(result, name), np.ndarray)
    }
    # Copies and launches under way are done when the host goes on: the caller may use the result on any stream, and
    # change or free the input.
    wp.synchronize_device(device)
    return replace(result, **arrays)


def in_input_terms(mesh: MeshInput, vertex_map: np.ndarray) -> dict[str, Any]:
    """The fields of a result that say where the input's vertices went, and how its topology was mended.

    ``vertex_map`` is that of the vertices of ``mesh``.
    """
    if mesh.repair is None:
        return {"vertex_map": vertex_map}
    clusters = mesh.repair.vertex_clusters(vertex_map)
    return {"vertex_map": clusters, "repair": mesh.repair, "copy_map": vertex_map}


def written_faces(mesh: MeshInput, faces: np.ndarray, face_map: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The faces of a result, those on the backs of others included, and the caller's face that each goes on from."""
    if mesh.repair is None:
        return faces, mesh.face_index[face_map]
    return mesh.repair.with_backs(faces, face_map)


def without_frames(work: Prepared, placer: Placer, ordered: DecimatedMesh) -> SimplifiedMesh:
    """The result of decimation with no frame placed yet; nothing of it is on the device.

    ``placer`` is that of ``ordered``.
    """
    log, drops = ordered.log, ordered.drops
    error = max(float(log.error.max(initial=0.0)), float(drops.error.max(initial=0.0)))
    faces, face_map = written_faces(work.mesh, placer.faces, ordered.face_map)
    return SimplifiedMesh(
        points=np.empty((0, placer.vertex_count, 3), dtype=np.float32),
        faces=faces,
        face_map=face_map,
        **in_input_terms(work.mesh, placer.vertex_map),
        stopped=ordered.stopped,
        error=100.0 * error,
        flips=np.empty(0, dtype=np.int32),
        log=log,
        key_frames=work.key_frames,
        diagonal=work.mesh.diagonal,
        plan=work.plan,
        components_removed=len(drops),
        rounding=work.mesh.rounding,
    )


def with_frames(
    result: SimplifiedMesh,
    work: Prepared,
    placer: Placer,
    refit: bool,
    *,
    sink: FrameSink | None = None,
    device: str | None = None,
    progress: Progress | None = None,
    settling: Settling | None = None,
    roughly: bool = False,
) -> SimplifiedMesh:
    """Place all frames, and refit them where that is asked for.

    Args:
        result: what :func:`without_frames` gives.
        work: the mesh.
        placer: what places its frames.
        refit: whether to fit the surface once more.
        sink: takes the frames; None to keep them in an array.
        device: where that array is; None for the host.
        progress: called with the part done and "place".
        settling: decides which vertices a refit leaves as placed; None for those that the refit does.
        roughly: refit roughly, for a look at where the surface is far from the input; flips are not counted.
    """
    mesh, array = work.mesh, ArraySink() if device is None else DeviceSink(device)
    placed = _place_progress(progress, mesh.frame_count)
    refit = refit and not work.place_settings.endpoint and bool(placer.free.any())
    result = replace(result, refitted=refit)
    placing = Placing(mesh, placer, array if sink is None else sink, work.blocks, result.faces, placed)
    if refit:
        on_disk = work.plan.scratch_bytes > 0
        # Errors are single precision: rounding gives the very one that was made a percentage.
        error = float(np.float32(result.error / 100.0))
        last = np.arange(len(result.log))[-1:]
        finished = place_refitted(
            placing,
            key_frames=work.key_frames,
            error=error,
            recent_error=float(result.log.recent_errors_at(last).sum()),
            on_disk=on_disk,
            settling=settling,
            roughly=roughly,
        )
    else:
        finished = place_frames(placing)
    if sink is not None:
        return replace(result, points=finished.first, flips=finished.flips)
    points = array.points if isinstance(array, ArraySink) else array.points.view(wp.float32)
    return on_result_device(replace(result, points=points, flips=finished.flips), device)


def finish(
    work: Prepared,
    ordered: DecimatedMesh,
    refit: bool,
    *,
    sink: FrameSink | None = None,
    device: str | None = None,
    progress: Progress | None = None,
    settling: Settling | None = None,
) -> SimplifiedMesh:
    """The result of a decimated mesh that stays in memory meanwhile: both of the above."""
    placer = work.placer(ordered, refit=refit)
    result = without_frames(work, placer, ordered)
    return with_frames(result, work, placer, refit, sink=sink, device=device, progress=progress, settling=settling)


def reached(result: SimplifiedMesh, target_faces: int) -> SimplifiedMesh:
    """The result itself.

    Raises:
        UnreachableTargetError: it has more faces than the target, if that is not 0, and no collapse is legal.
    """
    if target_faces > 0 and result.stopped == "no legal collapse":
        raise UnreachableTargetError(
            f"{len(result.faces)} faces are left and no edge collapse is legal, {target_faces} were asked for", result
        )
    return result


def _place_progress(progress: Progress | None, frame_count: int) -> Callable[[int], None] | None:
    if progress is None:
        return None
    return lambda done: progress(ORDER_END + (1.0 - ORDER_END) * done / frame_count, "place")
