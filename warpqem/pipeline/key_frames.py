"""Choose the frames that decide the order of collapses, and those in which its result is looked at."""

from __future__ import annotations

import numpy as np
import warp as wp

from warpqem.frames.device_frames import take_vertices
from warpqem.frames.stream import counted_frames
from warpqem.mesh.mesh_input import MeshInput

__all__ = ["MAX_LOOKED_FRAMES", "KeyFrameChoice", "looked_frames", "pose_bytes"]

# Poses are compared at about so many vertices, spread over the index range: enough to see every limb of a character.
SAMPLED_VERTICES = 1024
# Of long animations fewer vertices are kept, so that the poses take no more memory than this, but so many at least.
POSE_BYTES = 16 * 2**20
MIN_VERTICES = 64
# Distances are taken so many frames at a time, so that no second copy of all poses is made.
FRAMES_AT_ONCE = 256
# Before collapses are exchanged the surface is refitted in so many key frames at most, and looked at in so many frames:
# also in others, as what ordering has seen nothing of is where it is far from the input. With key frames alone, of 63
# cells one more has a largest distance 1.2 times that of others, and jitter is 1 % more, for a tenth less time.
MAX_FITTED_FRAMES = 16
MAX_LOOKED_FRAMES = 32


class KeyFrameChoice:
    """Farthest-point choice in pose space, starting with the first frame that counts.

    The distance of two frames is the RMS distance of corresponding vertices after their centroids are laid together,
    so that travelling through the scene is not taken for a change of pose. Some vertices of every frame are gathered
    while the frames are read.

    Args:
        mesh: the mesh; vertices without a face are not looked at.
        count: how many frames to choose, at least 1.
    """

    def __init__(self, mesh: MeshInput, count: int) -> None:
        # Where the source says which frames count, the others are no key frames.
        self._counted = np.flatnonzero(counted_frames(mesh.source))
        self._count = min(count, len(self._counted))
        used = np.flatnonzero(mesh.used)
        self._vertex = used[:: _step(mesh.frame_count, len(used))]
        self._all = self._count == len(self._counted)
        self._poses = np.empty((0 if self._all else mesh.frame_count, len(self._vertex), 3), dtype=np.float32)

    def observe(self, frames: slice, points: np.ndarray | wp.array) -> None:
        """Keep what distinguishes these frames (n, V, 3), or (n, V) points on a device, from others."""
        if not self._all:
            # Laid out alike for any number of frames, so that sums round alike: a vertex of all frames after another.
            pose = np.ascontiguousarray(self._sampled(points).transpose(1, 0, 2))
            pose -= pose.mean(axis=0)
            self._poses[frames] = pose.transpose(1, 0, 2)

    def _sampled(self, points: np.ndarray | wp.array) -> np.ndarray:
        """The vertices that poses are compared at, on the host: of frames on a device, no others come there."""
        if isinstance(points, np.ndarray):
            return np.take(points, self._vertex, axis=1)
        sampled: np.ndarray = take_vertices(
            points, wp.array(self._vertex, dtype=wp.int32, device=points.device)
        ).numpy()
        return sampled

    def choose(self) -> np.ndarray:
        """The key frames, (K,) int, ascending; fewer than asked for where poses repeat."""
        if self._all:
            return self._counted
        frame_count = len(self._poses)
        distance = np.full(frame_count, -np.inf)
        distance[self._counted] = np.inf
        chosen = [int(self._counted[0])]
        squares = np.empty_like(self._poses[:FRAMES_AT_ONCE])
        while len(chosen) < self._count:
            last = self._poses[chosen[-1]]
            for first in range(0, frame_count, FRAMES_AT_ONCE):
                block = slice(first, first + FRAMES_AT_ONCE)
                poses = self._poses[block]
                away = np.square(np.subtract(poses, last, out=squares[: len(poses)]), out=squares[: len(poses)])
                distance[block] = np.minimum(distance[block], away.sum(axis=(1, 2)))
            chosen.append(int(distance.argmax()))
        # A repeated frame (a still animation) adds nothing.
        return np.unique(chosen)


def looked_frames(key_frames: np.ndarray, counted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The frames that levels are looked at in, and the key frames among them that they are refitted in, both ascending.

    Args:
        key_frames: (K,) int, ascending.
        counted: int, all frames that count, ascending.
    """
    fitted = _spread(key_frames, MAX_FITTED_FRAMES)
    others = _spread(np.setdiff1d(counted, fitted), MAX_LOOKED_FRAMES - len(fitted))
    return np.union1d(fitted, others), fitted


def _spread(frames: np.ndarray, count: int) -> np.ndarray:
    """So many of some frames, evenly spread; all where there are fewer."""
    return frames[np.linspace(0, len(frames) - 1, min(count, len(frames))).astype(int)]


def pose_bytes(frame_count: int, vertex_count: int) -> int:
    """What the poses of all frames take."""
    return 12 * frame_count * -(-vertex_count // _step(frame_count, vertex_count))


def _step(frame_count: int, vertex_count: int) -> int:
    """Every so manieth vertex is kept; it depends on the mesh alone, so that memory never changes a result."""
    most = POSE_BYTES // (12 * frame_count)
    if most >= SAMPLED_VERTICES:
        return max(1, vertex_count // SAMPLED_VERTICES)
    return -(-vertex_count // max(MIN_VERTICES, most))
