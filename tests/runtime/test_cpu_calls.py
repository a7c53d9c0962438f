"""Launches on a CPU that are prepared once for each kernel."""

import gc
import weakref

import numpy as np
import pytest
import warp as wp

from warpqem.kernels.work import Work
from warpqem.runtime.compiling import is_compiled
from warpqem.runtime.cpu_calls import CPU_CODE, prepared_call
from warpqem.runtime.launches import Recorder, launch


@wp.kernel
def add_scaled(scale: wp.float32, shift: wp.vec3, values: wp.array[wp.vec3], work: Work, sums: wp.array[wp.vec3]):
    i = wp.tid()
    sums[i] = sums[i] + scale * values[i] + wp.float32(work.part) * shift


@pytest.fixture
def arguments():
    work = Work()
    work.part = 3
    values = wp.array(np.arange(12, dtype=np.float32).reshape(4, 3), dtype=wp.vec3, device="cpu")
    return [2.0, wp.vec3(1.0, 0.0, 0.0), values, work, wp.zeros(4, dtype=wp.vec3, device="cpu")]


def test_every_launch_has_its_own_arguments(arguments):
    for scale in (1.0, 2.0, 4.0):
        launch(add_scaled, 4, [scale, *arguments[1:4]], [arguments[4]], device="cpu")
    expected = 7.0 * arguments[2].numpy() + 3 * np.array([3.0, 0.0, 0.0])
    np.testing.assert_array_equal(arguments[4].numpy(), expected)


def test_fewer_threads_do_less(arguments):
    for threads in (4, 1):
        launch(add_scaled, threads, arguments[:4], [arguments[4]], device="cpu")
    assert arguments[4].numpy()[:, 0].tolist() == [6.0, 9.0, 15.0, 21.0]


def test_numpys_numbers_of_threads_are_taken(arguments):
    for threads in (np.int64(4), (np.int32(1),)):
        launch(add_scaled, threads, arguments[:4], [arguments[4]], device="cpu")
        launch(add_scaled, threads, arguments[:4], [arguments[4]], device="cpu")
    assert arguments[4].numpy()[:, 0].tolist() == [12.0, 18.0, 30.0, 42.0]


def test_numbers_of_other_types_are_converted(arguments):
    launch(add_scaled, 4, arguments[:4], [arguments[4]], device="cpu")
    launch(add_scaled, 4, [np.float64(1.0), (0.0, 0.0, 1.0), *arguments[2:4]], [arguments[4]], device="cpu")
    np.testing.assert_array_equal(arguments[4].numpy(), 3.0 * arguments[2].numpy() + [3.0, 0.0, 3.0])


@pytest.mark.parametrize("wrong", ["dtype", "axes", "count", "struct"])
def test_wrong_arguments_are_refused(arguments, wrong):
    launch(add_scaled, 4, arguments[:4], [arguments[4]], device="cpu")
    given = list(arguments)
    if wrong == "dtype":
        given[2] = wp.zeros(4, dtype=wp.vec2, device="cpu")
    elif wrong == "axes":
        given[2] = wp.zeros((4, 1), dtype=wp.vec3, device="cpu")
    elif wrong == "struct":
        given[3] = 3
    else:
        given.pop()
    with pytest.raises((RuntimeError, AttributeError)):
        launch(add_scaled, 4, given[:4], given[4:], device="cpu")


def test_recorded_operations_hold_their_arrays():
    values = wp.array(np.ones((4, 3)), dtype=wp.vec3, device="cpu")
    total, copied = wp.zeros(4, dtype=wp.vec3, device="cpu"), wp.zeros(3, dtype=wp.vec3, device="cpu")
    recorder = Recorder("cpu")
    recorder.launch(add_scaled, 4, [1.0, wp.vec3(), values, Work()], [total])
    recorder.copy(copied, total, source_offset=2, count=2)
    recorder.zero(values)
    run = recorder.finish()
    del values, recorder
    gc.collect()
    # What the memory would be used for again.
    others = [wp.full(4, 7.0, dtype=wp.vec3, device="cpu") for _ in range(100)]
    run()
    run()
    assert total.numpy().tolist() == [[1.0] * 3] * 4
    assert copied.numpy().tolist() == [[1.0] * 3] * 2 + [[0.0] * 3]
    assert len(others) == 100


@pytest.mark.parametrize("hashed", [False, True], ids=["", "and looked at"])
def test_a_module_that_has_changed_is_compiled_anew(hashed):
    def one_more(values: wp.array[wp.int32]):
        values[wp.tid()] += 1

    module = wp.get_module(f"tests.runtime.changing_{hashed}")
    kernel = wp.kernel(one_more, module=module)
    values = wp.zeros(4, dtype=wp.int32, device="cpu")
    launch(kernel, 4, [], [values], device="cpu")
    assert prepared_call(kernel, 4, [values]) is not None
    wp.set_module_options({"enable_backward": False}, module)
    if hashed:
        is_compiled(module, "cpu")
    assert prepared_call(kernel, 4, [values]) is None
    launch(kernel, 4, [], [values], device="cpu")
    assert prepared_call(kernel, 4, [values]) is not None
    launch(kernel, 4, [], [values], device="cpu")
    assert values.numpy().tolist() == [3] * 4


def test_recorded_operations_hold_their_code():
    def add_two(values: wp.array[wp.int32]):
        values[wp.tid()] += 2

    module = wp.get_module("tests.runtime.replaced")
    kernel = wp.kernel(add_two, module=module)
    values = wp.zeros(4, dtype=wp.int32, device="cpu")
    launch(kernel, 4, [], [values], device="cpu")
    recorder = Recorder("cpu")
    recorder.launch(kernel, 4, [], [values])
    run, code = recorder.finish(), weakref.ref(module.execs[CPU_CODE])
    del recorder
    wp.set_module_options({"enable_backward": False}, module)
    launch(kernel, 4, [], [values], device="cpu")
    gc.collect()
    assert code() is not None
    assert module.execs[CPU_CODE] is not code()
    run()
    assert values.numpy().tolist() == [6] * 4
    del run
    gc.collect()
    assert code() is None
