"""Feature points of a face that a user names: in a JSON file, as point subsets, or as primvars of the mesh."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom

from warpqem.errors import OptionError
from warpqem.face import FEATURE_NAMES, FaceProtection
from warpqem.face.feature_points import features_any_way
from warpqem.files.file_kinds import check_regular
from warpqem.mesh.mesh_input import read_mesh
from warpqem.usd.commands.mesh_job import MeshJob
from warpqem.usd.commands.simplify_options import SimplifyOptions
from warpqem.usd.read.read_mesh import MeshLayout, MeshSource, PoseFrames
from warpqem.usd.read.skeleton_poses import StagePoses
from warpqem.usd.write.feature_subsets import feature_primvars, feature_subsets

__all__ = ["FacePoints", "face_axes", "face_protection", "largest_mesh", "points_on_level"]


def face_axes(stage: Usd.Stage) -> tuple[str, str]:
    """The axes up and out of a face, by the stage's up axis."""
    return ("+z", "-y") if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z else ("+y", "+z")


def largest_mesh(prims: Sequence[Usd.Prim], poses: StagePoses) -> MeshSource:
    """The mesh with the most points, the first of equal ones: of several it is taken for the face."""
    return max((MeshSource(prim, poses) for prim in prims), key=lambda mesh: mesh.point_count)


@dataclass(frozen=True)
class FacePoints:
    """Points by name: a point's index in its mesh, or None for a point that the face does not have.

    Attributes:
        points: the points.
        prim: prim path of the mesh that they are of; None where that is not said.
        origin: where they come from, for errors.
    """

    points: dict[str, int | None] = field(default_factory=dict)
    prim: str | None = None
    origin: str = ""

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> FacePoints:
        """From a JSON file with a number, or null, for each point by name, or what `warpqem face detect` writes.

        Raises:
            OptionError: the file cannot be read, or holds something else.
        """
        check_regular(path, OptionError, f"points {os.fspath(path)}")
        try:
            value: Any = json.loads(Path(path).read_text("utf-8"))
        except (OSError, ValueError, RecursionError) as error:
            raise OptionError(f"points {path}: cannot be read ({error})") from error
        prim = value.get("prim") if isinstance(value, dict) and isinstance(value.get("points"), dict) else None
        value = value.get("points", value) if isinstance(value, dict) else None
        if not isinstance(value, dict):
            raise OptionError(f"points {path}: expected an object with points by name")
        found = {name: entry.get("point") if isinstance(entry, dict) else entry for name, entry in value.items()}
        for name, point in found.items():
            if point is not None and (isinstance(point, bool) or not isinstance(point, int)):
                raise OptionError(f"points {path}: {name} is {point!r}, expected a point's index or null")
        return cls(found, prim if isinstance(prim, str) else None, os.fspath(path))

    @classmethod
    def authored(cls, prim: Usd.Prim, strict: bool = True) -> FacePoints:
        """From the mesh: point subsets take precedence over primvars.

        Args:
            prim: The mesh.
            strict: Refuse what does not name a feature point; else leave it out, as it may mean something else.

        Raises:
            OptionError: a subset or primvar is not named after a feature point, or holds no point.
        """
        found: dict[str, int | None] = {}
        for name, primvar in feature_primvars(prim).items():
            value = primvar.Get(Usd.TimeCode.EarliestTime())
            if name in FEATURE_NAMES and isinstance(value, int) and not isinstance(value, bool):
                found[name] = value
            elif strict:
                raise OptionError(
                    f"{prim.GetPath()}.{primvar.GetAttr().GetName()}: expected the name of a feature point, and the "
                    f"index of the point, got {value!r}"
                )
        for name, subset in feature_subsets(prim).items():
            indices = subset.GetIndicesAttr().Get(Usd.TimeCode.EarliestTime())
            if name in FEATURE_NAMES and indices:
                found[name] = int(indices[0])
            elif strict:
                raise OptionError(f"{subset.GetPath()}: expected the name of a feature point, and the point")
        return cls(found, str(prim.GetPath()), str(prim.GetPath()))

    def on_one_of(self, prims: Sequence[Usd.Prim], poses: StagePoses) -> FacePoints:
        """The same as of one of these meshes: the one that is named, or the largest.

        Raises:
            OptionError: the one that is named is not among them.
        """
        if self.prim is None:
            return replace(self, prim=largest_mesh(prims, poses).path)
        if not any(str(prim.GetPath()) == self.prim for prim in prims):
            raise OptionError(f"points {self.origin}: there is no mesh {self.prim} among those to simplify")
        return self

    def over(self, others: FacePoints) -> FacePoints:
        """These, and of others those that these do not name."""
        return FacePoints({**others.points, **self.points}, self.prim, self.origin)

    def on_vertices(self, mesh: MeshLayout) -> dict[str, int | None]:
        """The vertices of a mesh by name; these are its points that a face uses.

        Raises:
            OptionError: there is no such point, or no such name.
        """
        found: dict[str, int | None] = {}
        for name, point in self.points.items():
            place = np.flatnonzero(mesh.used_points == point)
            if name not in FEATURE_NAMES:
                raise OptionError(
                    f"points of {self.origin}: there is no feature point {name!r}; there are {', '.join(FEATURE_NAMES)}"
                )
            if point is not None and not len(place):
                raise OptionError(f"feature point {name}: {mesh.path} has no point {point} in a face")
            found[name] = None if point is None else int(place[0])
        return found


def face_protection(job: MeshJob, options: SimplifyOptions, given: FacePoints) -> FaceProtection:
    """How the feature points of a mesh are kept: those that are given or authored, and the others as they are found.

    They are found on the points as they are authored, in the poses, as `warpqem face detect` does: where lips are cut
    apart, welding may have joined them.

    Raises:
        OptionError: a point that is given does not exist, or a weight or ring is out of range.
    """
    source, mesh = job.source, job.mesh
    points = given.over(FacePoints.authored(source.prim))
    overrides = points.on_vertices(mesh)
    poses = PoseFrames(source, mesh.times, mesh.used_points)
    found = features_any_way(read_mesh(poses, mesh.right_handed_faces), *face_axes(source.prim.GetStage()), overrides)
    return options.face_protection(found.moved(_vertex_of_used_point(job)))


def points_on_level(
    job: MeshJob, protection: FaceProtection | None, vertex_map: npt.NDArray[np.int32]
) -> dict[str, int]:
    """The points of a simplified mesh that the feature points have become, by name.

    Args:
        job: The mesh.
        protection: How its feature points were kept; None for another cost model: those that the mesh names itself.
        vertex_map: (V,) of the result.
    """
    if protection is not None and protection.features is not None:
        vertices = protection.features.vertices
    else:
        named, mesh = FacePoints.authored(job.source.prim, strict=False).points, job.mesh
        if not named:
            return {}
        vertex = _vertex_of_used_point(job)
        place = {name: np.flatnonzero(mesh.used_points == point) for name, point in named.items()}
        vertices = {name: int(vertex[found[0]]) for name, found in place.items() if len(found)}
    moved = {name: int(vertex_map[vertex]) for name, vertex in vertices.items()}
    return {name: vertex for name, vertex in moved.items() if vertex >= 0}


def _vertex_of_used_point(job: MeshJob) -> npt.NDArray[np.int64]:
    """The welded vertex of each point that a face uses."""
    vertex = np.empty(len(job.mesh.used_points), dtype=np.int64)
    vertex[job.mesh.faces] = job.faces
    return vertex
