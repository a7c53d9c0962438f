"""Take off a mesh what does not fit its new topology.

Everything is authored on the current edit target, so a layer above the input hides the weaker opinions by blocks.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from pxr import Sdf, Usd, UsdGeom, UsdSkel

from warpqem.usd.read.blend_shapes import count_shape_users
from warpqem.usd.read.descendants import children_of

__all__ = ["Dropped", "block", "drop_skin", "drop_subdivision"]

# Attributes of UsdGeomMesh that say how a subdivision surface passes its edges and points.
SHARPNESS_ATTRIBUTES = (
    "creaseIndices",
    "creaseLengths",
    "creaseSharpnesses",
    "cornerIndices",
    "cornerSharpnesses",
)


@dataclass
class Dropped:
    """What was taken off one mesh.

    Attributes:
        names: What the report names, one entry per property or group of prims.
        blocked: Paths of the properties that were blocked.
        deactivated: Paths of the child prims that were deactivated.
        unbound: Paths of skel:skeleton relationships that must stay, empty, to stop the inheritance of a binding.
        rest_normals: Whether it had normals of a rest shape that it is no longer.
        unskinned: Paths of the prims that need no SkelBindingAPI once nothing of their skin is left.
    """

    names: list[str] = field(default_factory=list)
    blocked: list[Sdf.Path] = field(default_factory=list)
    deactivated: list[Sdf.Path] = field(default_factory=list)
    unbound: list[Sdf.Path] = field(default_factory=list)
    unskinned: list[Sdf.Path] = field(default_factory=list)
    rest_normals: bool = False


def block(attribute: Usd.Attribute, dropped: Dropped) -> bool:
    """Hide the value of an attribute; False if it has none."""
    if not attribute or not attribute.HasAuthoredValue():
        return False
    attribute.Block()
    dropped.blocked.append(attribute.GetPath())
    return True


def drop_subdivision(mesh: UsdGeom.Mesh, dropped: Dropped) -> None:
    """Take off subdivision, with creases and corners, and the list of holes, which have no faces on the new mesh."""
    for name in SHARPNESS_ATTRIBUTES:
        if block(mesh.GetPrim().GetAttribute(name), dropped):
            dropped.names.append(name)
    if block(mesh.GetHoleIndicesAttr(), dropped):
        dropped.names.append("holeIndices (the holes stay, without faces)")
    scheme = mesh.GetSubdivisionSchemeAttr().Get()
    # Most exporters that write no scheme mean polygons, though USD takes them for a subdivision surface.
    if scheme != UsdGeom.Tokens.none and mesh.GetSubdivisionSchemeAttr().HasAuthoredValue():
        dropped.names.append(f"subdivision ({scheme})")


def drop_skin(prim: Usd.Prim, dropped: Dropped) -> None:
    """Take the binding to a skeleton and the blend shapes off a mesh whose points are poses, no rest shape.

    Normals of the rest shape go with them; those of the poses are made anew, see `warpqem.usd.write.hard_edges`.
    """
    shapes = [child for child in children_of(prim) if child.IsA(UsdSkel.BlendShape)]
    properties = prim.GetAuthoredPropertiesInNamespace("skel")
    properties += prim.GetAuthoredPropertiesInNamespace("primvars:skel")
    inherited = _inherits_influences(prim)
    if not (shapes or properties or inherited or prim.HasAPI(UsdSkel.BindingAPI)):
        return
    for prop in properties:
        if isinstance(prop, Usd.Relationship):
            prop.SetTargets([])
            dropped.blocked.append(prop.GetPath())
        else:
            block(prop, dropped)
    users = count_shape_users(prim.GetStage()) if shapes else {}
    for shape in shapes:
        # This mesh no longer refers to its shapes, so that any user is another mesh, which still needs the shape.
        if users[shape.GetPath()] == 0:
            shape.SetActive(False)
            dropped.deactivated.append(shape.GetPath())
    if inherited or prim.HasAPI(UsdSkel.BindingAPI):
        # A block does not stop UsdSkel from inheriting influences; an empty skeleton on an applied API does. The API
        # stays on the layer, as the validators of USD ask for it where a weaker layer has properties of a skin.
        skeleton = UsdSkel.BindingAPI.Apply(prim).CreateSkeletonRel()
        skeleton.SetTargets([])
        if inherited:
            dropped.unbound.append(skeleton.GetPath())
        else:
            dropped.blocked.append(skeleton.GetPath())
            dropped.unskinned.append(prim.GetPath())
    deformed = shapes or inherited or prim.HasAttribute("primvars:skel:jointIndices")
    for name in ("normals", "primvars:normals", "primvars:normals:indices") if deformed else ():
        if block(prim.GetAttribute(name), dropped) and not name.endswith("indices"):
            dropped.rest_normals = True
            dropped.names.append(f"{name} of the rest pose (made anew from the poses)")
    count = f" with {len(shapes)} blend shape{'s' if len(shapes) > 1 else ''}" if shapes else ""
    dropped.names.append("skin binding" + count)


def _inherits_influences(prim: Usd.Prim) -> bool:
    """True if an ancestor gives the mesh joint influences; UsdSkel inherits them whatever their interpolation."""
    parent = prim.GetParent()
    while parent:
        if parent.GetAttribute("primvars:skel:jointIndices").HasAuthoredValue():
            return True
        parent = parent.GetParent()
    return False
