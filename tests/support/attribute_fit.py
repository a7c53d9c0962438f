"""A mesh simplified and made ready for the attribute fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import warpqem
from warpqem.attribute_fit.partners import PartnerSearch
from warpqem.attribute_fit.texture import reference_signs
from warpqem.attribute_fit.values import ValueLayout
from warpqem.pipeline.surface_transfer import SurfaceTransfer, surface_transfer


@dataclass(frozen=True)
class Fitting:
    """What tests fit: the input's faces on their points, the result, and where values stand."""

    points: np.ndarray
    faces: np.ndarray
    result: warpqem.SimplifiedMesh
    transfer: SurfaceTransfer
    layout: ValueLayout

    def start(self, corner_values: np.ndarray) -> np.ndarray:
        """Transferred values (R, C) of those at the corners of the input (N, 3, C)."""
        return self.transfer.wedges_from_corners(corner_values)

    def signs(self, values: np.ndarray) -> np.ndarray:
        """Which way each triangle of the output is to turn by texture coordinates (3N, 2)."""
        repair = self.result.repair
        turned = np.zeros(len(self.faces), dtype=bool) if repair is None else repair.is_turned
        return reference_signs(self.layout, values, self.result.face_map, turned)


def fitting(points, faces, seams=None, ratio: float = 0.3, device: str = "cpu") -> Fitting:
    """Simplify a mesh, and find partners of samples for values at its corners that do not cross seams (S, 2)."""
    ends = np.zeros((0, 2), dtype=np.int64) if seams is None else np.asarray(seams, dtype=np.int64)
    result = warpqem.simplify(points, faces, ratio=ratio, seams=ends, measure=False, device=device)
    transfer = surface_transfer(points, faces, result, seams=ends, device=device)
    partners = PartnerSearch(faces, result, transfer, ends, device).find(points, result.points[0])
    elements = np.arange(faces.size, dtype=np.int32).reshape(-1, 3)
    return Fitting(points, faces, result, transfer, ValueLayout(partners, elements, transfer.corner_wedge))
