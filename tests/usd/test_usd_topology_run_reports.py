"""What info, compare, pictures and pages say of meshes whose topology varies over time."""

from __future__ import annotations

import pytest
from pxr import Usd, UsdGeom

from tests.support.usd_topology_runs import HELD, PATH, capture, check_at, define_capture, simplified
from warpqem.errors import StageError
from warpqem.usd import CompareOptions, SimplifyOptions, compare_stages, inspect_stage, simplify_stage
from warpqem.usd.commands.render import RenderOptions, render_sheet
from warpqem.usd.commands.report_page import write_simplify_report


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


def test_page_of_nothing_else_says_so(tmp_path):
    capture(tmp_path / "in.usda", [6, 9], 2)
    options = SimplifyOptions(ratio=0.5, device="cpu")
    report = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", options)
    with pytest.raises(StageError, match=f"{PATH}: its topology varies over time"):
        write_simplify_report(tmp_path / "page.html", report, options)
