"""The input surface cut along seams, so that a walk over it stays on its side of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from warpqem.mesh.components import lowest_members
from warpqem.mesh.mesh_input import is_proper
from warpqem.pipeline.surface_transfer import joined_edges, matching_corners

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
        # All corners of a face are on it, or none.
        return np.flatnonzero(self.corner[:, 0] >= 0).astype(np.int32)


def cut_surface(faces: Ints, seams: npt.NDArray[np.int64], sheets: Ints | None = None) -> CutSurface:
    """Cut a surface.

    Args:
        faces: (N, 3) int32, the input.
        seams: (S, 2) int64, ends of the edges that values do not cross.
        sheets: (N, 3) int32, see :class:`warpqem.repair.mended_mesh.MeshRepair`; None where nothing was mended.
    """
    topology = faces if sheets is None else sheets
    # Column by column: NumPy takes five times as long along rows of three.
    used = is_proper(faces)
    if topology.min(initial=0) < 0:
        used &= (topology >= 0).all(axis=1)
    label = topology.astype(np.int64)
    # Beside seams alone are there vertices with several sides.
    is_seam = np.zeros(int(faces.max(initial=0)) + 1, dtype=bool)
    # A vertex that no face uses is beside none.
    is_seam[seams[seams < len(is_seam)]] = True
    on_seam = is_seam.take(faces)
    beside = (on_seam[:, 0] | on_seam[:, 1] | on_seam[:, 2]) & used
    if beside.any():
        part = np.flatnonzero(beside)
        own = topology[part]
        # Pairs as in the whole mesh, as all faces at a vertex of a seam are in this part.
        one, other = matching_corners(*joined_edges(faces[part], seams, own), own)
        # Faces back to back share the third vertex, too.
        shared = np.flatnonzero(own.ravel()[one] == own.ravel()[other])
        side = lowest_members(own.size, np.stack([one[shared], other[shared]], axis=1)).reshape(-1, 3)
        label[part] = np.where(on_seam[part], int(topology.max()) + 1 + side, own)
    if not used.all():
        label, faces = label[used], faces[used]
    flat = label.ravel()
    # Labels are few more than corners: a table takes a tenth of the time that sorting them does.
    first = np.full(int(flat.max(initial=-1)) + 1, -1, dtype=np.int64)
    first[flat[::-1]] = np.arange(len(flat))[::-1]
    is_used = first >= 0
    corner = (np.cumsum(is_used, dtype=np.int32) - 1).take(flat).reshape(-1, 3)
    vertex = faces.ravel()[first[is_used]]
    if len(corner) < len(used):
        everywhere = np.full((len(used), 3), -1, dtype=np.int32)
        everywhere[used] = corner
        corner = everywhere
    return CutSurface(corner, vertex)
