"""The small picture of a result that a notebook shows."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from PIL import Image

from warpqem.picture.render import fit_view, render
from warpqem.picture.sheet import caption, tile

__all__ = ["preview", "side_by_side"]

# Pictures in a row, and the pixels of one: a row fills the width of a notebook.
PICTURES = 3
SIZE = (300, 225)
COLORS = 32
# A mesh that does not move is looked at from the front quarter, from behind, and from above.
AROUND = ((30.0, 12.0), (210.0, 12.0), (30.0, 70.0))


def preview(points: npt.NDArray[np.float32], faces: npt.NDArray[np.int32]) -> bytes:
    """A PNG of a mesh: the first, the middle and the last frame; of a single one three sides.

    Args:
        points: (F, V, 3).
        faces: (N, 3).

    Raises:
        DegenerateMeshError: there are no points.
    """
    frames = np.unique(np.linspace(0, len(points) - 1, PICTURES).round().astype(int))
    if len(frames) == 1:
        views = [fit_view(points[0], azimuth=a, elevation=e, aspect=SIZE[0] / SIZE[1]) for a, e in AROUND]
        return _png([render(points[0], faces, view, size=SIZE, lines=True) for view in views])
    # One view of all of them, so that motion shows.
    view = fit_view(points[frames], aspect=SIZE[0] / SIZE[1])
    pictures = [render(points[frame], faces, view, size=SIZE, lines=True) for frame in frames]
    return _png([caption(picture, f"frame {frame}") for picture, frame in zip(pictures, frames, strict=True)])


def side_by_side(meshes: Sequence[tuple[npt.NDArray[np.float32], npt.NDArray[np.int32], str]]) -> bytes:
    """A PNG of meshes, each of points (V, 3), faces (N, 3) and its caption, in one view."""
    view = fit_view(np.concatenate([points for points, _, _ in meshes]), aspect=SIZE[0] / SIZE[1])
    return _png([caption(render(points, faces, view, size=SIZE, lines=True), text) for points, faces, text in meshes])


def _png(pictures: list[npt.NDArray[np.uint8]]) -> bytes:
    file = io.BytesIO()
    # They are grey: more colours do not show, and a notebook stays small.
    Image.fromarray(tile(pictures, len(pictures))).quantize(COLORS).save(file, "PNG", optimize=True)
    return file.getvalue()
