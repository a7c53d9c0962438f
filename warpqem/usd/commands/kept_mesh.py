"""A mesh that keeps all its faces: what the options ask of it nevertheless."""

from __future__ import annotations

import numpy as np
from pxr import UsdGeom

from warpqem.usd.commands.mesh_job import MeshJob
from warpqem.usd.commands.rig_options import single
from warpqem.usd.commands.simplify_options import SimplifyOptions
from warpqem.usd.read.mesh_skin import Skin

__all__ = ["wanted_changes"]


def wanted_changes(job: MeshJob, options: SimplifyOptions) -> list[str]:
    """Names of the options that change a mesh also where no face of it is removed; empty for a mesh to leave as it is.

    Args:
        job: The mesh.
        options: What is asked for.
    """
    wanted = _of_skin(job.skin, options) if job.skin is not None else []
    if options.bake and job.source.has_skin_binding:
        wanted.append("bake")
    has_normals = _has_normals(UsdGeom.Mesh(job.source.prim))
    if (options.normals == "none" and has_normals) or (options.normals == "fit" and not has_normals):
        wanted.append("normals")
    return wanted


def _of_skin(skin: Skin, options: SimplifyOptions) -> list[str]:
    wanted = []
    most, joints, shapes = single(options.influences), single(options.joints), single(options.shapes)
    if most is not None and skin.influence_count > most:
        wanted.append("influences")
    used = {int(joint) for at in skin.influences.values() for joint in np.unique(at.joints[at.weights > 0])}
    if joints is not None and len(used) > joints:
        wanted.append("joints")
    if options.joint_error is not None and used:
        wanted.append("joint_error")
    if shapes is not None and len(skin.shapes) > shapes:
        wanted.append("shapes")
    if options.shape_error is not None and skin.shapes:
        wanted.append("shape_error")
    return wanted


def _has_normals(mesh: UsdGeom.Mesh) -> bool:
    primvar = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("normals")
    return bool(mesh.GetNormalsAttr().HasAuthoredValue() or (primvar and primvar.HasAuthoredValue()))
