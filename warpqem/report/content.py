"""What a report is made of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from warpqem.arguments.array_record import ArrayRecord
from warpqem.arguments.json_types import Json
from warpqem.picture.look import Look

__all__ = ["Level", "Report", "Table"]


@dataclass(frozen=True, eq=False, repr=False)
class Level(ArrayRecord):
    """A simplified mesh.

    Attributes:
        name: what the page calls it, such as "LOD1".
        points: (F, V', 3), in the coordinates and frames of the original.
        faces: (N', 3) integers, counter-clockwise.
        measured: its errors over all frames of the animation, where they are known; None for those of the frames here.
        look: its colours and textures; None for none.
        meshes: the errors of each of its meshes, by the name of the part in the look.
    """

    name: str
    points: np.ndarray
    faces: np.ndarray
    measured: Mapping[str, Json] | None = None
    look: Look | None = None
    meshes: Mapping[str, Mapping[str, Json]] = field(default_factory=dict)


@dataclass(frozen=True)
class Table:
    """A table of the page.

    Attributes:
        title: stands above it.
        head: name of each column.
        rows: text or numbers for each column.
    """

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str | int | float | None]]


@dataclass(frozen=True, eq=False, repr=False)
class Report(ArrayRecord):
    """What a page shows.

    Attributes:
        title: its heading.
        points: (F, V, 3) or (V, 3), the original.
        faces: (N, 3) integers, counter-clockwise.
        levels: simplified meshes, the finest first.
        times: name of each frame, such as its time code; None counts from 1.
        frames_per_second: how fast the frames play.
        up: "y" or "z".
        tables: options, timings and the like.
        notes: sentences under the picture.
        markers: vertices of the original by name, such as the feature points of a face; drawn as dots, on the levels
            too, on the vertex that is nearest in the first frame.
        look: colours and textures of the original; None for none.
        thinned: True where frames were left out before, so that differences from one to the next mean nothing.
    """

    title: str
    points: np.ndarray
    faces: np.ndarray
    levels: Sequence[Level]
    times: Sequence[float] | None = None
    frames_per_second: float = 24.0
    up: str = "y"
    tables: Sequence[Table] = ()
    notes: Sequence[str] = ()
    markers: Mapping[str, int] = field(default_factory=dict)
    look: Look | None = None
    thinned: bool = False
