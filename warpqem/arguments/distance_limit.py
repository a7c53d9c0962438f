"""How far a result may be from its input: as a part of the diagonal, as a length, or both."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from warpqem.errors import OptionError

__all__ = ["SINGLE_PRECISION", "DistanceLimit"]

# Half a unit in the last place of a coordinate as long as the diagonal, in single precision: points of a result are
# placed no better, wherever the mesh is.
SINGLE_PRECISION = 2.0**-24


# What is proved is the limit divided by this: the measured largest distance is up to a thousandth above that of a point
# (`warpqem.kernels.largest_distance`), and is not to be above the limit either.
MEASURED_ABOVE = 1.0011


@dataclass(frozen=True)
class DistanceLimit:
    """The smaller of two limits.

    Attributes:
        part: of the diagonal of the input's bounding box in each frame; inf for none.
        length: in units of the points; inf for none.
    """

    part: float = math.inf
    length: float = math.inf

    def __bool__(self) -> bool:
        return math.isfinite(self.part) or math.isfinite(self.length)

    def __str__(self) -> str:
        named = {"max_error": (100.0 * self.part, " %"), "max_distance": (self.length, "")}
        return " and ".join(f"{name} {value:g}{unit}" for name, (value, unit) in named.items() if math.isfinite(value))

    def check_provable(self) -> None:
        """To be called where nothing could be removed within the limit.

        Raises:
            OptionError: it is a part of the diagonal that single precision does not resolve.
        """
        if self.part < SINGLE_PRECISION:
            raise OptionError(
                f"{self}: nothing can be removed within it, as single precision places points to "
                f"{100 * SINGLE_PRECISION:.1g} % of the diagonal at best"
            )

    def relative(self, diagonal: float) -> float:
        """What is to be proved in a frame with that diagonal, as a part of it: a little less than the limit."""
        return self._relative(diagonal) / MEASURED_ABOVE

    def is_below(self, part: float, length: float) -> bool:
        """Whether a distance, as a part of the diagonal and in units, is above it."""
        return part > self.part or length > self.length

    def _relative(self, diagonal: float) -> float:
        return min(self.part, self.length / diagonal)

    def units(self, diagonals: npt.NDArray[np.float64], largest: float) -> npt.NDArray[np.float64]:
        """The length in each frame, (n,), in which its limit is that of the largest diagonal: no less than its own."""
        return np.minimum(self.part * diagonals, self.length) / self._relative(largest)
