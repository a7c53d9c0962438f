"""The overview of a batch."""

from __future__ import annotations

import base64
import io
import json
import re
from shutil import copyfile

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from tests.support.usd_stages import cloth_stage
from warpqem.cli.main import app
from warpqem.report.overview import Asset, overview_page
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.commands.overview import SIZE, write_overview


def data_of(page: str) -> dict:
    return json.loads(re.search(r'id="data">(.*?)</script>', page, re.S)[1])


def result(folder, name: str, status: str = "done", **others: object) -> dict:
    found = {
        "input": str(folder / f"{name}.usda"), "output": str(folder / "out" / f"{name}.usda"), "status": status,
        "message": None, "seconds": 1.0, "faces": 128, "faces_after": 64, "report": None,
    }  # fmt: skip
    return {**found, **others}


@pytest.fixture
def done(tmp_path) -> dict:
    cloth_stage(tmp_path / "b.usda")
    (tmp_path / "out").mkdir()
    options = SimplifyOptions(ratio=0.5, device="cpu")
    report = simplify_stage(tmp_path / "b.usda", tmp_path / "out" / "b.usda", options)
    return result(tmp_path, "b", report=report.to_dict())


def overview(folder, results: list[dict]) -> dict:
    write_overview(folder / "page.html", results, device="cpu")
    return data_of((folder / "page.html").read_text("utf-8"))


def test_assets_have_figures_pictures_and_a_link(done, tmp_path):
    [asset] = overview(tmp_path, [done])["assets"]
    assert (asset["name"], asset["link"], asset["faces_after"]) == ("b.usda", "out/b.usda", 64)
    measured = done["report"]["prims"][0]["measured"]
    assert [asset[name] for name in ("rms", "hausdorff", "flips", "verdict")] == [
        measured[name] for name in ("rms", "hausdorff", "flips", "verdict")
    ]
    before, after = (
        np.asarray(Image.open(io.BytesIO(base64.b64decode(text.split(",")[1]))).convert("RGB"))
        for text in asset["pictures"]
    )
    assert before.shape == (SIZE[1], SIZE[0], 3)
    assert (before != after).any()


def of_verdict(done: dict, tmp_path, name: str, **measured) -> dict:
    prim = done["report"]["prims"][0]
    report = {**done["report"], "prims": [{**prim, "measured": {**prim["measured"], **measured}}]}
    return {**done, "input": str(tmp_path / f"{name}.usda"), "report": report}


def test_assets_link_to_reports_of_their_own(done, tmp_path, monkeypatch):
    # Names that are the same as those of files in a folder.
    (tmp_path / "x").mkdir()
    for name in ("x/b.usda", "x_b.usda"):
        copyfile(tmp_path / "b.usda", tmp_path / name)
    twice = [{**done, "input": str(tmp_path / name)} for name in ("x/b.usda", "x_b.usda")]
    pages = [asset["page"] for asset in overview(tmp_path, twice)["assets"]]
    assert pages == ["page_pages/x_b.usda.html", "page_pages/x_b.usda_2.html"]
    for name in pages:
        data = data_of((tmp_path / name).read_text("utf-8"))
        assert (data["original"]["faces"], data["levels"][0]["faces"]) == (128, 64)
        assert (
            data["levels"][0]["meshes"]["/Root/Cloth"]["verdict"] == done["report"]["prims"][0]["measured"]["verdict"]
        )
    monkeypatch.setattr("warpqem.usd.commands.overview.MAX_PAGES", 1)
    data = overview(tmp_path, twice)
    assert [asset["page"] for asset in data["assets"]] == [pages[0], ""]
    assert data["notes"][-1] == "The first 1 have a report of their own."


def test_report_of_an_asset_replaces_no_input(done, tmp_path):
    (tmp_path / "page_pages").mkdir()
    needed = tmp_path / "page_pages" / "b.usda.html"
    needed.write_text("needed")
    result = {**done, "fingerprint": {"files": {str(needed): ""}}}
    [asset] = overview(tmp_path, [result])["assets"]
    assert (asset["page"], asset["message"].startswith("no report of its own: ")) == ("", True)
    assert len(asset["pictures"]) == 2
    assert needed.read_text() == "needed"


def test_assets_come_with_the_worst_first_and_equal_ones_by_name(done, tmp_path):
    results = [
        of_verdict(done, tmp_path, "d", verdict="good", hausdorff=0.9),
        of_verdict(done, tmp_path, "c", verdict="poor", hausdorff=0.1),
        of_verdict(done, tmp_path, "e", verdict="look", hausdorff=0.5),
        of_verdict(done, tmp_path, "f", verdict="look", hausdorff=0.6),
        result(tmp_path, "z", "failed", message="lost"),
        result(tmp_path, "y", "failed", message="lost"),
    ]
    names = [asset["name"] for asset in overview(tmp_path, results)["assets"]]
    assert names == [f"{name}.usda" for name in "yzcfed"]


def test_failed_asset_has_its_message_and_nothing_to_open(tmp_path):
    [asset] = overview(tmp_path, [result(tmp_path, "a", "failed", message="lost")])["assets"]
    assert (asset["message"], asset["link"], asset["pictures"]) == ("lost", "", [])


def test_asset_that_cannot_be_drawn_says_so(tmp_path):
    [asset] = overview(tmp_path, [result(tmp_path, "gone")])["assets"]
    assert asset["message"].startswith("not drawn: ")


def test_pictures_end_at_a_number_and_the_page_says_so(done, tmp_path, monkeypatch):
    monkeypatch.setattr("warpqem.usd.commands.overview.MAX_PICTURES", 1)
    data = overview(tmp_path, [done, {**done, "input": done["input"] + "z"}])
    assert [len(asset["pictures"]) for asset in data["assets"]] == [2, 0]
    assert data["notes"][-1] == "The first 1 are drawn."


def test_names_are_no_markup():
    page = overview_page("<b>", [Asset("</script><b>", "done")])
    assert "<title>&lt;b&gt;</title>" in page
    assert page.count("</script>") == 2
    assert data_of(page)["assets"][0]["name"] == "</script><b>"


def test_batch_writes_an_overview(tmp_path):
    cloth_stage(tmp_path / "a.usda")
    (tmp_path / "b.usda").write_text("no stage")
    arguments = f"batch {tmp_path}/a.usda {tmp_path}/b.usda -o {tmp_path}/out --ratio 0.5 --device cpu --jobs 1"
    finished = CliRunner().invoke(app, [*arguments.split(), "--report", str(tmp_path / "page.html")])
    assert finished.exit_code == 1
    data = data_of((tmp_path / "page.html").read_text("utf-8"))
    assert [(asset["name"], asset["status"]) for asset in data["assets"]] == [("b.usda", "failed"), ("a.usda", "done")]
