"""Names of the files in archives that USD makes."""

from __future__ import annotations

import zipfile

__all__ = ["archive_files"]

# The bit of an entry that says its name is UTF-8; without it Python takes the name for the first encoding of archives.
UTF8_NAME, FIRST_ENCODING = 0x800, "cp437"


def archive_files(archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    """The entries of an archive by their names; USD writes these in UTF-8 and does not say so."""
    return {_name(entry): entry for entry in archive.infolist()}


def _name(entry: zipfile.ZipInfo) -> str:
    if entry.flag_bits & UTF8_NAME:
        return entry.filename
    try:
        return entry.filename.encode(FIRST_ENCODING).decode("utf-8")
    except UnicodeError:
        return entry.filename
