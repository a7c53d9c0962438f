"""Progressive meshes in files: lossless, in chunks, and safe to read from anywhere."""

from __future__ import annotations

import json
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import warpqem
from tests.support import meshes
from warpqem.errors import OptionError, ProgressiveFileError
from warpqem.progressive import coding, load, read_info, save, stream
from warpqem.progressive.container import HEADER, MAGIC

# Large enough for three chunks.
SPHERE = meshes.swaying_sphere(4, 3)


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A mesh and the file it was saved to."""
    mesh = warpqem.build_progressive(*SPHERE, device="cpu")
    path = tmp_path_factory.mktemp("progressive") / "sphere.wpqm"
    save(mesh, path, {"times": [1.0, 2.0, 3.0]})
    return mesh, path


def rewritten(path: Path, folder: Path, **changes: object) -> Path:
    """The file with other entries in its header, and a checksum that fits."""
    data = path.read_bytes()
    start = len(MAGIC) + HEADER.size
    length, _ = HEADER.unpack(data[len(MAGIC) : start])
    header = json.dumps({**json.loads(data[start : start + length]), **changes}).encode()
    changed = folder / "changed.wpqm"
    changed.write_bytes(MAGIC + HEADER.pack(len(header), zlib.crc32(header)) + header + data[start + length :])
    return changed


def test_loaded_mesh_is_the_saved_one_to_the_bit(built):
    mesh, path = built
    again = load(path)
    np.testing.assert_array_equal(again.points.view(np.int32), mesh.points.view(np.int32))
    for name in ("row_vertex", "row_start", "parent_row", "row_end", "face_rank", "face_index", "face_split", "error"):
        np.testing.assert_array_equal(getattr(again.topology, name), getattr(mesh.topology, name), err_msg=name)


def test_file_is_the_same_on_every_run(built, tmp_path):
    mesh, path = built
    save(mesh, tmp_path / "again.wpqm", {"times": [1.0, 2.0, 3.0]})
    assert (tmp_path / "again.wpqm").read_bytes() == path.read_bytes()


def test_refinement_arrives_in_chunks_each_a_level(built):
    mesh, path = built
    parts = list(stream(path))
    assert len(parts) == 3
    assert [part.split_count for part in parts] == [0, 1024, mesh.split_count]
    for part in parts:
        level, whole = part.level(part.split_count), mesh.level(part.split_count)
        np.testing.assert_array_equal(level.points, whole.points)
        np.testing.assert_array_equal(level.faces, whole.faces)


def test_only_what_a_level_needs_is_read(built, monkeypatch):
    mesh, path = built
    part = load(path, target_faces=500)
    assert part.split_count == 1024
    assert not part.is_complete
    level = part.level(part.splits_for(target_faces=500))
    np.testing.assert_array_equal(level.points, mesh.level(mesh.splits_for(target_faces=500)).points)


def test_what_is_not_loaded_is_named(built, tmp_path):
    _, path = built
    part = load(path, split_count=0)
    with pytest.raises(OptionError, match="4000 faces were asked for, 4 are loaded"):
        part.splits_for(target_faces=4000)
    with pytest.raises(OptionError, match="only 4 of 5120 faces are loaded"):
        part.vertex_map(0)
    with pytest.raises(OptionError, match="only 4 of 5120 faces are loaded"):
        save(part, tmp_path / "part.wpqm")


def test_info_says_what_is_inside(built):
    mesh, path = built
    info = read_info(path)
    assert (info.vertex_count, info.face_count, info.frame_count) == (2562, 5120, 3)
    assert info.split_count == mesh.split_count
    assert info.extra == {"times": [1.0, 2.0, 3.0]}


def test_mesh_without_a_split_is_saved(tmp_path):
    points, faces = meshes.octahedron()
    mesh = warpqem.build_progressive(points, faces, base_faces=8, device="cpu")
    save(mesh, tmp_path / "octahedron.wpqm")
    level = load(tmp_path / "octahedron.wpqm").level(0)
    np.testing.assert_array_equal(level.points[0], points.astype(np.float32))
    np.testing.assert_array_equal(level.faces, faces)


def test_failed_save_leaves_nothing_behind(built, tmp_path, monkeypatch):
    mesh, _ = built
    (tmp_path / "old.wpqm").write_bytes(b"old")

    def fail(*_: object) -> None:
        raise OSError("no space")

    monkeypatch.setattr("os.fsync", fail)
    with pytest.raises(OSError, match="no space"):
        save(mesh, tmp_path / "old.wpqm")
    assert [file.name for file in tmp_path.iterdir()] == ["old.wpqm"]
    assert (tmp_path / "old.wpqm").read_bytes() == b"old"


@pytest.mark.parametrize("size", [0, 5, 12, 40, 300, 0.5, 0.99])
def test_truncated_file_is_an_error_that_says_so(built, tmp_path, size):
    data = built[1].read_bytes()
    cut = data[: size if isinstance(size, int) else int(size * len(data))]
    (tmp_path / "cut.wpqm").write_bytes(cut)
    with pytest.raises(ProgressiveFileError, match=r"cut\.wpqm: (the file|this is)"):
        load(tmp_path / "cut.wpqm")


def test_other_file_is_an_error(tmp_path):
    (tmp_path / "other.wpqm").write_text("#usda 1.0\n" * 20)
    with pytest.raises(ProgressiveFileError, match="this is no progressive mesh"):
        load(tmp_path / "other.wpqm")


def test_later_version_is_an_error_that_names_it(built, tmp_path):
    data = bytearray(built[1].read_bytes())
    data[7:8] = b"2"
    (tmp_path / "later.wpqm").write_bytes(data)
    with pytest.raises(ProgressiveFileError, match="version '2'"):
        load(tmp_path / "later.wpqm")


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_damaged_byte_is_found(built, tmp_path_factory, data):
    content = bytearray(built[1].read_bytes())
    content[data.draw(st.integers(0, len(content) - 1))] ^= data.draw(st.integers(1, 255))
    path = tmp_path_factory.mktemp("damaged") / "damaged.wpqm"
    path.write_bytes(content)
    with pytest.raises(ProgressiveFileError, match=r"damaged\.wpqm"):
        load(path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"frame_count": 0}, "contradict"),
        ({"frame_count": 2**30}, "of memory are free"),
        ({"frame_count": 4}, "bytes where .* belong|damaged"),
        ({"vertex_count": -1}, "vertex_count -1 is no count"),
        ({"vertex_count": True}, "vertex_count True is no count"),
        ({"face_count": 10**6}, "contradict"),
        ({"base_vertex_count": 0}, "contradict"),
        ({"chunks": []}, "list of chunks"),
        ({"chunks": [[0, 0, 0, 10**12, 0]]}, "out of order"),
        ({"chunks": "none"}, "list of chunks"),
        ({"unknown": 1}, "header cannot be read"),
        ({"extra": 3}, "contradict"),
    ],
)
def test_hostile_header_is_an_error(built, tmp_path, changes, message):
    with pytest.raises(ProgressiveFileError, match=message):
        load(rewritten(built[1], tmp_path, **changes))


FLOATS = st.floats(width=32, allow_nan=False, allow_infinity=False)


@settings(max_examples=60, deadline=None)
@given(arrays(np.float32, st.tuples(st.integers(1, 5), st.integers(1, 6), st.just(3)), elements=FLOATS))
def test_tracks_of_any_floats_come_back_to_the_bit(points):
    again = coding.decode_tracks(coding.encode_tracks(points), *points.shape[:2])
    np.testing.assert_array_equal(again.view(np.int32), points.view(np.int32))


@settings(max_examples=60, deadline=None)
@given(arrays(np.float32, st.tuples(st.just(3), st.integers(1, 4), st.integers(1, 5), st.just(3)), elements=FLOATS))
def test_splits_of_any_floats_come_back_to_the_bit(tracks):
    parent, first, second = tracks
    with np.errstate(all="ignore"):
        ratio = coding.split_ratios(parent, first, second)
        data = coding.encode_splits(parent, first, second, ratio)
        residuals = tuple(coding.unpack(part, parent.size).reshape(parent.shape) for part in data)
        again = coding.decode_splits(residuals, parent, ratio)
    np.testing.assert_array_equal(again[0].view(np.int32), first.view(np.int32))
    np.testing.assert_array_equal(again[1].view(np.int32), second.view(np.int32))


def test_smooth_motion_takes_little_more_than_its_raw_size(tmp_path):
    points, faces = meshes.swaying_sphere(3, 48)
    save(warpqem.build_progressive(points, faces, device="cpu"), tmp_path / "sphere.wpqm")
    # All levels, without loss: twice as many vertices as the input has, and all the topology.
    assert (tmp_path / "sphere.wpqm").stat().st_size < 1.2 * points.astype(np.float32).nbytes
