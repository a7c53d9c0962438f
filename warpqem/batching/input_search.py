"""The USD files that a folder or a pattern holds, also where links lead to them in several ways or in circles."""

from __future__ import annotations

import fnmatch
import glob
import os
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

__all__ = ["INPUT_SUFFIXES", "files_below", "fixed_part", "is_usd_name", "match_pattern", "same_file_key"]

INPUT_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
# Stands for any number of folders in a pattern.
ANY_FOLDERS = "**"


def is_usd_name(name: str) -> bool:
    """True for the name of a USD file that is not hidden."""
    return not name.startswith(".") and os.path.splitext(name)[1].lower() in INPUT_SUFFIXES


def same_file_key(path: Path) -> tuple[object, ...]:
    """What two paths to one file have in common.

    A file with one name is known by its number, also where a folder is mounted twice. One with several names (hard
    links) may have them to save room on the disk: each is a file of its own.
    """
    try:
        found = path.stat()
    except (OSError, ValueError):
        return (os.path.realpath(path),)
    return (found.st_dev, found.st_ino) if found.st_nlink == 1 else (os.path.realpath(path),)


def files_below(folder: Path) -> list[Path]:
    """The USD files below a folder, but not what is hidden; links to folders are not followed."""
    files = []
    for where, folders, names in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        files += [Path(where, name) for name in sorted(names) if is_usd_name(name)]
    return files


def fixed_part(pattern: str) -> Path:
    """The folder that all matches of a pattern lie in, as far as it is written out."""
    parts = []
    for part in Path(pattern).parts[:-1]:
        if glob.has_magic(part):
            break
        parts.append(part)
    return Path(*parts).absolute() if parts else Path.cwd()


@dataclass(frozen=True)
class _State:
    """A folder, or at the end of a pattern a file, and how many parts of the pattern have led to it."""

    path: Path
    matched: int


def match_pattern(pattern: str) -> list[Path]:
    """What a pattern such as "shots/**/*.usd" stands for, sorted: files and folders, as `glob.glob` finds them.

    Links to folders are followed, but no folder is searched twice for the same part of the pattern. What can be reached
    without a link is named by that way.
    """
    base = fixed_part(pattern)
    parts = Path(pattern).absolute().parts[len(base.parts) :]
    waiting, behind_links = deque([_State(base, 0)]), deque[_State]()
    seen: set[tuple[object, ...]] = set()
    found: dict[Path, None] = {}
    while waiting or behind_links:
        state = waiting.popleft() if waiting else behind_links.popleft()
        if state.matched == len(parts):
            found[state.path] = None
            continue
        key = _folder_key(state)
        if key is None or key in seen:
            continue
        seen.add(key)
        for later in _steps(state, parts[state.matched]):
            (behind_links if later.path.is_symlink() and later.path != state.path else waiting).append(later)
    return sorted(found)


def _folder_key(state: _State) -> tuple[object, ...] | None:
    """Identity of a folder, also where links or mounts lead to it, and what is still to be matched."""
    try:
        found = state.path.stat()
    except (OSError, ValueError):
        return None
    return (found.st_dev, found.st_ino, state.matched)


def _steps(state: _State, part: str) -> Iterator[_State]:
    """Where one more part of a pattern leads to from a folder."""
    after = state.matched + 1
    if part != ANY_FOLDERS and not glob.has_magic(part):
        if os.path.lexists(state.path / part):
            yield _State(state.path / part, after)
        return
    try:
        names = sorted(os.listdir(state.path))
    except OSError:
        return
    if part == ANY_FOLDERS:
        yield _State(state.path, after)
        names = [name for name in names if not name.startswith(".")]
        yield from (_State(state.path / name, state.matched) for name in names if (state.path / name).is_dir())
        # Behind the last part it stands for files, too.
        yield from (_State(state.path / name, after) for name in names if not (state.path / name).is_dir())
        return
    hidden = part.startswith(".")
    for name in fnmatch.filter(names, part):
        if hidden or not name.startswith("."):
            yield _State(state.path / name, after)
