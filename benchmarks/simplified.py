"""What a contender returns, on disk and in memory: one topology for all frames, or one for each."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

__all__ = ["Simplified", "load_simplified", "save_simplified"]


@dataclass(frozen=True)
class Simplified:
    """Simplified frames.

    Attributes:
        points: (V', 3) per frame.
        faces: (N', 3) per frame; a single entry where all frames share it.
    """

    points: list[NDArray[np.floating]]
    faces: list[NDArray[np.integer]]

    @property
    def shares_topology(self) -> bool:
        """Whether one list of faces serves all frames."""
        return len(self.faces) == 1


def save_simplified(result: Simplified, path: Path) -> None:
    """Write an ``.npz`` that :func:`load_simplified` reads."""
    np.savez(
        path,
        points=np.concatenate(result.points),
        faces=np.concatenate(result.faces),
        point_counts=[len(p) for p in result.points],
        face_counts=[len(f) for f in result.faces],
    )


def load_simplified(path: Path) -> Simplified:
    """Read what :func:`save_simplified` wrote."""
    with np.load(path) as stored:
        return Simplified(
            np.split(stored["points"], np.cumsum(stored["point_counts"])[:-1]),
            np.split(stored["faces"], np.cumsum(stored["face_counts"])[:-1]),
        )
