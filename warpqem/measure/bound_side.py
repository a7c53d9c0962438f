"""One of two meshes whose distance is bounded: what is proved of its faces, and the pieces that they were cut into."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.kernels.near_faces import HINTS, Surface
from warpqem.measure.piece_proof import PieceArrays
from warpqem.measure.unit_frames import UnitBlock
from warpqem.mesh.edges import faces_across

__all__ = ["BoundSide"]


class BoundSide:
    """One of the two meshes: what is known of its faces, and itself in one frame on the device."""

    def __init__(
        self,
        faces: npt.NDArray[np.int32],
        device: str,
        hint: npt.NDArray[np.int32] | None,
        across: wp.array | None = None,
    ) -> None:
        if across is None:
            across = wp.array(faces_across(faces), dtype=wp.int32, device=device)
        self._device, self._mesh = device, None
        self.faces = np.ascontiguousarray(faces, dtype=np.int32)
        self.surface = Surface()
        self.corner_vertex = wp.array(self.faces.ravel(), dtype=wp.int32, device=device, copy=False)
        self.surface.corner_vertex = self.corner_vertex
        self.surface.across = across
        hints = np.full((len(faces), int(HINTS)), -1, dtype=np.int32)
        if hint is not None:
            hints[:, 0] = hint
        self.hint = wp.array(hints, dtype=wp.int32, device=device)
        self.pieces = PieceArrays.none()
        # Faces whose pieces are there, faces to be looked at, and those that do not hold.
        self.recorded = np.zeros(len(faces), dtype=bool)
        self.active = np.ones(len(faces), dtype=bool)
        self.failed = np.zeros(len(faces), dtype=bool)
        # Faces that are not known to hold nor to fail.
        self.undecided = np.zeros(len(faces), dtype=bool)
        # Faces (n, 2), of this mesh and of the other one, that in some frame proves it beside those in the pieces. Kept
        # of the mesh whose faces stay: of the other one a face that moves is looked at anyway.
        self.relied_on = np.zeros((0, 2), dtype=np.int32)

    @property
    def unrecorded(self) -> npt.NDArray[np.int64]:
        """Faces to be looked at that have no pieces."""
        return np.flatnonzero(self.active & ~self.recorded & ~self.failed)

    def inherit(
        self,
        old: BoundSide,
        owner: npt.NDArray[np.integer],
        face: npt.NDArray[np.integer],
        stays: npt.NDArray[np.bool_] | None,
    ) -> None:
        """Take over the pieces of ``old``, with new numbers of owners and faces, -1 for those that are no more.

        With ``stays``, faces of the other mesh that have not moved, what lies over these alone is proved.
        """
        pieces = old.pieces
        new_owner, new_face = owner[pieces.owner], face[pieces.face]
        broken = np.zeros(len(old.faces), dtype=bool)
        broken[pieces.owner[(new_face < 0) | (new_owner < 0)]] = True
        whole = old.recorded & ~broken & ~old.failed
        keep = np.flatnonzero(whole[pieces.owner])
        self.pieces = PieceArrays(
            pieces.parent[keep],
            new_owner[keep].astype(np.int32),
            new_face[keep].astype(np.int32),
            pieces.weight.take(keep, axis=0),
        )
        self.recorded[self.pieces.owner] = True
        proved = whole & ~old.undecided
        if stays is None:
            # No face of the other mesh has moved: those of this one decide.
            self.active[owner[proved & (owner >= 0)]] = False
        else:
            for own_face, other_face in ((pieces.owner, pieces.face), old.relied_on.T):
                proved[own_face[~stays[other_face]]] = False
            self.active = ~proved
            relied_on = old.relied_on[proved[old.relied_on[:, 0]]]
            self.relied_on = np.stack([owner[relied_on[:, 0]], face[relied_on[:, 1]]], axis=1).astype(np.int32)
        if self.faces is old.faces:
            self._mesh, self.surface.mesh = old._mesh, old.surface.mesh

    def rely_on(self, pairs: Sequence[npt.NDArray[np.int32]]) -> None:
        """Note what the proofs of the faces looked at rely on, pairs as ``relied_on``."""
        known = np.concatenate([self.relied_on, *pairs]).astype(np.int64)
        if len(known):
            size = int(known[:, 1].max()) + 1
            key = np.unique(known[:, 0] * size + known[:, 1])
            self.relied_on = np.stack([key // size, key % size], axis=1).astype(np.int32)

    def show(self, block: UnitBlock, frame: int, *, searched: bool) -> None:
        """Show a frame; ``searched`` says whether the hierarchy is needed.

        The hierarchy is refitted from frame to frame: where it leads the search decides no verdict.
        """
        self.surface.points = block.double[frame]
        if searched:
            single = wp.array(self.surface.points.numpy().astype(np.float32), dtype=wp.vec3, device=self._device)
            mesh = self._mesh
            if mesh is None:
                mesh = self._mesh = wp.Mesh(points=single, indices=self.corner_vertex)
            else:
                mesh.points = single
            self.surface.mesh = mesh.id
