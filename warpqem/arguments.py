"""Check the arguments of ``warpqem.simplify`` that are neither points nor faces."""

from __future__ import annotations

import math
from dataclasses import dataclass

from warpqem.errors import OptionError

__all__ = ["Goal", "check_options", "check_ratio", "read_goal", "target_count"]


@dataclass(frozen=True)
class Goal:
    """Where simplifying ends.

    Attributes:
        target_faces: faces to keep; 0 to go on until the error limit.
        max_error: % of the diagonal; inf for none.
    """

    target_faces: int
    max_error: float


def check_options(
    goal: tuple[float | None, int | None, float | None], coherence: float, key_frames: int | None, placement: str
) -> None:
    """Raise an OptionError for an option outside its range; ``goal`` is ratio, target_faces and max_error."""
    ratio, target_faces, max_error = goal
    if ratio is None and target_faces is None and max_error is None:
        raise OptionError("one of ratio, target_faces and max_error is needed")
    if ratio is not None and target_faces is not None:
        raise OptionError(f"ratio {ratio} and target_faces {target_faces} exclude each other")
    if ratio is not None:
        check_ratio(ratio)
    if target_faces is not None and not _is_count(target_faces):
        raise OptionError(f"target_faces must be a whole number of at least 1, got {target_faces}")
    if max_error is not None and not 0.0 < max_error < math.inf:
        raise OptionError(f"max_error must be a positive number of % of the diagonal, got {max_error}")
    if not 0.0 <= coherence <= 1.0:
        raise OptionError(f"coherence must be in [0, 1], got {coherence}")
    if key_frames is not None and not _is_count(key_frames):
        raise OptionError(f"key_frames must be a whole number of at least 1, got {key_frames}")
    if placement not in ("optimal", "endpoint"):
        raise OptionError(f"placement must be 'optimal' or 'endpoint', got {placement!r}")


def _is_count(value: float) -> bool:
    return math.isfinite(value) and value == int(value) and value >= 1


def check_ratio(ratio: float) -> None:
    """Raise an OptionError for a part of the faces that is none."""
    if not 0.0 < ratio <= 1.0:
        raise OptionError(f"ratio must be in (0, 1], got {ratio}")


def target_count(ratio: float, face_count: int) -> int:
    """The faces that a part of them is."""
    return max(1, round(ratio * face_count))


def read_goal(face_count: int, ratio: float | None, target_faces: int | None, max_error: float | None) -> Goal:
    """With an error limit alone, ordering goes on until the limit stops it."""
    target = int(target_faces or 0) if ratio is None else target_count(ratio, face_count)
    return Goal(target, math.inf if max_error is None else max_error)
