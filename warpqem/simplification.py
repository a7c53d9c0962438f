"""``warpqem.simplify``: one topology for a whole animation."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from warpqem.attributes import AttributeField, weighted_corner_values
from warpqem.cost_models import CostModelSpec, cost_model, feature_weights
from warpqem.device import resolve_device
from warpqem.errors import OptionError, UnreachableTargetError
from warpqem.frame_blocks import pack_frames
from warpqem.kernels.topology import CORNER, LOCKED, SEAM
from warpqem.key_frames import choose_key_frames
from warpqem.mesh_input import AnimatedMesh, as_numpy, as_vertex_values, read_mesh
from warpqem.order.log import CollapseRecord
from warpqem.order.stage import OrderInput, OrderSettings, order_collapses
from warpqem.place.stage import Placer, PlaceSettings
from warpqem.refit.stage import refit_frames
from warpqem.seams import Seams, read_seams

__all__ = ["SimplifiedMesh", "simplify"]

Progress = Callable[[float, str], None]

# Part of the progress that ordering takes; placing takes the rest.
ORDER_SHARE = 0.7
# Ordering follows the material no more stiffly than this: beyond it the order loses shape and gains no steadiness.
ORDER_EPSILON = 0.05
# Weights above this would leave float32 no room for costs, which then count as forbidden.
MOST_WEIGHT = 1e12


@dataclass(frozen=True)
class SimplifiedMesh:
    """What :func:`simplify` returns.

    Attributes:
        points: (F, V', 3) float32, in the input's coordinates.
        faces: (N', 3) int32.
        vertex_map: (V,) int32, input vertex to the output vertex it collapsed into; -1 for a vertex without a face.
        face_map: (N',) int32, the input face that each output face goes on from.
        stopped: "target", "max_error" or "no legal collapse".
        error: % of the bounding-box diagonal, the largest RMS distance over key frames, among all collapses, of a
            merged vertex from the planes of the faces it stands for.
        flips: (F,) int32, output faces that face away from the input there.
        log: the collapses, for levels of detail.
        key_frames: (K,) int, the frames that decided the order.
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


@dataclass(frozen=True)
class _Goal:
    target_faces: int
    max_error: float  # % of the diagonal


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
    locked: Any = None,
    seams: Any = None,
    attributes: Sequence[AttributeField] = (),
    device: str | None = None,
    progress: Progress | None = None,
) -> SimplifiedMesh:
    """Simplify an animated mesh to one topology that fits all its frames.

    The result is deterministic: the same input gives the same bits on the same device.

    Args:
        points: (F, V, 3) or (V, 3) coordinates in any unit: NumPy, Warp, or anything with the array interface or
            DLPack; or a ``trimesh.Trimesh``, then without ``faces``.
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
        vertex_weights: (V,) factors from 0 to 1e12 on the cost at each vertex.
        locked: (V,) bool, or indices, of vertices that keep their position in every frame.
        seams: (S, 2) vertex pairs: edges that values on the surface do not cross, such as UV seams. They stay closed
            polylines of edges near where they were, with the same ends and forks, as long as the shape has something
            to spare: beyond that the islands between them that cost the shape least are given up.
        attributes: UVs and other values on the surface, each with the weight of its error in the order of collapses;
            see :class:`warpqem.AttributeField`. ``max_error`` and ``SimplifiedMesh.error`` stay errors of the shape.
        device: Warp device; None takes cuda:0 if present, else cpu.
        progress: called with the part done, 0 to 1, and the stage, "order" or "place".

    Raises:
        OptionError: an option outside its range, or options that exclude each other.
        MeshShapeError, NonFinitePointError, FaceIndexError, DegenerateMeshError: see :mod:`warpqem.errors`.
        DeviceError: there is no such device.
        UnreachableTargetError: no legal collapse leads to the face count asked for; its ``result`` is what there is.
    """
    spec = cost_model(metric)
    goal_options = (ratio, target_faces, max_error)
    _check_options(goal_options, coherence, key_frames, placement)
    device = resolve_device(device)
    mesh = read_mesh(points, faces)
    goal = _goal(len(mesh.faces), *goal_options)
    seam = read_seams(seams, mesh.faces, mesh.vertex_count)
    pinned = _lock_mask(locked, mesh.vertex_count)
    weights = _cost_weights(spec, mesh, vertex_weights, device)
    keys = _key_frames(spec, mesh, key_frames)
    endpoint = placement == "endpoint"
    values = weighted_corner_values(attributes, mesh)
    order_input = _order_input(spec, mesh, keys, weights, seam, pinned, values, device)
    ordered = order_collapses(
        order_input,
        OrderSettings(
            target_faces=goal.target_faces,
            error_limit=goal.max_error / 100.0,
            epsilon=min(_epsilon(coherence), ORDER_EPSILON),
            endpoint=endpoint,
            deformation_weight=spec.deformation_weight,
        ),
        device,
        _order_progress(progress, len(mesh.faces), goal.target_faces),
    )
    settings = PlaceSettings(_epsilon(coherence), _regularisation(coherence), endpoint)
    placer = Placer(mesh.faces, ordered, order_input.quadric_scale, pinned, settings, device)
    placed = placer.place_all(mesh, _place_progress(progress, mesh.frame_count))
    if refit and not endpoint and placer.free.any():
        placed = refit_frames(mesh, placer, placed, keys, float(ordered.log.error.max(initial=0.0)), device)
    result = SimplifiedMesh(
        points=placer.original_points(mesh, placed),
        faces=placer.faces,
        vertex_map=placer.vertex_map,
        face_map=mesh.face_index[ordered.face_map],
        stopped=ordered.stopped,
        error=100.0 * float(ordered.log.error.max(initial=0.0)),
        flips=placer.count_flips(placed),
        log=ordered.log,
        key_frames=keys,
    )
    if goal.target_faces > 0 and result.stopped == "no legal collapse":
        raise UnreachableTargetError(
            f"{len(result.faces)} faces are left and no edge collapse is legal, {goal.target_faces} were asked for",
            result,
        )
    return result


def _order_input(
    spec: CostModelSpec,
    mesh: AnimatedMesh,
    keys: np.ndarray,
    weights: np.ndarray,
    seam: Seams,
    pinned: np.ndarray,
    attributes: np.ndarray | None,
    device: str,
) -> OrderInput:
    flags = np.where(pinned, int(LOCKED), 0) | np.where(seam.on_seam, int(SEAM), 0)
    flags |= np.where(seam.corner, int(CORNER), 0)
    return OrderInput(
        faces=mesh.faces,
        key_position=pack_frames(mesh.points[keys], device, centre=mesh.centre, scale=1 / mesh.diagonal),
        key_count=len(keys),
        vertex_flags=flags.astype(np.int32),
        quadric_scale=np.ones(mesh.vertex_count, dtype=np.float32),
        cost_weight=weights,
        seam=seam.half_edge,
        trajectories=mesh.unit_points(slice(None)) if spec.deformation_weight > 0 else None,
        attributes=attributes,
    )


def _epsilon(coherence: float) -> float:
    """Pull towards the anchor: 1e-3, the least that float32 solves safely, at 0; 0.3 at one half; 100 at 1."""
    return 10.0 ** (5.0 * coherence - 3.0)


def _regularisation(coherence: float) -> float:
    """Pull of anchor weights towards equal ones: 0.005 at coherence 0, 0.05 at one half, 0.5 at 1."""
    return 0.005 * 100.0**coherence


def _check_options(
    goal: tuple[float | None, int | None, float | None], coherence: float, key_frames: int | None, placement: str
) -> None:
    ratio, target_faces, max_error = goal
    if ratio is None and target_faces is None and max_error is None:
        raise OptionError("one of ratio, target_faces and max_error is needed")
    if ratio is not None and target_faces is not None:
        raise OptionError(f"ratio {ratio} and target_faces {target_faces} exclude each other")
    if ratio is not None and not 0.0 < ratio <= 1.0:
        raise OptionError(f"ratio must be in (0, 1], got {ratio}")
    if target_faces is not None and not _is_count(target_faces):
        raise OptionError(f"target_faces must be a whole number of at least 1, got {target_faces}")
    if max_error is not None and not 0.0 < max_error < math.inf:
        raise OptionError(f"max_error must be a positive number of % of the diagonal, got {max_error}")
    if not 0.0 <= coherence <= 1.0:
        raise OptionError(f"coherence must be in [0, 1], got {coherence}")
    if key_frames is not None and not _is_count(key_frames):
        raise OptionError(f"key_frames must be a whole number of at least 1, got {key_frames}")
    if placement not in ("optimal", "endpoint"):
        raise OptionError(f"placement must be 'optimal' or 'endpoint', got {placement!r}")


def _is_count(value: float) -> bool:
    return math.isfinite(value) and value == int(value) and value >= 1


def _goal(face_count: int, ratio: float | None, target_faces: int | None, max_error: float | None) -> _Goal:
    """With an error limit alone, ordering goes on until the limit stops it."""
    if ratio is not None:
        target = max(1, round(ratio * face_count))
    else:
        target = 0 if target_faces is None else int(target_faces)
    return _Goal(target, math.inf if max_error is None else max_error)


def _lock_mask(locked: Any, vertex_count: int) -> np.ndarray:
    mask = np.zeros(vertex_count, dtype=bool)
    if locked is None:
        return mask
    array = as_numpy(locked)
    if array.dtype == bool:
        if array.shape != (vertex_count,):
            raise OptionError(f"locked must have one entry for each of {vertex_count} vertices, got {array.shape}")
        return array.copy()
    if array.ndim != 1 or (array.size and array.dtype.kind not in "iu"):
        raise OptionError(f"locked must be (V,) bool or vertex indices, got shape {array.shape} dtype {array.dtype}")
    outside = (array < 0) | (array >= vertex_count)
    if outside.any():
        raise OptionError(f"locked names vertex {array[outside][0]}, but there are {vertex_count} vertices")
    mask[array.astype(np.int64)] = True
    return mask


def _cost_weights(spec: CostModelSpec, mesh: AnimatedMesh, vertex_weights: Any, device: str) -> np.ndarray:
    weights = feature_weights(spec, mesh, device)
    if vertex_weights is None:
        return weights
    own = as_vertex_values(vertex_weights, "vertex_weights", mesh.vertex_count)
    outside = np.flatnonzero((own < 0) | (own > MOST_WEIGHT))
    if len(outside):
        vertex = int(outside[0])
        raise OptionError(
            f"vertex_weights must be in [0, {MOST_WEIGHT:g}], got {own[vertex]} at vertex {vertex}; "
            "use locked for vertices that must not move"
        )
    return weights * own


def _key_frames(spec: CostModelSpec, mesh: AnimatedMesh, key_frames: int | None) -> np.ndarray:
    if spec.single_frame:
        return np.zeros(1, dtype=np.int64)
    points = mesh.points if mesh.used.all() else mesh.points[:, mesh.used]
    return choose_key_frames(points, mesh.frame_count if key_frames is None else int(key_frames))


def _order_progress(progress: Progress | None, face_count: int, target: int) -> Callable[[int], None] | None:
    if progress is None:
        return None
    # The last collapse may take one face more than asked for.
    return lambda live: progress(ORDER_SHARE * min(1.0, (face_count - live) / max(1, face_count - target)), "order")


def _place_progress(progress: Progress | None, frame_count: int) -> Callable[[int], None] | None:
    if progress is None:
        return None
    return lambda done: progress(ORDER_SHARE + (1.0 - ORDER_SHARE) * done / frame_count, "place")
