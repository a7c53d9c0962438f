"""Messages about many meshes: those that say the same become one line, and paths keep their ends."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence

from rich.console import Console

from warpqem.cli.console import WIDEST

__all__ = [
    "MIN_PATH",
    "file_size",
    "files_size",
    "group_messages",
    "path_width",
    "shortened_path",
    "terminal_width",
    "with_separators",
]

# What two messages of a kind may differ in.
NUMBERS = re.compile(r"\d+(?:,\d{3})*(?:\.\d+)?(?:e[+-]?\d+)?")
# Characters of a line that the figures beside a path take.
FIGURES = 67
# Characters of a path that are left at least: a name of most meshes.
MIN_PATH = 12
# Characters of a path that is an example of many; all of them are named with --verbose.
EXAMPLE_WIDTH = 40


def group_messages(held: Sequence[tuple[str, str]], paths: Sequence[str]) -> list[tuple[str, str]]:
    """Messages, in the order of the first of each kind.

    Args:
        held: Kind and text of each; the text of a mesh begins with its path, behind the name of a level, if any.
        paths: The meshes, the worst first.
    """
    rank = {path: index for index, path in enumerate(paths)}
    groups: dict[tuple[str, str, bool, str], list[tuple[str, str]]] = {}
    for kind, text in held:
        level, path, said = _parted(text, rank)
        # Errors are each mesh's own, and so is what is about no mesh.
        key = said if path == "" or kind == "error" else NUMBERS.sub("#", said)
        groups.setdefault((kind, level, path == "", key), []).append((path, said))
    lines = []
    for (kind, level, _, _), members in groups.items():
        # Errors of two meshes stay two, also where they say the same.
        if kind == "error" or members[0][0] == "" or len({path for path, _ in members}) == 1:
            lines += [(kind, f"{level}{path}{': ' if path else ''}{said}") for path, said in dict.fromkeys(members)]
            continue
        path, said = min(members, key=lambda member: rank[member[0]])
        count = len({path for path, _ in members})
        alike = len({said for _, said in members}) == 1
        example = "" if alike else f", such as {shortened_path(path, EXAMPLE_WIDTH)}"
        lines.append((kind, f"{level}{count} meshes{example}: {said}"))
    return lines


def _parted(text: str, rank: dict[str, int]) -> tuple[str, str, str]:
    """Level, path and the rest of a message; no path where it is about no mesh."""
    found = re.match(r"(LOD\d+: )?(.*?): ", text)
    if found is None:
        return "", "", text
    # A path may have colons: namespaces of primvars are no part of it, but any name of a glTF file is.
    level = found[1] or ""
    rest = text[len(level) :]
    for path in sorted((path for path in rank if rest.startswith(f"{path}: ")), key=len, reverse=True):
        return level, path, rest[len(path) + 2 :]
    return "", "", text


def terminal_width(to_stderr: bool = False) -> int:
    """Characters of a line on a terminal; where there is none, as many as a table has."""
    console = Console(stderr=to_stderr)
    return console.width if console.is_terminal else WIDEST


def path_width(to_stderr: bool = False) -> int:
    """Characters of a path in a table of figures; where no terminal limits it, as many as it has."""
    return max(MIN_PATH, terminal_width(to_stderr) - FIGURES)


def shortened_path(path: str, width: int) -> str:
    """A path without its beginning, where it is longer than so many characters."""
    if len(path) <= width:
        return path
    end = path[-(width - 3) :]
    # Whole names, unless the last one alone is too long.
    cut = end.find("/")
    return f"...{end[cut:] if 0 <= cut < len(end) - 1 else end}"


def with_separators(cell: str) -> str:
    """A whole number with separators of thousands; all else as it is."""
    return f"{int(cell):,}" if cell.isdecimal() else cell


def file_size(path: str) -> str:
    """The size of a file in words, such as "18 KB"; empty where it is not known."""
    return files_size([path])


def files_size(paths: Sequence[str]) -> str:
    """The size of some files together in words; empty where it is not known."""
    try:
        size = float(sum(map(os.path.getsize, paths)))
    except OSError:
        return ""
    for unit in ("bytes", "KB", "MB"):
        if size < 999.5:
            return f"{size:.0f} {unit}" if size >= 9.95 or unit == "bytes" else f"{size:.1f} {unit}"
        size /= 1000.0
    return f"{size:.1f} GB"
