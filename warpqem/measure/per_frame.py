"""Errors of a simplified mesh in each frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from warpqem.arguments.array_record import ArrayRecord

__all__ = ["FrameErrors"]


@dataclass(frozen=True, eq=False, repr=False)
class FrameErrors(ArrayRecord):
    """Errors per evaluated frame, arrays of shape (K,); distances in % of the reference's diagonal in that frame.

    Where the nearest point lies on an edge, its faces are equally near and any of them may count as the nearest: normal
    deviation and flips have that uncertainty (about 0.05 % and 1 %), distances do not.

    Attributes:
        frame: frame indices, int64.
        hausdorff: largest distance of any point, both directions; at most 0.1 % above that of a point.
        mean: average of the mean distances of the two directions.
        rms: larger of the root mean square distances of the two directions; which one is larger, neighbouring frames
            decide together where there are few samples in each.
        rms_forward: root mean square distance from the reference to the test mesh.
        rms_backward: root mean square distance from the test to the reference mesh.
        normal_deviation: mean angle in degrees between a sample's face normal and that of the nearest face, averaged
            over both directions.
        flips: test faces whose normal opposes that of the reference face nearest to their centroid, int64. A sheet with
            both sides, and faces whose winding is unlike that around them (:mod:`warpqem.measure.winding`), have either
            normal; the two sides of a sheet of the test mesh oppose nothing. The same holds for normal deviation.
        degenerate_faces: test faces with less area than 1e-14 squared diagonals, int64.
    """

    frame: npt.NDArray[np.int64]
    hausdorff: npt.NDArray[np.float64]
    mean: npt.NDArray[np.float64]
    rms: npt.NDArray[np.float64]
    rms_forward: npt.NDArray[np.float64]
    rms_backward: npt.NDArray[np.float64]
    normal_deviation: npt.NDArray[np.float64]
    flips: npt.NDArray[np.int64]
    degenerate_faces: npt.NDArray[np.int64]
