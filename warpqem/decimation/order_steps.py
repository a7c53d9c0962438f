"""The steps of an order: collapses and prunings as they came, and the faces that each leaves."""

from __future__ import annotations

import numpy as np

from warpqem.decimation.collapse_log import CollapseRecord
from warpqem.decimation.pruning import DropRecord

__all__ = ["OrderSteps"]


class OrderSteps:
    """All steps from the input to what ordering left.

    Args:
        log: the collapses.
        drops: the pruned components.
        face_count: faces of the input.
    """

    def __init__(self, log: CollapseRecord, drops: DropRecord, face_count: int) -> None:
        when = np.concatenate([2 * np.arange(len(log)) + 1, 2 * drops.collapse_count])
        step = np.argsort(when, kind="stable")
        self._is_collapse = step < len(log)
        removed = np.concatenate([log.faces_removed, drops.face_count])[step]
        self._left = face_count - np.concatenate([[0], np.cumsum(removed, dtype=np.int64)])

    def __len__(self) -> int:
        return len(self._is_collapse)

    def to(self, target_faces: int) -> int:
        """The least number of steps that leaves so many faces or fewer; all of them where none does."""
        return min(int(np.searchsorted(-self._left, -target_faces)), len(self))

    def counts(self, step_count: int) -> tuple[int, int]:
        """How many collapses and drops the first steps are."""
        collapses = int(np.count_nonzero(self._is_collapse[:step_count]))
        return collapses, step_count - collapses
