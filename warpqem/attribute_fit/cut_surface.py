"""The input surface cut along seams, so that a walk over it stays on its side of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from warpqem.mesh.components import lowest_members
from warpqem.mesh.mesh_input import is_proper
from warpqem.pipeline.surface_transfer import joined_faces

__all__ = ["CutSurface", "cut_surface"]

Ints = npt.NDArray[np.int32]


@dataclass(frozen=True)
class CutSurface:
    """A surface whose faces share a vertex where values go on from one to the other, and nowhere else.

    Attributes:
        corner: (N, 3) int32, the vertex at each corner of the input's faces, from 0 to W; -1 at faces that are none.
        vertex: (W,) int32, the input vertex that each of these is.
    """

    corner: Ints
    vertex: Ints

    @property
    def face(self) -> Ints:
        """(M,) int32, the input's faces that are part of it."""
        return np.flatnonzero((self.corner >= 0).all(axis=1)).astype(np.int32)


def cut_surface(faces: Ints, seams: npt.NDArray[np.int64], sheets: Ints | None = None) -> CutSurface:
    """Cut a surface.

    Args:
        faces: (N, 3) int32, the input.
        seams: (S, 2) int64, ends of the edges that values do not cross.
        sheets: (N, 3) int32, see :class:`warpqem.repair.mended_mesh.MeshRepair`; None where nothing was mended.
    """
    topology = faces if sheets is None else sheets
    used = is_proper(faces) & (topology >= 0).all(axis=1)
    label = topology.astype(np.int64)
    # Beside seams alone are there vertices with several sides.
    beside = np.isin(faces, seams).any(axis=1) & used if len(seams) else np.zeros(len(faces), dtype=bool)
    if beside.any():
        part = np.flatnonzero(beside)
        own = topology[part]
        # Pairs as in the whole mesh, as all faces at a vertex of a seam are in this part.
        first, second = joined_faces(faces[part], seams, own)
        links = []
        for k in range(3):
            pair, other = np.nonzero(own[second] == own[first, k][:, None])
            links.append(np.stack([3 * first[pair] + k, 3 * second[pair] + other], axis=1))
        side = lowest_members(own.size, np.concatenate(links)).reshape(-1, 3)
        on_seam = np.isin(faces[part], seams)
        label[part] = np.where(on_seam, int(topology.max()) + 1 + side, own)
    corner = np.full(faces.shape, -1, dtype=np.int32)
    _, first_corner, number = np.unique(label[used], return_index=True, return_inverse=True)
    corner[used] = number.reshape(-1, 3)
    return CutSurface(corner, faces[used].ravel()[first_corner])
