"""Good, look or poor: what the measured errors of a simplified mesh mean to somebody who looks at it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from warpqem.arguments.figures import rounded_up

if TYPE_CHECKING:
    from warpqem.measure.measured import Measured

__all__ = ["GOOD", "LIMITS", "LOOK", "POOR", "WARNING_DISTANCE", "WORDS", "Limit", "Verdict", "rank", "verdict_of"]

GOOD, LOOK, POOR = "good", "look", "poor"
# The worst first.
WORDS = (POOR, LOOK, GOOD)

# A command warns where a point ends further off than this, in % of the diagonal.
WARNING_DISTANCE = 2.0


@dataclass(frozen=True)
class Limit:
    """Where a measured error stops to be good, and where it becomes poor.

    Attributes:
        name: what tables call the error.
        value: takes it from the measured errors.
        look: above this the mesh is worth a look.
        poor: above this it is poor.
        unit: stands behind the numbers.
        sentence: why the limits are where they are.
    """

    name: str
    value: Callable[[Measured], float]
    look: float
    poor: float
    unit: str
    sentence: str


# The one place of the limits; docs/glossary.md repeats them, which a test holds.
LIMITS = (
    Limit(
        "RMS",
        lambda errors: errors.rms,
        0.1,
        0.5,
        "%",
        "Where the mesh fills a picture of 1000 pixels from corner to corner, 0.1 % is one pixel and 0.5 % five.",
    ),
    Limit(
        "Hausdorff",
        lambda errors: errors.hausdorff,
        1.0,
        WARNING_DISTANCE,
        "%",
        "A single spot that is 10 of those 1000 pixels off is seen when looked for; 20 pixels change the outline.",
    ),
    Limit(
        "flips",
        lambda errors: 100.0 * errors.flips / errors.test_faces,
        1.0,
        5.0,
        "% of the faces",
        "A face that turned over is shaded dark; one in a hundred is common in folds, one in twenty is a torn surface.",
    ),
)


@dataclass(frozen=True)
class Verdict:
    """What a mesh is worth.

    Attributes:
        word: "good", "look" or "poor".
        reason: the error that decides, with its limit; empty for "good".
    """

    word: str
    reason: str


def rank(word: str, hausdorff: float) -> tuple[int, float]:
    """What measured meshes are sorted by, the worst first: the verdict, then the largest distance."""
    return WORDS.index(word), -hausdorff


def verdict_of(errors: Measured) -> Verdict:
    """The verdict on measured errors: that of the error that is furthest beyond its limit."""
    for word in (POOR, LOOK):
        beyond = [(limit.value(errors) / getattr(limit, word), limit) for limit in LIMITS]
        worst, limit = max(beyond, key=lambda pair: pair[0])
        if worst > 1.0:
            # As tables show it; a value that would be rounded down to its limit is shown above it.
            exact = limit.value(errors)
            value = rounded_up(exact) if limit.name == "Hausdorff" else f"{exact:.4g}"
            if float(value) <= getattr(limit, word):
                value = rounded_up(exact)
            return Verdict(word, f"{limit.name} {value} {limit.unit} is above {getattr(limit, word):g}")
    return Verdict(GOOD, "")
