"""Poses that normals are fitted in: those that are written, or those that a skin is shown in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom, Vt

from warpqem.mesh.directions import unit_vectors
from warpqem.usd.read.shading_normals import skinned_normals
from warpqem.usd.read.skeleton_poses import MeshPoser
from warpqem.usd.write.attribute_transfer import AttributeTransfer

__all__ = ["NormalPose", "shown_poses", "written_poses"]

Points = npt.NDArray[np.float32]
Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class NormalPose:
    """Both meshes in one pose.

    Attributes:
        points: (V, 3), the input.
        placed: (V', 3), the output.
        shaped: (V', 3), the output before joints move it; ``placed`` without any.
        turn: (V', 3, 3) float64, what joints do to normals, as row vectors and up to their length; 0 where they leave
            no direction. None without any.
    """

    points: Points
    placed: Points
    shaped: Points
    turn: Floats | None = None

    def unturned(self, normals: Floats, vertex: npt.NDArray[np.int64]) -> Floats:
        """Unit normals (R, 3) in the pose at vertices (R,) as they are before joints turn them; 0 for none."""
        if self.turn is None:
            return normals
        turn = self.turn[vertex]
        known = np.abs(np.linalg.det(turn)) > SINGULAR
        found = np.zeros_like(normals)
        found[known] = np.linalg.solve(np.swapaxes(turn[known], 1, 2), normals[known][..., None])[..., 0]
        return unit_vectors(found)

    def turned(self, normals: Floats, vertex: npt.NDArray[np.int64]) -> Floats:
        """Unit normals (R, 3) at vertices (R,) as joints turn them into the pose."""
        return normals if self.turn is None else unit_vectors(np.einsum("rk,rkd->rd", normals, self.turn[vertex]))


# Determinants of a turn's unit rows below this leave no direction.
SINGULAR = 1e-4


def written_poses(
    mesh: UsdGeom.Mesh, transfer: AttributeTransfer, codes: Sequence[Usd.TimeCode], frames: Sequence[int]
) -> list[NormalPose]:
    """Some of the frames that are written at time codes."""
    poses = []
    for frame in frames:
        placed = np.asarray(mesh.GetPointsAttr().Get(codes[frame]), dtype=np.float32)
        poses.append(NormalPose(transfer.read_pose(frame), placed, placed))
    return poses


def shown_poses(
    mesh: UsdGeom.Mesh, transfer: AttributeTransfer, poser: MeshPoser, shown: Sequence[int]
) -> list[NormalPose]:
    """Some of the poses that a skin is shown in.

    Args:
        mesh: The simplified mesh, with its points and its skin.
        transfer: Where it gets its values from.
        poser: What deforms it.
        shown: Which of `AttributeTransfer.shown_codes`.

    Raises:
        StageError: UsdSkel cannot pose the mesh.
    """
    rest = mesh.GetPointsAttr().Get()
    poses = []
    for number in shown:
        code = transfer.shown_codes[number]
        turn = None
        if poser.skinning_query.HasJointInfluences():
            turn = _turn(poser, len(rest), code)
        shaped = poser.shaped(Vt.Vec3fArray(rest), code)
        poses.append(NormalPose(transfer.read_shown(number), poser.pose(rest, code), shaped, turn))
    return poses


def _turn(poser: MeshPoser, point_count: int, code: Usd.TimeCode) -> Floats:
    """What joints do to normals at all points, (V', 3, 3), up to a length of each.

    UsdSkel turns directions. Those of the axes and of their sum say how long the axes are relative to each other.
    """
    known = np.concatenate([np.eye(3), np.ones((1, 3))])
    normals = np.tile(known, (point_count, 1))
    turned = unit_vectors(skinned_normals(poser, normals, np.repeat(np.arange(point_count), 4), code))
    axes, total = turned.reshape(-1, 4, 3)[:, :3], turned.reshape(-1, 4, 3)[:, 3]
    turn = np.zeros_like(axes)
    usable = np.abs(np.linalg.det(axes)) > SINGULAR
    length = np.linalg.solve(np.swapaxes(axes[usable], 1, 2), total[usable][..., None])
    # As long as each other on average, so that the determinant says how flat they are.
    turn[usable] = axes[usable] * (length / np.abs(length).mean(axis=1, keepdims=True))
    return turn
