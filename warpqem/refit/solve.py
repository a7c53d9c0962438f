"""Solve the normal equations of all corrections together, by preconditioned conjugate gradients on the device."""

from __future__ import annotations

import warp as wp

from warpqem.kernels import element_solve as kernels
from warpqem.runtime import new_arrays
from warpqem.runtime.launches import Recorder, launch
from warpqem.runtime.loops import DeviceLoop

__all__ = ["ElementSolver"]

# The iteration stops where the preconditioned residual has fallen to this part of its start: corrections are a small
# part of an edge, so three digits are plenty.
TOLERANCE = 1e-3
MAX_STEPS = 200


class ElementSolver:
    """Solves systems of the same elements, one after another, on the device: the host waits for none of them.

    Args:
        elements: symmetric positive definite when they are solved; the blocks may change from one time to the next.
    """

    def __init__(self, elements: kernels.Elements) -> None:
        device = elements.block.device
        self._elements, self._vertex_count = elements, len(elements.adjacency_start) - 1
        self._state = state = kernels.Solve()
        state.x, state.residual, state.direction, state.image = (
            new_arrays.empty(self._vertex_count, dtype=wp.vec3, device=device) for _ in range(4)
        )
        state.inverse = new_arrays.empty(self._vertex_count, dtype=wp.mat33, device=device)
        state.slice_sum = new_arrays.empty(kernels.SLICES, dtype=wp.float64, device=device)
        state.scalar = new_arrays.zeros(4, dtype=wp.float64, device=device)
        state.report = new_arrays.zeros(2, dtype=wp.int32, device=device)
        step = Recorder(str(device))
        step.launch(kernels.turn_direction, self._vertex_count, [state])
        step.launch(kernels.multiply_direction, self._vertex_count, [elements, state])
        step.launch(kernels.sum_curvature, kernels.SLICES, [state])
        step.launch(kernels.close_curvature, 1, [state])
        step.launch(kernels.step_forward, self._vertex_count, [state])
        step.launch(kernels.sum_residual, kernels.SLICES, [state])
        step.launch(kernels.end_step, 1, [MAX_STEPS, state])
        # A graph must not end before its work does, so it is kept for all systems.
        self._loop = DeviceLoop(step, state.report, str(device))
        self._always = new_arrays.full(1, 1, dtype=wp.int32, device=device)

    def solve(self, corner_right: wp.array, wanted: wp.array | None = None) -> wp.array:
        """The solution (C,) vec3 of the elements as they are now, until the next one is asked for.

        Args:
            corner_right: (3N',) vec3, the right side in parts, one for each corner of each face.
            wanted: (1,) int32, 0 where the solution is not wanted: it then is zero, and takes next to no time.
        """
        state, device = self._state, corner_right.device
        launch(kernels.start_solve, self._vertex_count, [self._elements, corner_right, state], device=device)
        launch(kernels.sum_residual, kernels.SLICES, [state], device=device)
        wanted = self._always if wanted is None else wanted
        launch(kernels.begin_steps, 1, [TOLERANCE**2, wanted, state], device=device)
        self._loop.complete()
        return state.x
