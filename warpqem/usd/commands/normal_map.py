"""Bake a normal map for a mesh that has been simplified: what the input shades with, on the new texture coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom

from warpqem.errors import StageError, WarpqemError
from warpqem.measure.surface_values import SurfaceValues
from warpqem.mesh.components import lowest_members
from warpqem.mesh.directions import unit_vectors
from warpqem.normal_maps.bake import BakeSurface, bake_normals, overlap_share
from warpqem.pipeline.result import SimplifiedMesh
from warpqem.runtime.device import resolve_device
from warpqem.usd.commands.measuring import written_source
from warpqem.usd.commands.mesh_job import MeshJob
from warpqem.usd.read.normal_textures import NormalTextures, face_owners, mapped_normals
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.surface_values import surface_values
from warpqem.usd.write.attribute_transfer import AttributeTransfer
from warpqem.usd.write.fitted_normals import smooth_input_normals
from warpqem.usd.write.normal_map_material import add_normal_map, check_material, uv_name_of
from warpqem.usd.write.smooth_normals import has_normals, is_shaded_by_subdivision
from warpqem.usd.write.stage_report import PrimReport
from warpqem.usd.write.write import OverLayer

__all__ = ["bake_mesh_normals"]

Floats = npt.NDArray[np.float64]

# Part of the texels that may be under two triangles: where islands touch, and where a coarser outline cuts a corner.
MAX_OVERLAP = 0.01
# Coordinates are in the square if they leave it by no more than this, in texels.
MAX_BEYOND = 0.5


@dataclass(frozen=True)
class _Group:
    """Faces that are to have one map.

    Attributes:
        owners: The mesh, or those of its subsets, whose materials the faces have.
        faces: (N',) bool.
        uv_name: The texture coordinates that their materials use.
    """

    owners: Sequence[Usd.Prim]
    faces: npt.NDArray[np.bool_]
    uv_name: str


def bake_mesh_normals(
    job: MeshJob,
    mesh: SimplifiedMesh,
    transfer: AttributeTransfer,
    layer: OverLayer,
    report: PrimReport,
    size: int,
    device: str | None,
) -> None:
    """Bake the maps of a mesh that has been written, and give it materials with them.

    Where that cannot be, the mesh and its materials stay as they are, and the report says why.

    Args:
        job: The mesh as it was read.
        mesh: What came of it.
        transfer: Where its values come from.
        layer: The edits, which the mesh is in.
        report: Gets a note for each map.
        size: Texels across a map.
        device: Warp device; None for the default.
    """
    path, device = job.mesh.path, resolve_device(device)
    try:
        written = written_source(layer.stage, job)
        times = None if job.written_times is None else job.written_times[:1]
        values = surface_values(written, times)
        groups = _groups(written, values)
        output = _output_surface(written, values, job, mesh, times)
        source = _input_surface(job, transfer)
        for group in _joined_groups(groups, values, size, device):
            _bake_group(group, layer, written, output, source, values, report, size, device)
    except WarpqemError as error:
        report.problems.append(f"{path}: no normal map: {str(error).removeprefix(f'{path}: ')}")


def _groups(written: MeshSource, values: SurfaceValues) -> list[_Group]:
    """The faces of each material.

    Raises:
        StageError: no map can be added to one, or there are no texture coordinates.
    """
    groups = []
    polygons = written.topology.triangle_polygons
    for owner, owned in face_owners(written.mesh, written.topology.polygon_count):
        if owned.any():
            check_material(owner)
            groups.append(_Group([owner], owned[polygons], uv_name_of(owner, list(values.uvs))))
    for group in groups:
        if group.uv_name not in values.uvs:
            raise StageError(values.unusable.get(group.uv_name, "it has no texture coordinates"))
    return groups


def _joined_groups(groups: Sequence[_Group], values: SurfaceValues, size: int, device: str) -> list[_Group]:
    """Groups of faces that have a map each: one for all with the same coordinates, where these do not overlap.

    Raises:
        StageError: those of one group overlap, or are outside of the square of the texture.
    """
    joined = []
    for name in dict.fromkeys(group.uv_name for group in groups):
        same = [group for group in groups if group.uv_name == name]
        whole = _Group([owner for one in same for owner in one.owners], sum_of(same), name)
        problem = _problem(whole, values, size, device)
        if problem is None:
            joined.append(whole)
            continue
        problems = [problem if len(same) == 1 else _problem(group, values, size, device) for group in same]
        if any(problems):
            raise StageError(next(text for text in problems if text))
        joined += same
    return joined


def sum_of(groups: Sequence[_Group]) -> npt.NDArray[np.bool_]:
    """The faces of several groups."""
    return np.any([group.faces for group in groups], axis=0)


def _problem(group: _Group, values: SurfaceValues, size: int, device: str) -> str | None:
    """Why no map can lie on the texture coordinates of some faces; None where one can."""
    uvs = _uvs(group, values)
    low, high = uvs.reshape(-1, 2).min(axis=0), uvs.reshape(-1, 2).max(axis=0)
    if (low < -MAX_BEYOND / size).any() or (high > 1.0 + MAX_BEYOND / size).any():
        return (
            f"primvars:{group.uv_name} is not within 0 and 1, but from ({low[0]:.4g}, {low[1]:.4g}) to "
            f"({high[0]:.4g}, {high[1]:.4g})"
        )
    edge, other = uvs[:, 1] - uvs[:, 0], uvs[:, 2] - uvs[:, 0]
    if not (edge[:, 0] * other[:, 1] != edge[:, 1] * other[:, 0]).any():
        return f"primvars:{group.uv_name} gives no face an area in the texture"
    share = overlap_share(uvs, size, device=device)
    if share > MAX_OVERLAP:
        return f"primvars:{group.uv_name} overlaps on {100 * share:.3g} % of its texels"
    return None


def _uvs(group: _Group, values: SurfaceValues) -> Floats:
    count = len(group.faces)
    return values.uvs[group.uv_name].at(0, count, 2)[group.faces]


def _bake_group(
    group: _Group,
    layer: OverLayer,
    written: MeshSource,
    output: BakeSurface,
    source: BakeSurface,
    values: SurfaceValues,
    report: PrimReport,
    size: int,
    device: str,
) -> None:
    here = replace(
        output,
        corners=output.corners[group.faces],
        normals=output.normals[group.faces],
        part=output.part[group.faces],
        uvs=_uvs(group, values),
    )
    baked = bake_normals(here, source, size, device=device)
    prim, stage = written.prim, layer.stage
    start = prim.GetName()
    if group.owners[0] != prim:
        start += f"_{group.owners[0].GetName()}"
    file = layer.maps.add(f"{start}_normal", baked.pixels)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(prim.GetPath()))
    for owner in group.owners:
        add_normal_map(mesh, owner, file, group.uv_name)
    share = 100 * baked.filled.mean()
    report.notes.append(f"{report.path}: normal map of {size} x {size} texels, {share:.3g} % of them in use")


def _output_surface(
    written: MeshSource, values: SurfaceValues, job: MeshJob, mesh: SimplifiedMesh, times: list[float] | None
) -> BakeSurface:
    """The mesh as it is written, in the pose that it is written in first."""
    code = Usd.TimeCode.Default() if times is None else Usd.TimeCode(times[0])
    points = np.asarray(written.mesh.GetPointsAttr().Get(code), dtype=np.float64)
    faces = written.topology.triangles
    corners = points[faces[:, ::-1] if written.left_handed else faces]
    part = _parts(job)[job.faces[mesh.face_map][:, 0]]
    return BakeSurface(corners, _or_faceted(values, corners), part)


def _input_surface(job: MeshJob, transfer: AttributeTransfer) -> BakeSurface:
    """The input in the same pose, with the normals that it shades with there."""
    pose, faces, source = transfer.read_pose(0), transfer.input_faces, job.source
    turned = faces[:, ::-1] if source.left_handed else faces
    corners = pose.astype(np.float64)[turned]
    values = surface_values(source, None if job.written_times is None else job.written_times[:1])
    normals = _or_faceted(values, corners)
    is_posed = job.skin is None and source.has_skin_binding and has_normals(source.prim)
    if is_posed or is_shaded_by_subdivision(source.mesh) or (transfer.shades_all and not has_normals(source.prim)):
        # Those of the rest shape fit no pose.
        outward = -1.0 if source.left_handed else 1.0
        smooth = smooth_input_normals(transfer, pose, outward)
        normals = smooth[:, ::-1] if source.left_handed else smooth
    mapped = mapped_normals(source, values, normals, NormalTextures())
    return BakeSurface(corners, normals, _parts(job)[faces[:, 0]], mapped=mapped)


def _parts(job: MeshJob) -> npt.NDArray[np.int64]:
    """The connected component of each vertex, by number."""
    edges = np.concatenate([job.faces[:, :2], job.faces[:, 1:]])
    found: npt.NDArray[np.int64] = lowest_members(int(job.faces.max()) + 1, edges)
    return found


def _or_faceted(values: SurfaceValues, corners: Floats) -> Floats:
    """Unit normals (N, 3, 3) of a mesh; those of its faces where it has none."""
    edge, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    flat: Floats = np.broadcast_to(unit_vectors(np.cross(edge, other))[:, None], corners.shape)
    if values.normals is None:
        return flat
    given = unit_vectors(values.normals.at(0, len(corners), 3))
    return np.where(given.any(axis=2, keepdims=True), given, flat)
