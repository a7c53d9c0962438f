"""Connected components of a mesh: the lowest vertex of each.

A forest in which every vertex points to one of its component that is no higher: each face joins the trees of its
corners, the higher root below the lower one, by a compare-and-swap that fails where another thread was there before.
Whatever the order of the threads, the root of a tree is its lowest vertex in the end. (Jaiganesh and Burtscher, "A
High-Performance Connected Components Implementation for GPUs", HPDC 2018.)
"""

import warp as wp

from warpqem.kernels.topology import VertexAdjacency
from warpqem.kernels.work import Work

wp.set_module_options({"enable_backward": False})  # no gradients are taken


@wp.func
def find_root(parent: wp.array[wp.int32], v: wp.int32) -> wp.int32:
    """The root of a vertex's tree. Vertices on the way come to point past their parents; others may do that, too."""
    before = wp.int32(v)
    at = parent[v]
    above = parent[at]
    while above < at:
        parent[before] = above
        before = at
        at = above
        above = parent[at]
    return at


@wp.func
def join_trees(parent: wp.array[wp.int32], a: wp.int32, b: wp.int32):
    """Make the trees of two vertices one."""
    low = find_root(parent, a)
    high = find_root(parent, b)
    while low != high:
        if high < low:
            swapped = wp.int32(high)
            high = low
            low = swapped
        found = wp.atomic_cas(parent, high, high, low)
        # Joined, or no root any more: then what it points to has to be joined.
        high = wp.where(found == high, low, found)


@wp.kernel
def begin_trees(
    # out
    parent_out: wp.array[wp.int32],
):
    """Every vertex is a tree of its own."""
    v = wp.tid()
    parent_out[v] = v


@wp.kernel
def join_faces(
    # in
    corner_vertex_in: wp.array[wp.int32],
    # in and out
    parent: wp.array[wp.int32],
):
    """Join the trees of each face's corners."""
    h = 3 * wp.tid()
    join_trees(parent, corner_vertex_in[h], corner_vertex_in[h + 1])
    join_trees(parent, corner_vertex_in[h + 1], corner_vertex_in[h + 2])


@wp.kernel
def close_trees(
    # in
    adjacency_in: VertexAdjacency,
    # in and out
    parent: wp.array[wp.int32],
    component_count: wp.array[wp.int32],
    # out
    is_root_out: wp.array[wp.int32],
):
    """Let every vertex point to its root, and count the roots that have a face (from zero)."""
    v = wp.tid()
    # No vertex but this one may come to point elsewhere: its own thread may have been there.
    root = parent[v]
    while parent[root] < root:
        root = parent[root]
    parent[v] = root
    is_root_out[v] = wp.where(root == v, 1, 0)
    if root == v and adjacency_in.start[v] < adjacency_in.end[v]:
        wp.atomic_add(component_count, 0, 1)


@wp.kernel
def number_components(
    # in
    root_in: wp.array[wp.int32],
    roots_before_in: wp.array[wp.int32],
    # out
    component_out: wp.array[wp.int32],
):
    """The component of each vertex: how many roots there are before its own."""
    v = wp.tid()
    component_out[v] = roots_before_in[root_in[v]]


@wp.kernel
def list_component_faces(
    # in
    corner_vertex_in: wp.array[wp.int32],
    face_count_in: wp.array[wp.int32],
    component_in: wp.array[wp.int32],
    is_chosen_in: wp.array[wp.int32],
    work: Work,
    # in and out
    listed: wp.array[wp.int32],
    # out
    face_out: wp.array[wp.vec3i],
):
    """List the live faces of the components (C,) that are chosen, in no order; ``listed`` counts them from zero."""
    for f in range(wp.tid(), face_count_in[0], work.thread_count):
        v = corner_vertex_in[3 * f]
        if v >= 0 and is_chosen_in[component_in[v]] != 0:
            i = wp.atomic_add(listed, 0, 1)
            face_out[i] = wp.vec3i(v, corner_vertex_in[3 * f + 1], corner_vertex_in[3 * f + 2])
