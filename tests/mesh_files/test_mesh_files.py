"""Sequences of mesh files: read, compared, welded, simplified and written again."""

from __future__ import annotations

import resource
from pathlib import Path

import numpy as np
import pytest
import trimesh
from typer.testing import CliRunner

import warpqem
from tests.support.mesh_files import poses, usd_frames, usd_mesh, write_files
from tests.support.meshes import grid, icosphere
from warpqem.cli.app import app
from warpqem.errors import MeshFileError, OptionError
from warpqem.mesh_files.file_names import find_mesh_files, frame_numbers, is_mesh_name, numbered_files
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.commands.mesh_stage import save_stage
from warpqem.usd.commands.simplify_meshes import simplify_mesh_files

FORMATS = (".ply", ".obj", ".off", ".stl", ".glb")
# Which have single precision numbers as they are; the others are text.
BINARY = (".ply", ".stl", ".glb")
HALF = SimplifyOptions(ratio=0.5, device="cpu")


@pytest.mark.parametrize("suffix", FORMATS)
def test_frames_are_read_as_they_were_written(tmp_path, suffix):
    points, faces = poses()
    write_files(tmp_path, suffix, points, faces)
    found = warpqem.load(str(tmp_path / f"ball-*{suffix}"))
    assert (found.frame_count, found.numbers) == (3, [8, 9, 10])
    read = found.read(slice(0, 3))
    # Corner by corner, as an STL numbers its vertices anew.
    np.testing.assert_allclose(read[:, found.faces], points[:, faces], atol=1e-7)
    assert len(found.faces) == len(faces)


@pytest.mark.parametrize("suffix", BINARY)
def test_binary_formats_keep_every_bit(tmp_path, suffix):
    points, faces = poses()
    write_files(tmp_path, suffix, points, faces)
    found = warpqem.load(str(tmp_path / f"ball-*{suffix}"))
    assert found.dtype == np.float32
    assert np.array_equal(found.read(slice(0, 3))[:, found.faces], points[:, faces])


def test_files_of_a_pattern_come_in_natural_order(tmp_path):
    files = write_files(tmp_path, ".ply", *poses(4))
    assert find_mesh_files(str(tmp_path / "ball-*.ply")) == list(map(str, files))
    assert find_mesh_files(str(tmp_path / "ball-##.ply")) == list(map(str, files))
    assert find_mesh_files(files[::-1]) == list(map(str, files[::-1]))


@pytest.mark.parametrize(
    ("names", "numbers"),
    [
        (["a1.ply", "a5.ply", "a10.ply"], [1, 5, 10]),
        (["a_v2.0007.ply", "a_v2.0008.ply"], [7, 8]),
        (["walk.ply", "walk2.ply"], [1, 2]),
        (["a2.ply", "a1.ply"], [1, 2]),
    ],
)
def test_frames_have_the_numbers_of_their_names(names, numbers):
    assert frame_numbers(names) == numbers


def test_output_names_take_the_place_of_the_number():
    assert numbered_files("out/h_####.ply", [7, 12345]) == ["out/h_0007.ply", "out/h_12345.ply"]
    with pytest.raises(OptionError, match=r"2 frames need a file each, such as h_####\.ply"):
        numbered_files("h.ply", [1, 2])
    with pytest.raises(OptionError, match="one row of #"):
        numbered_files("h_#_#.ply", [1, 2])


def test_names_of_mesh_files_are_told_from_others():
    assert all(is_mesh_name(f"a{suffix.upper()}") for suffix in FORMATS)
    assert not any(is_mesh_name(name) for name in ("a.usdc", "a.usdz", "a.wpqm", "a", "a.zip", "a.json"))


def test_polygons_come_as_triangles(tmp_path):
    (tmp_path / "quad.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n")
    found = warpqem.load(tmp_path / "quad.obj")
    assert found.frame_count == 1
    assert len(found.faces) == 2


def test_other_face_count_is_named(tmp_path):
    points, faces = poses()
    files = write_files(tmp_path, ".ply", points, faces)
    trimesh.Trimesh(points[0], faces[:-1], process=False).export(files[1])
    with pytest.raises(MeshFileError, match=r"ball-9\.ply: 319 faces, but 320 in .*ball-8\.ply"):
        warpqem.load(tmp_path / "ball-*.ply")


def test_other_face_is_named(tmp_path):
    points, faces = poses()
    files = write_files(tmp_path, ".ply", points, faces)
    trimesh.Trimesh(points[0], np.roll(faces, 1, axis=0), process=False).export(files[2])
    with pytest.raises(MeshFileError, match=r"ball-10\.ply: face 0 is \[.*\], but \[.*\] in .*ball-8\.ply"):
        warpqem.load(tmp_path / "ball-*.ply")


@pytest.mark.parametrize("data", [b"", b"ply\nformat ascii 1.0\nelement vertex 3\n", b"nonsense"])
def test_damaged_file_is_named(tmp_path, data):
    files = write_files(tmp_path, ".ply", *poses())
    files[1].write_bytes(data)
    with pytest.raises(MeshFileError, match=r"ball-9\.ply: "):
        warpqem.load(tmp_path / "ball-*.ply")


def test_points_that_are_no_numbers_are_named(tmp_path):
    points, faces = poses()
    points[1, 5, 2] = np.nan
    write_files(tmp_path, ".ply", points, faces)
    with pytest.raises(MeshFileError, match=r"ball-9\.ply: point 5 is \[.*nan\] \(1 such points\)"):
        warpqem.load(tmp_path / "ball-*.ply")


@pytest.mark.parametrize("pattern", ["none-*.ply", "none.ply", "none-##.obj"])
def test_pattern_without_files_is_refused(tmp_path, pattern):
    with pytest.raises(MeshFileError, match="no such file"):
        warpqem.load(tmp_path / pattern)


def test_corners_that_part_in_one_frame_are_not_welded(tmp_path):
    points, faces = (np.asarray(part) for part in grid(2, 1))
    corners = np.repeat(points[faces].reshape(1, -1, 3), 2, axis=0).astype(np.float32)
    shared = len(np.unique(corners[0], axis=0))
    # One corner leaves the others in the second frame.
    corners[1, 4] += 5.0
    write_files(tmp_path, ".stl", corners, np.arange(corners.shape[1]).reshape(-1, 3))
    found = warpqem.load(tmp_path / "ball-*.stl")
    is_shared = (corners[0] == corners[0, 4]).all(axis=1).sum() > 1
    assert found.vertex_count == shared + int(is_shared)
    assert np.array_equal(found.read(slice(0, 2))[:, found.faces.reshape(-1)], corners)
    assert f"welded to {found.vertex_count} vertices" in found.notes[-1]


@pytest.mark.parametrize("suffix", FORMATS)
def test_result_equals_that_of_the_same_frames_in_usd(tmp_path, suffix):
    points, faces = poses()
    write_files(tmp_path / "in", suffix, points, faces)
    if suffix == ".stl":
        # An STL numbers its vertices by their corners.
        loaded = warpqem.load(tmp_path / "in" / "ball-*.stl")
        points, faces = loaded.read(slice(0, 3)), loaded.faces
    save_stage(points, faces, tmp_path / "in.usdc", [8, 9, 10], 24.0)
    simplify_stage(tmp_path / "in.usdc", tmp_path / "usd.usdc", HALF)
    simplify_mesh_files(tmp_path / "in" / f"ball-*{suffix}", tmp_path / "files.usdc", HALF)
    expected, found = usd_frames(tmp_path / "usd.usdc"), usd_frames(tmp_path / "files.usdc")
    assert np.array_equal(expected[1], found[1])
    assert expected[2] == found[2] == [8.0, 9.0, 10.0]
    np.testing.assert_allclose(found[0], expected[0], atol=0 if suffix in BINARY else 1e-6)


def test_usd_output_needs_no_other_file(tmp_path):
    write_files(tmp_path / "in", ".ply", *poses())
    report = simplify_mesh_files(tmp_path / "in" / "ball-*.ply", tmp_path / "out.usdc", HALF, fps=30)
    assert report.input == str(tmp_path / "in" / "ball-*.ply")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in", "out.usdc"]
    stage, mesh = usd_mesh(tmp_path / "out.usdc")
    assert stage.GetTimeCodesPerSecond() == 30
    assert str(mesh.GetPath()) == "/Root/ball"


@pytest.mark.parametrize("suffix", FORMATS)
def test_frames_are_written_as_files_with_their_numbers(tmp_path, suffix):
    write_files(tmp_path / "in", ".ply", *poses())
    simplify_mesh_files(tmp_path / "in" / "ball-*.ply", tmp_path / "out.usdc", HALF)
    report = simplify_mesh_files(tmp_path / "in" / "ball-*.ply", tmp_path / "new" / f"b_###{suffix}", HALF)
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == [
        f"b_{frame:03}{suffix}" for frame in (8, 9, 10)
    ]
    assert len(report.outputs) == 3
    points, faces, _ = usd_frames(tmp_path / "out.usdc")
    found = warpqem.load(tmp_path / "new" / f"b_*{suffix}")
    np.testing.assert_allclose(found.read(slice(0, 3))[:, found.faces], points[:, faces], atol=1e-7)


def test_range_of_frames_writes_these_frames(tmp_path):
    write_files(tmp_path / "in", ".ply", *poses())
    options = SimplifyOptions(ratio=0.5, device="cpu", frames=warpqem.usd.FrameRange(9, 10))
    report = simplify_mesh_files(tmp_path / "in" / "ball-*.ply", tmp_path / "out" / "b_##.ply", options)
    assert [Path(file).name for file in report.outputs] == ["b_09.ply", "b_10.ply"]


def test_single_file_is_a_clip_of_one_frame(tmp_path):
    [file] = write_files(tmp_path, ".obj", *poses(1))
    simplify_mesh_files(file, tmp_path / "out.usda", HALF)
    points, faces, times = usd_frames(tmp_path / "out.usda")
    assert (len(points), len(faces), times) == (1, 160, [])
    report = simplify_mesh_files(file, tmp_path / "out.ply", HALF)
    assert report.outputs == [str(tmp_path / "out.ply")]


@pytest.mark.parametrize("output", ["in/ball-#.ply", "in/ball-##.ply"])
def test_files_that_are_read_are_not_overwritten(tmp_path, output):
    files = write_files(tmp_path / "in", ".ply", *poses())
    before = [file.read_bytes() for file in files]
    with pytest.raises(OptionError, match="a mesh file that is read, which is never overwritten"):
        simplify_mesh_files(tmp_path / "in" / "ball-*.ply", tmp_path / output, HALF)
    assert [file.read_bytes() for file in files] == before


def test_nothing_is_left_behind_after_an_error(tmp_path):
    files = write_files(tmp_path / "in", ".ply", *poses())
    files[2].write_bytes(b"")
    (tmp_path / "out").mkdir()
    with pytest.raises(MeshFileError):
        simplify_mesh_files(tmp_path / "in" / "ball-*.ply", tmp_path / "out" / "out.usdc", HALF)
    assert list((tmp_path / "out").iterdir()) == []


def colored(pose: np.ndarray, faces: np.ndarray, red: int, of: str = "vertex") -> trimesh.Trimesh:
    count = len(pose) if of == "vertex" else len(faces)
    colors = np.tile(np.array([[red, 120, 7, 255]], dtype=np.uint8), (count, 1))
    return trimesh.Trimesh(pose, faces, process=False, **{f"{of}_colors": colors})


@pytest.mark.parametrize("of", ["vertex", "face"])
def test_colours_that_all_files_share_come_along(tmp_path, of):
    points, faces = poses()
    for frame, pose in enumerate(points):
        colored(pose, faces, 200, of).export(tmp_path / f"c-{frame}.ply")
    simplify_mesh_files(tmp_path / "c-*.ply", tmp_path / "out.usdc", HALF)
    stage, mesh = usd_mesh(tmp_path / "out.usdc")
    np.testing.assert_allclose(np.array(mesh.GetDisplayColorPrimvar().Get())[0], [200 / 255, 120 / 255, 7 / 255])
    del stage
    simplify_mesh_files(tmp_path / "c-*.ply", tmp_path / "new" / "c-#.ply", HALF)
    found = trimesh.load(tmp_path / "new" / "c-0.ply", process=False)
    assert set(map(tuple, getattr(found.visual, f"{of}_colors"))) == {(200, 120, 7, 255)}


def test_colours_that_change_are_left_out_by_name(tmp_path):
    points, faces = poses()
    for frame, pose in enumerate(points):
        colored(pose, faces, 200 + frame).export(tmp_path / f"c-{frame}.ply")
    report = simplify_mesh_files(tmp_path / "c-*.ply", tmp_path / "out.usdc", HALF)
    [note] = report.problems
    assert "c-1.ply: vertex colours are not those of" in note
    stage, mesh = usd_mesh(tmp_path / "out.usdc")
    assert stage
    assert not mesh.GetDisplayColorAttr().HasAuthoredValue()


def test_texture_coordinates_come_along_and_out_again(tmp_path):
    points, faces = (np.asarray(part) for part in grid(8, 8))
    uv = points[:, :2] / 8
    for frame in range(2):
        pose = points + np.array([0, 0, frame])
        visual = trimesh.visual.TextureVisuals(uv=uv)
        mesh = trimesh.Trimesh(pose, faces, visual=visual, process=False)
        (tmp_path / f"u-{frame}.obj").write_text(mesh.export(file_type="obj", write_texture=False))
    found = warpqem.load(tmp_path / "u-*.obj")
    assert found.uv is not None
    simplify_mesh_files(tmp_path / "u-*.obj", tmp_path / "out" / "u-#.obj", HALF)
    text = (tmp_path / "out" / "u-0.obj").read_text()
    assert "vt " in text
    assert "mtllib" not in text
    back = warpqem.load(tmp_path / "out" / "u-*.obj")
    np.testing.assert_allclose(back.uv, back.read(slice(0, 1))[0, :, :2] / 8, atol=1e-5)


def test_levels_of_mesh_files_are_files_or_a_package(tmp_path):
    write_files(tmp_path / "in", ".ply", *poses())
    pattern = tmp_path / "in" / "ball-*.ply"
    levels = {"lods": (0.5, 0.25), "device": "cpu"}
    with pytest.raises(OptionError, match="lod_files, or a package"):
        simplify_mesh_files(pattern, tmp_path / "out.usdc", SimplifyOptions(**levels))
    simplify_mesh_files(pattern, tmp_path / "out.usdc", SimplifyOptions(**levels, lod_files=True))
    assert [len(usd_frames(tmp_path / f"out_LOD{level}.usdc")[1]) for level in (1, 2)] == [160, 80]
    simplify_mesh_files(pattern, tmp_path / "out.usdz", SimplifyOptions(**levels))
    assert len(usd_frames(tmp_path / "out.usdz")[1]) == 320


def test_command_takes_patterns_and_rates(tmp_path):
    write_files(tmp_path / "in", ".ply", *poses())
    arguments = ["simplify", tmp_path / "in" / "ball-*.ply", "-o", tmp_path / "out.usdc", "--ratio", "0.5"]
    more = ["--device", "cpu", "--fps", "60", "--report", tmp_path / "page.html"]
    result = CliRunner().invoke(app, list(map(str, [*arguments, *more])))
    assert result.exit_code == 0, result.output
    assert usd_mesh(tmp_path / "out.usdc")[0].GetTimeCodesPerSecond() == 60
    assert (tmp_path / "page.html").exists()


def test_rate_of_a_usd_file_is_not_an_option(tmp_path):
    save_stage(*poses(), tmp_path / "in.usdc", [1, 2, 3], 24.0)
    arguments = ["simplify", tmp_path / "in.usdc", "-o", tmp_path / "out.usdc", "--ratio", "0.5", "--fps", "60"]
    result = CliRunner().invoke(app, list(map(str, arguments)))
    assert result.exit_code == 2
    assert "--fps is for mesh files" in result.stderr


@pytest.mark.parametrize("fps", [0, -1, float("nan"), float("inf")])
def test_rate_that_is_none_is_refused(tmp_path, fps):
    with pytest.raises(OptionError, match="fps"):
        simplify_mesh_files(tmp_path / "a.ply", tmp_path / "out.usdc", HALF, fps=fps)


def test_long_sequence_takes_no_more_memory_than_a_short_one(tmp_path):
    points, faces = icosphere(4)
    for frame in range(120):
        pose = np.asarray(points) * (1 + 0.1 * np.sin(0.1 * frame))
        trimesh.Trimesh(pose, faces, process=False).export(tmp_path / f"s-{frame}.ply")
    simplify_mesh_files(tmp_path / "s-1?.ply", tmp_path / "short.usdc", HALF)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    warpqem.load(tmp_path / "s-*.ply")
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024
    # All points would be 120 x 2562 x 3 x 8 bytes, and what trimesh keeps of each mesh several times as much.
    assert grown < 5 * 2**20
