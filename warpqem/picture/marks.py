"""Named points on pictures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from warpqem.picture.render import View

__all__ = ["mark"]

# In pixels.
RADIUS, FONT_SIZE = 4, 11
DOT_COLOR, TEXT_COLOR = (200, 40, 40), (30, 50, 140)


def mark(picture: np.ndarray, view: View, points: np.ndarray, labels: Sequence[str]) -> np.ndarray:
    """The picture (height, width, 3) uint8 with a dot and a label at each of the points (n, 3) of its view."""
    image = Image.fromarray(picture)
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(FONT_SIZE)
    height, width = picture.shape[:2]
    right, up, _ = view.axes()
    local = np.asarray(points, dtype=np.float64) - view.middle
    scale = height / view.height
    for place, label in zip(local, labels, strict=True):
        x, y = width / 2 + place @ right * scale, height / 2 - place @ up * scale
        draw.ellipse([x - RADIUS, y - RADIUS, x + RADIUS, y + RADIUS], fill=DOT_COLOR)
        draw.text((x + RADIUS + 2, y - FONT_SIZE / 2), label, fill=TEXT_COLOR, font=font)
    return np.array(image)
