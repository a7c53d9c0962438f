"""Look at the meshes of a stage without changing anything."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from pxr import Sdf, Tf, Usd, UsdGeom

from warpqem.errors import StageError, VaryingTopologyError, WarpqemError
from warpqem.files.outputs import OutputFile
from warpqem.measure import topology
from warpqem.repair.mended_mesh import face_repair
from warpqem.usd.checks.input_files import check_stage_outputs
from warpqem.usd.checks.usd_errors import usd_errors_named
from warpqem.usd.read.descendants import subsets_of
from warpqem.usd.read.open_stage import find_meshes, open_with_problems
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.skeleton_poses import StagePoses
from warpqem.usd.read.topology_runs import describe_runs, find_runs, open_run
from warpqem.usd.read.variants import select_variants

__all__ = ["MeshInfo", "inspect_stage"]

UV_TYPES = (
    Sdf.ValueTypeNames.TexCoord2fArray,
    Sdf.ValueTypeNames.TexCoord2dArray,
    Sdf.ValueTypeNames.TexCoord2hArray,
    Sdf.ValueTypeNames.Float2Array,
)


@dataclass
class MeshInfo:
    """What a mesh consists of.

    Attributes:
        path: Prim path.
        frames: Number of authored poses, 1 for a mesh that does not move.
        first_time: Time code of the first pose, None for a mesh that does not move.
        last_time: Time code of the last pose.
        vertices: Authored points.
        faces: Authored faces of any number of corners.
        triangles: Triangles that the faces are cut into.
        border_edges: Edges with one face.
        non_manifold_edges: Edges with more than two faces.
        joints: Joints that the mesh is bound to.
        blend_shapes: Blend shapes of the mesh.
        uv_sets: Names of the texture coordinate primvars.
        subsets: Names of the GeomSubsets.
        orientation: "rightHanded" or "leftHanded".
        subdivision: Subdivision scheme.
        runs: Runs of constant topology, 1 for a mesh with one topology. With more, the counts are those of the first.
        problems: What is wrong, or in the way of simplification, in words.
    """

    path: str
    frames: int = 0
    first_time: float | None = None
    last_time: float | None = None
    vertices: int = 0
    faces: int = 0
    triangles: int = 0
    border_edges: int = 0
    non_manifold_edges: int = 0
    joints: int = 0
    blend_shapes: int = 0
    uv_sets: list[str] = field(default_factory=list)
    subsets: list[str] = field(default_factory=list)
    orientation: str = ""
    subdivision: str = ""
    runs: int = 1
    problems: list[str] = field(default_factory=list)

    def to_dict(self) -> dict[str, Any]:
        """Plain dictionaries, lists, numbers and None, ready for JSON."""
        return asdict(self)


def inspect_stage(
    path: str | os.PathLike[str], other_outputs: Sequence[OutputFile] = (), variants: Sequence[str] = ()
) -> list[MeshInfo]:
    """Describe every mesh of a USD file, those without geometry last.

    Args:
        path: The file.
        other_outputs: What the caller is going to write; see `warpqem.usd.simplify_stage`.
        variants: Variants to look at, `SET=NAME` or `/Prim/Path{SET=NAME}`.

    Raises:
        StageError: the file cannot be read.
        OptionError: an output is a file that is read, or there is no such variant.

    Examples:
        >>> from warpqem.usd import inspect_stage
        >>> [mesh.path for mesh in inspect_stage("quadruped_gallop.usdc")]
        ['/Quadruped/Mesh']
    """
    return inspect_with_problems(path, other_outputs, variants)[0]


def inspect_with_problems(
    path: str | os.PathLike[str], other_outputs: Sequence[OutputFile] = (), variants: Sequence[str] = ()
) -> tuple[list[MeshInfo], list[str]]:
    """Describe every mesh of a USD file, and what is wrong with the files that it names; one line each.

    Raises:
        StageError, OptionError: see `inspect_stage`.
    """
    stage, problems = open_with_problems(path, prepare=lambda stage: select_variants([stage], variants))
    check_stage_outputs(other_outputs, [stage])
    with usd_errors_named(path, reading=True):
        poses = StagePoses(stage)
        selection = find_meshes(stage)
        infos = [_inspect_any(prim, poses) for prim in selection.prims]
    infos += [MeshInfo(mesh, problems=[f"no geometry: no value of {lacking}"]) for mesh, lacking in selection.empty]
    infos += [MeshInfo(proxy, problems=[str(error)]) for proxy, error in selection.refused]
    return infos, problems


def _inspect(prim: Usd.Prim, poses: StagePoses) -> MeshInfo:
    mesh = UsdGeom.Mesh(prim)
    info = MeshInfo(
        path=str(prim.GetPath()),
        uv_sets=[
            str(primvar.GetPrimvarName())
            for primvar in UsdGeom.PrimvarsAPI(prim).GetPrimvarsWithValues()
            if primvar.GetTypeName() in UV_TYPES
        ],
        subsets=[subset.GetPrim().GetName() for subset in subsets_of(mesh)],
        orientation=str(mesh.GetOrientationAttr().Get()),
        subdivision=str(mesh.GetSubdivisionSchemeAttr().Get()),
    )
    try:
        _inspect_constant(info, prim, poses)
    except VaryingTopologyError as error:
        if poses.poser(prim) is not None:
            info.problems.append(str(error))
        else:
            _inspect_runs(info, prim)
    except StageError as error:
        info.problems.append(str(error))
    return info


def _inspect_constant(info: MeshInfo, prim: Usd.Prim, poses: StagePoses) -> None:
    """Describe a mesh with one topology.

    Raises:
        VaryingTopologyError: it has several.
        StageError: its topology cannot be read.
    """
    source = MeshSource(prim, poses)
    problems: list[str] = []
    try:
        source.read(source.frame_times())
    except VaryingTopologyError:
        raise
    except StageError as error:
        problems.append(str(error))
    _describe_source(info, source)
    info.problems += problems
    _find_wrong_lengths(info, source)


def _inspect_runs(info: MeshInfo, prim: Usd.Prim) -> None:
    """Describe a mesh whose topology varies over time by its first run that shows something."""
    mesh = UsdGeom.Mesh(prim)
    runs = find_runs(mesh)
    shown = next((run for run in runs if not run.is_empty), runs[0])
    if not shown.is_empty:
        with open_run(prim, shown) as alone:
            _inspect_constant(info, alone, StagePoses(alone.GetStage()))
    info.frames = sum(len(run.times) for run in runs)
    info.first_time, info.last_time = runs[0].times[0], runs[-1].times[-1]
    info.runs = len(runs)
    if info.runs > 1:
        info.problems.insert(0, f"{describe_runs(mesh, runs)}; the figures are those of {shown}")


def _inspect_any(prim: Usd.Prim, poses: StagePoses) -> MeshInfo:
    """The same, also where that fails in a way that is not foreseen: the other meshes have no part in it."""
    try:
        return _inspect(prim, poses)
    except (WarpqemError, MemoryError, Tf.ErrorException):
        raise
    except Exception as error:
        what = " ".join(f"{type(error).__name__}: {error}".split())
        return MeshInfo(str(prim.GetPath()), problems=[f"{prim.GetPath()}: unexpected error while reading it: {what}"])


def _describe_source(info: MeshInfo, source: MeshSource) -> None:
    times = source.authored_times
    info.frames = max(len(times), 1)
    info.first_time, info.last_time = (times[0], times[-1]) if times else (None, None)
    info.vertices = source.point_count
    info.faces = source.topology.polygon_count
    info.triangles = len(source.topology.triangles)
    if source.poser is not None:
        info.joints, info.blend_shapes = source.poser.joint_count, source.poser.blend_shape_count
    elif source.prim.HasAttribute("primvars:skel:jointIndices"):
        info.problems.append("joint influences without a skeleton that they reach (not below a SkelRoot, or not bound)")
    counts = {
        "triangles that name a point twice": source.topology.degenerate_count,
        "faces marked as holes": source.topology.hole_count,
        "points that no face uses": source.point_count - len(np.unique(source.topology.triangles)),
    }
    if info.triangles:
        figures = topology(source.topology.triangles)
        info.border_edges, info.non_manifold_edges = figures.border_edges, figures.non_manifold_edges
        counts["non-manifold vertices"] = figures.non_manifold_vertices
        counts["triangles that repeat another"] = figures.repeated_faces
        repair = face_repair(source.topology.triangles, source.point_count)
        if repair is not None:
            counts["triangles wound unlike most around them"] = repair.findings.turned_faces
    else:
        info.problems.append("no faces")
    info.problems += [f"{what}: {count}" for what, count in counts.items() if count]


def _find_wrong_lengths(info: MeshInfo, source: MeshSource) -> None:
    """Note primvars whose length does not fit their interpolation; renderers differ in how they read them."""
    corner_count = len(source.mesh.GetFaceVertexIndicesAttr().Get(Usd.TimeCode.EarliestTime()))
    expected = {
        UsdGeom.Tokens.vertex: source.point_count,
        UsdGeom.Tokens.varying: source.point_count,
        UsdGeom.Tokens.faceVarying: corner_count,
        UsdGeom.Tokens.uniform: source.topology.polygon_count,
    }
    for primvar in UsdGeom.PrimvarsAPI(source.prim).GetPrimvarsWithValues():
        count = expected.get(primvar.GetInterpolation())
        value = (
            primvar.GetIndices(Usd.TimeCode.EarliestTime())
            if primvar.IsIndexed()
            else primvar.Get(Usd.TimeCode.EarliestTime())
        )
        if count is None or value is None or not hasattr(value, "__len__"):
            continue
        size = primvar.GetElementSize()
        if size < 1:
            info.problems.append(f"primvars:{primvar.GetPrimvarName()}: elementSize {size}")
            continue
        length = len(value) // size
        if length != count:
            info.problems.append(
                f"primvars:{primvar.GetPrimvarName()}: {length} values, {count} expected ({primvar.GetInterpolation()})"
            )
