"""Every array argument of every public function, in every form that callers give arrays in."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import pytest
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import warpqem
from tests.support import meshes
from tests.support.array_kinds import REFUSED, Wrapped, slots
from warpqem.arguments.array_input import FLOAT32_MAX, as_numpy, finite_array, first_beyond, first_outside
from warpqem.errors import FaceIndexError, MemoryLimitError, MeshShapeError, OptionError, WarpqemError

POINTS, FACES = meshes.swaying_sphere(1, 3)
OPTIONS = {"ratio": 0.5, "device": "cpu"}


def arrays_of(value: Any) -> list[np.ndarray]:
    """All arrays in a result, in a fixed order."""
    if isinstance(value, np.ndarray):
        return [value]
    if is_dataclass(value):
        return [array for field in fields(value) for array in arrays_of(getattr(value, field.name))]
    if isinstance(value, (list, tuple)):
        return [array for item in value for array in arrays_of(item)]
    if isinstance(value, warpqem.ProgressiveMesh):
        return [value.points, value.topology.row_vertex]
    return []


@pytest.mark.parametrize("name", sorted(slots()))
def test_no_other_form_than_an_array_of_numbers_is_taken(name):
    slot, wrong = slots()[name], []
    for kind, make in slot.refused.items():
        value = make(slot.array)
        try:
            slot.call(value)
            wrong.append(f"{kind}: taken")
        except WarpqemError as error:
            if len(str(error)) < 10:
                wrong.append(f"{kind}: says only {error}")
        except Exception as error:
            wrong.append(f"{kind}: {type(error).__name__}: {error}")
    assert wrong == []


@pytest.mark.parametrize("name", sorted(slots()))
def test_other_forms_of_the_same_numbers_give_the_same_bits(name):
    slot, wrong = slots()[name], []
    plain = arrays_of(slot.call(slot.array))
    # Lists hold double precision, in which points far from the origin are taken about another one.
    double = plain if slot.kind == "indices" else arrays_of(slot.call(slot.array.astype(np.float64)))
    for kind, make in slot.accepted.items():
        value = make(slot.array)
        before = slot.array.copy()
        try:
            result = arrays_of(slot.call(value))
        except Exception as error:
            wrong.append(f"{kind}: {type(error).__name__}: {error}")
            continue
        wanted = double if kind in ("list", "tuple") else plain
        if not all(np.array_equal(a, b, equal_nan=a.dtype.kind == "f") for a, b in zip(result, wanted, strict=True)):
            wrong.append(f"{kind}: another result")
        np.testing.assert_array_equal(slot.array, before)
    assert wrong == []


@pytest.mark.parametrize("name", sorted(slots()))
def test_arrays_that_cannot_be_written_to_serve(name):
    slot = slots()[name]
    array = slot.array.copy()
    array.flags.writeable = False
    slot.call(array)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (REFUSED["masked"](POINTS), r"points has 1 masked values, the first at \(1, 21, 0\)"),
        (
            [np.ma.MaskedArray(POINTS[0], POINTS[0] > 1e9), REFUSED["masked"](POINTS[1])],
            r"1 masked values.*\(1, 21, 0\)",
        ),
        (POINTS.astype(str), r"points must be real numbers, got dtype <U32 \(the first is '"),
        (POINTS.astype(object), r"points must be real numbers, got dtype object \(the first is "),
        (REFUSED["ragged"](POINTS), "points cannot be converted to an array .*inhomogeneous"),
        (
            REFUSED["raising"](POINTS),
            r"points cannot be converted to an array .Raising: RuntimeError: cannot convert: call .cpu",
        ),
        (REFUSED["raising exchange"](POINTS), "BufferError: tensor requires grad"),
        ((row for row in POINTS), "points must be an array, got a generator"),
        (np.ndarray, "points must be an array, got the class ndarray"),
        (None, "points must be an array, got None"),
        (3.5, r"points must have shape .* got \(\)"),
    ],
)
def test_message_says_what_was_given(value, message):
    with pytest.raises(MeshShapeError, match=message):
        warpqem.simplify(value, FACES, **OPTIONS)


def test_matrix_serves_as_points():
    matrix = POINTS[0].view(np.matrix)
    np.testing.assert_array_equal(
        warpqem.simplify(matrix, FACES, **OPTIONS).points, warpqem.simplify(POINTS[0], FACES, **OPTIONS).points
    )


def test_matrix_is_no_row_of_weights():
    with pytest.raises(MeshShapeError, match=r"42 numbers, one per vertex, got shape \(1, 42\)"):
        warpqem.simplify(POINTS, FACES, vertex_weights=np.ones((1, 42)).view(np.matrix), **OPTIONS)


def test_indexed_warp_array_serves():
    indices = wp.array(np.arange(3), dtype=int, device="cpu")
    indexed = wp.array(POINTS, dtype=float, device="cpu")[indices]
    assert isinstance(indexed, wp.indexedarray)
    np.testing.assert_array_equal(as_numpy(indexed, "points"), POINTS)


@pytest.mark.parametrize("dtype", [np.int64, np.uint64, np.int32, np.uint8])
def test_faces_of_more_than_32_bits_of_indices_are_refused_before_anything_is_copied(dtype):
    faces = np.broadcast_to(np.array([0, 1, 2], dtype=dtype), (2**31, 3))
    with pytest.raises(MeshShapeError, match="6442450944 indices, more than the 2147483647"):
        warpqem.simplify(POINTS, faces, **OPTIONS)
    with pytest.raises(MeshShapeError, match="more than the 2147483647"):
        warpqem.simplify(POINTS, FACES, seams=faces[:, :2], **OPTIONS)


def test_faces_whose_copy_does_not_fit_are_refused_before_they_are_copied():
    faces = np.broadcast_to(np.array([0, 1, 2]), (7 * 10**8, 3))
    for call in (warpqem.simplify, warpqem.plan):
        with pytest.raises(MemoryLimitError, match=r"700000000 faces need .* to be read, and 1.0G may be used"):
            call(POINTS, faces, memory="1G", **OPTIONS)


def test_frames_that_are_broadcast_are_not_copied():
    still = np.broadcast_to(POINTS[:1].astype(np.int8), (10**7, 42, 3))
    plan = warpqem.plan(still, FACES, memory="8G", sink=warpqem.frames.stream.NoFrames(), **OPTIONS)
    assert plan.frame_count == 10**7


@pytest.mark.parametrize("index", [2**31, 2**32 + 1, 2**63, 2**64 - 1])
@pytest.mark.parametrize("dtype", [np.uint64])
def test_unsigned_index_does_not_wrap_around(index, dtype):
    faces = FACES.astype(dtype)
    faces[7, 2] = index
    with pytest.raises(FaceIndexError, match=rf"face 7 corner 2 refers to vertex {index}, but there are 42"):
        warpqem.simplify(POINTS, faces, **OPTIONS)


@pytest.mark.parametrize("dtype", [int, np.uint8, np.int64])
def test_mask_of_integers_is_not_taken_for_indices(dtype):
    mask = np.zeros(42, dtype=dtype)
    mask[5:9] = 1
    with pytest.raises(OptionError, match=r"locked has 42 integers.* all 0 or 1: a mask must be bool"):
        warpqem.simplify(POINTS, FACES, locked=mask, **OPTIONS)


@pytest.mark.parametrize("name", ["vertex_weights", "quadric_scale"])
@pytest.mark.parametrize(("value", "shown"), [(1e300, r"1e\+300"), (-1e-60, "-1e-60"), (1.0000001e12, "1000000100000")])
def test_factor_out_of_range_is_refused_before_it_is_rounded(name, value, shown):
    values = np.ones(42)
    values[9] = value
    with pytest.raises(OptionError, match=rf"{name} must be in .* got {shown}.* at vertex 9"):
        warpqem.simplify(POINTS, FACES, **{name: values}, **OPTIONS)


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64, np.longdouble])
@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan])
def test_infinity_of_every_float_type_is_found(dtype, value):
    array = np.zeros((3, 2), dtype=dtype)
    array[2, 1] = value
    for limit in (FLOAT32_MAX, 1e308):
        assert first_beyond(array, limit) == (2, 1)
    with pytest.raises(MeshShapeError, match=r"a at \(2, 1\) is"):
        finite_array(array, "a", (3, 2))


def test_infinite_weight_locks_in_any_float_type():
    for dtype in (np.float16, np.float32, np.float64):
        weights = np.ones(42, dtype=dtype)
        weights[3] = np.inf
        result = warpqem.simplify(POINTS, FACES, vertex_weights=weights, **OPTIONS)
        np.testing.assert_array_equal(result.points[:, result.vertex_map[3]], POINTS[:, 3])


@given(hnp.arrays(hnp.integer_dtypes(), hnp.array_shapes(min_dims=1, max_dims=3, max_side=6)), st.integers(1, 300))
def test_first_index_outside_is_the_one_a_search_finds(indices, count):
    expected = next((p for p, i in np.ndenumerate(indices) if not 0 <= int(i) < count), None)
    assert first_outside(indices, count) == expected


@given(
    hnp.arrays(
        st.sampled_from([np.float16, np.float32, np.float64]),
        hnp.array_shapes(min_dims=1, max_dims=3, max_side=6),
        elements={"allow_nan": True, "allow_infinity": True},
    )
)
def test_first_value_beyond_single_precision_is_the_one_a_search_finds(values):
    expected = next((p for p, x in np.ndenumerate(values) if not abs(float(x)) <= FLOAT32_MAX), None)
    assert first_beyond(values, FLOAT32_MAX) == expected


@settings(deadline=None, max_examples=30)
@given(hnp.arrays(hnp.unsigned_integer_dtypes() | hnp.integer_dtypes(), (4, 3), elements=st.integers(0, 3)))
def test_faces_of_any_integer_type_give_the_same_result_or_error(faces):
    points = meshes.tetrahedron()[0]

    def ending(given: Any) -> Any:
        try:
            return warpqem.simplify(points, given, ratio=1.0, device="cpu").faces.tolist()
        except WarpqemError as error:
            return type(error), str(error)

    plain = ending(faces.astype(np.int32))
    assert ending(Wrapped(faces)) == ending(faces.tolist()) == ending(faces[:, ::-1].copy()[:, ::-1]) == plain
