"""The USD library that Python finds as `pxr`: from usd-core, from another package, or from a host application."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from importlib.metadata import distributions
from pathlib import Path

from warpqem.errors import UsdLibraryError

__all__ = ["OLDEST_USD", "need_usd"]

# The oldest version that the tests pass with; `usd-core` in pyproject.toml says the same.
OLDEST_USD = (24, 3)
# What warpqem imports of it, those that others need first. UsdLod is newer, and loaded only for levels that ask for it.
MODULES = ("Tf", "Gf", "Vt", "Ar", "Kind", "Sdf", "Pcp", "Usd", "UsdGeom", "UsdSkel", "UsdUtils")


def need_usd() -> None:
    """Load USD, or say what is wrong with it and what to install.

    Raises:
        UsdLibraryError: there is no `pxr`, it cannot be loaded, or it is older than `OLDEST_USD`.
    """
    spec = importlib.util.find_spec("pxr")
    if spec is None:
        raise UsdLibraryError(
            f"USD is not installed for {sys.executable or 'this Python'} (no module named pxr): pip install usd-core; "
            "in Houdini, Maya, Blender or Omniverse Kit run warpqem in the application's own Python, which brings USD"
        )
    folder = Path(next(iter(spec.submodule_search_locations or ()), "?"))
    try:
        loaded = {name: importlib.import_module(f"pxr.{name}") for name in MODULES}
        version = tuple(loaded["Usd"].GetVersion()[1:])
    # A file that is missing, a binary for another Python, an incomplete installation: each raises something else.
    except Exception as error:
        raise UsdLibraryError(
            f"{_named(folder)} cannot be loaded ({type(error).__name__}: {error}); {_remedy(folder)}"
        ) from error
    if version < OLDEST_USD:
        found = f"is USD {_text(version)}, but warpqem needs at least {_text(OLDEST_USD)}"
        raise UsdLibraryError(f"{_named(folder)} {found}; {_remedy(folder)}")


def _text(version: tuple[int, ...]) -> str:
    """A version as USD writes it, such as 24.03."""
    return ".".join(f"{part:02}" for part in version)


def _named(folder: Path) -> str:
    return f"USD at {folder} ({' and '.join(_packages(folder)) or 'part of no package that pip has installed'})"


def _packages(folder: Path) -> list[str]:
    """The installed packages that have files of a `pxr` folder, such as `usd-core 26.11`."""
    found = set()
    for package in distributions():
        first = next((file for file in package.files or () if file.parts[0] == "pxr"), None)
        if first is not None and Path(str(package.locate_file("pxr"))).resolve() == folder.resolve():
            found.add(f"{package.metadata['Name']} {package.version}")
    return sorted(found)


def _remedy(folder: Path) -> str:
    packages = _packages(folder)
    if len(packages) > 1:
        return "these packages overwrite each other's files: uninstall all of them and install one"
    if not packages:
        return "update the application that brings it, or take it off the path (PYTHONPATH) and pip install usd-core"
    return f"pip install --upgrade --force-reinstall {packages[0].split()[0]}"
