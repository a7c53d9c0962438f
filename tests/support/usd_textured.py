"""Stages of textured meshes, and what the material of a mesh has as its normal map."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, Vt

from tests.support.usd_stages import quad_grid
from warpqem.normal_maps.maps import decoded, encoded

# Quads across the bumpy sheet of the tests.
SIDE = 16


def bumpy_points(side: int = SIDE) -> np.ndarray:
    """Points (V, 3) of a sheet over the unit square, with a wave."""
    points = quad_grid(side)[0] / side
    points[:, 2] = 0.05 * np.sin(6.0 * points[:, 0]) * np.cos(5.0 * points[:, 1])
    return points.astype(np.float32)


def wave_normals(points: np.ndarray) -> np.ndarray:
    """Unit normals of that wave."""
    x, y = 6.0 * points[:, 0], 5.0 * points[:, 1]
    slope = np.stack([0.3 * np.cos(x) * np.cos(y), -0.25 * np.sin(x) * np.sin(y)], axis=1)
    normals = np.concatenate([-slope, np.ones((len(points), 1))], axis=1)
    return (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)


def define_sheet(
    stage: Usd.Stage,
    path: str,
    uvs: np.ndarray | None = None,
    points: np.ndarray | None = None,
    uv_name: str = "st",
    side: int = SIDE,
) -> UsdGeom.Mesh:
    """A bumpy sheet with normals, and texture coordinates (V, 2) at its points; by default its place on the square."""
    points = bumpy_points(side) if points is None else points
    mesh = UsdGeom.Mesh.Define(stage, path)
    _, counts, indices = quad_grid(side)
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(counts))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(indices))
    mesh.CreateSubdivisionSchemeAttr("none")
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
    mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(wave_normals(points)))
    mesh.SetNormalsInterpolation("vertex")
    uvs = points[:, :2] if uvs is None else uvs
    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(uv_name, Sdf.ValueTypeNames.TexCoord2fArray, "vertex")
    primvar.Set(Vt.Vec2fArray.FromNumpy(np.ascontiguousarray(uvs, dtype=np.float32)))
    return mesh


def define_material(stage: Usd.Stage, path: str, image: str | None = None, uv_name: str = "st") -> UsdShade.Material:
    """A material of UsdPreviewSurface, with an image as its base colour."""
    material = UsdShade.Material.Define(stage, path)
    surface = UsdShade.Shader.Define(stage, f"{path}/surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    surface.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(0.25)
    material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
    if image is not None:
        texture = define_texture(stage, f"{path}/color", image, uv_name)
        surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).ConnectToSource(texture, "rgb")
    return material


def define_texture(stage: Usd.Stage, path: str, image: str, uv_name: str = "st") -> UsdShade.ConnectableAPI:
    """A texture on coordinates of a name."""
    reader = UsdShade.Shader.Define(stage, f"{path}_uv")
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set(uv_name)
    texture = UsdShade.Shader.Define(stage, path)
    texture.CreateIdAttr("UsdUVTexture")
    texture.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(image)
    texture.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(reader.ConnectableAPI(), "result")
    texture.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)
    return texture.ConnectableAPI()


def add_map(material: UsdShade.Material, image: str) -> UsdShade.Shader:
    """Give a material of these a normal map, and return its texture."""
    stage, path = material.GetPrim().GetStage(), material.GetPath()
    define_texture(stage, f"{path}/bumps", image)
    texture = UsdShade.Shader.Get(stage, path.AppendChild("bumps"))
    texture.CreateInput("sourceColorSpace", Sdf.ValueTypeNames.Token).Set("raw")
    texture.CreateInput("scale", Sdf.ValueTypeNames.Float4).Set(Gf.Vec4f(2, 2, 2, 1))
    texture.CreateInput("bias", Sdf.ValueTypeNames.Float4).Set(Gf.Vec4f(-1, -1, -1, 0))
    surface = UsdShade.Shader.Get(stage, path.AppendChild("surface"))
    surface.CreateInput("normal", Sdf.ValueTypeNames.Normal3f).ConnectToSource(texture.ConnectableAPI(), "rgb")
    return texture


def write_tilted_map(path: Path, tilt: tuple[float, float, float], size: int = 8) -> None:
    """A normal map that is one vector everywhere."""
    vector = np.array(tilt) / np.linalg.norm(tilt)
    Image.fromarray(np.broadcast_to(encoded(vector), (size, size, 3)).copy()).save(path)


def bind(prim: Usd.Prim, material: UsdShade.Material) -> None:
    """Bind a material to a prim."""
    UsdShade.MaterialBindingAPI.Apply(prim).Bind(material)


def sheet_stage(path: Path, *names: str, **options: Any) -> Usd.Stage:
    """A stage with sheets at /Root/NAME, saved."""
    stage = Usd.Stage.CreateNew(str(path))
    stage.SetMetadata("metersPerUnit", 1.0)
    stage.SetMetadata("upAxis", "Y")
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/Root").GetPrim())
    for name in names or ("Sheet",):
        define_sheet(stage, f"/Root/{name}", **options)
    stage.Save()
    return stage


def normal_texture(stage: Usd.Stage, path: str) -> UsdShade.Shader | None:
    """The texture that is the normal map of what is bound to a prim; None without one."""
    material = UsdShade.MaterialBindingAPI(stage.GetPrimAtPath(path)).ComputeBoundMaterial()[0]
    surface = material.ComputeSurfaceSource()[0] if material else None
    port = surface.GetInput("normal") if surface else None
    sources = port.GetConnectedSources()[0] if port else []
    return UsdShade.Shader(sources[0].source.GetPrim()) if sources else None


def map_file(stage: Usd.Stage, path: str) -> str | None:
    """Where that is."""
    texture = normal_texture(stage, path)
    return None if texture is None else texture.GetInput("file").Get().resolvedPath


def map_vectors(path: str) -> np.ndarray:
    """The vectors (height, width, 3) of a map."""
    return decoded(np.array(Image.open(path)))
