"""The body of the quadruped: a horse of 1.6 m at the withers, as smoothly joined solids with the bone of each.

Metres; +y up, +z forward, +x to the left of the animal. The hooves stand on y = 0.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.implicit import Field, Points, ellipsoid, mirror, round_cone, smooth_minimum, subtract, union


@dataclass(frozen=True)
class Solid:
    """A tapered capsule of the body and the bone that carries it; `width` scales its x extent."""

    bone: str
    start: tuple[float, float, float]
    end: tuple[float, float, float]
    start_radius: float
    end_radius: float
    width: float = 1.0

    def field(self) -> Field:
        """Return the field of the solid."""
        return round_cone(self.start, self.end, self.start_radius, self.end_radius, self.width)


TORSO = (
    Solid("pelvis", (0, 1.24, -0.52), (0, 1.18, -0.66), 0.28, 0.20, 0.86),
    Solid("loin", (0, 1.25, -0.40), (0, 1.24, -0.20), 0.265, 0.275, 0.84),
    Solid("back", (0, 1.22, -0.22), (0, 1.19, 0.12), 0.29, 0.325, 0.80),
    Solid("chest", (0, 1.19, 0.12), (0, 1.17, 0.40), 0.325, 0.29, 0.76),
    Solid("chest", (0, 1.15, 0.42), (0, 1.12, 0.55), 0.26, 0.19, 0.86),
    Solid("chest", (0, 1.50, 0.28), (0, 1.42, 0.02), 0.085, 0.09, 0.8),
)
NECK = (
    Solid("neck_low", (0, 1.26, 0.48), (0, 1.52, 0.70), 0.235, 0.175, 0.58),
    Solid("neck_high", (0, 1.52, 0.70), (0, 1.80, 0.96), 0.175, 0.118, 0.60),
    Solid("head", (0, 1.80, 0.96), (0, 1.85, 1.02), 0.118, 0.11, 0.66),
)
MANE = (
    Solid("neck_low", (0, 1.555, 0.30), (0, 1.68, 0.55), 0.05, 0.065, 0.40),
    Solid("neck_high", (0, 1.68, 0.55), (0, 1.94, 0.88), 0.065, 0.06, 0.40),
    Solid("head", (0, 1.94, 0.88), (0, 1.97, 0.99), 0.06, 0.04, 0.40),
)
HEAD = (
    Solid("head", (0, 1.855, 1.06), (0, 1.76, 1.16), 0.118, 0.105, 0.72),
    Solid("head", (0, 1.80, 1.14), (0, 1.575, 1.40), 0.098, 0.062, 0.74),
    Solid("head", (0, 1.72, 1.07), (0, 1.54, 1.33), 0.105, 0.045, 0.62),
    Solid("head", (0, 1.565, 1.40), (0, 1.53, 1.425), 0.068, 0.064, 0.80),
    Solid("head", (0, 1.505, 1.36), (0, 1.495, 1.385), 0.046, 0.042, 0.85),
)
TAIL = (
    Solid("tail_1", (0, 1.37, -0.76), (0, 1.34, -0.90), 0.060, 0.050),
    Solid("tail_1", (0, 1.34, -0.90), (0, 1.25, -0.985), 0.050, 0.053),
    Solid("tail_2", (0, 1.25, -0.985), (0, 1.05, -1.045), 0.053, 0.068),
    Solid("tail_3", (0, 1.05, -1.045), (0, 0.80, -1.07), 0.068, 0.070),
    Solid("tail_4", (0, 0.80, -1.07), (0, 0.46, -1.05), 0.070, 0.018),
)
# The solids of the left side; the right side is their mirror image.
EAR = (Solid("ear", (0.056, 1.950, 1.01), (0.074, 2.10, 1.02), 0.040, 0.010),)
FORE_LEG = (
    Solid("scapula", (0.10, 1.40, 0.26), (0.135, 1.14, 0.50), 0.12, 0.125, 0.75),
    Solid("humerus", (0.135, 1.14, 0.50), (0.150, 0.95, 0.36), 0.125, 0.105, 0.85),
    Solid("forearm", (0.150, 0.95, 0.36), (0.145, 0.54, 0.405), 0.098, 0.050, 0.85),
    Solid("fore_cannon", (0.145, 0.54, 0.405), (0.145, 0.49, 0.405), 0.053, 0.044),
    Solid("fore_cannon", (0.145, 0.50, 0.400), (0.145, 0.20, 0.395), 0.036, 0.033),
    Solid("fore_pastern", (0.145, 0.20, 0.395), (0.145, 0.185, 0.395), 0.044, 0.042),
    Solid("fore_pastern", (0.145, 0.19, 0.400), (0.145, 0.085, 0.450), 0.036, 0.042),
    Solid("fore_pastern", (0.145, 0.085, 0.450), (0.145, 0.00, 0.480), 0.046, 0.066),
)
HIND_LEG = (
    Solid("femur", (0.10, 1.24, -0.58), (0.155, 0.99, -0.43), 0.205, 0.145, 0.75),
    Solid("femur", (0.11, 1.12, -0.70), (0.145, 0.88, -0.63), 0.165, 0.115, 0.70),
    Solid("tibia", (0.155, 0.99, -0.42), (0.145, 0.64, -0.70), 0.140, 0.066, 0.78),
    Solid("tibia", (0.145, 0.88, -0.66), (0.145, 0.66, -0.745), 0.055, 0.030, 0.7),
    Solid("hind_cannon", (0.145, 0.64, -0.715), (0.145, 0.58, -0.715), 0.062, 0.050, 0.85),
    Solid("hind_cannon", (0.145, 0.58, -0.710), (0.145, 0.21, -0.670), 0.042, 0.035),
    Solid("hind_pastern", (0.145, 0.21, -0.670), (0.145, 0.195, -0.670), 0.046, 0.043),
    Solid("hind_pastern", (0.145, 0.20, -0.665), (0.145, 0.085, -0.615), 0.037, 0.042),
    Solid("hind_pastern", (0.145, 0.085, -0.615), (0.145, 0.00, -0.585), 0.046, 0.066),
)
LOWER = (-0.45, -0.06, -1.24)
UPPER = (0.45, 2.16, 1.56)


def solids() -> list[Solid]:
    """Return the solids of both sides; bones of the pairs carry the suffix `_left` or `_right`."""
    result = [*TORSO, *NECK, *MANE, *HEAD, *TAIL]
    for solid in (*EAR, *FORE_LEG, *HIND_LEG):
        for side, sign in (("left", 1.0), ("right", -1.0)):
            start, end = ((sign * p[0], p[1], p[2]) for p in (solid.start, solid.end))
            result.append(Solid(f"{solid.bone}_{side}", start, end, solid.start_radius, solid.end_radius, solid.width))
    return result


def _chain(radius: float, parts: tuple[Solid, ...]) -> Field:
    return union(radius, *(part.field() for part in parts))


def body() -> Field:
    """Return the field of the whole animal."""
    # Fillet radii in metres: wide where muscles run into each other, narrow where parts must stay apart.
    torso = union(0.10, _chain(0.10, TORSO), _chain(0.06, NECK))
    torso = union(0.05, torso, _chain(0.03, MANE))
    torso = union(0.10, torso, mirror(_chain(0.05, FORE_LEG[:2])), mirror(_chain(0.08, HIND_LEG[:3])))
    legs = union(0.01, _chain(0.03, FORE_LEG[1:]), _chain(0.03, HIND_LEG[2:]))
    torso = union(0.05, torso, mirror(legs))
    torso = union(0.04, torso, _head(), _chain(0.015, TAIL))

    def standing(points: Points) -> NDArray[np.float64]:
        # The hooves are cut flat by the ground plane.
        return -smooth_minimum(-torso(points), points[:, 1], 0.012)

    return standing


def _head() -> Field:
    skull = _chain(0.03, HEAD)
    brow = mirror(ellipsoid((0.070, 1.832, 1.150), (0.022, 0.020, 0.040), pitch=45.0))
    eye = mirror(ellipsoid((0.076, 1.803, 1.158), (0.022, 0.021, 0.028), pitch=45.0))
    socket = mirror(ellipsoid((0.092, 1.800, 1.162), (0.022, 0.030, 0.040), pitch=45.0))
    nostril = mirror(ellipsoid((0.050, 1.552, 1.468), (0.020, 0.028, 0.024), pitch=-25.0))
    # The mouth and the hollow between cheek bone and jaw are grooves along the flank of the muzzle.
    mouth = mirror(round_cone((0.060, 1.535, 1.360), (0.034, 1.497, 1.460), 0.015, 0.016))
    cheek_groove = mirror(round_cone((0.088, 1.70, 1.16), (0.066, 1.60, 1.30), 0.026, 0.024))
    skull = subtract(0.012, union(0.02, skull, brow), socket, nostril, mouth, cheek_groove)
    ear = subtract(0.010, EAR[0].field(), ellipsoid((0.066, 2.015, 1.050), (0.020, 0.060, 0.026)))
    return union(0.02, union(0.006, skull, eye), mirror(ear))


def edge_size(points: Points) -> NDArray[np.float64]:
    """Return the wanted edge length ``(P,)``, relative: short on the head and the lower legs, long on the trunk."""
    size = np.ones(len(points))
    for centre, radius, factor in (
        ((0.0, 1.55, 1.43), 0.18, 0.38),
        ((0.0, 1.81, 1.15), 0.22, 0.48),
        ((0.0, 2.02, 1.02), 0.16, 0.50),
    ):
        near = np.exp(-(((points - np.array(centre)) ** 2).sum(axis=1)) / radius**2)
        size *= 1.0 - (1.0 - factor) * near
    # The lower legs are thin: their wanted length falls from the elbow down to the fetlock.
    lower = np.clip((0.75 - points[:, 1]) / 0.35, 0.0, 1.0) * (points[:, 2] > -0.95)
    return size * (1.0 - 0.45 * lower * lower * (3.0 - 2.0 * lower))
