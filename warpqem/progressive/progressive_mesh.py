"""A mesh in motion at any level of detail."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from warpqem.arguments.array_record import ArrayRecord
from warpqem.arguments.distance_limit import DistanceLimit
from warpqem.arguments.limits import ABOVE_0
from warpqem.arguments.number_input import number_within, real_number, whole_number
from warpqem.errors import OptionError
from warpqem.options import check_ratio, target_count
from warpqem.progressive.vertex_splits import SplitTopology

__all__ = ["MeshLevel", "ProgressiveMesh"]


@dataclass(frozen=True, eq=False, repr=False)
class MeshLevel(ArrayRecord):
    """One level of a :class:`ProgressiveMesh`: what :func:`warpqem.simplify` gives for as many faces, to the bit.

    Attributes:
        points: (F, V', 3) float32.
        faces: (N', 3) int32.
        face_map: (N',) int32, the input face that each goes on from.
        vertex: (V',) int32, the input vertex that each output vertex goes by.
        error: % of the bounding-box diagonal, as ``SimplifiedMesh.error``.
        split_count: vertex splits from the base mesh.
    """

    points: np.ndarray
    faces: np.ndarray
    face_map: np.ndarray
    vertex: np.ndarray
    error: float
    split_count: int

    def __repr__(self) -> str:
        frames, vertices = self.points.shape[:2]
        return (
            f"MeshLevel({len(self.faces)} faces, {vertices} vertices, {frames} frame{'s' * (frames != 1)}, "
            f"{self.split_count} splits, error={self.error:.3g} %)"
        )

    def _repr_png_(self) -> bytes:
        """The picture that a notebook shows, see :func:`warpqem.picture.preview.preview`."""
        from warpqem.picture.preview import preview

        return preview(self.points, self.faces)


def _check_one(asked: Mapping[str, object]) -> None:
    """Raise an OptionError unless exactly one of some arguments is given."""
    given = [name for name, value in asked.items() if value is not None]
    if len(given) != 1:
        *most, last = asked
        raise OptionError(
            f"exactly one of {', '.join(most)} and {last} is needed, got {' and '.join(given) if given else 'none'}"
        )


@dataclass(frozen=True)
class _Rows:
    """The vertices of one level: ``row`` (V',) by input vertex, and ``start``, their ranks, with ``by_start``."""

    row: np.ndarray
    start: np.ndarray
    by_start: np.ndarray


class ProgressiveMesh:
    """Every level between an animated mesh and its base mesh, one vertex after the other.

    Splits may arrive later than the base: see :func:`warpqem.progressive.file.load`.

    Args:
        topology: the base mesh and the splits.
        points: (F, B + 2 C, 3) float32, the rows' positions in all frames, in the input's coordinates.

    Attributes:
        source: the file it was loaded from; None for a mesh that was built.
    """

    def __init__(self, topology: SplitTopology, points: np.ndarray) -> None:
        self.topology, self.points = topology, points
        self.source: str | None = None
        self._face_counts = topology.face_counts()

    def __repr__(self) -> str:
        loaded = "" if self.is_complete else f", {self.loaded_face_count} loaded"
        frames = f"{self.frame_count} frame{'s' * (self.frame_count != 1)}"
        origin = "" if self.source is None else f", source={self.source!r}"
        return f"ProgressiveMesh({self.base_face_count} to {self.face_count} faces{loaded}, {frames}{origin})"

    def _repr_png_(self) -> bytes:
        """The picture that a notebook shows: the base mesh, the finest level and one between them, first frame."""
        from warpqem.picture.preview import side_by_side

        counts = sorted({0, self.split_count // 2, self.split_count})
        levels = [self.level(count) for count in counts]
        counted = [(level, len(level.faces)) for level in levels]
        return side_by_side([(level.points[0], level.faces, f"{n} face{'s' * (n != 1)}") for level, n in counted])

    @property
    def split_count(self) -> int:
        """Splits C that are loaded; all of them lead to the input itself."""
        return self.topology.split_count

    @property
    def base_face_count(self) -> int:
        """Faces of the base mesh."""
        return int(self._face_counts[0])

    @property
    def face_count(self) -> int:
        """Faces of the input."""
        return self.topology.face_count

    @property
    def loaded_face_count(self) -> int:
        """Faces of the finest level that is loaded."""
        return len(self.topology.face_rank)

    @property
    def is_complete(self) -> bool:
        """Whether all splits are loaded."""
        return self.loaded_face_count == self.face_count

    @property
    def frame_count(self) -> int:
        """Frames F."""
        return len(self.points)

    def splits_for(
        self,
        *,
        ratio: float | None = None,
        target_faces: int | None = None,
        max_error: float | None = None,
        max_size_error: float | None = None,
        device: str | None = None,
    ) -> int:
        """The splits of the level with so many faces, or one fewer, or of the coarsest one within an error.

        Args:
            ratio: part of the input's faces, in (0, 1].
            target_faces: faces.
            max_error: as for :func:`warpqem.simplify`: the largest distance between the input and the level, both ways,
                at every point and in every frame, in % of the diagonal of the input's bounding box in that frame. It is
                proved, for some ten levels one after the other, and needs all splits.
            max_size_error: the same as an estimate, which is there already: :meth:`error` of the level.
            device: Warp device for the proof; None takes cuda:0 if present, else cpu.

        Raises:
            OptionError: not exactly one of the first four is given, there is no such level, or ``max_error`` is given
                and not all splits are loaded.
        """
        asked = {
            "ratio": ratio,
            "target_faces": target_faces,
            "max_error": max_error,
            "max_size_error": max_size_error,
        }
        _check_one(asked)
        if max_error is not None:
            return self._splits_within(number_within(max_error, "max_error", ABOVE_0), device)
        if max_size_error is not None:
            limit = number_within(max_size_error, "max_size_error", ABOVE_0)
            within = np.flatnonzero(100.0 * self.topology.error.astype(np.float64) <= limit)
            if not len(within):
                raise OptionError(f"max_size_error {limit} % was asked for, the error of all levels here is larger")
            return int(within[0])
        if ratio is not None:
            target = target_count(check_ratio(ratio), self.face_count)
        else:
            target = whole_number(target_faces, "target_faces")
        split_count = int(np.searchsorted(self._face_counts, target, side="right")) - 1
        if split_count < 0:
            raise OptionError(f"{target} faces were asked for, the base mesh has {self.base_face_count}")
        if split_count == self.split_count and target > self.loaded_face_count and not self.is_complete:
            raise OptionError(f"{target} faces were asked for, {self.loaded_face_count} are loaded")
        return split_count

    def _splits_within(self, max_error: float, device: str | None) -> int:
        # It takes a mesh of this class, and Warp.
        from warpqem.progressive.bounded_levels import coarsest_within

        self._check_complete("max_error is proved against all faces")
        return coarsest_within(self, DistanceLimit(max_error / 100.0), device=device)

    def error(self, split_count: int) -> float:
        """The error after so many splits, in % of the bounding-box diagonal, as ``SimplifiedMesh.error``.

        Raises:
            OptionError: there are not so many splits.
        """
        return 100.0 * float(self.topology.error[self._checked_count(split_count)])

    def level(
        self,
        split_count: int | None = None,
        *,
        faces: int | None = None,
        ratio: float | None = None,
        max_error: float | None = None,
        max_size_error: float | None = None,
        device: str | None = None,
    ) -> MeshLevel:
        """One level; exactly one argument says which. All but ``max_error`` take time that grows with its size alone.

        Args:
            split_count: splits of the base mesh.
            faces: faces; the level has as many, or one fewer.
            ratio: part of the input's faces, in (0, 1].
            max_error: the coarsest level that is proved to be within so many % of the diagonal of the input's bounding
                box, see :meth:`splits_for`.
            max_size_error: the coarsest level with an ``error``, which is an estimate, of at most so many % of it.
            device: Warp device for the proof of ``max_error``; None takes cuda:0 if present, else cpu.

        Raises:
            OptionError: there is no such level, or not exactly one argument; or ``max_error`` where not all splits are
                loaded.
        """
        asked = {
            "split_count": split_count,
            "faces": faces,
            "ratio": ratio,
            "max_error": max_error,
            "max_size_error": max_size_error,
        }
        _check_one(asked)
        if split_count is None:
            limits: dict[str, Any] = {"max_error": max_error, "max_size_error": max_size_error, "device": device}
            split_count = self.splits_for(ratio=ratio, target_faces=faces, **limits)
        split_count = self._checked_count(split_count)
        rows = self._rows(split_count)
        face_count = int(self._face_counts[split_count])
        order = np.argsort(self.topology.face_index[:face_count])
        corner = self._find(rows, self.topology.face_rank[:face_count][order])
        return MeshLevel(
            points=np.take(self.points, rows.row, axis=1),
            faces=corner.astype(np.int32),
            face_map=self.topology.face_index[:face_count][order],
            vertex=self.topology.row_vertex[rows.row],
            error=self.error(split_count),
            split_count=split_count,
        )

    def vertex_map(self, split_count: int) -> np.ndarray:
        """(V,) int32, input vertex to the output vertex of a level; -1 for a vertex without a face.

        Raises:
            OptionError: not all splits are loaded, or there are not so many.
        """
        self._check_complete("vertex_map is that of all faces")
        rows = self._rows(self._checked_count(split_count))
        full = self._rows(self.split_count)
        vertex_map = np.full(self.topology.vertex_count, -1, dtype=np.int32)
        vertex_map[self.topology.row_vertex[full.row]] = self._find(rows, self.topology.row_start[full.row])
        return vertex_map

    def morph(self, coarse: int, fine: int, blend: float) -> tuple[np.ndarray, np.ndarray]:
        """The level after ``fine`` splits on its way from the one after ``coarse`` splits (geomorph, Hoppe 1996).

        Args:
            coarse: splits of the coarser level.
            fine: splits of the finer one.
            blend: 0 to 1: at 0 every vertex lies on the one it splits from, so that the surface is the coarser level,
                with faces of no area; at 1 it is the finer level.

        Returns:
            Points (F, V', 3) float32 and faces (N', 3) int32 of the finer level.

        Raises:
            OptionError: ``blend`` is outside its range, or the levels are in the wrong order.
        """
        blend = real_number(blend, "blend", "in [0, 1]", lambda value: 0.0 <= value <= 1.0)
        coarse, fine = self._checked_count(coarse), self._checked_count(fine)
        if coarse > fine:
            raise OptionError(f"the coarser level has {coarse} splits, the finer one {fine}")
        before, after, level = self._rows(coarse), self._rows(fine), self.level(fine)
        source = before.row[self._find(before, self.topology.row_start[after.row])]
        start = np.take(self.points, source, axis=1)
        if blend == 0.0:
            return start, level.faces
        if blend == 1.0:
            return level.points, level.faces
        return start + np.float32(blend) * (level.points - start), level.faces

    def _check_complete(self, why: str) -> None:
        if not self.is_complete:
            raise OptionError(f"{why}: only {self.loaded_face_count} of {self.face_count} faces are loaded")

    def _checked_count(self, split_count: int) -> int:
        most = self.split_count
        if isinstance(split_count, (int, np.integer, float, np.floating)) and not 0 <= split_count <= most:
            raise OptionError(f"there are 0 to {most} splits, got {split_count}")
        return whole_number(split_count, "the number of splits", least=0, expected=f"0 to {most}")

    def _rows(self, split_count: int) -> _Rows:
        topology = self.topology
        row = np.flatnonzero(topology.row_end[: topology.base_count + 2 * split_count] >= split_count)
        row = row[np.argsort(topology.row_vertex[row])]
        start = topology.row_start[row]
        by_start = np.argsort(start)
        return _Rows(row, start[by_start], by_start)

    @staticmethod
    def _find(rows: _Rows, rank: np.ndarray) -> np.ndarray:
        """The vertices of a level that hold some ranks."""
        found: np.ndarray = rows.by_start[np.searchsorted(rows.start, rank, side="right") - 1]
        return found
