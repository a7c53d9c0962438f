"""Decimation: which edges collapse, decided on the key frames. Its result is a topology and a vertex map."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import warp as wp

from warpqem.decimation.adjacency import Adjacency, build_adjacency, classify_vertices
from warpqem.decimation.arrangement import ARRANGED_FACES, Arrangement, arrange
from warpqem.decimation.attribute_quadrics import build_wedges
from warpqem.decimation.cluster_vertices import build_members
from warpqem.decimation.collapse_log import CollapseRecord
from warpqem.decimation.collapse_nodes import NodeRecorder
from warpqem.decimation.component_forest import ComponentForest
from warpqem.decimation.constrained_edges import ConstrainedEdges, EdgeMarks
from warpqem.decimation.deformation import build_deformation
from warpqem.decimation.faces_left import roots_of_faces
from warpqem.decimation.initial_quadrics import constraint_weights, given_quadrics, initial_quadrics
from warpqem.decimation.native_loop import SmallOrderer
from warpqem.decimation.order_readback import OrderReadback
from warpqem.decimation.ordering import Ordering
from warpqem.decimation.pass_steps import PassSteps
from warpqem.decimation.pruning import Components, DropRecord
from warpqem.decimation.quadric_sums import QuadricSums, add_quadric_sums
from warpqem.kernels import attribute as attribute_kernels
from warpqem.kernels.clean_topology import count_non_manifold
from warpqem.kernels.lanes import width_of
from warpqem.kernels.mesh_state import KEY_FRAMES, AnyKeyFrames, CostModel, MeshState
from warpqem.kernels.topology import CORNER, NON_MANIFOLD
from warpqem.runtime import new_arrays
from warpqem.runtime.device import device_traits
from warpqem.runtime.launches import launch
from warpqem.runtime.readback import read_together

__all__ = ["DecimatedMesh", "DecimationInput", "OrderSettings", "order_collapses"]

# So many half-edges of borders and seams come to the host along with their number.
FEW_EDGES = 128


@dataclass(frozen=True)
class OrderSettings:
    """What decides the order.

    Attributes:
        target_faces: stop at so many faces.
        error_limit: RMS error in diagonals above which no edge collapses; inf for none.
        epsilon: regularisation of a merged vertex towards the material anchor of its edge, relative to the quadric.
        endpoint: the merged vertex goes to one of the edge's ends.
        deformation_weight: factor of the edge-length deformation term; 0 for none.
        keep_components: none is pruned.
        memoryless: quadrics are those of the present faces instead of the input's.
        size_limit: the same as ``error_limit``, of a mesh that is not to be destroyed for its target; where components
            are pruned because their cost is due, it does not count.
    """

    target_faces: int
    error_limit: float
    epsilon: float
    endpoint: bool
    deformation_weight: float
    keep_components: bool = True
    memoryless: bool = False
    size_limit: float = math.inf


@dataclass(frozen=True)
class DecimatedMesh:
    """The topology that ordering left, and what placement needs of it (V input vertices, B blocks of key frames).

    Attributes:
        faces: (N', 3) int32 over input vertices: each cluster goes by the vertex that was kept.
        face_map: (N',) int32, the input face that each of them was.
        root: (V,) int32, the kept vertex that each input vertex collapsed into.
        key_position: (V, B) points, the input on the key frames, in diagonals.
        key_count: key frames.
        row: (V,) int32, the row that each input vertex has in ``position`` and ``quadric``.
        position: (V, B) points, where ordering put the kept vertices.
        quadric: (V, B) quadric of each kept vertex's cluster, about ``position``; that of the first key frame holds the
            attribute error too.
        constrained: (3N,) int8, 1 at the input's border half-edges, 2 at its seams'.
        line_rank: (V,) int, of input vertices: 2 at corners of seams, 1 elsewhere on a seam or border, 0 inside.
        non_manifold: (V,) bool, input vertices whose faces are not one fan; they keep their position.
        face_order: (N,) int32, the input face at each place of the order that faces had; None for the input's.
        stopped: "target", "max_error", "max_size_error" or "no legal collapse".
        log: the collapses.
        drops: the pruned components.
    """

    faces: np.ndarray
    face_map: np.ndarray
    root: np.ndarray
    key_position: wp.array
    key_count: int
    row: np.ndarray
    position: wp.array
    quadric: wp.array
    constrained: np.ndarray
    line_rank: np.ndarray
    non_manifold: np.ndarray
    face_order: np.ndarray | None
    stopped: str
    log: CollapseRecord
    drops: DropRecord


@dataclass(frozen=True)
class DecimationInput:
    """A mesh on the device's scale: positions in diagonals, per-vertex values as in :class:`MeshState`."""

    faces: np.ndarray  # (N, 3) int32
    key_position: wp.array  # (V, B) blocks of points, in diagonals
    key_count: int
    vertex_flags: np.ndarray  # (V,) int32
    quadric_scale: np.ndarray  # (V,) float32
    cost_weight: np.ndarray  # (V,) float32
    seam: np.ndarray  # (3N,) int32, 1 at both half-edges of a seam edge
    trajectories: np.ndarray | None  # (V, F, 3) float32, in diagonals, only with a deformation term
    attributes: np.ndarray | None  # (N, 3, C) float64 at the corners, times their weights; None for none
    matrices: np.ndarray | None = (
        None  # (V, 3, 3), of one key frame: quadrics about the vertices in place of the faces'
    )
    sums: QuadricSums | None = None  # quadrics of other vertices that count at a vertex too


def order_collapses(
    mesh: DecimationInput,
    settings: OrderSettings,
    device: str,
    progress: Callable[[int], None] | None = None,
    recorder: NodeRecorder | None = None,
    gone: np.ndarray | None = None,
) -> DecimatedMesh:
    """Collapse edges down to the target.

    ``progress`` is called with the live face count after each pass; ``recorder`` keeps every vertex on the way. The
    components of ``gone`` (V,) bool are pruned first.
    """
    vertex_count = len(mesh.vertex_flags)
    corner_vertex = new_arrays.uploaded(mesh.faces.ravel(), dtype=wp.int32, device=device)
    arrangement = arrange(corner_vertex, mesh.key_position) if len(mesh.faces) >= ARRANGED_FACES else None
    state, frames, adjacency, kinds = _on_device(mesh, corner_vertex, arrangement, settings, device)
    edges, non_manifold = kinds.edges, kinds.non_manifold
    seam_weight = constraint_weights(edges.seam_count, len(mesh.faces))[2]
    steps = PassSteps(state, frames, adjacency, _cost_model(mesh, settings), device, settings.memoryless, seam_weight)
    if gone is not None and arrangement is not None:
        gone = gone[arrangement.host_vertex]
    left = OrderReadback(steps, mesh.faces, corner_vertex, arrangement)
    orderer = _new_ordering(steps)
    if math.isinf(settings.error_limit) and math.isinf(settings.size_limit) and kinds.forest is None:
        orderer.along = partial(left.ahead, settings.target_faces, len(edges.half_edge))
    stopped, drops = _collapse(orderer, settings, kinds.forest, gone, progress, recorder)
    count, face_count, brought = orderer.collapse_count(), orderer.live_faces, orderer.brought
    if mesh.attributes is not None:
        add_attributes = attribute_kernels.add_attribute_quadrics[width_of(frames.quadric)]
        launch(add_attributes, len(frames.quadric), [state.wedges.quadric], [frames.quadric], device=device)
    # What follows needs their memory.
    del state, adjacency, steps, kinds, orderer
    if arrangement is not None and len(drops):
        drops = drops.for_vertices(arrangement.host_vertex)
    log, root, face_map = left.read(count, face_count, drops, brought)
    row = np.arange(vertex_count, dtype=np.int32) if arrangement is None else arrangement.host_place
    if arrangement is not None and len(edges.half_edge):
        edges = edges.renumbered(arrangement.restore_half_edges(edges.half_edge), arrangement.host_vertex)
    return DecimatedMesh(
        faces=roots_of_faces(mesh.faces, face_map, root),
        face_map=face_map,
        root=root,
        key_position=mesh.key_position,
        key_count=mesh.key_count,
        row=row,
        position=frames.position,
        quadric=frames.quadric,
        constrained=edges.marks(mesh.faces.size),
        line_rank=_line_rank(mesh.vertex_flags, edges),
        non_manifold=non_manifold[row] if non_manifold.any() else non_manifold,
        face_order=None if arrangement is None else arrangement.host_face,
        stopped=stopped,
        log=log,
        drops=drops,
    )


def _collapse(
    orderer: Ordering,
    settings: OrderSettings,
    forest: ComponentForest | None,
    gone: np.ndarray | None,
    progress: Callable[[int], None] | None,
    recorder: NodeRecorder | None,
) -> tuple[str, DropRecord]:
    """Collapse edges: why it stopped, and the pruned components. The rows of the key frames move along."""
    steps, state = orderer.steps, orderer.state
    lowest_limit = min(settings.error_limit, settings.size_limit)
    components = None
    if forest is not None:
        limits = settings.error_limit**2, lowest_limit**2
        components = Components(forest, state, steps.frames.position, int(steps.model.key_count), *limits, gone)
    if recorder is not None:
        recorder.begin(settings.memoryless)
    stopped = orderer.run(settings.target_faces, progress, recorder, components)
    if stopped == "max_error" and settings.size_limit < settings.error_limit:
        stopped = "max_size_error"
    vertex_count = len(state.vertex_flags)
    drops = DropRecord.none(vertex_count) if components is None else components.record(orderer.drops)
    return stopped, drops


def _on_device(
    mesh: DecimationInput,
    input_corners: wp.array,
    arrangement: Arrangement | None,
    settings: OrderSettings,
    device: str,
) -> tuple[MeshState, AnyKeyFrames, Adjacency, _Kinds]:
    """The mesh as kernels see it, rearranged or a copy."""
    state, frames = MeshState(), KEY_FRAMES[width_of(mesh.key_position)]()
    if arrangement is None:
        corner_vertex, frames.input = new_arrays.clone(input_corners), mesh.key_position
    else:
        corner_vertex = arrangement.rearrange_faces(input_corners)
        frames.input = arrangement.rearrange_rows(mesh.key_position)
    frames.position = new_arrays.clone(frames.input)

    def of_vertices(values: np.ndarray, dtype: type) -> wp.array:
        uploaded = new_arrays.uploaded(values, dtype=dtype, device=device)
        return uploaded if arrangement is None else arrangement.rearrange_vertices(uploaded)

    state.face_count = new_arrays.uploaded([len(mesh.faces)], dtype=wp.int32, device=device)
    adjacency = build_adjacency(corner_vertex, len(mesh.vertex_flags), state.face_count, spare=len(corner_vertex))
    state.corner_vertex, state.adjacency = corner_vertex, adjacency.lists
    state.vertex_flags = of_vertices(mesh.vertex_flags, wp.int32)
    state.quadric_scale = of_vertices(mesh.quadric_scale, wp.float32)
    state.cost_weight = of_vertices(mesh.cost_weight, wp.float32)
    state.seam = _seam_marks(mesh.seam, arrangement, device)
    border = classify_vertices(corner_vertex, adjacency, state.vertex_flags)
    kinds = _find_kinds(state, border, settings.keep_components)
    options = mesh if arrangement is None else _rearranged_options(mesh, arrangement)
    if options.matrices is None:
        frames.quadric = initial_quadrics(corner_vertex, adjacency, kinds.edges, frames.position, state.quadric_scale)
    else:
        frames.quadric = given_quadrics(options.matrices, device)
    if options.sums is not None:
        _add_sums(options.sums, state, frames, settings.memoryless)
    state.edge_cost = new_arrays.empty(len(corner_vertex), dtype=wp.float32, device=device)
    state.trajectory, state.deformation = build_deformation(options.trajectories, len(mesh.faces), device)
    state.wedges = build_wedges(corner_vertex, frames.position, options.attributes, mesh.key_count)
    state.members = build_members(corner_vertex, adjacency, frames.position, mesh.key_count)
    return state, frames, adjacency, kinds


@dataclass(frozen=True)
class _Kinds:
    """What the topology shows of a mesh (V vertices), as the device numbers it."""

    edges: ConstrainedEdges
    non_manifold: np.ndarray  # (V,) bool
    forest: ComponentForest | None  # None for a single component, or where they do not matter


def _find_kinds(state: MeshState, border: wp.array, keep_components: bool) -> _Kinds:
    """Look for edges of borders and seams, non-manifold vertices and components: the host waits once for the counts."""
    device, flags = border.device, state.vertex_flags
    counts = new_arrays.zeros(3, dtype=wp.int32, device=device)
    edges, components, others = (new_arrays.part(counts, place, place + 1) for place in range(3))
    marks = EdgeMarks(state.corner_vertex, border, state.seam, edges)
    forest = None if keep_components else ComponentForest(state.corner_vertex, state.adjacency, components)
    launch(count_non_manifold, len(flags), [flags], [others], device=device)
    # The first ones come along: most meshes have few.
    brought, *known = read_together(
        counts, *([marks.first(FEW_EDGES)] if device_traits(str(device)).own_memory else [])
    )
    edge_count, component_count, non_manifold_count = brought.tolist()
    non_manifold = np.zeros(len(flags), dtype=bool)
    if non_manifold_count:
        non_manifold = (flags.numpy() & int(NON_MANIFOLD)) != 0
    # One component always stays.
    return _Kinds(marks.listed(edge_count, *known), non_manifold, forest if component_count > 1 else None)


def _seam_marks(seam: np.ndarray, arrangement: Arrangement | None, device: str) -> wp.array:
    """(3N,) int32, 1 at both half-edges of a seam edge."""
    if not seam.any():
        return new_arrays.zeros(len(seam), dtype=wp.int32, device=device)
    marks = new_arrays.uploaded(seam, dtype=wp.int32, device=device)
    return marks if arrangement is None else arrangement.rearrange_corners(marks)


def _rearranged_options(mesh: DecimationInput, arrangement: Arrangement) -> DecimationInput:
    """What single options ask for, rearranged; the rest as it is."""
    return replace(
        mesh,
        trajectories=None if mesh.trajectories is None else mesh.trajectories[arrangement.host_vertex],
        attributes=None if mesh.attributes is None else mesh.attributes[arrangement.host_face],
        matrices=None if mesh.matrices is None else mesh.matrices[arrangement.host_vertex],
        sums=None if mesh.sums is None else mesh.sums.renumbered(arrangement.host_place),
    )


def _add_sums(sums: QuadricSums, state: MeshState, frames: AnyKeyFrames, memoryless: bool) -> None:
    """Add quadrics of other vertices, and keep them where quadrics are made anew."""
    added = add_quadric_sums(sums, frames.position, frames.quadric)
    if memoryless:
        rows = np.full(len(frames.position), -1, dtype=np.int32)
        rows[sums.row] = np.arange(len(sums.row))
        state.sum_row, frames.kept_sum = wp.array(rows, device=frames.position.device), added


def _cost_model(mesh: DecimationInput, settings: OrderSettings) -> CostModel:
    model = CostModel()
    model.key_count = float(mesh.key_count)
    model.epsilon = settings.epsilon
    model.endpoint = int(settings.endpoint)
    model.error_limit = min(settings.error_limit, settings.size_limit) ** 2
    # The term sums over all frames, the quadrics over the key frames: brought to the same number of frames.
    frame_count = 1 if mesh.trajectories is None else mesh.trajectories.shape[1]
    model.deformation_weight = settings.deformation_weight * mesh.key_count / frame_count
    return model


def _new_ordering(steps: PassSteps) -> Ordering:
    """The loop for a kind of device: a GPU waits too long for the host, and a CPU for dead faces."""
    if not device_traits(steps.device).captures:
        return SmallOrderer(steps)
    # Its kernels take a while to load, and a CPU has no use for them.
    from warpqem.decimation.device_loop import DeviceOrderer

    return DeviceOrderer(steps)


def _line_rank(vertex_flags: np.ndarray, edges: ConstrainedEdges) -> np.ndarray:
    """(V,) int32: 2 at corners of seams, 1 at other ends of edges of borders and seams, 0 elsewhere."""
    rank = np.zeros(len(vertex_flags), dtype=np.int32)
    rank[edges.ends] = 1
    rank[(vertex_flags & int(CORNER)) != 0] = 2
    return rank
