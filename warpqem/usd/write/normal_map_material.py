"""A material of a mesh's own that adds a normal map to the one that is bound to it.

It stands below the mesh and inherits the material of the input, so that whatever is changed there shows here too, and
other meshes of that material keep theirs.
"""

from __future__ import annotations

from collections.abc import Sequence

from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade

from warpqem.errors import StageError

__all__ = ["MATERIAL_NAME", "add_normal_map", "check_material", "uv_name_of"]

# Of the material of a mesh that has none, and behind the names of others.
MATERIAL_NAME = "baked"
# How a binding holds against those below it, and how the names of those by collections begin.
STRONGER, COLLECTIONS = UsdShade.Tokens.strongerThanDescendants, "material:binding:collection"
# Renderers ask for one of these kinds of binding, and take that for all purposes where there is none of it.
PURPOSES = (UsdShade.Tokens.allPurpose, UsdShade.Tokens.preview, UsdShade.Tokens.full)
# Of a mesh without a colour: the default of the surface itself is far darker than renderers show such a mesh.
PLAIN = Gf.Vec3f(0.5, 0.5, 0.5)
# Nodes below a surface that are looked through for the texture coordinates it uses.
MAX_NODES = 64


def bound_materials(owner: Usd.Prim) -> list[tuple[UsdShade.Material, str]]:
    """The materials of a mesh or subset by the purpose that they are bound for; an invalid one for none."""
    found: list[tuple[UsdShade.Material, str]] = []
    for purpose in PURPOSES:
        material = UsdShade.MaterialBindingAPI(owner).ComputeBoundMaterial(purpose)[0]
        if purpose == UsdShade.Tokens.allPurpose or (material and material.GetPath() != found[0][0].GetPath()):
            found.append((material, purpose))
    return [(material, purpose) for material, purpose in found if material] or found[:1]


def check_material(owner: Usd.Prim) -> None:
    """Check that a normal map can be added to what is bound to a mesh or subset.

    Raises:
        StageError: it has a surface that is no UsdPreviewSurface or no part of the material, or it is bound in a way
            that no binding of the mesh's own goes before.
    """
    for material, purpose in bound_materials(owner):
        if not material:
            continue
        binding = UsdShade.MaterialBindingAPI(owner).ComputeBoundMaterial(purpose)[1]
        is_strong = UsdShade.MaterialBindingAPI.GetMaterialBindingStrength(binding) == STRONGER
        is_own = binding.GetPrim() == owner
        if (is_strong and not is_own) or (is_own and binding.GetName().startswith(COLLECTIONS)):
            raise StageError(f"{binding.GetPath()} binds a material that no other binding goes before")
        shader = material.ComputeSurfaceSource()[0]
        if not shader and not _has_surface(material):
            continue
        if not shader or shader.GetIdAttr().Get() != "UsdPreviewSurface":
            raise StageError(f"the material {material.GetPath()} has no UsdPreviewSurface")
        if not shader.GetPath().HasPrefix(material.GetPath()):
            raise StageError(f"the surface {shader.GetPath()} is no part of the material {material.GetPath()}")


def _has_surface(material: UsdShade.Material) -> bool:
    """Whether a material has a surface for any renderer."""
    return any(port.GetBaseName().endswith("surface") and port.HasConnectedSource() for port in material.GetOutputs())


def uv_name_of(owner: Usd.Prim, names: Sequence[str]) -> str:
    """The texture coordinates that the material of a mesh or subset uses; else "st", else the first of some names."""
    for material, _ in bound_materials(owner):
        shader = material.ComputeSurfaceSource()[0] if material else None
        ports = (
            [] if not shader else [shader.GetInput(name) for name in ("normal", "diffuseColor")] + shader.GetInputs()
        )
        found = _reader_names([port for port in ports if port])
        for name in found:
            if name in names:
                return name
    return "st" if "st" in names or not names else sorted(names)[0]


def _reader_names(ports: Sequence[UsdShade.Input]) -> list[str]:
    """Names of primvars that readers of coordinates give, in the order of the inputs that they come to."""
    names, waiting, count = [], list(ports), 0
    while waiting and count < MAX_NODES:
        port, count = waiting.pop(0), count + 1
        for attribute in port.GetValueProducingAttributes():
            if not UsdShade.Output.IsOutput(attribute):
                continue
            node = UsdShade.Shader(attribute.GetPrim())
            if str(node.GetIdAttr().Get() or "").startswith("UsdPrimvarReader_float2"):
                name = node.GetInput("varname")
                names.append(str((name.GetValueProducingAttributes() or [None])[0].Get() if name else ""))
            else:
                waiting[:0] = node.GetInputs()
    return names


def add_normal_map(mesh: UsdGeom.Mesh, owner: Usd.Prim, file: str, uv_name: str) -> list[str]:
    """Bind a mesh or subset to a material of its own that has a normal map, with all else of the one it had.

    Args:
        mesh: The mesh, on the stage of the edits.
        owner: It, or one of its subsets.
        file: The image.
        uv_name: The texture coordinates that it lies on.

    Returns:
        Paths of the new materials.
    """
    made = []
    for material, purpose in bound_materials(owner):
        new = _new_material(mesh, owner, material)
        surface = new.ComputeSurfaceSource()[0]
        surface.CreateInput("normal", Sdf.ValueTypeNames.Normal3f).ConnectToSource(_texture(new, file, uv_name))
        UsdShade.MaterialBindingAPI.Apply(owner).Bind(new, UsdShade.Tokens.fallbackStrength, purpose)
        made.append(str(new.GetPath()))
    return made


def _new_material(mesh: UsdGeom.Mesh, owner: Usd.Prim, material: UsdShade.Material) -> UsdShade.Material:
    stage, start = mesh.GetPrim().GetStage(), mesh.GetPath()
    name = f"{material.GetPrim().GetName()}_{MATERIAL_NAME}" if material else MATERIAL_NAME
    path, count = start.AppendChild(name), 1
    while stage.GetPrimAtPath(path):
        count += 1
        path = start.AppendChild(f"{name}_{count}")
    new = UsdShade.Material.Define(stage, path)
    if not material:
        _add_surface(new, mesh)
        return new
    if not material.ComputeSurfaceSource()[0]:
        _add_surface(new, mesh)
    new.GetPrim().GetInherits().AddInherit(material.GetPath())
    if new.GetPrim().IsInstanceable():
        # What is below an instance cannot be edited.
        new.GetPrim().SetInstanceable(False)
    return new


def _add_surface(material: UsdShade.Material, mesh: UsdGeom.Mesh) -> None:
    """What renderers give a mesh without a material: its display colour and opacity."""
    surface = _node(material, "surface", "UsdPreviewSurface")
    surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set(PLAIN)
    kinds = {
        "diffuseColor": ("displayColor", Sdf.ValueTypeNames.Color3f, "float3", Sdf.ValueTypeNames.Float3),
        "opacity": ("displayOpacity", Sdf.ValueTypeNames.Float, "float", Sdf.ValueTypeNames.Float),
    }
    for name, (primvar, kind, reader, result) in kinds.items():
        if not UsdGeom.PrimvarsAPI(mesh).FindPrimvarWithInheritance(primvar).HasAuthoredValue():
            continue
        node = _node(material, primvar, f"UsdPrimvarReader_{reader}")
        node.CreateInput("varname", Sdf.ValueTypeNames.String).Set(primvar)
        port = surface.CreateInput(name, kind)
        port.ConnectToSource(node.CreateOutput("result", result))
    material.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", Sdf.ValueTypeNames.Token))


def _texture(material: UsdShade.Material, file: str, uv_name: str) -> UsdShade.Output:
    reader = _node(material, "normal_map_uv", "UsdPrimvarReader_float2")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set(uv_name)
    texture = _node(material, "normal_map", "UsdUVTexture")
    texture.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(Sdf.AssetPath(file))
    texture.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(
        reader.CreateOutput("result", Sdf.ValueTypeNames.Float2)
    )
    for wrap in ("wrapS", "wrapT"):
        texture.CreateInput(wrap, Sdf.ValueTypeNames.Token).Set("clamp")
    texture.CreateInput("sourceColorSpace", Sdf.ValueTypeNames.Token).Set("raw")
    # From pixels of 0 to 1 to vectors of -1 to 1.
    texture.CreateInput("scale", Sdf.ValueTypeNames.Float4).Set(Gf.Vec4f(2.0, 2.0, 2.0, 1.0))
    texture.CreateInput("bias", Sdf.ValueTypeNames.Float4).Set(Gf.Vec4f(-1.0, -1.0, -1.0, 0.0))
    texture.CreateInput("fallback", Sdf.ValueTypeNames.Float4).Set(Gf.Vec4f(0.0, 0.0, 1.0, 1.0))
    return texture.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)


def _node(material: UsdShade.Material, name: str, kind: str) -> UsdShade.Shader:
    """A new node below a material, beside those that it inherits."""
    stage, path, count = material.GetPrim().GetStage(), material.GetPath().AppendChild(name), 1
    while stage.GetPrimAtPath(path):
        count += 1
        path = material.GetPath().AppendChild(f"{name}_{count}")
    node = UsdShade.Shader.Define(stage, path)
    node.CreateIdAttr(kind)
    return node
