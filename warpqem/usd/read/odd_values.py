"""Values that a mesh is done with, but that cannot be meant: named, so that nobody takes them for results.

Whatever decides the shape is refused elsewhere. Here is what only comes along, or what USD itself passes over.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
import numpy.typing as npt
from pxr import Sdf, Usd, UsdGeom, UsdSkel

from warpqem.usd.read.blend_shapes import shape_attributes
from warpqem.usd.read.descendants import subsets_of
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.value_arrays import element_size, reads_as_indices, sample_codes, to_numpy

__all__ = ["find_odd_values"]

# Weights as exporters round them, to eight bits, sum to one within this.
WEIGHT_TOLERANCE = 0.02


def find_odd_values(source: MeshSource) -> list[str]:
    """One line for each attribute with such values, with prim, attribute and time.

    Looked at are attributes of another type than the schema's, primvars whose elementSize or indices cannot be meant,
    primvars, normals, motion and blend shapes that are no finite numbers, names that the schema does not know, subsets
    of faces or points that do not exist, transforms that are not finite or flatten the mesh, joint weights that are no
    shares, and skeletons and animations whose arrays do not fit their joints.
    """
    mesh = source.mesh
    known = set(source.prim.GetPrimDefinition().GetPropertyNames())
    authored = [one for one in source.prim.GetAuthoredAttributes() if one.GetName() in known]
    found = [
        *_types(authored),
        *_primvar_layout(source),
        *_tokens(authored),
        *_subsets(mesh, source.topology.polygon_count, source.point_count),
        *_transform(source),
    ]
    attributes = [primvar.GetAttr() for primvar in UsdGeom.PrimvarsAPI(mesh).GetPrimvarsWithAuthoredValues()]
    attributes += [mesh.GetNormalsAttr(), mesh.GetVelocitiesAttr(), mesh.GetAccelerationsAttr()]
    for path in UsdSkel.BindingAPI(source.prim).GetBlendShapeTargetsRel().GetForwardedTargets():
        shape = UsdSkel.BlendShape(source.prim.GetStage().GetPrimAtPath(path))
        attributes += [attribute for attribute, _ in shape_attributes(shape) if attribute] if shape else []
    found += [text for text in map(_not_finite, attributes) if text is not None]
    if source.poser is not None:
        found += [*_weights(source.poser.skinning_query), *_skeleton(source.poser.skeleton_query)]
    return found


def _types(authored: Iterable[Usd.Attribute]) -> Iterator[str]:
    """Arrays of another type than the schema's, of attributes that it knows."""
    for attribute in authored:
        declared = attribute.GetTypeName()
        value = attribute.Get(Usd.TimeCode.EarliestTime()) if declared.isArray else None
        if value is None or type(value) is type(declared.defaultValue):
            continue
        yield f"{attribute.GetPath()}: {Sdf.GetValueTypeNameForValue(value)} in the file, taken as {declared}"


def _primvar_layout(source: MeshSource) -> Iterator[str]:
    for primvar in UsdGeom.PrimvarsAPI(source.prim).GetPrimvarsWithAuthoredValues():
        count = source.element_count(str(primvar.GetInterpolation()))
        size = element_size(primvar, count)
        if size != primvar.GetElementSize():
            yield f"{primvar.GetAttr().GetPath()}: elementSize {primvar.GetElementSize()} does not fit, taken as {size}"
        indices = primvar.GetIndicesAttr()
        if indices and indices.HasAuthoredValue() and not reads_as_indices(indices):
            yield f"{indices.GetPath()}: {indices.GetTypeName()}, where USD reads int[]"


def _not_finite(attribute: Usd.Attribute) -> str | None:
    for code in sample_codes(attribute):
        array = _numbers(attribute, code)
        if array is None:
            continue
        bad = np.flatnonzero(~np.isfinite(array.reshape(len(array), -1)).all(axis=1))
        if len(bad):
            value = array[bad[0]].tolist()
            return f"{attribute.GetPath()}: value {bad[0]} at time {_name(code)} is {value} ({len(bad)} such values)"
    return None


def _numbers(attribute: Usd.Attribute, code: Usd.TimeCode) -> npt.NDArray[np.floating] | None:
    array = to_numpy(attribute.Get(code))
    return array if array is not None and array.dtype.kind == "f" and len(array) else None


def _tokens(authored: Iterable[Usd.Attribute]) -> Iterator[str]:
    """Names that the schema does not know, such as an orientation "up": USD takes the default instead, or anything."""
    for attribute in authored:
        allowed = attribute.GetMetadata("allowedTokens")
        if not allowed:
            continue
        for code in sample_codes(attribute):
            value = attribute.Get(code)
            if value not in allowed:
                yield f"{attribute.GetPath()}: {value!r} at time {_name(code)} is none of {', '.join(allowed)}"
                break


def _subsets(mesh: UsdGeom.Mesh, polygon_count: int, point_count: int) -> Iterator[str]:
    counts = {UsdGeom.Tokens.face: polygon_count, UsdGeom.Tokens.point: point_count}
    for subset in subsets_of(mesh):
        kind = subset.GetElementTypeAttr().Get()
        if kind not in counts:
            continue
        count, attribute = counts[kind], subset.GetIndicesAttr()
        for code in sample_codes(attribute):
            indices = np.asarray(attribute.Get(code), dtype=np.int64)
            outside = indices[(indices < 0) | (indices >= count)]
            if len(outside):
                yield (
                    f"{attribute.GetPath()}: {kind} {outside[0]} at time {_name(code)} does not exist "
                    f"({count} {kind}s; {len(outside)} such entries)"
                )
                break
            if len(np.unique(indices)) < len(indices):
                yield f"{attribute.GetPath()}: names a {kind} twice at time {_name(code)}"
                break


def _transform(source: MeshSource) -> Iterator[str]:
    times = source.authored_times[:1]
    code = Usd.TimeCode(times[0]) if times else Usd.TimeCode.Default()
    matrix = UsdGeom.XformCache(code).GetLocalToWorldTransform(source.prim)
    if not np.isfinite(np.array(matrix)).all():
        yield f"{source.path}: its transform to the world at time {_name(code)} is not finite"
    elif matrix.GetDeterminant3() == 0.0:
        yield f"{source.path}: its transform to the world at time {_name(code)} flattens it"


def _weights(query: UsdSkel.SkinningQuery) -> Iterator[str]:
    primvar = query.GetJointWeightsPrimvar()
    if not query.HasJointInfluences() or not primvar:
        return
    for code in sample_codes(primvar.GetAttr()):
        values = to_numpy(primvar.ComputeFlattened(code), max(1, primvar.GetElementSize()))
        if values is None or not values.size:
            continue
        sums = values.reshape(len(values), -1).astype(np.float64).sum(axis=1)
        bad = np.flatnonzero(
            (np.abs(sums - 1.0) > WEIGHT_TOLERANCE) | (values.reshape(len(values), -1) < 0).any(axis=1)
        )
        if len(bad):
            yield (
                f"{primvar.GetAttr().GetPath()}: the weights of point {bad[0]} at time {_name(code)} are "
                f"{values[bad[0]].tolist()}, no shares of one ({len(bad)} such points)"
            )
            break


def _skeleton(query: UsdSkel.SkeletonQuery) -> Iterator[str]:
    skeleton = query.GetSkeleton()
    joints = skeleton.GetJointsAttr().Get() or []
    if len(set(joints)) < len(joints):
        yield f"{skeleton.GetJointsAttr().GetPath()}: names a joint twice"
    for attribute in (skeleton.GetBindTransformsAttr(), skeleton.GetRestTransformsAttr()):
        value = attribute.Get()
        if value is not None and len(value) != len(joints):
            yield f"{attribute.GetPath()}: {len(value)} matrices for {len(joints)} joints"
    animation_query = query.GetAnimQuery()
    animation = UsdSkel.Animation(animation_query.GetPrim()) if animation_query else None
    if not animation:
        return
    count = len(animation.GetJointsAttr().Get() or [])
    attributes = (animation.GetTranslationsAttr(), animation.GetRotationsAttr(), animation.GetScalesAttr())
    for attribute in attributes:
        for code in sample_codes(attribute):
            length = len(attribute.Get(code))
            if length != count:
                yield f"{attribute.GetPath()}: {length} values at time {_name(code)} for {count} joints"
                break


def _name(code: Usd.TimeCode) -> str:
    return "default" if code.IsDefault() else f"{code.GetValue():g}"
