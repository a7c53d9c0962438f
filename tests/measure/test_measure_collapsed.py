"""Frames in which a mesh is collapsed to a point or a line: named, and left out of the errors of the others."""

import dataclasses
import json

import numpy as np
import pytest
from pxr import Usd, UsdGeom
from typer.testing import CliRunner

import warpqem
from tests.support.meshes import bumpy_sphere
from warpqem.cli.main import app
from warpqem.errors import DegenerateMeshError
from warpqem.measure import SurfaceValues, compare, compare_appearance, distance_colors, vertex_distances
from warpqem.measure.collapsed import collapsed_frames
from warpqem.measure.surface_values import CornerValues

# A pyramid over a square of side 1, and the square alone.
PYRAMID = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 0.1]], dtype=np.float32)
FACES = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]], dtype=np.int32)
SQUARE = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
DIAGONAL = float(np.sqrt(2.01))


def frames(*scales):
    """The pyramid about (0.5, 0.5, 0) at some scales."""
    middle = np.float32([0.5, 0.5, 0])
    return np.stack([(PYRAMID - middle) * np.float32(scale) + middle for scale in scales])


def without(errors, *names):
    return {name: value for name, value in dataclasses.asdict(errors).items() if name not in names}


@pytest.mark.parametrize("scale", [0, 1e-8, [1, 0, 0]], ids=["point", "rounding", "line"])
def test_errors_are_those_of_the_other_frames(device, scale):
    all_frames, others = frames(1, scale, 2), frames(1, 2)
    found = compare(all_frames, FACES, all_frames[:, :4], SQUARE, device=device)
    plain = compare(others, FACES, others[:, :4], SQUARE, device=device, frames=[0, 1])
    assert found.collapsed_frames == (1,)
    assert found.per_frame.frame.tolist() == [0, 2]
    assert found.frame_count == 2
    assert found.hausdorff == pytest.approx(100 * 0.1 / DIAGONAL, rel=1e-3)
    assert found.rms == pytest.approx(plain.rms, rel=0.05)
    assert found.edge_length_error == plain.edge_length_error
    assert found.jitter is None


def test_test_mesh_that_is_off_where_the_reference_is_a_point_counts_by_the_largest_diagonal(device):
    reference = frames(1, 0)
    test = reference.copy()
    test[1, 2] += np.float32([0, 0, 0.5])
    found = compare(reference, FACES, test, FACES, device=device)
    assert found.collapsed_frames == (1,)
    assert found.hausdorff == pytest.approx(100 * 0.5 / DIAGONAL, rel=1e-6)
    assert found.hausdorff_length == pytest.approx(0.5, rel=1e-6)
    assert found.verdict.word == "poor"


def test_test_mesh_that_is_a_point_where_the_reference_is_none_is_that_far_off(device):
    reference = frames(1, 1)
    test = reference.copy()
    test[1] = np.float32([0.5, 0.5, 0])
    found = compare(reference, FACES, test, FACES, device=device)
    assert found.hausdorff == pytest.approx(100 * np.sqrt(0.5) / DIAGONAL, rel=1e-6)
    assert found.verdict.word == "poor"


def test_test_mesh_that_is_a_line_across_the_reference_is_as_far_off_as_that_reaches_from_it(device):
    reference = frames(1, 1)
    test = reference.copy()
    # Its box is that of the square.
    test[1] = np.linspace(0, 1, 5, dtype=np.float32)[:, None] * np.float32([1, 1, 0])
    found = compare(reference, FACES, test, FACES, device=device)
    assert found.collapsed_frames == (1,)
    assert found.hausdorff == pytest.approx(100 * np.sqrt(0.5) / DIAGONAL, rel=1e-6)
    distance = vertex_distances(test, FACES, reference, FACES, device=device)[1]
    assert distance == pytest.approx(100 * np.array([0, np.sqrt(0.5), 0, np.sqrt(0.5), 0.1]) / DIAGONAL, abs=1e-5)


def test_frame_of_needles_beside_others_is_an_error(device):
    # Too thin for the search, which then finds the faces of the other frame.
    points = frames(1, [1, 1e-6, 1e-6])[::-1]
    assert not collapsed_frames(points, FACES).any()
    with pytest.raises(DegenerateMeshError, match="every face is degenerate in frame 0"):
        compare(points, FACES, frames(1, 1)[:, :4], SQUARE, device=device)


def test_frames_before_and_after_do_not_follow_each_other(device):
    # Three frames before and after: differences within either part are 0, across the gap they are not.
    apart = frames(1, 1, 1, 0, 1, 1, 1)
    test = apart.copy()
    test[4:, 4] += np.float32([0, 0.2, 0])
    found = compare(apart, FACES, test, FACES, device=device)
    assert found.slide == found.jitter == 0


def test_result_has_the_errors_of_a_comparison_in_memory_and_as_a_stream(device):
    points, faces = frames(1, 0, 2), FACES
    result = warpqem.simplify(points, faces, target_faces=2, device=device)
    found = compare(points, faces, result.points, result.faces, device=device)
    assert result.measured.collapsed_frames == (1,)
    assert result.measured.rms == found.rms
    assert result.measured.hausdorff == found.hausdorff


def test_mesh_far_from_the_origin_is_not_collapsed():
    # Faces lower than rounding there, on a mesh that is not: 1024 wide where single precision has steps of 64.
    grid = np.stack(np.meshgrid(np.arange(0, 1025, 64.0), np.arange(0, 1025, 64.0)), axis=-1).reshape(-1, 2)
    points = (np.c_[grid, 0 * grid[:, 0]] + [1e9, 0, 0]).astype(np.float32)
    start = (17 * np.arange(16)[:, None] + np.arange(16)).ravel()
    faces = np.stack([start, start + 1, start + 18], axis=1)
    assert not collapsed_frames(points[None], faces).any()
    # The same in double precision may be small there.
    assert not collapsed_frames(PYRAMID[None].astype(np.float64) / 3 + 1e9, FACES).any()


def test_limit_in_a_frame_that_is_a_point_is_one_of_the_largest_diagonal(device):
    ball, faces = bumpy_sphere(2)
    steady = np.float32([2, 2, 2])
    rounded = np.random.default_rng(0).integers(-2, 3, ball.shape) * np.spacing(np.float32(2)) + steady
    plain, blinking = (np.stack([ball, middle, ball * 1.5]).astype(np.float32) for middle in (ball, rounded))
    limited = [warpqem.simplify(points, faces, max_error=3.0, device=device) for points in (plain, blinking)]
    assert limited[1].measured.collapsed_frames == (1,)
    assert limited[1].measured.hausdorff <= 3.0
    assert len(limited[1].faces) < 1.2 * len(limited[0].faces)


def test_heat_map_of_a_collapsed_frame_is_by_the_largest_diagonal(device):
    reference = frames(1, 0)
    test = reference.copy()
    assert not vertex_distances(reference, FACES, test, FACES, device=device)[1].any()
    test[1, 2] += np.float32([0, 0, 0.5])
    distance = vertex_distances(reference, FACES, test, FACES, device=device)
    assert distance[1] == pytest.approx([0, 0, 100 * 0.5 / DIAGONAL, 0, 0])
    colors, scale = distance_colors(reference[1:], FACES, reference[1:], FACES, device=device)
    assert scale == 0
    assert np.ptp(colors) == pytest.approx(np.ptp(colors[0, 0]))


def test_appearance_is_that_of_the_other_frames(device):
    normals = np.zeros((3, 4, 3, 3))
    normals[..., 2] = 1
    turned = normals.copy()
    # Turned by 90 degrees in the collapsed frame alone.
    turned[1] = [1, 0, 0]
    points = frames(1, 0, 2)
    values = [SurfaceValues(normals=CornerValues.of("normals", one)) for one in (normals, turned)]
    found = compare_appearance(points, FACES, values[0], points, FACES, values[1], device=device)
    assert found.frame_count == 2
    assert found.normals.largest == pytest.approx(0, abs=1e-6)


@pytest.fixture
def blinking(tmp_path):
    """A stage with the pyramid, collapsed to a point at time 2."""
    stage = Usd.Stage.CreateNew(str(tmp_path / "in.usda"))
    mesh = UsdGeom.Mesh.Define(stage, "/Mesh")
    mesh.CreateFaceVertexCountsAttr([3] * len(FACES))
    mesh.CreateFaceVertexIndicesAttr(FACES.ravel())
    for time, points in enumerate(frames(1, 0, 1.5, 2), start=1):
        mesh.CreatePointsAttr().Set(points, time)
    stage.Save()
    return tmp_path


def test_commands_name_the_time_and_end_well(blinking):
    text = "/Mesh: collapsed to a point or a line at time 2, left out of its errors"
    source, output = blinking / "in.usda", blinking / "out.usda"
    json_file = blinking / "found.json"
    for command in (
        f"simplify {source} -o {output} --faces 2 --report {blinking}/s.html",
        f"compare {source} {output} --report {blinking}/c.html --heatmap {blinking}/h.usda --json {json_file}",
    ):
        shown = CliRunner().invoke(app, [*command.split(), "--device", "cpu"])
        assert shown.exit_code == 0, shown.output
        assert f"note: {text}" in shown.stderr
    found = json.loads(json_file.read_text())["prims"][0]["comparison"]
    assert found["collapsed_frames"] == [1]
    assert found["frame_count"] == 3
    page = (blinking / "s.html").read_text("utf-8")
    assert text in page
    drawn = f"render {output} --reference {source} --heatmap --size 40x40 --pictures 4 -o {blinking}/r.png --device cpu"
    assert CliRunner().invoke(app, drawn.split()).exit_code == 0
