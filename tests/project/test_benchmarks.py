"""The logic of the benchmarks: figures, turns, floors, reports. How fast anything is, is no test's business."""

import itertools
import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest
import warp as wp
from pxr import Usd, UsdGeom

from benchmarks import images, scaling, stream, turns
from benchmarks.__main__ import parse
from benchmarks.cards import CARDS, H200, card_of
from benchmarks.figures import log_slope, median, ratio_in_turn
from benchmarks.floor import Demand, count_demand, floor_seconds
from benchmarks.floor_options import OPTION_MODELS
from benchmarks.generated import moving_torus
from benchmarks.kernels import kernel_rows
from benchmarks.launches import profile_launches
from benchmarks.machine import describe_host
from benchmarks.quality import measure_quality
from benchmarks.report import Column, Report, Table, markdown_table, write_report
from benchmarks.settings import Settings
from benchmarks.simplified import Simplified, load_simplified, save_simplified
from benchmarks.work import torus_work
from tests.support.usd_stages import cloth_stage
from warpqem import simplify
from warpqem.measure import topology
from warpqem.normal_maps.bake import BakeSurface, bake_normals, overlap_share


@wp.kernel
def do_nothing():
    pass


MACHINE = {
    "cpu": "a CPU",
    "cores": 2,
    "memory_gb": 1.0,
    "gpus": [],
    "system": "a system",
    "load": [0.0],
    "python": "3",
    "commit": "",
    "versions": {"numpy": "2"},
}


def test_median_of_an_even_number_of_turns_lies_between_the_middle_ones():
    assert median([4.0, 1.0, 3.0, 2.0]) == 2.5


def test_a_slow_moment_that_both_share_leaves_their_ratio():
    assert ratio_in_turn([2.0, 20.0, 2.0], [1.0, 10.0, 1.0]) == 2.0


def test_ratio_is_taken_turn_by_turn():
    # The ratio of the medians would be 1.
    assert ratio_in_turn([1.0, 2.0, 6.0], [4.0, 2.0, 2.0]) == 1.0
    assert ratio_in_turn([1.0, 2.0, 4.0], [0.5, 4.0, 2.0]) == 2.0


@pytest.mark.parametrize(("times", "base"), [([], []), ([1.0], [1.0, 2.0])])
def test_ratio_needs_the_same_turns_of_both(times, base):
    with pytest.raises(ValueError, match="same turns of both"):
        ratio_in_turn(times, base)


@pytest.mark.parametrize("power", [0.5, 1.0, 2.0])
def test_slope_is_the_power_that_time_grows_with(power):
    work = np.array([10.0, 200.0, 3000.0])
    assert log_slope(work, 0.3 * work**power) == pytest.approx(power)


def test_slope_needs_two_amounts_of_work():
    assert log_slope([5.0, 5.0], [1.0, 2.0]) is None
    assert log_slope([], []) is None


@pytest.mark.parametrize("face_count", [500, 5000, 40000])
def test_torus_is_closed_and_has_about_the_faces_asked_for(face_count):
    points, faces = moving_torus(face_count, 2)
    found = topology(faces)
    assert abs(len(faces) - face_count) < 0.05 * face_count
    assert (found.border_edges, found.non_manifold_edges, found.euler_number) == (0, 0, 0)
    assert points.shape == (2, len(faces) // 2, 3)


def test_torus_faces_look_outwards():
    points, faces = moving_torus(2000, 1)
    corner = points[0][faces]
    assert np.einsum("ij,ij->i", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])).sum() > 0


@pytest.mark.parametrize("shared", [True, False])
def test_results_come_back_from_disk_as_they_were(tmp_path, shared):
    frames = [np.full((3 + t, 3), t, dtype=np.float32) for t in range(3)]
    faces = [np.array([[0, 1, 2]])] if shared else [np.array([[0, 1, 2]] * (t + 1)) for t in range(3)]
    save_simplified(Simplified(frames, faces), tmp_path / "result.npz")
    result = load_simplified(tmp_path / "result.npz")
    assert result.shares_topology == shared
    for stored, given in ((result.points, frames), (result.faces, faces)):
        assert all(np.array_equal(a, b) for a, b in zip(stored, given, strict=True))


def test_jitter_does_not_depend_on_how_the_topology_is_given():
    work = torus_work(800, 5, 0.5)
    result = simplify(work.points, work.faces, target_faces=work.target_faces, device="cpu")
    once = measure_quality(work, Simplified(list(result.points), [result.faces]), "cpu")
    often = measure_quality(work, Simplified(list(result.points), [result.faces] * 5), "cpu")
    assert often["jitter"] == pytest.approx(once["jitter"], rel=1e-6)
    assert often["rms"] == pytest.approx(once["rms"], rel=0.05)
    assert (often["slide"], often["edge_length_error"]) == (None, None)


class FakeWorker:
    """Notes what it is asked to do instead of starting a process."""

    asked: list[str]

    def __init__(self, name, *_):
        self.name, self.outcome = name, turns.Outcome()

    def note(self, what):
        FakeWorker.asked.append(f"{what} {self.name}")

    def wait_until_ready(self):
        self.note("start")

    def take_turn(self):
        self.note("run")

    def fetch(self):
        self.note("fetch")

    def close(self):
        self.note("close")


def test_contenders_take_turns(monkeypatch):
    FakeWorker.asked = []
    monkeypatch.setattr(turns, "_Worker", FakeWorker)
    turns.run_in_turn(torus_work(100, 1, 0.5), ["a", "b"], turns=2, say=lambda _: None)
    runs = [asked for asked in FakeWorker.asked if asked.startswith("run")]
    assert runs == ["run a", "run b", "run a", "run b"]
    assert FakeWorker.asked[:2] == ["start a", "start b"]


def test_a_contender_that_dies_says_why():
    outcome = turns.run_in_turn(torus_work(100, 1, 0.5), ["nobody"], 1, say=lambda _: None)["nobody"]
    assert "KeyError: 'nobody'" in outcome.failure
    assert (outcome.seconds, outcome.result) == ([], None)


def test_floor_is_the_longer_of_moving_and_computing():
    for card in CARDS:
        most_bytes, most_flops = card.bytes_per_second, card.flops_per_second
        assert floor_seconds(Demand(most_bytes, most_flops / 2), card) == pytest.approx(1.0)
        assert floor_seconds(Demand(most_bytes, most_flops * 2), card) == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("name", "bandwidth"),
    [("NVIDIA H200", H200.bytes_per_second), ("NVIDIA H100 80GB HBM3", 3.35e12), ("NVIDIA H100 PCIe", 2.0e12)],
)
def test_a_card_is_known_by_its_name(name, bandwidth):
    assert card_of(name).bytes_per_second == bandwidth


def test_no_card_hides_behind_a_more_general_one():
    assert [card_of(card.name) for card in CARDS] == list(CARDS)
    assert card_of("AMD EPYC") is None


def test_a_kernel_without_an_entry_has_no_floor():
    assert count_demand("no_such_kernel", {}, 1) is None


@pytest.fixture(scope="module")
def profile():
    work = torus_work(2000, 16, 0.5)
    with profile_launches() as taken:
        result = simplify(work.points, work.faces, target_faces=work.target_faces, device="cpu")
    return work, result, taken


def test_a_profile_does_not_change_the_result(profile):
    work, profiled, _ = profile
    plain = simplify(work.points, work.faces, target_faces=work.target_faces, device="cpu")
    assert np.array_equal(plain.points, profiled.points)
    assert np.array_equal(plain.faces, profiled.faces)


def test_every_kernel_of_a_simplification_has_a_floor(profile):
    table = profile[2].by_kernel()
    assert {"compute_all_costs", "update_neighbourhood_costs", "commit_collapses", "place_vertices"} <= set(table)
    assert [name for name, launches in table.items() if any(demand is None for _, demand in launches)] == []


@pytest.mark.parametrize(
    "options", [{"quality": "best"}, {"quality": "fast", "metric": "dod"}, {"metric": "aqem"}], ids=str
)
def test_every_kernel_of_an_option_has_a_floor_that_is_above_none_and_below_the_whole_mesh(options):
    work = torus_work(600, 6, 0.3)
    with profile_launches() as taken:
        simplify(work.points, work.faces, target_faces=work.target_faces, device="cpu", **options)
    table = taken.by_kernel()
    assert [name for name, launches in table.items() if any(demand is None for _, demand in launches)] == []
    further = set(table) & set(OPTION_MODELS)
    assert further
    # No launch needs more than all matrices of the refit, which are the largest arrays, or all pairs of points.
    most = 1000 * len(work.faces) * len(work.points)
    for name in further:
        assert all(0 <= demand.bytes < most for _, demand in table[name]), name
        assert sum(demand.bytes for _, demand in table[name]) > 0, name


def test_every_kernel_of_a_baked_map_has_a_floor():
    corners = np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])
    surface = BakeSurface(corners, np.broadcast_to([0.0, 0.0, 1.0], (1, 3, 3)), np.zeros(1, int), corners[..., :2])
    with profile_launches() as taken:
        overlap_share(corners[..., :2], 16, device="cpu")
        bake_normals(surface, surface, 16, device="cpu")
    table = taken.by_kernel()
    assert set(table) == {"count_faces_at_texels", "bake_texels", "dilate"}
    assert all(demand.bytes >= 16 * 16 * 4 for launches in table.values() for _, demand in launches)


def test_a_launch_without_threads_is_none():
    with profile_launches() as taken:
        wp.launch(do_nothing, dim=0, inputs=[], device="cpu")
        wp.launch(do_nothing, dim=1, inputs=[], device="cpu")
    assert [entry.kernel for entry in taken.entries] == ["do_nothing"]


def test_parts_of_a_launch_add_up_to_the_whole(profile):
    work, _, taken = profile
    costs = [demand for _, demand in taken.by_kernel()["compute_all_costs"]]
    vertices, half_edges = work.points.shape[1], 3 * len(work.faces)
    assert sum(d.bytes for d in costs) == pytest.approx(vertices * 16 * 52 + 12 * (half_edges + vertices))
    assert sum(d.flops for d in costs) == pytest.approx(half_edges / 2 * 16 * 220)


def test_kernel_shares_add_up(profile):
    *rows, total = kernel_rows(profile[2])
    assert math.isclose(sum(row["share"] for row in rows), 100.0)
    assert total["launches"] == sum(row["launches"] for row in rows)
    assert all(a["milliseconds"] >= b["milliseconds"] for a, b in itertools.pairwise(rows))


def test_sizes_beyond_the_memory_are_skipped_and_named(monkeypatch, tmp_path):
    monkeypatch.setattr(scaling, "available_memory", lambda _: 2 * scaling.predicted_bytes(1000, 4))
    monkeypatch.setattr(
        scaling,
        "_measure",
        lambda faces, frames, _: {"faces_before": faces, "frames": frames, "seconds": 1e-6 * faces, "failure": None},
    )
    report = Report("scaling", "Scaling", MACHINE)
    sizes = [(500, 4), (1000, 4), (100000, 4)]
    scaling._sweep(report, "Faces", sizes, lambda row: row["faces_before"], Settings(tmp_path))
    rows = report.tables[0].rows
    assert [row["faces_before"] for row in rows] == [500, 1000]
    assert rows[1]["local_slope"] == pytest.approx(1.0)
    assert any(note.startswith("100000 faces x 4 frames skipped: may need") for note in report.notes)
    assert any("all sizes: time grows with the power 1.00" in note for note in report.notes)


def test_table_writes_missing_values_as_dashes():
    table = Table("t", (Column("name", "who"), Column("x", "ratio", ".2f")), [{"name": "a|b", "x": 1.0}, {"name": "c"}])
    assert markdown_table(table).splitlines() == ["| who | ratio |", "|---|---:|", "| a\\|b | 1.00 |", "| c | - |"]


def test_a_machine_without_git_has_no_commit(monkeypatch):
    monkeypatch.setenv("PATH", "")
    assert describe_host([])["commit"] == ""


def test_report_holds_the_machine_and_every_figure(tmp_path):
    report = Report(
        "r", "Title", MACHINE, [Table("t", (Column("x", "x", ".1f"),), [{"x": 1.25, "hidden": 3}])], ["left out"]
    )
    markdown, data = write_report(report, tmp_path / "new")
    text = markdown.read_text()
    assert "a CPU, 2 cores" in text
    assert "- left out" in text
    assert json.loads(data.read_text())["tables"][0]["rows"] == [{"x": 1.25, "hidden": 3}]


def test_peers_are_the_default_command(tmp_path):
    command, settings = parse(["--out", str(tmp_path), "--quick"])
    assert (command, settings.quick, settings.turns) == ("peers", True, 2)


@pytest.mark.parametrize("wrong", [["--turns", "0"], ["--ratio", "1.5"], ["nothing"]])
def test_wrong_options_are_refused(wrong, capsys):
    with pytest.raises(SystemExit) as stop:
        parse(wrong)
    assert stop.value.code == 2
    assert wrong[-1] in capsys.readouterr().err


def test_a_clip_holds_the_frames_of_its_torus(tmp_path, monkeypatch):
    monkeypatch.setattr(stream, "UNSAVED_BYTES", 0)
    torus = stream.write_clip(tmp_path / "clip.usdc", 200, 5)
    stage = Usd.Stage.Open(str(tmp_path / "clip.usdc"))
    attribute = UsdGeom.Mesh(stage.GetPrimAtPath(stream.PRIM)).GetPointsAttr()
    points, faces = moving_torus(200, 5)
    np.testing.assert_array_equal([attribute.Get(float(frame)) for frame in range(5)], points)
    np.testing.assert_array_equal(torus.faces, faces)


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="no /proc")
def test_memory_of_a_process_is_its_own():
    held = np.ones(2**24)  # the parent's own
    few, many = (
        stream.run_process([sys.executable, "-c", f"import time; x = bytearray({size}); time.sleep(0.1)"], {})
        for size in (1, 50 * 2**20)
    )
    assert 45 < many.peak_mb - few.peak_mb < 60
    assert 45 < many.private_mb - few.private_mb < 60
    assert many.peak_mb < held.nbytes / 2**20


def test_process_that_fails_is_named_with_its_error():
    with pytest.raises(RuntimeError, match=r"exit code 1: .*ZeroDivisionError"):
        stream.run_process([sys.executable, "-c", "1 / 0"], {})


def test_pictures_of_a_file_are_compared_with_those_of_its_results(tmp_path):
    cloth_stage(tmp_path / "cloth.usda").Save()
    settings = Settings(tmp_path / "out", quick=True, device="cpu", usd=tmp_path / "cloth.usda")
    [table] = images.run(settings).tables
    assert [row["way"] for row in table.rows] == list(images.WAYS)
    assert all(row["scene"] == "cloth" and 0 < row["silhouette"] <= 1 for row in table.rows)
