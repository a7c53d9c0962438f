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
        self._is_collapse, removed = np.ones(len(log), dtype=bool), log.faces_removed
        if len(drops):
            when = np.concatenate([2 * np.arange(len(log)) + 1, 2 * drops.collapse_count])
            step = np.argsort(when, kind="stable")
            self._is_collapse = step < len(log)
            removed = np.concatenate([log.faces_removed, drops.face_count])[step]
        self._face_count = face_count
        # Before each step, and after the last one.
        self._removed = np.zeros(len(removed) + 1, dtype=np.int64)
        np.cumsum(removed, out=self._removed[1:])

    def __len__(self) -> int:
        return len(self._is_collapse)

    def to(self, target_faces: int) -> int:
        """The least number of steps that leaves so many faces or fewer; all of them where none does."""
        return min(int(np.searchsorted(self._removed, self._face_count - target_faces)), len(self))

    def counts(self, step_count: int) -> tuple[int, int]:
        """How many collapses and drops the first steps are."""
        collapses = int(np.count_nonzero(self._is_collapse[:step_count]))
        return collapses, step_count - collapses
