"""Values at the corners of the output that fit the input's: normals, and whatever is smooth between corners."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import astuple, dataclass, replace

import numpy as np
import numpy.typing as npt

from warpqem.attribute_fit.input_samples import InputSamples
from warpqem.attribute_fit.normal_groups import split_corners
from warpqem.attribute_fit.partners import Partners
from warpqem.attribute_fit.solve import corner_fits, fit_values, misfits
from warpqem.mesh.directions import unit_vectors

__all__ = [
    "NormalErrors",
    "ValueLayout",
    "fit_normals",
    "fit_smooth_values",
    "normal_errors",
    "normal_misfits",
    "own_normals",
    "split_normals",
]

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]

# Shorter vectors than this have no direction.
SHORTEST = 1e-12


@dataclass(frozen=True)
class ValueLayout:
    """Where the values of one attribute stand on both meshes.

    Attributes:
        partners: of the samples.
        corner_element: (N, 3) int32, which value each corner of the input has.
        corner_row: (N', 3) int32, which of R values each corner of the output has.
        input_samples: samples of the input that errors are taken at, too; None for none.
    """

    partners: Partners
    corner_element: Ints
    corner_row: Ints
    input_samples: InputSamples | None = None


def fit_smooth_values(
    layout: ValueLayout, values: Floats, start: Floats, free: npt.NDArray[np.bool_] | None = None
) -> Floats:
    """Values (R, C) for the output that fit those of the input best, within the range of these in each channel.

    Args:
        layout: where they stand.
        values: (E, C) float64, of the input.
        start: (R, C) float64, values so far, which stay where nothing is known of the input.
        free: (R,) bool, values that may change; None for all.
    """
    free = np.ones(len(start), dtype=bool) if free is None else free
    misfit = misfits(layout.partners, layout.corner_element, values, layout.corner_row, start)
    fitted = start + fit_values(layout.partners, misfit, layout.corner_row, free)
    for k in range(values.shape[1]):
        # Along rows NumPy takes ten times as long.
        channel = values[:, k]
        np.clip(fitted[:, k], channel.min(), channel.max(), out=fitted[:, k])
    return np.where(free[:, None], fitted, start)


def normal_misfits(layout: ValueLayout, values: Floats, start: Floats) -> Floats:
    """What start normals miss of those of the input, (N', 3, 3), see :func:`warpqem.attribute_fit.solve.misfits`.

    Args:
        layout: where they stand.
        values: (E, 3) float64, of the input, unit vectors.
        start: (R, 3) float64, unit vectors.
    """
    return misfits(layout.partners, layout.corner_element, values, layout.corner_row, start)


def own_normals(layout: ValueLayout, misfit: Floats, start: Floats) -> Floats:
    """Unit normals (N', 3, 3) at the corners of each face that fit its own samples best; arguments of `fit_normals`."""
    return unit_vectors(start[layout.corner_row] + corner_fits(misfit))


def split_normals(faces: Ints, layout: ValueLayout, own: Iterable[Floats]) -> tuple[ValueLayout, Ints]:
    """Let corners have normals of their own where one normal cannot stand for the input's on all faces at a vertex.

    Args:
        faces: (N', 3) int32, the output.
        layout: where normals stand so far.
        own: what :func:`own_normals` gives; in several poses, which have to agree.

    Returns:
        Where they stand then, and (R',) the row so far of each; the layout itself where nothing is split.
    """
    group, row = split_corners(faces, layout.corner_row, own)
    if len(row) == np.count_nonzero(np.bincount(layout.corner_row.ravel())):
        return layout, np.arange(int(layout.corner_row.max(initial=-1)) + 1, dtype=np.int32)
    return replace(layout, corner_row=group), row


def fit_normals(layout: ValueLayout, misfit: Floats, start: Floats) -> Floats:
    """Unit normals (R, 3) for the output that fit those of the input best.

    Args:
        layout: where they stand; corners that are split go on from the same start, and miss as much.
        misfit: (N', 3, 3), what the start misses by `normal_misfits`.
        start: (R, 3) float64, unit vectors, which stay where nothing is known of the input.
    """
    fitted = start + fit_values(layout.partners, misfit, layout.corner_row, np.ones(len(start), dtype=bool))
    length = np.linalg.norm(fitted, axis=1, keepdims=True)
    return np.where(length > SHORTEST, fitted / np.maximum(length, SHORTEST), start)


@dataclass(frozen=True)
class NormalErrors:
    """How far normals are from the input's at the samples, means by area; both 0 where no sample has a partner.

    Attributes:
        squared: squared difference of the unit normals: what pictures of the shading show.
        angle: angle between them, in radians. A few samples beyond an edge that went decide the other one alone.
        both_squared: mean of that and of the same at samples of the input, where there are some.
        both_angle: likewise.
    """

    squared: float
    angle: float
    both_squared: float
    both_angle: float

    @classmethod
    def over_poses(cls, poses: Iterable[NormalErrors]) -> NormalErrors:
        """The mean over poses, at least one."""
        squared, angle, both_squared, both_angle = np.mean([astuple(one) for one in poses], axis=0).tolist()
        return cls(squared, angle, both_squared, both_angle)

    def is_within(self, other: NormalErrors, share: float = 1.0) -> bool:
        """Whether none is larger than that of ``other``, the squared one than so large a part of it."""
        both = self.both_squared <= other.both_squared and self.both_angle <= other.both_angle
        return both and self.squared <= share * other.squared and self.angle <= other.angle


def normal_errors(layout: ValueLayout, values: Floats, *shown: Floats) -> list[NormalErrors]:
    """How far normals of the output are from the input's, both ways where there are samples of the input.

    Args:
        layout: where the input's normals stand.
        values: (E, 3) float64, of the input, of length one.
        shown: each (N', 3, 3), normals at the corners of the output.
    """
    face, weight = layout.partners.face_on_host, layout.partners.weight_on_host
    known = face >= 0
    # A slice is a view, and next to always enough.
    chosen = np.s_[:] if known.all() else known
    area = np.broadcast_to(layout.partners.area[:, None], face.shape)[chosen].ravel()
    total = float(area.sum())
    if not total > 0:
        return [NormalErrors(0.0, 0.0, 0.0, 0.0)] * len(shown)
    element = layout.corner_element[face[chosen].ravel()]
    weight = weight[chosen].reshape(-1, 3).astype(np.float64)
    # One corner after the other takes half the time of an array of all three.
    wanted = unit_vectors(np.add.reduce([weight[:, k : k + 1] * values[element[:, k]] for k in range(3)]))
    found = []
    for corners in shown:
        normals = unit_vectors((layout.partners.samples @ corners)[chosen].reshape(-1, 3))
        ways = [_mean_errors(wanted, normals, area / total)]
        samples = layout.input_samples
        if samples is not None:
            there = samples.normals_of_input(values[layout.corner_element])
            even = np.full(len(there), 1.0 / len(there))
            ways.append(_mean_errors(there, samples.normals_of_output(corners), even))
        both_squared, both_angle = np.mean(ways, axis=0).tolist()
        found.append(NormalErrors(*ways[0], both_squared, both_angle))
    return found


def _mean_errors(wanted: Floats, normals: Floats, weight: Floats) -> tuple[float, float]:
    """Squared difference and angle of unit normals (S, 3) with weights (S,) that sum to one."""
    squared = ((wanted - normals) ** 2).sum(axis=1)
    # Of a chord of the unit circle; rounding may take it beyond the diameter.
    angle = 2 * np.arcsin(np.minimum(np.sqrt(squared) / 2, 1.0))
    return float((weight * squared).sum()), float((weight * angle).sum())
