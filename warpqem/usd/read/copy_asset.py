"""Copies of files that a stage names, wherever they are."""

from __future__ import annotations

import os
import shutil
import zipfile
from typing import IO

from pxr import Ar

from warpqem.errors import StageError
from warpqem.files.archives import archive_files
from warpqem.files.file_kinds import check_regular
from warpqem.usd.checks.usd_errors import first_line

__all__ = ["copy_asset"]


def copy_asset(place: str, target: IO[bytes]) -> None:
    """Copy a file, which may be in a package or wherever a resolver looks.

    Args:
        place: Its resolved path.
        target: A file open for writing.

    Raises:
        StageError: it cannot be read.
        OSError: it cannot be written.
    """
    outer, inner = Ar.SplitPackageRelativePathOuter(place) if Ar.IsPackageRelativePath(place) else (place, "")
    check_regular(outer, StageError)
    if os.path.isfile(outer):
        with open(outer, "rb") as file:
            if not inner:
                shutil.copyfileobj(file, target)
                return
            try:
                _unpack(file, str(inner), target)
            except (zipfile.BadZipFile, KeyError, ValueError, EOFError) as error:
                raise StageError(f"{place}: cannot be read ({first_line(error)})") from error
        return
    # Early versions of USD offer this to C++ alone.
    asset = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(place)) if hasattr(Ar.Resolver, "OpenAsset") else None
    if asset is None:
        raise StageError(f"{place}: cannot be read")
    target.write(asset.GetBuffer())


def _unpack(package: IO[bytes], inner: str, file: IO[bytes]) -> None:
    """Copy a file out of a package, which may lie in a package there."""
    name, rest = Ar.SplitPackageRelativePathOuter(inner) if Ar.IsPackageRelativePath(inner) else (inner, "")
    with zipfile.ZipFile(package) as archive, archive.open(archive_files(archive)[str(name)]) as entry:
        if rest:
            _unpack(entry, str(rest), file)
        else:
            shutil.copyfileobj(entry, file)
