"""The arguments of ``warpqem.simplify`` that are neither points nor faces, and whether they are in their ranges."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from warpqem.errors import OptionError

if TYPE_CHECKING:
    from warpqem.attributes import AttributeField
    from warpqem.face.protect import FaceProtection
    from warpqem.motion import MotionWeighting

__all__ = ["Goal", "SimplifyOptions", "check_ratio", "read_goal", "target_count"]


@dataclass(frozen=True)
class Goal:
    """Where simplifying ends.

    Attributes:
        target_faces: faces to keep; 0 to go on until the error limit.
        max_error: % of the diagonal; inf for none.
    """

    target_faces: int
    max_error: float


@dataclass(frozen=True)
class SimplifyOptions:
    """What decides the result of :func:`warpqem.simplify` for a mesh; the meaning of each is told there."""

    ratio: float | None = None
    target_faces: int | None = None
    max_error: float | None = None
    metric: str = "dsd"
    coherence: float = 0.5
    key_frames: int | None = 16
    placement: str = "optimal"
    refit: bool = False
    memoryless: bool = False
    vertex_weights: Any = None
    quadric_scale: Any = None
    locked: Any = None
    lock_borders: bool = False
    keep_components: bool = False
    seams: Any = None
    attributes: Sequence[AttributeField] = ()
    face: FaceProtection | None = None
    motion: MotionWeighting | None = None
    memory: int | str | None = None
    device: str | None = None

    def check(self) -> None:
        """Raise an OptionError for a number outside its range, or goals that are missing or exclude each other."""
        if self.ratio is None and self.target_faces is None and self.max_error is None:
            raise OptionError("one of ratio, target_faces and max_error is needed")
        if self.ratio is not None and self.target_faces is not None:
            raise OptionError(f"ratio {self.ratio} and target_faces {self.target_faces} exclude each other")
        if self.ratio is not None:
            check_ratio(self.ratio)
        if self.target_faces is not None and not _is_count(self.target_faces):
            raise OptionError(f"target_faces must be a whole number of at least 1, got {self.target_faces}")
        if self.max_error is not None and not 0.0 < self.max_error < math.inf:
            raise OptionError(f"max_error must be a positive number of % of the diagonal, got {self.max_error}")
        if not 0.0 <= self.coherence <= 1.0:
            raise OptionError(f"coherence must be in [0, 1], got {self.coherence}")
        if self.key_frames is not None and not _is_count(self.key_frames):
            raise OptionError(f"key_frames must be a whole number of at least 1, got {self.key_frames}")
        if self.placement not in ("optimal", "endpoint"):
            raise OptionError(f"placement must be 'optimal' or 'endpoint', got {self.placement!r}")

    def goal(self, face_count: int) -> Goal:
        """Where simplifying a mesh of so many faces ends."""
        return read_goal(face_count, self.ratio, self.target_faces, self.max_error)

    @property
    def refits(self) -> bool:
        """Whether the surface is fitted once more: vertices of the input are to stay what they are."""
        return bool(self.refit) and self.placement != "endpoint"


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
