"""Pictures of meshes: a z-buffered rasteriser in NumPy and contact sheets of its pictures."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

# Light from over the viewer's left shoulder, and a weaker one from the right that keeps the dark side readable.
KEY_LIGHT = np.array([-0.45, 0.65, 0.62])
FILL_LIGHT = np.array([0.75, 0.05, 0.5])
BACKGROUND = np.array([0.93, 0.94, 0.95])


def camera_rotation(azimuth: float, elevation: float) -> NDArray[np.float64]:
    """Return the rotation ``(3, 3)`` from world (y up) to a camera looking along -z from these angles in degrees.

    Azimuth 0 looks at the +z side of the object, azimuth 90 at its +x side.
    """
    a, e = np.radians(azimuth), np.radians(elevation)
    turn = np.array([[np.cos(a), 0.0, -np.sin(a)], [0.0, 1.0, 0.0], [np.sin(a), 0.0, np.cos(a)]])
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(e), -np.sin(e)], [0.0, np.sin(e), np.cos(e)]])
    return tilt @ turn


def _shade(points: NDArray, faces: NDArray, smooth: bool) -> NDArray[np.float64]:
    """Return the light on each corner of each face ``(N, 3)``, both sides of the surface lit alike."""
    corner = points[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    if smooth:
        total = np.zeros_like(points)
        np.add.at(total, faces.ravel(), np.repeat(normal, 3, axis=0))
        corner_normal = total[faces]
    else:
        corner_normal = np.repeat(normal[:, None], 3, axis=1)
    corner_normal = corner_normal / np.maximum(np.linalg.norm(corner_normal, axis=-1, keepdims=True), 1e-30)
    corner_normal = np.where(normal[:, None, 2:] < 0.0, -corner_normal, corner_normal)
    key = np.clip(corner_normal @ (KEY_LIGHT / np.linalg.norm(KEY_LIGHT)), 0.0, 1.0)
    fill = np.clip(corner_normal @ (FILL_LIGHT / np.linalg.norm(FILL_LIGHT)), 0.0, 1.0)
    return 0.18 + 0.68 * key + 0.2 * fill


def render(
    points: NDArray,
    faces: NDArray,
    colors: NDArray | None = None,
    *,
    size: tuple[int, int] = (480, 360),
    azimuth: float = 30.0,
    elevation: float = 12.0,
    frame: tuple[NDArray, float] | None = None,
    smooth: bool = True,
) -> NDArray[np.uint8]:
    """Return an orthographic picture ``(height, width, 3)`` of the mesh.

    `colors` ``(V, 3)`` are linear in [0, 1]; `frame` is the world point in the middle of the picture and the world
    height of the picture, by default the bounding box of the mesh.
    """
    width, height = size
    view = np.asarray(points, np.float64) @ camera_rotation(azimuth, elevation).T
    if frame is None:
        low, high = view.min(axis=0), view.max(axis=0)
        middle, extent = (low + high) / 2.0, 1.06 * max(high[1] - low[1], (high[0] - low[0]) * height / width)
    else:
        middle, extent = camera_rotation(azimuth, elevation) @ np.asarray(frame[0], float), frame[1]
    scale = height / extent
    screen = np.stack([(view[:, 0] - middle[0]) * scale + width / 2, (middle[1] - view[:, 1]) * scale + height / 2], 1)
    corner = screen[faces]
    low = np.clip(np.floor(corner.min(axis=1)).astype(int), 0, [width, height])
    high = np.clip(np.ceil(corner.max(axis=1)).astype(int) + 1, 0, [width, height])
    box = np.maximum(high - low, 0)
    count = box.prod(axis=1)
    face = np.repeat(np.arange(len(faces)), count)
    local = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    x = low[face, 0] + local % np.maximum(box[face, 0], 1)
    y = low[face, 1] + local // np.maximum(box[face, 0], 1)
    share = _barycentric(corner[face], np.stack([x, y], axis=1) + 0.5)
    inside = (share >= -1e-9).all(axis=1)
    face, x, y, share = face[inside], x[inside], y[inside], share[inside]
    depth = (view[faces[face], 2] * share).sum(axis=1)
    # Painter's order: of several writes to one pixel NumPy keeps the last, so the nearest goes last.
    order = np.argsort(depth, kind="stable")
    face, x, y, share = face[order], x[order], y[order], share[order]
    light = (_shade(view, faces, smooth)[face] * share).sum(axis=1)
    tone = np.full((len(points), 3), 0.72) if colors is None else np.asarray(colors, float)
    picture = np.tile(BACKGROUND, (height, width, 1))
    paint = (tone[faces[face]] * share[:, :, None]).sum(axis=1) * light[:, None]
    picture[y, x] = np.clip(paint, 0.0, 1.0) ** (1.0 / 2.2)
    return (picture * 255.0 + 0.5).astype(np.uint8)


def _barycentric(corner: NDArray, at: NDArray) -> NDArray[np.float64]:
    u, v, w = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0], at - corner[:, 0]
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    area = np.where(np.abs(area) < 1e-12, np.inf, area)
    second = (w[:, 0] * v[:, 1] - w[:, 1] * v[:, 0]) / area
    third = (u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0]) / area
    degenerate = np.isinf(area)
    first = np.where(degenerate, -1.0, 1.0 - second - third)
    return np.stack([first, second, third], axis=1)


def tile(pictures: Sequence[NDArray[np.uint8]], columns: int) -> NDArray[np.uint8]:
    """Return pictures of one size laid out in rows of `columns`."""
    height, width = pictures[0].shape[:2]
    rows = -(-len(pictures) // columns)
    sheet = np.full((rows * height, columns * width, 3), 255, dtype=np.uint8)
    for index, picture in enumerate(pictures):
        row, column = divmod(index, columns)
        sheet[row * height : (row + 1) * height, column * width : (column + 1) * width] = picture
    return sheet


def contact_sheet(meshes: Sequence[tuple], path: str | Path, columns: int = 4, **options: object) -> None:
    """Write a PNG with one picture per mesh, a mesh being ``(points, faces)`` or ``(points, faces, colors)``.

    `options` are those of `render`.
    """
    Image.fromarray(tile([render(*mesh, **options) for mesh in meshes], columns)).save(path, optimize=True)
