"""Solve the normal equations of all corrections together, by preconditioned conjugate gradients on the device."""

from __future__ import annotations

import warp as wp

from warpqem.kernels import element_solve as kernels
from warpqem.runtime import new_arrays
from warpqem.runtime.launches import Recorder, launch
from warpqem.runtime.loops import DeviceLoop

__all__ = ["solve_elements"]

# The iteration stops where the preconditioned residual has fallen to this part of its start: corrections are a small
# part of an edge, so three digits are plenty.
TOLERANCE = 1e-3
MAX_STEPS = 200


def solve_elements(elements: kernels.Elements, corner_right: wp.array) -> wp.array:
    """The solution (C,) vec3.

    Args:
        elements: symmetric positive definite.
        corner_right: (3N',) vec3, the right side in parts, one for each corner of each face.
    """
    device = corner_right.device
    vertex_count = len(elements.adjacency_start) - 1
    state = kernels.Solve()
    state.x, state.residual, state.direction, state.image = (
        new_arrays.empty(vertex_count, dtype=wp.vec3, device=device) for _ in range(4)
    )
    state.inverse = new_arrays.empty(vertex_count, dtype=wp.mat33, device=device)
    state.slice_sum = new_arrays.empty(kernels.SLICES, dtype=wp.float64, device=device)
    state.scalar = new_arrays.zeros(4, dtype=wp.float64, device=device)
    state.report = new_arrays.zeros(2, dtype=wp.int32, device=device)
    launch(kernels.start_solve, vertex_count, [elements, corner_right, state], device=device)
    launch(kernels.sum_residual, kernels.SLICES, [state], device=device)
    launch(kernels.begin_steps, 1, [TOLERANCE**2, state], device=device)
    step = Recorder(str(device))
    step.launch(kernels.turn_direction, vertex_count, [state])
    step.launch(kernels.multiply_direction, vertex_count, [elements, state])
    step.launch(kernels.sum_curvature, kernels.SLICES, [state])
    step.launch(kernels.close_curvature, 1, [state])
    step.launch(kernels.step_forward, vertex_count, [state])
    step.launch(kernels.sum_residual, kernels.SLICES, [state])
    step.launch(kernels.end_step, 1, [MAX_STEPS, state])
    DeviceLoop(step, state.report, str(device)).run()
    return state.x
