"""Files that a command writes: none of them may be a file that it reads, or the same file as another one.

Files are compared by what they are on the disk, not by their names: links, relative paths and upper or lower case make
no difference. `warpqem.usd.checks.input_files` lists what a stage reads.
"""

from __future__ import annotations

import os
import re
import stat
import unicodedata
from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from warpqem.errors import OptionError

__all__ = ["InputFile", "OutputFile", "OutputFiles", "check_outputs", "named_outputs"]

# In place of the name of a file: standard output.
STDOUT = "-"


@dataclass(frozen=True)
class OutputFile:
    """A file to be written.

    Attributes:
        option: Name of the option that names it, for messages.
        path: The file.
    """

    option: str
    path: str | os.PathLike[str]

    def __str__(self) -> str:
        """As messages name it."""
        return f"{self.option} {os.fspath(self.path)}"


@dataclass(frozen=True)
class InputFile:
    """A file that must stay as it is.

    Attributes:
        path: The file, which need not be there: where something names it, writing it would change what is read.
        role: What the file is, such as "a sublayer of shot.usda", or a function that finds it out when it is asked
            for; None from it means that the file is named, but not read.
    """

    path: str | os.PathLike[str]
    role: str | Callable[[], str | None] = "the input"


class OutputFiles:
    """All files that one command is going to write."""

    def __init__(self, outputs: Iterable[OutputFile]) -> None:
        """Compare them with each other.

        Raises:
            OptionError: two of them are the same file, or one is a folder.
        """
        self.outputs = list(outputs)
        self._by_key: dict[Hashable, OutputFile] = {}
        self._by_folder: dict[str, list[str]] = {}
        self.any_exists = False
        for output in self.outputs:
            if os.path.isdir(output.path):
                # What is renamed over a link to a folder takes the place of the link.
                raise OptionError(f"{output}: this is a folder")
            keys = _keys(output.path)
            for key in keys:
                if key in self._by_key:
                    raise OptionError(f"{output}: {self._by_key[key]} is the same file, and only one can be written")
            self._by_key.update(dict.fromkeys(keys, output))
            # Where the keys are known the path is one.
            folder, name = os.path.split(os.path.realpath(output.path)) if keys else ("", "")
            self._by_folder.setdefault(folder, []).append(name)
            self.any_exists = self.any_exists or os.path.isfile(output.path)

    def check(self, inputs: Iterable[InputFile]) -> None:
        """Compare them with files that must stay as they are.

        Raises:
            OptionError: one of them is such a file; the message names the option, the path and what the file is.
        """
        for source in inputs:
            for key in _keys(source.path):
                if key in self._by_key:
                    role = source.role if isinstance(source.role, str) else source.role()
                    if role is not None:
                        raise OptionError(f"{self._by_key[key]}: this is {role}, which is never overwritten")

    def matching(self, folder: str, pattern: re.Pattern[str]) -> list[str]:
        """Those in a folder whose names match a pattern as a whole."""
        place = os.path.realpath(folder)
        return [os.path.join(place, name) for name in self._by_folder.get(place, ()) if pattern.fullmatch(name)]


def check_outputs(outputs: Iterable[OutputFile], inputs: Iterable[InputFile]) -> None:
    """Refuse to write over a file that is read, and to write a file twice.

    To be called before anything is written.

    Args:
        outputs: All files that are going to be written.
        inputs: All files that must stay as they are.

    Raises:
        OptionError: an output is an input, is named twice, or is a folder.
    """
    OutputFiles(outputs).check(inputs)


def named_outputs(options: Mapping[str, str | os.PathLike[str] | None]) -> list[OutputFile]:
    """The outputs among the values of options: those that are given and are not "-", which is standard output."""
    return [OutputFile(name, path) for name, path in options.items() if path is not None and os.fspath(path) != STDOUT]


def _keys(path: str | os.PathLike[str]) -> set[Hashable]:
    """What two names of one file have in common.

    That is its number on the disk where it is there, and its folder's number and its name in it in any case: a file
    that is not there yet has nothing else. Devices and pipes have none, as nothing is lost by writing to them.
    """
    try:
        keys: set[Hashable] = {_place(path)}
    except (OSError, ValueError):
        return set()  # no name of a file, such as one with a NUL in it: it cannot be written either
    try:
        found = os.stat(path)
    except OSError:
        return keys
    return keys | {(found.st_dev, found.st_ino)} if stat.S_ISREG(found.st_mode) else set()


def _place(path: str | os.PathLike[str]) -> Hashable:
    folder = Path(os.path.realpath(path)).parent
    names = [os.path.basename(os.path.realpath(path))]
    while not folder.is_dir() and folder != folder.parent:
        names.append(folder.name)
        folder = folder.parent
    if _ignores_case(folder):
        names = [unicodedata.normalize("NFC", name).casefold() for name in names]
    found = os.stat(folder)
    return (found.st_dev, found.st_ino, *reversed(names))


def _ignores_case(folder: Path) -> bool:
    """Whether upper and lower case are the same in a folder, as far as its own name shows it."""
    other = folder.with_name(folder.name.swapcase()) if folder.name else folder
    try:
        return other != folder and other.samefile(folder)
    except OSError:
        return False
