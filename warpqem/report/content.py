"""What a report is made of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from warpqem.arguments.array_record import ArrayRecord
from warpqem.arguments.json_types import Json
from warpqem.picture.look import Look

__all__ = ["Curve", "Level", "Report", "Skeleton", "Table"]


@dataclass(frozen=True, eq=False, repr=False)
class Skeleton(ArrayRecord):
    """Joints that move the original.

    Attributes:
        name: of the skeleton.
        joints: name of each joint.
        parents: (J,) integers, the joint above each; -1 for none.
        points: (F, J, 3), where the joints are, in the frames of the original.
        used: names of those that move a mesh.
    """

    name: str
    joints: Sequence[str]
    parents: np.ndarray
    points: np.ndarray
    used: set[str]


@dataclass(frozen=True)
class Curve:
    """A plot of one quantity against another.

    Attributes:
        title: stands above it.
        unit: of what is upwards.
        x_name: what is to the right.
        series: name, places to the right and values of each line.
    """

    title: str
    unit: str
    x_name: str
    series: Sequence[tuple[str, Sequence[float], Sequence[float]]]


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
        used_joints: joints that move it, by the name of the skeleton; None where all do that move the original.
    """

    name: str
    points: np.ndarray
    faces: np.ndarray
    measured: Mapping[str, Json] | None = None
    look: Look | None = None
    meshes: Mapping[str, Mapping[str, Json]] = field(default_factory=dict)
    used_joints: Mapping[str, set[str]] | None = None


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
        skeletons: what moves it.
        curves: plots beside those of the errors.
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
    skeletons: Sequence[Skeleton] = ()
    curves: Sequence[Curve] = ()
    thinned: bool = False
