"""Render a mesh in one frame, by ray casting on the device."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from warpqem.arguments.array_input import finite_array, real_array
from warpqem.arguments.number_input import real_number, shown, whole_number
from warpqem.errors import OptionError
from warpqem.kernels import render as kernels
from warpqem.mesh.mesh_input import finite_points, read_faces, read_points
from warpqem.runtime.device import on_device, resolve_device
from warpqem.runtime.part_launches import PerPart, launch_in_parts, rows_of

__all__ = ["View", "encoded_srgb", "fit_view", "render"]

# A light grey, linear: dark and bright surfaces both stand out from it.
BACKGROUND = (0.85, 0.87, 0.89)
# Surfaces without a colour.
PLAIN = (0.72, 0.72, 0.72)
# Part of the picture that is left free around the mesh.
MARGIN = 0.06
# Rays across a pixel, each way.
SAMPLES = 2


@dataclass(frozen=True)
class View:
    """Where a picture looks at the mesh from.

    Attributes:
        azimuth: Degrees about the up axis; 0 looks at the side that faces forward, 90 at the one to the left of that.
        elevation: Degrees above the horizon.
        middle: World point in the middle of the picture.
        height: World height of the picture.
        up: "y" or "z", the up axis; forward is +z or -y.
    """

    azimuth: float
    elevation: float
    middle: tuple[float, float, float]
    height: float
    up: str = "y"

    def __post_init__(self) -> None:
        """Refuse an axis that is none, and a picture without height."""
        check_up(self.up)
        for name in ("azimuth", "elevation"):
            real_number(getattr(self, name), f"{name} of the view", "a number of degrees", np.isfinite)
        finite_array(self.middle, "middle of the view", (3,))
        real_number(self.height, "height of the view", "a positive number, as expected", lambda x: 0.0 < x < np.inf)

    def axes(self) -> np.ndarray:
        """(3, 3) float64: unit vectors to the right of the picture, up in it, and towards the viewer."""
        return _axes(self.azimuth, self.elevation, self.up)


def check_up(up: Any) -> None:
    """Raise an OptionError for an up axis that is none."""
    if not isinstance(up, str) or up not in ("y", "z"):
        raise OptionError(f"up axis {up!r}: expected 'y' or 'z'")


def _axes(azimuth: float, elevation: float, up: str) -> np.ndarray:
    a, e = np.radians(azimuth), np.radians(elevation)
    right = np.array([np.cos(a), 0.0, -np.sin(a)])
    toward = np.array([np.cos(e) * np.sin(a), np.sin(e), np.cos(e) * np.cos(a)])
    axes = np.stack([right, np.cross(toward, right), toward])
    # A z-up world is a y-up one, turned: its -y points to the viewer.
    return axes if up == "y" else np.stack([axes[:, 0], -axes[:, 2], axes[:, 1]], axis=1)


def fit_view(
    points: np.ndarray, *, azimuth: float = 30.0, elevation: float = 12.0, up: str = "y", aspect: float = 4 / 3
) -> View:
    """A view that shows all points in a picture of this ratio of width to height.

    Args:
        points: (F, V, 3) or (V, 3).
        azimuth: see :class:`View`.
        elevation: likewise.
        up: likewise.
        aspect: width by height.

    Raises:
        MeshShapeError, NonFinitePointError, DegenerateMeshError: points of another shape or dtype, or not finite; none.
        OptionError: an angle, axis or aspect that is none.
    """
    check_up(up)
    for angle, name in ((azimuth, "azimuth"), (elevation, "elevation")):
        real_number(angle, f"{name} of the view", "a number of degrees", np.isfinite)
    real_number(aspect, "aspect of the view", "a positive number, as expected", lambda x: 0.0 < x < np.inf)
    flat = finite_points(read_points(points, "points")).astype(np.float64).reshape(-1, 3)
    axes = _axes(azimuth, elevation, up)
    seen = flat @ axes.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    height = max(high[1] - low[1], (high[0] - low[0]) / aspect) * (1.0 + MARGIN)
    middle = (low + high) / 2 @ axes
    return View(azimuth, elevation, (float(middle[0]), float(middle[1]), float(middle[2])), float(height) or 1.0, up)


@on_device
def render(
    points: np.ndarray,
    faces: np.ndarray,
    view: View,
    *,
    colors: np.ndarray | None = None,
    size: tuple[int, int] = (480, 360),
    smooth: bool = False,
    lines: bool = False,
    device: str | None = None,
) -> np.ndarray:
    """A picture of a mesh, (height, width, 3) uint8, sRGB.

    Args:
        points: (V, 3).
        faces: (N, 3) integers.
        view: where it is looked at from.
        colors: (V, 3) linear Rec. 709, 0 to 1; None for grey.
        size: width and height in pixels.
        smooth: shade over the edges instead of face by face.
        lines: draw the edges.
        device: Warp device; None takes cuda:0 if present, else cpu.

    Raises:
        OptionError: a size below one pixel, or no view.
        MeshShapeError, NonFinitePointError, FaceIndexError, DegenerateMeshError: see :mod:`warpqem.errors`.
        DeviceError: there is no such device.
    """
    width, height = _checked_size(size)
    if not isinstance(view, View):
        raise OptionError(f"view must be a View, got {shown(view)}")
    pose = finite_points(read_points(real_array(points, "points", ("V", 3)), "points"))[0]
    # Rays go to whatever memory an index leads to.
    faces = read_faces(faces, "faces", len(pose))
    if colors is not None:
        colors = finite_array(colors, "colors", (len(pose), 3), single=True)
    device = resolve_device(device)
    # About the middle, where float32 is finest.
    local = (pose.astype(np.float64) - view.middle).astype(np.float32)
    corner_vertex = wp.array(np.ascontiguousarray(faces, dtype=np.int32).ravel(), device=device)
    mesh = wp.Mesh(points=wp.array(local, dtype=wp.vec3, device=device), indices=corner_vertex)
    axes = view.axes()
    camera = kernels.Camera()
    camera.middle = wp.vec3(0.0, 0.0, 0.0)
    camera.right, camera.up = wp.vec3(*axes[0].tolist()), wp.vec3(*axes[1].tolist())
    camera.pixel = view.height / height
    camera.reach = float(max(np.linalg.norm(np.ptp(local, axis=0)), np.linalg.norm(local, axis=1).max(), 1e-30))
    shading = kernels.Shading()
    tones = np.broadcast_to(PLAIN, local.shape) if colors is None else colors
    shading.color = wp.array(np.ascontiguousarray(tones, dtype=np.float32), dtype=wp.vec3, device=device)
    shading.normal = wp.array(_vertex_normals(local, faces), dtype=wp.vec3, device=device)
    shading.smooth, shading.lines = int(smooth), int(lines)
    shading.background = wp.vec3(*BACKGROUND)
    image = wp.empty((height, width), dtype=wp.vec3, device=device)

    def camera_of(part: slice) -> kernels.Camera:
        # Rows of a strip are counted from the picture's top, so the strip's camera looks as far up or down.
        strip = kernels.Camera()
        shift = camera.pixel * (0.5 * height - 0.5 * (part.start + part.stop))
        strip.middle = camera.middle + shift * camera.up
        strip.right, strip.up, strip.pixel, strip.reach = camera.right, camera.up, camera.pixel, camera.reach
        return strip

    launch_in_parts(
        kernels.render_pixels,
        image.shape,
        inputs=[mesh.id, corner_vertex, mesh.points, PerPart(camera_of), shading, SAMPLES],
        outputs=[rows_of(image)],
        device=device,
    )
    return encoded_srgb(image.numpy())


def _checked_size(size: Any) -> tuple[int, int]:
    if not isinstance(size, (list, tuple)) or len(size) != 2:
        raise OptionError(f"size must be width and height, expected two numbers of pixels, got {shown(size)}")
    width, height = (
        whole_number(x, f"{name} of the picture", expected="at least one pixel")
        for x, name in zip(size, ("width", "height"), strict=True)
    )
    return width, height


def _vertex_normals(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    corner = points[faces].astype(np.float64)
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    total = np.zeros(points.shape)
    np.add.at(total, faces.ravel(), np.repeat(normal, 3, axis=0))
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.divide(total, length, out=np.zeros_like(total), where=length > 0).astype(np.float32)


def encoded_srgb(linear: np.ndarray) -> np.ndarray:
    """sRGB bytes of linear values (IEC 61966-2-1)."""
    clipped = np.clip(linear, 0.0, 1.0)
    encoded = np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)
    return (encoded * 255.0 + 0.5).astype(np.uint8)
