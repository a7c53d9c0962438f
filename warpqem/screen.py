"""How large an error looks on a screen, and how large it may be to look so."""

from __future__ import annotations

import math
from dataclasses import dataclass

from warpqem.number_input import real_number

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
            value, what = getattr(self, name), f"screen {name.replace('_', ' ')}"
            real_number(value, what, "a number above 0", lambda x: 0.0 < x < math.inf)
        real_number(self.field_of_view, "field of view", "degrees between 0 and 180", lambda x: 0.0 < x < 180.0)

    @property
    def length(self) -> float:
        """The length at that distance, across the line of sight, that the error in pixels covers."""
        height = 2.0 * self.distance * math.tan(math.radians(self.field_of_view) / 2.0)
        return self.error * height / self.image_height
