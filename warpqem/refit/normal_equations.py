"""The normal equations of a fit: made from pairs, solved with vertices held."""

from __future__ import annotations

import warp as wp

from warpqem.decimation.adjacency import Adjacency
from warpqem.kernels import refit as kernels
from warpqem.kernels.element_solve import Elements
from warpqem.refit.holds import Holds
from warpqem.refit.matching import Matching
from warpqem.refit.material_frames import MaterialBlock
from warpqem.refit.scales import FitSizes
from warpqem.refit.solve import ElementSolver
from warpqem.runtime import new_arrays
from warpqem.runtime.launches import launch

__all__ = ["NormalEquations"]

# Stiffness of corrections, relative to the area they stand for: along the surface, across it.
TANGENT_STIFFNESS = 0.001
NORMAL_STIFFNESS = 0.00008


class NormalEquations:
    """Those of all corrections of one mesh, on the device; the arrays take those of one pairing after the other.

    Args:
        corner_vertex: (3N',) int32 on the device, the faces.
        adjacency: corners around each vertex.
    """

    def __init__(self, corner_vertex: wp.array, adjacency: Adjacency) -> None:
        self._device, face_count = str(corner_vertex.device), len(corner_vertex) // 3
        self._face_count = face_count
        self._elements = elements = Elements()
        elements.corner_vertex = corner_vertex
        elements.adjacency_start, elements.adjacent_corner = adjacency.start, adjacency.corner
        # Blocks on the diagonal are filled in when they are solved.
        elements.block = new_arrays.empty((face_count, 9), dtype=wp.mat33, device=self._device)
        self._diagonal = new_arrays.empty((face_count, 3), dtype=wp.mat33, device=self._device)
        # Of each face by how much its corners are held.
        self._share = new_arrays.empty(face_count, dtype=wp.float32, device=self._device)
        # The right side at each corner.
        self._right = new_arrays.empty(3 * face_count, dtype=wp.vec3, device=self._device)
        self._solver = ElementSolver(elements)

    def assemble(
        self, matching: Matching, keys: MaterialBlock, sizes: FitSizes, correction: wp.array, far: float
    ) -> None:
        """Make them of the last pairs, found on the surface as it is corrected now, (C,) vec3.

        Pairs that lie ``far`` apart, in diagonals, count half.
        """
        launch(
            kernels.assemble_elements,
            dim=self._face_count,
            inputs=[
                self._elements.corner_vertex,
                matching.input_pairs,
                matching.input_start,
                matching.input_order,
                matching.output_pairs,
                sizes.values,
                keys.points,
                keys.frames,
                correction,
                1.0 / far**2,
            ],
            outputs=[self._elements.block, self._diagonal, self._share, self._right],
            device=self._device,
        )

    def solve(self, holds: Holds, wanted: wp.array | None = None) -> wp.array:
        """What solves them with vertices held as they are now, (C,) vec3; see :class:`ElementSolver`."""
        launch(
            kernels.hold_elements,
            dim=self._face_count,
            inputs=[
                self._elements.corner_vertex,
                self._diagonal,
                self._share,
                wp.vec3(TANGENT_STIFFNESS, TANGENT_STIFFNESS, NORMAL_STIFFNESS),
                holds.stiffness,
            ],
            outputs=[self._elements.block],
            device=self._device,
        )
        return self._solver.solve(self._right, wanted)
