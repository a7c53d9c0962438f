"""All meshes of a file as one, in world space, as a picture shows them."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from pxr import Sdf, Usd, UsdGeom

from warpqem.errors import StageError
from warpqem.usd.frames import FrameRange
from warpqem.usd.mesh import MeshSource
from warpqem.usd.skel import StagePoses
from warpqem.usd.stage import find_meshes, open_stage

__all__ = ["WorldMeshes", "chosen_times"]


class WorldMeshes:
    """All meshes of one file in world space.

    Attributes:
        name: The file's name without its folder.
        stage: The file.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        prims: Sequence[str] = (),
        variant: tuple[Sdf.Path, str, str] | None = None,
        passing: Sequence[str] = (),
        stage: Usd.Stage | None = None,
    ) -> None:
        """Find the meshes.

        Args:
            path: USD file.
            prims: Prim paths; meshes at and below them are taken. Empty for all.
            variant: Prim path, name of a variant set and the variant to select there; None for what the file selects.
            passing: Prim paths of meshes that are left out, such as those that could not be simplified.
            stage: The file, open already; None to open it.

        Raises:
            StageError: the file cannot be read, or has no mesh.
        """
        self.name = os.path.basename(os.fspath(path))
        self.stage: Usd.Stage = open_stage(path) if stage is None else stage
        if variant is not None:
            prim_path, variant_set, selection = variant
            # In the session layer, which is not part of the file.
            with Usd.EditContext(self.stage, self.stage.GetSessionLayer()):
                self.stage.GetPrimAtPath(prim_path).GetVariantSet(variant_set).SetVariantSelection(selection)
        found = [prim for prim in find_meshes(self.stage, prims).prims if str(prim.GetPath()) not in passing]
        if not found:
            raise StageError(f"{path}: there is no mesh on the stage")
        poses = StagePoses(self.stage)
        self._sources = [MeshSource(prim, poses) for prim in found]

    @property
    def times(self) -> list[float]:
        """Every time code at which a mesh has a sample."""
        return sorted({time for source in self._sources for time in source.authored_times})

    @property
    def point_count(self) -> int:
        """Points of all meshes."""
        return sum(source.point_count for source in self._sources)

    @property
    def up(self) -> str:
        """The up axis, "y" or "z"."""
        return "z" if UsdGeom.GetStageUpAxis(self.stage) == UsdGeom.Tokens.z else "y"

    def read(self, times: Sequence[float] | None) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.int32]]:
        """Points (F, V, 3) and counter-clockwise faces (N, 3) of all meshes as one.

        Raises:
            StageError: a mesh cannot be read at one of the times.
        """
        points, faces, count = [], [], 0
        for source in self._sources:
            own = None if not source.authored_times else times
            mesh = source.read(own)
            posed = np.repeat(mesh.points, len(times or [0]) // len(mesh.points), axis=0).astype(np.float64)
            for frame, time in enumerate(times or [None]):
                code = Usd.TimeCode.Default() if time is None else Usd.TimeCode(time)
                matrix = np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(source.prim))
                posed[frame] = posed[frame] @ matrix[:3, :3] + matrix[3, :3]
            points.append(posed)
            faces.append(mesh.right_handed_faces + count)
            count += posed.shape[1]
        return np.concatenate(points, axis=1).astype(np.float32), np.concatenate(faces).astype(np.int32)


def chosen_times(meshes: Sequence[WorldMeshes], frames: FrameRange | None = None) -> list[float]:
    """The time codes of all of them, within a range; empty where nothing moves.

    Raises:
        StageError: there is no sample in the range.
    """
    times = sorted({time for item in meshes for time in item.times})
    if frames is None:
        return times
    chosen = frames.select(times)
    if not chosen:
        raise StageError(f"no sample in the frame range {frames}")
    return chosen
