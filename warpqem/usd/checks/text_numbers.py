"""Text that USD writes and cannot read."""

from __future__ import annotations

import mmap
import re
from pathlib import Path

from warpqem.usd.checks.byte_check import QUOTED

__all__ = ["make_readable"]

# USD writes a NaN with a sign bit as -nan, which its own parser refuses, and with it the whole file.
SIGNED_NAN = b"-nan"
_SIGNED_OR_QUOTED = re.compile(QUOTED.pattern + rb"|(?<![\w.])-nan\b", re.DOTALL)


def make_readable(path: Path) -> None:
    """Take the sign off every NaN in a text file; other files stay as they are."""
    with open(path, "rb") as file:
        if not file.read(8).startswith(b"#usda"):
            return
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as text:
            if text.find(SIGNED_NAN) < 0:
                return
            data = _SIGNED_OR_QUOTED.sub(lambda found: b"nan" if found[0] == SIGNED_NAN else found[0], text)
    path.write_bytes(data)
