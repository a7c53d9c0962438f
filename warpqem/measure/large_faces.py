"""Faces of an input that are larger than those of a simplified mesh: nothing says that what lies over them is near."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.kernels import large_faces as kernels
from warpqem.measure.face_lists import FacesAround, uploaded
from warpqem.measure.far_points import longest_edges, longest_edges_there
from warpqem.runtime import new_arrays
from warpqem.runtime.launches import launch

__all__ = ["LargeFaces", "large_faces"]

# Faces of the input whose longest edge in any frame is so many times the mean of those of the simplified mesh have
# points of their own. With 0.7 times the same spots are found.
LARGE = 1.5
# Where the host would wait for their number there is room for so many, or for one of so many faces of the input.
ROOM, FACES_PER_ROOM = 512, 32


def large_faces(
    reference: wp.array, around: FacesAround, test: wp.array, faces: npt.NDArray[np.integer], device: str
) -> npt.NDArray[np.int64]:
    """The input's faces, of blocks ``reference``, that are larger than those of a simplified mesh, ``test``."""
    own, simplified = longest_edges([(reference, around.corner_vertex.reshape(-1, 3)), (test, faces)], device)
    return np.flatnonzero(own > LARGE * float(simplified.mean()))


class LargeFaces:
    """The same listed on a device, of which the host asks later.

    Args:
        reference: (V, B) blocks of points of the input.
        around: its faces.
        test: blocks of points of the simplified mesh.
        faces: (N', 3) int, its faces.
        cluster: (V,) int32, the cluster of each input vertex, on the host or the device.
        room: faces that there is room for; None for as many as there mostly are.
        device: Warp device.

    Attributes:
        rows: (1 + R,) int32 on the device, how many there are, then each of them as far as there is room.
        corners: (R, 3) int32 on the device, their corners; 0 in rows without a face.
        clusters: (R, 3) int32 on the device, the clusters of these; -1 in rows without a face.
    """

    def __init__(
        self,
        reference: wp.array,
        around: FacesAround,
        test: wp.array,
        faces: npt.NDArray[np.integer],
        cluster: npt.NDArray[np.integer] | wp.array,
        device: str,
        room: int | None = None,
    ) -> None:
        count = len(around.corner_vertex) // 3
        self.room = min(count, max(ROOM, count // FACES_PER_ROOM) if room is None else room)
        corners = around.corner_vertex.reshape(-1, 3)
        own, simplified = longest_edges_there([(reference, corners), (test, faces)], device)
        totals = new_arrays.empty(int(kernels.SLICES), dtype=wp.float64, device=device)
        length = new_arrays.empty(1, dtype=wp.float32, device=device)
        launch(kernels.sum_lengths, len(totals), [simplified], [totals], device=device)
        launch(kernels.scale_sum, 1, [totals, LARGE / max(1, len(faces))], [length], device=device)
        before = new_arrays.empty(count, dtype=wp.int32, device=device)
        launch(kernels.mark_longer, count, [own, length], [before], device=device)
        wp.utils.array_scan(before, before, inclusive=True)
        self.rows, self.corners = (
            new_arrays.zeros(shape, dtype=wp.int32, device=device) for shape in (1 + self.room, (self.room, 3))
        )
        self.clusters = new_arrays.full((self.room, 3), -1, dtype=wp.int32, device=device)
        there = uploaded(cluster, device)
        inputs, outputs = [around.corners(device), there, before], [self.rows, self.corners, self.clusters]
        launch(kernels.list_longer, count, inputs, outputs, device=device)

    def leave_out_others(self, within: wp.array, points_of_each: int) -> None:
        """Make limits (R n,) of n points of each face negative in rows without a face."""
        inputs = [self.rows, points_of_each]
        launch(kernels.leave_out_others, len(within), inputs, [within], device=within.device)

    def rows_of_corners(self, row: npt.NDArray[np.int32], corner_of_point: npt.NDArray[np.integer]) -> wp.array:
        """(R, S) int32 on the device, the row (V,) of the corner that each of S points of a face is nearest to."""
        device, shape = self.rows.device, (self.room, len(corner_of_point))
        inputs = [new_arrays.uploaded(values, dtype=wp.int32, device=device) for values in (row, corner_of_point)]
        found = new_arrays.empty(shape, dtype=wp.int32, device=device)
        launch(kernels.rows_of_corners, shape, [self.corners, *inputs], [found], device=device)
        return found
