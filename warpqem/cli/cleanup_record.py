"""Record of what a command has to be cleared of when it is ended: folders with temporary files, and processes."""

from __future__ import annotations

import os
import signal
import tempfile
import time
from contextlib import suppress
from pathlib import Path

from warpqem.files.temporary import record_folders, remove_leftovers
from warpqem.runtime.processes import ProcessId, record_processes

__all__ = ["WorkRecord"]

# Seconds for killed processes to be gone, and between two looks.
GONE_SECONDS, LOOK_SECONDS = 5.0, 0.01


class WorkRecord:
    """A file without a name that two processes share: one writes into it, either can clear what the other one left."""

    def __init__(self) -> None:
        """Make the file, before the processes part."""
        if hasattr(os, "memfd_create"):
            self._file = os.memfd_create("warpqem-record")
        else:
            with tempfile.TemporaryFile(buffering=0) as file:
                self._file = os.dup(file.fileno())
        self._folders: set[Path] = set()

    def begin(self) -> None:
        """Record what this process does from now on."""
        record_folders(self._add_folder)
        record_processes(self._add_process)

    def _add_folder(self, folder: Path) -> None:
        folder = folder.absolute()
        if folder not in self._folders:
            self._folders.add(folder)
            self._add(b"folder " + os.fsencode(folder))

    def _add_process(self, number: int) -> None:
        process = ProcessId.of(number)
        self._add(b"process %d %d" % (process.number, process.started))

    def _add(self, entry: bytes) -> None:
        # A null byte is in no path. Written at once, so that no entry is there by half.
        os.write(self._file, entry + b"\0")

    def clear(self) -> None:
        """End the processes that are still there, and remove the temporary files of all that have ended."""
        folders, processes = self._read()
        for process in processes:
            if process.is_alive():
                with suppress(OSError):
                    os.kill(process.number, signal.SIGKILL)
        end = time.monotonic() + GONE_SECONDS
        while any(process.is_alive() for process in processes) and time.monotonic() < end:
            time.sleep(LOOK_SECONDS)
        for folder in folders:
            remove_leftovers(folder)

    def _read(self) -> tuple[list[Path], list[ProcessId]]:
        folders, processes = [], []
        data = os.pread(self._file, os.fstat(self._file).st_size, 0)
        for entry in data.split(b"\0")[:-1]:
            kind, _, value = entry.partition(b" ")
            if kind == b"folder":
                folders.append(Path(os.fsdecode(value)))
            else:
                number, started = value.split()
                processes.append(ProcessId(int(number), int(started)))
        return folders, processes
