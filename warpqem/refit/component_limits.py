"""How far components of the output may be from the input: as far as they were as placed, in the key frames.

A component is held against the whole input, by samples that take turns over the key frames, and against its own part
of it, at vertices and points of faces in all key frames. Parts that lie in each other are near to each other anywhere:
only against its own part a component that leaves its place is seen to.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.frames.blocks import pack_frames
from warpqem.kernels import surface_limits as kernels
from warpqem.measure.far_points import FacesAround
from warpqem.measure.surface_places import (
    InputVertices,
    Places,
    SampledFaces,
    Side,
    SimplifiedVertices,
    input_side,
    large_faces,
    squared_distances,
)
from warpqem.mesh.components import lowest_members
from warpqem.refit.matching import Matching
from warpqem.runtime import new_arrays
from warpqem.runtime.launches import launch

__all__ = ["ComponentLimits"]

# A component may come further away by such a part: of 19 cells of small parts RMS is 0.1 % less so, and the largest
# distance 0.3 %. Places between those looked at may add three times that.
GROWTH = 1.02
# Below this, in diagonals, no distance counts as larger than another: ten times what float32 resolves.
SMALLEST_DISTANCE = 1e-6


class ComponentLimits:
    """The limits of one mesh; what is paired by ``matching`` when they are made and later is what they hold for.

    Args:
        matching: pairs the input's key frames with those of the output as it lies.
        source: (K, V) vec3, the input's key frames.
        placed: (K, C) vec3, the output's as placed.
        corners: (N, 3) int32, the input's faces, as ``matching`` has them.
        vertex_map: (V,) int32, input vertex to output vertex.
        faces: (N', 3) int32, the output's.
        device: Warp device.

    Attributes:
        sampled: what :func:`warpqem.kernels.surface_limits.raise_limits` raises.
    """

    def __init__(
        self,
        matching: Matching,
        source: wp.array,
        placed: wp.array,
        corners: np.ndarray,
        vertex_map: np.ndarray,
        faces: np.ndarray,
        device: str,
    ) -> None:
        self._matching, self._device = matching, device
        self._source, self._placed = source, placed
        self._corners, self._vertex_map, self._faces = corners, vertex_map, faces
        vertex_count = placed.shape[1]
        lowest = lowest_members(vertex_count, faces[:, [0, 1, 1, 2]].reshape(-1, 2))
        self._component = np.unique(lowest[faces[:, 0]], return_inverse=True)[1]
        self.sampled = sampled = kernels.Limits()
        count = int(self._component.max(initial=-1)) + 1
        sampled.component = wp.array(self._component, dtype=wp.int32, device=device)
        sampled.squared, sampled.own_squared = (
            wp.full(count, SMALLEST_DISTANCE**2, dtype=wp.float32, device=device) for _ in range(2)
        )
        self._of_vertex = np.zeros(vertex_count, dtype=np.int32)
        self._of_vertex[faces] = self._component[:, None]
        of_input = np.where(vertex_map >= 0, self._of_vertex[vertex_map], -1).astype(np.int32)
        sampled.vertex_component = wp.array(of_input, dtype=wp.int32, device=device)
        sampled.far = new_arrays.zeros(vertex_count, dtype=wp.int32, device=device)
        self._own: _OwnParts | None = None

    def mark_far(self, moved: wp.array) -> wp.array:
        """(C,) int32 on the device, 1 at vertices of places further away than any of their component was as placed.

        Args:
            moved: (K, C) vec3, the key frames of the output as it lies now.
        """
        self.sampled.far.zero_()
        self._matching.note_far(kernels.mark_far_samples, self.sampled)
        if self._own is None:
            self._own = self._make_own_parts()
        self._own.mark_far(moved, self.sampled.far)
        return self.sampled.far

    def whole_components(self, marked: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """(C,) bool, all vertices of the components that some vertices (C,) bool are of."""
        is_marked = np.zeros(len(self.sampled.squared), dtype=bool)
        is_marked[self._component[marked[self._faces].any(axis=1)]] = True
        whole = np.zeros_like(marked)
        whole[self._faces[is_marked[self._component]]] = True
        return whole

    def _make_own_parts(self) -> _OwnParts:
        return _OwnParts(
            self._source,
            self._corners,
            self._vertex_map,
            self._placed,
            self._faces,
            self._of_vertex,
            self.sampled.own_squared,
            self._device,
        )


class _OwnParts:
    """How far components may be from their own parts of the input: what they were as placed, and a little more.

    Nothing of it comes to the host but which faces are large.

    Args:
        source: (K, V) vec3, key frames of the input.
        corners: (N, 3) int32, its faces.
        vertex_map: (V,) int32, input vertex to output vertex.
        placed: (K, C) vec3, the output as placed.
        faces: (N', 3) int32, its faces.
        component: (C,) int32, of each of its vertices.
        limits: (n,) float32 on the device, of each component: squared distances that it had at some samples as placed;
            kept, and raised to what it had at all places.
        device: Warp device.
    """

    def __init__(
        self,
        source: wp.array,
        corners: np.ndarray,
        vertex_map: np.ndarray,
        placed: wp.array,
        faces: np.ndarray,
        component: np.ndarray,
        limits: wp.array,
        device: str,
    ) -> None:
        self._device, self._limits = device, limits
        reference, self._lanes = (pack_frames(points, device) for points in (source, placed))
        vertex_count = placed.shape[1]
        around, around_output = FacesAround(corners, len(vertex_map)), FacesAround(faces, vertex_count)
        input_faces = input_side(reference, around, vertex_map, np.arange(len(corners)), vertex_count)
        output = Side(self._lanes, around_output, around_output)
        is_used = np.zeros(len(vertex_map), dtype=bool)
        is_used[corners] = True
        used = np.flatnonzero(is_used)
        large = corners[large_faces(reference, around, self._lanes, faces, device)]
        vertices: list[Places] = [
            InputVertices(reference, output, used, vertex_map[used]),
            SimplifiedVertices(self._lanes, input_faces, np.unique(faces), around_output),
        ]
        points_of_faces: list[Places] = [
            SampledFaces(reference, large, vertex_map[large], output, around_output),
            SampledFaces(self._lanes, faces, faces, input_faces, around_output),
        ]
        components = wp.array(component, dtype=wp.int32, device=device)
        # How far vertices are decides how closely points of faces are looked at.
        counts = [sum(one.count * one.points_of_each for one in places) for places in (vertices, points_of_faces)]
        nearest = new_arrays.full(sum(counts), -1, dtype=wp.int32, device=device)
        for places, part in ((vertices, nearest[: counts[0]]), (points_of_faces, nearest[counts[0] :])):
            _Look(places, components, part, device).raise_limits(limits)
        self._look = _Look([*vertices, *points_of_faces], components, nearest, device)

    def mark_far(self, moved: wp.array, marks: wp.array) -> None:
        """Mark (C,) vertices at places of (K, C) points further away than any of their component was as placed."""
        wp.copy(self._lanes, pack_frames(moved, self._device))
        self._look.mark_far(self._limits, marks)


class _Look:
    """Some places, the components that they are held to, and the faces of the other surface that they are near to."""

    def __init__(self, places: list[Places], component: wp.array, nearest: wp.array, device: str) -> None:
        self._places, self._nearest, self._device = [one for one in places if one.count], nearest, device
        self._groups: list[tuple[kernels.PlacesOfVertices, slice]] = []
        self._count = 0
        for one in self._places:
            group = kernels.PlacesOfVertices()
            group.vertex = wp.array(one.clusters.astype(np.int32), dtype=wp.int32, device=device)
            group.points, group.component = one.points_of_each, component
            first, self._count = self._count, self._count + one.count * one.points_of_each
            self._groups.append((group, slice(first, self._count)))

    def raise_limits(self, limits: wp.array) -> None:
        """Raise the squared limits (n,) of components to the largest squared distances of their places."""
        squared = self._distances(limits, 1.0)
        for group, points in self._groups:
            part = squared[points]
            launch(kernels.raise_own_limits, len(part), [group, part], [limits], device=self._device)

    def mark_far(self, limits: wp.array, marks: wp.array) -> None:
        """Mark vertices (C,) int32 of places that are further away than the squared limits (n,) and growth allow."""
        squared = self._distances(limits, GROWTH)
        for group, points in self._groups:
            part = squared[points]
            inputs = [group, part, limits, GROWTH]
            launch(kernels.mark_far_places, len(part), inputs, [marks], device=self._device)

    def _distances(self, limits: wp.array, growth: float) -> wp.array:
        """The squared distance of each point, no closer than its limit."""
        within = new_arrays.empty(self._count, dtype=wp.float32, device=self._device)
        for group, points in self._groups:
            part = within[points]
            launch(kernels.gather_limits, len(part), [group, limits, growth], [part], device=self._device)
        return squared_distances(self._places, within, self._device, self._nearest)
