"""Look at the bytes of a layer or package before USD parses them."""

from __future__ import annotations

import os
import re
import zipfile
from pathlib import Path
from typing import IO

import numpy as np
from pxr import Ar

from warpqem.errors import StageError
from warpqem.usd.checks.usd_errors import first_line

__all__ = ["CRATE", "MAX_NESTED", "QUOTED", "check_bytes", "check_stream"]

# Brackets and prims in each other. Scenes have some dozens; USD's own stack ends between 20 000 and 100 000.
MAX_NESTED = 1000
# Text is looked at as a whole, so it must fit in memory several times over; larger scenes are binary.
MAX_TEXT_BYTES = 4 * 2**30
# A package is a zip archive of files that are stored as they are; a directory of more of them is no asset.
MAX_PACKAGE_FILES = 100_000
# Packages in each other; each is looked through as often as it has packages around it.
MAX_PACKAGES_DEEP = 16

CRATE, TEXT, PACKAGE = b"PXR-USDC", (b"#usda", b"#sdf"), b"PK\x03\x04"
# What brackets may stand in without being any: strings, asset paths, comments.
QUOTED = re.compile(
    rb'"""(?:[^"\\]|\\.|"(?!""))*"""|\'\'\'(?:[^\'\\]|\\.|\'(?!\'\'))*\'\'\'|"(?:[^"\\\n]|\\.)*"|\'(?:[^\'\\\n]|\\.)*\''
    rb"|@@@.*?@@@|@[^@\n]*@|#[^\n]*|//[^\n]*|/\*.*?\*/",
    re.DOTALL,
)
_STEPS = np.zeros(256, dtype=np.int8)
_STEPS[list(b"([{")] = 1
_STEPS[list(b")]}")] = -1
# Bytes whose nesting is counted at a time.
_BLOCK = 2**24


def check_bytes(file: str, by: str = "") -> None:
    """Look at the bytes of a layer or package before USD does.

    Args:
        file: A regular file.
        by: Who names it, for the message.

    Raises:
        StageError: it cannot be read, or USD could not read it safely.
    """
    try:
        with open(file, "rb") as stream:
            check_stream(stream, file, by)
    except OSError as error:
        raise StageError(f"{file}{by}: cannot be read ({error.strerror or error})") from error


def check_stream(stream: IO[bytes], file: str, by: str = "") -> None:
    """The same for the bytes of what is no file on disk.

    Args:
        stream: The bytes, from their start.
        file: What to call it.
        by: Who names it, for the message.

    Raises:
        StageError: USD could not read it safely.
    """
    size = stream.seek(0, os.SEEK_END)
    stream.seek(0)
    start = stream.read(8)
    if not start:
        raise StageError(f"{file}{by}: an empty file, which USD cannot open")
    if start.startswith(TEXT):
        if size > MAX_TEXT_BYTES:
            raise StageError(f"{file}{by}: text of more than {MAX_TEXT_BYTES} bytes; binary files may be larger")
        # No more than there was: a file may grow for ever.
        _check_nesting(start + stream.read(size), file + by)
    elif start.startswith(PACKAGE):
        _check_package(stream, size, file, by)


def _check_nesting(text: bytes, name: str) -> None:
    steps = _STEPS[np.frombuffer(QUOTED.sub(b" ", text), dtype=np.uint8)]
    depth = 0
    for start in range(0, len(steps), _BLOCK):
        depths = depth + np.cumsum(steps[start : start + _BLOCK], dtype=np.int32)
        if depths.max() > MAX_NESTED:
            raise StageError(f"{name}: brackets nested more than {MAX_NESTED} deep")
        depth = int(depths[-1])


def _check_package(stream: IO[bytes], size: int, name: str, by: str, depth: int = 1) -> None:
    """Look at a package and at those in it.

    Args:
        stream: Its bytes.
        size: How many there are.
        name: Path, also one into a package.
        by: Who names it.
        depth: How many packages there are, this one among them.
    """
    if depth > MAX_PACKAGES_DEEP:
        raise StageError(f"{name}{by}: more than {MAX_PACKAGES_DEEP} packages in each other")
    try:
        with zipfile.ZipFile(stream) as package:
            entries = package.infolist()
            if len(entries) > MAX_PACKAGE_FILES:
                raise StageError(f"{name}{by}: a package of more than {MAX_PACKAGE_FILES} files")
            for entry in entries:
                _check_entry(entry, size, name + by)
                with package.open(entry) as file:
                    start = file.read(8)
                    inner = str(Ar.JoinPackageRelativePath(name, entry.filename))
                    if start.startswith(TEXT):
                        _check_nesting(start + file.read(), inner + by)
                    elif start.startswith(PACKAGE):
                        _check_package(file, entry.file_size, inner, by, depth + 1)
    except (zipfile.BadZipFile, NotImplementedError, EOFError, OSError, ValueError, RuntimeError) as error:
        raise StageError(f"{name}{by}: no package that could be read ({first_line(error)})") from error


def _check_entry(entry: zipfile.ZipInfo, size: int, name: str) -> None:
    if entry.compress_type != zipfile.ZIP_STORED or entry.file_size != entry.compress_size:
        raise StageError(f"{name}: {entry.filename} in the package is compressed, which USD forbids")
    if entry.file_size > size:
        raise StageError(f"{name}: {entry.filename} in the package is said to be larger than it")
    if entry.filename.startswith(("/", "\\")) or ".." in Path(entry.filename).parts:
        raise StageError(f"{name}: {entry.filename} in the package names a place outside of it")
