"""Messages about many meshes: those that say the same become one line, and paths keep their ends."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence

from warpqem.cli.tables import WIDEST, shortened_path, terminal_width

__all__ = ["file_size", "files_size", "group_messages", "message_path_width"]

# What two messages of a kind may differ in.
NUMBERS = re.compile(r"\d+(?:,\d{3})*(?:\.\d+)?(?:e[+-]?\d+)?")
# Characters of a path in a message on a terminal; they are whole with --verbose.
PATH_WIDTH = 40


def message_path_width() -> int:
    """Characters of a path in a message: on a terminal its end, elsewhere all of it."""
    return PATH_WIDTH if terminal_width(to_stderr=True) < WIDEST else WIDEST


def group_messages(
    held: Sequence[tuple[str, str]], paths: Sequence[str], path_width: int = WIDEST
) -> list[tuple[str, str]]:
    """Messages, in the order of the first of each kind.

    Args:
        held: Kind and text of each; the text of a mesh begins with its path, behind the name of a level, if any.
        paths: The meshes, the worst first.
        path_width: Characters of a path, but for those in errors, which stay whole.
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
            width = WIDEST if kind == "error" else path_width
            for path, said in dict.fromkeys(members):
                lines.append((kind, f"{level}{shortened_path(path, width)}{': ' if path else ''}{said}"))
            continue
        path, said = min(members, key=lambda member: rank[member[0]])
        count = len({path for path, _ in members})
        alike = len({said for _, said in members}) == 1
        example = "" if alike else f", such as {shortened_path(path, path_width)}"
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
