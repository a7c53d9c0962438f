"""What a file that was built from USD says of its stage: entries of the header, checked as they are read."""

from __future__ import annotations

import itertools
import math
import reprlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from warpqem.errors import ProgressiveFileError

__all__ = ["StageNotes", "StageUnits"]


@dataclass(frozen=True)
class StageUnits:
    """Metadata of a stage.

    Attributes:
        up_axis: "Y" or "Z".
        metres_per_unit, time_codes_per_second, frames_per_second: finite numbers.
    """

    up_axis: str
    metres_per_unit: float
    time_codes_per_second: float
    frames_per_second: float


@dataclass(frozen=True)
class StageNotes:
    """The entries that ``warpqem progressive build`` adds.

    Attributes:
        where: what messages call the file.
        extra: the entries; others may be among them, and any may be missing.
        frame_count: frames of the mesh.
    """

    where: str
    extra: Mapping[str, Any]
    frame_count: int

    def prim(self) -> str:
        """Path of the prim that the mesh was, as it stands there.

        Raises:
            ProgressiveFileError: there is none; as all others.
        """
        value: str = self._of_type("prim", self._entry("prim"), str, "text")
        return value

    def diagonal(self) -> float:
        """The largest diagonal of a frame's bounding box, in the units of the stage, above 0."""
        value = self._number("diagonal", self._entry("diagonal"))
        if value <= 0.0:
            raise self._error("diagonal", value, "a number above 0")
        return value

    def times(self) -> list[float] | None:
        """Ascending time codes, one for each frame; None for the default time of a mesh that does not move."""
        value = self._entry("times")
        if value is None and self.frame_count == 1:
            return None
        found = [self._number("times", one) for one in self._of_type("times", value, list, "a list")]
        if len(found) != self.frame_count:
            raise ProgressiveFileError(f"{self.where}: there are {len(found)} times and {self.frame_count} frames")
        for before, after in itertools.pairwise(found):
            if not before < after:
                raise ProgressiveFileError(f"{self.where}: time {after:g} comes after time {before:g}")
        return found

    def units(self) -> StageUnits:
        """The metadata of the stage."""
        entries = self._of_type("stage", self._entry("stage"), dict, "an object")
        wanted = ("up_axis", "metres_per_unit", "time_codes_per_second", "frames_per_second")
        missing = [name for name in wanted if name not in entries]
        if missing:
            raise ProgressiveFileError(f"{self.where}: the stage in it has no {missing[0]}")
        axis, *numbers = (entries[name] for name in wanted)
        if axis not in ("Y", "Z"):
            raise self._error("up_axis", axis, "Y or Z")
        return StageUnits(axis, *map(self._number, wanted[1:], numbers))

    def _entry(self, name: str) -> Any:
        if name not in self.extra:
            raise ProgressiveFileError(f"{self.where}: there is no {name} in it; was it built from USD?")
        return self.extra[name]

    def _of_type(self, name: str, value: Any, kind: type, wanted: str) -> Any:
        if not isinstance(value, kind):
            raise self._error(name, value, wanted)
        return value

    def _number(self, name: str, value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise self._error(name, value, "a finite number")
        return float(value)

    def _error(self, name: str, value: object, wanted: str) -> ProgressiveFileError:
        return ProgressiveFileError(f"{self.where}: {name} {reprlib.repr(value)} in it is not {wanted}")
