"""Which meshes were smooth because they were subdivided."""

from __future__ import annotations

from pxr import Usd, UsdGeom

__all__ = ["NORMAL_ATTRIBUTES", "has_normals", "is_creased", "is_shaded_by_subdivision", "is_smooth_scheme"]

SMOOTH_SCHEMES = (UsdGeom.Tokens.catmullClark, UsdGeom.Tokens.loop)

NORMAL_ATTRIBUTES = ("normals", "primvars:normals", "primvars:normals:indices")


def is_shaded_by_subdivision(mesh: UsdGeom.Mesh) -> bool:
    """True for a subdivision surface without normals of its own, which looks smooth but at creases.

    Sharp corners say where the surface passes, and are smooth beside the point itself.
    """
    return is_smooth_scheme(mesh) and not has_normals(mesh.GetPrim())


def is_smooth_scheme(mesh: UsdGeom.Mesh) -> bool:
    """True for a surface that subdivision makes smooth."""
    return mesh.GetSubdivisionSchemeAttr().Get() in SMOOTH_SCHEMES


def has_normals(prim: Usd.Prim) -> bool:
    """True for a mesh with normals of its own."""
    return any(prim.GetAttribute(name).HasAuthoredValue() for name in NORMAL_ATTRIBUTES[:2])


def is_creased(mesh: UsdGeom.Mesh) -> bool:
    """True for a mesh with creases, which has no one normal at each point."""
    return bool(mesh.GetCreaseIndicesAttr().Get(Usd.TimeCode.EarliestTime()))
