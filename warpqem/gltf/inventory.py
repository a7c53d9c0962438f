"""What a glTF file holds, by its JSON: clips, skins, morph targets, materials; and what of it another file has."""

from __future__ import annotations

import base64
import json
import os
import re
import struct
import urllib.parse
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from warpqem.errors import MeshFileError

__all__ = [
    "SUFFIXES",
    "GltfPart",
    "compare_gltf",
    "frame_rate",
    "gltf_parts",
    "is_animated",
    "is_animated_gltf",
    "read_gltf",
]

SUFFIXES = (".glb", ".gltf")
GLB_MAGIC, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942
# Bytes of JSON that are read at most: a scene of 100000 nodes has 30 MB.
MAX_JSON = 2**28
# Rates at which clips are sampled; one of them has all keys of most files.
RATES = (24, 25, 30, 48, 50, 60)
# Parts of a frame that keys may be further off: they are single precision, and some tools round to milliseconds.
TIME_TOLERANCE = 0.02


@dataclass(frozen=True)
class GltfPart:
    """Something in a file.

    Attributes:
        kind: such as "clip".
        name: its name; empty for none.
        seconds: how long a clip is; None for what is none.
        counts: what else there is to count, such as "joints".
    """

    kind: str
    name: str
    seconds: float | None = None
    counts: Mapping[str, int] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"{self.kind} {self.name!r}" if self.name else self.kind


@dataclass(frozen=True)
class _File:
    path: Path
    json: dict[str, Any]
    binary: bytes


def read_gltf(path: str | os.PathLike[str]) -> _File:
    """The JSON of a .glb or .gltf file, and the binary part that a .glb has.

    Raises:
        MeshFileError: it cannot be read, or is no glTF 2 file.
    """
    place = Path(path)
    try:
        with place.open("rb") as file:
            head = file.read(12)
            binary = b""
            if len(head) == 12 and struct.unpack("<I", head[:4])[0] == GLB_MAGIC:
                chunks = dict(_chunks(file))
                text, binary = chunks.get(JSON_CHUNK, b""), chunks.get(BINARY_CHUNK, b"")
            else:
                text = head + file.read(MAX_JSON)
        found = json.loads(text.decode("utf-8"))
    except OSError as error:
        raise MeshFileError(f"{place}: cannot be read ({error.strerror})") from error
    except (ValueError, struct.error) as error:
        raise MeshFileError(f"{place}: no glTF file ({error})") from error
    if not isinstance(found, dict) or str(found.get("asset", {}).get("version", "")).partition(".")[0] != "2":
        raise MeshFileError(f"{place}: no glTF 2 file")
    return _File(place, found, binary)


def _chunks(file: Any) -> Iterator[tuple[int, bytes]]:
    while len(head := file.read(8)) == 8:
        length, kind = struct.unpack("<II", head)
        if kind == JSON_CHUNK and length > MAX_JSON:
            raise ValueError(f"{length} bytes of JSON")
        yield kind, file.read(length)


def is_animated(file: _File) -> bool:
    """Whether there are clips, skins or morph targets, which mesh files have none of."""
    found = file.json
    targets = any(part.get("targets") for mesh in found.get("meshes", []) for part in mesh.get("primitives", []))
    return bool(found.get("animations") or found.get("skins") or targets)


def is_animated_gltf(path: str | os.PathLike[str]) -> bool:
    """Whether a path is a glTF file with clips, skins or morph targets; trimesh reads the others."""
    if Path(path).suffix.lower() not in SUFFIXES or not os.path.isfile(path):
        return False
    try:
        return is_animated(read_gltf(path))
    except MeshFileError:
        # The reader of mesh files says what is wrong with it.
        return False


def gltf_parts(file: _File) -> list[GltfPart]:
    """What a file holds, in its order."""
    found = file.json
    parts = [
        GltfPart("clip", _name(clip), _duration(found, clip), {"animated nodes": _animated_nodes(clip)})
        for clip in found.get("animations", [])
    ]
    parts += [GltfPart("skin", _name(skin), None, {"joints": len(skin["joints"])}) for skin in found.get("skins", [])]
    # By the node that shows it: a mesh often has no name, or another one.
    shown = [node for node in found.get("nodes", []) if "mesh" in node]
    parts += [GltfPart("mesh", _name(node), None, _mesh_counts(found["meshes"][node["mesh"]])) for node in shown]
    parts += [GltfPart("material", _name(one), None, _texture_counts(one)) for one in found.get("materials", [])]
    parts += [GltfPart("image", "") for _ in found.get("images", [])]
    parts += [GltfPart("camera", _name(camera)) for camera in found.get("cameras", [])]
    lights = found.get("extensions", {}).get("KHR_lights_punctual", {}).get("lights", [])
    parts += [GltfPart("light", _name(light)) for light in lights]
    return parts + [GltfPart("extension", name) for name in sorted(found.get("extensionsUsed", []))]


def _name(entry: Mapping[str, Any]) -> str:
    return str(entry.get("name", ""))


def _animated_nodes(clip: Mapping[str, Any]) -> int:
    return len({channel["target"].get("node") for channel in clip["channels"]})


def _duration(found: Mapping[str, Any], clip: Mapping[str, Any]) -> float:
    inputs = [found["accessors"][sampler["input"]] for sampler in clip["samplers"]]
    first = min((entry.get("min", [0.0])[0] for entry in inputs), default=0.0)
    return float(max((entry.get("max", [0.0])[0] for entry in inputs), default=0.0) - first)


def _mesh_counts(mesh: Mapping[str, Any]) -> dict[str, int]:
    primitives = mesh["primitives"]
    attributes = [set(part["attributes"]) for part in primitives]

    def most(start: str) -> int:
        return max(sum(name.startswith(start) for name in names) for names in attributes)

    counts = {
        "morph targets": max(len(part.get("targets", [])) for part in primitives),
        "materials": len({part["material"] for part in primitives if "material" in part}),
        "UV sets": most("TEXCOORD_"),
        "colour sets": most("COLOR_"),
        "sets of joints": most("JOINTS_"),
        "sets of tangents": most("TANGENT"),
    }
    return {name: count for name, count in counts.items() if count}


def _texture_counts(material: Mapping[str, Any]) -> dict[str, int]:
    count = len(re.findall(r'Texture": \{', json.dumps(material)))
    return {"textures": count} if count else {}


def compare_gltf(before: list[GltfPart], after: list[GltfPart], frame: float) -> tuple[list[str], list[str]]:
    """What a file kept of another one, and what it lost, in lines.

    Args:
        before: What the first file holds.
        after: What the second one holds.
        frame: Seconds of a frame: clips are as long as each other within it.

    Returns:
        Lines of what was kept, by kind, and of what is missing or has fewer of something.
    """
    kept, lost = dict[str, int](), list[str]()
    left, names = list(after), {(part.kind, part.name) for part in before}
    # Those with the same name first: what is left may have lost its name.
    for part in sorted(before, key=lambda part: (part.kind, part.name) not in {(o.kind, o.name) for o in after}):
        found = _counterpart(part, left, names)
        if found is None:
            lost.append(f"{part} is lost")
            continue
        left.remove(found)
        if part.name and found.name != part.name:
            lost.append(f"{part} is named {found.name!r} now")
            continue
        fewer = [
            f"{part}: {found.counts.get(name, 0)} of {count} {name} are left"
            for name, count in part.counts.items()
            if found.counts.get(name, 0) < count
        ]
        if part.seconds is not None and found.seconds is not None and abs(found.seconds - part.seconds) > frame:
            fewer.append(f"{part}: {found.seconds:.3f} s of {part.seconds:.3f} s are left")
        lost += fewer
        if not fewer:
            kept[part.kind] = kept.get(part.kind, 0) + 1
    targets = sum(part.counts.get("morph targets", 0) for part in before)
    lines = [f"{count} {kind}{'' if count == 1 else 'es' if kind == 'mesh' else 's'}" for kind, count in kept.items()]
    if targets and not any("morph targets" in line for line in lost):
        lines.append(f"{targets} morph target{'s' * (targets != 1)}")
    return lines, lost


def _counterpart(part: GltfPart, others: list[GltfPart], names: set[tuple[str, str]]) -> GltfPart | None:
    """What a part is in another file: that of its name, or one whose name is new there."""
    alike = [other for other in others if other.kind == part.kind]
    named = [other for other in alike if other.name == part.name]
    # Names of extensions are what they are.
    new = [other for other in alike if (other.kind, other.name) not in names and other.kind != "extension"]
    return next(iter(named or new), None)


def frame_rate(file: _File) -> int:
    """The frames per second whose frames are nearest to the keys of all clips; 30 where nothing moves."""
    inputs = {sampler["input"] for clip in file.json.get("animations", []) for sampler in clip["samplers"]}
    times = [found for found in (_scalars(file, index) for index in sorted(inputs)) if found is not None]
    if not times:
        return 30
    keys = np.unique(np.concatenate(times)).astype(np.float64)
    off = [float(np.abs(keys * rate - np.round(keys * rate)).mean()) for rate in RATES]
    # Of rates that are as near the lowest: every frame of 24 is one of 48.
    return next(rate for rate, far in zip(RATES, off, strict=True) if far <= min(off) + TIME_TOLERANCE)


def _scalars(file: _File, index: int) -> np.ndarray | None:
    """The numbers of an accessor of times; None where its data cannot be had."""
    accessor = file.json["accessors"][index]
    if "bufferView" not in accessor or accessor.get("componentType") != 5126:
        return None
    view = file.json["bufferViews"][accessor["bufferView"]]
    data = _buffer(file, view["buffer"])
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    if data is None or view.get("byteStride", 4) != 4 or start + 4 * accessor["count"] > len(data):
        return None
    return np.frombuffer(data, dtype="<f4", count=accessor["count"], offset=start)


def _buffer(file: _File, index: int) -> bytes | None:
    uri = file.json["buffers"][index].get("uri")
    if uri is None:
        return file.binary
    if uri.startswith("data:"):
        return base64.b64decode(uri.partition(",")[2])
    place = file.path.parent / urllib.parse.unquote(uri)
    return place.read_bytes() if place.is_file() else None
