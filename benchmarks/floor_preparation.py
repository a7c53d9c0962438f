"""The least that kernels before the first pass and after the last must do."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from benchmarks.demand import INT, POINT, VALENCE, Arguments, Demand, frames_of, size_of

__all__ = ["PREPARATION_MODELS"]

# Two edges, their cross product and its length 20, lengths of three edges 15, largest ones and sums 6.
AREA_FLOPS = 41


def _begin_members(a: Arguments) -> Demand:
    # Two links.
    return Demand(a["members"].following.size * 2 * INT)


def _measure_faces(a: Arguments) -> Demand:
    # Corners of the faces, points of their vertices, half as many; sizes and edges written.
    faces, frames = len(a["size_out"]), frames_of(a["position_in"])
    points = faces / 2 * frames * POINT
    written = size_of(a["size_out"]) + size_of(a["longest_out"])
    return Demand(size_of(a["corner_vertex_in"]) + points + written, faces * frames * AREA_FLOPS)


def _measure_members(a: Arguments) -> Demand:
    # The faces at each vertex; its list, point, areas and reach.
    vertices = a["members"].following.size
    read = size_of(a["size_in"]) + size_of(a["longest_in"]) + vertices * VALENCE * INT
    return Demand(read + vertices * (6 * INT + POINT))


# Arrays that a kernel reads or writes, and how many times.
_STREAMED: dict[str, tuple[tuple[str, float], ...]] = {
    "begin_trees": (("parent_out", 1),),
    "join_faces": (("corner_vertex_in", 1), ("parent", 2)),
    "close_trees": (("parent", 2), ("is_root_out", 1)),
    "number_components": (("root_in", 1), ("roots_before_in", 1), ("component_out", 1)),
    "mark_remnants": (
        ("face_count_in", 1),
        ("cheapness_in", 1),
        ("least_loss_in", 1),
        ("is_remnant_out", 1),
    ),
    "list_component_faces": (("corner_vertex_in", 1 / 3), ("component_in", 1), ("face_out", 2)),
    "count_non_manifold": (("vertex_flags_in", 1),),
    "invert_order": (("item_in", 1), ("place_out", 1)),
    "key_faces": (("corner_vertex_in", 1), ("place_in", 1), ("corner_vertex_in", 2 / 3)),
    "rearrange_corners": (("corner_vertex_out", 2 + 1 / 3), ("place_in", 1)),
    "gather_integers": (("values_out", 2), ("item_in", 1)),
    "gather_numbers": (("values_out", 2), ("item_in", 1)),
    "mark_constrained": (("border_in", 1), ("seam_in", 1), ("constrained_out", 1), ("is_constrained_out", 1)),
    "list_constrained": (("constrained_in", 1), ("edge_out", 2)),
    "mark_faces_left": (("corner_vertex_in", 1), ("root_in", 1), ("vertex_drop_in", 1), ("is_left_out", 1)),
    "begin_roots": (("parent_out", 1),),
    "link_collapses": (("values_in", 0.5),),
    "follow_collapses": (("parent_in", 1), ("root_out", 1)),
    "drop_unfit_faces": (("corner_vertex_in", 1), ("corner_vertex_out", 1)),
    "list_faces_left": (("before_in", 1), ("face_out", 1)),
}


def _streamed(kernel: str, a: Arguments) -> Demand:
    return Demand(sum(times * size_of(a[name]) for name, times in _STREAMED[kernel]))


def _find_unclean_vertices(a: Arguments) -> Demand:
    # Flags, and where lists begin and end; few vertices have two faces.
    return Demand(3 * size_of(a["vertex_flags_in"]))


def _measure_components(a: Arguments) -> Demand:
    # The first corner of each face, its costs, and two numbers of its component.
    faces = a["state"].corner_vertex.size // 3
    return Demand(faces * 4 * INT + 2 * size_of(a["face_count"]), 3 * faces)


def _find_bounds(a: Arguments) -> Demand:
    return Demand(a["position_in"].shape[0] * POINT)


def _key_vertices(a: Arguments) -> Demand:
    return Demand(a["position_in"].shape[0] * (POINT + 2 * INT))


PREPARATION_MODELS: dict[str, Callable[[Arguments], Demand]] = {
    **{kernel: partial(_streamed, kernel) for kernel in _STREAMED},
    "begin_members": _begin_members,
    "measure_faces": _measure_faces,
    "measure_members": _measure_members,
    "measure_components": _measure_components,
    "find_unclean_vertices": _find_unclean_vertices,
    "find_bounds": _find_bounds,
    "key_vertices": _key_vertices,
}
