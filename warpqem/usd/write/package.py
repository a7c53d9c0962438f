"""USD packages (.usdz): a layer and all files that it names in one uncompressed zip archive.

The layer comes first, and each file starts at a multiple of 64 bytes, as the specification of usdz asks for; USD's own
writer sees to the latter.
"""

from __future__ import annotations

import os
import re
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pxr import Sdf, Tf, Usd, UsdUtils

from warpqem.errors import StageError
from warpqem.files.archives import archive_files
from warpqem.files.temporary import remove_path, replacing, temporary_path
from warpqem.usd.checks.usd_errors import first_line
from warpqem.usd.read.copy_asset import copy_asset
from warpqem.usd.write.collect_files import Collection

__all__ = ["PACKAGE_SUFFIX", "is_package", "write_package", "write_package_with_layers"]

PACKAGE_SUFFIX = ".usdz"
# A zip archive without extensions, which the specification excludes, counts bytes with 32 bits.
MAX_BYTES = 2**32 - 1
# Files of an archive bear a time. One for all of them, 1980-01-02, makes an archive the same bytes on every run; zip
# has no earlier one than 1980-01-01, in local time.
FILE_TIME = 315_619_200
# What the specification of usdz allows in a package beside layers.
ALLOWED = re.compile(r"\.(usd[acz]?|png|jpe?g|exr|avif|m4a|mp3|wav)$", re.IGNORECASE)


def is_package(path: str | os.PathLike[str]) -> bool:
    """True for the name of a package."""
    return os.fspath(path).lower().endswith(PACKAGE_SUFFIX)


def write_package(layer: Sdf.Layer, collection: Collection, output: Path) -> list[str]:
    """Write a flat layer and the files gathered from it as a package, under a temporary name first.

    Args:
        layer: The layer; its attributes name their files relative to it.
        collection: Those files.
        output: The package.

    Returns:
        What programs may not read, one line each.

    Raises:
        StageError: the package cannot be written, or a file not read; nothing is left behind.
    """
    with _work_folder(output) as folder:
        root = folder / f"{output.stem}.usdc"
        if not layer.Export(os.fspath(root)):
            raise StageError(f"{output}: USD cannot write it")
        files = {root.name: root}
        for number, (name, source) in enumerate(collection.files.items()):
            files[name] = folder / f"{number}.file"
            with open(files[name], "wb") as file:
                copy_asset(source, file)
        _write_archive(files, output)
    return _foreign(collection.files, output)


def write_package_with_layers(layer: Sdf.Layer, output: Path) -> list[str]:
    """Write a layer, those that it refers to and all files that they name as a package, under a temporary name first.

    Args:
        layer: The layer; it names others by absolute paths.
        output: The package.

    Returns:
        What programs may not read, one line each.

    Raises:
        StageError: the package cannot be written; nothing is left behind.
    """
    with _work_folder(output) as folder:
        root = folder / f"{output.stem}.usdc"
        if not layer.Export(os.fspath(root)):
            raise StageError(f"{output}: USD cannot write it")
        _, _, missing = UsdUtils.ComputeAllDependencies(Sdf.AssetPath(os.fspath(root)))
        packed, local = folder / "all.usdz", folder / "local"
        # False, or an error, also where a file is missing, as one is that the input names in vain.
        try:
            done = UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(os.fspath(root)), os.fspath(packed))
        except Tf.ErrorException:
            done = False
        if not packed.is_file() or not (done or missing):
            raise StageError(f"{output}: USD cannot gather the files that the input names")
        with zipfile.ZipFile(packed) as archive:
            files = {name: Path(archive.extract(entry, local)) for name, entry in archive_files(archive).items()}
        _write_archive(files, output)
    lost = [f"{path}: missing, so that the package lacks it" for path in missing]
    return lost + _foreign(files, output)


@contextmanager
def _work_folder(output: Path) -> Iterator[Path]:
    """A folder beside the output for the files of the package, which goes away."""
    folder = temporary_path(output.parent, ".package")
    try:
        folder.mkdir()
        yield folder
    except (OSError, Tf.ErrorException) as error:
        raise StageError(f"{output}: cannot be written ({first_line(error)})") from error
    finally:
        remove_path(folder)


def _write_archive(files: Mapping[str, Path], output: Path) -> None:
    """Write files as an archive, in their order.

    Raises:
        StageError: USD cannot write it, or it would be too large.
        OSError: the file cannot be written.
    """
    size = sum(path.stat().st_size for path in files.values())
    if size > MAX_BYTES:
        raise StageError(f"{output}: the files of the package have {size} bytes, and it can hold {MAX_BYTES}")
    # Moved from Usd to Sdf in later versions.
    module: Any = Sdf if hasattr(Sdf, "ZipFileWriter") else Usd
    with replacing(output) as temporary:
        writer = module.ZipFileWriter.CreateNew(os.fspath(temporary))
        for name, path in files.items():
            os.utime(path, (FILE_TIME, FILE_TIME))
            if not writer.AddFile(os.fspath(path), name):
                raise StageError(f"{output}: USD cannot add {name}")
        if not writer.Save():
            raise StageError(f"{output}: USD cannot write it")


def _foreign(names: Iterable[str], output: Path) -> list[str]:
    return [
        f"{output}: {name}: no kind of file that the specification of usdz allows; some programs do not show it"
        for name in names
        if not ALLOWED.search(name)
    ]
