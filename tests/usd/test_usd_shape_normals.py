"""Normals of meshes that had none follow their blend shapes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdSkel

from tests.support.usd_rig import FRAMES, TUBE, shaped_rig
from tests.support.usd_stages import skinned_stage
from warpqem.mesh.smooth_normals import vertex_normals
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.read.materials import Materials
from warpqem.usd.read.mesh_look import mesh_look
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.shading_normals import shaded_mesh
from warpqem.usd.read.skeleton_poses import StagePoses
from warpqem.usd.write import fitted_normals


def angles(stage: Usd.Stage) -> np.ndarray:
    """Between shading normals and those of the posed faces, in degrees, in several frames."""
    source, found = MeshSource(stage.GetPrimAtPath(TUBE), StagePoses(stage)), []
    for time in FRAMES[::3]:
        mesh = shaded_mesh(source, mesh_look(source, Materials(), time), time)
        own = vertex_normals(np.asarray(mesh.points, dtype=np.float32), mesh.faces)[mesh.faces]
        found.append(np.degrees(np.arccos(np.clip((mesh.normals * own).sum(axis=2), -1, 1))).ravel())
    return np.concatenate(found)


@pytest.mark.parametrize(("scheme", "normals"), [("none", "fit"), ("catmullClark", None), ("catmullClark", "keep")])
def test_new_normals_follow_blend_shapes(tmp_path: Path, scheme, normals, monkeypatch):
    # Polygons get them, too, although such a swelling is shaded more like the input without any.
    monkeypatch.setattr(fitted_normals.NormalErrors, "is_within", lambda *_: True)
    stage = shaped_rig(tmp_path / "in.usda")
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(TUBE))
    mesh.CreateSubdivisionSchemeAttr(scheme)
    # A swelling so strong that its sides face along the tube.
    for name in ("left", "right"):
        offsets = UsdSkel.BlendShape(stage.GetPrimAtPath(f"{TUBE}/{name}")).GetOffsetsAttr()
        offsets.Set([5.0 * value for value in offsets.Get()])
    stage.Save()
    options = SimplifyOptions(ratio=0.5, normals=normals, measure=False, device="cpu")
    simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", options)
    result = Usd.Stage.Open(str(tmp_path / "out.usda"))
    assert UsdGeom.Mesh(result.GetPrimAtPath(TUBE)).GetNormalsAttr().HasAuthoredValue()
    followed = angles(result).mean()
    for prim in result.GetPrimAtPath(TUBE).GetChildren():
        shape = UsdSkel.BlendShape(prim)
        if shape and shape.GetNormalOffsetsAttr().HasAuthoredValue():
            assert len(shape.GetNormalOffsetsAttr().Get()) == len(shape.GetPointIndicesAttr().Get())
            shape.GetNormalOffsetsAttr().Block()
    assert followed < 0.5 * angles(result).mean()


def test_inbetweens_get_normals_too(tmp_path: Path):
    stage = skinned_stage(tmp_path / "in.usda")
    stage.GetPrimAtPath("/Char/Body").GetAttribute("subdivisionScheme").Set("catmullClark")
    stage.Save()
    simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", SimplifyOptions(ratio=0.6, measure=False, device="cpu"))
    result = Usd.Stage.Open(str(tmp_path / "out.usda"))
    shape = UsdSkel.BlendShape(result.GetPrimAtPath("/Char/Body/bulge"))
    count = len(shape.GetPointIndicesAttr().Get())
    assert len(shape.GetNormalOffsetsAttr().Get()) == len(shape.GetOffsetsAttr().Get()) == count > 2
    inbetween = shape.GetInbetween("half")
    assert len(inbetween.GetNormalOffsets()) == len(inbetween.GetOffsets()) == count
    assert np.abs(np.array(inbetween.GetNormalOffsets())).max() > 1e-3
