"""Options that are more than a number or a name: read from text, and checked. No stage is needed for it, nor USD."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any

from warpqem.arguments.limits import COUNT, WEIGHTS, Limits
from warpqem.arguments.number_hints import number_hint
from warpqem.arguments.number_text import parse_number
from warpqem.errors import OptionError
from warpqem.usd.read.time_codes import FrameRange

__all__ = [
    "FRAMES_HELP",
    "AttributeWeights",
    "bare_name",
    "check_faces",
    "check_lods",
    "check_weights",
    "face_budget",
    "parse_attribute_weight",
    "parse_faces",
    "read_folders",
    "read_frames",
    "read_length",
    "read_paths",
    "read_ratios",
    "read_weights",
]

# Shares of the levels below the original.
LEVEL_SHARE = Limits(0.0, 1.0, open_low=True, open_high=True)
# Weights by primvar name, without "primvars:".
AttributeWeights = Sequence[tuple[str, float]]


def bare_name(name: str) -> str:
    """The name of a primvar without its namespace."""
    return name.removeprefix("primvars:")


def parse_attribute_weight(text: str) -> tuple[str, float]:
    """Read `NAME=WEIGHT`.

    Raises:
        OptionError: it is something else.
    """
    name, _, weight = text.rpartition("=")
    try:
        if name:
            return bare_name(name), parse_number(weight)
    except ValueError:
        pass
    raise OptionError(f"`attribute_weight` '{text}': expected NAME=WEIGHT, such as st=0.1")


def check_weights(weights: AttributeWeights) -> None:
    """Check that all weights are in range.

    Raises:
        OptionError: one is not.
    """
    for name, weight in weights:
        if weight not in WEIGHTS:
            raise OptionError(f"attribute_weights of {name} must be {WEIGHTS}, got {weight:g}")


def read_weights(value: Any) -> tuple[tuple[str, float], ...]:
    """Weights of primvars from a list of texts, or from text with blanks between them."""
    return tuple(parse_attribute_weight(text) for text in read_paths(value))


def parse_faces(value: object) -> int | str:
    """Read a number of faces, or a share of all faces such as "25%".

    Raises:
        ValueError: it is neither.
    """
    text = str(value).strip()
    if isinstance(value, bool) or not re.fullmatch(r"[-+]?\d{1,18}(\.0)?|\+?\d+(\.\d+)? ?%", text, re.ASCII):
        if found := re.fullmatch(r"0?\.\d{1,6}", text, re.ASCII):
            hint = f"; for that share give {100 * float(found[0]):g}%"
        else:
            hint = number_hint("", value, COUNT, whole=True)
        raise ValueError(f"expected a whole number, or a share of all faces such as 25%{hint}")
    return text.replace(" ", "") if text.endswith("%") else int(text.removesuffix(".0"))


def face_budget(faces: int | str, total: int) -> int:
    """The number of faces that a number, or a share of so many, is."""
    return faces if isinstance(faces, int) else max(1, round(float(faces.rstrip("%")) / 100.0 * total))


def check_faces(faces: object) -> None:
    """Check a number or a share of faces.

    Raises:
        OptionError: it is neither, or out of range.
    """
    try:
        read = parse_faces(faces)
    except ValueError as error:
        raise OptionError(f"faces {faces}: {error}") from None
    if isinstance(read, int) and read < 1:
        raise OptionError(f"faces {faces}: expected at least 1")
    if isinstance(read, str) and not 0 < float(read.rstrip("%")) <= 100:
        raise OptionError(f"faces {faces}: expected a share above 0 % and at most 100 %")


def read_ratios(value: Any) -> tuple[float, ...]:
    """Ratios from text such as "0.5,0.25,0.1", or from a list of numbers.

    Raises:
        OptionError: one of them is no number.
    """
    text = value if isinstance(value, str) else ",".join(map(str, value))
    ratios = []
    for part in text.split(","):
        try:
            ratios.append(parse_number(part))
        except ValueError:
            hint = number_hint("", part, LEVEL_SHARE)
            expected = "expected ratios such as 0.5,0.25,0.1"
            raise OptionError(f"`lods` '{text}': '{part}' is no number; {expected}{hint}") from None
    return tuple(ratios)


def read_paths(value: Any) -> tuple[str, ...]:
    """A list of texts, or text with blanks between the entries."""
    return tuple(value.split()) if isinstance(value, str) else _texts(value)


def read_folders(value: Any) -> tuple[str, ...]:
    """A list of texts, or one, which may have blanks in it."""
    return (value,) if isinstance(value, str) else _texts(value)


FRAMES_HELP = "Only the samples from START to END, in time codes; with STEP, poses interpolated every STEP time codes."


def read_frames(value: Any) -> FrameRange:
    """A range of time codes from text such as "1:24:0.5"."""
    return FrameRange.parse(*_texts([value]))


def read_length(value: Any) -> float | str:
    """A length, which `warpqem.usd.read.lengths` reads: a number, or text with a unit."""
    if isinstance(value, bool):
        raise ValueError("expected a length")
    return value if isinstance(value, str) else float(value)


def _texts(values: Any) -> tuple[str, ...]:
    for value in values:
        if not isinstance(value, str):
            raise ValueError("expected text")
    return tuple(values)


def check_lods(ratios: Sequence[float]) -> None:
    """Check the ratios of the levels below the original.

    Raises:
        OptionError: one is not between 0 and 1, or not smaller than the one before it.
    """
    before = math.inf
    for ratio in ratios:
        if ratio not in LEVEL_SHARE:
            hint = number_hint("", ratio, LEVEL_SHARE)
            raise OptionError(f"lods: ratio {ratio:g}: expected a share above 0 and below 1{hint}")
        if ratio >= before:
            raise OptionError(f"lods: ratio {ratio:g} after {before:g}: each level must be smaller than the one before")
        before = ratio
