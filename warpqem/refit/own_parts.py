"""How far components of the output may be from their own parts of the input: as far as they were as placed.

Looked at are vertices of both and points of faces, in all key frames, each at the faces around its clusters. Where a
component has few faces it is furthest away inside of them: its edges cut through a bolt from one side to the other, or
bridge a notch of its head, and that between points that are no closer than the bolt is thick. There points are dense.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.frames.blocks import pack_frames
from warpqem.kernels import distance_points as distance_kernels
from warpqem.kernels import surface_limits as kernels
from warpqem.kernels.lanes import width_of
from warpqem.measure.face_lists import FacesAround
from warpqem.measure.large_faces import LargeFaces, large_faces
from warpqem.measure.surface_places import (
    InputVertices,
    Places,
    SampledFaces,
    Side,
    SimplifiedVertices,
    input_side,
    squared_distances,
)
from warpqem.mesh.edges import edge_key
from warpqem.mesh.grouping import different
from warpqem.mesh.indexing import put_at
from warpqem.runtime import new_arrays
from warpqem.runtime.device import device_traits
from warpqem.runtime.launches import launch
from warpqem.runtime.part_launches import launch_in_parts, rows_of
from warpqem.runtime.readback import joined

__all__ = ["OwnParts"]

# A component may come further away by such a part. Places between those looked at may add the rest of 5 %: of 1365
# parts of 25 clips and assemblies one is further away. With 1.02, RMS of assemblies is 0.2 % more.
GROWTH = 1.035
# Components of so many faces have dense points: those that came further away had 12 to 44. Of 48, parts are as near.
FEW_FACES = 64
# On edges, where nearly all of them are furthest, in eighths; inside of faces in quarters. With sixths and fifths, a
# bolt comes 8 % further away; with three times the points inside, none gets nearer.
EDGE_EIGHTHS = np.arange(1, 8, dtype=np.float32) / 8
POINTS_OF_EDGE = np.stack([EDGE_EIGHTHS, 1 - EDGE_EIGHTHS, np.zeros_like(EDGE_EIGHTHS)], axis=1)
POINTS_OF_FACE = np.array([[2, 1, 1], [1, 2, 1], [1, 1, 2]], dtype=np.float32) / 4
# The input's faces are smaller. Middles of these instead of those of edges let a part come 8 % further away.
MIDDLE_OF_EDGE = np.array([[0.5, 0.5, 0.0]], dtype=np.float32)
# A squared distance beyond all others, of points that were not looked at yet.
FAR = 1e30


class OwnParts:
    """How far components may be from their own parts of the input: what they were as placed, and a little more.

    Where the host would wait for which faces are large, nothing of it comes to the host.

    Args:
        source: (K, V) vec3, key frames of the input.
        corners: (N, 3) int32, its faces.
        used: (U,) int, the vertices that these have, ascending.
        vertex_map: (V,) int32, input vertex to output vertex.
        placed: (K, C) vec3, the output as placed.
        faces: (N', 3) int32, its faces.
        component: (C,) int32, of each of its vertices.
        limits: (n,) float32 on the device, of each component: squared distances that it had at some samples as placed;
            kept, and raised to what it had at all places.
        frame_scale: (K,) float32 on the device, what multiplies distances of each frame.
        device: Warp device.
        room: large faces that there is room for where the host does not know them; None for as many as there mostly
            are.

    Attributes:
        large_count: (1,) int32 on the device, how many large faces there are; None where the host knows.
        room: those that there is room for.
    """

    def __init__(
        self,
        source: wp.array,
        corners: np.ndarray,
        used: np.ndarray,
        vertex_map: np.ndarray,
        placed: wp.array,
        faces: np.ndarray,
        component: np.ndarray,
        limits: wp.array,
        frame_scale: wp.array,
        device: str,
        room: int | None = None,
    ) -> None:
        self._device, self._limits, self._scale = device, limits, frame_scale
        self._component = new_arrays.uploaded(component, dtype=wp.int32, device=device)
        reference, self._lanes = (self._packed(points) for points in (source, placed))
        vertex_count = placed.shape[1]
        around, around_output = FacesAround(corners, len(vertex_map)), FacesAround(faces, vertex_count)
        input_faces = input_side(reference, around, vertex_map, vertex_count)
        output = Side(self._lanes, around_output, around_output)
        is_asked = not device_traits(device).own_memory
        listed = None
        if is_asked:
            large = corners[large_faces(reference, around, self._lanes, faces, device)]
            of_large = SampledFaces(reference, large, vertex_map[large], output, around_output)
        else:
            listed = LargeFaces(reference, around, self._lanes, faces, vertex_map, device, room)
            of_large = SampledFaces(reference, listed.corners, listed.clusters, output, around_output)
        self.large_count = None if listed is None else listed.rows[:1]
        self.room = 0 if listed is None else listed.room
        own = component[faces[:, 0]]
        is_small = np.bincount(own) <= FEW_FACES
        few = is_small[own]
        many = faces[~few] if few.any() else faces
        edges = _edges(corners[_at_few(corners, vertex_map, component, is_small)], len(vertex_map))
        edges_of_few = _edges(faces[few], vertex_count)
        of_input = InputVertices(reference, output, used, vertex_map[used])
        of_output = SimplifiedVertices(self._lanes, input_faces, different(faces, vertex_count), around_output)
        points = [
            of_large,
            SampledFaces(reference, edges, vertex_map[edges[:, :2]], output, around_output, MIDDLE_OF_EDGE),
            SampledFaces(self._lanes, many, many, input_faces, around_output),
            SampledFaces(self._lanes, edges_of_few, edges_of_few[:, :2], input_faces, around_output, POINTS_OF_EDGE),
            SampledFaces(self._lanes, faces[few], faces[few], input_faces, around_output, POINTS_OF_FACE),
        ]
        row = _rows(used)
        begin = [_rows_of_corners(one, row) for one in points[listed is not None : 2]]
        row_of_output = len(used) + _rows(of_output.vertex)
        begin += [_rows_of_corners(one, row_of_output) for one in points[2:]]
        there = new_arrays.uploaded(np.concatenate(begin), dtype=wp.int32, device=device)
        if listed is not None:
            there = joined([listed.rows_of_corners(row, of_large.weights.argmax(axis=1)).reshape(-1), there])
        self._look = self._looked_at([of_input, of_output], points, there)

    def _looked_at(self, vertices: Sequence[Places], points: Sequence[Places], begin: wp.array) -> _Look:
        """A look at vertices and points of faces, which raises the limits to how far they are.

        How far vertices are decides how closely points are looked at. Each of them, (m,), begins where the vertex in a
        row ``begin`` of all vertices ended.
        """
        device, component = self._device, self._component
        count = sum(one.count for one in vertices)
        nearest = new_arrays.full(count + len(begin), -1, dtype=wp.int32, device=device)
        most = new_arrays.full(count + len(begin), FAR, dtype=wp.float32, device=device)
        found = new_arrays.part(nearest, 0, count), new_arrays.part(most, 0, count)
        _Look(vertices, component, *found, device).raise_limits(self._limits)
        if len(begin):
            found = tuple(new_arrays.part(array, count, count + len(begin)) for array in (nearest, most))
            launch(kernels.begin_at_vertices, len(begin), [nearest, begin], [found[0]], device=device)
            _Look(points, component, *found, device).raise_limits(self._limits)
        return _Look([*vertices, *points], component, nearest, most, device)

    def mark_far(self, moved: wp.array, marks: wp.array) -> None:
        """Mark (C,) vertices at places of (K, C) points further away than any of their component was as placed."""
        now = self._packed(moved)
        step = new_arrays.zeros(len(self._limits), dtype=wp.float32, device=self._device)
        kernel, count = distance_kernels.largest_steps[width_of(now)], len(now)
        launch(kernel, count, [self._lanes, now, self._component], [step], device=self._device)
        wp.copy(self._lanes, now)
        self._look.mark_far(self._limits, step, marks)

    def _packed(self, points: wp.array) -> wp.array:
        """Blocks of points (K, n), each frame in its own unit."""
        lanes = pack_frames(points, self._device)
        kernel, outputs = distance_kernels.scale_frames[width_of(lanes)], [rows_of(lanes)]
        launch_in_parts(kernel, lanes.shape, [self._scale], outputs, device=self._device)
        return lanes


def _at_few(
    corners: npt.NDArray[np.integer],
    vertex_map: npt.NDArray[np.integer],
    component: npt.NDArray[np.integer],
    is_small: npt.NDArray[np.bool_],
) -> npt.NDArray[np.integer]:
    """The faces of the input (N, 3) that belong to components (n,) with few faces."""
    if not is_small.any():
        return np.empty(0, dtype=np.int64)
    # Vertices without a component are no corners.
    return np.flatnonzero(is_small[component[vertex_map]].take(corners[:, 0]))


def _edges(faces: npt.NDArray[np.integer], vertex_count: int) -> npt.NDArray[np.int32]:
    """(e, 3) int32, the edges of faces (m, 3), once each, as faces whose last corner is the second one."""
    key = np.sort(edge_key(faces.ravel(), faces[:, [1, 2, 0]].ravel(), vertex_count))
    first, second = np.divmod(key[np.flatnonzero(np.diff(key, prepend=-1))], vertex_count)
    return np.column_stack([first, second, second]).astype(np.int32)


def _rows(vertex: npt.NDArray[np.integer]) -> npt.NDArray[np.int32]:
    """Where each vertex is among some of them (n,), ascending; up to the last of these."""
    row = np.zeros(int(vertex.max(initial=-1)) + 1, dtype=np.int32)
    put_at(row, vertex, np.arange(len(vertex), dtype=np.int32))
    return row


def _rows_of_corners(places: SampledFaces, row: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    """(m,) int32, the ``row`` of the corner that each point of faces is nearest to."""
    assert isinstance(places.faces, np.ndarray)
    return row.take(places.faces.take(places.weights.argmax(axis=1), axis=1)).ravel()


def _part(array: wp.array, rows: slice) -> wp.array:
    return new_arrays.part(array, rows.start, rows.stop)


class _Look:
    """Some places and the components that they are held to.

    Args:
        places: with m points.
        component: (C,) int32 on the device, of each output vertex.
        nearest: (m,) int32, the faces of the other surface that they were near to at the last look, -1 for none.
        most: (m,) float32, how far they were at most, squared.
        device: Warp device.
    """

    def __init__(
        self, places: Sequence[Places], component: wp.array, nearest: wp.array, most: wp.array, device: str
    ) -> None:
        self._places, self._device = [one for one in places if one.count], device
        self._nearest, self._most = nearest, most
        self._groups: list[tuple[kernels.PlacesOfVertices, slice]] = []
        self._count = 0
        for one in self._places:
            group = kernels.PlacesOfVertices()
            clusters = one.clusters
            if not isinstance(clusters, wp.array):
                clusters = new_arrays.uploaded(clusters, dtype=wp.int32, device=device)
            group.vertex = clusters
            group.points, group.component = one.points_of_each, component
            first, self._count = self._count, self._count + one.count * one.points_of_each
            self._groups.append((group, slice(first, self._count)))

    def raise_limits(self, limits: wp.array) -> None:
        """Raise the squared limits (n,) of components to the largest squared distances of their places."""
        nowhere = new_arrays.zeros(len(limits), dtype=wp.float32, device=self._device)
        _, squared = self._distances(limits, 1.0, nowhere)
        wp.copy(self._most, squared)
        for group, points in self._groups:
            part = _part(squared, points)
            launch(kernels.raise_own_limits, len(part), [group, part], [limits], device=self._device)

    def mark_far(self, limits: wp.array, step: wp.array, marks: wp.array) -> None:
        """Mark vertices (C,) int32 of places that are further away than the squared limits (n,) and growth allow.

        No vertex of a component has gone further than ``step`` (n,) since the last look.
        """
        within, squared = self._distances(limits, GROWTH, step)
        for group, points in self._groups:
            part = _part(squared, points)
            inputs, outputs = [group, part, _part(within, points)], [_part(self._most, points), marks]
            launch(kernels.mark_far_places, len(part), inputs, outputs, device=self._device)

    def _distances(self, limits: wp.array, growth: float, step: wp.array) -> tuple[wp.array, wp.array]:
        """The limits of points, negative where none is looked at, and their distances, no closer than that; squared."""
        within = new_arrays.empty(self._count, dtype=wp.float32, device=self._device)
        for group, points in self._groups:
            part = _part(within, points)
            inputs, outputs = [group, limits, growth, step], [_part(self._most, points), part]
            launch(kernels.gather_limits, len(part), inputs, outputs, device=self._device)
        return within, squared_distances(self._places, within, self._device, self._nearest)
