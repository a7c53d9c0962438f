"""Names of temporary files and folders beside an output, and how to remove those that a killed process left."""

from __future__ import annotations

import hashlib
import os
import platform
import re
import shutil
import uuid
from pathlib import Path

__all__ = ["remove_leftovers", "temporary_path"]

# Hidden, and with machine and process, so that what a dead one left can be told from what a living one is writing. USD
# itself writes under such a name with another suffix, of letters and digits, before it renames the file.
HOST = hashlib.sha256(platform.node().encode()).hexdigest()[:8]
PATTERN = re.compile(rf"\.warpqem\.{HOST}-(\d+)\.[0-9a-f]{{32}}\.\w+")


def temporary_path(folder: Path, suffix: str) -> Path:
    """A new name in a folder; a file is written under it and then renamed, which cannot be seen half done.

    A folder of this name is for what processes hand each other while they work on an output.
    """
    return folder / f".warpqem.{HOST}-{os.getpid()}.{uuid.uuid4().hex}{suffix}"


def remove_leftovers(folder: Path, process: int | None = None) -> list[Path]:
    """Remove the temporary files and folders that processes of this machine left in a folder.

    Args:
        folder: The folder.
        process: A process that has ended, or is not to use the folder any more; None for all that have ended.
    """
    removed = []
    try:
        entries = sorted(os.listdir(folder))
    except OSError:
        return []
    for name in entries:
        found = PATTERN.fullmatch(name)
        if found and (int(found[1]) == process if process is not None else not _is_alive(int(found[1]))):
            _remove(folder / name)
            removed.append(folder / name)
    return removed


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def _is_alive(process: int) -> bool:
    if os.name != "posix":
        return True  # there is no asking without touching it
    try:
        os.kill(process, 0)
        # One that has ended is still known until its parent, or what stands in for it, has asked how.
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] not in ("Z", "X")
    except ProcessLookupError:
        return False
    except (OSError, IndexError):
        return True
