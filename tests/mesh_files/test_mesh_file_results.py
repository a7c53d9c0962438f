"""Results of simplifying as mesh files, USD files and trimesh."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import warpqem
from tests.support.mesh_files import poses, usd_frames, write_files
from warpqem.errors import OptionError
from warpqem.mesh_files.reading import read_mesh_file
from warpqem.mesh_files.writing import WrittenValues, as_trimesh, write_frames


def test_sequence_is_simplified_as_its_arrays_are(tmp_path):
    points, faces = poses()
    write_files(tmp_path, ".ply", points, faces)
    found = warpqem.simplify(warpqem.load(tmp_path / "ball-*.ply"), ratio=0.5, device="cpu")
    expected = warpqem.simplify(points, faces, ratio=0.5, device="cpu")
    assert np.array_equal(found.points, expected.points)
    assert np.array_equal(found.faces, expected.faces)


@pytest.mark.parametrize("suffix", [".usda", ".usdc", ".usdz"])
def test_result_is_saved_as_usd(tmp_path, suffix):
    result = warpqem.simplify(*poses(), ratio=0.5, device="cpu")
    result.save(tmp_path / f"out{suffix}", numbers=[4, 5, 9])
    points, faces, times = usd_frames(tmp_path / f"out{suffix}")
    assert np.array_equal(points, result.points)
    assert np.array_equal(faces, result.faces)
    assert times == [4.0, 5.0, 9.0]


def test_result_is_saved_as_mesh_files(tmp_path):
    result = warpqem.simplify(*poses(), ratio=0.5, device="cpu")
    files = result.save(tmp_path / "b_##.ply")
    assert [Path(file).name for file in files] == ["b_01.ply", "b_02.ply", "b_03.ply"]
    assert np.array_equal(warpqem.load(files).read(slice(0, 3)), result.points)


def test_result_of_other_suffix_or_count_is_refused(tmp_path):
    result = warpqem.simplify(*poses(), ratio=0.5, device="cpu")
    with pytest.raises(OptionError, match="suffix"):
        result.save(tmp_path / "out.abc")
    with pytest.raises(OptionError, match="2 of them for 3 frames"):
        result.save(tmp_path / "out.usda", numbers=[1, 2])


def test_frame_of_a_result_is_a_trimesh():
    result = warpqem.simplify(*poses(), ratio=0.5, device="cpu")
    found = result.to_trimesh(2)
    assert np.array_equal(found.vertices.astype(np.float32), result.points[2])
    assert np.array_equal(found.faces, result.faces)


def test_seams_of_values_split_vertices():
    from warpqem.mesh_files.writing import WrittenValues

    faces = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float32)
    uv = np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [0.5, 0.5], [0, 1]]], dtype=np.float32)
    found = as_trimesh(points, faces, WrittenValues(uv))
    # Vertex 2 has two sides.
    assert len(found.vertices) == 5
    assert np.array_equal(found.vertices[found.faces], points[faces])
    assert np.array_equal(found.visual.uv[found.faces], uv)


@pytest.mark.parametrize("with_colors", [False, True])
@pytest.mark.parametrize("suffix", [".obj", ".off"])
@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(points=arrays(np.float32, (4, 3), elements=st.floats(-1e6, 1e6, width=32)))
def test_text_formats_hold_every_bit_of_points_of_any_size(tmp_path, suffix, with_colors, points):
    faces = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
    colors = np.random.default_rng(0).random((2, 3, 4)).astype(np.float32) if with_colors else None
    write_frames([points], faces, 4, [str(tmp_path / f"a{suffix}")], WrittenValues(colors=colors))
    found = read_mesh_file(str(tmp_path / f"a{suffix}"))
    np.testing.assert_array_equal(found.points.astype(np.float32)[found.faces], points[faces])
