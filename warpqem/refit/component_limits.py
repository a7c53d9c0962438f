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
    furthest_of,
    input_side,
    large_faces,
)
from warpqem.mesh.components import lowest_members
from warpqem.refit.matching import Matching
from warpqem.runtime.device import device_traits

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
        sampled.far = wp.zeros(len(faces), dtype=wp.int32, device=device)
        self._own: _OwnParts | None = None

    def far_vertices(self, moved: wp.array) -> npt.NDArray[np.bool_]:
        """(C,) bool, vertices of places that are further away than any of their component was as placed.

        Args:
            moved: (K, C) vec3, the key frames of the output as it lies now.
        """
        self.sampled.far.zero_()
        self._matching.note_far(kernels.mark_far_faces, self.sampled)
        if self._own is None:
            self._own = self._make_own_parts()
        marked = self._own.far_vertices(moved)
        marked[self._faces[self.sampled.far.numpy() != 0]] = True
        return marked

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
            np.sqrt(self.sampled.own_squared.numpy()),
            self._device,
        )


class _OwnParts:
    """How far components may be from their own parts of the input: what they were as placed, and a little more.

    Args:
        source: (K, V) vec3, key frames of the input.
        corners: (N, 3) int32, its faces.
        vertex_map: (V,) int32, input vertex to output vertex.
        placed: (K, C) vec3, the output as placed.
        faces: (N', 3) int32, its faces.
        component: (C,) int, of each of its vertices.
        limits: (n,) float32 of each component, in diagonals: distances that it had at some samples as placed; kept.
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
        limits: npt.NDArray[np.float32],
        device: str,
    ) -> None:
        self._device, self._corners, self._map, self._faces = device, corners, vertex_map, faces
        self._component, self._limits = component, limits
        vertex_count = placed.shape[1]
        self._reference, lanes = (pack_frames(points, device) for points in (source, placed))
        around, self._around_output = FacesAround(corners, len(vertex_map)), FacesAround(faces, vertex_count)
        self._input = input_side(self._reference, around, vertex_map, np.arange(len(corners)), vertex_count)
        is_used = np.zeros(len(vertex_map), dtype=bool)
        is_used[corners] = True
        self._vertex, self._kept = np.flatnonzero(is_used), np.unique(faces)
        self._large = corners[large_faces(self._reference, around, lanes, faces, device)]
        # How far vertices are decides how closely points of faces are looked at. Where the host would wait for that,
        # all are looked at together: it finds the same.
        every = self._places(lanes)
        for places in (every[:2], every[2:]) if device_traits(device).in_order else (every,):
            for one, distance in zip(places, self._distances(places), strict=True):
                np.maximum.at(limits, self._of(one), distance)
        limits *= GROWTH

    def far_vertices(self, moved: wp.array) -> npt.NDArray[np.bool_]:
        """(C,) bool, vertices at places that are further away than any of their component was as placed."""
        places = self._places(pack_frames(moved, self._device))
        marked = np.zeros(len(self._component), dtype=bool)
        for one, distance in zip(places, self._distances(places), strict=True):
            marked[one.clusters[distance > self._limit(one)]] = True
        return marked

    def _places(self, lanes: wp.array) -> list[Places]:
        """All places, with the output in ``lanes``: vertices first."""
        around, faces = self._around_output, self._faces
        output = Side(lanes, around, (around.start, around.face))
        return [
            InputVertices(self._reference, output, self._vertex, self._map[self._vertex]),
            SimplifiedVertices(lanes, self._input, self._kept, around),
            SampledFaces(self._reference, self._large, self._map[self._large], output, around),
            SampledFaces(lanes, faces, faces, self._input, around),
        ]

    def _distances(self, places: list[Places]) -> list[npt.NDArray[np.float32]]:
        return furthest_of(places, [self._limit(one) for one in places], self._device)

    def _of(self, places: Places) -> npt.NDArray[np.integer]:
        """The component of each place."""
        return self._component[places.clusters[:, 0]]

    def _limit(self, places: Places) -> npt.NDArray[np.float32]:
        """The limit of each place."""
        return self._limits[self._of(places)]
