"""Kinds of vertices: which may collapse into which, and which end a collapse keeps, against the rules in words."""

import itertools

import numpy as np
import pytest
import warp as wp

from warpqem.kernels import topology, vertex_kind
from warpqem.kernels.vertex_kind import may_collapse, may_collapse_into, removed_end

BORDER, LOCKED, NON_MANIFOLD, SEAM, CORNER, MIRROR = (
    int(getattr(topology, name)) for name in ("BORDER", "LOCKED", "NON_MANIFOLD", "SEAM", "CORNER", "MIRROR")
)
PINNED = LOCKED | NON_MANIFOLD
# A corner of seams is on one, and so is where one meets a border; a mirror plane cuts a border.
FLAGS = [
    flags
    for flags in range(64)
    if (not flags & CORNER or flags & SEAM)
    and (not flags & MIRROR or flags & BORDER)
    and (not (flags & SEAM and flags & BORDER) or flags & CORNER)
]
PAIRS = np.array(list(itertools.product(FLAGS, FLAGS)), dtype=np.int32)


@wp.kernel(enable_backward=False)
def look_up(
    # in
    flags_in: wp.array2d[wp.int32],
    # out
    into_out: wp.array[wp.int32],
    either_out: wp.array[wp.int32],
    removed_out: wp.array[wp.int32],
):
    i = wp.tid()
    into_out[i] = wp.where(may_collapse_into(flags_in[i, 0], flags_in[i, 1]), 1, 0)
    either_out[i] = wp.where(may_collapse(flags_in[i, 0], flags_in[i, 1]), 1, 0)
    removed_out[i] = removed_end(flags_in[i], 0, 1)


@pytest.fixture(scope="module")
def found(device):
    """For each pair of flags whether the first may collapse into the second, either into the other, and what goes."""
    results = [wp.empty(len(PAIRS), dtype=wp.int32, device=device) for _ in range(3)]
    wp.launch(look_up, dim=len(PAIRS), inputs=[wp.array(PAIRS, device=device)], outputs=results, device=device)
    into, either, removed = (result.numpy() for result in results)
    return into.astype(bool), either.astype(bool), removed


def lies_on(flags):
    """What a vertex stays on when another one joins it, the strongest first."""
    return (flags & PINNED != 0, flags & BORDER != 0, flags & SEAM != 0, flags & CORNER != 0)


def may_join(u, v):
    """Pinned vertices do not move; the link condition does not hold a non-manifold vertex and a border apart."""
    if u & PINNED and v & PINNED:
        return False
    return not (u & NON_MANIFOLD and v & BORDER) and not (v & NON_MANIFOLD and u & BORDER)


def test_vertex_collapses_into_one_that_lies_on_as_much(found):
    expected = [may_join(u, v) and lies_on(u) <= lies_on(v) for u, v in PAIRS.tolist()]
    np.testing.assert_array_equal(found[0], expected)


def test_edge_collapses_where_its_ends_may_be_one(found):
    np.testing.assert_array_equal(found[1], [may_join(u, v) for u, v in PAIRS.tolist()])


def test_collapse_keeps_the_pinned_end_or_else_the_lower(found):
    pinned = (PAIRS & PINNED) != 0
    np.testing.assert_array_equal(found[2], np.where(pinned[:, 1] & ~pinned[:, 0], 0, 1))


def test_table_has_a_row_and_a_column_for_each_kind():
    table = np.array(vertex_kind._MAY_COLLAPSE)
    assert table.shape == (int(vertex_kind.KIND_COUNT),) * 2
    assert int(vertex_kind.NON_MANIFOLD_KIND) == len(table) - 1
