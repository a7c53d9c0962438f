"""Render a mesh in one frame, by ray casting on the device."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.arguments.array_input import finite_array, real_array
from warpqem.arguments.number_input import real_number, shown, whole_number
from warpqem.errors import MeshShapeError, OptionError
from warpqem.kernels import render as kernels
from warpqem.mesh.mesh_input import finite_points, read_faces, read_points
from warpqem.normal_maps.maps import MappedNormals, device_maps
from warpqem.normal_maps.posed import posed_normals
from warpqem.picture.look import PLAIN, Look, Texture, corner_normals, plain_look, smoothing_groups
from warpqem.runtime.device import on_device, resolve_device
from warpqem.runtime.part_launches import PerPart, launch_in_parts, rows_of

__all__ = ["PlacedScene", "View", "decoded_srgb", "encoded_srgb", "fit_view", "place_scene", "render"]

# A light grey, linear: dark and bright surfaces both stand out from it.
BACKGROUND = (0.85, 0.87, 0.89)
# How much darker lines are at most, and the mean length of edges in pixels from which on they are: those of finer
# meshes are fainter, so that the shape stays to be seen.
LINE_SHADE = 0.65
LINE_LENGTH = 12.0
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
    look: Look | None = None,
    device: str | None = None,
) -> np.ndarray:
    """A picture of a mesh, (height, width, 3) uint8, sRGB.

    Args:
        points: (V, 3).
        faces: (N, 3) integers.
        view: where it is looked at from.
        colors: (V, 3) linear Rec. 709, 0 to 1; None for those of the look.
        size: width and height in pixels.
        smooth: shade over the edges instead of face by face; hard edges stay, see `warpqem.picture.look`.
        lines: draw the edges, the fainter the shorter they are.
        look: colours, textures and hard edges; None for a plain surface.
        device: Warp device; None takes cuda:0 if present, else cpu.

    Raises:
        OptionError: a size below one pixel, or no view.
        MeshShapeError, NonFinitePointError, FaceIndexError, DegenerateMeshError: see :mod:`warpqem.errors`.
        DeviceError: there is no such device.
    """
    scene = place_scene(points, faces, view, size, colors=colors, smooth=smooth, lines=lines, look=look, device=device)
    image = wp.empty(scene.shape, dtype=wp.vec3, device=scene.device)
    scene.launch(kernels.render_pixels, [image])
    return encoded_srgb(image.numpy())


@dataclass(frozen=True)
class PlacedScene:
    """A mesh before a camera, on a device.

    Attributes:
        mesh: what rays are cast at.
        corner_vertex: (3N,) int32, the vertex at each corner.
        camera: of the whole picture.
        shading: what the surface looks like.
        shape: height and width of the picture in pixels.
        device: Warp device.
    """

    mesh: wp.Mesh
    corner_vertex: Any
    camera: Any
    shading: Any
    shape: tuple[int, int]
    device: str

    def seen_from(self, view: View) -> PlacedScene:
        """The same from elsewhere, with the same middle of the picture."""
        return replace(self, camera=_camera(view, self.shape[0], self.camera.reach))

    def launch(self, kernel: Any, images: Sequence[Any]) -> None:
        """Run a kernel over all pixels, in strips where they are many; it writes to images (height, width)."""

        def camera_of(part: slice) -> kernels.Camera:
            # Rows of a strip are counted from the picture's top, so the strip's camera looks as far up or down.
            strip, whole = kernels.Camera(), self.camera
            shift = whole.pixel * (0.5 * self.shape[0] - 0.5 * (part.start + part.stop))
            strip.middle = whole.middle + shift * whole.up
            strip.right, strip.up, strip.pixel, strip.reach = whole.right, whole.up, whole.pixel, whole.reach
            return strip

        launch_in_parts(
            kernel,
            self.shape,
            inputs=[self.mesh.id, self.corner_vertex, self.mesh.points, PerPart(camera_of), self.shading, SAMPLES],
            outputs=[rows_of(image) for image in images],
            device=self.device,
        )


def place_scene(
    points: np.ndarray,
    faces: np.ndarray,
    view: View,
    size: tuple[int, int],
    *,
    colors: np.ndarray | None = None,
    smooth: bool = False,
    lines: bool = False,
    look: Look | None = None,
    normals: np.ndarray | None = None,
    device: str | None = None,
) -> PlacedScene:
    """Check a mesh and put it before a camera; arguments and errors of :func:`render`.

    Args:
        points: see there, as all others.
        faces: likewise.
        view: likewise.
        size: likewise.
        colors: likewise.
        smooth: likewise.
        lines: likewise.
        look: likewise.
        normals: (N, 3, 3) shading normals at the corners, which take the place of those by ``smooth``; 0 for those of
            the face.
        device: see there.
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
    reach = float(max(np.linalg.norm(np.ptp(local, axis=0)), np.linalg.norm(local, axis=1).max(), 1e-30))
    look = plain_look(len(faces)) if look is None else look
    if len(look.face_part) != len(faces):
        raise MeshShapeError(f"look: it is of {len(look.face_part)} faces, and the mesh has {len(faces)}")
    if normals is None and smooth:
        normals = corner_normals(local, faces, smoothing_groups(local, faces, look.normals))
    mapped = None
    if normals is not None and look.mapped is not None and look.rest_corners is not None:
        mapped = _posed_maps(look.mapped, look.rest_corners, local[faces], normals)
        normals = mapped.normals.astype(np.float32)
    corners = None if colors is None else colors[faces]
    camera = _camera(view, height, reach)
    strength = 0.0 if not lines else LINE_SHADE * min(1.0, _edge_length(local, faces) / (camera.pixel * LINE_LENGTH))
    shading = _shading(look, corners, normals, strength, device)
    shading.maps = device_maps(mapped, local[faces], device)
    return PlacedScene(mesh, corner_vertex, camera, shading, (height, width), device)


def _camera(view: View, height: int, reach: float) -> Any:
    """The kernel's camera for a picture of so many rows of points about the view's middle, as far off as ``reach``."""
    axes = view.axes()
    camera = kernels.Camera()
    camera.middle = wp.vec3(0.0, 0.0, 0.0)
    camera.right, camera.up = wp.vec3(*axes[0].tolist()), wp.vec3(*axes[1].tolist())
    camera.pixel, camera.reach = view.height / height, reach
    return camera


def _checked_size(size: Any) -> tuple[int, int]:
    if not isinstance(size, (list, tuple)) or len(size) != 2:
        raise OptionError(f"size must be width and height, expected two numbers of pixels, got {shown(size)}")
    width, height = (
        whole_number(x, f"{name} of the picture", expected="at least one pixel")
        for x, name in zip(size, ("width", "height"), strict=True)
    )
    return width, height


def _shading(
    look: Look,
    colors: npt.NDArray[np.floating] | None,
    normals: npt.NDArray[np.floating] | None,
    line: float,
    device: str,
) -> Any:
    """What the kernel reads; colours (N, 3, 3) take the place of all that the look has."""
    shading = kernels.Shading()
    face_count = len(look.face_part)
    textures: Sequence[Texture] = () if colors is not None else look.textures
    if colors is None:
        # Textures are multiplied with their colours, which are white where the look has none.
        textured = np.array([part.texture is not None for part in look.parts])[look.face_part]
        plain = np.where(textured[:, None, None], 1.0, np.broadcast_to(PLAIN, (face_count, 3, 3)))
        colors = plain if look.colors is None else look.colors
    smooth = normals is not None
    if normals is None:
        normals = np.zeros((face_count, 3, 3), dtype=np.float32)
    part_texture = np.array([-1 if part.texture is None or not textures else part.texture for part in look.parts])

    def at_corners(values: npt.NDArray[np.floating], dtype: Any) -> Any:
        flat = np.ascontiguousarray(values, dtype=np.float32).reshape(-1, values.shape[-1])
        return wp.array(flat, dtype=dtype, device=device)

    shading.color, shading.normal = at_corners(colors, wp.vec3), at_corners(normals, wp.vec3)
    shading.uv = at_corners(np.zeros((face_count, 3, 2)) if look.uvs is None else look.uvs, wp.vec2)
    shading.face_texture = wp.array(part_texture[look.face_part].astype(np.int32), dtype=wp.int32, device=device)
    # Without a texture there is one texel that nothing reads.
    texels = [decoded_srgb(texture.pixels).reshape(-1, 3) for texture in textures] or [np.zeros((1, 3))]
    sizes = [texture.pixels.shape[1::-1] for texture in textures] or [(1, 1)]
    repeats = [texture.repeats for texture in textures] or [(False, False)]
    starts = np.cumsum([0, *(len(one) for one in texels[:-1])])
    shading.texel = wp.array(np.concatenate(texels).astype(np.float32), dtype=wp.vec3, device=device)
    shading.texture_start = wp.array(starts.astype(np.int32), dtype=wp.int32, device=device)
    shading.texture_size = wp.array(np.array(sizes, dtype=np.int32), dtype=wp.vec2i, device=device)
    shading.texture_repeats = wp.array(np.array(repeats, dtype=np.int32), dtype=wp.vec2i, device=device)
    shading.smooth, shading.line = int(smooth), line
    shading.background = wp.vec3(*BACKGROUND)
    return shading


def _posed_maps(
    mapped: MappedNormals,
    rest: npt.NDArray[np.floating],
    corners: npt.NDArray[np.floating],
    normals: npt.NDArray[np.floating],
) -> MappedNormals:
    """The maps of a look in the pose that is drawn; faces without one, or without normals, have these."""
    posed = posed_normals(rest, mapped.normals, corners)
    has_own = (np.asarray(mapped.face_map) >= 0)[:, None, None] & posed.any(axis=2, keepdims=True)
    return replace(mapped, normals=np.where(has_own, posed, normals))


def _edge_length(points: npt.NDArray[np.float32], faces: npt.NDArray[np.integer]) -> float:
    """Mean length of the edges."""
    corner = points[faces].astype(np.float64)
    return float(np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).mean()) if len(faces) else 0.0


def decoded_srgb(encoded: npt.NDArray[np.uint8]) -> npt.NDArray[np.float64]:
    """Linear values of sRGB bytes (IEC 61966-2-1)."""
    share = encoded / 255.0
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


def encoded_srgb(linear: np.ndarray) -> np.ndarray:
    """sRGB bytes of linear values (IEC 61966-2-1)."""
    clipped = np.clip(linear, 0.0, 1.0)
    encoded = np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)
    return (encoded * 255.0 + 0.5).astype(np.uint8)
