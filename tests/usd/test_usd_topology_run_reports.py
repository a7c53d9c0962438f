"""What info, compare, pictures and pages say of meshes whose topology varies over time."""

from __future__ import annotations

import pytest
from pxr import Usd, UsdGeom

from tests.support import cli
from tests.support.report import data_of
from tests.support.usd_topology_runs import HELD, PATH, capture, check_at, define_capture, simplified
from warpqem.usd import CompareOptions, FrameRange, SimplifyOptions, compare_stages, inspect_stage, simplify_stage
from warpqem.usd.commands.render import RenderOptions, render_sheet
from warpqem.usd.commands.report_page import stage_report, write_compare_report, write_simplify_report


def test_info_describes_the_runs(tmp_path):
    capture(tmp_path / "in.usda", [10, 12, 9], 4)
    [info] = inspect_stage(tmp_path / "in.usda")
    assert (info.runs, info.frames, info.first_time, info.last_time) == (3, 12, 0, 11)
    assert (info.faces, info.triangles, info.subsets, info.uv_sets) == (100, 200, ["half"], ["st"])
    assert info.problems == [
        "topology varies over time: 3 runs of constant topology (81 to 144 faces); "
        "the figures are those of times 0 to 3"
    ]


def test_comparison_goes_run_by_run(tmp_path):
    capture(tmp_path / "in.usda", [10, 14], 4)
    simplified(tmp_path, ratio=0.3)
    heatmap = tmp_path / "heat.usda"
    options = CompareOptions(samples=2000, device="cpu", heatmap=str(heatmap))
    [pair] = compare_stages(tmp_path / "in.usda", tmp_path / "out.usda", options)
    assert pair.message is None
    assert pair.times == list(range(8))
    assert pair.comparison.frame_count == len(pair.comparison.per_frame.rms) == 8
    assert 0 < pair.comparison.rms < 1
    assert pair.comparison.jitter is not None
    stage = Usd.Stage.Open(str(heatmap))
    HELD.append(stage)
    check_at(UsdGeom.Mesh(stage.GetPrimAtPath(PATH)), 5.0)


def test_comparison_of_a_mesh_with_itself_finds_nothing(tmp_path):
    capture(tmp_path / "in.usda", [10, 14], 2)
    [pair] = compare_stages(tmp_path / "in.usda", tmp_path / "in.usda", CompareOptions(samples=500, device="cpu"))
    assert pair.comparison.hausdorff < 1e-3


def test_pictures_show_each_topology(tmp_path):
    capture(tmp_path / "in.usda", [6, 9], 2)
    simplified(tmp_path, ratio=0.3)
    options = RenderOptions(pictures=4, size=(80, 60), device="cpu", heatmap=True)
    scale = render_sheet(tmp_path / "out.usda", tmp_path / "sheet.png", options, tmp_path / "in.usda")
    assert 0 < scale < 10


def test_page_with_one_topology_names_what_it_leaves_out(tmp_path):
    capture(tmp_path / "in.usda", [6, 9], 2)
    stage = Usd.Stage.Open(str(tmp_path / "in.usda"))
    define_capture(stage, [8], 2, path="/Root/Other")
    stage.Save()
    options = SimplifyOptions(ratio=0.5, device="cpu")
    report = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", options)
    write_simplify_report(tmp_path / "page.html", report, options)
    assert f"{PATH}: not shown, its topology varies over time" in (tmp_path / "page.html").read_text()


@pytest.mark.parametrize("lods", [None, (0.5, 0.25)], ids=["one", "levels"])
def test_page_of_nothing_else_shows_the_longest_run_and_figures_of_all(tmp_path, lods):
    capture(tmp_path / "in.usda", [6, 9, 7], 2)
    options = SimplifyOptions(ratio=None if lods else 0.5, lods=lods or (), device="cpu", frames=FrameRange(1, 5))
    report = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", options)
    write_simplify_report(tmp_path / "page.html", report, options)
    page = data_of((tmp_path / "page.html").read_text())
    assert page["times"] == [2.0, 3.0]
    assert page["original"]["faces"] == 2 * 9 * 9
    assert len(page["levels"]) == len(report.prims)
    assert [level["measures"]["rms"] for level in page["levels"]] == [prim.measured["rms"] for prim in report.prims]
    assert any("Picture and curves are of times 2 to 3, 2 of 5 frames" in note for note in page["notes"])


def test_page_of_a_comparison_shows_a_run_that_both_files_have(tmp_path):
    capture(tmp_path / "in.usda", [6, 9], 3)
    simplified(tmp_path, ratio=0.5)
    pairs = compare_stages(str(tmp_path / "in.usda"), str(tmp_path / "out.usda"), CompareOptions(device="cpu"))
    write_compare_report(
        tmp_path / "page.html",
        str(tmp_path / "in.usda"),
        str(tmp_path / "out.usda"),
        pairs,
        CompareOptions(device="cpu"),
    )
    page = data_of((tmp_path / "page.html").read_text())
    assert page["times"] == [0.0, 1.0, 2.0]
    assert page["levels"][0]["measures"]["rms"] == pairs[0].comparison.rms


def test_page_of_topologies_that_differ_in_each_frame_shows_one(tmp_path):
    capture(tmp_path / "in.usda", [6, 9, 7], 1)
    report = stage_report(str(tmp_path / "in.usda"))
    assert (report.times, report.points.shape[0], len(report.faces)) == ([0.0], 1, 72)


def test_commands_with_a_report_of_nothing_else_end_well(tmp_path):
    capture(tmp_path / "in.usda", [6, 9], 2)
    files = (tmp_path / "in.usda", "-o", tmp_path / "out.usda")
    done = cli.run("simplify", *files, "--ratio", 0.5, "--device", "cpu", "--report", tmp_path / "page.html")
    assert done.exit_code == 0, done.stderr
    options = ("--device", "cpu", "--report", tmp_path / "both.html", "--heatmap", tmp_path / "heat.usda")
    done = cli.run("compare", tmp_path / "in.usda", tmp_path / "out.usda", *options)
    assert done.exit_code == 0, done.stderr
    assert all((tmp_path / name).exists() for name in ("page.html", "both.html", "heat.usda"))
