"""Names of temporary files beside an output, and how to remove those that a killed process left."""

from __future__ import annotations

import os
import re
import uuid
from pathlib import Path

__all__ = ["remove_leftovers", "temporary_path"]

# Hidden, and with the process, so that what a dead one left can be told from what a living one is writing.
PREFIX = ".warpqem"
PATTERN = re.compile(r"\.warpqem\.(\d+)\.[0-9a-f]{32}\.[a-z]+")


def temporary_path(folder: Path, suffix: str) -> Path:
    """A new name in a folder; a file is written under it and then renamed, which cannot be seen half done."""
    return folder / f"{PREFIX}.{os.getpid()}.{uuid.uuid4().hex}{suffix}"


def remove_leftovers(folder: Path, process: int | None = None) -> list[Path]:
    """Remove the temporary files in a folder that a process left, or any process where none is named.

    Only for processes that have ended, or of which nobody is to use the folder.
    """
    removed = []
    try:
        entries = sorted(os.listdir(folder))
    except OSError:
        return []
    for name in entries:
        found = PATTERN.fullmatch(name)
        if found and process in (None, int(found[1])):
            (folder / name).unlink(missing_ok=True)
            removed.append(folder / name)
    return removed
