"""Progress as a function or a bar, and calls that are cancelled from another thread."""

from __future__ import annotations

import contextlib
import functools
import sys
import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import warpqem
from tests.support import meshes, symmetry
from tests.support.usd_stages import cloth_stage, define_cloth
from warpqem.arguments.progress import listener, with_progress_bar
from warpqem.errors import CancelledError, OptionError
from warpqem.usd import SimplifyOptions, simplify_stage

POINTS, FACES = meshes.swaying_sphere(2, 4)


class SetAfter:
    """A token that is set once it has been asked so often."""

    def __init__(self, count: int) -> None:
        self.count = count

    def is_set(self) -> bool:
        self.count -= 1
        return self.count < 0


def a_level(**options):
    return warpqem.order_levels(POINTS, FACES, target_faces=60, device="cpu").level(80, **options)


CALLS = {
    "simplify": functools.partial(warpqem.simplify, POINTS, FACES, ratio=0.3, device="cpu"),
    "limit": functools.partial(warpqem.simplify, POINTS, FACES, max_error=2.0, device="cpu"),
    "symmetric": functools.partial(
        warpqem.simplify_symmetric, symmetry.POINTS, symmetry.FACES, "x", ratio=0.3, device="cpu"
    ),
    "levels": functools.partial(warpqem.simplify_levels, POINTS, FACES, ratios=[0.5, 0.3], device="cpu"),
    "order": functools.partial(warpqem.order_levels, POINTS, FACES, target_faces=60, device="cpu"),
    "level": a_level,
    "progressive": functools.partial(warpqem.build_progressive, POINTS, FACES, device="cpu"),
}


@pytest.mark.parametrize("name", CALLS)
def test_a_call_that_was_cancelled_before_does_nothing(name):
    token = threading.Event()
    token.set()
    with pytest.raises(CancelledError, match="cancelled before it began"):
        CALLS[name](cancel=token)


@pytest.mark.parametrize("name", CALLS)
def test_a_call_ends_where_progress_would_be_called(name):
    with pytest.raises(CancelledError, match=r"cancelled at \d+ %"):
        CALLS[name](cancel=SetAfter(1))


@pytest.mark.parametrize("name", CALLS)
def test_progress_true_goes_to_its_end_without_a_terminal(name, capsys):
    CALLS[name](progress=True)
    assert capsys.readouterr().err == ""


@given(count=st.integers(0, 60))
@settings(deadline=None, max_examples=12)
def test_a_cancelled_call_has_no_part_in_the_next_one(count):
    whole = warpqem.simplify(POINTS, FACES, ratio=0.3, device="cpu")
    with contextlib.suppress(CancelledError):
        warpqem.simplify(POINTS, FACES, ratio=0.3, device="cpu", cancel=SetAfter(count))
    again = warpqem.simplify(POINTS, FACES, ratio=0.3, device="cpu")
    assert np.array_equal(whole.points, again.points)
    assert np.array_equal(whole.faces, again.faces)


def test_another_thread_ends_a_call():
    token, begun = threading.Event(), threading.Event()
    seen = []

    def show(fraction, text):
        seen.append(fraction)
        begun.set()
        token.wait(30)

    def end():
        begun.wait(30)
        token.set()

    other = threading.Thread(target=end)
    other.start()
    with pytest.raises(CancelledError):
        warpqem.simplify(POINTS, FACES, ratio=0.3, device="cpu", progress=show, cancel=token)
    other.join()
    assert len(seen) == 1


def test_progress_false_is_nothing_and_a_function_is_called_to_the_end():
    seen = []
    warpqem.simplify(POINTS, FACES, ratio=0.3, device="cpu", progress=False)
    warpqem.simplify(POINTS, FACES, ratio=0.3, device="cpu", progress=lambda done, stage: seen.append((done, stage)))
    assert [done for done, _ in seen] == sorted(done for done, _ in seen)
    assert seen[-1] == (1.0, "place")


def test_what_cannot_be_asked_whether_it_is_set_is_refused():
    for token in (True, "stop", threading.Event):
        with (
            pytest.raises(OptionError, match="cancel must have is_set")
            if token is not threading.Event
            else (pytest.raises(TypeError))
        ):
            warpqem.simplify(POINTS, FACES, ratio=0.3, device="cpu", cancel=token)


def test_a_bar_is_drawn_on_a_terminal_and_taken_away_also_after_an_error(monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("TERM", "xterm")
    steps = []

    @with_progress_bar
    def work(progress=None):
        listen = listener(progress)
        assert callable(listen)
        listen(0.5, "order")
        steps.append(listen)
        raise RuntimeError("in the middle")

    with pytest.raises(RuntimeError):
        work(progress=True)
    assert steps
    shown = capsys.readouterr()
    assert shown.out == ""
    assert "collapsing edges" in shown.err
    assert "\x1b[2K" in shown.err


def test_a_stage_that_is_cancelled_is_not_written(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    define_cloth(stage, "/Root/Second", size=5, times=[1.0, 2.0])
    stage.Save()
    before = sorted(path.name for path in tmp_path.iterdir())
    for count in (1, 6):
        with pytest.raises(CancelledError):
            simplify_stage(
                tmp_path / "in.usda", tmp_path / "out.usda", SimplifyOptions(ratio=0.3), cancel=SetAfter(count)
            )
        assert sorted(path.name for path in tmp_path.iterdir()) == before
