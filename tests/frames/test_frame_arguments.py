"""Sources and sinks of frames that do not do what they say, and those that do it in unusual ways."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import pytest
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st

import warpqem
from tests.support import meshes
from warpqem.errors import DegenerateMeshError, FrameSourceError, NonFinitePointError, OptionError
from warpqem.face import facial_features
from warpqem.frames.checked_frames import CheckedFrames
from warpqem.frames.stream import ArraySink, NoFrames

POINTS, FACES = meshes.swaying_sphere(1, 20)
POINTS = POINTS.astype(np.float32)
OPTIONS = {"ratio": 0.5, "device": "cpu", "key_frames": 3}


class Frames:
    """A sound source, whose parts can be replaced; counts how often it is read."""

    def __init__(self, points: np.ndarray = POINTS, **parts: Any) -> None:
        self.points, self.frame_count, self.vertex_count, self.dtype = points, *points.shape[:2], points.dtype
        self.reads = 0
        self.__dict__.update(parts)

    def read(self, frames: slice) -> Any:
        self.reads += 1
        return self.give(self.points[frames])

    def give(self, points: np.ndarray) -> Any:
        return points


class Reusing(Frames):
    """Gives one buffer again and again, as a decoder does."""

    buffer: np.ndarray | None = None

    def give(self, points: np.ndarray) -> np.ndarray:
        if self.buffer is None:
            self.buffer = np.empty_like(self.points)
        self.buffer[:] = np.nan
        self.buffer[: len(points)] = points
        return self.buffer[: len(points)]


@pytest.fixture
def small_blocks(monkeypatch):
    """Blocks of 8 frames, so that several are under way."""
    for module in ("frames.blocks", "pipeline.memory_plan"):
        monkeypatch.setattr(f"warpqem.{module}.BLOCK_BYTES", 1)


@pytest.fixture(autouse=True)
def _no_thread_is_left():
    yield
    assert [t.name for t in threading.enumerate() if t.name.startswith(("warpqem-read", "warpqem-write"))] == []


CALLS = {
    "simplify": lambda source: warpqem.simplify(source, FACES, **OPTIONS),
    "plan": lambda source: warpqem.plan(source, FACES, **OPTIONS),
    "simplify_levels": lambda source: warpqem.simplify_levels(source, FACES, ratios=[0.5], device="cpu"),
    "order_levels": lambda source: warpqem.order_levels(source, FACES, target_faces=40, device="cpu"),
    "build_progressive": lambda source: warpqem.build_progressive(source, FACES, base_faces=60, device="cpu"),
    "motion_features": lambda source: warpqem.motion_features(source, FACES, device="cpu"),
    "facial_features": lambda source: facial_features(source, FACES),
    "morph_weights": lambda source: warpqem.costs.morph_weights(POINTS[0], source),
}
READERS = sorted(CALLS.keys() - {"plan"})


@pytest.mark.parametrize("call", sorted(CALLS))
@pytest.mark.parametrize(
    ("parts", "error", "message"),
    [
        ({"frame_count": 0}, DegenerateMeshError, "0 frames"),
        ({"frame_count": -3}, DegenerateMeshError, "-3 frames"),
        ({"frame_count": "20"}, FrameSourceError, r"\.frame_count must be a whole number, got '20' \(str\)"),
        ({"frame_count": 19.5}, FrameSourceError, r"\.frame_count must be a whole number, got 19.5"),
        ({"frame_count": True}, FrameSourceError, r"\.frame_count must be a whole number, got True \(bool\)"),
        ({"frame_count": None}, FrameSourceError, r"\.frame_count must be a whole number, got None"),
        ({"frame_count": float("nan")}, FrameSourceError, r"\.frame_count must be a whole number, got nan"),
        ({"vertex_count": 0}, DegenerateMeshError, "of 0 vertices"),
        ({"vertex_count": [42]}, FrameSourceError, r"\.vertex_count must be a whole number, got \[42\] \(list\)"),
        ({"dtype": np.dtype(int)}, FrameSourceError, "must be float32 or float64, got a source of int64"),
        ({"dtype": np.float16}, FrameSourceError, "must be float32 or float64, got a source of .*float16"),
        ({"dtype": "floats"}, FrameSourceError, "must be float32 or float64, got a source of floats"),
        ({"dtype": None}, FrameSourceError, "must be float32 or float64, got a source of None"),
        ({"read": POINTS}, FrameSourceError, r"\.read must be a method"),
    ],
    ids=lambda value: str(value)[:24],
)
def test_what_a_source_says_of_itself_is_checked(call, parts, error, message):
    with pytest.raises(error, match=message):
        CALLS[call](Frames(**parts))


@pytest.mark.parametrize("call", sorted(CALLS))
def test_a_source_that_lacks_something_is_named(call):
    class Half:
        frame_count = 20

        def read(self, frames: slice) -> np.ndarray:
            return POINTS[frames]

    with pytest.raises(FrameSourceError, match="a Half has read, but no vertex_count and no dtype"):
        CALLS[call](Half())


@pytest.mark.parametrize("call", sorted(CALLS))
def test_the_class_of_a_source_is_none(call):
    class Cache(Frames):
        frame_count, vertex_count, dtype = 20, 42, np.dtype(np.float32)

    with pytest.raises(FrameSourceError, match=r"the class Cache was given, expected an instance: Cache\(\)"):
        CALLS[call](Cache)


@pytest.mark.parametrize("call", READERS)
@pytest.mark.parametrize(
    ("give", "message"),
    [
        (lambda points: None, "frames 0 to .*must be an array, got None"),
        (lambda points: points[:, :-1], r"frames 0 to .*: expected shape \(\d+, 42, 3\), got \(\d+, 41, 3\)"),
        (lambda points: points[0, :5], r"expected shape \(\d+, 42, 3\), got \(5, 3\)"),
        (lambda points: np.concatenate([points, points]), r"expected shape \(\d+, 42, 3\), got"),
        (lambda points: points[:0], r"got \(0, 42, 3\)"),
        (lambda points: points.astype(np.float64), "expected float32, as .*dtype says, got float64"),
        (lambda points: points.astype(int), "expected float32, as .*dtype says, got int64"),
        (lambda points: points.tolist(), "expected float32, as .*dtype says, got float64"),
        (lambda points: points.astype(str), "expected float32, as .*dtype says, got <U32"),
        (lambda points: np.ma.MaskedArray(points, points > 0.4), "masked values"),
        (lambda points: [[1, 2], [3]], "cannot be converted to an array"),
    ],
)
def test_what_a_source_gives_is_checked(call, give, message):
    with pytest.raises(FrameSourceError, match=message):
        CALLS[call](Frames(give=give))


@pytest.mark.parametrize("parts", [{"dtype": np.float32}, {"dtype": "float32"}, {"frame_count": np.int16(20)}])
def test_what_a_source_says_may_come_in_other_types(parts):
    np.testing.assert_array_equal(CALLS["simplify"](Frames(**parts)).points, CALLS["simplify"](POINTS).points)


@pytest.mark.parametrize(
    "give",
    [
        lambda points: points.astype(">f4"),
        lambda points: points[:, ::-1].copy()[:, ::-1],
        lambda points: np.asfortranarray(points),
        lambda points: np.ma.MaskedArray(points),
        lambda points: wp.array(points, dtype=wp.vec3, device="cpu"),
    ],
)
def test_what_a_source_gives_may_lie_anyhow(give):
    np.testing.assert_array_equal(CALLS["simplify"](Frames(give=give)).points, CALLS["simplify"](POINTS).points)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.usefixtures("small_blocks")
def test_a_source_may_use_one_buffer_for_all_its_frames(dtype):
    points, sink = POINTS.astype(dtype), ArraySink()
    whole = warpqem.simplify(points, FACES, **OPTIONS)
    result = warpqem.simplify(Reusing(points), FACES, sink=sink, **OPTIONS)
    assert result.plan.block_count == 3
    np.testing.assert_array_equal(sink.points, whole.points)
    np.testing.assert_array_equal(result.key_frames, whole.key_frames)


@pytest.mark.usefixtures("small_blocks")
@pytest.mark.parametrize("read", range(3, 9))
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_point_that_is_not_finite_when_it_is_read_again_is_named(read, value):
    source = Frames()
    # Three blocks to look through, three key frames, three blocks to place.

    def give(points: np.ndarray) -> np.ndarray:
        if source.reads != read + 1:
            return points
        changed = points.copy()
        changed[0, 7, 2] = value
        return changed

    source.give = give
    with pytest.raises(NonFinitePointError, match=rf"vertex 7 in frame \d+ has z = {value}, which was finite when"):
        warpqem.simplify(source, FACES, **OPTIONS)
    assert source.reads > read


@pytest.mark.usefixtures("small_blocks")
@pytest.mark.parametrize("read", [3, 5, 6, 8])
def test_frames_that_differ_when_they_are_read_again_are_named(read):
    source = Frames()
    source.give = lambda points: points if source.reads <= read else points * np.float32(1.001)
    with pytest.raises(
        FrameSourceError, match=r"frame \d+ lies within \(.*\) to \(.*\), and within .* when it was read"
    ):
        warpqem.simplify(source, FACES, **OPTIONS)


@pytest.mark.usefixtures("small_blocks")
@pytest.mark.parametrize("read", range(9))
def test_what_reading_raises_comes_through_as_it_is(read):
    class OwnError(Exception):
        pass

    source = Frames()

    def give(points: np.ndarray) -> np.ndarray:
        if source.reads > read:
            raise OwnError("tape is torn")
        return points

    source.give = give
    with pytest.raises(OwnError, match="tape is torn"):
        warpqem.simplify(source, FACES, **OPTIONS)


@pytest.mark.usefixtures("small_blocks")
@pytest.mark.parametrize("options", [{}, {"refit": True}])
@pytest.mark.parametrize("written", [-1, 0, 1, 2])
def test_what_writing_raises_comes_through_as_it_is(written, options):
    class OwnError(Exception):
        pass

    class Sink(NoFrames):
        blocks = 0

        def begin(self, *arguments: Any) -> None:
            if written < 0:
                raise OwnError("no room")

        def write(self, frames: slice, points: np.ndarray) -> None:
            if self.blocks == written:
                raise OwnError("no room")
            self.blocks += 1

    with pytest.raises(OwnError, match="no room"):
        warpqem.simplify(Frames(), FACES, sink=Sink(), **OPTIONS, **options)


@pytest.mark.usefixtures("small_blocks")
@pytest.mark.parametrize("stage", ["read", "order", "place"])
def test_what_progress_raises_comes_through_as_it_is(stage):
    def progress(part: float, name: str) -> None:
        if name == stage:
            raise KeyError(stage)

    with pytest.raises(KeyError, match=stage):
        warpqem.simplify(Frames(), FACES, progress=progress, **OPTIONS)


class OnlyBegins:
    """A sink that does not write."""

    def begin(self, *arguments: Any) -> None:
        """Nothing to do."""


SINK_CALLS = {
    "simplify": lambda sink, source: warpqem.simplify(source, FACES, sink=sink, **OPTIONS),
    "plan": lambda sink, source: warpqem.plan(source, FACES, sink=sink, **OPTIONS),
    "simplify_symmetric": lambda sink, source: warpqem.simplify_symmetric(source, FACES, sink=sink, **OPTIONS),
}


@pytest.mark.parametrize("call", sorted(SINK_CALLS))
@pytest.mark.parametrize(
    ("sink", "message"),
    [
        ([], r"sink: \[\] \(list\) has no method begin and no method write"),
        ("out.npy", "has no method begin"),
        (OnlyBegins(), "has no method write"),
        (NoFrames, r"the class NoFrames was given, expected an instance: NoFrames\(\)"),
        (print, "has no method begin"),
        (False, r"False \(bool\) has no method begin"),
    ],
)
def test_a_sink_that_is_none_is_refused_before_a_frame_is_read(call, sink, message):
    source = Frames()
    with pytest.raises(OptionError, match=message):
        SINK_CALLS[call](sink, source)
    assert source.reads == 0


def test_sinks_of_levels_are_checked():
    order = warpqem.order_levels(POINTS, FACES, target_faces=40, device="cpu")
    with pytest.raises(OptionError, match="no method write"):
        order.level(50, sink=OnlyBegins())


@settings(deadline=None, max_examples=40)
@given(st.lists(st.tuples(st.integers(0, 19), st.integers(1, 20)), min_size=1, max_size=6), st.integers(0, 41))
def test_frames_read_in_any_order_are_compared_with_what_they_were(readings, vertex):
    source = Frames(POINTS.copy())
    checked = CheckedFrames(source, "points")
    seen: set[int] = set()
    for first, count in readings:
        frames = slice(first, min(20, first + count))
        np.testing.assert_array_equal(checked.read(frames), POINTS[frames])
        seen |= set(range(20)[frames])
    for frame in range(20):
        source.points[frame, vertex] = 9.0
        if frame in seen:
            with pytest.raises(FrameSourceError, match=f"frame {frame} lies within"):
                checked.read(slice(frame, frame + 1))
        else:
            checked.read(slice(frame, frame + 1))
