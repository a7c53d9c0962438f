"""Base colours and textures of surfaces, from the materials of UsdPreviewSurface that are bound to them."""

from __future__ import annotations

import io
import math
import struct
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image
from pxr import Sdf, Usd, UsdShade

from warpqem.errors import StageError
from warpqem.picture.look import Texture
from warpqem.usd.read.copy_asset import copy_asset

__all__ = [
    "IMAGE_ERRORS",
    "Materials",
    "Surface",
    "TextureUse",
    "coordinates_of",
    "numbers_of",
    "source_of",
    "value_of",
]

# The longer side of textures, in pixels; a page holds them all.
LARGEST_TEXTURE = 512
# What Pillow raises for damaged images, and for those that it takes for attacks by their size.
IMAGE_ERRORS = (
    OSError,
    ValueError,
    SyntaxError,
    EOFError,
    LookupError,
    TypeError,
    OverflowError,
    struct.error,
    MemoryError,
    Image.DecompressionBombError,
    Image.DecompressionBombWarning,
)
# Nodes on the way from a base colour to its texture and from there to its coordinates; deeper ones are no way out.
MAX_NODES = 16


@dataclass(frozen=True, eq=False)
class TextureUse:
    """A texture and how it lies on a surface.

    Attributes:
        texture: the image.
        primvar: name of the texture coordinates.
        transform: (3, 2), by which rows (u, v, 1) are multiplied.
    """

    texture: Texture
    primvar: str
    transform: npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Surface:
    """The base colour of a material.

    Attributes:
        color: linear; multiplied with the texture where there is one. None for the colours of the primvar.
        texture: None for none.
        primvar: name of the colours that take the place of a constant one; empty for none.
    """

    color: tuple[float, float, float] | None
    texture: TextureUse | None = None
    primvar: str = ""


class Materials:
    """Reads each material and each image once; shared between files, what is equal in them is one texture.

    Attributes:
        left_out: Why materials are not shown, one line for each that has a texture which cannot be.
    """

    def __init__(self) -> None:
        """Nothing is read yet."""
        self.left_out: list[str] = []
        self._surfaces: dict[tuple[Usd.Stage, Sdf.Path], Surface | None] = {}
        self._images: dict[bytes, npt.NDArray[np.uint8] | None] = {}
        self._textures: dict[tuple[bytes, tuple[bool, bool]], Texture] = {}

    def surface_of(self, prim: Usd.Prim) -> Surface | None:
        """The surface of a mesh or subset; None without a material of UsdPreviewSurface."""
        material = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
        if not material:
            return None
        key = (prim.GetStage(), material.GetPath())
        if key not in self._surfaces:
            self._surfaces[key] = self._read(material)
        return self._surfaces[key]

    def _read(self, material: UsdShade.Material) -> Surface | None:
        shader = material.ComputeSurfaceSource()[0]
        if not shader or shader.GetIdAttr().Get() != "UsdPreviewSurface":
            return None
        base = shader.GetInput("diffuseColor")
        if not base:
            # What the specification of UsdPreviewSurface has for it.
            return Surface((0.18, 0.18, 0.18))
        source = source_of(base)
        if isinstance(source, UsdShade.Shader):
            return self._from_node(source)
        return Surface(_color(source.Get() if source else base.Get()) or (0.18, 0.18, 0.18))

    def _from_node(self, node: UsdShade.Shader) -> Surface | None:
        kind = str(node.GetIdAttr().Get() or "")
        if kind.startswith("UsdPrimvarReader_float3"):
            return Surface(None, primvar=_text(value_of(node, "varname")))
        if kind != "UsdUVTexture":
            return None
        asset = value_of(node, "file")
        image = self._image(asset)
        if image is None:
            name = getattr(asset, "path", "") or "none"
            why = "tiles are not shown" if "<UDIM>" in name else "it is missing, or no image that can be read"
            self.leave_out(f"{node.GetPath().GetParentPath()}: texture {name} is not shown: {why}")
            fallback = _color(value_of(node, "fallback"))
            # What the specification has without one is black, in which no shape is to be seen.
            return None if fallback is None else Surface(fallback)
        pixels, content = image
        repeats = tuple(str(value_of(node, name) or "") not in ("clamp", "black") for name in ("wrapS", "wrapT"))
        texture = self._textures.setdefault(
            (content, (repeats[0], repeats[1])), Texture(pixels, (repeats[0], repeats[1]))
        )
        primvar, transform = coordinates_of(node)
        return Surface(_color(value_of(node, "scale")) or (1.0, 1.0, 1.0), TextureUse(texture, primvar, transform))

    def leave_out(self, line: str) -> None:
        """Note why something is not shown, once."""
        if line not in self.left_out:
            self.left_out.append(line)

    def _image(self, asset: Any) -> tuple[npt.NDArray[np.uint8], bytes] | None:
        place = str(getattr(asset, "resolvedPath", "") or "")
        if not place:
            return None
        file = io.BytesIO()
        try:
            copy_asset(place, file)
        except (StageError, OSError):
            return None
        content = file.getvalue()
        if content not in self._images:
            self._images[content] = _decoded(content)
        pixels = self._images[content]
        return None if pixels is None else (pixels, content)


def _decoded(content: bytes) -> npt.NDArray[np.uint8] | None:
    """Pixels, made smaller; None for what is no image that can be read."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            image = Image.open(io.BytesIO(content))
        with image:
            # JPEG files are read at a smaller size at once.
            image.draft("RGB", (LARGEST_TEXTURE, LARGEST_TEXTURE))
            small = image.convert("RGB")
            small.thumbnail((LARGEST_TEXTURE, LARGEST_TEXTURE), Image.Resampling.LANCZOS)
            return np.array(small)
    except IMAGE_ERRORS:
        return None


def source_of(port: UsdShade.Input) -> UsdShade.Shader | UsdShade.Input | None:
    """The shader whose output an input is connected to, or the input of the material that has its value."""
    attributes = port.GetValueProducingAttributes()
    if not attributes:
        return None
    if UsdShade.Output.IsOutput(attributes[0]):
        return UsdShade.Shader(attributes[0].GetPrim())
    return UsdShade.Input(attributes[0])


def value_of(node: UsdShade.Shader, name: str) -> Any:
    """The value of an input, of the node itself or of the material's interface."""
    port = node.GetInput(name)
    source = source_of(port) if port else None
    return source.Get() if isinstance(source, UsdShade.Input) else None


def _color(value: Any) -> tuple[float, float, float] | None:
    """The first three numbers of a value, 0 and larger; None for what is none."""
    found = numbers_of(value, 3)
    return None if found is None else (max(found[0], 0.0), max(found[1], 0.0), max(found[2], 0.0))


def numbers_of(value: Any, count: int) -> list[float] | None:
    """The first numbers of a value of whatever type; None for what has fewer, or one that is not finite."""
    try:
        found = [float(value)] if count == 1 else [float(value[index]) for index in range(count)]
    except (TypeError, ValueError, IndexError, OverflowError):
        return None
    return found if all(map(math.isfinite, found)) else None


def _text(value: Any) -> str:
    return "" if value is None else str(value)


def coordinates_of(node: UsdShade.Shader) -> tuple[str, npt.NDArray[np.float64]]:
    """Name of the primvar that a texture lies on, and the transform of its values."""
    transform = np.eye(3)
    port = node.GetInput("st")
    for _ in range(MAX_NODES):
        source = source_of(port) if port else None
        if not isinstance(source, UsdShade.Shader):
            break
        kind = str(source.GetIdAttr().Get() or "")
        if kind.startswith("UsdPrimvarReader_float2"):
            return _text(value_of(source, "varname")) or "st", transform[:, :2]
        if kind != "UsdTransform2d":
            break
        # The node nearest to the primvar is applied first.
        transform = _transform_of(source) @ transform
        port = source.GetInput("in")
    return "st", transform[:, :2]


def _transform_of(node: UsdShade.Shader) -> npt.NDArray[np.float64]:
    """(3, 3): scale, then rotation counter-clockwise in degrees, then translation, for rows (u, v, 1)."""
    angle = np.radians((numbers_of(value_of(node, "rotation"), 1) or [0.0])[0])
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    matrix = np.eye(3)
    matrix[:2, :2] = np.diag(numbers_of(value_of(node, "scale"), 2) or [1.0, 1.0]) @ turn
    matrix[2, :2] = numbers_of(value_of(node, "translation"), 2) or [0.0, 0.0]
    return matrix
