"""Many meshes in one call: what each call alone gives, errors by place, cancelling, threads."""

from __future__ import annotations

import contextlib
import threading

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

import warpqem
from tests.support import meshes
from warpqem.errors import (
    CancelledError,
    DeviceError,
    FaceIndexError,
    MemoryLimitError,
    NonFinitePointError,
    OptionError,
    UnreachableTargetError,
    WarpqemError,
)
from warpqem.pipeline import many
from warpqem.runtime.cpu_threads import thread_count
from warpqem.runtime.thread_limit import limit_threads, thread_limit, thread_scope, worthwhile_threads

SHAPES = [
    meshes.icosphere(1),
    meshes.torus(),
    meshes.grid(6, 9),
    meshes.swaying_sphere(2, 4),
    meshes.tube(12, 10),
    meshes.swaying_sphere(1, 3),
]


@pytest.fixture(params=[1, 3], autouse=True)
def workers(request, monkeypatch):
    """How many are at work at once, whatever this machine has."""
    monkeypatch.setattr(many, "thread_count", lambda device: request.param)
    return request.param


def same(one: warpqem.SimplifiedMesh, other: warpqem.SimplifiedMesh) -> bool:
    names = ("points", "faces", "vertex_map", "face_map", "flips", "key_frames")
    return one.stopped == other.stopped and all(
        np.array_equal(getattr(one, name), getattr(other, name)) for name in names
    )


@given(order=st.lists(st.integers(0, len(SHAPES) - 1), max_size=9), ratio=st.sampled_from([0.2, 0.5]))
@settings(deadline=None, max_examples=10)
def test_each_mesh_has_the_bits_of_a_call_of_its_own(order, ratio):
    given_meshes = [SHAPES[index] for index in order]
    results = warpqem.simplify_many(given_meshes, ratio=ratio, device="cpu")
    alone = [warpqem.simplify(*mesh, ratio=ratio, device="cpu") for mesh in given_meshes]
    assert len(results) == len(alone)
    assert all(map(same, results, alone))


def test_meshes_may_have_options_of_their_own_and_be_trimeshes():
    sphere = trimesh.creation.icosphere(subdivisions=2)
    points, faces = SHAPES[1]
    asked = [sphere, (points, faces, {"target_faces": 100}), (points, faces, {"metric": "qem", "ratio": 0.3})]
    results = warpqem.simplify_many(iter(asked), ratio=0.5, device="cpu")
    assert [len(result.faces) for result in results] == [160, 100, 172]
    assert same(results[0], warpqem.simplify(sphere, ratio=0.5, device="cpu"))
    assert same(results[2], warpqem.simplify(points, faces, metric="qem", ratio=0.3, device="cpu"))


def test_no_mesh_gives_no_result():
    assert warpqem.simplify_many([], ratio=0.5) == []


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"coherence": 2.0}, "coherence must be"),
        ({"ratio": 2.0}, "ratio must be"),
        ({"target_faces": 5}, "exclude each other"),
        ({"metric": "nonsense"}, "metric"),
        ({"memory": "much"}, "memory 'much'"),
        ({"attributes": 3}, "attributes must be a list"),
        ({"face": warpqem.face.FaceProtection()}, "face= needs metric 'face'"),
        ({"device": "tpu"}, "no Warp device 'tpu'"),
    ],
)
@pytest.mark.parametrize("asked", [[], [(*SHAPES[0], {"ratio": 0.5, "coherence": 0.5})]])
def test_options_for_all_are_checked_whatever_the_meshes_are(asked, options, match):
    with pytest.raises((OptionError, DeviceError), match=match):
        warpqem.simplify_many(asked, **{"ratio": 0.5, **options})


def test_options_that_do_not_exist_are_refused_without_any_mesh():
    with pytest.raises(TypeError, match="'nonsense'"):
        warpqem.simplify_many([], nonsense=3)


def test_no_mesh_needs_no_goal():
    assert warpqem.simplify_many([], quality="best") == []


def broken(index: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Meshes, of which two cannot be done."""
    points, faces = SHAPES[0]
    found = [(points, faces)] * 6
    found[index] = (np.where(np.arange(len(points))[:, None] == 7, np.nan, points), faces)
    found[index + 2] = (points, faces + 5)
    return found


def test_the_first_error_in_order_is_raised_and_names_its_mesh():
    for _ in range(3):
        with pytest.raises(NonFinitePointError, match=r"^meshes\[2\]: .*vertex 7"):
            warpqem.simplify_many(broken(2), ratio=0.5, device="cpu")


def test_errors_may_stand_in_the_place_of_results():
    results = warpqem.simplify_many(broken(1), ratio=0.5, device="cpu", return_errors=True)
    kinds = [type(result) for result in results]
    good = warpqem.SimplifiedMesh
    assert kinds == [good, NonFinitePointError, good, FaceIndexError, good, good]
    assert str(results[3]).startswith("meshes[3]: ")


def test_an_unreachable_target_keeps_its_result():
    points, faces = SHAPES[0]
    [found] = warpqem.simplify_many([(points, faces)], target_faces=1, device="cpu", return_errors=True)
    assert isinstance(found, UnreachableTargetError)
    assert len(found.result.faces) > 1


@pytest.mark.parametrize(
    ("asked", "options", "match"),
    [
        ("none", {}, "meshes must be a list"),
        (3, {}, "meshes must be a list"),
        ([(*SHAPES[0], 0.5)], {}, r"meshes\[0\]: options must be a dictionary"),
        ([SHAPES[0]], {"coherence": 2.0}, r"meshes\[0\]: coherence must be"),
        ([(*SHAPES[0], {"ratio": 2})], {}, r"meshes\[0\]: ratio must be"),
        ([SHAPES[0]], {"ratio": None}, "one of ratio, target_faces"),
        ([SHAPES[0]], {"return_errors": "yes"}, "return_errors must be True or False"),
    ],
)
def test_wrong_arguments_are_named_before_the_work(asked, options, match):
    with pytest.raises(OptionError, match=match):
        warpqem.simplify_many(asked, **{"ratio": 0.5, **options})


SPHERE = SHAPES[0]
# The third of a mesh, and what its error says.
OWN = {
    "ratio": ({"ratio": 2.0}, "ratio must be in (0, 1], got 2.0"),
    "text": ({"ratio": "half"}, "ratio must be in (0, 1]"),
    "no goal": ({"ratio": None}, "one of ratio, target_faces"),
    "two goals": ({"ratio": 0.5, "target_faces": 9}, "exclude each other"),
    "weights": ({"vertex_weights": np.ones(3)}, "vertex_weights must be"),
    "attributes": ({"attributes": 3}, "attributes must be a list"),
    "device": ({"device": "tpu"}, "no Warp device 'tpu'"),
    "metric": ({"metric": "nonsense"}, "unknown metric 'nonsense'"),
    "memory": ({"memory": "much"}, "memory 'much'"),
    "motion": ({"metric": "aqem", "motion": 5}, "motion must be a MotionWeighting"),
    "face": ({"metric": "face", "face": 5}, "face must be a FaceProtection"),
    "of another metric": ({"motion": warpqem.costs.MotionWeighting()}, "motion= needs a metric"),
    "unknown": ({"rato": 0.5}, "there is no option 'rato' (str); the options are ratio, "),
    "no name": ({3: 0.5}, "there is no option 3; the options are ratio, "),
    "an argument of all": ({"progress": print}, "there is no option 'progress'"),
    "no dictionary": (0.5, "options must be a dictionary, got 0.5"),
}


@pytest.mark.parametrize("case", OWN)
def test_wrong_options_of_one_mesh_are_its_error_and_the_others_are_done(case):
    own, text = OWN[case]
    asked = [SPHERE, (*SPHERE, own), SPHERE]
    found = warpqem.simplify_many(asked, ratio=0.5, device="cpu", return_errors=True)
    good = warpqem.SimplifiedMesh
    assert [type(result) for result in found[::2]] == [good, good]
    assert isinstance(found[1], WarpqemError)
    assert str(found[1]).startswith("meshes[1]: ")
    assert text in str(found[1])


@pytest.mark.parametrize("mesh", [(SPHERE[0],), (*SPHERE, {}, 1), (), None, "sphere", {}])
def test_what_is_no_mesh_is_an_error_in_its_place(mesh):
    found = warpqem.simplify_many([mesh, SPHERE], ratio=0.5, device="cpu", return_errors=True)
    assert isinstance(found[0], WarpqemError)
    assert str(found[0]).startswith("meshes[0]: ")
    assert isinstance(found[1], warpqem.SimplifiedMesh)


def test_options_for_all_end_the_call_where_errors_are_results_too():
    with pytest.raises(OptionError, match=r"^coherence must be"):
        warpqem.simplify_many([SPHERE], ratio=0.5, coherence=2.0, return_errors=True)


def test_no_goal_for_all_is_none_where_each_mesh_has_one():
    [found] = warpqem.simplify_many([(*SPHERE, {"ratio": 0.5})], ratio=None, device="cpu")
    assert len(found.faces) == 40


def test_only_wrong_meshes_are_errors_alone():
    found = warpqem.simplify_many([(*SPHERE, {"ratio": 2}), None], ratio=0.5, return_errors=True)
    assert [isinstance(error, WarpqemError) for error in found] == [True, True]


def test_a_mesh_takes_no_more_memory_than_its_own_options_say(workers, monkeypatch):
    real, limits = many.simplify, []

    def watched(points, faces, **options):
        limits.append(options["memory"])
        return real(points, faces, **options)

    monkeypatch.setattr(many, "simplify", watched)
    own = {"memory": "100M"}
    warpqem.simplify_many([SPHERE, (*SPHERE, own), SPHERE], ratio=0.5, device="cpu", memory="900M")
    shared = "900M" if workers == 1 else 300 * 2**20
    assert sorted(map(str, limits)) == sorted(map(str, [shared, "100M" if workers == 1 else 100 * 2**20, shared]))


def test_an_option_that_does_not_exist_is_named():
    with pytest.raises(TypeError, match=r"meshes\[0\]: unexpected keyword argument 'nonsense'"):
        warpqem.simplify_many([SHAPES[0]], ratio=0.5, nonsense=3)


def test_progress_is_called_by_the_caller_s_thread_up_to_the_end():
    seen, threads = [], set()

    def show(fraction, text):
        seen.append((fraction, text))
        threads.add(threading.get_ident())

    warpqem.simplify_many(SHAPES, ratio=0.5, device="cpu", progress=show)
    fractions = [fraction for fraction, _ in seen]
    assert fractions == sorted(fractions)
    assert seen[-1] == (1.0, "6 of 6 meshes")
    assert threads == {threading.get_ident()}


def test_another_thread_ends_the_call(workers):
    stop = threading.Event()
    timer = threading.Timer(0.2, stop.set)
    timer.start()
    with pytest.raises(CancelledError):
        warpqem.simplify_many(SHAPES * 500, ratio=0.5, device="cpu", cancel=stop)
    timer.join()


def test_what_progress_raises_ends_the_call():
    def show(fraction, text):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        warpqem.simplify_many(SHAPES * 100, ratio=0.5, device="cpu", progress=show)


def test_one_that_needs_all_memory_has_its_turn_alone(workers, monkeypatch):
    real, limits = many.simplify, []

    def needs_much(points, faces, **options):
        limits.append(options.get("memory"))
        if options.get("memory") is not None and len(points) == len(SHAPES[1][0]):
            raise MemoryLimitError("too little")
        return real(points, faces, **options)

    monkeypatch.setattr(many, "simplify", needs_much)
    results = warpqem.simplify_many(SHAPES[:3], ratio=0.5, device="cpu")
    assert [type(result).__name__ for result in results] == ["SimplifiedMesh"] * 3
    assert limits.count(None) == (3 if workers == 1 else 1)


def test_the_memory_asked_for_is_shared(workers, monkeypatch):
    real, limits = many.simplify, []

    def watched(points, faces, **options):
        limits.append(options["memory"])
        return real(points, faces, **options)

    monkeypatch.setattr(many, "simplify", watched)
    warpqem.simplify_many(SHAPES[:3], ratio=0.5, device="cpu", memory="900M")
    assert set(limits) == {"900M" if workers == 1 else 300 * 2**20}


def test_small_meshes_are_worth_one_thread_and_large_ones_all():
    assert worthwhile_threads(500, 1) == worthwhile_threads(300, 48) == 1
    assert worthwhile_threads(100_000, 1) == 53
    assert worthwhile_threads(16_000, 48) > 8


def test_the_limit_of_threads_ends_with_its_call():
    cores = thread_count("cpu")
    with thread_scope():
        limit_threads(1)
        assert thread_count("cpu") == 1
        warpqem.simplify(*SHAPES[0], ratio=0.5, device="cpu")
        assert thread_limit() == 1
    assert thread_count("cpu") == cores
    with contextlib.suppress(OptionError), thread_scope():
        limit_threads(1)
        raise OptionError
    assert thread_limit() is None


def test_there_is_no_limit_of_threads_outside_of_a_call():
    limit_threads(1)
    assert thread_limit() is None


def test_a_limit_of_threads_has_no_part_in_the_bits(monkeypatch):
    points, faces = meshes.swaying_sphere(3, 8)
    results = []
    for threads in (1, 5):
        monkeypatch.setattr("warpqem.pipeline.prepare.worthwhile_threads", lambda *sizes, most=threads: most)
        results.append(warpqem.simplify(points, faces, ratio=0.2, device="cpu"))
    assert same(*results)
