"""Sheets of pictures."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from warpqem.files.temporary import replacing

__all__ = ["caption", "tile", "write_gif", "write_png"]

# Of captions, in pixels.
FONT_SIZE = 14
TEXT_COLOR = (40, 44, 52)


def caption(picture: np.ndarray, text: str) -> np.ndarray:
    """The picture (height, width, 3) uint8 with a line of text in its upper left corner."""
    image = Image.fromarray(picture)
    ImageDraw.Draw(image).text((8, 6), text, fill=TEXT_COLOR, font=ImageFont.load_default(FONT_SIZE))
    return np.array(image)


def tile(pictures: Sequence[np.ndarray], columns: int) -> np.ndarray:
    """Pictures of one size in rows of ``columns``, (height, width, 3) uint8; white where there is none."""
    height, width = pictures[0].shape[:2]
    rows = -(-len(pictures) // columns)
    sheet = np.full((rows * height, columns * width, 3), 255, dtype=np.uint8)
    for index, picture in enumerate(pictures):
        row, column = divmod(index, columns)
        sheet[row * height : (row + 1) * height, column * width : (column + 1) * width] = picture
    return sheet


def write_gif(
    pictures: Sequence[np.ndarray], path: str | os.PathLike[str], frames_per_second: float = 12.0, colors: int = 64
) -> None:
    """Write pictures (height, width, 3) uint8 as a film that repeats, under a temporary name, and rename it.

    Args:
        pictures: sRGB, all of one size.
        path: the file, replaced if it exists.
        frames_per_second: GIF counts in hundredths of a second, so that 12 becomes 12.5.
        colors: of the whole film, 2 to 256. They are not dithered: the noise would cost more than it shows.

    Raises:
        OSError: the file cannot be written; nothing is left behind.
    """
    # One palette for all pictures, found in all of them at once.
    palette = Image.fromarray(np.concatenate(pictures)).quantize(colors, dither=Image.Dither.NONE)
    films = [Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    options = {"format": "GIF", "append_images": films[1:], "loop": 0, "optimize": False, "disposal": 1}
    _save(films[0], path, save_all=True, duration=round(100 / frames_per_second) * 10, **options)


def write_png(picture: np.ndarray, path: str | os.PathLike[str], colors: int | None = None) -> None:
    """Write a picture (height, width, 3) uint8 under a temporary name and rename it.

    Args:
        picture: sRGB.
        path: the file, replaced if it exists.
        colors: Reduce it to so many colours, for a small file; None for all.

    Raises:
        OSError: the file cannot be written; nothing is left behind.
    """
    image = Image.fromarray(picture)
    _save(image if colors is None else image.quantize(colors), path, format="PNG", optimize=True)


def _save(image: Image.Image, path: str | os.PathLike[str], **options: Any) -> None:
    with replacing(Path(path)) as temporary:
        image.save(temporary, **options)
