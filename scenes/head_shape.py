"""The resting face as smoothly joined solids.

Centimetres; +y up, +z out of the face, +x to the left of the person. The eyes are at y = 0.
"""

import numpy as np
from numpy.typing import NDArray

from scenes.implicit import Field, Points, ellipsoid, mirror, round_cone, smooth_minimum, subtract, union

# The neck is cut off here, at right angles to its axis.
NECK_CUT = -16.5
LOWER = (-10.0, -17.4, -11.6)
UPPER = (10.0, 12.6, 12.6)

EYE = np.array([3.15, 0.0, 6.55])
EYE_RADIUS = 1.32
LID_THICKNESS = 0.20
# Half width of the opening between the lids.
EYE_HALF_WIDTH = 1.22

MOUTH_Y = -6.75
MOUTH_HALF_WIDTH = 2.45


def contact_line(x: NDArray) -> NDArray[np.float64]:
    """Return the height of the line between the lips at `x`: a shallow bow whose corners hang by 0.12 cm."""
    share = np.clip(np.abs(x) / MOUTH_HALF_WIDTH, 0.0, 1.5)
    return MOUTH_Y + 0.05 * np.cos(2.0 * np.pi * share) - 0.12 * share**2


def lid_lines(x: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the elevation in radians of the lower and the upper lid seen from the eye's middle.

    `x` is the sideways distance from the middle of the eye, positive outwards.
    """
    share = np.clip(x / EYE_HALF_WIDTH, -1.0, 1.0)
    # An almond: the arcs meet at the corners, the outer corner stands a little higher than the inner one.
    arc = np.sqrt(np.maximum(1.0 - share**2, 0.0))
    tilt = 0.06 * share
    return tilt - 0.34 * arc**1.2, tilt + 0.44 * arc


def skull() -> Field:
    """Return the head without eyes, nose, mouth and ears."""
    cranium = ellipsoid((0, 3.4, -1.3), (7.3, 8.2, 9.3))
    forehead = ellipsoid((0, 3.9, 2.6), (6.0, 5.6, 5.7))
    face = ellipsoid((0, -3.2, 3.0), (5.7, 7.0, 5.5))
    cheek = mirror(ellipsoid((3.9, -2.4, 5.3), (2.0, 1.5, 2.0), yaw=-30.0))
    jaw = mirror(round_cone((4.7, -6.0, 0.9), (1.2, -10.0, 6.6), 1.55, 1.35))
    ramus = mirror(round_cone((5.3, -2.2, 0.2), (4.7, -6.2, 0.9), 1.4, 1.5))
    chin = ellipsoid((0, -9.9, 7.0), (1.75, 1.45, 1.5))
    muzzle = ellipsoid((0, -6.4, 6.0), (3.1, 2.7, 3.0))
    neck = round_cone((0, -6.0, -2.2), (0, -20.0, -4.4), 4.7, 5.6)
    throat = round_cone((0, -10.2, 1.2), (0, -14.5, 0.6), 1.5, 1.2)
    trunk = union(2.4, cranium, forehead, face)
    trunk = union(1.8, trunk, cheek, jaw, ramus)
    trunk = union(1.6, trunk, muzzle, chin)
    trunk = union(2.2, trunk, neck, throat)
    temple = mirror(ellipsoid((8.3, 1.8, 4.4), (1.4, 2.8, 3.0)))
    cheek_hollow = mirror(ellipsoid((6.9, -6.2, 5.4), (1.5, 2.6, 2.0)))
    return subtract(1.6, trunk, temple, cheek_hollow)


def _with_brow_and_sockets(solid: Field) -> Field:
    brow = mirror(round_cone((1.3, 1.55, 7.35), (4.6, 1.85, 5.9), 0.85, 0.65))
    socket = mirror(ellipsoid((3.2, -0.05, 8.9), (2.0, 1.35, 1.6)))
    return subtract(1.1, union(1.0, solid, brow), socket)


def _with_nose(solid: Field) -> Field:
    bridge = round_cone((0, 0.5, 7.7), (0, -3.3, 9.9), 0.62, 0.72, 1.05)
    tip = ellipsoid((0, -3.75, 10.05), (0.86, 0.80, 0.88))
    opposite_vertex = mirror(ellipsoid((1.02, -3.95, 9.15), (0.66, 0.68, 0.98), yaw=20.0))
    septum = round_cone((0, -4.25, 9.9), (0, -4.75, 8.7), 0.40, 0.42)
    root = round_cone((0, -0.4, 7.2), (0, -4.2, 8.2), 0.8, 1.35, 1.05)
    nose = union(0.7, union(0.8, bridge, root), union(0.45, tip, opposite_vertex, septum))
    nostril = mirror(round_cone((0.60, -5.0, 9.50), (0.62, -4.3, 9.25), 0.27, 0.20))
    return subtract(0.2, union(0.8, solid, nose), nostril)


def _front(solid: Field, x: NDArray, y: NDArray) -> NDArray[np.float64]:
    """Return the z at which a ray from the front meets the solid."""
    # 0.02 cm steps: far finer than any lip.
    depth = np.arange(12.0, 3.0, -0.02)
    grid = np.stack(np.broadcast_arrays(x[:, None], y[:, None], depth[None]), axis=-1)
    inside = solid(grid.reshape(-1, 3)).reshape(len(x), -1) < 0.0
    return depth[inside.argmax(axis=1)]


def _lip(solid: Field, sign: float, thickness: NDArray) -> Field:
    """Return half a lip: capsules along the contact line, above (`sign` 1) or below it (-1), resting on the face."""
    x = np.linspace(0.0, MOUTH_HALF_WIDTH, len(thickness))
    y = contact_line(x) + sign * thickness
    # Sunk by half of their thickness the lips swell out of the face without standing off it.
    z = _front(solid, x, y) - 0.50 * thickness
    at = np.round(np.stack([x, y, z], axis=1), 4)
    parts = [
        round_cone(at[i], at[i + 1], float(thickness[i]), float(thickness[i + 1])) for i in range(len(thickness) - 1)
    ]
    return mirror(union(0.08, *parts))


def _with_lips(solid: Field) -> Field:
    below = ellipsoid((0, -8.75, 9.6), (1.8, 0.55, 0.9))
    philtrum = round_cone((0, -5.0, 9.55), (0, -5.8, 9.60), 0.28, 0.34)
    carved = subtract(0.6, subtract(1.0, solid, below), philtrum)
    # Thickness in cm from the middle to the corner; the upper lip dips in the middle (Cupid's bow).
    upper = _lip(carved, 1.0, np.array([0.43, 0.50, 0.47, 0.38, 0.27, 0.15]))
    lower = _lip(carved, -1.0, np.array([0.60, 0.60, 0.54, 0.43, 0.29, 0.15]))
    return union(0.06, union(0.35, carved, upper), union(0.35, carved, lower))


def lid_opening(points: Points) -> NDArray[np.float64]:
    """Return how far inside the opening between the lids of either eye points are, in cm along the eyeball.

    Zero on the rims of the lids, negative on the lids.
    """
    x, y, z = (np.stack([np.abs(points[:, 0]), points[:, 1], points[:, 2]], axis=1) - EYE).T
    low, high = lid_lines(x)
    elevation = np.arctan2(y, np.maximum(z, 1e-6))
    inside = np.minimum(elevation - low, high - elevation) * np.sqrt(y * y + z * z)
    return inside - np.maximum(np.abs(x) - EYE_HALF_WIDTH, 0.0)


def _with_eyes(solid: Field) -> Field:
    ball = mirror(ellipsoid(EYE, (EYE_RADIUS,) * 3))
    shell = mirror(ellipsoid(EYE, (EYE_RADIUS + LID_THICKNESS,) * 3))

    def lids(points: Points) -> NDArray[np.float64]:
        return -smooth_minimum(-shell(points), -lid_opening(points), 0.08)

    return union(0.03, union(0.75, solid, lids), ball)


def _ear() -> Field:
    flap = ellipsoid((7.65, -1.6, -1.0), (0.55, 3.0, 1.75), pitch=-12.0, yaw=-20.0)
    lobe = ellipsoid((7.35, -4.1, -0.1), (0.50, 0.95, 0.8))
    bowl = ellipsoid((8.40, -1.3, -0.60), (0.75, 2.25, 1.10), pitch=-12.0, yaw=-20.0)
    ridge = ellipsoid((8.05, -0.9, -1.15), (0.32, 1.75, 0.42), pitch=-10.0)
    tragus = ellipsoid((7.25, -1.9, 0.55), (0.40, 0.65, 0.40))
    return union(0.25, subtract(0.3, union(0.5, flap, lobe), bowl), ridge, tragus)


def head() -> Field:
    """Return the field of the whole head; the neck runs on below `NECK_CUT`."""
    face = _with_eyes(_with_lips(_with_nose(_with_brow_and_sockets(skull()))))
    return union(0.5, face, mirror(_ear()))


def edge_size(points: Points) -> NDArray[np.float64]:
    """Return the wanted edge length ``(P,)``, relative: short at eyes, lips, nose and ears, long on the skull."""
    size = np.full(len(points), 1.0)
    folded = np.stack([np.abs(points[:, 0]), points[:, 1], points[:, 2]], axis=1)
    for centre, radius, factor in (
        ((3.15, 0.0, 7.55), 2.0, 0.15),
        ((0.0, MOUTH_Y, 9.0), 2.2, 0.25),
        ((1.8, MOUTH_Y, 8.5), 1.7, 0.25),
        ((0.6, -4.4, 9.6), 1.6, 0.32),
        ((7.8, -1.6, -0.8), 3.0, 0.45),
        ((0.0, -4.0, 8.0), 6.5, 0.60),
    ):
        near = np.exp(-((((folded - np.array(centre)) / radius) ** 2).sum(axis=1)))
        size = np.minimum(size, 1.0 - (1.0 - factor) * near)
    return size
