"""The arguments of ``warpqem.simplify`` that are neither points nor faces, and whether they are in their ranges."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from warpqem.distance_limit import DistanceLimit
from warpqem.errors import OptionError
from warpqem.number_input import flag, real_number, shown, whole_number

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
        max_distance: in units of the points; inf for none.
    """

    target_faces: int
    max_error: float
    max_distance: float = math.inf

    @property
    def limit(self) -> DistanceLimit:
        """How far the result may be from the input."""
        return DistanceLimit(self.max_error / 100.0, self.max_distance)


@dataclass(frozen=True)
class SimplifyOptions:
    """What decides the result of :func:`warpqem.simplify` for a mesh; the meaning of each is told there."""

    ratio: float | None = None
    target_faces: int | None = None
    max_error: float | None = None
    max_distance: float | None = None
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

    def checked(self) -> SimplifyOptions:
        """The same with Python's own numbers and flags.

        Raises:
            OptionError: an option of the wrong type or outside its range; goals that are missing or exclude each other.
        """
        if (self.ratio, self.target_faces, self.max_error, self.max_distance) == (None, None, None, None):
            raise OptionError("one of ratio, target_faces, max_error and max_distance is needed")
        if self.ratio is not None and self.target_faces is not None:
            raise OptionError(f"ratio {self.ratio} and target_faces {self.target_faces} exclude each other")
        if not isinstance(self.metric, str):
            raise OptionError(f"metric must be the name of a cost model, got {shown(self.metric)}")
        if not isinstance(self.placement, str) or self.placement not in ("optimal", "endpoint"):
            raise OptionError(f"placement must be 'optimal' or 'endpoint', got {self.placement!r}")
        limit = "a positive number of % of the diagonal"
        return replace(
            self,
            ratio=None if self.ratio is None else check_ratio(self.ratio),
            target_faces=None if self.target_faces is None else whole_number(self.target_faces, "target_faces"),
            max_error=None
            if self.max_error is None
            else real_number(self.max_error, "max_error", limit, lambda value: 0.0 < value < math.inf),
            max_distance=None
            if self.max_distance is None
            else real_number(
                self.max_distance, "max_distance", "a positive length", lambda value: 0.0 < value < math.inf
            ),
            coherence=real_number(self.coherence, "coherence", "in [0, 1]", lambda value: 0.0 <= value <= 1.0),
            key_frames=None if self.key_frames is None else whole_number(self.key_frames, "key_frames"),
            attributes=_checked_fields(self.attributes),
            refit=flag(self.refit, "refit"),
            memoryless=flag(self.memoryless, "memoryless"),
            lock_borders=flag(self.lock_borders, "lock_borders"),
            keep_components=flag(self.keep_components, "keep_components"),
        )

    def goal(self, face_count: int) -> Goal:
        """Where simplifying a mesh of so many faces ends."""
        goal = read_goal(face_count, self.ratio, self.target_faces, self.max_error)
        return goal if self.max_distance is None else replace(goal, max_distance=self.max_distance)

    @property
    def bounded(self) -> bool:
        """Whether the distance to the input is limited."""
        return self.max_error is not None or self.max_distance is not None

    @property
    def refits(self) -> bool:
        """Whether the surface is fitted once more: vertices of the input are to stay what they are."""
        return bool(self.refit) and self.placement != "endpoint"


def _checked_fields(attributes: Any) -> tuple[AttributeField, ...]:
    # An iterator would be empty the second time it is looked at.
    if not isinstance(attributes, (list, tuple)):
        raise OptionError(f"attributes must be a list of AttributeField, got {shown(attributes)}")
    for index, field in enumerate(attributes):
        if not (hasattr(field, "values") and hasattr(field, "weight")):
            raise OptionError(f"attributes[{index}] must be an AttributeField, got {shown(field)}")
    return tuple(attributes)


def check_ratio(ratio: Any) -> float:
    """The part of the faces that is asked for.

    Raises:
        OptionError: it is none.
    """
    return real_number(ratio, "ratio", "in (0, 1]", lambda value: 0.0 < value <= 1.0)


def target_count(ratio: float, face_count: int) -> int:
    """The faces that a part of them is."""
    return max(1, round(ratio * face_count))


def read_goal(face_count: int, ratio: float | None, target_faces: int | None, max_error: float | None) -> Goal:
    """With an error limit alone, ordering goes on until the limit stops it."""
    target = int(target_faces or 0) if ratio is None else target_count(ratio, face_count)
    return Goal(target, math.inf if max_error is None else max_error)
