"""Measured errors: right, the same wherever they are given, and with a verdict."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

import warpqem
from benchmarks.props import props
from tests.support.usd_stages import cloth_stage
from warpqem.arguments.figures import rounded_up
from warpqem.cli.main import app
from warpqem.errors import DegenerateMeshError, UnreachableTargetError
from warpqem.measure import LIMITS, Measured, compare
from warpqem.measure.cells import Joined
from warpqem.measure.closest_points import ClosestPointSearch
from warpqem.measure.surfaces import SurfaceComparison, sample_count
from warpqem.usd import CompareOptions, SimplifyOptions, compare_stages, simplify_stage

GLOSSARY = Path(__file__).parents[2] / "docs" / "glossary.md"


def waves(side: int, frames: int, seed: float = 0.0):
    x, y = np.meshgrid(np.linspace(0, 1, side), np.linspace(0, 1, side))
    phase = np.linspace(seed, seed + 2, frames)[:, None, None]
    height = 0.1 * np.sin(7 * x + phase) * np.cos(5 * y + 2 * phase)
    points = np.stack([np.broadcast_to(x, height.shape), np.broadcast_to(y, height.shape), height], axis=-1)
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    faces = np.concatenate([corner[:, None] + [0, 1, side], corner[:, None] + [1, side + 1, side]])
    return points.reshape(frames, -1, 3).astype(np.float32), faces.astype(np.int32)


def densest(points, faces, other_points, other_faces, steps=60):
    """The largest distance of a grid of points on every face of one mesh from another."""
    u, v = np.meshgrid(np.linspace(0, 1, steps), np.linspace(0, 1, steps))
    inside = u + v <= 1
    u, v = u[inside][:, None, None], v[inside][:, None, None]
    corner = points[faces].astype(np.float64)
    grid = corner[:, 0] + u * (corner[:, 1] - corner[:, 0]) + v * (corner[:, 2] - corner[:, 0])
    search = ClosestPointSearch(other_faces, "cpu", "other")
    return float(search.closest(other_points.astype(np.float64), grid.reshape(-1, 3), 0).distance.max())


class Keeping:
    """A sink that keeps what it gets."""

    def begin(self, frame_count, vertex_count, faces):
        self.blocks = []

    def write(self, frames, points):
        self.blocks.append(points.copy())


@pytest.mark.parametrize("frames", [1, 3])
def test_no_point_of_a_dense_grid_is_further_than_the_largest_distance(device, frames):
    fine, fine_faces = waves(13, frames)
    coarse, coarse_faces = waves(5, frames)
    found = compare(fine, fine_faces, coarse, coarse_faces, samples=50, device=device).per_frame.hausdorff
    for p, q, largest in zip(fine, coarse, found, strict=True):
        diagonal = np.linalg.norm(np.ptp(p.astype(np.float64), axis=0))
        meshes = (p / diagonal, fine_faces, q / diagonal, coarse_faces)
        dense = 100 * max(densest(*meshes), densest(*meshes[2:], *meshes[:2]))
        # The grid misses the furthest point by no more than its spacing.
        assert dense * (1 - 1e-9) <= largest <= 1.02 * dense


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6))
def test_largest_distance_is_no_smaller_than_that_of_any_sample(seed):
    random = np.random.default_rng(seed)
    points, faces = waves(6, 9, seed % 7)
    moved = points + random.normal(0, 0.02, points.shape).astype(np.float32)
    frames = compare(points, faces, moved, faces, samples=20, seed=0, device="cpu").per_frame
    others = compare(points, faces, moved, faces, samples=3000, seed=seed, device="cpu").per_frame
    np.testing.assert_allclose(frames.hausdorff, others.hausdorff, rtol=2.1e-3)
    assert (frames.hausdorff >= frames.rms).all()


def test_peak_between_vertices_is_found(device):
    # The middle of the only face lies over the middle of a roof whose ridge no vertex of the face is near.
    roof = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 0.5, 0.3], [1, 0.5, 0.3]]])
    roof_faces = np.array([[0, 1, 5], [0, 5, 4], [4, 5, 3], [4, 3, 2]])
    flat_faces = np.array([[0, 1, 3], [0, 3, 2]])
    result = compare(roof, roof_faces, roof[:, :4], flat_faces, samples=1, device=device)
    assert result.hausdorff == pytest.approx(100 * 0.3 / np.linalg.norm([1, 1, 0.3]), rel=2e-3)


def test_mean_square_over_few_samples_a_frame_is_that_of_many(device):
    fine, fine_faces = waves(17, 200)
    coarse, coarse_faces = waves(6, 200)
    few, many = (compare(fine, fine_faces, coarse, coarse_faces, samples=count, device=device) for count in (64, 2000))
    assert few.rms == pytest.approx(many.rms, rel=0.01)
    assert few.flips == many.flips


def test_samples_of_all_frames_are_bounded_and_each_frame_has_enough():
    assert [sample_count(frames, 100_000) for frames in (1, 48, 5000)] == [20000, 683, 64]


def test_samples_of_few_faces_are_fewer_in_few_frames():
    assert [sample_count(1, faces) for faces in (12, 500, 501, 5000, 5001)] == [2000, 2000, 2004, 20000, 20000]
    assert [sample_count(frames, 12) for frames in (16, 17, 48)] == [2000, 1928, 683]


def test_few_samples_of_small_meshes_say_what_many_say(device):
    for prop in props(5):
        small = warpqem.simplify(prop.points, prop.faces, ratio=0.5, device=device)
        pair = (prop.points, prop.faces, small.points, small.faces)
        few, many = (compare(*pair, samples=count, device=device) for count in (None, 100_000))
        assert few.sample_count == 2000
        assert few.rms == pytest.approx(many.rms, rel=0.03)
        assert few.mean == pytest.approx(many.mean, rel=0.03)


def test_threads_and_blocks_change_no_digit(device, monkeypatch):
    fine, fine_faces = waves(40, 20)
    coarse, coarse_faces = waves(9, 20)
    found = []
    for threads in (1, 2, 3):
        monkeypatch.setattr("warpqem.measure.patches.thread_count", lambda device, threads=threads: threads)
        monkeypatch.setattr("warpqem.runtime.cpu_threads.thread_count", lambda device, threads=threads: threads)
        found.append(compare(fine, fine_faces, coarse, coarse_faces, device=device).to_dict())
    assert found[0] == found[1] == found[2]


def test_frames_without_room_for_all_pieces_give_the_same(device, monkeypatch):
    fine, fine_faces = waves(20, 6)
    coarse, coarse_faces = waves(5, 6)
    found = compare(fine, fine_faces, coarse, coarse_faces, device=device).to_dict()
    monkeypatch.setattr("warpqem.measure.patches.PIECES_PER_FACE", 0)
    assert compare(fine, fine_faces, coarse, coarse_faces, device=device).to_dict() == found


def test_largest_distance_that_moves_through_the_frames_is_found_in_each(device):
    points, faces = waves(9, 8)
    moved = points.copy()
    for frame in range(8):
        moved[frame, 10 * frame + 5, 2] += 0.05 + 0.01 * frame
    found = compare(points, faces, moved, faces, device=device)
    alone = [compare(points[f], faces, moved[f], faces, device=device).hausdorff for f in range(8)]
    np.testing.assert_allclose(found.per_frame.hausdorff, alone, rtol=1.1e-3)
    assert found.hausdorff == found.per_frame.hausdorff.max()


def test_lengths_are_in_units_of_the_points(device):
    points, faces = waves(7, 3)
    moved = points + np.float32([0, 0, 0.02])
    small, large = (compare(s * points, faces, s * moved, faces, device=device) for s in (1.0, 100.0))
    assert large.rms == pytest.approx(small.rms, rel=1e-6)
    assert large.rms_length == pytest.approx(100 * small.rms_length, rel=1e-6)
    assert small.rms_length <= 0.02 * (1 + 1e-4)
    assert small.hausdorff_length >= 0.02 * (1 - 1e-4)


def test_result_in_memory_and_stream_have_the_errors_that_compare_gives(device):
    points, faces = waves(15, 30)
    result = warpqem.simplify(points, faces, ratio=0.2, device=device)
    found = compare(points, faces, result.points, result.faces, device=device)
    assert {name: getattr(found, name) for name in vars(result.measured)} == vars(result.measured)
    sink = Keeping()
    streamed = warpqem.simplify(points, faces, ratio=0.2, sink=sink, device=device)
    assert streamed.measured == result.measured
    assert np.array_equal(np.concatenate(sink.blocks), result.points)


def test_result_that_is_not_to_be_measured_has_no_errors_and_the_same_bits(device):
    points, faces = waves(9, 9)
    sinks = Keeping(), Keeping()
    results = [
        warpqem.simplify(points, faces, ratio=0.3, sink=sink, measure=flag, device=device)
        for sink, flag in zip(sinks, (True, False), strict=True)
    ]
    assert results[1].measured is None
    assert np.array_equal(*(np.concatenate(sink.blocks) for sink in sinks))


def test_levels_symmetric_meshes_and_unreachable_targets_are_measured(device):
    points, faces = waves(9, 4)
    levels = warpqem.simplify_levels(points, faces, ratios=[0.5, 0.2], device=device)
    assert 0 < levels[0].measured.rms < levels[1].measured.rms
    with pytest.raises(UnreachableTargetError) as caught:
        warpqem.simplify(points, faces, target_faces=1, locked=np.arange(20), device=device)
    assert caught.value.result.measured.test_faces == len(caught.value.result.faces)


def test_mesh_that_is_collapsed_in_all_frames_has_no_errors(device):
    points, faces = waves(5, 3)
    with pytest.raises(DegenerateMeshError, match="collapsed to a point or a line in every frame"):
        compare(points * 0, faces, points, faces, device=device)


@pytest.fixture
def cloth(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    return tmp_path


def test_report_of_a_stage_and_comparison_of_its_files_have_the_same_digits(cloth):
    report = simplify_stage(cloth / "in.usda", cloth / "out.usda", SimplifyOptions(ratio=0.3, device="cpu"))
    [pair] = compare_stages(cloth / "in.usda", cloth / "out.usda", CompareOptions(device="cpu"))
    measured, compared = report.prims[0].measured, pair.comparison.to_dict()
    assert {name: compared[name] for name in measured} == measured
    assert report.prims[0].estimate > 0


def test_command_line_shows_the_figures_of_its_json(cloth):
    arguments = f"simplify {cloth}/in.usda -o {cloth}/out.usda --ratio 0.3 --device cpu --json {cloth}/a.json"
    shown = CliRunner().invoke(app, arguments.split()).stdout
    [prim] = json.loads((cloth / "a.json").read_text("utf-8"))["prims"]
    compared = CliRunner().invoke(app, f"compare {cloth}/in.usda {cloth}/out.usda --device cpu".split()).stdout
    # Nothing is above the largest distance as it is shown, either.
    texts = [f"{prim['measured'][name]:.4g}" for name in ("rms", "flips")] + [rounded_up(prim["measured"]["hausdorff"])]
    for text in texts:
        assert text in shown
        assert text in compared
    assert prim["measured"]["verdict"] in shown


def test_no_measure_leaves_the_errors_out_and_the_output_as_it_is(cloth):
    for name, flag in (("a", True), ("b", False)):
        options = SimplifyOptions(ratio=0.3, measure=flag, device="cpu")
        report = simplify_stage(cloth / "in.usda", cloth / f"{name}.usda", options)
    assert report.prims[0].measured is None
    assert (cloth / "a.usda").read_bytes() == (cloth / "b.usda").read_bytes()


def measured(**values) -> Measured:
    plain = dict.fromkeys(("rms_forward", "rms_backward", "mean", "normal_deviation", "rms_length"), 0.0)
    figures = {
        "rms": 0.01,
        "hausdorff": 0.1,
        "flips": 0.0,
        "hausdorff_length": 1.0,
        "sample_count": 1,
        "collapsed_frames": (),
    }
    return Measured(**plain, **{**figures, "frame_count": 1, "test_faces": 100, **values})


@pytest.mark.parametrize(
    ("values", "word", "reason"),
    [
        ({}, "good", ""),
        ({"rms": 0.1, "hausdorff": 1.0, "flips": 1.0}, "good", ""),
        ({"rms": 0.2, "hausdorff": 1.5}, "look", "RMS 0.2 % is above 0.1"),
        # The rounding of the table, but for a value that is only just above its limit.
        ({"rms": 0.16952}, "look", "RMS 0.1695 % is above 0.1"),
        ({"rms": 0.10000001}, "look", "RMS 0.1001 % is above 0.1"),
        ({"hausdorff": 1.50001}, "look", "Hausdorff 1.501 % is above 1"),
        ({"hausdorff": 1.5}, "look", "Hausdorff 1.5 % is above 1"),
        ({"rms": 0.4, "hausdorff": 2.5}, "poor", "Hausdorff 2.5 % is above 2"),
        ({"flips": 6.0}, "poor", "flips 6 % of the faces is above 5"),
    ],
)
def test_verdict_is_that_of_the_error_furthest_beyond_its_limit(values, word, reason):
    verdict = measured(**values).verdict
    assert (verdict.word, verdict.reason) == (word, reason)


def test_glossary_has_the_limits_with_their_sentences():
    text = GLOSSARY.read_text("utf-8")
    for limit in LIMITS:
        assert (
            f"| {limit.name} | {limit.look:g} {limit.unit} | {limit.poor:g} {limit.unit} | {limit.sentence} |" in text
        )


def test_mesh_that_ends_far_off_is_warned_of_and_stands_first(cloth):
    shown = CliRunner().invoke(app, f"simplify {cloth}/in.usda -o {cloth}/out.usda --faces 2 --device cpu".split())
    assert "% of the diagonal" in shown.stderr
    assert "units) off" in shown.stderr
    assert "poor" in shown.stdout


def test_groups_of_frames_are_bounded_by_faces_and_frames():
    sizes = [
        SurfaceComparison(
            Joined.single(np.tile([[0, 1, 2]], (count, 1))), Joined.single(np.array([[0, 1, 2]])), frames, 1, 0, "cpu"
        ).group
        for count, frames in ((10, 5), (400, 5000), (20000, 48))
    ]
    assert sizes == [5, 32, 8]
