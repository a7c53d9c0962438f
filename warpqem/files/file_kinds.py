"""What is at a path, before it is opened: a pipe has no end, a device neither, and opening either may wait for ever."""

from __future__ import annotations

import os
import stat

from warpqem.errors import WarpqemError

__all__ = ["check_regular", "kind_of"]

# File systems that the kernel makes up as they are read: files there say a size that is none, and some never end.
MADE_UP = ("/proc", "/sys")


def kind_of(path: str | os.PathLike[str]) -> str | None:
    """Why a path is no file that can be read to its end, such as "a pipe"; links are followed.

    Returns:
        None for a regular file, and where nothing is there.
    """
    try:
        found = os.stat(path)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError) as error:
        return f"a path that leads nowhere ({getattr(error, 'strerror', None) or error})"
    kinds = {
        stat.S_IFDIR: "a folder",
        stat.S_IFIFO: "a pipe",
        stat.S_IFSOCK: "a socket",
        stat.S_IFCHR: "a device",
        stat.S_IFBLK: "a device",
    }
    kind = stat.S_IFMT(found.st_mode)
    if kind != stat.S_IFREG:
        return kinds.get(kind, "something of another kind")
    real = os.path.realpath(path)
    for root in MADE_UP:
        if real.startswith(root + os.sep) or (os.path.ismount(root) and os.stat(root).st_dev == found.st_dev):
            return f"made up by the system (in {root})"
    return None


def check_regular(path: str | os.PathLike[str], error: type[WarpqemError], name: str | None = None) -> None:
    """Refuse to open what may have no end.

    Args:
        path: The file; a missing one is left to be found missing.
        error: The class of error to raise.
        name: What the message calls the file; by default its path.

    Raises:
        WarpqemError: of the class given, where the path is no regular file.
    """
    kind = kind_of(path)
    if kind is not None:
        raise error(f"{os.fspath(path) if name is None else name}: no regular file, but {kind}")
