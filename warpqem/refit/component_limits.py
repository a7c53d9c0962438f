"""How far components of the output may be from the input: as far as they were as placed, in the key frames.

A component is held against the whole input, by samples that take turns over the key frames, and against its own part
of it, at places in all key frames. Parts that lie in each other are near to each other anywhere: only against its own
part a component that leaves its place is seen to.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.kernels import surface_limits as kernels
from warpqem.mesh.components import lowest_members
from warpqem.mesh.grouping import ranks
from warpqem.mesh.indexing import put_at, taken
from warpqem.refit.matching import Matching
from warpqem.refit.own_parts import OwnParts
from warpqem.runtime import new_arrays

__all__ = ["ComponentLimits"]

# Below this, in diagonals, no distance counts as larger than another: ten times what float32 resolves.
SMALLEST_DISTANCE = 1e-6


class ComponentLimits:
    """The limits of one mesh; what is paired by ``matching`` when they are made and later is what they hold for.

    Args:
        matching: pairs the input's key frames with those of the output as it lies.
        source: (K, V) vec3, the input's key frames.
        placed: (K, C) vec3, the output's as placed.
        corners: (N, 3) int32, the input's faces, as ``matching`` has them.
        used: (U,) int, the vertices that these have, ascending.
        vertex_map: (V,) int32, input vertex to output vertex.
        faces: (N', 3) int32, the output's.
        frame_scale: (K,) float32 on the device, what multiplies the distances of each key frame from a component's own
            part.
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
        used: np.ndarray,
        vertex_map: np.ndarray,
        faces: np.ndarray,
        frame_scale: wp.array,
        device: str,
    ) -> None:
        self._matching, self._device = matching, device
        self._source, self._placed = source, placed
        self._corners, self._used, self._vertex_map, self._faces = corners, used, vertex_map, faces
        vertex_count = placed.shape[1]
        lowest = lowest_members(vertex_count, np.concatenate([faces[:, :2], faces[:, 1:]]))
        # Numbers in the order of their lowest vertices.
        self._component = ranks(taken(lowest, faces[:, 0]), vertex_count)
        self.sampled = sampled = kernels.Limits()
        count = int(self._component.max(initial=-1)) + 1
        sampled.frame_scale = frame_scale
        sampled.component = new_arrays.uploaded(self._component, dtype=wp.int32, device=device)
        sampled.squared, sampled.own_squared = (
            new_arrays.full(count, SMALLEST_DISTANCE**2, dtype=wp.float32, device=device) for _ in range(2)
        )
        self._of_vertex = np.zeros(vertex_count, dtype=np.int32)
        for corner in faces.T:
            put_at(self._of_vertex, corner, self._component)
        # The last place is of vertices without a face.
        of_input = taken(np.append(self._of_vertex, np.int32(-1)), vertex_map)
        sampled.vertex_component = new_arrays.uploaded(of_input, dtype=wp.int32, device=device)
        sampled.far = new_arrays.zeros(vertex_count, dtype=wp.int32, device=device)
        self._own: OwnParts | None = None
        self._room: int | None = None

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

    @property
    def large_count(self) -> wp.array | None:
        """(1,) int32 on the device: what :meth:`mark_far` may not have had room for; None where it has."""
        return None if self._own is None else self._own.large_count

    @property
    def room(self) -> int:
        """What :meth:`mark_far` had room for, at least."""
        return 0 if self._own is None else self._own.room

    def make_room(self, large_count: int) -> None:
        """Have room for so many large faces; places are then to be looked at again."""
        self._own, self._room = None, large_count

    def whole_components(self, marked: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """(C,) bool, all vertices of the components that some vertices (C,) bool are of."""
        is_marked = np.zeros(len(self.sampled.squared), dtype=bool)
        is_marked[self._component[marked[self._faces].any(axis=1)]] = True
        whole = np.zeros_like(marked)
        whole[self._faces[is_marked[self._component]]] = True
        return whole

    def _make_own_parts(self) -> OwnParts:
        return OwnParts(
            self._source,
            self._corners,
            self._used,
            self._vertex_map,
            self._placed,
            self._faces,
            self._of_vertex,
            self.sampled.own_squared,
            self.sampled.frame_scale,
            self._device,
            self._room,
        )
