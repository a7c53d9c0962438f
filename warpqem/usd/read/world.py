"""All meshes of a file as one, in world space, as a picture shows them."""

from __future__ import annotations

import os
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from pxr import Sdf, Usd, UsdGeom

from warpqem.errors import StageError, VaryingTopologyError
from warpqem.picture.images import PosedMesh
from warpqem.picture.look import Look, joined, plain_look
from warpqem.usd.read.materials import Materials
from warpqem.usd.read.mesh_look import mesh_look
from warpqem.usd.read.normal_textures import NormalTextures
from warpqem.usd.read.open_stage import find_meshes, open_stage
from warpqem.usd.read.read_mesh import MeshSource, StageMesh
from warpqem.usd.read.shading_normals import ShadedMesh, shaded_mesh
from warpqem.usd.read.skeleton_poses import StagePoses
from warpqem.usd.read.time_codes import FrameRange
from warpqem.usd.read.topology_runs import TopologyRun, find_runs, open_run

__all__ = ["WorldMeshes", "chosen_times", "limit_places", "longest_run"]

# Instances may show a mesh a million times: with so many points of all files together (96 MB a frame in float64), each
# mesh is drawn at one place only.
MAX_POINTS = 4_000_000


class WorldMeshes:
    """All meshes of one file in world space.

    Attributes:
        name: The file's name without its folder.
        stage: The file.
        left_out: Paths of meshes whose topology varies over time, where those are not wanted and there are others.
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
            varying: Take meshes whose topology varies over time too, not only where there are no others. Times within
                one run of constant topology can be read at once.
            stage: The file, open already; None to open it.

        Raises:
            StageError: the file cannot be read, or has no mesh.
        """
        self.name = os.path.basename(os.fspath(path))
        self.stage: Usd.Stage = open_stage(path) if stage is None else stage
        if variant is not None:
            prim_path, variant_set, variant_name = variant
            # In the session layer, which is not part of the file.
            with Usd.EditContext(self.stage, self.stage.GetSessionLayer()):
                self.stage.GetPrimAtPath(prim_path).GetVariantSet(variant_set).SetVariantSelection(variant_name)
        selection = find_meshes(self.stage, prims)
        poses = StagePoses(self.stage)
        meshes = []
        for prim in selection.prims:
            places = [place for place, shown in selection.places.items() if shown == prim.GetPath()]
            if not {str(prim.GetPath()), *map(str, places)} & set(passing):
                meshes.append(_WorldMesh.of(prim, poses, places))
        if not meshes:
            raise StageError(f"{path}: there is no mesh on the stage")
        varying = varying or all(mesh.runs for mesh in meshes)
        self.left_out = [str(mesh.prim.GetPath()) for mesh in meshes if mesh.runs and not varying]
        self._meshes = [mesh for mesh in meshes if varying or not mesh.runs]

    @property
    def changes(self) -> list[float]:
        """Time codes at which the topology of a mesh changes, ascending."""
        return sorted({run.start for mesh in self._meshes for run in mesh.runs[1:]})

    def shows_at(self, time: float) -> bool:
        """Whether a mesh has anything to show at a time."""
        return any(not mesh.runs or not mesh.run_at(time).is_empty for mesh in self._meshes)

    @property
    def times(self) -> list[float]:
        """Every time code at which a mesh has a sample."""
        return sorted({time for mesh in self._meshes for time in mesh.times})

    @property
    def point_count(self) -> int:
        """Points of all meshes wherever they show; of one whose topology varies, at its first frame."""
        return sum(mesh.point_count for mesh in self._meshes)

    @property
    def up(self) -> str:
        """The up axis, "y" or "z"."""
        return "z" if UsdGeom.GetStageUpAxis(self.stage) == UsdGeom.Tokens.z else "y"

    @property
    def first_places(self) -> list[Sdf.Path]:
        """One path for each mesh, the first at which the stage shows it."""
        return [mesh.places[0] for mesh in self._meshes]

    @property
    def sources(self) -> list[MeshSource]:
        """The meshes with one topology."""
        return [mesh.source for mesh in self._meshes if mesh.source is not None]

    def show_only(self, places: Sequence[Sdf.Path]) -> None:
        """Leave meshes out of all other paths; one that is at none of these is left at its first."""
        wanted = set(places)
        self._meshes = [
            replace(mesh, places=[place for place in mesh.places if place in wanted] or mesh.places[:1])
            for mesh in self._meshes
        ]

    def read(self, times: Sequence[float] | None) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.int32]]:
        """Points (F, V, 3) and counter-clockwise faces (N, 3) of all meshes as one.

        Raises:
            StageError: a mesh cannot be read at one of the times.
            VaryingTopologyError: the topology of a mesh changes between them.
        """
        points, faces, count = [], [], 0
        for item in self._meshes:
            mesh = item.read(times)
            if mesh is None:
                continue
            posed = np.repeat(mesh.points, len(times or [0]) // len(mesh.points), axis=0).astype(np.float64)
            for place in item.places:
                points.append(self._in_world(posed, place, times))
                faces.append(mesh.right_handed_faces + count)
                count += posed.shape[1]
        if not points:
            return np.zeros((len(times or [0]), 0, 3), dtype=np.float32), np.zeros((0, 3), dtype=np.int32)
        return np.concatenate(points, axis=1).astype(np.float32), np.concatenate(faces).astype(np.int32)

    def look(self, times: Sequence[float] | None, materials: Materials, textures: NormalTextures | None = None) -> Look:
        """What the meshes look like at the first of some times, face by face as `read` has them.

        Parts are named by the path at which a mesh shows. Normal maps are left out without what was read of them.
        """
        looks = []
        for item in self._meshes:
            found = item.look(times, materials, textures)
            if found is not None:
                looks += [
                    replace(found, parts=[replace(part, name=str(place)) for part in found.parts])
                    for place in item.places
                ]
        return joined(looks)

    def shown(self, time: float | None, materials: Materials, textures: NormalTextures) -> PosedMesh:
        """What of the meshes is visible at a time as one mesh, with shading normals and normal maps.

        Raises:
            StageError: a mesh cannot be read.
        """
        code = Usd.TimeCode.Default() if time is None else Usd.TimeCode(time)
        meshes, count = [], 0
        for item in self._meshes:
            prims = [self.stage.GetPrimAtPath(place) for place in item.places]
            seen = [prim for prim in prims if UsdGeom.Imageable(prim).ComputeVisibility(code) != "invisible"]
            found = item.posed(time, materials, textures) if seen else None
            if found is None:
                continue
            for prim in seen:
                meshes.append(found.moved(np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(prim)), count))
                count += len(found.points)
        if not meshes:
            return PosedMesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int32))
        points, faces, normals = (np.concatenate(part) for part in zip(*(mesh[:3] for mesh in meshes), strict=True))
        return PosedMesh(points, faces, normals, joined([look for *_, look in meshes]))

    def _in_world(
        self, points: npt.NDArray[np.float64], place: Sdf.Path, times: Sequence[float] | None
    ) -> npt.NDArray[np.float64]:
        """Points (F, V, 3) of a mesh where the stage shows it."""
        moved = np.empty_like(points)
        for frame, time in enumerate(times or [None]):
            code = Usd.TimeCode.Default() if time is None else Usd.TimeCode(time)
            matrix = np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(self.stage.GetPrimAtPath(place)))
            moved[frame] = points[frame] @ matrix[:3, :3] + matrix[3, :3]
        return moved


@dataclass(frozen=True)
class _WorldMesh:
    """One mesh.

    Attributes:
        prim: Where it is defined.
        places: Paths at which the stage shows it: that of the prim, or those of instances of it.
        source: The mesh, if it has one topology.
        runs: Its runs of constant topology otherwise.
    """

    prim: Usd.Prim
    places: Sequence[Sdf.Path]
    source: MeshSource | None
    runs: Sequence[TopologyRun]

    @classmethod
    def of(cls, prim: Usd.Prim, poses: StagePoses, places: Sequence[Sdf.Path]) -> _WorldMesh:
        try:
            return cls(prim, places, MeshSource(prim, poses), ())
        except VaryingTopologyError:
            if poses.poser(prim) is not None:
                raise
            return cls(prim, places, None, find_runs(UsdGeom.Mesh(prim)))

    @property
    def times(self) -> list[float]:
        if self.source is not None:
            return self.source.authored_times
        return [time for run in self.runs for time in run.times]

    @property
    def point_count(self) -> int:
        if self.source is not None:
            return self.source.point_count * len(self.places)
        return len(UsdGeom.Mesh(self.prim).GetPointsAttr().Get(self.runs[0].times[0]) or ()) * len(self.places)

    def run_at(self, time: float) -> TopologyRun:
        """The run that a mesh whose topology varies shows at a time."""
        return next(run for run in self.runs if run.shows(time))

    def look(self, times: Sequence[float] | None, materials: Materials, textures: NormalTextures | None) -> Look | None:
        """What the mesh looks like; None where it shows nothing."""
        if self.source is not None:
            return mesh_look(self.source, materials, times[0] if times else None, textures)
        # A run is opened in a stage of its own, without what is bound to the mesh.
        mesh = self.read(times)
        return None if mesh is None else plain_look(len(mesh.faces))

    def posed(self, time: float | None, materials: Materials, textures: NormalTextures) -> ShadedMesh | None:
        """The mesh at a time with its shading normals, in local space; None where it shows nothing."""
        if self.source is not None:
            if not len(self.source.topology.triangles):
                return None
            return shaded_mesh(self.source, mesh_look(self.source, materials, time, textures), time)
        with self._opened(None if time is None else [time]) as source:
            if source is None:
                return None
            return shaded_mesh(source, plain_look(len(source.topology.triangles)), time)

    def read(self, times: Sequence[float] | None) -> StageMesh | None:
        """The mesh at some times; None where it shows nothing."""
        with self._opened(times) as source:
            return None if source is None else source.read(times if source.authored_times else None)

    @contextmanager
    def _opened(self, times: Sequence[float] | None) -> Iterator[MeshSource | None]:
        """The mesh with the topology of some times; None where it shows nothing."""
        if self.source is not None:
            yield self.source
            return
        run = self.run_at(times[0]) if times else None
        if run is None or times is None or not all(run.shows(time) for time in times):
            raise VaryingTopologyError(f"{self.prim.GetPath()}: its topology varies over time; one run can be read")
        if run.is_empty:
            yield None
            return
        with open_run(self.prim, replace(run, times=tuple(times))) as alone:
            yield MeshSource(alone, StagePoses(alone.GetStage()))


def limit_places(meshes: Sequence[WorldMeshes]) -> bool:
    """Where instances show more points than can be drawn, leave each mesh at one place, the same in all files.

    Returns:
        Whether anything was left out.
    """
    if sum(item.point_count for item in meshes) <= MAX_POINTS:
        return False
    places = meshes[0].first_places
    counts = [item.point_count for item in meshes]
    for item in meshes:
        item.show_only(places)
    return counts != [item.point_count for item in meshes]


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


def longest_run(meshes: Sequence[WorldMeshes], times: Sequence[float]) -> list[float]:
    """The most times in a row between which no topology changes and all files show something, the first of as many.

    Raises:
        StageError: at no time all of them show something.
    """
    changes = sorted({time for item in meshes for time in item.changes})
    runs: dict[int, list[float]] = {}
    for time in times:
        if all(item.shows_at(time) for item in meshes):
            runs.setdefault(bisect_right(changes, time), []).append(time)
    if not runs:
        raise StageError(f"{meshes[0].name}: at no time there is anything to show in all files")
    return max(runs.values(), key=len)
