"""Normals of one pose of a mesh in another pose."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from warpqem.mesh.directions import unit_vectors

__all__ = ["posed_normals"]

Floats = npt.NDArray[np.float64]


def posed_normals(
    rest: npt.NDArray[np.floating], normals: npt.NDArray[np.floating], posed: npt.NDArray[np.floating]
) -> Floats:
    """Unit normals (N, 3, 3) that go with the faces from one pose into another.

    Each face takes its normals along as what is upright on its points stays so, as the inverse transpose of its
    deformation does; corners that share a point and a normal at rest share the mean.

    Args:
        rest: (N, 3, 3) the corners in the pose of the normals.
        normals: (N, 3, 3) unit normals there.
        posed: (N, 3, 3) the corners in the other pose.
    """
    rest, normals, posed = (np.asarray(given, dtype=np.float64) for given in (rest, normals, posed))
    edge, other = rest[:, 1] - rest[:, 0], rest[:, 2] - rest[:, 0]
    cross = np.cross(edge, other)
    area = np.linalg.norm(cross, axis=1)[:, None]
    # What a normal has along two edges and across the face stays; only what these are in space changes.
    along, across, up = (np.einsum("nkd,nd->nk", normals, axis) for axis in (edge, other, unit_vectors(cross)))
    edge, other = posed[:, 1] - posed[:, 0], posed[:, 2] - posed[:, 0]
    cross = np.cross(edge, other)
    squared = (cross * cross).sum(axis=1)[:, None]
    inverse = np.divide(1.0, squared, out=np.zeros_like(squared), where=squared > 0)
    # Across, a face stretches as it does along itself, so that a mesh may grow.
    up = up * np.sqrt(area * np.sqrt(inverse))
    # The dual basis of the two edges in their plane.
    first, second = np.cross(other, cross) * inverse, np.cross(cross, edge) * inverse
    moved = sum(
        part[..., None] * axis[:, None] for part, axis in ((along, first), (across, second), (up, unit_vectors(cross)))
    )
    rows = np.concatenate([rest, normals], axis=2).reshape(-1, 6) + 0.0
    _, group = np.unique(rows, axis=0, return_inverse=True)
    weighted = np.sqrt(squared)[:, :, None] * unit_vectors(np.asarray(moved))
    sums = [np.bincount(group.ravel(), weighted[..., axis].ravel()) for axis in range(3)]
    total: Floats = np.stack(sums, axis=1)
    return unit_vectors(total[group.ravel()].reshape(normals.shape))
