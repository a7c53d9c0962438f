"""Names of mesh files: which are any, the files of a pattern in their order, and the frames that they are."""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from warpqem.errors import MeshFileError, OptionError

__all__ = ["find_mesh_files", "frame_numbers", "is_mesh_name", "natural_key", "numbered_files"]

# Formats that trimesh reads and writes without a further package, known without loading it.
SUFFIXES = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf")
ARCHIVES = ("bz2", "gz", "tar", "zip")
# What else it reads are meshes, but for drawings, clouds of points and its own dumps; USD files are USD's.
NO_MESHES = (*ARCHIVES, "dict", "dict64", "dxf", "json", "msgpack", "svg", "usd", "usda", "usdc", "usdz", "xyz")
# Stands for the number of a frame in a name, a digit each at least.
NUMBER = re.compile(r"#+")
DIGITS = re.compile(r"(\d+)")


def is_mesh_name(path: str | os.PathLike[str]) -> bool:
    """True for the name of a mesh file, or a pattern of such names, by its suffix."""
    suffix = os.path.splitext(os.fspath(path))[1].lower()
    if suffix in SUFFIXES:
        return True
    if not suffix or suffix[1:] in NO_MESHES:
        return False
    import trimesh

    return suffix[1:] in trimesh.available_formats()


def natural_key(path: str | os.PathLike[str]) -> tuple[object, ...]:
    """What sorts names as people do: horse-2 before horse-10."""
    parts = DIGITS.split(os.fspath(path))
    return tuple((int(part), part) if index % 2 else part for index, part in enumerate(parts))


def find_mesh_files(pattern: str | os.PathLike[str] | Sequence[str | os.PathLike[str]]) -> list[str]:
    """The files of a sequence, in their order.

    Args:
        pattern: One file; a pattern such as "horse-*.ply" or "horse.####.ply", whose files come in natural order; or
            the files themselves, in the order given.

    Raises:
        MeshFileError: there is no such file.
        OptionError: a name is no mesh file's.
    """
    if not isinstance(pattern, (str, os.PathLike)):
        files = [os.fspath(path) for path in pattern]
        if not files:
            raise OptionError("mesh files: an empty list; expected at least one file")
        for path in files:
            _check_name(path)
        return files
    text = os.fspath(pattern)
    _check_name(text)
    # A name that is there is no pattern, whatever is in it.
    if os.path.lexists(text):
        return [text]
    if NUMBER.search(os.path.basename(text)):
        folder, name = os.path.split(text)
        numbered = re.compile(r"\d+".join(map(re.escape, NUMBER.split(name))))
        found = [os.path.join(folder, entry) for entry in _entries(folder or ".") if numbered.fullmatch(entry)]
    else:
        found = glob.glob(text, recursive=True)
    if not found:
        raise MeshFileError(f"{text}: no such file")
    return sorted(found, key=natural_key)


def frame_numbers(files: Sequence[str]) -> list[int]:
    """The frame that each file of a sequence is: the last number in its name, or 1, 2, ... where these do not rise."""
    found = [DIGITS.findall(Path(path).stem) for path in files]
    if all(found):
        numbers = [int(parts[-1]) for parts in found]
        if all(earlier < later for earlier, later in pairwise(numbers)):
            return numbers
    return list(range(1, len(files) + 1))


def numbered_files(output: str | os.PathLike[str], numbers: Sequence[int], option: str = "output") -> list[str]:
    """The file of each frame for an output such as "out/horse_####.ply".

    Args:
        output: A name with one row of #, each a digit at least; or of one file, for one frame.
        numbers: The frames.
        option: What messages call it.

    Raises:
        OptionError: there are several frames, and their place in the name is missing; or it has several.
    """
    folder, name = os.path.split(os.fspath(output))
    places = NUMBER.findall(name)
    if len(places) > 1:
        raise OptionError(f"{option} {output}: expected one row of #, which stands for the frame")
    if not places:
        if len(numbers) > 1:
            stem, suffix = os.path.splitext(os.fspath(output))
            raise OptionError(f"{option} {output}: {len(numbers)} frames need a file each, such as {stem}_####{suffix}")
        return [os.fspath(output)]
    return [os.path.join(folder, NUMBER.sub(f"{number:0{len(places[0])}d}", name)) for number in numbers]


def _check_name(path: str) -> None:
    if not is_mesh_name(path):
        raise OptionError(f"{path}: no mesh file by its name; expected one of {', '.join(SUFFIXES)}")


def _entries(folder: str) -> list[str]:
    try:
        return os.listdir(folder)
    except OSError:
        return []
