"""Files of other programs: what brings them to a format that is read, and back."""

from __future__ import annotations

import os
from dataclasses import dataclass

__all__ = ["READ", "how_to_read", "how_to_write"]

READ = "USD (.usd, .usda, .usdc, .usdz), .glb, .gltf, .obj, .ply, .stl and .off"
EXPORT = "File > Export > Universal Scene Description"


@dataclass(frozen=True)
class _Format:
    """A format that is neither read nor written here.

    Attributes:
        name: what people call it.
        reader: what makes USD of it.
        writer: what makes it of USD; empty where that is not known.
    """

    name: str
    reader: str
    writer: str = ""


def _by_blender(name: str, menu: str) -> _Format:
    reader = f"in Blender File > Import > {menu}, then {EXPORT}"
    writer = f"in Blender File > Import > Universal Scene Description, then File > Export > {menu}"
    return _Format(name, reader, writer)


_BLENDER = _Format("a Blender scene", f"in Blender {EXPORT}, with Animation", "in Blender by File > Import")
_MAYA = _Format("a Maya scene", "in Maya File > Export All, as USD Export (the plug-in mayaUsdPlugin)")
_HOUDINI = _Format("a Houdini scene", "in Houdini by a USD node (USD ROP)")
_POINT_CACHE = _Format(
    "a point cache without faces", f"in Blender on its mesh by the modifier Mesh Cache, then {EXPORT}"
)
_FORMATS = {
    ".fbx": _by_blender("FBX", "FBX"),
    ".abc": _by_blender("Alembic", "Alembic"),
    ".dae": _by_blender("Collada", "Collada"),
    ".blend": _Format(
        "a Blender scene", f"in Blender {EXPORT}, with Animation", "in Blender by importing the USD file"
    ),
    ".ma": _MAYA,
    ".mb": _MAYA,
    ".max": _Format("a 3ds Max scene", "in 3ds Max File > Export, as USD"),
    ".c4d": _Format("a Cinema 4D scene", "in Cinema 4D File > Export, as USD"),
    ".hip": _HOUDINI,
    ".hipnc": _HOUDINI,
    ".hiplc": _HOUDINI,
    ".uasset": _Format("an Unreal asset", "in Unreal by Asset Actions > Export, as USD"),
    ".bvh": _Format("motion without a mesh", f"in Blender with a character that it moves, then {EXPORT}"),
    ".mdd": _POINT_CACHE,
    ".pc2": _POINT_CACHE,
    ".vrm": _Format("glTF by another name", "as a copy with the suffix .glb"),
}


def how_to_read(path: str | os.PathLike[str]) -> str:
    """What a file in a format that is not read is, and how to convert it."""
    suffix = _suffix(path)
    known = _FORMATS.get(suffix)
    if known is None:
        return f"{suffix or 'a name without a suffix'} is none of the formats that are read: {READ}; convert it to USD"
    return f"{suffix} is {known.name}, which is not read; convert it to USD: {known.reader}"


def how_to_write(path: str | os.PathLike[str]) -> str:
    """How to get a file in a format that is not written; empty where that is not known."""
    known = _FORMATS.get(_suffix(path))
    if known is None or not known.writer:
        return ""
    return f"; for {known.name} write a .usd file, and convert that: {known.writer}"


def _suffix(path: str | os.PathLike[str]) -> str:
    return os.path.splitext(os.fspath(path))[1].lower()
