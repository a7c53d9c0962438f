"""Places on a relief, in the face's own units: the length of the nose, from its root to the lip, is one."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Missing", "Spot", "trust"]

# Standing out by so much of a nose's length makes a confidence of one half.
HALF_TRUST = 0.01


@dataclass(frozen=True)
class Spot:
    """A feature point before it is a vertex.

    Attributes:
        left: to the person's left of the midline.
        up: above the tip of the nose.
        forward: in front of it.
        confidence: 0 to 1.
    """

    left: float
    up: float
    forward: float
    confidence: float


@dataclass(frozen=True)
class Missing:
    """Why a feature point was not found."""

    reason: str


def trust(prominence: float) -> float:
    """The confidence in a point that stands out by so much, in noses: it approaches one."""
    return prominence / (prominence + HALF_TRUST)
