"""Share a face budget between meshes.

Every mesh is simplified once, as far as it goes, to learn what its collapses cost. The budget is then spent where a
face saves the most error: all meshes stop at the same cost of the next collapse (equal marginal cost, the condition for
the least total error).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["CostCurve", "split_budget"]


@dataclass(frozen=True)
class CostCurve:
    """What simplifying one mesh costs, in units that are the same for all meshes of a stage.

    Attributes:
        face_count: Faces before the first collapse.
        cost: float64, shape (C,), cost of each collapse in order of application: squared distance times area, averaged
            over the frames, in world units to the fourth power.
        faces_removed: int64, shape (C,), faces each collapse removed.
        weight: What a face of it counts in the budget: 1, or the share of the frames that a run of constant topology
            has, of a mesh whose topology varies over time.
        input_faces: Faces of the mesh as the input has it, with those that repeat others and go for nothing, of which
            shares are taken; None for as many as `face_count`.
    """

    face_count: int
    cost: npt.NDArray[np.float64]
    faces_removed: npt.NDArray[np.int64]
    weight: float = 1.0
    input_faces: int | None = None

    @property
    def counted_faces(self) -> float:
        """What its faces are of those of the stage as the input has them."""
        return self.weight * (self.face_count if self.input_faces is None else self.input_faces)

    @classmethod
    def from_log(
        cls,
        face_count: int,
        cost: npt.NDArray[np.float32],
        faces_removed: npt.NDArray[np.int32],
        unit_length: float,
        frame_count: int,
        weight: float = 1.0,
        input_faces: int | None = None,
    ) -> CostCurve:
        """Bring the costs of a collapse log to world units.

        Args:
            face_count: Faces before the first collapse.
            cost: float32, shape (C,), squared distance times area, summed over frames, at unit bounding-box diagonal.
            faces_removed: int32, shape (C,).
            unit_length: World length of the bounding-box diagonal that the log takes as 1.
            frame_count: Frames the cost is summed over.
            weight: See above.
            input_faces: See above.
        """
        # Squared distance times area is a length to the fourth power.
        scale = unit_length**4 / frame_count
        return cls(face_count, cost.astype(np.float64) * scale, faces_removed.astype(np.int64), weight, input_faces)


def split_budget(curves: Sequence[CostCurve], budget: int) -> list[int]:
    """Face count of each mesh so that all together have at most `budget` faces at the least total cost.

    A collapse that is cheaper than one before it comes for free once that one is done, so the running maximum of the
    cost decides. Ties go to the mesh that comes first.

    Args:
        curves: One curve for each mesh.
        budget: Faces of all meshes together.

    Returns:
        One face count for each mesh. Their weighted sum is at most `budget`, less by no more than one collapse removes,
        or the least that the curves reach.
    """
    face_counts = np.array([curve.face_count for curve in curves], dtype=np.int64)
    weights = np.array([curve.weight for curve in curves])
    surplus = float((weights * face_counts).sum()) - budget
    if surplus <= 0 or not curves:
        return face_counts.tolist()
    marginal = np.concatenate([np.maximum.accumulate(curve.cost) for curve in curves])
    removed = np.concatenate([curve.faces_removed for curve in curves])
    owner = np.repeat(np.arange(len(curves)), [len(curve.cost) for curve in curves])
    # A stable sort keeps the order of application within each mesh, where the running maximum never falls.
    order = np.argsort(marginal, kind="stable")
    total = np.cumsum((removed * weights[owner])[order])
    spent = order[: int(np.searchsorted(total, surplus)) + 1]
    np.subtract.at(face_counts, owner[spent], removed[spent])
    return face_counts.tolist()
