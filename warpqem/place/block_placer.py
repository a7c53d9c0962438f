"""Place clusters of input vertices in a block of frames at a time.

Memory is that of the block and of the clusters; the number of frames does not matter. Frames do not know of each other,
so how they are cut into blocks makes no difference to a single bit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from warpqem.frames.blocks import block_width, pack_frames, unpack_frames
from warpqem.frames.device_frames import to_device
from warpqem.kernels import placement as kernels
from warpqem.kernels.lanes import width_of
from warpqem.mesh.mesh_input import AnimatedMesh
from warpqem.runtime import new_arrays
from warpqem.runtime.part_launches import FIRST_ITEM, PerPart, columns_of, launch_in_parts, rows_of
from warpqem.runtime.staging import Download, Downloads

__all__ = ["BlockPlacer", "ClusterData", "PlacedBlocks", "PlacedFrames", "PointsUnderWay", "pack_block"]

# Blocks of frames times clusters times stiffnesses that are measured at once. Each takes 20 bytes: 20 MB at most.
MAX_MEASURED = 1 << 20


@dataclass(frozen=True)
class PlacedFrames:
    """Some placed frames: ``points`` (n, C, 3) float32, in diagonals, and area-weighted normals of the input there.

    A normal (n, C, 3) is the sum over the faces of the vertex's cluster, twice their area long. ``copied`` (n, M, 3)
    float32 are the input's points, about its origin, at the vertices that are copied from it. Those that stay on a
    device are arrays (n, ...) of points there.
    """

    points: np.ndarray | wp.array
    normals: np.ndarray | wp.array
    copied: np.ndarray | wp.array

    def to_blocks(self, width: int, copied: wp.array) -> PlacedBlocks:
        """All of it on the device, in blocks of so many frames; ``copied`` (M,) are the vertices that are copies."""
        device = copied.device
        points, normals = (pack_frames(values, device, width=width) for values in (self.points, self.normals))
        copied_from = new_arrays.uploaded(np.arange(len(copied)), dtype=wp.int32, device=device)
        return PlacedBlocks(points, normals, to_device(self.copied, device), copied_from, copied)

    def to_rows(self) -> np.ndarray:
        """All of it as one array (n, 2C + M, 3)."""
        return np.concatenate([self.points, self.normals, self.copied], axis=1)

    @classmethod
    def from_rows(cls, rows: np.ndarray, vertex_count: int) -> PlacedFrames:
        """Back from such an array, for C vertices."""
        parts = (rows[:, :vertex_count], rows[:, vertex_count : 2 * vertex_count], rows[:, 2 * vertex_count :])
        return cls(*(np.ascontiguousarray(part) for part in parts))


@dataclass(frozen=True)
class PointsUnderWay:
    """Points of some frames, and a number for each, on their way to the host.

    Attributes:
        download: brings both.
        shape: (n, C, 3), of the points.
    """

    download: Download
    shape: tuple[int, int, int]

    def result(self) -> tuple[np.ndarray, np.ndarray]:
        """Points float32, and the numbers (n,) int32, once they are there; none where there are none."""
        numbers, size = self.download.result(), math.prod(self.shape)
        return numbers[:size].reshape(self.shape), numbers[size:].view(np.int32)


@dataclass(frozen=True)
class PlacedBlocks:
    """The same on the device.

    Attributes:
        points: (C, B) blocks of points, in diagonals.
        normals: (C, B) blocks of normals.
        source: (n, V) points of the input, about its origin.
        copied_from: (M,) int32, the vertices of ``source`` that are copied.
        copied: (M,) int32, the output vertices that are copies of them.
    """

    points: wp.array
    normals: wp.array
    source: wp.array
    copied_from: wp.array
    copied: wp.array

    def original_points(self, mesh: AnimatedMesh) -> np.ndarray:
        """The points in the caller's coordinates, (n, C, 3) float32, on the host."""
        found: np.ndarray = self.restored(mesh).numpy()
        return found

    def begin_download(self, mesh: AnimatedMesh, number: wp.array | None, downloads: Downloads) -> PointsUnderWay:
        """Begin to bring the same and ``number`` (n,) int32 of the device, if there is one, to the host by one copy."""
        shape = (len(self.source), len(self.points), 3)
        size = math.prod(shape)
        rows = new_arrays.empty(
            size + (0 if number is None else len(number)), dtype=wp.float32, device=self.points.device
        )
        self.restored(mesh, new_arrays.shaped(rows, shape[:2], wp.vec3))
        if number is not None:
            new_arrays.copy(new_arrays.shaped(rows, number.shape, wp.int32, first=size), number)
        return PointsUnderWay(downloads.begin(rows), shape)

    def restored(self, mesh: AnimatedMesh, out: wp.array | None = None) -> wp.array:
        """The same on the device, (n, C) points, in ``out`` if that is given."""
        device = self.points.device
        if out is None:
            out = new_arrays.empty((len(self.source), len(self.points)), dtype=wp.vec3, device=device)
        offset = wp.vec3d(*map(float, mesh.centre + mesh.origin))
        launch_in_parts(
            kernels.restore_points[width_of(self.points)],
            self.points.shape,
            inputs=[rows_of(self.points), float(mesh.diagonal), offset],
            outputs=[columns_of(out)],
            device=device,
        )
        self._copy(wp.vec3d(*map(float, mesh.origin)), self.copied, out)
        return out

    def fetch(self) -> PlacedFrames:
        """All of it on the host, with one copy."""
        size = 2 * len(self.points) + len(self.copied)
        rows = new_arrays.empty((len(self.source), size), dtype=wp.vec3, device=self.points.device)
        self.fill(rows)
        return PlacedFrames.from_rows(rows.numpy(), len(self.points))

    def fill(self, rows: wp.array) -> None:
        """Put all of it into an array (n, 2C + M) of points there."""
        vertex_count, device = len(self.points), rows.device
        unpack_frames(self.points, rows[:, :vertex_count])
        unpack_frames(self.normals, rows[:, vertex_count : 2 * vertex_count])
        columns = new_arrays.uploaded(2 * vertex_count + np.arange(len(self.copied)), dtype=wp.int32, device=device)
        # Adding a negative zero changes no bit.
        self._copy(wp.vec3d(-0.0, -0.0, -0.0), columns, rows)

    def _copy(self, offset: wp.vec3d, columns: wp.array, out: wp.array) -> None:
        """The copied vertices plus ``offset`` into some columns (M,) of points (n, ...)."""
        if len(self.copied):
            launch_in_parts(
                kernels.copy_vertices,
                (len(self.source), len(self.copied)),
                inputs=[rows_of(self.source), self.copied_from, offset, columns],
                outputs=[rows_of(out)],
                device=out.device,
            )


@dataclass(frozen=True)
class ClusterData:
    """What placing takes.

    Attributes:
        corner_vertex: (3N,) int32 on the device, the input's faces.
        rows: the arrays of :class:`warpqem.kernels.placement.Clusters` by their names, on the device or the host.
    """

    corner_vertex: wp.array
    rows: dict[str, Any]

    @property
    def vertex_count(self) -> int:
        """Clusters C."""
        return len(self.rows["solved"])


def pack_block(mesh: AnimatedMesh, points: wp.array, device: str) -> wp.array:
    """Some frames of the mesh, given about its origin: (n, V) points on the device, as placing takes them."""
    width = block_width(mesh.frame_count, device)
    return pack_frames(points, device, centre=mesh.centre, scale=1 / mesh.diagonal, width=width)


class BlockPlacer:
    """Clusters on a device.

    Args:
        data: the clusters.
        device: Warp device.

    Attributes:
        copied_from: (M,) int32, the input vertices that are copied.
        copied: (M,) int32, the clusters that are copies of them.
    """

    def __init__(self, data: ClusterData, device: str) -> None:
        self._data, self._device = data, device
        self._corner_vertex = data.corner_vertex
        self._clusters = kernels.Clusters()
        for name, values in data.rows.items():
            if isinstance(values, np.ndarray):
                dtype = kernels.Clusters.vars[name].type.dtype
                values = new_arrays.uploaded(values, dtype=dtype, device=device, copy=False)
            setattr(self._clusters, name, values)
        none = np.empty(0, dtype=np.int32)
        self.copy_vertices(none, none)

    def copy_vertices(self, copied_from: np.ndarray, copied: np.ndarray) -> None:
        """Copy some clusters (M,) int from input vertices (M,) int from now on, in place of others."""
        self.copied_from, self.copied = (
            new_arrays.uploaded(values, dtype=wp.int32, device=self._device) for values in (copied_from, copied)
        )

    def measure_stiffness(self, key_position: wp.array, key_count: int, choices: wp.array) -> wp.array:
        """What clusters would have with each stiffness; nothing is changed.

        Args:
            key_position: (V, B) blocks of points, the input on the key frames, in diagonals.
            key_count: key frames K in these.
            choices: (C, STEPS) float32 on the device, those to try.

        Returns:
            (C, 2 STEPS + 1) float32 on the device, sums over the key frames: area times squared distance from their
            planes, in diagonals^4; squared distance from where their vertex is in the mean, beside its anchor, in
            diagonals squared; and what the planes weigh, in diagonals squared.

        Raises:
            ValueError: more or fewer stiffnesses are given.
        """
        (count, steps), block_count = choices.shape, key_position.shape[1]
        if steps != int(kernels.STEPS):
            # The kernel would write past the end.
            raise ValueError(f"{steps} stiffnesses of each cluster, {int(kernels.STEPS)} are tried")
        sums = new_arrays.empty((count, 2 * steps + 1), dtype=wp.float32, device=self._device)
        at_once = max(1, MAX_MEASURED // max(1, block_count * steps))
        for first in range(0, count, at_once):
            part = sums if count <= at_once else sums[first : min(first + at_once, count)]
            self._sum_stiffness(key_position, key_count, choices, first, part)
        return sums

    def _sum_stiffness(
        self, key_position: wp.array, key_count: int, choices: wp.array, first: int, sums: wp.array
    ) -> None:
        """Bring what some clusters from the first on would have into sums (n, 2 STEPS + 1)."""
        count, block_count, device = len(sums), key_position.shape[1], self._device
        shape = (count, block_count, int(kernels.STEPS))
        errors, areas = (new_arrays.empty(size, dtype=wp.float32, device=device) for size in (shape, shape[:2]))
        offsets = new_arrays.empty(shape, dtype=wp.vec4, device=device)
        found = [rows_of(errors), rows_of(offsets), rows_of(areas)]
        launch_in_parts(
            kernels.measure_stiffness[width_of(key_position)],
            shape[:2],
            inputs=[
                key_position,
                self._corner_vertex,
                self._clusters,
                choices,
                PerPart(lambda part: first + part.start),
            ],
            outputs=found,
            device=device,
        )
        launch_in_parts(kernels.sum_stiffness, count, [*found, key_count], [rows_of(sums)], device=device)

    def set_stiffness(self, stiffness: wp.array) -> None:
        """Hold clusters to their anchors from now on with this stiffness (C,) float32, relative to their quadrics."""
        self._data.rows["stiffness"] = self._clusters.stiffness = stiffness

    def place(self, mesh: AnimatedMesh, points: wp.array, packed: wp.array | None = None) -> PlacedBlocks:
        """Place some frames of the mesh, given about its origin: (n, V) points on the device.

        ``packed`` is what :func:`pack_block` makes of them, where that is there already.
        """
        device, width, vertex_count = self._device, block_width(mesh.frame_count, self._device), self._data.vertex_count
        packed = pack_block(mesh, points, device) if packed is None else packed
        block_count = packed.shape[1]
        out = new_arrays.empty((vertex_count, block_count), dtype=packed.dtype, device=device)
        normal = new_arrays.like(out)
        launch_in_parts(
            kernels.place_vertices[width],
            (vertex_count, block_count),
            inputs=[packed, self._corner_vertex, self._clusters, FIRST_ITEM],
            outputs=[out, normal],
            device=device,
        )
        return PlacedBlocks(out, normal, points, self.copied_from, self.copied)
