"""Take off a mesh what does not fit its new topology.

Everything is authored on the current edit target, so a layer above the input hides the weaker opinions by blocks.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from pxr import Sdf, Usd, UsdGeom, UsdSkel

__all__ = ["Dropped", "drop_misfits"]

# Array attributes of UsdGeomMesh with one entry per face, edge or point of the old topology.
TOPOLOGY_ATTRIBUTES = (
    "normals",
    "velocities",
    "accelerations",
    "holeIndices",
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
        names: What to tell the user, one entry per property or group of prims.
        blocked: Paths of the properties that were blocked.
        deactivated: Paths of the child prims that were deactivated.
        unbound: Paths of skel:skeleton relationships that must stay, empty, to stop the inheritance of a binding.
        unskinned: Paths of the prims that need no SkelBindingAPI once nothing of their skin is left.
    """

    names: list[str] = field(default_factory=list)
    blocked: list[Sdf.Path] = field(default_factory=list)
    deactivated: list[Sdf.Path] = field(default_factory=list)
    unbound: list[Sdf.Path] = field(default_factory=list)
    unskinned: list[Sdf.Path] = field(default_factory=list)


def drop_misfits(prim: Usd.Prim) -> Dropped:
    """Block or deactivate everything on a mesh whose length or indices refer to its old topology.

    Constant primvars, transforms, visibility, purpose and material bindings of the mesh stay. The skin binding goes:
    the points of the new mesh are poses, not a rest shape.

    Args:
        prim: A mesh below a SkelRoot or not, on a stage whose edit target takes the edits.
    """
    dropped = Dropped()
    _drop_primvars(prim, dropped)
    for name in TOPOLOGY_ATTRIBUTES:
        if _block(prim.GetAttribute(name), dropped):
            dropped.names.append(name)
    _drop_subsets(prim, dropped)
    _drop_skin(prim, dropped)
    scheme = UsdGeom.Mesh(prim).GetSubdivisionSchemeAttr().Get()
    if scheme != UsdGeom.Tokens.none:
        dropped.names.append(f"subdivision ({scheme})")
    return dropped


def _block(attribute: Usd.Attribute, dropped: Dropped) -> bool:
    if not attribute or not attribute.HasAuthoredValue():
        return False
    attribute.Block()
    dropped.blocked.append(attribute.GetPath())
    return True


def _drop_primvars(prim: Usd.Prim, dropped: Dropped) -> None:
    for primvar in UsdGeom.PrimvarsAPI(prim).GetPrimvars():
        name = str(primvar.GetPrimvarName())
        # primvars:skel:* go with the skin binding, whatever their interpolation.
        if primvar.GetInterpolation() == UsdGeom.Tokens.constant or name.startswith("skel:"):
            continue
        interpolation = primvar.GetInterpolation()
        _block(primvar.GetIndicesAttr(), dropped)
        if _block(primvar.GetAttr(), dropped):
            dropped.names.append(f"primvars:{name} ({interpolation})")


def _drop_subsets(prim: Usd.Prim, dropped: Dropped) -> None:
    subsets = UsdGeom.Subset.GetAllGeomSubsets(UsdGeom.Mesh(prim))
    if not subsets:
        return
    for subset in subsets:
        subset.GetPrim().SetActive(False)
        dropped.deactivated.append(subset.GetPath())
    for attribute in prim.GetAuthoredPropertiesInNamespace("subsetFamily"):
        _block(attribute, dropped)
    dropped.names.append(f"{len(subsets)} GeomSubset{'s' if len(subsets) > 1 else ''}")


def _drop_skin(prim: Usd.Prim, dropped: Dropped) -> None:
    shapes = [child for child in prim.GetChildren() if child.IsA(UsdSkel.BlendShape)]
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
            _block(prop, dropped)
    for shape in shapes:
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
    count = f" with {len(shapes)} blend shape{'s' if len(shapes) > 1 else ''}" if shapes else ""
    dropped.names.append("skin binding" + count)


def _inherits_influences(prim: Usd.Prim) -> bool:
    """True if an ancestor gives the mesh joint influences."""
    primvar = UsdGeom.PrimvarsAPI(prim.GetParent()).FindPrimvarWithInheritance("skel:jointIndices")
    return bool(primvar and primvar.HasAuthoredValue())
