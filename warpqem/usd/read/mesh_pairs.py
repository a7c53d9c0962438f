"""Which meshes of two stages belong together: those that the stages show at the same paths.

A mesh that instances share is one mesh with many places. One file edits it where it is defined, another in a class that
the instances inherit from, a flat file in a prototype of its own, so that its own path says little.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pxr import Sdf

from warpqem.usd.read.open_stage import MeshSelection

__all__ = ["MeshPair", "pair_meshes"]


@dataclass(frozen=True)
class MeshPair:
    """Two meshes with a place in common, or one that has none in common with any.

    Attributes:
        name: Path of the mesh of the reference; where that belongs to several of the test, the first place that it has
            in common with this one.
        reference: Path of a mesh of the reference; None if it shows none where the test shows one.
        test: Path of a mesh of the test; None likewise.
    """

    name: str
    reference: Sdf.Path | None
    test: Sdf.Path | None


def pair_meshes(reference: MeshSelection, test: MeshSelection) -> list[MeshPair]:
    """All pairs of meshes, in the order of the reference; then what the test alone has.

    A mesh that shows in both files, but at some places in one of them only, is named once for those places. What one of
    the selections refuses is left out.
    """
    places: dict[tuple[Sdf.Path | None, Sdf.Path | None], list[Sdf.Path]] = {}
    for place in dict.fromkeys([*reference.places, *test.places]):
        places.setdefault((reference.places.get(place), test.places.get(place)), []).append(place)
    refused = {Sdf.Path(path) for path, _ in (*reference.refused, *test.refused)}
    found = [pair for pair in places if refused.isdisjoint(pair)]
    order = {prim.GetPath(): index for index, prim in enumerate(reference.prims)}
    found.sort(key=lambda pair: order.get(pair[0], len(order)))
    return [MeshPair(_name(pair, places[pair], found), *pair) for pair in found]


def _name(
    pair: tuple[Sdf.Path | None, Sdf.Path | None],
    places: Sequence[Sdf.Path],
    pairs: Sequence[tuple[Sdf.Path | None, Sdf.Path | None]],
) -> str:
    own = pair[1] if pair[0] is None else pair[0]
    side = 1 if pair[0] is None else 0
    alone = sum(other[side] == own for other in pairs) == 1
    return str(own if alone or own in places else places[0])
