"""Temporary files and folders beside outputs: their names, and how to remove those that a killed process left.

A name holds the machine, its boot, the process and when that process started, so that what a dead process left can be
told from what a living one writes, also where a process id has been given out again.
"""

from __future__ import annotations

import functools
import hashlib
import os
import platform
import re
import shutil
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from warpqem.runtime.processes import ProcessId, own_id

__all__ = [
    "MARK_LENGTH",
    "mark_temporary",
    "note_folder",
    "record_folders",
    "remove_leftovers",
    "remove_marked",
    "remove_path",
    "replacing",
    "temporary_path",
]

# machine-boot-process-start.unique; USD itself writes under such a name with another suffix, of letters and digits,
# before it renames the file.
PATTERN = re.compile(r"\.warpqem\.([0-9a-f]{8})-([0-9a-f]{8})-(\d+)-(\d+)\.([0-9a-f]{32})\.\w+")
# Digits of the unique part by which the files of one job are known on all machines.
MARK_LENGTH = 16
# The inode of the first process id namespace of a Linux kernel: processes in any other one are in a container.
FIRST_NAMESPACE = "pid:[4026531836]"

_folders: Callable[[Path], None] | None = None
_mark = ""
_cleared: set[tuple[int, Path]] = set()


@functools.cache
def _machine() -> str:
    return _digest(platform.node(), _read("/etc/machine-id"))


@functools.cache
def _boot() -> str:
    """This run of the machine, and within it the container."""
    return _digest(_read("/proc/sys/kernel/random/boot_id"), _namespace())


@functools.cache
def _namespace() -> str:
    try:
        return os.readlink("/proc/self/ns/pid")
    except OSError:
        return ""


def _digest(*parts: str) -> str:
    return hashlib.sha256("\n".join(parts).encode("utf-8", "surrogateescape")).hexdigest()[:8]


def _read(path: str) -> str:
    try:
        return Path(path).read_text().strip()
    except OSError:
        return ""


def temporary_path(folder: Path, suffix: str) -> Path:
    """A new name in a folder; a file is written under it and then renamed, which cannot be seen half done.

    A folder of this name holds several such files. The first name that a process asks for in a folder removes what dead
    processes left there.
    """
    own = own_id()
    if (own.number, folder) not in _cleared:
        _cleared.add((own.number, folder))
        remove_leftovers(folder)
    note_folder(folder)
    unique = (_mark + uuid.uuid4().hex)[:32]
    return folder / f".warpqem.{_machine()}-{_boot()}-{own.number}-{own.started}.{unique}{suffix}"


@contextmanager
def replacing(target: Path) -> Iterator[Path]:
    """Write a file under a temporary name, which replaces the target at the end; on an error nothing is left behind.

    Args:
        target: The file to write.

    Yields:
        The temporary path, in the same folder and with the same suffix.

    Raises:
        OSError: the file cannot be renamed.
    """
    temporary = temporary_path(target.parent, target.suffix if re.fullmatch(r"\.\w+", target.suffix) else ".part")
    try:
        yield temporary
        os.replace(temporary, target)
    finally:
        temporary.unlink(missing_ok=True)


def note_folder(folder: Path) -> None:
    """Record a folder that this process or its workers use for temporary files."""
    if _folders is not None:
        _folders(folder)


def record_folders(record: Callable[[Path], None]) -> None:
    """From now on call something with each folder that this process uses for temporary files, before it does."""
    global _folders
    _folders = record


@contextmanager
def mark_temporary(mark: str) -> Iterator[None]:
    """Let the names of all temporary files of this process bear a mark for a while, see `remove_marked`.

    Args:
        mark: 16 hexadecimal digits.
    """
    global _mark
    _mark, before = mark[:MARK_LENGTH], _mark
    try:
        yield
    finally:
        _mark = before


def remove_leftovers(folder: Path, process: int | None = None) -> list[Path]:
    """Remove the temporary files and folders that processes of this machine left in a folder.

    Args:
        folder: The folder.
        process: A process that has ended, or is not to use the folder any more; None for all that have ended.

    Returns:
        What was removed.
    """
    return _remove_found(folder, lambda path, name: _is_left(path, name, process))


def remove_marked(folder: Path, mark: str) -> list[Path]:
    """Remove the temporary files and folders with a mark, whose processes on any machine have ended; see above."""
    return _remove_found(folder, lambda path, name: name[5].startswith(mark[:MARK_LENGTH]))


def _remove_found(folder: Path, wanted: Callable[[Path, re.Match[str]], bool]) -> list[Path]:
    removed = []
    try:
        entries = sorted(os.listdir(folder))
    except OSError:
        return []
    for entry in entries:
        name, path = PATTERN.fullmatch(entry), folder / entry
        if name and _is_own(path) and wanted(path, name):
            remove_path(path)
            removed.append(path)
    return removed


def _is_left(path: Path, name: re.Match[str], process: int | None) -> bool:
    machine, boot, number, started = name[1], name[2], int(name[3]), int(name[4])
    if machine != _machine():
        return False
    if boot != _boot():
        return process is None and _is_older_than_boot(path)
    return number == process if process is not None else not ProcessId(number, started).is_alive()


def _is_older_than_boot(path: Path) -> bool:
    """Whether nobody has touched a file since this machine started; False in a container, which starts at any time."""
    found = re.search(r"^btime (\d+)$", _read("/proc/stat"), re.MULTILINE)
    if found is None or _namespace() != FIRST_NAMESPACE:
        return False
    try:
        return path.lstat().st_mtime < int(found[1])
    except OSError:
        return False


def _is_own(path: Path) -> bool:
    """Whether a file belongs to the user of this process."""
    try:
        return not hasattr(os, "geteuid") or path.lstat().st_uid == os.geteuid()
    except OSError:
        return False


def remove_path(path: Path) -> None:
    """Remove a file, or a folder with all that is in it; what cannot be removed stays.

    A temporary folder that another thread is removing is gone as well when this returns: that thread may be one that
    the end of the process stops.
    """
    known = PATTERN.fullmatch(path.name) is not None
    gone = path.with_suffix(".removed") if known else path.with_name(f"{path.name}.{uuid.uuid4().hex}")
    with suppress(OSError):
        if path.is_dir() and not path.is_symlink():
            # Renamed first, so that nobody who knows it only by its name can add to it meanwhile.
            os.replace(path, gone)
        else:
            path.unlink(missing_ok=True)
    shutil.rmtree(gone, ignore_errors=True)
