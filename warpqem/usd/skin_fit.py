"""Fit the skin of a simplified mesh to its poses, see `warpqem.skinning.fit`."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from pxr import Usd

from warpqem.frame_blocks import frame_blocks
from warpqem.frame_stream import SomeFrames
from warpqem.key_frames import KeyFrameChoice
from warpqem.mesh_input import read_mesh
from warpqem.result import SimplifiedMesh
from warpqem.skinning.fit import fit_skin
from warpqem.skinning.skin import LinearSkin
from warpqem.usd.carrier import Carrier
from warpqem.usd.job import MeshJob
from warpqem.usd.mesh import MeshSource
from warpqem.usd.skin import Influences, Skin
from warpqem.usd.skin_output import blend_influences
from warpqem.usd.skin_poses import is_linear, joint_transforms, shape_offsets

__all__ = ["FittedMesh", "SkinFitter", "why_not_fitted"]

# Poses that a skin is fitted to at most, far apart. More of them changed nothing that could be measured.
MOST_POSES = 32


@dataclass(frozen=True)
class FittedMesh:
    """The skin of a simplified mesh.

    Attributes:
        rest_points: float32, shape (V', 3), in the space of the authored points.
        influences: of these points.
    """

    rest_points: npt.NDArray[np.float32]
    influences: Influences


def why_not_fitted(skin: Skin, poses: MeshSource) -> str | None:
    """Why the joint influences of a mesh cannot be fitted to its poses and are interpolated; None if they can be."""
    if poses.poser is None:
        return "no skeleton moves it"
    if not is_linear(poses.poser):
        return "its skinning is not linear"
    if len(skin.influences) > 1:
        return "its joint influences change over time"
    return None


class SkinFitter:
    """Fits rest points and joint influences to the poses of a mesh, or those of them that are farthest apart.

    As a `warpqem.FrameSink` it keeps the simplified points of these poses.

    Args:
        job: The mesh, whose skin can be fitted.
        poses: The mesh in the poses of `job`.
        times: Time codes of these poses; None for one at the default time.
    """

    def __init__(self, job: MeshJob, poses: MeshSource, times: list[float] | None) -> None:
        self._job, self._poses = job, poses
        chosen = _choose_poses(job)
        self._codes = [Usd.TimeCode.Default() if times is None else Usd.TimeCode(times[index]) for index in chosen]
        # The rest shape is the first frame.
        self._frames = np.concatenate([[0], job.pose_start + chosen])
        self._points = np.zeros((0, 0, 3), dtype=np.float32)

    def begin(self, frame_count: int, vertex_count: int, faces: npt.NDArray[np.int32]) -> None:
        """Make room for the points of the poses."""
        self._points = np.empty((len(self._frames), vertex_count, 3), dtype=np.float32)

    def write(self, frames: slice, points: npt.NDArray[np.float32]) -> None:
        """Keep those of the frames that are wanted."""
        first, last = np.searchsorted(self._frames, [frames.start, frames.stop])
        self._points[first:last] = points[self._frames[first:last] - frames.start]

    def fit(self, result: SimplifiedMesh, carrier: Carrier, refitted: bool, device: str | None) -> FittedMesh:
        """Fit the skin.

        Args:
            result: The simplified mesh, whose frames went through here.
            carrier: Where it gets its values from.
            refitted: Whether its surface was fitted as a whole, which the skin is then to follow.
            device: Warp device; None for the default.

        Raises:
            MeshShapeError: the poses are not what joints and blend shapes give.
        """
        job, skin, poser, fit = self._job, self._job.skin, self._poses.poser, self._job.rest_fit
        assert skin is not None
        assert poser is not None
        assert fit is not None
        point = np.empty(job.frames.vertex_count, dtype=np.int64)
        point[job.faces] = job.source.topology.triangles
        influences = next(iter(skin.influences.values()))
        rows = carrier.vertices()
        start = blend_influences(influences, rows, skin.influence_limit)
        offsets, start_offsets = shape_offsets(poser, skin.rest_points, self._codes), None
        if offsets is not None:
            # The rest shape is without them; frames are as large as the poses.
            offsets = np.concatenate([np.zeros_like(offsets[:1]), offsets]) * np.float32(fit.scale)
            start_offsets = np.stack([rows.blend(offset) for offset in offsets])
            offsets = offsets[:, point]
        transforms = fit.moved(joint_transforms(poser, self._codes))
        rest_transforms = np.broadcast_to(np.eye(4)[:3], transforms[:1].shape)
        poses = np.concatenate([job.frames.read(slice(frame, frame + 1)) for frame in self._frames.tolist()])
        fitted = fit_skin(
            poses,
            job.faces,
            replace(result, points=self._points),
            LinearSkin(poses[0], influences.joints[point], influences.weights[point]),
            np.concatenate([rest_transforms, transforms]),
            start=LinearSkin(self._points[0], start.joints, start.weights),
            influences=skin.influence_limit,
            offsets=offsets,
            start_offsets=start_offsets,
            seams=job.seams.hold(),
            to_planes=not refitted,
            device=device,
        )
        return FittedMesh(fit.undo(fitted.skin.rest), Influences(fitted.skin.joints, fitted.skin.weights))


def _choose_poses(job: MeshJob) -> npt.NDArray[np.int64]:
    poses = SomeFrames(job.frames, job.pose_start, job.frames.frame_count)
    choice = KeyFrameChoice(read_mesh(poses, job.faces), MOST_POSES)
    for block in frame_blocks(poses.frame_count, poses.vertex_count):
        choice.observe(block, poses.read(block))
    return choice.choose()
