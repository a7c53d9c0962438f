"""Memory asked for before it is needed, on a CPU: a hint that changes no result.

What a collapse touches lies wherever its vertex is, so on a mesh larger than the caches each first look at a neighbour
waits for memory, one after the other. A thread that walks a list knows who comes next: it asks for the rows of the
next items while it works on this one. A GPU hides the same waits behind its other threads and needs no hint: where a
part has more than one thread, nothing is done here.
"""

from typing import Any

import warp as wp

from warpqem.kernels.mesh_state import AnyKeyFrames, MeshState
from warpqem.kernels.topology import half_edge_target
from warpqem.kernels.work import EdgeList, Work

wp.set_module_options({"enable_backward": False})  # no gradients are taken

# How many items ahead of its use each link of the chain is asked for: from the half-edge to its ends, to their
# corners, to the faces of these, to the vertices of those. Each needs what the one before has brought.
ENDS_AHEAD = wp.constant(wp.int32(8))
ADJACENCY_AHEAD = wp.constant(wp.int32(6))
LISTS_AHEAD = wp.constant(wp.int32(4))
FACES_AHEAD = wp.constant(wp.int32(2))
RINGS_AHEAD = wp.constant(wp.int32(1))


@wp.func_native("""
#if !defined(__CUDA_ARCH__)
    __builtin_prefetch(&wp::index(values, i));
#endif
""")
def prefetch(values: Any, i: wp.int32):
    """The line of one value."""
    ...


@wp.func_native("""
#if !defined(__CUDA_ARCH__)
    const char* row = reinterpret_cast<const char*>(&wp::index(rows, i, 0));
    __builtin_prefetch(row);
    __builtin_prefetch(row + rows.strides[0] - 1);
#endif
""")
def prefetch_row(rows: Any, i: wp.int32):
    """The first and the last line of a row; those between follow by themselves."""
    ...


@wp.func_native("""
#if !defined(__CUDA_ARCH__)
    __builtin_prefetch(&wp::index(rows, i, j));
#endif
""")
def prefetch_item(rows: Any, i: wp.int32, j: wp.int32):
    """The line of one value of a row."""
    ...


@wp.func
def prefetch_faces(state: MeshState, v: wp.int32):
    """The faces around a vertex."""
    for i in range(state.adjacency.start[v], state.adjacency.end[v]):
        prefetch(state.corner_vertex, state.adjacency.corner[i])


@wp.func
def prefetch_costs(state: MeshState, v: wp.int32):
    """The faces around a vertex and the costs of their edges."""
    for i in range(state.adjacency.start[v], state.adjacency.end[v]):
        prefetch(state.corner_vertex, state.adjacency.corner[i])
        prefetch(state.edge_cost, state.adjacency.corner[i])


@wp.func
def prefetch_ring(state: MeshState, positions: Any, v: wp.int32):
    """Positions of the neighbours of a vertex."""
    for i in range(state.adjacency.start[v], state.adjacency.end[v]):
        prefetch_row(positions, half_edge_target(state.corner_vertex, state.adjacency.corner[i]))


@wp.func
def prefetch_cost_ring(state: MeshState, frames: AnyKeyFrames, v: wp.int32):
    """All that the costs of the edges at a vertex take from its neighbours."""
    for i in range(state.adjacency.start[v], state.adjacency.end[v]):
        w = half_edge_target(state.corner_vertex, state.adjacency.corner[i])
        prefetch(state.vertex_flags, w)
        prefetch(state.cost_weight, w)
        prefetch_row(frames.quadric, w)
        prefetch_row(frames.position, w)


@wp.func
def prefetch_moved(
    state: MeshState, frames: AnyKeyFrames, vertices: wp.array[wp.int32], i: wp.int32, count: wp.int32, work: Work
):
    """What new costs around the vertices that come after the ``i``-th of a list need."""
    if work.thread_count > 1:
        return
    if i + FACES_AHEAD < count:
        prefetch_costs(state, vertices[i + FACES_AHEAD])
    if i + RINGS_AHEAD < count:
        prefetch_cost_ring(state, frames, vertices[i + RINGS_AHEAD])


@wp.func
def prefetch_ends(state: MeshState, frames: AnyKeyFrames, selected: EdgeList, work: Work, k: wp.int32):
    """The rows of the ends of the selected edges that come after the ``k``-th of a part."""
    if work.thread_count > 1:
        return
    first = work.part * selected.capacity
    count = selected.count[work.part]
    if k + ENDS_AHEAD < count:
        prefetch(state.corner_vertex, selected.half_edge[first + k + ENDS_AHEAD])
    if k + LISTS_AHEAD < count:
        for side in range(2):
            v = end_of(state, selected.half_edge[first + k + LISTS_AHEAD], side)
            prefetch(state.vertex_flags, v)
            prefetch_row(frames.position, v)
            prefetch_row(frames.quadric, v)


@wp.func
def prefetch_adjacency(state: MeshState, vertices: wp.array[wp.int32], i: wp.int32, count: wp.int32, work: Work):
    """The corners of the vertices that come after the ``i``-th of a list, and their faces; -1 is passed over."""
    if work.thread_count > 1:
        return
    if i + ADJACENCY_AHEAD < count:
        v = vertices[i + ADJACENCY_AHEAD]
        if v >= 0:
            prefetch(state.adjacency.start, v)
            prefetch(state.adjacency.end, v)
    if i + LISTS_AHEAD < count:
        v = vertices[i + LISTS_AHEAD]
        if v >= 0:
            prefetch(state.adjacency.corner, state.adjacency.start[v])
    if i + FACES_AHEAD < count:
        v = vertices[i + FACES_AHEAD]
        if v >= 0:
            prefetch_faces(state, v)


@wp.func
def prefetch_collapses(state: MeshState, frames: AnyKeyFrames, selected: EdgeList, work: Work, k: wp.int32):
    """What the selected edges that come after the ``k``-th of a part need: ends, faces and positions around them."""
    if work.thread_count > 1:
        return
    first = work.part * selected.capacity
    count = selected.count[work.part]
    if k + ENDS_AHEAD < count:
        prefetch(state.corner_vertex, selected.half_edge[first + k + ENDS_AHEAD])
        prefetch(state.edge_cost, selected.half_edge[first + k + ENDS_AHEAD])
    for side in range(2):
        if k + ADJACENCY_AHEAD < count:
            v = end_of(state, selected.half_edge[first + k + ADJACENCY_AHEAD], side)
            prefetch(state.adjacency.start, v)
            prefetch(state.adjacency.end, v)
        if k + LISTS_AHEAD < count:
            v = end_of(state, selected.half_edge[first + k + LISTS_AHEAD], side)
            prefetch(state.adjacency.corner, state.adjacency.start[v])
        if k + FACES_AHEAD < count:
            v = end_of(state, selected.half_edge[first + k + FACES_AHEAD], side)
            prefetch_faces(state, v)
            prefetch_row(frames.quadric, v)
        if k + RINGS_AHEAD < count:
            prefetch_ring(state, frames.position, end_of(state, selected.half_edge[first + k + RINGS_AHEAD], side))


@wp.func
def end_of(state: MeshState, h: wp.int32, side: wp.int32) -> wp.int32:
    """Where a half-edge begins (side 0) or ends (1)."""
    if side == 0:
        return state.corner_vertex[h]
    return half_edge_target(state.corner_vertex, h)


@wp.func
def prefetch_edges(state: MeshState, edges: EdgeList, part: wp.int32, i: wp.int32, values: Any, work: Work):
    """What the edges that come after the ``i``-th of a part need: ends, cost, and the ``values`` of both ends."""
    if work.thread_count > 1:
        return
    first = part * edges.capacity
    count = edges.count[part]
    if i + ENDS_AHEAD < count:
        h = edges.half_edge[first + i + ENDS_AHEAD]
        prefetch(state.corner_vertex, h)
        prefetch(state.edge_cost, h)
    if i + LISTS_AHEAD < count:
        h = edges.half_edge[first + i + LISTS_AHEAD]
        u = state.corner_vertex[h]
        # A dead edge has no ends.
        if u >= 0:
            prefetch(values, u)
            prefetch(values, half_edge_target(state.corner_vertex, h))
