"""A stage on which a mesh holds everything that USD lets it hold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, Vt

from tests.support.usd_stages import FRAMES, cloth_stage, quad_grid, waves

CLOTH = "/Root/Cloth"
SIZE = 8
POINTS, COUNTS, INDICES = quad_grid(SIZE)
LENGTHS = {
    "constant": 1,
    "uniform": len(COUNTS),
    "vertex": len(POINTS),
    "varying": len(POINTS),
    "faceVarying": len(INDICES),
}
NAMES = Sdf.ValueTypeNames

# A value of every kind for the element with this number.
KINDS = {
    "bool": (NAMES.BoolArray, lambda i: i % 3 == 0),
    "uchar": (NAMES.UCharArray, lambda i: i % 250),
    "int": (NAMES.IntArray, lambda i: -i),
    "uint": (NAMES.UIntArray, lambda i: i),
    "int64": (NAMES.Int64Array, lambda i: 2**40 + i),
    "uint64": (NAMES.UInt64Array, lambda i: 2**60 + i),
    "half": (NAMES.HalfArray, lambda i: i / 8),
    "double": (NAMES.DoubleArray, lambda i: i / 7),
    "timecode": (NAMES.TimeCodeArray, lambda i: Sdf.TimeCode(i)),
    "string": (NAMES.StringArray, lambda i: f"s{i}"),
    "token": (NAMES.TokenArray, lambda i: f"t{i % 5}"),
    "asset": (NAMES.AssetArray, lambda i: Sdf.AssetPath(f"./tex{i % 2}.txt")),
    "int2": (NAMES.Int2Array, lambda i: Gf.Vec2i(i, -i)),
    "half3": (NAMES.Half3Array, lambda i: Gf.Vec3h(i, 1, 2)),
    "double4": (NAMES.Double4Array, lambda i: Gf.Vec4d(i, 1, 2, 3)),
    "color4f": (NAMES.Color4fArray, lambda i: Gf.Vec4f(i / 300, 0, 0, 1)),
    "normal3f": (NAMES.Normal3fArray, lambda i: Gf.Vec3f(0, 0.6, 0.8)),
    "quatf": (NAMES.QuatfArray, lambda i: Gf.Quatf(Gf.Rotation(Gf.Vec3d(0, 0, 1), i).GetQuat())),
    "quath": (NAMES.QuathArray, lambda i: Gf.Quath(1)),
    "matrix3d": (NAMES.Matrix3dArray, lambda i: Gf.Matrix3d(1 + i)),
    "matrix4d": (NAMES.Matrix4dArray, lambda i: Gf.Matrix4d(1 + i)),
    "frame4d": (NAMES.Frame4dArray, lambda i: Gf.Matrix4d(1)),
}


def rich_stage(path: Path) -> Usd.Stage:
    """A cloth at /Root/Cloth, saved."""
    stage = cloth_stage(path)
    for index in range(2):
        (path.parent / f"tex{index}.txt").write_text("texture")
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH))
    _add_primvars(mesh)
    _add_attributes(mesh)
    _add_subdivision(mesh)
    _add_subsets(stage, mesh)
    _add_metadata(stage, mesh)
    stage.Save()
    return stage


def _add_primvars(mesh: UsdGeom.Mesh) -> None:
    api = UsdGeom.PrimvarsAPI(mesh)
    for kind, (type_name, value) in KINDS.items():
        for interpolation, length in LENGTHS.items():
            primvar = api.CreatePrimvar(f"{kind}_{interpolation}", type_name, interpolation)
            primvar.Set([value(i) for i in range(length)])
    for interpolation, length in LENGTHS.items():
        # The same two values as in an indexed primvar, and one of three numbers for each element.
        indexed = api.CreatePrimvar(f"indexed_{interpolation}", NAMES.FloatArray, interpolation)
        indexed.Set([1.0, 2.0])
        indexed.SetIndices(Vt.IntArray([i * 2 // length for i in range(length)]))
        sized = api.CreatePrimvar(f"sized_{interpolation}", NAMES.FloatArray, interpolation, 3)
        sized.Set([float(i) for i in range(3 * length)])
        moving = api.CreatePrimvar(f"moving_{interpolation}", NAMES.FloatArray, interpolation)
        for time in (0.5, 2.0, 7.0):
            moving.Set([time * i for i in range(length)], time)
        turning = api.CreatePrimvar(f"turning_{interpolation}", NAMES.FloatArray, interpolation)
        turning.Set([3.0, 4.0])
        for time in (1.0, 3.0):
            turning.SetIndices(Vt.IntArray([int(time + i) % 2 for i in range(length)]), time)
    gaps = api.CreatePrimvar("gaps", NAMES.FloatArray, "faceVarying")
    gaps.Set([0.0, 1.0, 2.0])
    gaps.SetIndices(Vt.IntArray([i % 2 for i in range(LENGTHS["faceVarying"])]))
    gaps.SetUnauthoredValuesIndex(2)
    st = api.CreatePrimvar("st", NAMES.TexCoord2fArray, "faceVarying")
    # Mirrored: the right half has the texture of the left one, turned over. The last row has no area.
    flat = np.stack([4 - np.abs(POINTS[:, 0] - 4), np.minimum(POINTS[:, 1], SIZE - 1)], axis=1)[INDICES]
    st.Set(Vt.Vec2fArray.FromNumpy(np.ascontiguousarray(flat, dtype=np.float32)))
    api.CreatePrimvar("scalar", NAMES.Float, "constant").Set(1.0)
    api.CreatePrimvar("nothing", NAMES.FloatArray, "vertex")
    api.CreatePrimvar("short", NAMES.FloatArray, "vertex").Set([1.0, 2.0])
    api.CreatePrimvar("blockedOnce", NAMES.FloatArray, "vertex").Set([1.0] * 81, 1.0)
    api.GetPrimvar("blockedOnce").GetAttr().Set(Sdf.ValueBlock(), 2.0)
    normals = api.CreatePrimvar("normals", NAMES.Normal3fArray, "faceVarying")
    normals.Set([Gf.Vec3f(0, 0, 1)])
    normals.SetIndices([0] * LENGTHS["faceVarying"])


def _add_attributes(mesh: UsdGeom.Mesh) -> None:
    prim = mesh.GetPrim()
    for time, pose in zip(FRAMES, waves(POINTS, 3), strict=True):
        mesh.CreateNormalsAttr().Set([Gf.Vec3f(0, 0, 1)] * 81, time)
        mesh.CreateVelocitiesAttr().Set([Gf.Vec3f(time)] * 81, time)
        mesh.CreateAccelerationsAttr().Set([Gf.Vec3f(0, time, 0)] * 81, time)
        extent = [pose.min(axis=0), pose.max(axis=0)]
        mesh.CreateExtentAttr().Set(Vt.Vec3fArray.FromNumpy(np.stack(extent)), time)
    mesh.SetNormalsInterpolation("vertex")
    for time in (1.0, 4.0):
        mesh.MakeVisible()
        mesh.CreateVisibilityAttr().Set("inherited" if time == 1 else "invisible", time)
        translate = prim.GetAttribute("xformOp:translate")
        operation = UsdGeom.XformOp(translate) if translate else mesh.AddTranslateOp()
        operation.Set(Gf.Vec3d(time, 0, 0), time)
    mesh.CreatePurposeAttr("render")
    mesh.CreateDoubleSidedAttr(True)
    prim.CreateAttribute("studio:points", NAMES.FloatArray).Set([float(i) for i in range(81)])
    prim.CreateAttribute("studio:faces", NAMES.StringArray).Set([str(i) for i in range(64)])
    prim.CreateAttribute("studio:corners", NAMES.IntArray).Set(list(range(256)))
    prim.CreateAttribute("studio:three", NAMES.FloatArray).Set([1.0, 2.0, 3.0])
    prim.CreateAttribute("studio:one", NAMES.Matrix4d).Set(Gf.Matrix4d(2))
    prim.CreateAttribute("studio:empty", NAMES.FloatArray)
    prim.CreateAttribute("studio:wired", NAMES.Float).AddConnection(Sdf.Path(f"{CLOTH}.studio:one"))
    prim.CreateRelationship("studio:friend").AddTarget("/Root")


def _add_subdivision(mesh: UsdGeom.Mesh) -> None:
    mesh.CreateSubdivisionSchemeAttr("catmullClark")
    mesh.CreateInterpolateBoundaryAttr("edgeAndCorner")
    mesh.CreateFaceVaryingLinearInterpolationAttr("all")
    mesh.CreateTriangleSubdivisionRuleAttr("smooth")
    mesh.CreateCreaseIndicesAttr([20, 21, 22])
    mesh.CreateCreaseLengthsAttr([3])
    mesh.CreateCreaseSharpnessesAttr([4.0])
    mesh.CreateCornerIndicesAttr([0])
    mesh.CreateCornerSharpnessesAttr([10.0])
    mesh.CreateHoleIndicesAttr([27])


def _add_subsets(stage: Usd.Stage, mesh: UsdGeom.Mesh) -> None:
    families = {
        "partition": ("materialBind", [range(32), range(32, 64)]),
        "nonOverlapping": ("rooms", [[10, 11], [40, 41]]),
    }
    families["unrestricted"] = ("loose", [range(17), [0, 40], [27]])
    for family_type, (family, parts) in families.items():
        for index, part in enumerate(parts):
            subset = UsdGeom.Subset.CreateGeomSubset(mesh, f"{family}{index}", "face", list(part), family, family_type)
            material = UsdShade.Material.Define(stage, f"/Root/Looks/{family}{index}")
            UsdShade.MaterialBindingAPI.Apply(subset.GetPrim()).Bind(material)
    moving = UsdGeom.Subset.Define(stage, f"{CLOTH}/moving")
    moving.CreateElementTypeAttr("face")
    moving.CreateFamilyNameAttr("loose")
    for time, faces in ((1.0, [1, 2]), (2.0, [40])):
        moving.CreateIndicesAttr().Set(faces, time)
    moving.GetIndicesAttr().Set(Sdf.ValueBlock(), 3.0)
    UsdGeom.Subset.CreateGeomSubset(mesh, "pins", "point", [0, 80], "pins", "unrestricted")
    UsdGeom.Subset.CreateGeomSubset(mesh, "rims", "edge", [0, 1, 1, 2], "rims", "unrestricted")
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(UsdShade.Material.Get(stage, "/Root/Looks/rooms0"))


def _add_metadata(stage: Usd.Stage, mesh: UsdGeom.Mesh) -> None:
    prim = mesh.GetPrim()
    prim.SetCustomDataByKey("studio:shot", 12)
    prim.SetDocumentation("A cloth.")
    prim.SetAssetInfoByKey("name", "cloth")
    mesh.GetPointsAttr().SetCustomDataByKey("source", "cache")
    mesh.GetPointsAttr().SetDocumentation("Where it is.")
    UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st").GetAttr().SetCustomDataByKey("map", "uv1")
    UsdGeom.Scope.Define(stage, f"{CLOTH}/notes").GetPrim().CreateAttribute("text", NAMES.String).Set("hem")
    layer = stage.GetRootLayer()
    layer.customLayerData = {"studio": "north"}
    layer.comment = "take 3"
