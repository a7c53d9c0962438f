"""What the tests of whole USD files check: every property against the input, lengths, ranges, time samples."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdSkel

from warpqem.usd.checks.input_check import check_composition

# Composition, which the comparison of composed stages looks through, and what flattening resolves.
ARCS = {
    "active", "apiSchemas", "clips", "clipSets", "inheritPaths", "instanceable", "payload", "references", "specializes",
    "specifier", "typeName", "variantSelection", "variantSetNames", "default", "timeSamples", "targetPaths",
    "connectionPaths",
}  # fmt: skip

Verdicts = dict[str, str]


def all_prims(stage: Usd.Stage) -> Iterable[Usd.Prim]:
    """Every prim, also classes, overs, inactive ones and what is below instances."""
    return Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies(Usd.PrimAllPrimsPredicate))


def plain(value: Any) -> Any:
    """A value that compares by its content; asset paths by the file they find."""
    if isinstance(value, Sdf.AssetPath):
        return value.resolvedPath or value.path
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if hasattr(value, "__len__") and not isinstance(value, str):
        return [plain(item) for item in value]
    return str(value) if value is not None else None


def metadata(item: Usd.Object) -> dict[str, Any]:
    return {key: plain(value) for key, value in item.GetAllAuthoredMetadata().items() if key not in ARCS}


def content(prop: Usd.Property) -> Any:
    """Targets, or connections and values at all samples; None where nothing is left."""
    if isinstance(prop, Usd.Relationship):
        return [str(path) for path in prop.GetTargets()]
    if not prop.IsAuthored():
        return None
    codes = [Usd.TimeCode.Default(), *map(Usd.TimeCode, prop.GetTimeSamples())]
    values = [(str(code), plain(prop.Get(code))) for code in codes]
    values = [(code, value) for code, value in values if value is not None]
    connections = [str(path) for path in prop.GetConnections()]
    return (connections, values) if values or connections else None


def compare_properties(before: Usd.Stage, after: Usd.Stage) -> Verdicts:
    """For each property and prim whether it was "changed", is "gone" or "added"; what is kept is left out."""
    verdicts: Verdicts = {}
    for prim in all_prims(before):
        path = prim.GetPath()
        other = after.GetPrimAtPath(path)
        if not other or (prim.IsActive() and not other.IsActive()):
            verdicts[str(path)] = "gone"
            continue
        kept = (prim.GetTypeName(), prim.GetAppliedSchemas(), prim.GetSpecifier(), metadata(prim))
        if kept != (other.GetTypeName(), other.GetAppliedSchemas(), other.GetSpecifier(), metadata(other)):
            verdicts[str(path)] = "changed"
        names = {prop.GetName() for item in (prim, other) for prop in item.GetAuthoredProperties()}
        for name in sorted(names):
            verdict = _compare(prim.GetProperty(name), other.GetProperty(name))
            if verdict:
                verdicts[f"{path}.{name}"] = verdict
    return verdicts


def _compare(first: Usd.Property, second: Usd.Property) -> str | None:
    had, has = (content(prop) if prop else None for prop in (first, second))
    if had == has and (not first or not second or metadata(first) == metadata(second)):
        return None
    if has is None or has == []:
        return "gone"
    return "added" if had is None else "changed"


def check_stage(stage: Usd.Stage, before: Usd.Stage | None = None) -> None:
    """Lengths, index ranges, finite values and time samples of every mesh; samples against the input, if given."""
    assert check_composition(stage) == []
    for prim in all_prims(stage):
        if prim.IsActive() and prim.IsA(UsdGeom.Mesh) and UsdGeom.Mesh(prim).GetPointsAttr().HasAuthoredValue():
            check_mesh(UsdGeom.Mesh(prim))
            source = before.GetPrimAtPath(prim.GetPath()) if before else None
            if source:
                check_times(UsdGeom.Mesh(source), UsdGeom.Mesh(prim))


def values_of(attribute: Usd.Attribute) -> list[Any]:
    """The values at the default time and all samples."""
    codes = [Usd.TimeCode.Default(), *map(Usd.TimeCode, attribute.GetTimeSamples())] if attribute else []
    return [value for value in (attribute.Get(code) for code in codes) if value is not None]


def check_mesh(mesh: UsdGeom.Mesh) -> None:
    [counts] = values_of(mesh.GetFaceVertexCountsAttr())[:1]
    [indices] = values_of(mesh.GetFaceVertexIndicesAttr())[:1]
    counts, indices = np.asarray(counts, dtype=np.int64), np.asarray(indices, dtype=np.int64)
    point_count = len(values_of(mesh.GetPointsAttr())[0])
    sizes = {
        "constant": 1, "uniform": len(counts), "vertex": point_count, "varying": point_count,
        "faceVarying": len(indices),
    }  # fmt: skip
    assert counts.sum() == len(indices)
    assert indices.min(initial=0) >= 0
    assert indices.max(initial=-1) < point_count
    for name in ("points", "velocities", "accelerations"):
        for value in values_of(mesh.GetPrim().GetAttribute(name)):
            assert len(value) == point_count, f"{name}: {len(value)} for {point_count} points"
            assert np.isfinite(np.asarray(value)).all(), name
    for value in values_of(mesh.GetNormalsAttr()):
        assert len(value) == sizes[mesh.GetNormalsInterpolation()]
    for primvar in UsdGeom.PrimvarsAPI(mesh).GetPrimvarsWithAuthoredValues():
        _check_primvar(primvar, sizes)
    for subset in UsdGeom.Subset.GetAllGeomSubsets(mesh):
        _check_subset(subset, {"face": len(counts), "point": point_count})
    for code in [Usd.TimeCode.Default(), *map(Usd.TimeCode, mesh.GetPointsAttr().GetTimeSamples())]:
        points, extent = (np.asarray(item.Get(code) or []) for item in (mesh.GetPointsAttr(), mesh.GetExtentAttr()))
        if not len(points) or not len(extent):
            continue
        np.testing.assert_allclose(extent, [points.min(axis=0), points.max(axis=0)], rtol=1e-6, atol=1e-6)
    _check_shapes(mesh.GetPrim(), point_count)


def _check_primvar(primvar: UsdGeom.Primvar, sizes: dict[str, int]) -> None:
    name, size = primvar.GetName(), sizes[primvar.GetInterpolation()]
    indices = values_of(primvar.GetIndicesAttr()) if primvar.IsIndexed() else []
    for value in values_of(primvar.GetAttr()):
        if not primvar.GetTypeName().isArray or primvar.GetInterpolation() == UsdGeom.Tokens.constant:
            # Nobody touches constant ones, whatever their length.
            continue
        count, rest = divmod(len(value), primvar.GetElementSize())
        assert not rest, f"{name}: {len(value)} values in elements of {primvar.GetElementSize()}"
        for index in indices:
            index = np.asarray(index)
            assert len(index) == size, f"{name}: {len(index)} indices, {primvar.GetInterpolation()} {size}"
            assert index.min(initial=0) >= 0
            assert index.max(initial=-1) < count
        unauthored = primvar.GetUnauthoredValuesIndex()
        assert unauthored == -1 or (indices and unauthored < count), f"{name}: unauthoredValuesIndex {unauthored}"
        if not indices:
            assert count == size, f"{name}: {count} elements, {primvar.GetInterpolation()} {size}"


def _check_subset(subset: UsdGeom.Subset, sizes: dict[str, int]) -> None:
    kind = subset.GetElementTypeAttr().Get()
    for value in values_of(subset.GetIndicesAttr()):
        members = np.asarray(value, dtype=np.int64)
        assert len(np.unique(members)) == len(members), subset.GetPath()
        assert members.min(initial=0) >= 0
        assert members.max(initial=-1) < sizes.get(kind, np.inf), subset.GetPath()


def _check_shapes(prim: Usd.Prim, point_count: int) -> None:
    for path in UsdSkel.BindingAPI(prim).GetBlendShapeTargetsRel().GetTargets():
        shape = UsdSkel.BlendShape(prim.GetStage().GetPrimAtPath(path))
        indices = np.asarray(shape.GetPointIndicesAttr().Get() or [], dtype=np.int64)
        assert indices.max(initial=-1) < point_count
        for name in ("offsets", "normalOffsets"):
            value = shape.GetPrim().GetAttribute(name).Get()
            assert not value or len(value) == (len(indices) or point_count), f"{path}.{name}"


def check_times(before: UsdGeom.Mesh, after: UsdGeom.Mesh) -> None:
    """What goes on having values has them at the times it had them, but for indices, which may become still."""
    for prop in before.GetPrim().GetAuthoredAttributes():
        other = after.GetPrim().GetAttribute(prop.GetName())
        if other and other.Get(Usd.TimeCode.EarliestTime()) is not None and not prop.GetName().endswith(":indices"):
            if prop.GetName() in ("faceVertexCounts", "faceVertexIndices", "extent", "holeIndices"):
                continue
            indices = before.GetPrim().GetAttribute(f"{prop.GetName()}:indices")
            own = set(prop.GetTimeSamples())
            # Values whose indices changed over time change themselves, but for constant ones, which nobody touches.
            together = own | set(indices.GetTimeSamples() if indices else ())
            assert set(other.GetTimeSamples()) in (own, together), prop.GetPath()
