"""The least that a launch must do: bytes it reads and writes, and floating-point operations, from its arguments.

Every array element that the launch needs counts once, as if it stayed in the cache until all threads had used it, and
operations count without index arithmetic: no program can do less with this algorithm, so time over floor is how far a
kernel is from the machine. Lists whose length the device alone knows are read back before the launch, so a count is
what this launch finds, not what would fit the list. A kernel without an entry here is reported without a floor.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

__all__ = ["BYTES_PER_SECOND", "COUNTED", "FLOPS_PER_SECOND", "Demand", "count_demand", "floor_seconds"]

# What a copy moved on an H200, bytes read and written (its datasheet says 4.8e12), and the float32 rate without tensor
# cores in the datasheet.
BYTES_PER_SECOND = 4.3e12
FLOPS_PER_SECOND = 67.0e12

INT, POINT, QUADRIC = 4, 12, 40
# Edges, faces and neighbours at a vertex of a closed triangle mesh, on average; half-edges that leave or enter it.
VALENCE = 6
# Position and quadric of a vertex in one frame.
ROW = POINT + QUADRIC
# Operations per edge and frame: the anchor 67; the merged quadric 70, its minimiser 56, value and sums 27.
PRICE_FLOPS = 220
# The anchor 67, the merged quadric 70, its minimiser 56, the sums of the target 9.
TARGET_FLOPS = 202
# Per face and frame: two edges and two normals 39, their dot product and test 8.
FLIP_FLOPS = 47
# Two shifts and a sum of quadrics, error and trace.
MERGE_FLOPS = 95
# A face plane in a vertex quadric: cross product 15, length 7, plane and products 30, ten sums.
PLANE_FLOPS = 62
SOLVE_FLOPS = 60

Arguments = Mapping[str, Any]


@dataclass(frozen=True)
class Demand:
    """Bytes moved to and from memory, and floating-point operations."""

    bytes: float
    flops: float = 0.0

    def __add__(self, other: Demand) -> Demand:
        return Demand(self.bytes + other.bytes, self.flops + other.flops)


def floor_seconds(demand: Demand) -> float:
    """The longer of the two times that an H200 needs: for the bytes, and for the operations."""
    return max(demand.bytes / BYTES_PER_SECOND, demand.flops / FLOPS_PER_SECOND)


def _length(edges: Any) -> int:
    """Length of a list that the device counts."""
    return int(edges.count.numpy()[0])


def _moved(a: Arguments) -> int:
    """Vertices that the last pass moved."""
    return max(0, _length(a["log"]) - int(a["pass_begin"].numpy()[0]))


def _keys(a: Arguments) -> int:
    return int(a["state"].position.shape[1])


def _price_all_edges(a: Arguments) -> Demand:
    vertices, keys = a["state"].position.shape
    half_edges = a["half_edge_count"]
    # Corners, stars and costs of each half-edge; the row starts and flags of each vertex.
    topology = half_edges * 3 * INT + vertices * 3 * INT
    return Demand(vertices * keys * ROW + topology, half_edges / 2 * keys * PRICE_FLOPS)


def _reprice_moved_stars(a: Arguments) -> Demand:
    moved, keys = _moved(a), _keys(a)
    # The vertex and its ring; corners and stars to find them; a cost at either half-edge of each edge.
    return Demand(
        moved * ((1 + VALENCE) * (keys * ROW + 3 * INT) + VALENCE * (3 + 3 + 2) * INT),
        moved * VALENCE * keys * PRICE_FLOPS,
    )


def _wake_neighbourhoods(a: Arguments) -> Demand:
    # The costs around each neighbour, read and written; a cost in two neighbourhoods counts in both.
    return Demand(_moved(a) * VALENCE * VALENCE * (1 + 2 * 2) * INT)


def _place_winners(a: Arguments) -> Demand:
    winners, keys = _length(a["winners"]), _keys(a)
    return Demand(winners * (keys * (2 * ROW + POINT) + 6 * INT), winners * keys * TARGET_FLOPS)


def _judge_winners(a: Arguments) -> Demand:
    winners, keys = _length(a["winners"]), _keys(a)
    # Both stars: ten faces stay, over the two ends and a ring of eight, against one target.
    faces, vertices = 2 * (VALENCE - 1), 2 + 2 * (VALENCE - 2)
    return Demand(
        winners * (keys * (vertices + 1) * POINT + 2 * VALENCE * 4 * INT), winners * keys * faces * FLIP_FLOPS
    )


def _commit_winners(a: Arguments) -> Demand:
    collapses, keys = int(np.count_nonzero(a["faces_removed_in"].numpy()[: _length(a["winners"])])), _keys(a)
    # Two rows and the target read, one row written; the log; the mask and corners of both stars.
    return Demand(
        collapses * (keys * (3 * ROW + POINT) + 8 * INT + 2 * VALENCE * 6 * INT), collapses * keys * MERGE_FLOPS
    )


def _count_costs(a: Arguments) -> Demand:
    return Demand(a["half_edge_count"] / a["sample_step"] * INT)


def _find_cap(a: Arguments) -> Demand:
    return Demand(2 * INT * a["histogram"].size)


def _collect_candidates(a: Arguments) -> Demand:
    return Demand(a["half_edge_count"] * INT)


def _claim_vertices(a: Arguments) -> Demand:
    # The half-edge, its cost and corners; a claim of eight bytes read and written at either end.
    return Demand(_length(a["candidates"]) * (4 * INT + 2 * 2 * 8))


def _select_winners(a: Arguments) -> Demand:
    # Two stars: their lists, the corners of ten faces, the claims of ten vertices.
    faces = 2 * (VALENCE - 1)
    return Demand(_length(a["candidates"]) * (5 * INT + faces * (1 + 3) * INT + faces * 8))


def _withdraw_claims(a: Arguments) -> Demand:
    return Demand(_length(a["candidates"]) * (3 * INT + 2 * 8))


def _shrink_candidates(a: Arguments) -> Demand:
    return Demand(_length(a["candidates_in"]) * (1 + 2 + 1 + 2 + 1) * INT)


def _count_corners(a: Arguments) -> Demand:
    return Demand(a["corner_vertex_in"].size * INT + a["corner_count_out"].size * 2 * INT)


def _fill_stars(a: Arguments) -> Demand:
    return Demand(2 * a["corner_vertex_in"].size * INT + a["star_cursor"].size * 2 * INT)


def _sort_stars(a: Arguments) -> Demand:
    return Demand((2 * a["star_corner"].size + a["star_start_in"].size) * INT)


def _classify_vertices(a: Arguments) -> Demand:
    return Demand((3 * a["corner_vertex_in"].size + 3 * a["vertex_flags"].size) * INT)


def _mark_live_faces(a: Arguments) -> Demand:
    return Demand(2 * a["live_out"].size * INT)


def _move_live_faces(a: Arguments) -> Demand:
    # Rank and corner of every face; three corners, costs and seams of the live ones, read and written.
    faces = a["live_rank_in"].size
    live = int(a["live_rank_in"].numpy()[-1])
    return Demand((2 * faces + 2 * 9 * live) * INT)


def _weigh_face_normals(a: Arguments) -> Demand:
    faces, keys = a["weighted_normal_out"].shape
    vertices = a["position_in"].shape[0]
    return Demand(faces * (3 * INT + keys * POINT) + vertices * keys * POINT, faces * keys * 27)


def _gather_vertex_quadrics(a: Arguments) -> Demand:
    faces = a["weighted_normal_in"].shape[0]
    vertices, keys = a["quadric_out"].shape
    return Demand(
        keys * (faces * POINT + vertices * QUADRIC) + (3 * faces + 2 * vertices) * INT,
        vertices * keys * (VALENCE * 12 + 6),
    )


def _measure_cluster_distances(a: Arguments) -> Demand:
    vertices, keys = a["key_position_in"].shape
    kept = len(np.unique(a["root_in"].numpy()))
    return Demand((vertices + kept) * keys * POINT + 2 * vertices * INT, vertices * keys * 9)


def _fit_anchor_weights(a: Arguments) -> Demand:
    keys = a["key_position_in"].shape[1]
    size = np.diff(a["member_start_in"].numpy()).astype(np.float64)
    members, entries = size.sum(), (size * (size + 1) / 2).sum()
    # The Gram matrices count as never leaving the chip.
    gram = keys * (members * 35 + entries * 7)
    solve = (size**3 / 3 + 2 * size**2).sum()
    return Demand(members * (keys * POINT + 2 * INT) + len(size) * (keys * ROW + 3 * INT), gram + solve)


def _place_vertices(a: Arguments) -> Demand:
    frames, vertices = a["points_in"].shape
    clusters, outputs = a["clusters"], a["points_out"].shape[1]
    faces, members = clusters.face.size, clusters.member.size
    once = faces * 4 * INT + members * 2 * INT + clusters.border.size * 2 * INT + outputs * 4 * INT
    flops = faces * PLANE_FLOPS + members * 6 + outputs * SOLVE_FLOPS
    return Demand(once + frames * (vertices + 2 * outputs) * POINT, frames * flops)


def _count_flips(a: Arguments) -> Demand:
    frames, outputs = a["points_in"].shape
    faces = a["corner_vertex_in"].size / 3
    return Demand(faces * 3 * INT + frames * 2 * outputs * POINT, frames * faces * 26)


_MODELS: dict[str, Callable[[Arguments], Demand]] = {
    model.__name__.removeprefix("_"): model
    for model in (
        _price_all_edges,
        _reprice_moved_stars,
        _wake_neighbourhoods,
        _place_winners,
        _judge_winners,
        _commit_winners,
        _count_costs,
        _find_cap,
        _collect_candidates,
        _claim_vertices,
        _select_winners,
        _withdraw_claims,
        _shrink_candidates,
        _count_corners,
        _fill_stars,
        _sort_stars,
        _classify_vertices,
        _mark_live_faces,
        _move_live_faces,
        _weigh_face_normals,
        _gather_vertex_quadrics,
        _measure_cluster_distances,
        _fit_anchor_weights,
        _place_vertices,
        _count_flips,
    )
}

# Names of the kernels that have a floor.
COUNTED = frozenset(_MODELS)


def count_demand(kernel: str, arguments: Arguments, lanes: int) -> Demand | None:
    """What a launch needs; None for a kernel without an entry.

    Args:
        kernel: its name.
        arguments: its arguments by name, as they are before the launch.
        lanes: threads of the launch; a sweep with a larger stride does that part of the work only.
    """
    if kernel not in _MODELS:
        return None
    whole = _MODELS[kernel](arguments)
    share = min(1.0, lanes / arguments["stride"]) if "stride" in arguments else 1.0
    return Demand(share * whole.bytes, share * whole.flops)
