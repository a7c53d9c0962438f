"""Loops of operations that a CPU runs without the host."""

import gc
import os
import weakref

import pytest
import warp as wp

from warpqem.runtime.native_programs import NativeRecorder

pytestmark = pytest.mark.skipif("CUDA_SEMANTICS" in os.environ, reason="of a CPU that works like one")


@wp.kernel
def count_down(step: wp.int32, left: wp.array[wp.int32]):
    left[0] = left[0] - step


@wp.kernel
def add_one(values: wp.array[wp.int32]):
    values[wp.tid()] += 1


def integers(*values) -> wp.array:
    return wp.array(values, dtype=wp.int32, device="cpu")


def run_times(times, record):
    """Run what is recorded so often."""
    loop, left = NativeRecorder(), integers(times)
    record(loop)
    loop.launch(count_down, 1, [1], [left])
    loop.finish_loop(left)()
    assert left.numpy()[0] == 0


@pytest.mark.parametrize("times", [0, 1, 7])
def test_a_loop_runs_as_long_as_its_number_says(times):
    values = integers(0, 0, 0)
    run_times(times, lambda loop: loop.launch(add_one, 3, [], [values]))
    assert values.numpy().tolist() == [times] * 3


def test_operations_are_run_in_order():
    values, copied, sums = integers(1, 2, 3), integers(0, 0, 0), integers(0, 0, 0)

    def record(loop):
        loop.copy(copied, values)
        loop.scan(sums, copied)
        loop.zero(values)
        loop.launch(add_one, 3, [], [values])

    run_times(1, record)
    assert copied.numpy().tolist() == [1, 2, 3]
    assert sums.numpy().tolist() == [0, 1, 3]
    assert values.numpy().tolist() == [1, 1, 1]


def test_a_part_of_an_array_is_copied():
    target = integers(0, 0, 0)
    run_times(1, lambda loop: loop.copy(target, integers(5, 6, 7), source_offset=1, count=2))
    assert target.numpy().tolist() == [6, 7, 0]


def test_a_sum_may_include_its_own_item_and_lie_in_its_place():
    values = integers(1, 2, 3)
    run_times(1, lambda loop: loop.scan(values, values, inclusive=True))
    assert values.numpy().tolist() == [1, 3, 6]


def test_counts_are_those_of_the_turn_at_work():
    count, values, sums, copied = integers(0), integers(*[0] * 4), integers(*[0] * 4), integers(*[0] * 8)

    def record(loop):
        loop.launch(add_one, 1, [], [count])
        loop.launch(add_one, 4, [], [values], counted=count)
        loop.scan(sums, values, counted=count, inclusive=True)
        loop.copy(copied, integers(*range(1, 9)), count=2, counted=count)

    run_times(3, record)
    assert values.numpy().tolist() == [3, 2, 1, 0]
    assert sums.numpy().tolist() == [3, 5, 6, 0]
    assert copied.numpy().tolist() == [1, 2, 3, 4, 5, 6, 0, 0]


def test_a_branch_is_taken_where_its_condition_is_not_zero():
    condition, values, after = integers(2), integers(0), integers(0)

    def record(loop):
        taken = NativeRecorder()
        taken.launch(add_one, 1, [], [values])
        taken.launch(count_down, 1, [1], [condition])
        loop.branch(condition, taken)
        loop.launch(add_one, 1, [], [after])

    run_times(5, record)
    assert values.numpy()[0] == 2
    assert after.numpy()[0] == 5


def test_arrays_live_as_long_as_the_loop():
    loop, left, values = NativeRecorder(), integers(2), integers(0)
    loop.launch(add_one, 1, [], [values])
    loop.launch(count_down, 1, [1], [left])
    run, kept = loop.finish_loop(left), weakref.ref(values)
    del loop, values
    gc.collect()
    assert kept() is not None
    run()
    assert kept().numpy()[0] == 2
    del run
    gc.collect()
    assert kept() is None


def test_operations_that_need_the_host_are_refused():
    with pytest.raises(TypeError, match="a loop without the host knows launches, copies, scans and branches only"):
        NativeRecorder().sort_pairs(integers(1, 0), integers(0, 1), 1, 1)


def test_a_launch_without_threads_is_refused():
    with pytest.raises(TypeError, match="kernel add_one cannot be launched by 0 threads, or takes arguments that only"):
        NativeRecorder().launch(add_one, 0, [], [integers(1)])
