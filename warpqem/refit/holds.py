"""How far vertices are held to where they were placed, more each time that they are marked; all on the device."""

from __future__ import annotations

import numpy as np
import warp as wp

from warpqem.kernels import refit as kernels
from warpqem.runtime import new_arrays
from warpqem.runtime.launches import launch

__all__ = ["Holds"]

# Stiffness along the surface of a vertex of a seam, relative to others. Across seams their fit to those of the input
# holds it, along them nothing else. With 250 characters have 1 % more of the distance, and of the texture error.
SEAM_STIFFNESS = 5.0
# A vertex that turns a face over gets so much more stiffness; where it still does, it does not move.
HOLD = 30.0
# The stiffness of a vertex that does not move, for its neighbours to be solved with.
MAX_HOLD = 1e6


class Holds:
    """The holds of the vertices of one mesh.

    Args:
        on_seam: (C,) bool, vertices of seams.
        device: Warp device.

    Attributes:
        stiffness: (C,) vec3, what multiplies the stiffness of each coordinate of a correction.
        any_marked: (1,) int32, whether any vertex was marked the last time.
    """

    def __init__(self, on_seam: np.ndarray, device: str) -> None:
        self._device, self._count = device, len(on_seam)
        own = np.ones((self._count, 3), dtype=np.float32)
        own[on_seam, :2] = SEAM_STIFFNESS
        self._own, self.stiffness = (new_arrays.uploaded(own, dtype=wp.vec3, device=device) for _ in range(2))
        self._held = new_arrays.full(self._count, 1.0, dtype=wp.float32, device=device)
        self.any_marked = new_arrays.zeros(1, dtype=wp.int32, device=device)

    def hold(self, marks: wp.array) -> None:
        """Hold vertices marked in (C,) int32 more than before, and at last for good."""
        self.any_marked.zero_()
        inputs = [marks, self._own, HOLD, MAX_HOLD]
        outputs = [self._held, self.stiffness, self.any_marked]
        launch(kernels.raise_holds, self._count, inputs, outputs, device=self._device)

    def take(self, solution: wp.array, correction: wp.array) -> None:
        """Make corrections (C,) vec3 those of a solution if any vertex was marked; none of those held for good."""
        inputs = [self.any_marked, self._held, solution]
        launch(kernels.take_held, self._count, inputs, [correction], device=self._device)
