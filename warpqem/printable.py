"""Text that comes from files, made safe to show on a terminal, in a log or on a page.

Names of files, prims and attributes, and what libraries quote of them, may hold characters that drive a terminal, break
a line or reverse the direction of what follows. Whatever shows text to people passes it through here; errors and
reports hold it as it is.
"""

from __future__ import annotations

import unicodedata

__all__ = ["FIRST_BYTE", "LAST_BYTE", "printable", "printable_lines"]

# Categories that Python calls not printable although they only take room on the line: other spaces, private glyphs.
HARMLESS_CATEGORIES = ("Zs", "Co")
# Joiners that scripts such as Persian and Devanagari are written with; they act on their neighbours alone.
JOINERS = "\u200c\u200d"
# Bytes of a file name that are no UTF-8 are these code points in Python, see os.fsdecode.
FIRST_BYTE, LAST_BYTE = 0xDC80, 0xDCFF


def printable(text: str) -> str:
    r"""Text on one line, with control characters, line breaks, marks of direction and lone surrogates as escapes.

    A byte of a file name that is no UTF-8 becomes ``\xNN``. Text that is safe already is returned as it is.
    """
    if text.isprintable():
        return text
    return "".join(character if _is_harmless(character) else _escape(character) for character in text)


def printable_lines(text: str) -> str:
    """Each line of a text made safe; the line breaks stay."""
    return "\n".join(map(printable, text.split("\n")))


def _is_harmless(character: str) -> bool:
    return character.isprintable() or character in JOINERS or unicodedata.category(character) in HARMLESS_CATEGORIES


def _escape(character: str) -> str:
    code = ord(character)
    if FIRST_BYTE <= code <= LAST_BYTE:
        return f"\\x{code - FIRST_BYTE + 0x80:02x}"
    return character.encode("unicode_escape").decode("ascii")
