"""Before decimation: check what the caller gave, plan the memory, look through the frames, and put it on the device."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from warpqem.arguments.number_input import shown
from warpqem.arguments.progress import Progress
from warpqem.costs.attributes import channel_count, weighted_corner_values
from warpqem.costs.models import CostModelSpec, cost_model
from warpqem.costs.motion_features import MotionWatch, MotionWeighting
from warpqem.costs.weights import border_vertices, check_factors, lock_mask, read_quadric_scale, read_weights
from warpqem.decimation.collapse_nodes import NodeRecorder
from warpqem.decimation.decimate import DecimatedMesh, DecimationInput, OrderSettings, order_collapses
from warpqem.decimation.late_parts import without_late_parts
from warpqem.decimation.quadric_sums import QuadricSums
from warpqem.errors import OptionError
from warpqem.frames.blocks import frame_blocks
from warpqem.frames.device_source import DeviceFrames
from warpqem.frames.stream import held_bytes, read_ahead
from warpqem.kernels.topology import CORNER, LOCKED, SEAM
from warpqem.mesh.mesh_input import AnimatedMesh, FrameObserver, MeshInput, measure_mesh, read_mesh
from warpqem.mesh.rounding import warn_of_rounding
from warpqem.mesh.seams import Seams, read_seams
from warpqem.options import Goal, MeshOptions
from warpqem.pipeline.key_frames import KeyFrameChoice
from warpqem.pipeline.memory_plan import MemoryNeeds, MemoryPlan, admit_faces, plan_memory
from warpqem.place.clusters import PlaceSettings
from warpqem.place.place import Placer
from warpqem.place.stiffness import MIN_STIFFNESS, cost_of_coherence
from warpqem.repair.mended_mesh import faces_for, repaired_mesh, repaired_options
from warpqem.repair.mended_topology import look_for_unclean
from warpqem.runtime.device import resolve_device
from warpqem.runtime.thread_limit import limit_threads, worthwhile_threads

__all__ = [
    "ORDER_END",
    "Prepared",
    "QuadricSource",
    "check_metric_options",
    "plan_work",
    "prepare",
    "spare_count",
]

# Makes matrices (V, 3, 3) about the vertices of a mesh of one frame, on the mesh of unit diagonal, from the mesh and
# the scale (V,) of the quadric at each vertex.
QuadricSource = Callable[[AnimatedMesh, np.ndarray], np.ndarray]

# Where reading for the first time and decimation end in the progress; placing takes the rest.
READ_END = 0.05
ORDER_END = 0.7
# Decimation follows the material no more stiffly than this: beyond it the order loses shape and gains no steadiness.
ORDER_EPSILON = 0.05

# So large a part of the faces may be exchanged; where that is fewer than so many faces, nothing is. With a tenth, 11
# cells have as small a largest distance and 0.4 % more RMS.
SPARE, MIN_SPARE = 0.05, 8


@dataclass(frozen=True)
class Prepared:
    """A mesh ready to be decimated and placed.

    Attributes:
        mesh: its faces and frames.
        key_frames: (K,) int, the frames that decide which edges collapse.
        goal: where to stop.
        plan: blocks of frames, and the memory for them.
        pinned: (V,) bool, input vertices that keep their position.
        quadric_scale: (V,) float32, scale of each input vertex's quadric.
        quadric_sums: quadrics of other vertices that count at a vertex too; None for none.
        order_input: the mesh on the device; None where it was decimated and released.
        order_settings: how to decimate.
        place_settings: how to place.
        device: Warp device.
    """

    mesh: AnimatedMesh
    key_frames: np.ndarray
    goal: Goal
    plan: MemoryPlan
    pinned: np.ndarray
    quadric_scale: np.ndarray
    quadric_sums: QuadricSums | None
    order_input: DecimationInput | None
    order_settings: OrderSettings
    place_settings: PlaceSettings
    device: str

    def order(self, progress: Progress | None = None, recorder: NodeRecorder | None = None) -> DecimatedMesh:
        """Collapse edges down to the goal; ``recorder`` keeps every vertex on the way."""
        repair, target = self.mesh.repair, self.goal.target_faces
        if repair is None or not target or not repair.is_double.any():
            return self.order_to(self.order_settings.target_faces, progress, recorder)
        # Far enough also where all faces that are left have a back.
        least = max(1, target // 2)
        if repair.is_double.all():
            return self.order_to(least, progress, recorder)
        coarse = self.order_to(least, progress)
        if coarse.stopped != "target" and repair.count_with_backs(coarse.face_map) > target:
            # As far as it goes, and why it went no further.
            return coarse if recorder is None else self.order_to(least, recorder=recorder)
        return self.order_to(faces_for(coarse, self.mesh, target), recorder=recorder)

    def order_to(
        self, face_count: int, progress: Progress | None = None, recorder: NodeRecorder | None = None
    ) -> DecimatedMesh:
        """Collapse edges down to so many faces, those on the back of others not counted.

        Parts that collapses cannot make small go first where others would be collapsed too far for them, unless the
        order is for other counts, too (with a ``recorder``).
        """
        assert self.order_input is not None
        listener = _order_progress(progress, len(self.mesh.faces), face_count)
        settings = replace(self.order_settings, target_faces=face_count)
        ordered = order_collapses(self.order_input, settings, self.device, listener, recorder)
        if recorder is not None:
            return ordered
        waits = None if progress is None else lambda _: progress(ORDER_END, "order")
        again = partial(order_collapses, self.order_input, settings, self.device, waits, None)
        return without_late_parts(ordered, face_count, again)

    def placer(self, ordered: DecimatedMesh, *, refit: bool = False) -> Placer:
        """What places the vertices that decimation left, to be refitted or not."""
        settings = self.place_settings
        if refit:
            settings = replace(settings, coherence_cost=cost_of_coherence(settings.epsilon))
        return Placer(
            self.mesh.faces,
            ordered,
            self.quadric_scale,
            self.pinned,
            settings,
            self.device,
            self.quadric_sums,
        )

    def without_input(self) -> Prepared:
        """The same without what only decimation needs."""
        return replace(self, order_input=None)

    @property
    def result_device(self) -> str | None:
        """Where the arrays of the result belong: on the device that the points were on; None for the host."""
        return self.mesh.source.device if isinstance(self.mesh.source, DeviceFrames) else None

    @property
    def blocks(self) -> list[slice]:
        """The frames to place at once."""
        return frame_blocks(self.mesh.frame_count, self.mesh.vertex_count, self.plan.block_frames)


def prepare(
    points: Any,
    faces: Any,
    options: MeshOptions,
    *,
    keep_frames: bool = True,
    keep_nodes: bool = False,
    measured: bool = False,
    vertex_flags: np.ndarray | None = None,
    quadrics: QuadricSource | None = None,
    progress: Progress | None = None,
) -> Prepared:
    """Make a mesh ready, with the arguments and errors of :func:`warpqem.simplify`.

    ``keep_frames`` says whether the result stays in memory, ``keep_nodes`` whether every vertex on the way down does,
    ``measured`` whether the result is measured on its way to a sink. ``vertex_flags`` (V,) int32 are kinds of vertices
    that the faces do not show, and ``quadrics`` what is used in place of the quadrics of the faces.
    """
    options = options.checked()
    spec = cost_model(options.metric)
    device = resolve_device(options.device)
    admit = partial(admit_faces, limit=options.memory, device=device)
    read = read_mesh(points, faces, admit, device, look_for_unclean)
    # For all that is done with it in this call, by whatever number of threads: the bits are the same.
    limit_threads(worthwhile_threads(len(read.faces), read.frame_count))
    given = repaired_mesh(read, device)
    options = repaired_options(options, read, given)
    goal = options.goal(len(given.faces))
    planned = plan_work(given, spec, options, device, keep_frames=keep_frames, keep_nodes=keep_nodes, measured=measured)
    seam = read_seams(options.seams, given.faces, given.vertex_count)
    factors, pinned = read_weights(options.vertex_weights, given)
    pinned |= lock_mask(options.locked, given.vertex_count)
    if options.lock_borders:
        pinned |= border_vertices(given)
    scale = read_quadric_scale(options.quadric_scale, given)
    check_metric_options(options, spec)
    sums = None
    if spec.keeps_face:
        sums, kept = _protected_face(given, options)
        pinned |= kept
    values = weighted_corner_values(options.attributes, given)
    mesh, keys, weights = _look_through(given, spec, planned, factors, options.motion, progress, device)
    flags = np.where(pinned, int(LOCKED), 0) | (0 if vertex_flags is None else vertex_flags)
    return Prepared(
        mesh=mesh,
        key_frames=keys,
        goal=goal,
        plan=planned,
        pinned=pinned,
        quadric_scale=scale,
        quadric_sums=sums,
        order_input=_order_input(spec, mesh, keys, weights, scale, sums, seam, flags, values, quadrics, device),
        order_settings=_order_settings(spec, goal, options),
        place_settings=PlaceSettings(
            _epsilon(options.coherence), _regularisation(options.coherence), options.placement == "endpoint"
        ),
        device=device,
    )


def check_metric_options(options: MeshOptions, spec: CostModelSpec) -> None:
    """Refuse options of another cost model, and what is no such option.

    Raises:
        OptionError: there is one.
    """
    if not isinstance(options.motion, MotionWeighting | None):
        raise OptionError(f"motion must be a MotionWeighting or None, got {shown(options.motion)}")
    if options.face is not None and not spec.keeps_face:
        raise OptionError(f"face= needs metric 'face', not {spec.name!r}")
    if options.motion is not None and not spec.uses_motion_features:
        raise OptionError(f"motion= needs a metric that keeps motion features, such as 'aqem', not {spec.name!r}")


def _protected_face(given: MeshInput, options: MeshOptions) -> tuple[QuadricSums, np.ndarray]:
    """Quadrics that count at the feature points of a face, too, and which vertices (V,) stay as these points."""
    from warpqem.face.protect import FaceProtection, protect

    if not isinstance(options.face, FaceProtection | None):
        raise OptionError(f"face must be a FaceProtection or None, got {shown(options.face)}")
    return protect(given, FaceProtection() if options.face is None else options.face)


def _order_settings(spec: CostModelSpec, goal: Goal, options: MeshOptions) -> OrderSettings:
    """How to decimate. Options are in % of the diagonal, these settings in parts of it."""
    return OrderSettings(
        target_faces=goal.target_faces,
        error_limit=goal.max_error / 100.0,
        size_limit=math.inf if options.max_size_error is None else options.max_size_error / 100.0,
        epsilon=min(_epsilon(options.coherence), ORDER_EPSILON),
        endpoint=options.placement == "endpoint",
        deformation_weight=spec.deformation_weight,
        keep_components=options.keep_components,
        memoryless=options.memoryless_orders,
    )


def spare_count(target_faces: int, face_count: int) -> int:
    """How many of the faces asked for may be exchanged, see :mod:`warpqem.pipeline.exchange`; 0 for too few."""
    spare = int(SPARE * target_faces)
    return spare if spare >= MIN_SPARE and target_faces < face_count else 0


def plan_work(
    mesh: MeshInput,
    spec: CostModelSpec,
    options: MeshOptions,
    device: str,
    *,
    keep_frames: bool,
    keep_nodes: bool,
    measured: bool = False,
) -> MemoryPlan:
    """The memory plan for arguments of :func:`prepare`."""
    frame_count, face_count = mesh.frame_count, len(mesh.faces)
    goal = options.goal(face_count)
    used_count = int(mesh.used.sum())
    max_key_frames = 1 if spec.single_frame else options.key_frames
    key_count = frame_count if max_key_frames is None else min(frame_count, int(max_key_frames))
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
            channels=channel_count(options.attributes, mesh),
            trajectories=spec.deformation_weight > 0,
            refit=options.refits,
            exchanges=options.exchanges and not options.bounded and spare_count(goal.target_faces, face_count) > 0,
            keep_frames=keep_frames,
            keep_nodes=keep_nodes,
            memoryless=options.memoryless_orders,
            source_bytes=held_bytes(mesh.source),
            bounded=options.bounded,
            measured=measured,
            frames_there=isinstance(mesh.source, DeviceFrames) and mesh.source.whole is not None,
        ),
        options.memory,
        device,
    )


def _look_through(
    given: MeshInput,
    spec: CostModelSpec,
    planned: MemoryPlan,
    factors: np.ndarray,
    weighting: MotionWeighting | None,
    progress: Progress | None,
    device: str,
) -> tuple[AnimatedMesh, np.ndarray, np.ndarray]:
    """Read all frames once: the mesh's size, its key frames (K,), and the weight of the cost at each vertex (V,)."""
    choice = KeyFrameChoice(given, planned.key_frames)
    motion = MotionWatch(given, device, weighting) if spec.uses_motion_features else None
    observers: list[FrameObserver] = [choice] if motion is None else [choice, motion]
    mesh = measure_mesh(
        given,
        device,
        observers,
        block_frames=planned.block_frames,
        hold=planned.device_frame_bytes > 0,
        progress=_read_progress(progress, given.frame_count),
    )
    warn_of_rounding(mesh.rounding)
    keys = choice.choose()
    if motion is not None:
        factors = motion.features().weight * factors
    if spec.vertex_weight is not None:
        own = spec.vertex_weight(mesh.chosen_points(keys), mesh.faces)
        factors = check_factors(own, mesh.vertex_count, f"metric {spec.name!r}: vertex_weight gave") * factors
    return mesh, keys, factors


def _order_input(
    spec: CostModelSpec,
    mesh: AnimatedMesh,
    keys: np.ndarray,
    weights: np.ndarray,
    scale: np.ndarray,
    sums: QuadricSums | None,
    seam: Seams,
    flags: np.ndarray,
    attributes: np.ndarray | None,
    quadrics: QuadricSource | None,
    device: str,
) -> DecimationInput:
    flags = flags | np.where(seam.on_seam, int(SEAM), 0) | np.where(seam.corner, int(CORNER), 0)
    return DecimationInput(
        faces=mesh.faces,
        key_position=mesh.unit_blocks(keys, device),
        key_count=len(keys),
        vertex_flags=flags.astype(np.int32),
        quadric_scale=scale,
        cost_weight=weights,
        seam=seam.half_edge,
        trajectories=_trajectories(mesh) if spec.deformation_weight > 0 else None,
        attributes=attributes,
        matrices=None if quadrics is None else quadrics(mesh, scale),
        sums=sums,
    )


def _trajectories(mesh: AnimatedMesh) -> np.ndarray:
    """Every frame of every vertex, in diagonals: (V, F, 3) float32, so that a vertex's trajectory is contiguous."""
    trajectories = np.empty((mesh.vertex_count, mesh.frame_count, 3), dtype=np.float32)
    for frames, points in read_ahead(mesh.points, frame_blocks(mesh.frame_count, mesh.vertex_count)):
        trajectories[:, frames] = mesh.to_unit(points).transpose(1, 0, 2)
    return trajectories


def _epsilon(coherence: float) -> float:
    """Regularisation weight towards the anchor: the least there is, 1e-3, at coherence 0; 0.5 at one half; 250 at 1."""
    return MIN_STIFFNESS * 500.0 ** (2.0 * coherence)


def _regularisation(coherence: float) -> float:
    """Regularisation of anchor weights towards equal ones: 0.002 at coherence 0, 0.02 at one half, 0.2 at 1."""
    return 0.002 * 100.0**coherence


def _read_progress(progress: Progress | None, frame_count: int) -> Callable[[int], None] | None:
    if progress is None:
        return None
    return lambda done: progress(READ_END * (done / frame_count), "read")


def _order_progress(progress: Progress | None, face_count: int, target: int) -> Callable[[int], None] | None:
    if progress is None:
        return None
    share = ORDER_END - READ_END
    # The last collapse may take one face more than asked for.
    return lambda live: progress(
        READ_END + share * min(1.0, (face_count - live) / max(1, face_count - target)), "order"
    )
