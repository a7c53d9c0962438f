"""A mesh on a device, ready for the kernels of one pass."""

import numpy as np
import warp as wp

from warpqem.decimation.adjacency import Adjacency, build_adjacency, classify_vertices
from warpqem.decimation.attribute_quadrics import build_wedges
from warpqem.decimation.cluster_vertices import build_members
from warpqem.decimation.constrained_edges import ConstrainedEdges, EdgeMarks
from warpqem.decimation.deformation import build_deformation
from warpqem.decimation.initial_quadrics import initial_quadrics
from warpqem.frames.blocks import pack_frames
from warpqem.kernels.deformation import measure_all_deformation
from warpqem.kernels.lanes import QUADRIC, width_of
from warpqem.kernels.mesh_state import KEY_FRAMES, CollapseLog, CostModel, MeshState
from warpqem.kernels.work import EdgeList, Work


def one_part(device, part=0, part_count=1) -> Work:
    """The whole work in one thread, or one part of it."""
    work = Work()
    work.part, work.part_count, work.thread_count = part, part_count, 1
    return work


def blocks(values, frame_count) -> np.ndarray:
    """(V, F, C) of blocks (V, B) on the device, C components."""
    array = values.numpy()
    return array.transpose(0, 1, 3, 2).reshape(len(array), -1, array.shape[2])[:, :frame_count]


def corners_of(faces, device) -> wp.array:
    """The vertices of all corners (3N,) of faces (N, 3)."""
    return wp.array(np.asarray(faces).ravel(), dtype=wp.int32, device=device)


def listed_edges(corner_vertex, border, seam) -> ConstrainedEdges:
    """The half-edges with a mark (3N,) of either kind."""
    count = wp.zeros(1, dtype=wp.int32, device=corner_vertex.device)
    return EdgeMarks(corner_vertex, border, seam, count).listed(int(count.numpy()[0]))


class DeviceMesh:
    """A mesh on the device: its state, its adjacency, its key frames as the kernels see them and as (V, K, C)."""

    def __init__(self, state: MeshState, adjacency: Adjacency, frames, key_count: int) -> None:
        self.state, self.adjacency, self.frames, self.key_count = state, adjacency, frames, key_count

    @property
    def position(self) -> np.ndarray:
        return blocks(self.frames.position, self.key_count)

    @property
    def quadric(self) -> np.ndarray:
        return blocks(self.frames.quadric, self.key_count)


def packed(points, device) -> wp.array:
    """Blocks of points (F, V, 3)."""
    return pack_frames(np.ascontiguousarray(points, dtype=np.float32), device)


def packed_quadrics(quadrics, like) -> wp.array:
    """Blocks as wide as those of ``like`` of quadrics (V, F, 10)."""
    quadrics = np.asarray(quadrics, dtype=np.float32)
    width = width_of(like)
    filled = np.zeros((len(quadrics), like.shape[1] * width, 10), dtype=np.float32)
    filled[:, : quadrics.shape[1]] = quadrics
    filled = filled.reshape(len(quadrics), -1, width, 10).transpose(0, 1, 3, 2)
    return wp.array(np.ascontiguousarray(filled), dtype=QUADRIC[width], device=like.device)


def build_mesh(
    points, faces, device, locked=(), cost_weight=None, with_trajectory=False, spare=None, chunk_frames=None
) -> DeviceMesh:
    """Points (K, V, 3) or (V, 3), taken as they are, and faces; every frame is a key frame.

    The adjacency pool has room for ``spare`` corners more than the mesh has, by default as many again.
    """
    points = points[None] if points.ndim == 2 else points
    vertex_count = points.shape[1]
    state = MeshState()
    state.face_count = wp.array([len(faces)], dtype=wp.int32, device=device)
    state.corner_vertex = wp.array(faces.ravel(), dtype=wp.int32, device=device)
    adjacency = build_adjacency(
        state.corner_vertex, vertex_count, state.face_count, spare=faces.size if spare is None else spare
    )
    state.adjacency = adjacency.lists
    flags = np.zeros(vertex_count, dtype=np.int32)
    flags[list(locked)] = 2
    state.vertex_flags = wp.array(flags, device=device)
    border = classify_vertices(state.corner_vertex, adjacency, state.vertex_flags)
    position = packed(points, device)
    frames = KEY_FRAMES[width_of(position)]()
    frames.position, frames.input = position, wp.clone(position)
    ones = wp.ones(vertex_count, dtype=wp.float32, device=device)
    state.seam = wp.zeros(faces.size, dtype=wp.int32, device=device)
    edges = listed_edges(state.corner_vertex, border, state.seam)
    frames.quadric = initial_quadrics(state.corner_vertex, adjacency, edges, position, ones)
    weight = np.ones(vertex_count) if cost_weight is None else np.asarray(cost_weight)
    state.cost_weight = wp.array(weight, dtype=wp.float32, device=device)
    state.quadric_scale = wp.full(vertex_count, 1.0, dtype=wp.float32, device=device)
    state.edge_cost = wp.zeros(faces.size, dtype=wp.float32, device=device)
    state.wedges = build_wedges(state.corner_vertex, position, None, len(points))
    state.members = build_members(state.corner_vertex, adjacency, position, len(points))
    trajectories = np.ascontiguousarray(points.transpose(1, 0, 2), dtype=np.float32) if with_trajectory else None
    state.trajectory, state.deformation = build_deformation(trajectories, len(faces), device, chunk_frames)
    if with_trajectory:
        wp.launch(measure_all_deformation, dim=1, inputs=[state, one_part(device)], device=device)
    return DeviceMesh(state, adjacency, frames, len(points))


def state_of_costs(cost, device) -> MeshState:
    """Faces of which nothing is known but the costs at their half-edges, filled up with inf."""
    state = MeshState()
    face_count = -(-len(cost) // 3)
    state.face_count = wp.array([face_count], dtype=wp.int32, device=device)
    filled = np.full(3 * face_count, np.inf, dtype=np.float32)
    filled[: len(cost)] = cost
    state.edge_cost = wp.array(filled, device=device)
    return state


def cost_model(epsilon=0.1, endpoint=False, error_limit=np.inf, deformation_weight=0.0, key_count=1) -> CostModel:
    model = CostModel()
    model.key_count = float(key_count)
    model.epsilon, model.endpoint = epsilon, int(endpoint)
    model.error_limit, model.deformation_weight = error_limit, deformation_weight
    return model


def edge_list(half_edges, device, capacity=None) -> EdgeList:
    """The half-edges as a list on the device."""
    half_edges = np.asarray(half_edges, dtype=np.int32)
    padded = np.zeros(max(1, len(half_edges), capacity or 0), dtype=np.int32)
    padded[: len(half_edges)] = half_edges
    edges = EdgeList()
    edges.count = wp.array([len(half_edges)], dtype=wp.int32, device=device)
    edges.half_edge = wp.array(padded, dtype=wp.int32, device=device)
    edges.capacity = len(padded)
    return edges


def listed(edges: EdgeList) -> np.ndarray:
    return edges.half_edge.numpy()[: int(edges.count.numpy()[0])]


def collapse_log(capacity, device) -> CollapseLog:
    log = CollapseLog()
    log.count = wp.zeros(1, dtype=wp.int32, device=device)
    log.round_count = wp.zeros(1, dtype=wp.int32, device=device)
    for name in ("kept", "removed", "left_opposite", "right_opposite", "faces_removed", "round_index"):
        setattr(log, name, wp.zeros(capacity, dtype=wp.int32, device=device))
    for name in ("cost", "error"):
        setattr(log, name, wp.zeros(capacity, dtype=wp.float32, device=device))
    return log


def half_edge_between(faces, u, v) -> int:
    """Index of the half-edge from ``u`` to ``v``."""
    head = np.roll(faces, -1, axis=1)
    return int(np.flatnonzero((faces.ravel() == u) & (head.ravel() == v))[0])
