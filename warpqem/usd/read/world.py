"""All meshes of a file as one, in world space, as a picture shows them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from pxr import Sdf, Usd, UsdGeom

from warpqem.errors import StageError, VaryingTopologyError
from warpqem.usd.read.open_stage import find_meshes, open_stage
from warpqem.usd.read.read_mesh import MeshSource, StageMesh
from warpqem.usd.read.skeleton_poses import StagePoses
from warpqem.usd.read.time_codes import FrameRange
from warpqem.usd.read.topology_runs import TopologyRun, find_runs, open_run

__all__ = ["WorldMeshes", "chosen_times"]


class WorldMeshes:
    """All meshes of one file in world space.

    Attributes:
        name: The file's name without its folder.
        stage: The file.
        left_out: Paths of meshes whose topology varies over time, where those are not wanted.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        prims: Sequence[str] = (),
        variant: tuple[Sdf.Path, str, str] | None = None,
        passing: Sequence[str] = (),
        varying: bool = False,
        stage: Usd.Stage | None = None,
    ) -> None:
        """Find the meshes.

        Args:
            path: USD file.
            prims: Prim paths; meshes at and below them are taken. Empty for all.
            variant: Prim path, name of a variant set and the variant to select there; None for what the file selects.
            passing: Prim paths of meshes that are left out, such as those that could not be simplified.
            varying: Take meshes whose topology varies over time too; then one time can be read at once.
            stage: The file, open already; None to open it.

        Raises:
            StageError: the file cannot be read, or has no mesh.
            VaryingTopologyError: the topology of all of its meshes varies, and those are not wanted.
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
        meshes = [_WorldMesh.of(prim, poses) for prim in found]
        self.left_out = [str(mesh.prim.GetPath()) for mesh in meshes if mesh.runs and not varying]
        self._meshes = [mesh for mesh in meshes if varying or not mesh.runs]
        if not self._meshes:
            raise VaryingTopologyError(
                f"{self.left_out[0]}: its topology varies over time; this shows meshes with one topology "
                "(warpqem render shows others)"
            )

    @property
    def times(self) -> list[float]:
        """Every time code at which a mesh has a sample."""
        return sorted({time for mesh in self._meshes for time in mesh.times})

    @property
    def point_count(self) -> int:
        """Points of all meshes; of one whose topology varies, at its first frame."""
        return sum(mesh.point_count for mesh in self._meshes)

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
        for item in self._meshes:
            mesh = item.read(times)
            if mesh is None:
                continue
            posed = np.repeat(mesh.points, len(times or [0]) // len(mesh.points), axis=0).astype(np.float64)
            for frame, time in enumerate(times or [None]):
                code = Usd.TimeCode.Default() if time is None else Usd.TimeCode(time)
                matrix = np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(item.prim))
                posed[frame] = posed[frame] @ matrix[:3, :3] + matrix[3, :3]
            points.append(posed)
            faces.append(mesh.right_handed_faces + count)
            count += posed.shape[1]
        if not points:
            return np.zeros((len(times or [0]), 0, 3), dtype=np.float32), np.zeros((0, 3), dtype=np.int32)
        return np.concatenate(points, axis=1).astype(np.float32), np.concatenate(faces).astype(np.int32)


@dataclass(frozen=True)
class _WorldMesh:
    """One mesh.

    Attributes:
        prim: Where it is.
        source: The mesh, if it has one topology.
        runs: Its runs of constant topology otherwise.
    """

    prim: Usd.Prim
    source: MeshSource | None
    runs: Sequence[TopologyRun]

    @classmethod
    def of(cls, prim: Usd.Prim, poses: StagePoses) -> _WorldMesh:
        try:
            return cls(prim, MeshSource(prim, poses), ())
        except VaryingTopologyError:
            if poses.poser(prim) is not None:
                raise
            return cls(prim, None, find_runs(UsdGeom.Mesh(prim)))

    @property
    def times(self) -> list[float]:
        if self.source is not None:
            return self.source.authored_times
        return [time for run in self.runs for time in run.times]

    @property
    def point_count(self) -> int:
        if self.source is not None:
            return self.source.point_count
        return len(UsdGeom.Mesh(self.prim).GetPointsAttr().Get(self.runs[0].times[0]) or ())

    def read(self, times: Sequence[float] | None) -> StageMesh | None:
        """The mesh at some times; None where it shows nothing."""
        if self.source is not None:
            return self.source.read(times if self.source.authored_times else None)
        if times is None or len(times) != 1:
            raise VaryingTopologyError(f"{self.prim.GetPath()}: its topology varies over time; one time can be read")
        run = next(run for run in self.runs if run.shows(times[0]))
        if run.is_empty:
            return None
        with open_run(self.prim, replace(run, times=tuple(times))) as alone:
            source = MeshSource(alone, StagePoses(alone.GetStage()))
            return source.read(times if source.authored_times else None)


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
