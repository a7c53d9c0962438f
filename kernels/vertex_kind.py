"""Vertex kinds: which may collapse into which, and which end a collapse keeps.

The kind of a vertex follows from its flags, and the kinds of its ends decide what an edge may do, as in meshoptimizer's
``kCanCollapse``. Where a vertex may collapse into the other and the other into it, the merged one lies anywhere between
them; where only one may, it stays with the other.
"""

import warp as wp

from warpqem.kernels.topology import BORDER, CORNER, LOCKED, NON_MANIFOLD, PINNED, SEAM

wp.set_module_options({"enable_backward": False})  # no gradients are taken

# What lies on a line stays on it, where lines meet stays there, and what is pinned stays where it is. The link
# condition says nothing of an edge from a non-manifold vertex to a border, or to another pinned vertex.
#
# A row for the vertex that goes, a column for the one it goes into:
#    INNER  SEAM  SEAM_CORNER  BORDER  BORDER_CORNER  LOCKED  NON_MANIFOLD
_MAY_COLLAPSE = (
    (1,     1,    1,           1,      1,             1,      1),  # INNER
    (0,     1,    1,           1,      1,             1,      1),  # SEAM
    (0,     0,    1,           1,      1,             1,      1),  # SEAM_CORNER: a seam ends or forks here
    (0,     0,    0,           1,      1,             1,      0),  # BORDER
    (0,     0,    0,           0,      1,             1,      0),  # BORDER_CORNER: a seam meets a border here
    (0,     0,    0,           0,      0,             0,      0),  # LOCKED
    (0,     0,    0,           0,      0,             0,      0),  # NON_MANIFOLD
)  # fmt: skip
KIND_COUNT = wp.constant(wp.int32(len(_MAY_COLLAPSE)))
(
    INNER_KIND,
    SEAM_KIND,
    SEAM_CORNER_KIND,
    BORDER_KIND,
    BORDER_CORNER_KIND,
    LOCKED_KIND,
    NON_MANIFOLD_KIND,
) = (wp.constant(wp.int32(kind)) for kind in range(len(_MAY_COLLAPSE)))
# The table as the bits of one number: a kernel would build a matrix anew for every edge.
COLLAPSE_BITS = wp.constant(
    wp.uint64(sum(bit << k for k, bit in enumerate([bit for row in _MAY_COLLAPSE for bit in row])))
)


def _kind_of(flags: int) -> int:
    """The kind of a vertex: what pins it counts most, then a border, then a seam."""
    if flags & int(NON_MANIFOLD):
        return int(NON_MANIFOLD_KIND)
    if flags & int(LOCKED):
        return int(LOCKED_KIND)
    if flags & int(BORDER):
        return int(BORDER_CORNER_KIND if flags & int(SEAM) else BORDER_KIND)
    if flags & int(CORNER):
        return int(SEAM_CORNER_KIND)
    return int(SEAM_KIND if flags & int(SEAM) else INNER_KIND)


# The kinds of all sets of flags, four bits each, as two numbers. Not asked flag by flag: the compiler of Warp 1.19 for
# sm_90 keeps such conditions of two vertices in one predicate (of `R2P`), and takes one vertex's for the other's.
_FLAG_SETS = 2 * int(CORNER)
_SETS_PER_NUMBER = 16
LOW_KINDS, HIGH_KINDS = (
    wp.constant(wp.uint64(sum(_kind_of(first + k) << 4 * k for k in range(_SETS_PER_NUMBER))))
    for first in range(0, _FLAG_SETS, _SETS_PER_NUMBER)
)


@wp.func
def vertex_kind(flags: wp.int32) -> wp.int32:
    """The kind of a vertex."""
    kinds = wp.where((flags & CORNER) != 0, HIGH_KINDS, LOW_KINDS)
    return wp.int32((kinds >> wp.uint64(4 * (flags & 15))) & wp.uint64(15))


@wp.func
def may_collapse_into(u_flags: wp.int32, v_flags: wp.int32) -> wp.bool:
    """Whether a vertex of flags ``u_flags`` may collapse into one of ``v_flags``."""
    bit = vertex_kind(u_flags) * KIND_COUNT + vertex_kind(v_flags)
    return ((COLLAPSE_BITS >> wp.uint64(bit)) & wp.uint64(1)) != wp.uint64(0)


@wp.func
def may_collapse(u_flags: wp.int32, v_flags: wp.int32) -> wp.bool:
    """Whether an edge between vertices of these flags may collapse, into either end."""
    return may_collapse_into(u_flags, v_flags) or may_collapse_into(v_flags, u_flags)


@wp.func
def removed_end(vertex_flags: wp.array[wp.int32], a: wp.int32, b: wp.int32) -> wp.int32:
    """The end that the collapse of edge ``a b`` removes: the higher one, or the one that is not pinned."""
    a_pinned = (vertex_flags[a] & PINNED) != 0
    b_pinned = (vertex_flags[b] & PINNED) != 0
    removed = wp.max(a, b)
    if a_pinned != b_pinned:
        removed = wp.where(a_pinned, b, a)
    return removed
