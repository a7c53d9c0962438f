"""Frames that come and go in blocks: the same bits as all at once, in the memory allowed."""

from __future__ import annotations

import gc
import threading

import numpy as np
import pytest

import warpqem
from tests.support.frame_stream import FACES, FRAME_COUNT, POINTS
from warpqem.decimation.decimate import DecimatedMesh, DecimationInput
from warpqem.errors import DegenerateMeshError, MemoryLimitError, MeshShapeError, NonFinitePointError, OptionError
from warpqem.frames.blocks import BLOCK_BYTES, frame_blocks
from warpqem.frames.stream import ArraySink, FrameWriter, NoFrames, read_ahead
from warpqem.pipeline.key_frames import POSE_BYTES
from warpqem.runtime.device import device_traits
from warpqem.runtime.memory import format_bytes, parse_bytes


class CountedFrames:
    """A frame source that counts the frames it is asked for."""

    def __init__(self, points: np.ndarray) -> None:
        self.points, self.frame_count, self.vertex_count, self.dtype = points, *points.shape[:2], points.dtype
        self.longest = self.total = 0

    def read(self, frames: slice) -> np.ndarray:
        count = frames.stop - frames.start
        self.longest, self.total = max(self.longest, count), self.total + count
        return self.points[frames]


def min_memory(**options) -> int:
    """The fewest bytes that are not refused."""
    low, high = 1, 2**40
    while low < high:
        middle = (low + high) // 2
        try:
            warpqem.plan(POINTS, FACES, memory=middle, **options)
            high = middle
        except MemoryLimitError:
            low = middle + 1
    return low


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(
    "options",
    [{}, {"metric": "qem"}, {"metric": "dod"}, {"metric": "aqem"}, {"refit": True}, {"placement": "endpoint"}],
    ids=lambda options: "-".join(map(str, options.values())) or "default",
)
def test_small_blocks_from_a_source_to_a_sink_give_the_bits_of_arrays(options, dtype, device):
    points, sink = POINTS.astype(dtype), ArraySink()
    options = {"ratio": 0.3, "key_frames": 4, "device": device} | options
    whole = warpqem.simplify(points, FACES, **options)
    blocks = warpqem.simplify(
        CountedFrames(points), FACES, sink=sink, memory=min_memory(sink=NoFrames(), **options), **options
    )
    assert (whole.plan.block_count, blocks.plan.block_count) == (1, 3)
    np.testing.assert_array_equal(sink.points, whole.points)
    np.testing.assert_array_equal(blocks.points, whole.points[:1])
    for name in ("faces", "vertex_map", "face_map", "flips", "key_frames"):
        np.testing.assert_array_equal(getattr(blocks, name), getattr(whole, name), err_msg=name)


@pytest.mark.parametrize("metric", ["dsd", "aqem"])
def test_a_source_is_read_twice_and_once_more_for_its_key_frames(metric):
    options = {"ratio": 0.5, "key_frames": 4, "metric": metric, "quality": "fast"}
    options |= {"sink": NoFrames(), "device": "cpu"}
    for measure in (False, True):
        source = CountedFrames(POINTS)
        warpqem.simplify(source, FACES, measure=measure, **options)
        # Once more for the errors of what a sink takes; a device with memory of its own keeps what it was given.
        again = 0 if device_traits("cpu").own_memory else FRAME_COUNT + 4
        assert source.total == (2 if measure else 1) * FRAME_COUNT + again


def test_no_more_frames_than_planned_are_read_at_once():
    options = {"ratio": 0.5, "sink": NoFrames(), "device": "cpu"}
    source = CountedFrames(POINTS)
    result = warpqem.simplify(source, FACES, memory=min_memory(**options), **options)
    assert source.longest == result.plan.block_frames == 8


def test_a_frame_source_serves_for_motion_features():
    from_array = warpqem.motion_features(POINTS, FACES, device="cpu")
    from_source = warpqem.motion_features(CountedFrames(POINTS), FACES, device="cpu")
    np.testing.assert_array_equal(from_source.factor, from_array.factor)


def test_angles_are_followed_from_block_to_block(monkeypatch):
    monkeypatch.setattr("warpqem.frames.blocks.BLOCK_BYTES", 1)
    points = np.repeat(POINTS[:1], FRAME_COUNT, axis=0)
    points[8:] = POINTS[1]  # the only change is between two blocks
    found = warpqem.motion_features(points, FACES, device="cpu")
    monkeypatch.undo()
    np.testing.assert_array_equal(found.factor, warpqem.motion_features(points, FACES, device="cpu").factor)
    assert found.factor.max() > 0


def test_points_that_are_not_finite_are_counted_over_all_blocks(monkeypatch):
    monkeypatch.setattr("warpqem.frames.blocks.BLOCK_BYTES", 1)
    points = POINTS.copy()
    points[[9, 20], 3] = np.nan
    with pytest.raises(NonFinitePointError, match=r"vertex 3 in frame 9 has x = nan \(2 such points"):
        warpqem.simplify(points, FACES, ratio=0.5, device="cpu")


def test_a_source_of_another_dtype_is_refused():
    with pytest.raises(MeshShapeError, match="source of int64"):
        warpqem.simplify(CountedFrames(POINTS.astype(np.int64)), FACES, ratio=0.5)


def test_a_source_without_frames_is_refused():
    with pytest.raises(DegenerateMeshError, match="0 frames"):
        warpqem.simplify(CountedFrames(POINTS[:0]), FACES, ratio=0.5)


def test_errors_of_a_source_come_through():
    class Broken(CountedFrames):
        def read(self, frames: slice) -> np.ndarray:
            if frames.start >= 8:
                raise OSError("disk gone")
            return super().read(frames)

    with pytest.raises(OSError, match="disk gone"):
        warpqem.simplify(Broken(POINTS), FACES, ratio=0.5, memory=min_memory(ratio=0.5), device="cpu")


def test_errors_of_a_sink_come_through():
    class Full(NoFrames):
        def write(self, frames: slice, points: np.ndarray) -> None:
            raise OSError("disk full")

    options = {"ratio": 0.5, "sink": Full(), "device": "cpu"}
    with pytest.raises(OSError, match="disk full"):
        warpqem.simplify(POINTS, FACES, memory=min_memory(**options), **options)


def test_what_ordering_needed_is_released_before_placing():
    def ordering() -> list:
        return [item for item in gc.get_objects() if isinstance(item, (DecimationInput, DecimatedMesh))]

    # What other tests left behind is kept alive, so that no new object can have its address.
    before, held = ordering(), []
    known = {id(item) for item in before}

    class Watcher(NoFrames):
        def begin(self, frame_count: int, vertex_count: int, faces: np.ndarray) -> None:
            held.extend(type(item).__name__ for item in ordering() if id(item) not in known)

    warpqem.simplify(POINTS, FACES, ratio=0.5, sink=Watcher(), device="cpu")
    assert held == []


def test_progress_is_reported_from_block_to_block():
    seen = []
    options = {"ratio": 0.5, "sink": NoFrames(), "device": "cpu"}
    memory = min_memory(**options)
    warpqem.simplify(POINTS, FACES, memory=memory, progress=lambda *call: seen.append(call), **options)
    assert [sum(stage == name for _, stage in seen) for name in ("read", "place")] == [3, 3]
    assert [part for part, _ in seen] == sorted(part for part, _ in seen)
    assert seen[-1] == (pytest.approx(1), "place")


def test_memory_that_cannot_do_is_refused_before_a_frame_is_read():
    source = CountedFrames(POINTS)
    with pytest.raises(MemoryLimitError, match=r"need .* for ordering, and 100K may be used.*fewer key frames than 16"):
        warpqem.simplify(source, FACES, ratio=0.5, memory="100K", device="cpu")
    assert source.total == 0


def test_the_refusal_of_dod_names_the_metric():
    with pytest.raises(MemoryLimitError, match="a metric other than dod"):
        warpqem.plan(np.zeros((5000, 3, 3)), [[0, 1, 2]], ratio=0.5, metric="dod", memory="100K")


def test_a_result_too_large_to_keep_is_refused_for_a_sink():
    points = np.broadcast_to(POINTS[:1], (100_000, *POINTS.shape[1:]))
    with pytest.raises(MemoryLimitError, match="a sink for the frames"):
        warpqem.plan(points, FACES, ratio=1.0, memory="100M")
    assert warpqem.plan(points, FACES, ratio=1.0, memory="100M", sink=NoFrames()).peak_bytes < 100 * 2**20


def test_the_plan_of_many_frames_takes_little_more_than_that_of_few():
    few, many = (
        warpqem.plan(
            np.broadcast_to(POINTS[:1], (count, *POINTS.shape[1:])),
            FACES,
            ratio=0.1,
            quality="fast",
            sink=NoFrames(),
        )
        for count in (50, 50_000)
    )
    # Poses to choose key frames from, and a full block with its neighbours; frames are kept where there is memory.
    needed = [plan.peak_bytes - plan.device_frame_bytes for plan in (few, many)]
    assert needed[1] - needed[0] <= POSE_BYTES + 12 * BLOCK_BYTES


def test_the_plan_of_levels_counts_what_is_kept_of_them():
    one, many = (warpqem.plan(POINTS, FACES, ratio=0.1, memory="1G", levels=levels) for levels in (False, True))
    assert many.order_bytes - one.order_bytes == 16 * len(POINTS[0]) * 52
    assert many.place_bytes > one.place_bytes


def test_levels_are_placed_from_a_source_to_sinks_in_small_blocks(monkeypatch):
    whole = warpqem.simplify_levels(POINTS, FACES, ratios=(0.5, 0.2), device="cpu")
    monkeypatch.setattr("warpqem.pipeline.memory_plan.BLOCK_BYTES", 1)
    order = warpqem.order_levels(CountedFrames(POINTS), FACES, target_faces=64, keep_frames=False, device="cpu")
    for level, count in zip(whole, (160, 64), strict=True):
        sink = ArraySink()
        assert order.level(count, sink=sink).plan.block_count == 3
        np.testing.assert_array_equal(sink.points, level.points)


def test_the_plan_says_how_the_work_is_cut():
    plan = warpqem.plan(POINTS, FACES, ratio=0.5, memory="1G", device="cpu")
    assert (plan.frame_count, plan.key_frames, plan.block_frames, plan.block_count) == (FRAME_COUNT, 16, FRAME_COUNT, 1)
    assert "21 frames in 1 block of 21, 16 key frames" in str(plan)
    assert plan.to_dict()["peak_bytes"] == plan.peak_bytes <= plan.limit_bytes == 2**30


def test_the_plan_of_the_result_is_the_one_announced():
    options = {"ratio": 0.5, "memory": "1G", "device": "cpu"}
    assert warpqem.simplify(POINTS, FACES, **options).plan == warpqem.plan(POINTS, FACES, **options)


@pytest.mark.parametrize(
    ("text", "count"), [("8G", 8 * 2**30), ("1.5 MiB", 3 * 2**19), ("500m", 500 * 2**20), ("+2G", 2**31), (7, 7)]
)
def test_bytes_are_read(text, count):
    assert parse_bytes(text) == count


@pytest.mark.parametrize("text", ["", "8X", "-1G", "0", 0, "G", "1e9"])
def test_what_is_no_number_of_bytes_is_refused(text):
    with pytest.raises(OptionError, match="expected bytes above 0, such as 8G"):
        warpqem.simplify(POINTS, FACES, ratio=0.5, memory=text)


@pytest.mark.parametrize("count", [1, 1023, 123_456, 2**20, 10 * 2**20 - 1, 123_456_789, 2**33 + 1])
def test_bytes_as_they_are_printed_are_enough(count):
    assert count <= parse_bytes(format_bytes(count)) <= 1.1 * count + 1024


def test_frame_blocks_cover_every_frame_once():
    blocks = frame_blocks(1000, 100000)
    assert [i for b in blocks for i in range(1000)[b]] == list(range(1000))
    assert len(blocks) > 1


def test_frame_blocks_have_a_bounded_size():
    assert max(b.stop - b.start for b in frame_blocks(1000, 10000)) * 10000 * 12 <= BLOCK_BYTES


def test_a_frame_block_fills_a_vector_register_at_least():
    assert [b.stop for b in frame_blocks(17, 10**9)] == [8, 16, 17]


def test_the_next_block_is_read_while_one_is_at_work():
    second_read = threading.Event()

    def read(frames: slice) -> slice:
        if frames.start:
            second_read.set()
        return frames

    reader = read_ahead(read, [slice(0, 1), slice(1, 2)])
    next(reader)
    assert second_read.wait(timeout=10)
    assert list(reader) == [(slice(1, 2), slice(1, 2))]


def test_blocks_are_written_in_order_while_the_caller_goes_on():
    written, gate = [], threading.Event()

    def write(frames: slice, block: int) -> None:
        gate.wait(timeout=10)
        written.append(block)

    with FrameWriter(write, 3) as writer:
        writer(slice(0, 1), 0)
        assert written == []
        gate.set()
        writer(slice(1, 2), 1)
        writer(slice(2, 3), 2)
    assert written == [0, 1, 2]
