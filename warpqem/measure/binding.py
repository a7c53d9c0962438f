"""The material point of the reference that each vertex of a test mesh stands for.

The nearest point of the reference in one frame may lie on another leg, or on the other side of a thin part. So a vertex
is bound to the nearest point of the *sheet* it belongs to. Which one that is says the collapse record where there is
one; for two meshes that know nothing of each other, the way the surfaces face, the distances in other frames, and what
a vertex's neighbours are bound to.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.array_input import index_array
from warpqem.components import lowest_members
from warpqem.errors import MeshShapeError
from warpqem.kernels.transfer import find_wedge_sources
from warpqem.launches import launch
from warpqem.measure.binding_surface import WALK_STEPS, ReferenceSurface, TestVertices, facing_sign
from warpqem.measure.distance import ClosestPointSearch
from warpqem.measure.inputs import MeshSequence, chosen_frames
from warpqem.place.rows import gather_faces
from warpqem.transfer import is_proper

__all__ = ["Binding", "bind", "bind_by_record", "bind_by_shape", "check_vertex_map"]

# Frames, evenly spread, in which a binding is checked: parts that touch in one of them are apart in others.
KEY_FRAMES = 8

# Two points of the reference are the same where they are no further apart, in all key frames, than this part of the
# test edge along which one was found from the other.
SAME_POINT = 0.05

# Two nearest points of a crease or a fold are on one sheet where their faces adjoin and they are no further apart, over
# the key frames, than this part of the longest edge at the vertex.
SAME_SHEET = 0.25

# Where two neighbours are bound to different sheets, that counts as an error of so much of the edge between them. A
# group of vertices moves to its neighbours' sheet where its distances grow by less.
BREAK = 0.25

# Moves of groups that can make other groups move; each round starts from the bindings of the one before.
ROUNDS = 4

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Binding:
    """Material points of the reference, one for each vertex of the test mesh that a face refers to.

    Attributes:
        face: (U,) int64, reference faces.
        barycentric: (U, 3) float64.
    """

    face: Ints
    barycentric: Floats


def bind(
    reference: MeshSequence,
    test: MeshSequence,
    centre: Floats,
    diagonal: Floats,
    device: str,
    vertex_map: Ints | None = None,
) -> Binding:
    """Bind the test vertices in use by the collapse record, or without one by the shape of both meshes.

    Either way the point is the nearest one in the first frame of the faces that can be meant.

    Args:
        reference: sequence the test mesh is bound to.
        test: sequence with as many frames.
        centre: (F, 3) centres of the reference frames.
        diagonal: (F,) diagonals of the reference frames.
        device: Warp device name.
        vertex_map: (V,) the test vertex that each reference vertex was collapsed into, -1 for none; None without one.
    """
    if vertex_map is not None:
        return bind_by_record(reference, test, centre, diagonal, device, vertex_map)
    return bind_by_shape(reference, test, centre, diagonal, device)


def check_vertex_map(vertex_map: Any, reference: MeshSequence, test: MeshSequence) -> Ints:
    """The vertex map of a collapse record as (V,) int64.

    Raises:
        MeshShapeError: it is no array of integers with an entry for each reference vertex, names a test vertex that
            does not exist, or leaves a test vertex in use without any face of the reference.
    """
    given = index_array(vertex_map, "vertex_map", ("V",)).astype(np.int64)
    vertex_count, test_count = reference.points.shape[1], test.points.shape[1]
    if len(given) != vertex_count:
        raise MeshShapeError(f"vertex_map: {len(given)} entries for the reference's {vertex_count} vertices")
    outside = np.flatnonzero((given < -1) | (given >= test_count))
    if len(outside):
        raise MeshShapeError(
            f"vertex_map: entry {outside[0]} is {given[outside[0]]}, but the test mesh has {test_count} vertices"
        )
    cluster = given[reference.faces]
    served = np.zeros(test_count, dtype=bool)
    served[cluster[(cluster >= 0).all(axis=1) & is_proper(reference.faces)]] = True
    missing = test.used[~served[test.used]]
    if len(missing):
        raise MeshShapeError(
            f"vertex_map: no face of the reference leads to vertex {missing[0]} of the test mesh "
            f"({len(missing)} such vertices)"
        )
    return given


def bind_by_record(
    reference: MeshSequence,
    test: MeshSequence,
    centre: Floats,
    diagonal: Floats,
    device: str,
    vertex_map: Ints,
) -> Binding:
    """Bind each vertex to the nearest point, in the first frame, of the reference faces that it stands for.

    Those are the faces with a corner among the vertices that were collapsed into it. Arguments as in :func:`bind`; the
    vertex map as :func:`check_vertex_map` gives it.
    """
    surface = ReferenceSurface(reference, centre, diagonal, [0], device)
    query = (test.points[0][test.used] - centre[0]) / diagonal[0]
    cluster = vertex_map[reference.faces]
    usable = (cluster >= 0).all(axis=1) & is_proper(reference.faces)
    slot = np.full(test.points.shape[1], -1, dtype=np.int32)
    slot[test.used] = np.arange(len(test.used))
    corner = np.where(usable[:, None], slot[cluster], -1).astype(np.int32).ravel()
    start, face, _ = gather_faces(corner, np.ones(len(corner), dtype=np.float32), len(query), device)
    nearest = wp.empty(len(query), dtype=wp.int32, device=device)
    weight = wp.empty(len(query), dtype=wp.vec3, device=device)
    launch(
        find_wedge_sources,
        dim=len(query),
        inputs=[
            wp.array(start, device=device),
            wp.array(face, device=device),
            wp.array(query.astype(np.float32), dtype=wp.vec3, device=device),
            surface.corner_vertex,
            wp.array(surface.points[0].astype(np.float32), dtype=wp.vec3, device=device),
        ],
        outputs=[nearest, weight],
        device=device,
    )
    # The point itself in double precision.
    return Binding(*surface.walk(nearest.numpy(), query, 0))


def bind_by_shape(
    reference: MeshSequence, test: MeshSequence, centre: Floats, diagonal: Floats, device: str
) -> Binding:
    """Bind each vertex to the nearest point, in the first frame, of the sheet that it belongs to.

    Candidates are the nearest points, in each of eight frames, of faces that face as the vertex does. Of these the
    one counts that stays nearest over those frames. Then neighbours are made to agree: a walk over the reference from
    the point of one vertex to its neighbour should end at the neighbour's point. Groups of vertices that are bound
    elsewhere than what surrounds them follow it where their distances hardly grow.

    Arguments as in :func:`bind`.
    """
    frames = chosen_frames(KEY_FRAMES, len(reference.points)).tolist()
    surface = ReferenceSurface(reference, centre, diagonal, frames, device)
    vertices = TestVertices(test, surface)
    face, barycentric = _nearest_over_time(surface, vertices)
    for _ in range(ROUNDS):
        moved = _follow_neighbours(surface, vertices, face, barycentric)
        if not moved.any():
            break
    return Binding(face, barycentric)


def _nearest_over_time(surface: ReferenceSurface, vertices: TestVertices) -> tuple[Ints, Floats]:
    """The best candidate for each vertex: faces (U,) and barycentric coordinates (U, 3) in the first frame.

    The nearest point in each key frame, and the nearest one of a face that faces as the vertex does, lead to a
    candidate: from there a walk goes to the vertex in the first frame.
    """
    search = ClosestPointSearch(surface.mesh.faces, surface.device, "reference")
    chosen = _Chosen(surface, vertices)
    for key, frame in enumerate(surface.frames):
        query, normal = vertices.points[key], vertices.normals[key]
        closest = search.closest(surface.points[key], query, frame)
        face = closest.face.astype(np.int64)
        along = chosen.facing(key, face)
        if key == 0:
            # A mesh that was turned inside out as a whole faces against the reference everywhere.
            chosen.sign = facing_sign(along, closest.distance)
        every = np.arange(len(vertices))
        chosen.offer(every, *surface.walk(face, vertices.points[0], WALK_STEPS if key else 0))
        against = np.flatnonzero(chosen.sign * along < 0)
        if not len(against):
            continue
        distance = closest.distance[against]
        reach = np.maximum(vertices.reach[against], 2 * distance)
        other = surface.facing(key, query[against], chosen.sign * normal[against], distance, reach)
        against, other = against[other >= 0], other[other >= 0]
        chosen.offer(against, *surface.walk(other, vertices.points[0][against], WALK_STEPS if key else 0))
    return chosen.face, chosen.barycentric


class _Chosen:
    """The best of the candidates offered so far for each vertex; the first offer is to be one for all.

    A candidate counts by its mean square distance over the key frames; one that faces against the vertex has an error
    besides. Of two on the same sheet the first one stays, which is the nearest in the first frame.

    Attributes:
        sign: -1 where the test mesh is the reference turned inside out, else 1.
    """

    def __init__(self, surface: ReferenceSurface, vertices: TestVertices) -> None:
        self._surface, self._vertices = surface, vertices
        count = len(vertices)
        self.sign = 1.0
        self.face, self.barycentric = np.full(count, -1, dtype=np.int64), np.zeros((count, 3))
        self._error = np.full(count, np.inf)

    def facing(self, key: int, face: Ints, chosen: Ints | slice = slice(None)) -> Floats:
        """Positive where a face (S,) faces as the chosen vertices do in a key frame, negative where against it."""
        a, b, c = (self._surface.points[key][self._surface.mesh.faces[face, k]] for k in range(3))
        along: Floats = (np.cross(b - a, c - a) * self._vertices.normals[key, chosen]).sum(axis=1)
        return along

    def offer(self, vertex: Ints, face: Ints, barycentric: Floats) -> None:
        """Offer a candidate to each of some vertices (S,)."""
        error = self._surface.mean_square(self._vertices.points[:, vertex], face, barycentric)
        against = self.sign * self.facing(0, face, vertex) < 0
        error += against * (BREAK * self._vertices.reach[vertex]) ** 2
        better = np.flatnonzero(error < self._error[vertex])
        rival = self.face[vertex[better]]
        here = self._surface.place(face[better], barycentric[better])
        there = self._surface.place(rival, self.barycentric[vertex[better]])
        apart = ((here - there) ** 2).sum(axis=2).mean(axis=0)
        near = apart <= (SAME_SHEET * self._vertices.reach[vertex[better]]) ** 2
        better = better[(rival < 0) | ~(near & self._surface.adjoin(face[better], rival))]
        to = vertex[better]
        self.face[to], self.barycentric[to], self._error[to] = face[better], barycentric[better], error[better]


def _follow_neighbours(
    surface: ReferenceSurface, vertices: TestVertices, face: Ints, barycentric: Floats
) -> npt.NDArray[np.bool_]:
    """Bind groups of vertices to the sheet of what surrounds them where that costs little; (U,) which moved.

    A group is joined by edges along which walks agree. The largest group of each connected part of the mesh stays.
    """
    edges, count = vertices.edges, len(vertices)
    here = surface.place(face, barycentric)
    agreed = _agreed(surface, vertices, face, here)
    group = lowest_members(count, edges[agreed])
    size = np.bincount(group, minlength=count)
    part = lowest_members(count, edges)
    # Of the groups of each part the largest, of equal ones the first.
    ranked = np.lexsort((-group, size[group], part))
    last = np.append(part[ranked][1:] != part[ranked][:-1], True)
    stays = np.isin(group, group[ranked[last]])
    moved = np.zeros(count, dtype=bool)
    if stays.all():
        return moved
    new_face, new_barycentric = _flood(surface, vertices, face, barycentric, stays)
    before = surface.mean_square(vertices.points, face, barycentric)
    after = surface.mean_square(vertices.points, new_face, new_barycentric)
    # Each edge that joins two groups is there both ways: a group counts those that leave it.
    breaks = group[edges[:, 0]] != group[edges[:, 1]]
    cost = np.bincount(group[edges[breaks, 0]], (BREAK * vertices.length[breaks]) ** 2, count)
    gain = np.bincount(group, before - after, count) + cost
    moved = ~stays & (gain[group] > 0)
    # A new point that is the old one moves nothing, and would do so in every round.
    moved &= (new_face != face) | (np.abs(new_barycentric - barycentric) > 0).any(axis=1)
    face[moved], barycentric[moved] = new_face[moved], new_barycentric[moved]
    return moved


def _agreed(surface: ReferenceSurface, vertices: TestVertices, face: Ints, here: Floats) -> npt.NDArray[np.bool_]:
    """(2E,) where the walk from the point of the first end to the second end arrives at the second one's point."""
    start, end = vertices.edges.T
    arrived = surface.place(*surface.walk(face[start], vertices.points[0][end]))
    apart = ((arrived - here[:, end]) ** 2).sum(axis=2).mean(axis=0)
    return apart <= (SAME_POINT * vertices.length) ** 2


def _flood(
    surface: ReferenceSurface,
    vertices: TestVertices,
    face: Ints,
    barycentric: Floats,
    reached: npt.NDArray[np.bool_],
) -> tuple[Ints, Floats]:
    """Bindings that spread from the vertices ``reached`` to all others, each by a walk from a neighbour's point.

    Of several neighbours that one leads whose point is nearest over the key frames.
    """
    new_face, new_barycentric, reached = face.copy(), barycentric.copy(), reached.copy()
    start, end = vertices.edges.T
    while True:
        front = np.flatnonzero(reached[start] & ~reached[end])
        if not len(front):
            return new_face, new_barycentric
        to = end[front]
        found, where = surface.walk(new_face[start[front]], vertices.points[0][to])
        error = surface.mean_square(vertices.points[:, to], found, where)
        order = np.lexsort((error, to))
        best = order[np.append(True, to[order][1:] != to[order][:-1])]
        new_face[to[best]], new_barycentric[to[best]] = found[best], where[best]
        reached[to[best]] = True
