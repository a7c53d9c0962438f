"""What all commands are told."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

__all__ = ["Settings"]


@dataclass(frozen=True)
class Settings:
    """Options of the command line.

    Attributes:
        out: folder for the reports.
        quick: small meshes and few turns: whether it works, not how fast.
        device: Warp device; None for the default.
        turns: how often each contender runs.
        ratio: part of the faces to keep.
        usd: file to work on instead of the generated mesh (commands ``peers`` and ``articulated``).
        prim: mesh in that file; None for the largest.
        data: file or folder of meshes in motion (command ``device``).
        pack: folder to put such meshes into, and nothing else is done (command ``device``).
        parts: parts to run (command ``device``); none for all.
    """

    out: Path
    quick: bool = False
    device: str | None = None
    turns: int = 5
    ratio: float = 0.1
    usd: Path | None = None
    prim: str | None = None
    data: Path | None = None
    pack: Path | None = None
    parts: tuple[str, ...] = ()

    def to_json(self) -> str:
        """As an argument of another process."""
        return json.dumps({name: str(v) if isinstance(v, Path) else v for name, v in asdict(self).items()})

    @staticmethod
    def from_json(text: str) -> Settings:
        """What :meth:`to_json` wrote."""
        given: dict[str, Any] = json.loads(text)
        paths = {name: None if given[name] is None else Path(given[name]) for name in ("out", "usd", "data", "pack")}
        return Settings(**given | paths | {"parts": tuple(given["parts"])})
