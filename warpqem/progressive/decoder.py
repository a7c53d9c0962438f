"""Chunks of a file put together to a mesh, with every number in them checked: a file may come from anywhere.

What passes is a progressive mesh: its vertices have ranks of their own, every face has three vertices on every level,
points are finite, and errors fall from level to level.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from warpqem.errors import ProgressiveFileError
from warpqem.progressive import coding
from warpqem.progressive.header import MAX_FACES_PER_SPLIT, FileInfo
from warpqem.progressive.progressive_mesh import ProgressiveMesh
from warpqem.progressive.vertex_splits import SplitTopology

__all__ = ["ChunkDecoder"]

Part = bytes | memoryview

# Positions that are decoded at a time, where the mesh has not many more: decoding takes six times the memory of a
# block. Those of larger meshes are decoded in larger blocks, since each goes through all frames one after the other.
MIN_BLOCK, BLOCKS_A_MESH = 2**19, 16


class ChunkDecoder:
    """Takes one chunk after the other.

    Args:
        info: the header.
        chunk_count: chunks that are going to be read.
    """

    def __init__(self, info: FileInfo, chunk_count: int) -> None:
        self._info = info
        splits, faces = info.loaded_counts(chunk_count)
        rows = info.base_vertex_count + 2 * splits
        self._row_vertex, self._row_start, self._row_stop = (np.empty(rows, dtype=np.int32) for _ in range(3))
        self._is_used = np.zeros(info.vertex_count, dtype=bool)
        self._row_end = np.full(rows, info.split_count, dtype=np.int32)
        self._parent_row = np.empty(splits, dtype=np.int32)
        self._error = np.empty(splits + 1, dtype=np.float32)
        self._face_rank = np.empty((faces, 3), dtype=np.int32)
        self._face_index, self._face_split = (np.full(faces, -1, dtype=np.int32) for _ in range(2))
        self._points = np.empty((info.frame_count, rows, 3), dtype=np.float32)
        self._block = max(1, max(MIN_BLOCK, info.frame_count * rows // BLOCKS_A_MESH) // info.frame_count)

    def mesh(self, chunk_count: int) -> ProgressiveMesh:
        """The mesh of the chunks so far, which are so many."""
        split_count, face_count = self._info.loaded_counts(chunk_count)
        rows = self._info.base_vertex_count + 2 * split_count
        topology = SplitTopology(
            base_count=self._info.base_vertex_count,
            row_vertex=self._row_vertex[:rows],
            row_start=self._row_start[:rows],
            parent_row=self._parent_row[:split_count],
            row_end=self._row_end[:rows].copy(),
            face_rank=self._face_rank[:face_count],
            face_index=self._face_index[:face_count],
            face_split=self._face_split[:face_count],
            error=self._error[: split_count + 1],
            vertex_count=self._info.vertex_count,
            face_count=self._info.face_count,
        )
        return ProgressiveMesh(topology, self._points[:, :rows])

    def read(self, index: int, parts: Sequence[Part]) -> None:
        """Take the next chunk.

        Raises:
            ProgressiveFileError: it holds something that no chunk there could.
        """
        if index == 0:
            self._read_base(parts)
        else:
            start, stop = (self._info.loaded_counts(count) for count in (index, index + 1))
            self._read_splits(parts, slice(start[0], stop[0]), slice(start[1], stop[1]))

    def _read_base(self, parts: Sequence[Part]) -> None:
        _check_part_count(parts, 6)
        info, count = self._info, self._info.base_vertex_count
        vertex, start = _sums(parts[0], count), _sums(parts[1], count)
        self._use_vertices(vertex)
        _check_range("rank", start, info.rank_count)
        by_start = np.argsort(start)
        ascending = start[by_start]
        if ascending[0] != 0 or (np.diff(ascending) <= 0).any():
            raise ProgressiveFileError("the ranks of the base mesh overlap")
        stop = np.empty_like(start)
        stop[by_start] = np.append(ascending[1:], info.rank_count)
        self._row_vertex[:count], self._row_start[:count], self._row_stop[:count] = vertex, start, stop
        faces = slice(0, info.base_face_count)
        self._read_faces(parts[2], parts[3], faces)
        corner = np.sort(np.searchsorted(ascending, self._face_rank[faces], side="right"), axis=1)
        if (corner[:, 1:] == corner[:, :-1]).any():
            raise ProgressiveFileError("a face of the base mesh has a vertex twice")
        self._read_errors(parts[4], slice(0, 1))
        residuals = coding.Residuals(parts[5], count, info.frame_count, 3)
        for rows in self._blocks(np.arange(count)):
            self._set_points(rows, coding.restore_tracks(residuals.rows(slice(rows[0], rows[-1] + 1))))

    def _read_splits(self, parts: Sequence[Part], splits: slice, faces: slice) -> None:
        _check_part_count(parts, 10)
        count, split = splits.stop - splits.start, np.arange(splits.start, splits.stop)
        kept = self._info.base_vertex_count + 2 * split
        parent, vertex, rank = (_sums(part, count) for part in parts[:3])
        self._use_vertices(vertex)
        waves = self._waves(parent, int(kept[0]))
        brought = coding.unpack(parts[3], count)
        if (brought < 0).any() or (brought > MAX_FACES_PER_SPLIT).any() or brought.sum() != faces.stop - faces.start:
            raise ProgressiveFileError("splits bring other faces than the header says")
        self._read_faces(parts[4], parts[5], faces)
        self._face_split[faces] = np.repeat(split, brought)
        self._read_errors(parts[6], slice(splits.start + 1, splits.stop + 1))
        ratio = coding.unpack(parts[7], count, np.float32)
        # A number that is none is not within either.
        if not (np.abs(ratio) <= coding.LARGEST_RATIO).all():
            raise ProgressiveFileError(f"the ratio of a split is not within {coding.LARGEST_RATIO:g}")
        self._parent_row[splits] = parent
        for chosen in waves:
            self._split_ranks(parent[chosen], kept[chosen], vertex[chosen], rank[chosen], split[chosen])
        self._check_brought(parent, kept, faces)
        first, second = (coding.Residuals(part, count, self._info.frame_count, 3) for part in parts[8:])
        for wave in waves:
            for chosen in self._blocks(wave):
                source = np.take(self._points, parent[chosen], axis=1).transpose(1, 0, 2)
                tracks = coding.decode_splits((first.rows(chosen), second.rows(chosen)), source, ratio[chosen])
                self._set_points(kept[chosen], tracks[0])
                self._set_points(kept[chosen] + 1, tracks[1])

    def _use_vertices(self, vertex: np.ndarray) -> None:
        """Take input vertices for rows that no split has made before."""
        _check_range("input vertex", vertex, self._info.vertex_count)
        used = self._is_used[vertex]
        self._is_used[vertex] = True
        if used.any() or len(np.unique(vertex)) < len(vertex):
            raise ProgressiveFileError("two vertices of a level are the same input vertex")

    def _blocks(self, rows: np.ndarray) -> Iterator[np.ndarray]:
        """So many of some rows at a time."""
        for start in range(0, len(rows), self._block):
            yield rows[start : start + self._block]

    def _waves(self, parent: np.ndarray, first_row: int) -> list[np.ndarray]:
        """The splits of a chunk by how many others of it each one comes after."""
        if (parent < 0).any() or (parent >= first_row + 2 * np.arange(len(parent))).any():
            raise ProgressiveFileError("a split ends a vertex that is not there yet")
        if len(np.unique(parent)) < len(parent) or (self._row_end[parent] < self._info.split_count).any():
            raise ProgressiveFileError("two splits end the same vertex")
        after: list[int] = []
        for before in ((parent - first_row) // 2).tolist():
            after.append(after[before] + 1 if before >= 0 else 0)
        order = np.argsort(after, kind="stable")
        return np.split(order, np.flatnonzero(np.diff(np.array(after)[order])) + 1)

    def _split_ranks(
        self, parent: np.ndarray, kept: np.ndarray, vertex: np.ndarray, rank: np.ndarray, split: np.ndarray
    ) -> None:
        start, stop = self._row_start[parent], self._row_stop[parent]
        if (rank <= start).any() or (rank >= stop).any():
            raise ProgressiveFileError("a split parts ranks that its vertex does not have")
        self._row_vertex[kept], self._row_vertex[kept + 1] = self._row_vertex[parent], vertex
        self._row_start[kept], self._row_stop[kept] = start, rank
        self._row_start[kept + 1], self._row_stop[kept + 1] = rank, stop
        self._row_end[parent] = split

    def _check_brought(self, parent: np.ndarray, kept: np.ndarray, faces: slice) -> None:
        """Whether each face lies on the edge between the two vertices of the split that brings it."""
        place = self._face_split[faces] - (kept[0] - self._info.base_vertex_count) // 2
        rank = self._face_rank[faces]

        def held(row: np.ndarray) -> np.ndarray:
            """How many corners of each face a row of its own has."""
            start, stop = self._row_start[row][:, None], self._row_stop[row][:, None]
            count: np.ndarray = ((rank >= start) & (rank < stop)).sum(axis=1)
            return count

        own, new, both = (held(row[place]) for row in (kept, kept + 1, parent))
        if ((own != 1) | (new != 1) | (both != 2)).any():
            raise ProgressiveFileError("a face is not at the edge that its split brings")

    def _read_faces(self, ranks: Part, indices: Part, faces: slice) -> None:
        count = faces.stop - faces.start
        self._face_rank[faces] = _sums(ranks, count, 3)
        self._face_index[faces] = _sums(indices, count)
        _check_range("rank of a corner", self._face_rank[faces], self._info.rank_count)
        # The caller's faces may have been more: those with a vertex twice were left out.
        _check_range("face", self._face_index[faces], 2**31 - 1)

    def _read_errors(self, part: Part, splits: slice) -> None:
        error = coding.unpack(part, splits.stop - splits.start, np.float32)
        self._error[splits] = error
        # From the level before on; comparisons with what is no number are false.
        error = self._error[max(splits.start - 1, 0) : splits.stop]
        if not (np.isfinite(error).all() and (error >= 0).all() and (error[1:] <= error[:-1]).all()):
            raise ProgressiveFileError("errors are not finite numbers that fall from level to level")

    def _set_points(self, rows: np.ndarray, tracks: np.ndarray) -> None:
        if not np.isfinite(tracks).all():
            raise ProgressiveFileError("a point is not finite")
        self._points[:, rows] = tracks.transpose(1, 0, 2)


def _sums(part: Part, count: int, width: int = 1) -> np.ndarray:
    """Indices (count,), or (count, width), from differences of neighbours."""
    values = np.cumsum(coding.unpack(part, count * width).reshape(count, width), axis=0, dtype=np.int32)
    return values if width > 1 else values[:, 0]


def _check_part_count(parts: Sequence[Part], count: int) -> None:
    if len(parts) != count:
        raise ProgressiveFileError(f"{len(parts)} parts where {count} belong")


def _check_range(name: str, values: np.ndarray, end: int) -> None:
    outside = (values < 0) | (values >= end)
    if outside.any():
        raise ProgressiveFileError(f"{name} {values[outside][0]} is not between 0 and {end - 1}")
