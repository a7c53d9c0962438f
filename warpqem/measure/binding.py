"""The material point of the reference that each vertex of a test mesh stands for.

The nearest point of the reference in one frame may lie on another leg, or on the other side of a thin part. So a vertex
is bound to the nearest point of the *sheet* it belongs to. The collapse record decides which one that is; for two
meshes without a record, the way the surfaces face, the distances in other frames, and what a vertex's neighbours are
bound to.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.arguments.array_input import index_array
from warpqem.errors import MeshShapeError
from warpqem.kernels.binding import find_listed
from warpqem.measure.binding_surface import WALK_STEPS, ReferenceSurface, TestVertices, facing_sign
from warpqem.measure.checked_meshes import CheckedMesh, chosen_frames
from warpqem.measure.closest_points import ClosestPointSearch
from warpqem.mesh.components import lowest_members
from warpqem.mesh.mesh_input import is_proper
from warpqem.place.cluster_rows import list_faces_at
from warpqem.runtime.launches import launch

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
    reference: CheckedMesh,
    test: CheckedMesh,
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


def check_vertex_map(vertex_map: Any, reference: CheckedMesh, test: CheckedMesh) -> Ints:
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
    reference: CheckedMesh,
    test: CheckedMesh,
    centre: Floats,
    diagonal: Floats,
    device: str,
    vertex_map: Ints,
) -> Binding:
    """Bind each vertex to the nearest point, in the first frame, of the reference faces that it stands for.

    Those are the faces with a corner among the vertices that were collapsed into it. Where they lie on both sides of a
    thin part, the side counts that faces as the vertex does, or is nearer over the motion.

    Arguments as in :func:`bind`; the vertex map as :func:`check_vertex_map` gives it.
    """
    surface = ReferenceSurface(reference, centre, diagonal, _key_frames(reference), device)
    vertices = TestVertices(test, surface)
    return Binding(*_nearest_over_time(surface, vertices, _ListedSearch(surface, vertices, test, vertex_map)))


def bind_by_shape(reference: CheckedMesh, test: CheckedMesh, centre: Floats, diagonal: Floats, device: str) -> Binding:
    """Bind each vertex to the nearest point, in the first frame, of the sheet that it belongs to.

    Candidates are the nearest points, in each of eight frames, of faces that face as the vertex does. Of these the
    one counts that stays nearest over those frames. Then neighbours are made to agree: a walk over the reference from
    the point of one vertex to its neighbour should end at the neighbour's point. Groups of vertices that are bound
    elsewhere than what surrounds them follow it where their distances hardly grow.

    Arguments as in :func:`bind`.
    """
    surface = ReferenceSurface(reference, centre, diagonal, _key_frames(reference), device)
    vertices = TestVertices(test, surface)
    face, barycentric = _nearest_over_time(surface, vertices, _WholeSearch(surface, vertices))
    for _ in range(ROUNDS):
        moved = _follow_neighbours(surface, vertices, face, barycentric)
        if not moved.any():
            break
    return Binding(face, barycentric)


def _key_frames(reference: CheckedMesh) -> list[int]:
    frames: list[int] = chosen_frames(KEY_FRAMES, len(reference.points)).tolist()
    return frames


class _Search(Protocol):
    """Finds faces of the reference for the vertices in a key frame."""

    def nearest(self, key: int) -> tuple[Ints, Floats]:
        """The nearest face to each vertex (U,), and its distance."""

    def facing(self, key: int, chosen: Ints, normal: Floats, distance: Floats) -> Ints:
        """The nearest faces to chosen vertices (S,) that face as normals (S, 3) do; -1 where there is none near.

        ``distance`` (S,) is that of the nearest face whichever way it faces.
        """


class _WholeSearch:
    """Any face counts."""

    def __init__(self, surface: ReferenceSurface, vertices: TestVertices) -> None:
        self._surface, self._vertices = surface, vertices
        self._search = ClosestPointSearch(surface.mesh.faces, surface.device, "reference")

    def nearest(self, key: int) -> tuple[Ints, Floats]:
        frame = self._surface.frames[key]
        closest = self._search.closest(self._surface.points[key], self._vertices.points[key], frame)
        return closest.face.astype(np.int64), closest.distance

    def facing(self, key: int, chosen: Ints, normal: Floats, distance: Floats) -> Ints:
        reach = np.maximum(self._vertices.reach[chosen], 2 * distance)
        # The frame is that which was searched for the nearest faces.
        mesh = self._search.mesh
        return self._surface.facing(key, self._vertices.points[key, chosen], normal, distance, reach, mesh)


class _ListedSearch:
    """Only faces that a vertex stands for count."""

    def __init__(self, surface: ReferenceSurface, vertices: TestVertices, test: CheckedMesh, vertex_map: Ints) -> None:
        self._surface, self._vertices = surface, vertices
        faces = surface.mesh.faces
        slot = np.full(test.points.shape[1] + 1, -1, dtype=np.int32)
        slot[test.used] = np.arange(len(test.used))
        # The vertex map's -1 finds the last slot, which is none.
        corner = np.where(is_proper(faces)[:, None], slot[vertex_map[faces]], -1).ravel()
        self._start, self._face = list_faces_at(corner, len(vertices), surface.device)

    def nearest(self, key: int) -> tuple[Ints, Floats]:
        everyone = np.arange(len(self._vertices))
        return self._find(key, everyone, np.zeros((len(everyone), 3)))

    def facing(self, key: int, chosen: Ints, normal: Floats, distance: Floats) -> Ints:
        return self._find(key, chosen, normal)[0]

    def _find(self, key: int, chosen: Ints, normal: Floats) -> tuple[Ints, Floats]:
        device, count = self._surface.device, np.diff(self._start)[chosen]
        start = np.concatenate([[0], np.cumsum(count)]).astype(np.int32)
        entry = np.repeat(self._start[chosen], count) + np.arange(start[-1]) - np.repeat(start[:-1], count)
        face = wp.empty(len(chosen), dtype=wp.int32, device=device)
        distance = wp.empty(len(chosen), dtype=wp.float64, device=device)
        doubles = (self._surface.points[key], self._vertices.points[key, chosen], normal)
        points, query, normals = (wp.array(values, dtype=wp.vec3d, device=device) for values in doubles)
        launch(
            find_listed,
            dim=len(chosen),
            inputs=[
                wp.array(start, device=device),
                wp.array(self._face[entry], dtype=wp.int32, device=device),
                points,
                self._surface.corner_vertex,
                query,
                normals,
            ],
            outputs=[face, distance],
            device=device,
        )
        return face.numpy().astype(np.int64), distance.numpy()


def _nearest_over_time(surface: ReferenceSurface, vertices: TestVertices, search: _Search) -> tuple[Ints, Floats]:
    """The best candidate for each vertex: faces (U,) and barycentric coordinates (U, 3) in the first frame.

    The nearest point in each key frame, and the nearest one of a face that faces as the vertex does, lead to a
    candidate: from there a walk goes to the vertex in the first frame.
    """
    chosen = _Chosen(surface, vertices)
    for key in range(len(surface.frames)):
        steps = WALK_STEPS if key else 0
        face, distance = search.nearest(key)
        along = chosen.facing(key, face)
        if key == 0:
            # A mesh that was turned inside out as a whole faces against the reference everywhere.
            chosen.sign = facing_sign(along, distance)
        chosen.offer(np.arange(len(vertices)), *surface.walk(face, vertices.points[0], steps))
        against = np.flatnonzero(chosen.sign * along < 0)
        if not len(against):
            continue
        other = search.facing(key, against, chosen.sign * vertices.normals[key, against], distance[against])
        against, other = against[other >= 0], other[other >= 0]
        chosen.offer(against, *surface.walk(other, vertices.points[0][against], steps))
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
