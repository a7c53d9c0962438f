"""Text files that are written as they are, and stages that are refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from warpqem.errors import StageError
from warpqem.usd.read.open_stage import open_stage

MESH = 'def Mesh "M"\n{\npoint3f[] points = [(0,0,0),(1,0,0),(0,1,0)]\nint[] faceVertexCounts = [3]\n'
MESH += "int[] faceVertexIndices = [0,1,2]\n}\n"


def text_file(folder: Path, text: str, name: str = "in.usda") -> Path:
    (folder / name).write_text(f"#usda 1.0\n{text}")
    return folder / name


def refused(path: Path, match: str, **options: object) -> None:
    with pytest.raises(StageError, match=match):
        open_stage(path, **options)


NESTED = {
    "prims": 'def "a" {\n' * 200_000 + MESH + "}\n" * 200_000,
    "dictionaries": "(customLayerData = " + "{ dictionary a = " * 200_000 + "{ }" + "}" * 200_000 + ")\n" + MESH,
    "tuples": f'def Mesh "M"\n{{\npoint3f[] points = {"(" * 200_000}{")" * 200_000}\n}}\n',
    "behind strings": '"}}}}}" # }}}}\n/* } */ @}@ """\n}\n"""' * 1000 + 'def "a" {\n' * 1500,
    "never closed": "[" * 200_000,
}
