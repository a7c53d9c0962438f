"""Blocks that travel beside the work of a device: what waits for what."""

import threading
import weakref

import numpy as np
import pytest
import warp as wp

import warpqem
from tests.support import meshes
from warpqem.frames import device_frames
from warpqem.frames.device_frames import device_blocks
from warpqem.frames.stream import read_ahead
from warpqem.pipeline import place_frames
from warpqem.runtime import staging
from warpqem.runtime.device import device_traits
from warpqem.runtime.staging import Downloads, HostBuffer, Uploads

BLOCKS = [slice(first, min(first + 4, 18)) for first in range(0, 18, 4)]
POINTS = np.random.default_rng(0).normal(size=(18, 5, 3)).astype(np.float32)


class LateStream:
    """Copies and work that are done as late as marks and waits allow: what is out of order gives other numbers."""

    def __init__(self) -> None:
        self._work, self._copies, self._lock = [], [], threading.RLock()
        self.buffers = 0

    def buffer(self, size):
        self.buffers += 1
        return HostBuffer.empty(size, pinned=False)

    def mark(self):
        return len(self._work)

    def copy(self, target, source, after):
        with self._lock:
            self._copies.append((target, source, after))
            return len(self._copies)

    def work_after(self, copied):
        self.begin(lambda: self.wait(copied))

    def wait(self, copied):
        with self._lock:
            for index, entry in enumerate(self._copies[:copied]):
                if entry is not None:
                    target, source, after = entry
                    self._copies[index] = None
                    self._do_work(after)
                    wp.copy(target, source)

    def begin(self, work):
        """Work on the device, in order."""
        with self._lock:
            self._work.append(work)

    def _do_work(self, count):
        for index, work in enumerate(self._work[:count]):
            if work is not None:
                self._work[index] = None
                work()

    def synchronize(self):
        with self._lock:
            self._do_work(len(self._work))


def numbers_of(array) -> np.ndarray:
    """A copy of what is on the device, which is a CPU here."""
    return np.array(array.numpy(), copy=True).reshape(len(array), -1, 3)


def uploaded(uploads, stream, read) -> dict[int, np.ndarray]:
    """What work on each block finds, which is done late."""
    seen = {}
    for frames, staged in read_ahead(uploads.staged(read), BLOCKS):
        there = uploads.sent(staged)
        stream.begin(lambda start=frames.start, there=there: seen.update({start: numbers_of(there)}))
    stream.synchronize()
    return seen


def test_work_finds_each_block_however_late_copies_and_work_are():
    stream = LateStream()
    seen = uploaded(Uploads("cpu", stream), stream, lambda frames: POINTS[frames])
    for frames in BLOCKS:
        np.testing.assert_array_equal(seen[frames.start], POINTS[frames])
    assert stream.buffers == 3


@pytest.mark.parametrize(
    ("forgotten", "instead"),
    [("wait", lambda *_: None), ("work_after", lambda *_: None), ("mark", lambda *_: 0)],
)
def test_what_is_forgotten_is_seen(forgotten, instead, monkeypatch):
    """The stream of these tests shows each mistake."""
    stream = LateStream()
    waits = stream.wait
    monkeypatch.setattr(stream, forgotten, instead)
    if forgotten == "wait":
        monkeypatch.setattr(stream, "work_after", lambda copied: stream.begin(lambda: waits(copied)))
    seen = uploaded(Uploads("cpu", stream), stream, lambda frames: POINTS[frames])
    assert any(not np.array_equal(seen[frames.start], POINTS[frames]) for frames in BLOCKS)


def test_blocks_that_are_held_come_to_their_place():
    stream = LateStream()
    uploads, held = Uploads("cpu", stream), wp.zeros(POINTS.shape[:2], dtype=wp.vec3, device="cpu")
    for frames, staged in read_ahead(uploads.staged(lambda frames: POINTS[frames]), BLOCKS):
        uploads.send(staged, held[frames.start : frames.stop])
    stream.synchronize()
    np.testing.assert_array_equal(numbers_of(held), POINTS)


def test_points_in_double_precision_are_not_staged():
    ready = Uploads("cpu", LateStream()).staged(lambda frames: POINTS[frames].astype(np.float64))
    staged = ready(BLOCKS[0])
    assert staged.buffer is None
    assert staged.points.dtype == np.float64


def test_the_end_waits_for_copies_under_way():
    stream = LateStream()
    uploads, held = Uploads("cpu", stream), wp.zeros(POINTS.shape[:2], dtype=wp.vec3, device="cpu")
    ready = uploads.staged(lambda frames: POINTS[frames])
    uploads.send(ready(BLOCKS[0]), held[:4])
    assert not numbers_of(held).any()
    uploads.close()
    np.testing.assert_array_equal(numbers_of(held)[:4], POINTS[:4])


def test_blocks_come_to_the_host_as_work_left_them_and_belong_to_the_caller():
    stream = LateStream()
    downloads, found = Downloads(stream), []
    there = [wp.zeros(60, dtype=wp.float32, device="cpu") for _ in BLOCKS]
    begun = []
    for number, block in enumerate(there):
        stream.begin(lambda number=number, block=block: block.fill_(number + 1.0))
        begun.append(downloads.begin(block))
        # What is done with it later does not matter.
        stream.begin(lambda block=block: block.zero_())
        if number:
            begun[number - 1].wait()
        if number > 1:
            # Written while the next one travels.
            found.append(begun[number - 2].result())
    begun[-1].wait()
    found += [download.result() for download in begun[-2:]]
    assert [set(block.tolist()) for block in found] == [{number + 1.0} for number in range(len(there))]
    assert stream.buffers == 3


def test_a_block_is_kept_until_it_is_on_the_host():
    stream = LateStream()
    block = wp.zeros(3, dtype=wp.float32, device="cpu")
    kept = weakref.ref(block)
    download = Downloads(stream).begin(block)
    stream._copies[0] = (stream._copies[0][0], wp.zeros(3, dtype=wp.float32, device="cpu"), 0)
    del block
    assert kept() is not None
    download.wait()
    assert kept() is None


def test_what_a_device_copies_at_once_is_the_same(device):
    there = wp.array(POINTS.ravel(), dtype=wp.float32, device=device)
    np.testing.assert_array_equal(Downloads(staging.copy_stream(device)).begin(there).result(), POINTS.ravel())
    uploads = Uploads(device)
    for frames, staged in read_ahead(uploads.staged(lambda frames: POINTS[frames]), BLOCKS):
        np.testing.assert_array_equal(numbers_of(uploads.sent(staged)), POINTS[frames])
    uploads.close()


def test_blocks_of_a_device_with_memory_of_its_own_are_staged_but_a_single_one(device, monkeypatch):
    made, make = [], device_frames.Uploads
    monkeypatch.setattr(device_frames, "Uploads", lambda *args: made.append(make(*args)) or made[-1])
    for blocks in (BLOCKS[:1], BLOCKS):
        found = [numbers_of(points) for _, points in device_blocks(None, lambda frames: POINTS[frames], blocks, device)]
        np.testing.assert_array_equal(np.concatenate(found), POINTS[: blocks[-1].stop])
    assert len(made) == device_traits(device).own_memory


class Kept:
    """A sink that keeps the very arrays that it gets."""

    def __init__(self) -> None:
        self.blocks = []

    def begin(self, *_) -> None:
        pass

    def write(self, frames, points) -> None:
        self.blocks.append(points)


@pytest.mark.parametrize("quality", ["fast", "best"])
def test_a_sink_may_keep_what_it_gets(quality, device, monkeypatch):
    points, faces = meshes.swaying_sphere(3, 40)
    options = {"ratio": 0.3, "quality": quality, "measure": False, "device": device}
    expected = warpqem.simplify(points, faces, **options)
    monkeypatch.setattr("warpqem.pipeline.memory_plan.BLOCK_BYTES", 12 * points[0].size)
    sink = Kept()
    result = warpqem.simplify(points, faces, sink=sink, **options)
    assert result.plan.block_count > 1
    np.testing.assert_array_equal(np.concatenate(sink.blocks), expected.points)
    np.testing.assert_array_equal(result.flips, expected.flips)


class LateCopies(LateStream):
    """Copies that are as late, beside work that is done at once."""

    def work_after(self, copied):
        self.wait(copied)


@pytest.mark.parametrize("quality", ["fast", "best"])
def test_results_are_the_same_however_late_copies_are(quality, device, monkeypatch):
    points, faces = meshes.swaying_sphere(3, 40)
    options = {"ratio": 0.3, "quality": quality, "measure": False, "device": device}
    expected = warpqem.simplify(points, faces, **options)
    monkeypatch.setattr("warpqem.pipeline.memory_plan.BLOCK_BYTES", 12 * points[0].size)
    streams = []

    def late(*_):
        streams.append(LateCopies())
        return streams[-1]

    monkeypatch.setattr(place_frames, "work_copies", late)
    monkeypatch.setattr(staging, "copy_stream", late)
    found = warpqem.simplify(points, faces, **options)
    assert any(stream.buffers for stream in streams)
    np.testing.assert_array_equal(found.points, expected.points)
    np.testing.assert_array_equal(found.flips, expected.flips)
