"""How large an error looks on a screen, and how large it may be to look so."""

from __future__ import annotations

import math
from dataclasses import MISSING, dataclass

from warpqem.arguments.limits import ABOVE_0, COUNT, Limits
from warpqem.arguments.option_fields import check_options, option

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

    error: float = option(
        MISSING, "Largest error in pixels, seen from --distance.", "PX", ABOVE_0, name="screen_error", panel="Goal"
    )
    distance: float = option(
        MISSING,
        "With --screen-error: from the camera to the mesh, in units of the stage.",
        "UNITS",
        ABOVE_0,
        panel="Goal",
    )
    field_of_view: float = option(
        45.0,
        "With --screen-error: vertical field of view, in degrees.",
        "DEG",
        Limits(0.0, 180.0, True, True),
        name="fov",
        panel="Goal",
    )
    image_height: int = option(
        1080, "With --screen-error: height of the picture, in pixels.", "PX", COUNT, panel="Goal"
    )

    def __post_init__(self) -> None:
        """Refuse views that show nothing."""
        check_options(self)

    @property
    def length(self) -> float:
        """The length at that distance, across the line of sight, that the error in pixels covers."""
        height = 2.0 * self.distance * math.tan(math.radians(self.field_of_view) / 2.0)
        return self.error * height / self.image_height
