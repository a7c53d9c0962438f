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

# Of captions, in pixels: letters, the strip that they stand in, and what is free at its sides.
FONT_SIZE = 14
STRIP = 26
SIDE = 8
TEXT_COLOR = (40, 44, 52)
STRIP_COLOR = (255, 255, 255)
# Of the bar of colours in a caption, in pixels.
BAR_SIZE = (96, 9)


def caption(picture: np.ndarray, text: str, bar: tuple[np.ndarray, str] | None = None) -> np.ndarray:
    """The picture (height, width, 3) uint8 below a strip with a line of text, `STRIP` pixels taller; it covers nothing.

    Args:
        picture: sRGB.
        text: cut off at its end where it is too long.
        bar: colours (n, 3) from 0 to 1, sRGB, drawn at the right of the strip, and what the last of them stands for;
            the first one stands for 0. Left out where there is no room.
    """
    width = picture.shape[1]
    strip = Image.new("RGB", (width, STRIP), STRIP_COLOR)
    draw, font = ImageDraw.Draw(strip), ImageFont.load_default(FONT_SIZE)
    room = width - SIDE
    if bar is not None:
        room = _draw_bar(strip, draw, font, *bar)
    shown = text
    while len(shown) > 1 and SIDE + draw.textlength(shown, font) > room:
        shown = shown[:-2].rstrip() + "…"
    draw.text((SIDE, STRIP / 2), shown, fill=TEXT_COLOR, font=font, anchor="lm")
    return np.concatenate([np.array(strip), picture])


def _draw_bar(strip: Image.Image, draw: ImageDraw.ImageDraw, font: Any, colors: np.ndarray, end: str) -> float:
    """Draw "0 [colours] end" at the right; returns where it starts."""
    from_right = strip.width - SIDE - draw.textlength(end, font)
    left = from_right - SIDE / 2 - BAR_SIZE[0]
    start = left - SIDE / 2 - draw.textlength("0", font)
    if start < strip.width / 3:
        return strip.width - SIDE
    share = np.linspace(0.0, len(colors) - 1.0, BAR_SIZE[0])
    row = np.stack([np.interp(share, np.arange(len(colors)), channel) for channel in colors.T], axis=1)
    pixels = np.broadcast_to((row * 255.0 + 0.5).astype(np.uint8), (BAR_SIZE[1], *row.shape))
    strip.paste(Image.fromarray(np.ascontiguousarray(pixels)), (round(left), (STRIP - BAR_SIZE[1]) // 2))
    for x, text in ((start, "0"), (from_right, end)):
        draw.text((x, STRIP / 2), text, fill=TEXT_COLOR, font=font, anchor="lm")
    return start - SIDE


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
