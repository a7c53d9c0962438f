"""Progressive files from anywhere: a named error and no memory to speak of, or a mesh that is one."""

from __future__ import annotations

import base64
import hashlib
import json
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard

import warpqem
from tests.support import meshes, progressive_cases
from tests.support.progressive_files import (
    MADE_BEFORE,
    SMALLEST,
    Chunks,
    Header,
    changed,
    file_bytes,
    packed,
    read_file,
    smallest_parts,
    with_table,
    write_file,
    zeros,
)
from warpqem.errors import DegenerateMeshError, MemoryLimitError, OptionError, ProgressiveFileError
from warpqem.progressive import load, read_info, save
from warpqem.progressive import memory_limit as limits
from warpqem.report.live import LiveLevels

# What Python, NumPy and zstandard take for a file of no size.
SMALL_BYTES = 2**20


def refused(path: Path, match: str) -> None:
    """The file ends in an error that names it, and takes no memory."""
    tracemalloc.start()
    try:
        with pytest.raises(ProgressiveFileError, match=match) as raised:
            load(path)
        assert path.name in str(raised.value)
        assert tracemalloc.get_traced_memory()[1] < SMALL_BYTES + 4 * path.stat().st_size
    finally:
        tracemalloc.stop()


def numbers_of(good: Path, chunk: int, part: int, dtype: type = np.int32) -> np.ndarray:
    """The numbers of a part, as they are coded."""
    data = zstandard.ZstdDecompressor().decompress(read_file(good)[1][chunk][part])
    return np.frombuffer(data, np.uint8).reshape(4, -1).T.copy().view(dtype).ravel()


def coded(values: np.ndarray) -> bytes:
    return packed(np.ascontiguousarray(values.view(np.uint8).reshape(-1, 4).T).tobytes())


# Many changes.


@pytest.fixture(scope="module", autouse=True)
def _files():
    yield
    progressive_cases.remove_files()


@pytest.mark.parametrize("start", range(0, 300, 100))
def test_changed_files_end_in_a_sound_mesh_or_a_named_error(start):
    ends = [progressive_cases.progressive_case(seed) for seed in range(start, start + 100)]
    assert ends.count("done") > 3
    assert ends.count("ProgressiveFileError") > 30


def test_files_of_the_version_before_are_loaded_to_the_bit(tmp_path):
    (tmp_path / "before.wpqm").write_bytes(base64.b64decode(MADE_BEFORE))
    mesh = load(tmp_path / "before.wpqm")
    found = hashlib.sha256()
    for split_count in range(mesh.split_count + 1):
        level = mesh.level(split_count)
        for values in (level.points, level.faces, np.float64(level.error)):
            found.update(values.tobytes())
    assert (mesh.split_count, mesh.frame_count) == (5, 3)
    assert found.hexdigest() == "d8d902e946737b3eead647da10bcdb62ad7f067613f7052c306b8e9beca2e12f"


# Memory.


def grown(header: dict[str, Any], parts: dict[int, bytes]) -> tuple[Header, Chunks]:
    """The smallest file with other counts and parts."""
    chunk = smallest_parts()
    for index, part in parts.items():
        chunk[index] = part
    return {**SMALLEST, **header}, [chunk]


BOMBS = {
    "faces without a byte": grown({"base_face_count": 3 * 10**8, "face_count": 3 * 10**8}, {}),
    "faces of zeros": grown(
        {"base_face_count": 10**7, "face_count": 10**7}, {2: zeros(12 * 10**7), 3: zeros(4 * 10**7)}
    ),
    "frames of zeros": grown({"frame_count": 10**7}, {5: zeros(12 * 10**7)}),
    "frames without a byte": grown({"frame_count": 2**31 - 1}, {}),
    "input vertices": grown({"vertex_count": 2**31 - 1}, {}),
    "splits without a byte": grown(
        {"split_count": 10**8, "rank_count": 10**8 + 1, "vertex_count": 10**8 + 1, "chunks": [[0, 0, 0, 0, 0]] * 2}, {}
    ),
}


@pytest.mark.parametrize("kind", BOMBS)
def test_counts_that_the_size_of_the_file_does_not_account_for_are_refused(tmp_path, kind):
    header, chunks = BOMBS[kind]
    chunks += [[b""] * 10] * (len(header["chunks"]) - 1)
    refused(write_file(tmp_path / "bomb.wpqm", header, chunks), r"take .* more than a file of|of memory are free")
    assert read_info(tmp_path / "bomb.wpqm").frame_count == header["frame_count"]


def unsized(data: bytes, window: int | None = None) -> bytes:
    """A frame that does not say what it unpacks to; with a window it is nothing else, and far larger."""
    compressor = zstandard.ZstdCompressor().compressobj()
    return (
        compressor.compress(data) + compressor.flush()
        if window is None
        else b"\x28\xb5\x2f\xfd\0" + bytes([window]) + b"\1\0\0"
    )


@pytest.mark.parametrize(
    ("part", "message"),
    [
        (zeros(2**31), "2147483648 bytes where 4 belong"),
        (b"\x28\xb5\x2f\xfd\xe0" + (2**60).to_bytes(8, "little") + b"\1\0\0", f"{2**60} bytes where 4 belong"),
        (unsized(bytes(4)), "data of unknown size where 4 belong"),
        (unsized(bytes(2**24)), "data of unknown size where 4 belong"),
        (unsized(b"", 0x88), "data of unknown size"),
        # A window of terabytes for four bytes of a known size.
        (b"\x28\xb5\x2f\xfd\x80\xff" + (4).to_bytes(4, "little") + b"\x23\0\0\0", "damaged"),
        (packed(bytes(3)), "3 bytes where 4 belong"),
        (packed(bytes(4)) + packed(bytes(4)), "damaged"),
        (packed(bytes(4))[:-1], "damaged"),
        (b"\x50\x2a\x4d\x18" + (4).to_bytes(4, "little") + bytes(4), "0 bytes where 4 belong"),
        (b"", "damaged"),
    ],
    ids=range(11),
)
def test_part_that_unpacks_to_something_else_is_refused_before_it_does(tmp_path, part, message):
    refused(write_file(tmp_path / "bomb.wpqm", *grown({}, {0: part})), rf"chunk 0: .*{message}")


def test_decoding_takes_few_times_the_memory_of_the_mesh(tmp_path):
    frames = 4 * 10**5
    header, chunks = grown({"frame_count": frames}, {5: zeros(12 * frames)})
    tracemalloc.start()
    mesh = load(write_file(tmp_path / "zeros.wpqm", header, chunks))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert not mesh.points.any()
    assert peak < 6 * mesh.points.nbytes


def test_file_that_save_writes_is_long_enough_for_what_it_unpacks_to(tmp_path, monkeypatch):
    monkeypatch.setattr(limits, "FREE_BYTES", 0)
    points, faces = meshes.swaying_sphere(1, 1)
    mesh = warpqem.build_progressive(np.repeat(points, 3000, axis=0), faces, device="cpu")
    save(mesh, tmp_path / "rests.wpqm")
    size = (tmp_path / "rests.wpqm").stat().st_size
    assert mesh.points.nbytes / 256 < size < mesh.points.nbytes / 200
    np.testing.assert_array_equal(load(tmp_path / "rests.wpqm").points, mesh.points)
    # As versions before have written it.
    data = (tmp_path / "rests.wpqm").read_bytes().rstrip(b"\0") + bytes(8)
    (tmp_path / "before.wpqm").write_bytes(data)
    with pytest.raises(ProgressiveFileError, match=r"before\.wpqm: .* say how much with memory \(--memory\)"):
        load(tmp_path / "before.wpqm")
    np.testing.assert_array_equal(load(tmp_path / "before.wpqm", memory="1G").points, mesh.points)
    with pytest.raises(ProgressiveFileError, match=r"more than the 1\.0M that memory allows"):
        load(tmp_path / "before.wpqm", memory=2**20)


def test_memory_that_runs_out_is_named(good, monkeypatch):
    def fail(*_: object, **__: object) -> None:
        raise MemoryError

    monkeypatch.setattr("warpqem.progressive.decoder.np.empty", fail)
    with pytest.raises(MemoryLimitError, match=r"good\.wpqm: there is not enough memory"):
        load(good)


# The header.


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"extra": {}', '"extra": {"a": NaN}', "'NaN' is no number"),
        ('"extra": {}', '"extra": {"a": -Infinity}', "'-Infinity' is no number"),
        ('"extra": {}', '"extra": {"a": 1e999}', "'1e999' is no number"),
        ('"extra": {}', f'"extra": {{"a": {"9" * 5000}}}', "an integer of 5000 digits"),
        ('"extra": {}', f'"extra": {{"a": {"[" * 99}{"]" * 99}}}', "nested more than 64 deep"),
        ('"extra": {}', f'"extra": {{"a": {"[" * 10**5}', "cannot be read"),
        ('"extra": {}', '"extra": {"a": 1, "a": 2}', "'a' is there twice"),
        ('"extra": {}', '"extra": {"a": "\\ud800"}', "can't encode"),
        ('"extra": {}', '"extra": {"\\udfff": 1}', "can't encode"),
        ('"extra": {}', '"extra": {}, "extra": {}', "'extra' is there twice"),
        ('"extra": {}', '"extra": {}, "more": 1', r"it holds \['vertex_count'"),
        ('"frame_count": 1, ', "", r"it holds \['vertex_count'"),
        ('"frame_count": 1', '"frame_count": 1.0', "frame_count 1.0 is no count"),
        ('"frame_count": 1', '"frame_count": "1"', "frame_count '1' is no count"),
        ('"frame_count": 1', f'"frame_count": "{"1" * 10**5}"', "frame_count '111.{,40}' is no count"),
        ('"face_count": 0, "f', '"face_count": 1, "f', "contradict"),
        ("[[0, 0, 0", "[[0, 0, true", "list of chunks"),
        ("[[0, 0, 0", "[[0, 0, 1", "chunk 0 begins at byte 1, the one before ends at 0"),
        ("[[0, 0, 0", "[[1, 0, 0", "out of order"),
    ],
)
def test_header_that_can_be_read_in_two_ways_or_none_is_refused(tmp_path, old, new, message):
    text = json.dumps(with_table(SMALLEST, [smallest_parts()]))
    assert old in text
    (tmp_path / "bad.wpqm").write_bytes(file_bytes(text.replace(old, new).encode(), [smallest_parts()]))
    refused(tmp_path / "bad.wpqm", message)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-32", "latin-1"])
def test_header_that_is_no_utf8_is_refused(tmp_path, encoding):
    text = json.dumps({**SMALLEST, "extra": {"a": "\xff"}}, ensure_ascii=False)
    (tmp_path / "bad.wpqm").write_bytes(file_bytes(text.encode(encoding), [smallest_parts()]))
    refused(tmp_path / "bad.wpqm", "can't decode")


def test_chunks_that_share_bytes_are_refused(good):
    header, chunks = read_file(good)
    header = with_table(header, chunks)
    header["chunks"] += [[header["chunks"][1][0] + 1, *header["chunks"][1][1:]]]
    good.write_bytes(file_bytes(header, chunks))
    refused(good, "chunk 2 begins at byte")


@pytest.mark.parametrize(
    "extra", [{"a": float("nan")}, {"a": {1, 2}}, {"a": "\ud800"}, {"a": 10**30}, {1: 2, "1": 3}, [1]], ids=repr
)
def test_extra_that_could_not_be_loaded_is_not_saved(sphere, tmp_path, extra):
    with pytest.raises(OptionError, match="extra"):
        save(sphere, tmp_path / "out.wpqm", extra)
    assert not list(tmp_path.iterdir())


# What the parts hold.


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0, -np.inf])
def test_error_that_is_none_is_refused(good, tmp_path, value):
    refused(write_file(tmp_path / "a.wpqm", *grown({}, {4: coded(np.float32([value]))})), "errors are not finite")
    errors = numbers_of(good, 1, 6, np.float32)
    errors[5] = value
    refused(changed(good, 1, 6, coded(errors)), "chunk 1: errors are not finite numbers that fall")


@pytest.mark.parametrize("place", [0, 5])
def test_errors_that_rise_are_refused(good, place):
    errors = numbers_of(good, 1, 6, np.float32)
    errors[place] = 1e6
    refused(changed(good, 1, 6, coded(errors)), "errors are not finite numbers that fall from level to level")


@pytest.mark.parametrize("value", [np.nan, np.inf, 2e6])
def test_ratio_that_is_none_is_refused(good, value):
    ratios = numbers_of(good, 1, 7, np.float32)
    ratios[3] = value
    refused(changed(good, 1, 7, coded(ratios)), "the ratio of a split")


@pytest.mark.parametrize(("chunk", "part"), [(0, 5), (1, 8), (1, 9)])
def test_point_that_is_not_finite_is_refused(good, chunk, part):
    missed = numbers_of(good, chunk, part)
    missed[:] = 0x7FFFFFFF
    refused(changed(good, chunk, part, coded(missed)), "a point is not finite")


@pytest.mark.parametrize(
    ("chunk", "part", "place", "step", "message"),
    [
        (0, 0, 1, 10**6, "input vertex"),
        (0, 0, 0, -(2**31), "input vertex"),
        (0, 1, 1, 10**6, "rank .* is not between"),
        (0, 2, 4, 10**6, "rank of a corner"),
        (0, 3, 0, -(10**6), "face -"),
        (1, 0, 3, 10**6, "not there yet"),
        (1, 1, 3, -(10**6), "input vertex"),
        (1, 2, 3, 10**6, "ranks that its vertex does not have"),
        (1, 3, 2, 5, "other faces than the header says"),
        (1, 4, 9, 10**6, "rank of a corner"),
        (1, 5, 9, -(10**6), "face -"),
    ],
)
def test_index_out_of_range_is_refused(good, chunk, part, place, step, message):
    values = numbers_of(good, chunk, part)
    values[place] += step
    refused(changed(good, chunk, part, coded(values)), rf"chunk {chunk}: .*{message}")


def test_face_of_the_base_mesh_with_a_vertex_twice_is_refused(good):
    ranks = np.cumsum(numbers_of(good, 0, 2).reshape(-1, 3), axis=0)
    ranks[0, 1] = ranks[0, 0]
    data = coded(np.diff(ranks, axis=0, prepend=0).astype(np.int32).ravel())
    refused(changed(good, 0, 2, data), "a face of the base mesh has a vertex twice")


def test_face_away_from_its_split_is_refused(good):
    ranks = np.cumsum(numbers_of(good, 1, 4).reshape(-1, 3), axis=0)
    ranks[3] = ranks[-1]
    data = coded(np.diff(ranks, axis=0, prepend=0).astype(np.int32).ravel())
    refused(changed(good, 1, 4, data), "a face is not at the edge that its split brings")


def test_input_vertex_of_two_vertices_is_refused(good):
    vertices = np.cumsum(numbers_of(good, 1, 1))
    vertices[4] = vertices[3]
    data = coded(np.diff(vertices, prepend=0).astype(np.int32))
    refused(changed(good, 1, 1, data), "two vertices of a level are the same input vertex")


@pytest.mark.parametrize("chunk", [0, 1])
def test_number_of_parts_that_is_wrong_is_refused(good, chunk):
    header, chunks = read_file(good)
    chunks[chunk] = chunks[chunk] * 1000
    refused(write_file(good, header, chunks), "parts where .* belong")


# What no page can show.


@pytest.mark.parametrize("shape", ["one vertex", "no extent"])
def test_mesh_that_no_page_can_show_is_named(tmp_path, shape):
    header, chunks = BOMBS["frames of zeros"][0] | {"frame_count": 1}, [smallest_parts()]
    if shape == "no extent":
        counts = dict.fromkeys(("vertex_count", "base_vertex_count", "rank_count"), 3)
        header = {**header, **counts, "base_face_count": 1, "face_count": 1}
        steps = coded(np.int32([0, 1, 1]))
        chunks = [[steps, steps, coded(np.int32([0, 1, 2])), packed(bytes(4)), packed(bytes(4)), packed(bytes(36))]]
    path = write_file(tmp_path / "flat.wpqm", header, chunks)
    with pytest.raises(DegenerateMeshError, match=r"flat\.wpqm: .*(no faces|no extent)"):
        LiveLevels(load(path), path.name, {}, device="cpu").data()
