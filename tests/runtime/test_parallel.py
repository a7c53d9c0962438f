"""Work shared between CPU threads."""

import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
import pytest
import warp as wp

from warpqem.runtime import cpu_threads as parallel
from warpqem.runtime import launches, part_launches
from warpqem.runtime.cpu_threads import launch_parts, run_parts, split_range
from warpqem.runtime.part_launches import (
    FIRST_ITEM,
    PerPart,
    columns_of,
    corners_of,
    launch_in_parts,
    rows_of,
    starts_of,
)


@wp.kernel(enable_backward=False)
def square(
    x_in: wp.array[wp.float32],
    # outputs
    square_out: wp.array[wp.float32],
):
    i = wp.tid()
    square_out[i] = x_in[i] * x_in[i]


@pytest.fixture
def three_threads(monkeypatch):
    monkeypatch.setattr(parallel, "_core_count", lambda: 3)
    with ThreadPoolExecutor(3) as pool:
        monkeypatch.setattr(parallel, "_pool", lambda: pool)
        yield


@pytest.mark.parametrize(("count", "parts"), [(0, 2), (1, 3), (7, 3), (8, 2)])
def test_slices_cover_the_range_once(count, parts):
    covered = [i for part in split_range(count, parts) for i in range(part.start, part.stop)]
    assert covered == list(range(count))


def test_parts_of_a_launch_cover_all_items(three_threads):
    x = wp.array(np.arange(10), dtype=wp.float32, device="cpu")
    out = wp.zeros_like(x)
    launch_in_parts(square, len(x), [rows_of(x)], [rows_of(out)], device="cpu")
    np.testing.assert_array_equal(out.numpy(), np.arange(10.0) ** 2)


ITEMS = np.arange(30)
IN_PARTS = [slice(0, 3), slice(3, 6), slice(6, 10)]


@pytest.mark.parametrize(
    ("argument", "expected"),
    [
        (rows_of(ITEMS), [ITEMS[:3], ITEMS[3:6], ITEMS[6:10]]),
        (columns_of(ITEMS.reshape(3, 10)), [ITEMS.reshape(3, 10)[:, part] for part in IN_PARTS]),
        (corners_of(ITEMS), [ITEMS[:9], ITEMS[9:18], ITEMS[18:30]]),
        (starts_of(ITEMS[:11]), [ITEMS[:4], ITEMS[3:7], ITEMS[6:11]]),
        (FIRST_ITEM, [0, 3, 6]),
        (PerPart(lambda part: part.stop), [3, 6, 10]),
        ("the same", ["the same"] * 3),
    ],
)
def test_each_part_gets_its_own_of_an_argument(argument, expected, three_threads, monkeypatch):
    seen = {}

    def note(kernel, dim, inputs, outputs, *, device):
        seen[inputs[0].start] = (dim, inputs[1], outputs[0])

    monkeypatch.setattr(part_launches, "launch", note)
    launch_in_parts(square, (10, 7), [PerPart(lambda part: part), argument], [argument], device="cpu")
    found = [seen[part.start] for part in IN_PARTS]
    assert [dim for dim, _, _ in found] == [(3, 7), (3, 7), (4, 7)]
    for (_, given, written), value in zip(found, expected, strict=True):
        np.testing.assert_array_equal(given, value)
        np.testing.assert_array_equal(written, value)


@pytest.mark.parametrize(
    ("argument", "array"),
    [(rows_of, ITEMS[:10]), (columns_of, ITEMS.reshape(3, 10)), (corners_of, ITEMS), (starts_of, ITEMS[:11])],
)
def test_a_part_that_is_the_whole_gets_the_array_itself(argument, array):
    assert argument(array).of(slice(0, 10)) is array
    assert argument(array).of(slice(0, 9)) is not array


def test_threads_load_a_module_once(three_threads, monkeypatch):
    loads = []
    monkeypatch.setattr(launches, "_loaded", set())
    monkeypatch.setattr(wp, "load_module", lambda module, *_, **__: (time.sleep(0.01), loads.append(module)))
    run_parts([partial(launches.load_kernel, square, "cpu")] * 9)
    assert loads == [square.module]


def test_error_of_a_part_is_raised_when_all_have_ended(three_threads):
    done = []

    def fail():
        raise ValueError("part")

    with pytest.raises(ValueError, match="part"):
        run_parts([lambda: done.append(1), fail, lambda: done.append(3)])
    assert sorted(done) == [1, 3]


@pytest.mark.parametrize(("least", "parts"), [(1, 3), (4, 2), (10, 1), (11, 1)])
def test_parts_have_as_many_items_as_asked_for(least, parts, three_threads):
    seen = []
    launch_parts(seen.append, 10, "cpu", least)
    assert len(seen) == parts
    assert min(part.stop - part.start for part in seen) >= min(least, 10)
