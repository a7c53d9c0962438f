"""Which corners of the output share a normal: those at one vertex whose own fits are nearly the same."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from warpqem.attribute_fit.partners import SAMPLES
from warpqem.mesh.components import lowest_members
from warpqem.mesh.directions import unit_vectors
from warpqem.mesh.edges import corner_links, edge_key
from warpqem.mesh.grouping import different, ranks
from warpqem.mesh.mesh_input import is_proper

__all__ = ["split_corners"]

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]

# Cosine of 25 degrees: normals further apart than that are an edge, as on a bevel that became one. At 20 pictures are
# nearer to the input once more, by 0.3 dB, but smooth faces of a few hundred triangles show edges.
SPLIT_COSINE = float(np.cos(np.radians(25.0)))


def split_corners(faces: Ints, corner_row: Ints, fits: Iterable[Floats]) -> tuple[Ints, Ints]:
    """Split corners that share a value where the fits of the faces beside an edge are far apart.

    They have to be so at the corner, where those of a surface that bends evenly meet, and halfway from there to the
    middles of the faces, among their samples: at the corner, beyond all of these, they may be apart where nothing is
    sharp.

    Args:
        faces: (N', 3) int32, the output.
        corner_row: (N', 3) int32, corners with the same number share a value so far; those with others never do.
        fits: (N', 3, 3) unit vectors at the corners, each face's own; several for several poses, and all have to agree.

    Returns:
        (N', 3) int32, numbers from 0 to G, and (G,) the row that each of them was a part of.
    """
    tail, head = faces.ravel(), faces.take((1, 2, 0), axis=1).ravel()
    key = edge_key(tail, head, int(faces.max()) + 1)
    links = corner_links(faces, key, np.repeat(is_proper(faces), 3))
    row = corner_row.ravel()
    links = links[row[links[:, 0]] == row[links[:, 1]]]
    is_near = np.ones(len(links), dtype=bool)
    for fit in fits:
        is_near &= _agree(fit, links) | _agree(unit_vectors(SAMPLES @ fit), links)
    lowest = lowest_members(faces.size, links[is_near])
    return ranks(lowest, faces.size).reshape(faces.shape), row[different(lowest, faces.size)]


def _agree(normals: Floats, links: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
    """Whether unit vectors (N', 3, 3) at linked corners (L, 2) are near each other."""
    flat = normals.reshape(-1, 3)
    return np.asarray((flat[links[:, 0]] * flat[links[:, 1]]).sum(axis=1) >= SPLIT_COSINE, dtype=bool)
