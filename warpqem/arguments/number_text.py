"""Numbers from text, in plain digits: Python takes underscores between them and digits of other scripts, too."""

from __future__ import annotations

__all__ = ["parse_number", "parse_whole"]


def parse_number(text: str) -> float:
    """The number that text says.

    Raises:
        ValueError: it says none, or not in plain digits.
    """
    return float(_plain(text))


def parse_whole(text: str) -> int:
    """The whole number that text says.

    Raises:
        ValueError: it says none, or not in plain digits.
    """
    return int(_plain(text))


def _plain(text: str) -> str:
    if "_" in text or not text.isascii():
        raise ValueError(f"{text!r} is no number in plain digits")
    return text
