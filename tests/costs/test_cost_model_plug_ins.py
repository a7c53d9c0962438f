"""Cost models of other packages: the example of CONTRIBUTING.md, installed as a distribution would be."""

from __future__ import annotations

import importlib
import json
import os
import re
import subprocess
import sys
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np
import pytest

import warpqem
from tests.support import meshes
from tests.support.usd_stages import cloth_stage
from warpqem.costs.models import COST_MODELS, CostModelSpec, cost_model, cost_model_names
from warpqem.errors import OptionError
from warpqem.usd import SimplifyOptions, simplify_stage

GUIDE = Path(__file__).resolve().parents[2] / "CONTRIBUTING.md"


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", GUIDE.read_text("utf-8"), re.S)


@pytest.fixture
def site(tmp_path, monkeypatch):
    """A folder for packages on sys.path that pip could have installed the guide's example into."""
    [module] = [block for block in blocks("python") if "CostModelSpec" in block]
    folder = tmp_path / "site"
    information = folder / "speedy-1.0.dist-info"
    information.mkdir(parents=True)
    (folder / "speedy.py").write_text(module, "utf-8")
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: speedy\nVersion: 1.0\n", "utf-8")
    [project] = [block for block in blocks("toml") if "entry-points" in block]
    table = re.search(r'\[project.entry-points."(.*)"\]\n(\w+) = "(.*)"', project)
    (information / "entry_points.txt").write_text(f"[{table[1]}]\n{table[2]} = {table[3]}\n", "utf-8")
    monkeypatch.syspath_prepend(str(folder))
    importlib.invalidate_caches()
    yield folder
    sys.modules.pop("speedy", None)


def add_model(site: Path, name: str, value: str) -> None:
    information = site / f"{name}-1.0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n", "utf-8")
    (information / "entry_points.txt").write_text(f"[warpqem.cost_models]\n{name} = {value}\n", "utf-8")


def half_still() -> tuple[np.ndarray, np.ndarray]:
    """A rough sheet whose right half moves as a whole, so that its shape is the same everywhere and always."""
    points, faces = meshes.grid(20, 20)
    points = np.asarray(points, dtype=np.float64)
    points[:, 2] += 0.2 * np.sin(7.0 * points[:, 0]) * np.cos(5.0 * points[:, 1])
    moving = points.copy()
    moving[points[:, 0] > points[:, 0].mean(), 2] += 5.0
    return np.stack([points, moving]).astype(np.float32), faces


def test_example_has_less_than_50_lines(site):
    lines = [line for line in (site / "speedy.py").read_text("utf-8").splitlines() if line.strip()]
    assert len(lines) < 50


def test_plug_in_is_listed_after_the_others(site):
    assert cost_model_names() == (*COST_MODELS, "speed")


def test_packages_are_looked_through_once(site, monkeypatch):
    looks = []
    monkeypatch.setattr(
        "warpqem.costs.models.entry_points", lambda **group: looks.append(group) or entry_points(**group)
    )
    assert cost_model_names() == cost_model_names()
    assert cost_model("speed").name == "speed"
    assert len(looks) == 1


def test_plug_in_works_in_the_api(site):
    points, faces = half_still()
    share = {}
    for metric in ("dsd", "speed"):
        result = warpqem.simplify(points, faces, ratio=0.3, metric=metric, device="cpu")
        share[metric] = (result.points[0, :, 0] > points[0, :, 0].mean()).mean()
    assert share["speed"] > share["dsd"] + 0.1


def test_plug_in_appears_in_the_command_line_and_in_the_report(site, tmp_path):
    cloth_stage(tmp_path / "in.usda")
    environment = {**os.environ, "PYTHONPATH": str(site)}

    def call(*arguments: str) -> subprocess.CompletedProcess:
        command = [sys.executable, "-m", "warpqem", *arguments]
        return subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)

    assert "speed" in re.sub(
        r"\s", "", call("simplify", "--help-all").stdout.split("--metric")[1].split("--coherence")[0]
    )
    options = "--ratio 0.5 --metric speed --device cpu --report page.html"
    done = call("simplify", "in.usda", "-o", "out.usda", *options.split())
    assert done.returncode == 0, done.stderr
    data = json.loads(re.search(r'id="data">(.*?)</script>', (tmp_path / "page.html").read_text("utf-8"), re.S)[1])
    options = dict(next(table for table in data["tables"] if table["title"] == "Options")["rows"])
    assert options["metric"].startswith("speed (")


def test_names_of_warpqem_cannot_be_taken(site):
    add_model(site, "dsd", "speedy:speed")
    assert cost_model("dsd") is COST_MODELS["dsd"]


def test_plug_in_that_cannot_be_loaded_is_named(site):
    add_model(site, "lost", "nowhere_at_all:model")
    with pytest.raises(OptionError, match="metric 'lost' of nowhere_at_all:model cannot be loaded"):
        cost_model("lost")


def test_plug_in_of_another_type_is_named(site):
    add_model(site, "other", "json:dumps")
    with pytest.raises(OptionError, match="is a function, expected a CostModelSpec"):
        cost_model("other")


@pytest.mark.parametrize(
    ("weights", "message"),
    [("numpy.ones(3)", r"shape \(3,\), expected 25"), ("-numpy.ones(len(points[0]))", "-1.0 at vertex 0"),
     ("points[0, :, 0] * numpy.nan", "nan at vertex 0")],
)  # fmt: skip
def test_weights_that_are_none_are_refused(site, weights, message):
    (site / "speedy.py").write_text(
        "import numpy\nfrom warpqem.costs import CostModelSpec\n"
        f"speed = CostModelSpec('speed', vertex_weight=lambda points, faces: {weights})\n"
    )
    points, faces = meshes.grid(4, 4)
    with pytest.raises(OptionError, match=message):
        warpqem.simplify(points, faces, ratio=0.5, metric="speed", device="cpu")


def by_motion(points, faces):
    way = np.linalg.norm(np.diff(points, axis=0), axis=2).sum(axis=0)
    return 1.0 + 19.0 * way / max(float(way.max()), 1e-30)


@pytest.mark.parametrize("as_spec", [False, True])
def test_a_function_or_a_spec_is_a_cost_model(site, as_spec):
    points, faces = half_still()
    metric = CostModelSpec("by_motion", vertex_weight=by_motion) if as_spec else by_motion
    given, named = (warpqem.simplify(points, faces, ratio=0.3, device="cpu", metric=m) for m in (metric, "speed"))
    assert np.array_equal(given.points, named.points)
    assert not np.array_equal(given.points, warpqem.simplify(points, faces, ratio=0.3, device="cpu").points)


def test_any_call_may_have_a_function_as_metric():
    points, faces = half_still()
    first = warpqem.simplify_levels(points, faces, ratios=[0.3], device="cpu", metric=by_motion)[0]
    assert np.array_equal(first.faces, warpqem.simplify(points, faces, ratio=0.3, device="cpu", metric=by_motion).faces)
    assert warpqem.plan(points, faces, ratio=0.3, device="cpu", metric=by_motion).key_frames == 2


def test_a_stage_takes_a_function_and_its_report_the_name(tmp_path):
    cloth_stage(tmp_path / "in.usda").Save()
    options = SimplifyOptions(ratio=0.3, metric=by_motion, device="cpu")
    report = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", options)
    assert report.run["options"]["metric"] == "by_motion"
    assert json.loads(json.dumps(report.to_dict()))["run"]["options"]["metric"] == "by_motion"


def test_wrong_weights_of_a_function_are_named_by_it():
    def by_nothing(points, faces):
        return -np.ones(points.shape[1])

    with pytest.raises(OptionError, match="metric 'by_nothing': vertex_weight gave"):
        warpqem.simplify(*half_still(), ratio=0.3, device="cpu", metric=by_nothing)


def test_a_batch_refuses_a_function_which_its_processes_do_not_know(tmp_path):
    job = warpqem.BatchJob("in.usda", "out.usda", SimplifyOptions(ratio=0.5, metric=by_motion))
    with pytest.raises(OptionError, match=r"jobs\[0\].options.metric must be a name"):
        warpqem.batch([job])
