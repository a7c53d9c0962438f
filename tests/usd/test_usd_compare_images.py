"""Comparing what files look like."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from pxr import Gf, Usd, UsdGeom, UsdSkel, Vt

from tests.support import meshes
from tests.support.cli import run
from tests.support.usd_normal_maps import bake
from tests.support.usd_rig import FRAMES, TUBE, shaped_rig
from tests.support.usd_stages import cloth_stage, define_cloth
from tests.support.usd_textured import sheet_stage
from warpqem.errors import OptionError, StageError
from warpqem.mesh.smooth_normals import vertex_normals
from warpqem.picture.images import IMAGE_VIEWS
from warpqem.picture.sheet import STRIP
from warpqem.usd import CompareOptions, FrameRange, SimplifyOptions, compare_stage_images, simplify_stage
from warpqem.usd.read.materials import Materials
from warpqem.usd.read.mesh_look import mesh_look
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.shading_normals import shaded_mesh
from warpqem.usd.read.skeleton_poses import StagePoses

SCENES = Path(__file__).resolve().parents[2] / "scenes"
SIZE = 48


def compare(reference: Path, test: Path, **options: object):
    keywords = {name: options.pop(name) for name in ("sheet", "size") if name in options}
    options.setdefault("device", "cpu")
    return compare_stage_images(reference, test, CompareOptions(**options), **{"size": SIZE, **keywords})


def sphere(stage: Usd.Stage, path: str, at: tuple[float, float, float] = (0.0, 0.0, 0.0), **options: object):
    """A mesh without subdivision and normals."""
    points, faces = meshes.icosphere(2)
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy((points + at).astype(np.float32)))
    mesh.CreateFaceVertexCountsAttr([3] * len(faces))
    mesh.CreateFaceVertexIndicesAttr(faces.ravel().tolist())
    mesh.CreateSubdivisionSchemeAttr("none")
    return mesh


def test_less_simplified_scene_looks_more_alike(tmp_path):
    scene = SCENES / "quadruped_gallop.usdc"
    found = []
    for ratio in (0.25, 0.05):
        output = tmp_path / f"{ratio}.usdc"
        simplify_stage(
            scene, output, SimplifyOptions(ratio=ratio, frames=FrameRange(1, 9), measure=False, device="cpu")
        )
        [report] = compare(scene, output, size=128, frames=FrameRange(1, 9))
        assert report.times == [1.0, 5.0, 9.0]
        found.append(report.score)
    near, far = found
    assert near.gray.psnr > far.gray.psnr + 4
    assert near.textured.psnr > far.textured.psnr + 4
    assert near.gray.ssim > far.gray.ssim
    assert 1 > near.silhouette > far.silhouette > 0.9


def test_file_looks_like_itself_on_every_run(tmp_path):
    scene = SCENES / "cape_wind.usdc"
    found = [compare(scene, scene)[0].to_dict() for _ in range(2)]
    assert found[0] == found[1]
    assert found[0]["score"]["gray"] == {"psnr": None, "ssim": pytest.approx(1.0)}
    assert found[0]["score"]["silhouette"] == 1.0


def test_normals_of_skin_and_blend_shapes_are_those_that_usd_bakes(tmp_path):
    stage = shaped_rig(tmp_path / "rig.usda")
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(TUBE))
    rest = np.array(mesh.GetPointsAttr().Get())
    faces = np.array(mesh.GetFaceVertexIndicesAttr().Get(), dtype=np.int32).reshape(-1, 3)
    normals = vertex_normals(rest, faces)
    mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(normals))
    mesh.SetNormalsInterpolation("vertex")
    generator = np.random.default_rng(1)
    for prim in mesh.GetPrim().GetChildren():
        offsets = generator.normal(0.0, 0.5, rest.shape).astype(np.float32)
        UsdSkel.BlendShape(prim).CreateNormalOffsetsAttr(Vt.Vec3fArray.FromNumpy(offsets))
    stage.Save()
    flat = Usd.Stage.Open(stage.Flatten())
    assert UsdSkel.BakeSkinning(flat.Traverse())
    baked = UsdGeom.Mesh(flat.GetPrimAtPath(TUBE)).GetNormalsAttr()
    source = MeshSource(mesh.GetPrim(), StagePoses(stage))
    for time in FRAMES[::4]:
        expected = np.array(baked.Get(time), dtype=np.float64)
        expected /= np.linalg.norm(expected, axis=1, keepdims=True)
        found = shaded_mesh(source, mesh_look(source, Materials(), time), time).normals
        np.testing.assert_allclose(found, expected[faces], atol=1e-5)
        assert np.abs(expected - normals).max() > 0.1


def test_creases_of_a_subdivision_surface_stay_hard(tmp_path):
    stage = Usd.Stage.CreateInMemory()
    mesh = UsdGeom.Mesh.Define(stage, "/Roof")
    mesh.CreatePointsAttr([(0, 0, 0), (0, 0, 1), (1, 1, 0), (1, 1, 1), (2, 0, 0), (2, 0, 1)])
    mesh.CreateFaceVertexCountsAttr([3] * 4)
    mesh.CreateFaceVertexIndicesAttr([0, 1, 2, 2, 1, 3, 2, 3, 4, 4, 3, 5])

    def steps() -> float:
        source = MeshSource(mesh.GetPrim(), StagePoses(stage))
        normals = shaded_mesh(source, mesh_look(source, Materials()), None).normals
        return float(np.abs(normals[1, 0] - normals[2, 0]).max())

    assert steps() == pytest.approx(0.0, abs=1e-6)
    mesh.CreateCreaseIndicesAttr([2, 3])
    mesh.CreateCreaseLengthsAttr([2])
    mesh.CreateCreaseSharpnessesAttr([10.0])
    assert steps() > 1.0


def test_mesh_shows_where_it_is_visible(tmp_path):
    for name, hidden in (("a.usda", False), ("b.usda", True)):
        stage = cloth_stage(tmp_path / name)
        ball = sphere(stage, "/Root/Ball", at=(0.0, 0.0, 3.0))
        visibility = UsdGeom.Imageable(ball).CreateVisibilityAttr()
        for time in (1.0, 2.0, 3.0, 4.0):
            visibility.Set("invisible" if hidden and time < 4.0 else "inherited", time)
        stage.Save()
    first, last = FrameRange(1, 1), FrameRange(4, 4)
    assert compare(tmp_path / "a.usda", tmp_path / "b.usda", frames=first)[0].score.silhouette < 0.98
    assert compare(tmp_path / "a.usda", tmp_path / "b.usda", frames=last)[0].score.silhouette == 1.0


def test_mesh_that_one_file_alone_has_is_a_difference(tmp_path):
    cloth_stage(tmp_path / "a.usda").Save()
    stage = cloth_stage(tmp_path / "b.usda")
    sphere(stage, "/Root/Ball", at=(0.0, 0.0, 3.0))
    stage.Save()
    for pair in (("a.usda", "b.usda"), ("b.usda", "a.usda")):
        [report] = compare(*(tmp_path / name for name in pair))
        assert report.message is None
        assert report.score.silhouette < 0.98


def test_instances_show_at_every_place(tmp_path):
    for name, scale in (("a.usda", 1.0), ("b.usda", 0.7)):
        stage = Usd.Stage.CreateNew(str(tmp_path / name))
        stage.CreateClassPrim("/Source")
        define_cloth(stage, "/Source/Cloth")
        for index in range(3):
            place = UsdGeom.Xform.Define(stage, f"/Places/P{index}")
            place.AddTranslateOp().Set(Gf.Vec3d(30.0 * index, 0, 0))
            place.AddScaleOp().Set(Gf.Vec3f(scale if index == 2 else 1.0))
            place.GetPrim().GetReferences().AddInternalReference("/Source")
            place.GetPrim().SetInstanceable(True)
        stage.Save()
    [report] = compare(tmp_path / "a.usda", tmp_path / "b.usda")
    # A third of the picture is half as large.
    assert 0.7 < report.score.silhouette < 0.95


def test_error_names_the_prim(tmp_path):
    stage = cloth_stage(tmp_path / "a.usda")
    points = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth")).GetPointsAttr()
    cloth_stage(tmp_path / "b.usda").Save()
    broken = list(points.Get(1.0))
    broken[3] = Gf.Vec3f(float("nan"), 0, 0)
    points.Set(broken, 1.0)
    stage.Save()
    [report] = compare(tmp_path / "a.usda", tmp_path / "b.usda")
    assert report.score is None
    assert report.message.startswith("pictures: /Root/Cloth.points: point 3 at time 1")


def test_sheet_shows_both_files_and_their_difference(tmp_path):
    scene = SCENES / "cape_wind.usdc"
    [report] = compare(scene, scene, sheet=tmp_path / "sheet.png", frames=FrameRange(1, 1))
    assert report.score is not None
    with Image.open(tmp_path / "sheet.png") as image:
        pixels = np.array(image)
    assert pixels.shape == (len(IMAGE_VIEWS) * (SIZE + STRIP), 6 * SIZE, 3)
    reference, test, difference = (pixels[STRIP : STRIP + SIZE, k * SIZE : (k + 1) * SIZE] for k in range(3))
    assert (reference == test).all()
    assert not difference.any()


def test_sheet_is_a_png_and_no_input(tmp_path):
    cloth_stage(tmp_path / "a.usda").Save()
    with pytest.raises(OptionError, match=r"image sheet .*a.usda: the suffix must be .png"):
        compare(tmp_path / "a.usda", tmp_path / "a.usda", sheet=tmp_path / "a.usda")
    (tmp_path / "b.png").mkdir()
    with pytest.raises(OptionError, match=r"image sheet .*folder"):
        compare(tmp_path / "a.usda", tmp_path / "a.usda", sheet=tmp_path / "b.png")
    with pytest.raises(StageError, match=r"missing.usda"):
        compare(tmp_path / "a.usda", tmp_path / "missing.usda")


def test_levels_have_a_score_each(tmp_path):
    options = SimplifyOptions(frames=FrameRange(1, 3), lods=(0.5, 0.1), measure=False, device="cpu")
    simplify_stage(SCENES / "cape_wind.usdc", tmp_path / "levels.usdc", options)
    found = compare(SCENES / "cape_wind.usdc", tmp_path / "levels.usdc", all_lods=True, frames=FrameRange(1, 3))
    assert [report.level for report in found] == ["LOD1", "LOD2"]
    assert found[0].score.gray.psnr > found[1].score.gray.psnr


def test_command_line_prints_and_writes_the_score(tmp_path):
    cloth_stage(tmp_path / "a.usda").Save()
    stage = cloth_stage(tmp_path / "b.usda")
    sphere(stage, "/Root/Cloth/Ball", at=(0.0, 0.0, 3.0))
    stage.RemovePrim("/Root/Cloth/Ball")
    stage.Save()
    done = run("compare", tmp_path / "a.usda", tmp_path / "b.usda", "--images", "--json", tmp_path / "out.json")
    assert done.exit_code == 0, done.output
    lines = [line.split() for line in done.output.splitlines()]
    assert ["surface", "PSNR", "dB", "SSIM", "silhouettes"] in lines
    assert ["gray", "equal", "1.0000", "1.0000"] in lines
    [score] = json.loads((tmp_path / "out.json").read_text())["images"]
    assert score["score"]["gray"]["psnr"] is None
    assert score["score"]["frame_count"] == len(score["times"]) == 3
    plain = run("compare", tmp_path / "a.usda", tmp_path / "b.usda", "--json", tmp_path / "plain.json")
    assert plain.exit_code == 0
    assert "images" not in json.loads((tmp_path / "plain.json").read_text())


def test_normal_maps_are_drawn(tmp_path):
    sheet_stage(tmp_path / "in.usda")
    plain, mapped = tmp_path / "plain.usda", tmp_path / "mapped.usda"
    simplify_stage(tmp_path / "in.usda", plain, SimplifyOptions(ratio=0.05, measure=False, device="cpu"))
    bake(tmp_path / "in.usda", mapped, ratio=0.05, measure=False)
    without, with_map = (compare(tmp_path / "in.usda", path, size=96)[0].score for path in (plain, mapped))
    assert with_map.shading.psnr > without.shading.psnr + 10
    assert with_map.silhouette == without.silhouette
