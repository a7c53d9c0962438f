"""Morph weights of meshes on a stage."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdSkel

from tests.support.usd_blend_shapes import BODY, shaped_stage
from tests.support.usd_stages import FRAMES, cloth_stage
from warpqem.costs.blend_shape_weights import morph_weights
from warpqem.errors import OptionError
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.commands.blend_shape_weights import morph_scale
from warpqem.usd.commands.mesh_job import MeshJob
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.skeleton_poses import StagePoses


def job_of(stage: Usd.Stage, path: str, **options: bool) -> MeshJob:
    return MeshJob.prepare(
        MeshSource(stage.GetPrimAtPath(path), StagePoses(stage)), SimplifyOptions(ratio=1.0, **options)
    )


@pytest.mark.parametrize("bake", [False, True])
@pytest.mark.parametrize("method", ["thirds", "rank", "distance"])
def test_blend_shapes_are_the_targets(tmp_path, method, bake):
    stage = shaped_stage(tmp_path)
    points = np.array(UsdGeom.Mesh(stage.GetPrimAtPath(BODY)).GetPointsAttr().Get())
    lift = np.maximum(0, 4 - points[:, :1]) * np.array([0, 0, 1])
    scale = morph_scale(job_of(stage, BODY, bake=bake), method)
    np.testing.assert_allclose(scale, morph_weights(0 * points, lift[None], method), rtol=1e-5)


def test_usage_goes_by_the_weights_of_the_animation(tmp_path):
    stage = shaped_stage(tmp_path)
    job = job_of(stage, BODY)
    np.testing.assert_allclose(morph_scale(job, "usage"), morph_scale(job, "distance"), rtol=1e-6)
    weights = UsdSkel.Animation(stage.GetPrimAtPath("/Char/Rig/Anim")).GetBlendShapeWeightsAttr()
    for time in FRAMES:
        weights.Set([0.0], time)
    assert (morph_scale(job_of(stage, BODY), "usage") == 1).all()


def test_poses_of_a_mesh_without_a_skeleton_are_the_targets():
    stage = cloth_stage(times=[1.0, 2.0, 3.0])
    job = job_of(stage, "/Root/Cloth")
    frames = job.frames.read(slice(0, job.frames.frame_count))
    np.testing.assert_array_equal(morph_scale(job, "rank"), morph_weights(frames[0], frames[1:], "rank"))


def test_still_mesh_has_no_weights():
    assert morph_scale(job_of(cloth_stage(times=None), "/Root/Cloth"), "thirds") is None


def simplified(folder: Path, **options: object) -> tuple[np.ndarray, list[str | None]]:
    report = simplify_stage(
        folder / "in.usda", folder / "out.usda", SimplifyOptions(**{"ratio": 0.4, "device": "cpu", **options})
    )
    if report.output is None:
        return np.zeros((0, 3)), [prim.message for prim in report.prims]
    stage = Usd.Stage.Open(str(folder / "out.usda"))
    points = UsdGeom.Mesh(stage.GetPrimAtPath(BODY)).GetPointsAttr().Get()
    return np.array(points), [prim.message for prim in report.prims]


def test_half_that_the_shape_lifts_keeps_more_points(tmp_path):
    shaped_stage(tmp_path)
    plain, _ = simplified(tmp_path, ratio=0.25)
    weighted, _ = simplified(tmp_path, ratio=0.25, morph_weights="thirds")
    assert (weighted[:, 0] < 4).mean() > (plain[:, 0] < 4).mean()


def test_usage_without_an_animation_names_the_mesh(tmp_path):
    stage = shaped_stage(tmp_path)
    stage.RemovePrim("/Char/Rig/Anim")
    stage.Save()
    _, messages = simplified(tmp_path, morph_weights="usage")
    assert messages == [f"{BODY}: no animation drives its blend shapes, so that their usage is not known"]


def test_stage_with_nothing_to_morph_is_refused(tmp_path):
    cloth_stage(tmp_path / "in.usda", times=None)
    with pytest.raises(OptionError, match="none of the 1 meshes has blend shapes or several poses"):
        simplified(tmp_path, morph_weights="thirds")
