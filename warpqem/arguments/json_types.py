"""What JSON holds, for type checkers: reports and figures as plain values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, TypeAlias

__all__ = ["Json"]

if TYPE_CHECKING:
    Json: TypeAlias = "str | int | float | bool | Sequence[Json] | Mapping[str, Json] | None"
else:
    # The API reference resolves names where they are used, and fails on a recursive one.
    Json = str | int | float | bool | Sequence | Mapping | None
