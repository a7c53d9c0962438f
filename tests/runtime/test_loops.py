"""Loops on a device: as one launch where a graph may hold a loop, else in turns that are queued ahead of the host."""

import os
from dataclasses import replace

import numpy as np
import pytest
import warp as wp

import warpqem.runtime.device
from tests.support import cuda_semantics
from warpqem.runtime.launches import Recorder
from warpqem.runtime.loops import DeviceLoop

under_cuda_semantics = pytest.mark.skipif("CUDA_SEMANTICS" not in os.environ, reason="needs CUDA_SEMANTICS")


@wp.kernel
def count_down(report: wp.array[wp.int32]):
    if report[0] > 0:
        report[0] = report[0] - 1
        report[1] = report[1] + 1


@wp.kernel
def count_up(number: wp.array[wp.int32]):
    number[0] = number[0] + 1


@pytest.fixture(params=[True, False], ids=["loop in the graph", "turns"])
def graph_loops(request, monkeypatch, device):
    """Both kinds of devices."""
    name = "cpu" if wp.get_device(device).is_cpu else "cuda"
    traits = replace(warpqem.runtime.device._TRAITS[name], graph_loops=request.param)
    monkeypatch.setitem(warpqem.runtime.device._TRAITS, name, traits)
    return request.param


def loop_of(turns, device, *more, in_turns=False):
    report = wp.array([turns, 0], dtype=wp.int32, device=device)
    body = Recorder(device)
    body.launch(count_down, 1, [report])
    for number in more:
        body.launch(count_up, 1, [number])
    return DeviceLoop(body, report, device, in_turns)


@pytest.mark.parametrize("turns", [1, 2, 7])
def test_a_loop_runs_until_the_device_says_so(turns, graph_loops, device):
    assert loop_of(turns, device).run().tolist() == [0, turns]


@pytest.mark.parametrize("ahead", [0, 1, 2, 9])
def test_turns_are_reported_in_their_order(ahead, graph_loops, device):
    reports = [report.tolist() for report in loop_of(4, device, in_turns=True).turns(ahead)]
    assert reports == [[3, 1], [2, 2], [1, 3], [0, 4]]


@pytest.mark.parametrize("ahead", [0, 2])
def test_turns_ahead_of_the_host_are_those_asked_for(ahead, graph_loops, device):
    number = wp.zeros(1, dtype=wp.int32, device=device)
    for _ in loop_of(4, device, number, in_turns=True).turns(ahead):
        pass
    assert number.numpy()[0] == 4 + ahead


def test_a_loop_in_a_graph_makes_no_turn_too_many(device):
    number = wp.zeros(1, dtype=wp.int32, device=device)
    loop_of(4, device, number).run()
    assert number.numpy()[0] == 4


def test_a_branch_is_taken_where_its_condition_holds_at_that_time(device):
    number, report = (wp.array([value, 0], dtype=wp.int32, device=device) for value in (0, 3))
    taken, body = Recorder(device), Recorder(device)
    taken.launch(count_up, 1, [number])
    body.launch(count_down, 1, [report])
    # Not in the last turn.
    body.branch(report[:1], taken)
    DeviceLoop(body, report, device).run()
    assert number.numpy()[0] == 2


def test_pairs_with_equal_keys_keep_their_order(device):
    key = np.random.default_rng(0).integers(0, 5, 100)
    keys, values = (wp.zeros(200, dtype=wp.int32, device=device) for _ in range(2))
    keys[:100].assign(key)
    values[:100].assign(np.arange(100))
    recorder = Recorder(device)
    recorder.sort_pairs(keys, values, 100, 3)
    recorder.finish()()
    np.testing.assert_array_equal(values.numpy()[:100], np.argsort(key, kind="stable"))


@under_cuda_semantics
def test_a_loop_is_one_launch_and_one_readback():
    loop = loop_of(5, "cpu")
    with cuda_semantics.counted() as traffic:
        loop.run()
    assert (traffic.graph_launches, traffic.readbacks, traffic.values_read) == (1, 1, 2)


@under_cuda_semantics
@pytest.mark.parametrize(
    "allocate",
    [
        lambda array: wp.utils.array_scan(array, array),
        lambda array: wp.empty(3, dtype=wp.int32, device="cpu"),
        lambda array: wp.clone(array),
        lambda array: wp.utils.runlength_encode(array, array, array),
        lambda array: wp.utils.array_sum(array),
    ],
    ids=["array_scan", "empty", "clone", "runlength_encode", "array_sum"],
)
@pytest.mark.parametrize("nested", [False, True], ids=["in a loop", "in a branch"])
def test_allocating_in_the_body_of_a_loop_is_an_error(allocate, nested):
    array, condition = (wp.zeros(4, dtype=wp.int32, device="cpu") for _ in range(2))
    inner, body = Recorder("cpu"), Recorder("cpu")
    inner._add(lambda: allocate(array), array)
    body.branch(condition[:1], inner)
    with pytest.raises(cuda_semantics.AllocationInLoopError):
        (body if nested else inner).finish_loop(condition[:1])


@under_cuda_semantics
def test_allocating_in_a_plain_graph_is_none():
    array = wp.ones(4, dtype=wp.int32, device="cpu")
    recorder = Recorder("cpu")
    recorder.scan(array, array)
    recorder.finish()()
    assert array.numpy().tolist() == [0, 1, 2, 3]
