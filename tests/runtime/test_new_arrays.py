"""New arrays, small and large, are what Warp makes."""

import gc

import numpy as np
import pytest
import warp as wp

import warpqem
from tests.support.meshes import waving_grid
from warpqem.runtime import new_arrays

# Of elements: small arrays and large ones are made in other ways.
COUNTS = (0, 5, 100_000)


def alike(one: wp.array, other: wp.array) -> None:
    assert type(one) is type(other)
    for name in ("dtype", "ndim", "size", "capacity", "shape", "strides", "device", "is_contiguous", "pinned"):
        assert getattr(one, name) == getattr(other, name), name


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("dtype", [wp.int32, wp.float64, wp.vec3, wp.mat33d, wp.bool])
def test_uploaded_values_are_a_copy(count, dtype):
    values = np.random.default_rng(0).integers(0, 2, (count, *getattr(dtype, "_shape_", ())))
    made = new_arrays.uploaded(values, dtype=dtype, device="cpu")
    alike(made, wp.array(values, dtype=dtype, device="cpu"))
    np.testing.assert_array_equal(made.numpy(), values)
    values += 1
    assert count == 0 or not np.array_equal(made.numpy(), values)


@pytest.mark.parametrize("shape", [*COUNTS, (3, 4), [2, 3, 4], (300, 400)])
def test_new_arrays_have_the_shape_of_warps(shape):
    alike(new_arrays.empty(shape, dtype=wp.vec3, device="cpu"), wp.empty(shape, dtype=wp.vec3, device="cpu"))
    made = new_arrays.zeros(shape, dtype=wp.vec3, device="cpu")
    alike(made, wp.zeros(shape, dtype=wp.vec3, device="cpu"))
    assert not made.numpy().any()
    made = new_arrays.full(shape, -1, dtype=wp.int32, device="cpu")
    alike(made, wp.full(shape, -1, dtype=wp.int32, device="cpu"))
    assert (made.numpy() == -1).all()


def test_values_in_another_arrangement_are_left_to_warp():
    flat = new_arrays.uploaded(np.arange(6.0), dtype=wp.vec3, device="cpu")
    assert flat.numpy().tolist() == [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]
    turned = new_arrays.uploaded(np.arange(6).reshape(2, 3).T, dtype=wp.int32, device="cpu")
    assert turned.numpy().tolist() == [[0, 3], [1, 4], [2, 5]]
    assert turned.is_contiguous


def test_views_hold_the_memory():
    view = new_arrays.uploaded(np.arange(8), dtype=wp.int32, device="cpu")[2:]
    values = new_arrays.full(8, 5, dtype=wp.int32, device="cpu").numpy()
    gc.collect()
    others = [new_arrays.zeros(8, dtype=wp.int32, device="cpu") for _ in range(100)]
    assert view.numpy().tolist() == [2, 3, 4, 5, 6, 7]
    assert values.tolist() == [5] * 8
    assert len(others) == 100


@pytest.mark.parametrize("shape", [5, (0,), (3, 4), (300, 400)])
@pytest.mark.parametrize("dtype", [wp.int32, wp.vec3])
def test_kernels_get_what_warp_says_of_an_array(shape, dtype):
    made = new_arrays.zeros(shape, dtype=dtype, device="cpu")
    plain = wp.array(ptr=made.ptr, dtype=dtype, shape=shape, device="cpu") if made.size else wp.zeros(shape, dtype)
    assert bytes(made.__ctype__()) == bytes(plain.__ctype__())


def whole(shape=(6, 4)) -> wp.array:
    return wp.array(np.arange(np.prod(shape), dtype=np.int32).reshape(shape), dtype=wp.int32, device="cpu")


@pytest.mark.parametrize(("first", "last"), [(0, 6), (1, 4), (5, 6), (2, 2)])
def test_rows_are_those_of_a_slice(first, last):
    array = whole()
    part = new_arrays.part(array, first, last)
    alike(part, array[first:last])
    part.fill_(-1)
    assert (array.numpy()[first:last] == -1).all()
    assert (array.numpy() == -1).sum() == 4 * (last - first)


@pytest.mark.parametrize("index", [0, 3, -1])
def test_a_row_is_that_of_an_index(index):
    array = whole()
    alike(new_arrays.row(array, index), array[index])
    assert new_arrays.row(array, index).numpy().tolist() == array.numpy()[index].tolist()


def test_rows_of_what_is_not_contiguous_are_left_to_warp():
    columns = whole()[:, 1:3]
    assert new_arrays.part(columns, 1, 3).numpy().tolist() == [[5, 6], [9, 10]]
    assert new_arrays.row(columns, 1).numpy().tolist() == [5, 6]
    assert new_arrays.clone(columns).numpy().tolist() == columns.numpy().tolist()


@pytest.mark.parametrize(("shape", "dtype", "first"), [((3, 8), None, 0), ((2, 3), wp.vec3, 3), ((4,), wp.int32, 20)])
@pytest.mark.parametrize("by_warp", [False, True])
def test_another_shape_is_of_the_same_memory(shape, dtype, first, by_warp, monkeypatch):
    values = np.arange(24, dtype=np.float32).reshape(4, 6)
    array = wp.array(values, dtype=wp.float32, device="cpu")
    if by_warp:
        # As on a device with memory of its own.
        monkeypatch.setattr(new_arrays, "_is_quick", lambda device: False)
    made = new_arrays.shaped(array, shape, dtype, first)
    assert made.shape == shape
    assert made.dtype is (dtype or wp.float32)
    expected = values.ravel()[first:].view(np.int32 if dtype is wp.int32 else np.float32)
    count = made.numpy().size
    np.testing.assert_array_equal(made.numpy().ravel(), expected[:count])
    made.zero_()
    assert np.flatnonzero(array.numpy().ravel() != values.ravel()).tolist() == [
        place for place in range(first, first + count) if place
    ]


def test_another_shape_beyond_the_memory_is_refused():
    with pytest.raises((RuntimeError, ValueError)):
        new_arrays.shaped(whole(), (5, 6))


def test_rows_hold_the_memory():
    part, row = new_arrays.part(whole(), 1, 2), new_arrays.row(whole(), 1)
    gc.collect()
    others = [new_arrays.zeros((6, 4), dtype=wp.int32, device="cpu") for _ in range(100)]
    assert part.numpy().tolist() == [[4, 5, 6, 7]]
    assert row.numpy().tolist() == [4, 5, 6, 7]
    assert len(others) == 100


@pytest.mark.parametrize("shape", [(0,), (6, 4), (300, 400)])
def test_copies_are_others_with_the_same_values(shape):
    array = whole(shape)
    copied, target = new_arrays.clone(array), new_arrays.like(array)
    new_arrays.copy(target, array)
    array.fill_(-1)
    for one in (copied, target):
        alike(one, array)
        assert one.numpy().ravel().tolist() == list(range(np.prod(shape)))


class Filled:
    """NumPy, whose new memory is full of one byte."""

    def __init__(self, byte):
        self._byte = byte

    def __getattr__(self, name):
        return getattr(np, name)

    def empty(self, size, dtype):
        return np.full(size, self._byte, dtype=dtype)


@pytest.mark.parametrize("options", [{}, {"quality": "fast"}, {"metric": "dod"}], ids=["best", "fast", "dod"])
def test_what_was_in_the_memory_before_changes_no_bit(options, monkeypatch):
    mesh, found = waving_grid(12, 6), set()
    # Zeros, numbers that are none, small whole numbers, and large ones below zero.
    for byte in (0x00, 0xFF, 0x01, 0xAB):
        monkeypatch.setattr(new_arrays, "np", Filled(byte))
        result = warpqem.simplify(*mesh, ratio=0.3, device="cpu", **options)
        found.add((result.points.tobytes(), result.faces.tobytes(), result.measured.hausdorff))
    assert len(found) == 1
