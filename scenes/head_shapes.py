"""The blend shapes of the head: where each vertex goes when a shape has weight one."""

import numpy as np
from numpy.typing import NDArray

from scenes import head_shape
from scenes.diffusion import diffuse
from scenes.head_mesh import HeadMesh
from scenes.implicit import Points
from scenes.scene import BlendShape

# Offsets shorter than this, in centimetres, are left out of a shape.
MIN_OFFSET = 1e-3

# The jaw turns about the line through the joints before the ears, at this (y, z), by these degrees when wide open.
JAW_HINGE = (-2.4, -0.2)
JAW_DEGREES = 15.0


def _bump(points: Points, centre: tuple[float, float, float], radii: tuple[float, float, float]) -> NDArray[np.float64]:
    """Return a bell ``(V,)`` around `centre` and around its mirror image."""
    folded = np.stack([np.abs(points[:, 0]), points[:, 1], points[:, 2]], axis=1)
    return np.exp(-(((folded - np.array(centre)) / np.array(radii)) ** 2).sum(axis=1))


def jaw_mask(mesh: HeadMesh) -> NDArray[np.float64]:
    """Return how much of the jaw's turn each vertex takes, 0 to 1, torn apart only between the lips."""
    x, y, z = mesh.points.T
    # The jaw lies below the line from the corner of the mouth to the hinge, and above its own lower edge.
    corner_z, corner_y = 8.0, head_shape.MOUTH_Y
    share = np.clip((corner_z - z) / (corner_z - JAW_HINGE[1]), 0.0, 1.0)
    below = y < np.where(z > corner_z, head_shape.contact_line(x), corner_y + share * (JAW_HINGE[0] - corner_y))
    under_edge = y < -7.6 - 0.58 * np.clip(z, 0.0, 7.5)
    label = (below & ~under_edge & (z > 0.0)).astype(float)
    label[mesh.upper_lip], label[mesh.lower_lip[1:-1]] = 0.0, 1.0
    half = mesh.pocket.shape[1] // 2
    label[mesh.pocket[:, :half]], label[mesh.pocket[:, half]] = 0.0, 0.5
    label[mesh.pocket[:, half + 1 :]] = 1.0
    # Sharp between the lips, soft over cheeks and throat.
    lips = np.exp(-((y - head_shape.MOUTH_Y) ** 2) / 1.5 - np.maximum(8.5 - z, 0.0) ** 2 / 1.0)
    reach = 1.7 - 1.45 * lips
    mask = diffuse(mesh.points, mesh.faces, label[:, None], reach)[:, 0]
    # The tail of the diffusion below 3 percent is cut off without a step: the shape stays sparse.
    return np.clip((mask - 0.03) / 0.97, 0.0, 1.0)


def jaw_open(mesh: HeadMesh) -> Points:
    """Turn the lower jaw, its lip and the floor of the mouth down about the hinge."""
    mask = jaw_mask(mesh)
    angle = np.radians(JAW_DEGREES)
    y, z = mesh.points[:, 1] - JAW_HINGE[0], mesh.points[:, 2] - JAW_HINGE[1]
    moved = mesh.points.copy()
    moved[:, 1] += mask * (np.cos(angle) * y - np.sin(angle) * z - y)
    moved[:, 2] += mask * (np.sin(angle) * y + np.cos(angle) * z - z)
    return moved


def smile(mesh: HeadMesh) -> Points:
    """Draw the corners of the mouth out, up and back, and lift the cheeks."""
    points = mesh.points
    side = np.tanh(points[:, 0] / 0.8)
    corner = _bump(points, (2.5, -6.8, 8.1), (1.5, 1.3, 2.2))
    cheek = _bump(points, (3.7, -3.6, 7.0), (1.8, 1.5, 2.2))
    moved = points.copy()
    moved[:, 0] += 0.60 * corner * side
    moved[:, 1] += 0.65 * corner + 0.35 * cheek
    moved[:, 2] += -0.45 * corner + 0.25 * cheek
    return moved


def pucker(mesh: HeadMesh) -> Points:
    """Draw the lips together and push them forward."""
    points = mesh.points
    mask = np.exp(-((points[:, 0] / 3.0) ** 4) - ((points[:, 1] - head_shape.MOUTH_Y) / 1.7) ** 4)
    mask *= np.exp(-((np.minimum(points[:, 2] - 8.5, 0.0) / 2.5) ** 2))
    moved = points.copy()
    moved[:, 0] *= 1.0 - 0.38 * mask
    moved[:, 1] += 0.12 * mask * (points[:, 1] - head_shape.MOUTH_Y)
    moved[:, 2] += 0.75 * mask
    return moved


def brow_up(mesh: HeadMesh) -> Points:
    """Raise the brows and the skin over them."""
    mask = _bump(mesh.points, (2.9, 2.0, 7.2), (2.3, 1.1, 2.5))
    moved = mesh.points.copy()
    moved[:, 1] += 0.75 * mask
    moved[:, 2] += 0.10 * mask
    return moved


def blink(mesh: HeadMesh, side: float) -> Points:
    """Close the lid of the left (`side` 1) or the right eye (-1): the upper lid slides down over the eyeball.

    All skin from the lower lid to the brow is moved along circles around the eye's axis; the part of the eyeball
    that was in sight is folded behind the seam.
    """
    x = side * mesh.points[:, 0] - head_shape.EYE[0]
    y, z = mesh.points[:, 1] - head_shape.EYE[1], mesh.points[:, 2] - head_shape.EYE[2]
    low, high = head_shape.lid_lines(x)
    # The upper lid does nine tenths of the way, in angles around the eye; its skin is drawn from 0.6 rad above.
    seam, top = low + 0.1 * (high - low), high + 0.6
    elevation, radius = np.arctan2(y, z), np.sqrt(y * y + z * z)
    in_sight = low + (elevation - low) * (seam - low) / np.maximum(high - low, 1e-9)
    lid = seam + (elevation - high) * (top - seam) / (top - high)
    closed = np.where(elevation < low, elevation, np.where(elevation < high, in_sight, lid))
    closed = np.where(elevation > top, elevation, closed)
    # Skin further from the eyeball than the lid stays: it is the socket's.
    from_ball = np.sqrt(x * x + y * y + z * z) - head_shape.EYE_RADIUS - head_shape.LID_THICKNESS
    hold = np.clip((0.85 - from_ball) / 0.65, 0.0, 1.0) * (z > 0.0) * (np.abs(x) < head_shape.EYE_HALF_WIDTH)
    turned = elevation + hold * (closed - elevation)
    moved = mesh.points.copy()
    moved[:, 1] += radius * (np.sin(turned) - np.sin(elevation))
    moved[:, 2] += radius * (np.cos(turned) - np.cos(elevation))
    return moved


def shapes(mesh: HeadMesh) -> tuple[BlendShape, ...]:
    """Return the blend shapes, each with the vertices it moves only."""
    targets = {
        "jawOpen": jaw_open(mesh),
        "smile": smile(mesh),
        "pucker": pucker(mesh),
        "browUp": brow_up(mesh),
        "blinkLeft": blink(mesh, 1.0),
        "blinkRight": blink(mesh, -1.0),
    }
    result = []
    for name, target in targets.items():
        offset = target - mesh.points
        moving = np.flatnonzero((offset**2).sum(axis=1) > MIN_OFFSET**2)
        result.append(BlendShape(name, moving.astype(np.int32), offset[moving].astype(np.float32)))
    return tuple(result)
