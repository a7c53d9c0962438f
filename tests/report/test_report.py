"""The HTML report, without a browser."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, UsdGeom, UsdSkel, Vt
from typer.testing import CliRunner

from tests.support import meshes
from tests.support.report import data_of, decode, waving
from tests.support.usd_rig import rig
from tests.support.usd_stages import cloth_stage, define_cloth
from warpqem.cli.main import app
from warpqem.errors import OptionError, StageError
from warpqem.report import Level, Report, Skeleton, Table, chosen_frames, report_data, report_page, write_report
from warpqem.report.data import LARGEST_POSITIONS, MAX_FRAMES
from warpqem.report.encoding import Grid, encode
from warpqem.usd.read.world import WorldMeshes
from warpqem.usd.read.world_rig import skeletons_of


def small_report(**others: object) -> Report:
    points, faces = waving()
    level = Level("half", points + np.float32([0, 0, 0.01]), faces)
    return Report("A & B <c>", points, faces, [level], tables=[Table("T", ("a", "b"), [("</script>", 1.5)])], **others)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.uint32])
def test_packed_arrays_come_back(dtype):
    values = np.random.default_rng(1).integers(0, np.iinfo(dtype).max, (5, 7), dtype=dtype, endpoint=True)
    np.testing.assert_array_equal(decode(encode(values), dtype, values.shape), values)


def test_packing_leaves_the_array_as_it_was():
    values = np.array([[1, 2], [65535, 3]], dtype=np.uint16)
    steps = decode(encode(values, over_time=True), np.uint16, values.shape)
    assert values.tolist() == [[1, 2], [65535, 3]]
    np.testing.assert_array_equal(np.cumsum(steps, axis=0, dtype=np.uint16), values)


def test_positions_are_off_by_half_a_step_at_most():
    points = np.random.default_rng(2).normal(size=(3, 50, 3)) * [100, 1, 1e-3] + [1e4, 0, 0]
    grid = Grid.around(points)
    restored = grid.low + grid.step * grid.round(points)
    assert np.abs(restored - points).max() <= 0.5001 * grid.step
    assert grid.step == pytest.approx(np.ptp(points[..., 0]) / 65535)


def test_mesh_without_extent_has_a_grid():
    grid = Grid.around(np.zeros((1, 4, 3)))
    assert grid.round(np.zeros((1, 4, 3))).tolist() == np.zeros((1, 4, 3)).tolist()


@pytest.mark.parametrize(("frames", "points"), [(48, 9000), (5000, 100), (100, 500_000), (1, 10), (3, 10**7)])
def test_frames_are_thinned_evenly_to_what_there_is_room_for(frames, points):
    chosen = chosen_frames(frames, points)
    assert chosen[0] == 0
    assert len(chosen) <= MAX_FRAMES
    assert len(chosen) <= 2 or len(chosen) * points * 6 <= LARGEST_POSITIONS
    assert len(chosen) * chosen.step >= frames


def test_short_clips_keep_all_frames():
    assert chosen_frames(48, 9000) == range(48)


def test_data_hold_what_the_page_shows():
    report = small_report()
    data = report_data(report, device="cpu")
    [level] = data["levels"]
    assert level["measures"]["perFrame"]["rms"] == pytest.approx([level["measures"]["rms"]] * 4, rel=0.2)
    # No vertex is farther off than the largest distance of the table, and here one is as far.
    assert level["mesh"]["heatScale"] == pytest.approx(level["measures"]["hausdorff"], rel=1e-3)
    assert level["mesh"]["heatScale"] <= data["heatEnd"] <= 1.25 * level["mesh"]["heatScale"]
    heat = decode(level["mesh"]["heat"], np.uint8, (4, len(report.points[0])))
    assert heat.max() == 255
    nodes = np.cumsum(decode(data["original"]["mesh"]["points"], np.uint16, report.points.shape), 0, np.uint16)
    np.testing.assert_allclose(data["grid"]["low"] + data["grid"]["step"] * nodes, report.points, atol=1e-4)
    np.testing.assert_array_equal(decode(level["mesh"]["faces"], np.uint32, report.faces.shape), report.faces)


def test_thinned_frames_have_no_differences_over_time():
    for thinned in (False, True):
        [level] = report_data(small_report(thinned=thinned), device="cpu")["levels"]
        assert (level["measures"]["slide"] is None) == thinned


def test_mesh_of_one_pose_is_shown():
    points, faces = meshes.grid(4, 4)
    data = report_data(
        Report("one", np.asarray(points), faces, [Level("same", np.asarray(points), faces)]), device="cpu"
    )
    assert (data["original"]["frames"], data["original"]["mesh"]["features"]) == (1, None)


@pytest.mark.parametrize(("room", "drawn"), [(10**6, (True, True)), (2500, (False, True)), (100, (False, False))])
def test_what_is_too_large_is_measured_and_named_but_not_drawn(monkeypatch, room, drawn):
    monkeypatch.setattr("warpqem.report.data.LARGEST_MESHES", room)
    data = report_data(small_report(), device="cpu")
    [level] = data["levels"]
    assert (data["original"]["mesh"] is not None, level["mesh"] is not None) == drawn
    assert level["measures"]["rms"] > 0
    assert sum("room for" in note for note in data["notes"]) == 2 - sum(drawn)


def test_markers_are_found_again_on_the_levels():
    points, faces = waving()
    order = np.random.default_rng(3).permutation(len(points[0]))
    moved = Level("other order", points[:, order], np.argsort(order)[faces])
    data = report_data(Report("m", points, faces, [moved], markers={"left": 0, "right": 5}), device="cpu")
    assert (data["markers"], data["original"]["markers"]) == (["left", "right"], [0, 5])
    assert order[data["levels"][0]["markers"]].tolist() == [0, 5]


def test_page_refers_to_nothing_outside():
    page = report_page(report_data(small_report(), device="cpu"))
    assert not re.search(r"<(script|img|iframe)[^>]*\ssrc=|<link[^>]*href=\"(?!data:)|@import|url\(", page)
    assert "%%" not in page[: page.index('id="data"')]


def test_text_of_the_user_is_no_markup():
    page = report_page(report_data(small_report(), device="cpu"))
    assert "<title>A &amp; B &lt;c&gt;</title>" in page
    assert data_of(page)["tables"][0]["rows"] == [["</script>", 1.5]]
    assert page.count("</script>") == 3


def test_equal_reports_are_equal_files(tmp_path):
    for name in ("a.html", "b.html"):
        write_report(tmp_path / name, small_report(), device="cpu")
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()


def test_other_suffix_is_refused(tmp_path):
    with pytest.raises(OptionError, match=r"\.html"):
        write_report(tmp_path / "report.pdf", small_report())


def test_page_that_cannot_be_written_leaves_nothing_behind(tmp_path):
    (tmp_path / "taken.html").mkdir()
    with pytest.raises(StageError, match="cannot be written"):
        write_report(tmp_path / "taken.html", small_report(), device="cpu")
    assert [path.name for path in tmp_path.iterdir()] == ["taken.html"]


def run(*arguments: object) -> object:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_simplify_writes_a_report(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    page = tmp_path / "page.html"
    done = run("simplify", tmp_path / "in.usda", "-o", tmp_path / "out.usda", "--ratio", 0.5, "--device", "cpu",
               "--report", page)  # fmt: skip
    assert done.exit_code == 0, done.stderr
    data = data_of(page.read_text("utf-8"))
    assert (data["original"]["faces"], [level["faces"] for level in data["levels"]]) == (128, [64])
    options = dict(next(table for table in data["tables"] if table["title"] == "Options")["rows"])
    assert (options["ratio"], options["metric"], options["device"]) == ("0.5", "dsd (Mohr & Gleicher 2003)", "cpu")


@pytest.mark.parametrize("schemas", [False, True])
def test_levels_are_all_in_the_report(tmp_path, schemas):
    if schemas:
        pytest.importorskip("pxr.UsdLod")
    cloth_stage(tmp_path / "in.usda")
    page = tmp_path / "page.html"
    form = ["--usd-lod"] if schemas else []
    done = run("simplify", tmp_path / "in.usda", "-o", tmp_path / "out.usda", "--lods", "0.5,0.25", *form,
               "--device", "cpu", "--report", page)  # fmt: skip
    assert done.exit_code == 0, done.stderr
    levels = data_of(page.read_text("utf-8"))["levels"]
    assert [(level["name"], level["faces"]) for level in levels] == [("LOD1", 64), ("LOD2", 32)]


def test_meshes_that_failed_are_notes_not_pictures(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    define_cloth(stage, "/Root/Broken").GetFaceVertexCountsAttr().Set([4])
    stage.Save()
    page = tmp_path / "page.html"
    done = run("simplify", tmp_path / "in.usda", "-o", tmp_path / "out.usda", "--ratio", 0.5, "--device", "cpu",
               "--report", page)  # fmt: skip
    assert done.exit_code == 1
    data = data_of(page.read_text("utf-8"))
    assert data["original"]["faces"] == 128
    assert any(note.startswith("/Root/Broken") for note in data["notes"])


def test_report_on_a_face_marks_its_feature_points(tmp_path):
    scene = Path(__file__).resolve().parents[2] / "scenes" / "talking_head.usdc"
    page = tmp_path / "page.html"
    done = run("simplify", scene, "-o", tmp_path / "out.usda", "--ratio", 0.1, "--metric", "face", "--frames", "1:3",
               "--device", "cpu", "--report", page)  # fmt: skip
    assert done.exit_code == 0, done.stderr
    data = data_of(page.read_text("utf-8"))
    assert {"nose_tip", "chin"} <= set(data["markers"])
    assert len(set(data["levels"][0]["markers"])) == len(data["markers"])


def test_compare_writes_a_report(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    page = tmp_path / "page.html"
    done = run("compare", tmp_path / "in.usda", tmp_path / "in.usda", "--samples", 100, "--device", "cpu",
               "--report", page)  # fmt: skip
    assert done.exit_code == 0, done.stderr
    [level] = data_of(page.read_text("utf-8"))["levels"]
    assert level["measures"]["rms"] < 1e-4


def test_pages_of_simplify_and_compare_say_the_same_of_texture_and_motion(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth"))
    st = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.vertex)
    st.Set(Vt.Vec2fArray.FromNumpy(np.array(mesh.GetPointsAttr().Get(1.0))[:, :2].copy()))
    stage.Save()
    files = tmp_path / "in.usda", tmp_path / "out.usda"
    pages = tmp_path / "simplify.html", tmp_path / "compare.html"
    assert run("simplify", files[0], "-o", files[1], "--ratio", 0.5, "--report", pages[0]).exit_code == 0
    assert run("compare", *files, "--report", pages[1]).exit_code == 0
    one, other = (data_of(page.read_text("utf-8")) for page in pages)
    looks = [[t for t in data["tables"] if t["title"] == "Texture, shading and colours"] for data in (one, other)]
    assert looks[0] == looks[1]
    [row] = looks[0][0]["rows"]
    assert row[1] == "st"
    assert row[5] == "UV"
    assert row[6] > 0
    assert one["levels"][0]["measures"] == other["levels"][0]["measures"]
    assert one["levels"][0]["measures"]["slideP95"] > 0
    assert any(note == "/Root/Cloth: colors: none, as neither mesh has colours" for note in one["notes"])


def test_other_suffix_of_a_report_is_wrong_usage_before_any_work(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    done = run("simplify", tmp_path / "in.usda", "-o", tmp_path / "out.usda", "--ratio", 0.5, "--report", "page.txt")
    assert done.exit_code == 2
    assert not (tmp_path / "out.usda").exists()


def test_bundle_is_of_the_version_that_its_build_names():
    from importlib.resources import files

    web = files("warpqem.report") / "web"
    if not web.is_dir():
        pytest.skip("an installed package has no build folder")
    wanted = json.loads((web / "package.json").read_text("utf-8"))["devDependencies"]["three"]
    bundle = (files("warpqem.report") / "assets" / "three.min.js").read_text("utf-8")
    assert f'"{wanted.split(".")[1]}"' in bundle
    assert "SPDX-License-Identifier: MIT" in bundle


def test_skeletons_say_which_joints_move_what():
    points, faces = waving()
    places = np.arange(4 * 3 * 3, dtype=np.float64).reshape(4, 3, 3)
    skeleton = Skeleton("/Rig", ["a", "a/b", "a/c"], np.array([-1, 0, 0]), places, {"a", "a/b"})
    levels = [Level("one", points, faces), Level("two", points, faces, used_joints={"/Rig": {"a"}}),
              Level("three", points, faces, used_joints={})]  # fmt: skip
    data = report_data(Report("rig", points, faces, levels, skeletons=[skeleton]), device="cpu")
    [found] = data["skeletons"]
    assert (found["parents"], found["used"]) == ([-1, 0, 0], [True, True, False])
    nodes = np.cumsum(decode(found["points"], np.uint16, places.shape), 0, np.uint16)
    np.testing.assert_allclose(found["grid"]["low"] + found["grid"]["step"] * nodes, places, atol=1e-3)
    assert [level["joints"] for level in data["levels"]] == [
        [[True, True, False]], [[True, False, False]], [[False, False, False]]
    ]  # fmt: skip


def test_reports_of_rigs_have_joints_sizes_and_curves(tmp_path):
    rig(tmp_path / "in.usda").Save()
    page = tmp_path / "page.html"
    done = run("simplify", tmp_path / "in.usda", "-o", tmp_path / "out.usda", "--lods", "0.5,0.25", "--joints", "3,2",
               "--device", "cpu", "--report", page)  # fmt: skip
    assert done.exit_code == 0, done.stderr
    data = data_of(page.read_text("utf-8"))
    table = next(table for table in data["tables"] if table["title"] == "Size and rig")
    assert table["head"] == ["level", "joints", "influences", "blend shapes", "KB"]
    before = sum(data["skeletons"][0]["used"])
    assert [row[:2] for row in table["rows"]] == [["original", before], ["LOD1", 3], ["LOD2", 2]]
    sizes = [row[4] for row in table["rows"]]
    assert sizes == sorted(sizes, reverse=True)
    assert [sum(level["joints"][0]) for level in data["levels"]] == [3, 2]
    [curve] = data["curves"]
    assert curve["title"] == "Error over joints"
    assert [(line["x"][0], line["x"][-1]) for line in curve["series"]] == [(before, 3), (before, 2)]


def test_joints_are_where_the_skeleton_has_them(tmp_path):
    stage = rig(tmp_path / "in.usda")
    [found] = skeletons_of(WorldMeshes("in.usda", stage=stage).sources, [2.0])
    cache = UsdSkel.Cache()
    query = cache.GetSkelQuery(UsdSkel.Skeleton(stage.GetPrimAtPath(found.name)))
    world = np.array(UsdGeom.XformCache(2.0).GetLocalToWorldTransform(query.GetPrim()))
    expected = [(np.array(matrix) @ world)[3, :3] for matrix in query.ComputeJointSkelTransforms(2.0)]
    np.testing.assert_allclose(found.points[0], expected, atol=1e-9)
    assert list(found.joints) == list(query.GetJointOrder())
