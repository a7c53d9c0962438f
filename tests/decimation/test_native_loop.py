"""Passes without the host: the collapses of the loop on the host, to the bit."""

import os

import numpy as np
import pytest

import warpqem
from tests.support import meshes
from warpqem.decimation import native_loop
from warpqem.decimation.native_loop import SmallOrderer
from warpqem.decimation.passes import SAMPLE_STEP, Orderer
from warpqem.errors import UnreachableTargetError
from warpqem.kernels.pass_control import MIN_SAMPLE

pytestmark = pytest.mark.skipif("CUDA_SEMANTICS" in os.environ, reason="of a CPU that works like one")

CLOSED, OPEN = meshes.swaying_sphere(3, 4), meshes.waving_grid(20, 4)
MANY_PARTS = meshes.joined(*[meshes.icosphere(0)] * 5, meshes.icosphere(2), *[meshes.tetrahedron()] * 4, spacing=2.5)
ENDS = {
    "50 %": {"ratio": 0.5},
    "10 %": {"ratio": 0.1},
    "3 %": {"ratio": 0.03},
    "unreachable": {"target_faces": 1, "max_error": 0.3},
    "no legal collapse": {"target_faces": 1},
    "error limit": {"max_error": 0.4},
    "nothing to do": {"ratio": 1.0},
}
KINDS = {
    "memoryless": {"memoryless": True},
    "dod": {"metric": "dod"},
    "one frame": {"metric": "qem"},
    "endpoint": {"placement": "endpoint"},
    "locked": {"lock_borders": True},
    "best": {"quality": "best"},
}


@pytest.fixture
def simplified(monkeypatch):
    """Simplify with a loop of one's own; the result, also of a target that cannot be reached."""

    def simplify(loop, mesh, **options):
        monkeypatch.setattr("warpqem.decimation.decimate._new_ordering", loop)
        try:
            return warpqem.simplify(*mesh, device="cpu", **options)
        except UnreachableTargetError as error:
            return error.result

    return simplify


@pytest.fixture
def on_the_host(monkeypatch):
    """Passes that the host was asked for."""
    passes = []
    run_pass = Orderer._run_pass
    monkeypatch.setattr(Orderer, "_run_pass", lambda self, *rest: passes.append(1) or run_pass(self, *rest))
    return passes


def assert_same(one, other):
    assert one.stopped == other.stopped
    for name in ("points", "faces", "vertex_map", "face_map"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    for name, values in vars(one.log).items():
        np.testing.assert_array_equal(values, getattr(other.log, name), err_msg=name)


@pytest.mark.parametrize("mesh", [CLOSED, OPEN], ids=["closed", "open"])
@pytest.mark.parametrize("options", ENDS.values(), ids=ENDS)
def test_loop_ends_as_on_the_host(options, mesh, simplified):
    assert_same(*(simplified(loop, mesh, **options) for loop in (SmallOrderer, Orderer)))


@pytest.mark.parametrize("options", KINDS.values(), ids=KINDS)
def test_loop_makes_the_collapses_of_the_host(options, simplified):
    assert_same(*(simplified(loop, OPEN, ratio=0.2, **options) for loop in (SmallOrderer, Orderer)))


def test_costs_are_sampled_as_on_the_host(simplified, on_the_host):
    mesh = meshes.swaying_sphere(4, 2)
    assert 3 * len(mesh[1]) > SAMPLE_STEP * int(MIN_SAMPLE)
    native = simplified(SmallOrderer, mesh, ratio=0.3)
    assert on_the_host == []
    assert_same(native, simplified(Orderer, mesh, ratio=0.3))


def test_threads_change_no_bit(simplified, monkeypatch):
    results = []
    for threads in (1, 3):
        monkeypatch.setattr("warpqem.decimation.pass_steps.thread_count", lambda _, threads=threads: threads)
        results.append(simplified(SmallOrderer, OPEN, ratio=0.2, quality="best"))
    assert_same(*results)


def test_the_host_is_not_asked_on_a_small_mesh(simplified, on_the_host):
    simplified(SmallOrderer, CLOSED, ratio=0.2)
    assert on_the_host == []


@pytest.mark.parametrize(
    ("mesh", "options"),
    [(CLOSED, {"metric": "dod"}), (MANY_PARTS, {"target_faces": 30})],
    ids=["deformation", "components"],
)
def test_what_needs_the_host_is_left_to_it(mesh, options, simplified, on_the_host):
    simplified(SmallOrderer, mesh, **{"ratio": 0.2, **options} if "target_faces" not in options else options)
    assert on_the_host


def test_a_large_mesh_is_left_to_the_host(simplified, on_the_host, monkeypatch):
    monkeypatch.setattr(native_loop, "SMALL_FACES", len(CLOSED[1]) - 1)
    simplified(SmallOrderer, CLOSED, ratio=0.2)
    assert on_the_host


def test_progress_is_told_once(simplified):
    told = []
    simplified(SmallOrderer, CLOSED, ratio=0.1, progress=lambda share, text: told.append((share, text)))
    assert told == sorted(told, key=lambda entry: entry[0])
    assert [text for _, text in told].count("order") == 1
