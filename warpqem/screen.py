"""How large an error looks on a screen, and how large it may be to look so."""

from __future__ import annotations

import math
from dataclasses import dataclass

from warpqem.errors import OptionError

__all__ = ["ScreenView"]


@dataclass(frozen=True)
class ScreenView:
    """An error in pixels, seen by a pinhole camera.

    Attributes:
        error: Pixels.
        distance: From the camera to the mesh, in the units of its points.
        field_of_view: Vertical, in degrees.
        image_height: Pixels.
    """

    error: float
    distance: float
    field_of_view: float = 45.0
    image_height: int = 1080

    def __post_init__(self) -> None:
        """Refuse views that show nothing."""
        for name in ("error", "distance", "image_height"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise OptionError(f"screen {name.replace('_', ' ')} {getattr(self, name):g}: expected a number above 0")
        if not 0.0 < self.field_of_view < 180.0:
            raise OptionError(f"field of view {self.field_of_view:g}: expected degrees between 0 and 180")

    @property
    def length(self) -> float:
        """The length at that distance, across the line of sight, that the error in pixels covers."""
        height = 2.0 * self.distance * math.tan(math.radians(self.field_of_view) / 2.0)
        return self.error * height / self.image_height
