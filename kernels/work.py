"""How the items of a launch are shared out: in parts between CPU threads, one by one between those of a GPU.

A CPU runs a launch on one thread, so a long one is made of parts that write apart from each other, a thread each. There
is one thread in a part, which walks its items in order. A GPU has a single part and as many threads as keep it busy.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})  # no gradients are taken


@wp.struct
class Work:
    """The share of one launch."""

    part: wp.int32
    part_count: wp.int32
    thread_count: wp.int32  # of the launch: each takes every so many of its part's items


@wp.func
def first_item(item_count: wp.int32, work: Work) -> wp.int32:
    """Where the part's consecutive items begin, among ``item_count``."""
    return wp.int32(wp.int64(item_count) * wp.int64(work.part) / wp.int64(work.part_count))


@wp.func
def last_item(item_count: wp.int32, work: Work) -> wp.int32:
    """Where they end."""
    return wp.int32(wp.int64(item_count) * wp.int64(work.part + 1) / wp.int64(work.part_count))


@wp.struct
class EdgeList:
    """Half-edges on the device, in a segment for each part."""

    count: wp.array[wp.int32]  # (P,)
    half_edge: wp.array[wp.int32]  # those of part p begin at p x capacity
    capacity: wp.int32


@wp.func
def count_before(edges: EdgeList, part: wp.int32) -> wp.int32:
    """Half-edges in the parts before this one."""
    total = wp.int32(0)
    for p in range(part):
        total += edges.count[p]
    return total


@wp.func
def append(edges: EdgeList, part: wp.int32, h: wp.int32):
    """Add a half-edge to a part's segment."""
    edges.half_edge[part * edges.capacity + wp.atomic_add(edges.count, part, 1)] = h
