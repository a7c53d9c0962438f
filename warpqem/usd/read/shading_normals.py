"""Shading normals of a mesh in a pose: its own, turned by skin and blend shapes, or those of a smooth surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Gf, Usd, UsdGeom, UsdSkel, Vt

from warpqem.arguments.array_record import ArrayRecord
from warpqem.errors import StageError
from warpqem.mesh.smooth_normals import corner_groups, vertex_normals
from warpqem.picture.look import Look, corner_normals, smoothing_groups
from warpqem.usd.read.mesh_seams import crease_edges
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.skeleton_poses import MeshPoser
from warpqem.usd.read.surface_values import surface_values

__all__ = ["ShadedMesh", "shaded_mesh", "skinned_normals"]

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.integer]


@dataclass(frozen=True, eq=False, repr=False)
class ShadedMesh(ArrayRecord):
    """A mesh at one time, in local space.

    Attributes:
        points: (V, 3), those that a face uses.
        faces: (N, 3) int32, counter-clockwise seen from the front.
        normals: (N, 3, 3) shading normals at the corners, 0 for that of the face.
        look: its colours and textures.
    """

    points: npt.NDArray[np.floating]
    faces: npt.NDArray[np.int32]
    normals: npt.NDArray[np.floating]
    look: Look

    def moved(self, matrix: Floats, first: int) -> tuple[Floats, npt.NDArray[np.int32], Floats, Look]:
        """Points, faces, normals and look after a transform (4, 4) of rows; vertices are numbered from ``first`` on."""
        points = self.points.astype(np.float64) @ matrix[:3, :3] + matrix[3, :3]
        turned = _unit(self.normals @ np.array(_normal_matrix(Gf.Matrix4d(matrix))))
        return points, self.faces + np.int32(first), turned, self.look


def shaded_mesh(source: MeshSource, look: Look, time: float | None) -> ShadedMesh:
    """A mesh with its shading normals.

    Authored ones go before all others, and are turned as `UsdSkel.BakeSkinning` turns them: normal offsets of blend
    shapes first, then joints by the inverse transposes of their transforms. Without some, a subdivision surface is
    smooth but at its creases, and polygons are where they meet at less than 60 degrees.

    Args:
        source: The mesh.
        look: Its colours and textures at that time.
        time: Time code; None for the default time.

    Raises:
        StageError: points or skin cannot be read.
    """
    mesh = source.read([time] if time is not None and source.authored_times else None)
    points, faces = mesh.points[0], mesh.right_handed_faces
    values = surface_values(source, None if time is None else [time]).normals
    if values is not None:
        return ShadedMesh(points, faces, _posed_normals(source, values.at(0, len(faces), 3), time), look)
    if source.mesh.GetSubdivisionSchemeAttr().Get() == UsdGeom.Tokens.none:
        return ShadedMesh(points, faces, corner_normals(points, faces, smoothing_groups(points, faces)), look)
    creases = crease_edges(source, faces)
    group = corner_groups(faces, creases).astype(np.int32)
    _, corner = np.unique(group, return_index=True)
    return ShadedMesh(points, faces, vertex_normals(points[faces.ravel()[corner]], group)[group], look)


def _posed_normals(source: MeshSource, corners: Floats, time: float | None) -> Floats:
    """Authored normals (N, 3, 3) in a pose, of length one or 0."""
    if source.poser is None:
        return _unit(corners)
    code = Usd.TimeCode.Default() if time is None else Usd.TimeCode(time)
    point = source.topology.triangles
    point = point[:, ::-1] if source.left_handed else point
    shaped = corners + _normal_offsets(source.poser, source.point_count, code)[point]
    return _unit(skinned_normals(source.poser, shaped.reshape(-1, 3), point.ravel(), code)).reshape(corners.shape)


def _normal_offsets(poser: MeshPoser, point_count: int, code: Usd.TimeCode) -> Floats:
    """What blend shapes add to the normals at all points, (P, 3)."""
    total = np.zeros((point_count, 3))
    query = poser.blend_shape_query
    if query is None:
        return total
    weights = poser.skeleton_query.GetAnimQuery().ComputeBlendShapeWeights(code)
    mapper = poser.skinning_query.GetBlendShapeMapper()
    mapped = weights if mapper is None or weights is None else mapper.Remap(weights)
    if mapped is None:
        return total
    for weight, shape_index, sub_shape in zip(*query.ComputeSubShapeWeights(mapped), strict=True):
        inbetween = query.GetInbetween(sub_shape)
        shape = query.GetBlendShape(shape_index)
        attribute = inbetween.GetNormalOffsetsAttr() if inbetween else shape.GetNormalOffsetsAttr()
        offsets = attribute.Get() if attribute else None
        if offsets is None or not len(offsets) or not weight:
            continue
        indices = np.asarray(shape.GetPointIndicesAttr().Get() or range(point_count), dtype=np.int64)
        values = np.asarray(offsets, dtype=np.float64)
        if len(values) != len(indices) or indices.min() < 0 or indices.max() >= point_count:
            raise StageError(f"{attribute.GetPath()}: {len(values)} values do not fit the {point_count} points")
        np.add.at(total, indices, weight * values)
    return total


def skinned_normals(poser: MeshPoser, normals: Floats, point: Ints, code: Usd.TimeCode) -> Floats:
    """Normals (C, 3) at points (C,) turned by the joints, in the mesh's local space.

    Raises:
        StageError: UsdSkel cannot turn them.
    """
    query = poser.skinning_query
    if not query.HasJointInfluences():
        return normals
    transforms = poser.skeleton_query.ComputeSkinningTransforms(code)
    joints, weights = poser.influences(code)
    width = query.GetNumInfluencesPerComponent()
    rows = np.zeros_like(point) if query.IsRigidlyDeformed() else point
    turned = Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(normals, dtype=np.float32))
    known = transforms is not None and len(joints) == len(weights) >= width * (int(rows.max(initial=0)) + 1)
    done = known and UsdSkel.SkinNormals(
        query.GetSkinningMethod(),
        _normal_matrix(query.GetGeomBindTransform(code)),
        Vt.Matrix3dArray([_normal_matrix(matrix) for matrix in poser.ordered(transforms)]),
        _of_rows(joints, width, rows, np.int32),
        _of_rows(weights, width, rows, np.float32),
        width,
        turned,
    )
    if not done:
        raise StageError(
            f"{poser.prim.GetPath()}: UsdSkel cannot skin its normals at time {code} with skeleton "
            f"{poser.skeleton_query.GetPrim().GetPath()} (primvars:skel:jointIndices, jointWeights)"
        )
    cache = UsdGeom.XformCache(code)
    to_world = cache.GetLocalToWorldTransform(poser.skeleton_query.GetPrim())
    to_local = to_world * cache.GetLocalToWorldTransform(poser.prim).GetInverse()
    return np.asarray(turned, dtype=np.float64) @ np.array(_normal_matrix(to_local))


def _normal_matrix(matrix: Gf.Matrix4d) -> Gf.Matrix3d:
    """The inverse transpose, by which normals are turned; USD matrices act on row vectors."""
    turned: Gf.Matrix3d = matrix.ExtractRotationMatrix().GetInverse().GetTranspose()
    return turned


def _of_rows(values: object, width: int, rows: Ints, dtype: type) -> object:
    chosen: npt.NDArray[Any] = np.asarray(values).reshape(-1, width)[rows].astype(dtype).ravel()
    return Vt.IntArray.FromNumpy(chosen) if dtype is np.int32 else Vt.FloatArray.FromNumpy(chosen)


def _unit(vectors: Floats) -> Floats:
    """Vectors (..., 3) of length one; those without a finite length become 0, such as those that a joint flattens."""
    with np.errstate(invalid="ignore", over="ignore"):
        length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=(length > 0) & np.isfinite(length))
