"""The quadric algebra against float64."""

from typing import Any

import numpy as np
import pytest
import warp as wp

from tests.oracles import quadrics as oracle
from tests.support.mesh_state import blocks, packed, packed_quadrics
from warpqem.kernels.lanes import width_of
from warpqem.kernels.quadric import (
    add_plane,
    anchored_minimiser,
    apply_matrix,
    linear_part,
    shift_origin,
    trace,
    value_at_minimiser,
    zero_quadric,
)

wp.set_module_options({"enable_backward": False})  # no gradients are taken

EPSILON = 0.01


@wp.kernel
def evaluate_quadrics(
    # in
    quadric_in: Any,
    x_in: Any,
    epsilon: wp.float32,
    # out
    product_out: Any,
    linear_out: Any,
    trace_out: wp.array2d[wp.float32],
    value_out: wp.array2d[wp.float32],
    shifted_out: Any,
    minimiser_out: Any,
    minimum_out: wp.array2d[wp.float32],
):
    i, t = wp.tid()
    q = quadric_in[i, t]
    y = x_in[i, t]
    product_out[i, t] = apply_matrix(q, y)
    linear_out[i, t] = linear_part(q)
    shifted = shift_origin(q, y)
    shifted_out[i, t] = shifted
    x = anchored_minimiser(q, epsilon)
    minimiser_out[i, t] = x
    traces = trace(q)
    minimum = value_at_minimiser(q, x, epsilon)
    width = len(traces)
    for k in range(width):
        trace_out[i, t * width + k] = traces[k]
        value_out[i, t * width + k] = shifted[9, k]  # Q(x) is the constant about x
        minimum_out[i, t * width + k] = minimum[k]


@wp.kernel
def make_planes(
    # in
    normal_in: Any,
    offset_in: wp.array[wp.float32],
    weight_in: wp.array[wp.float32],
    # out
    quadric_out: Any,
):
    i, t = wp.tid()
    n = normal_in[i, t]
    offset = n[0] * 0.0
    weight = n[0] * 0.0
    width = len(offset)
    for k in range(width):
        if t * width + k < offset_in.shape[0]:
            offset[k] = offset_in[t * width + k]
            weight[k] = weight_in[t * width + k]
    quadric_out[i, t] = add_plane(zero_quadric(n), n, offset, weight)


def random_quadrics(count=64, planes=5):
    """Sums of a few planes near the origin."""
    random = np.random.default_rng(0)
    result = []
    for _ in range(count):
        q = oracle.zero()
        for _ in range(planes):
            q += oracle.plane(random.normal(size=3), random.normal(size=3) * 0.1, random.uniform(0.1, 1))
        result.append(q)
    return result, random.normal(size=(count, 3)).astype(np.float32)


def evaluate(quadrics, x, device, epsilon=EPSILON):
    """Everything of each quadric and point, the quadrics taken as frames of one vertex."""
    n = len(quadrics)
    point = packed(np.asarray(x)[:, None], device)
    quadric = packed_quadrics([[oracle.pack(q) for q in quadrics]], point)
    numbers = [wp.empty((1, point.shape[1] * width_of(point)), dtype=wp.float32, device=device) for _ in "abc"]
    product, linear, minimiser = (wp.empty_like(point) for _ in range(3))
    shifted = wp.empty_like(quadric)
    outputs = [product, linear, numbers[0], numbers[1], shifted, minimiser, numbers[2]]
    inputs = [quadric, point, epsilon]
    wp.launch(evaluate_quadrics, dim=point.shape, inputs=inputs, outputs=outputs, device=device)
    return [blocks(a, n)[0] if not any(a is b for b in numbers) else a.numpy()[0, :n] for a in outputs]


@pytest.fixture(scope="module")
def evaluated(device):
    quadrics, x = random_quadrics()
    return quadrics, x.astype(np.float64), evaluate(quadrics, x, device)


def test_plane_quadric_is_the_weighted_squared_distance_from_a_plane(device):
    random = np.random.default_rng(1)
    normal = random.normal(size=(32, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    offset, weight = random.normal(size=32), random.uniform(0.1, 2, 32)
    point = packed(normal[:, None], device)
    out = packed_quadrics(np.zeros((1, 32, 10)), point)
    inputs = [point]
    inputs += [wp.array(a, dtype=wp.float32, device=device) for a in (offset, weight)]
    wp.launch(make_planes, dim=point.shape, inputs=inputs, outputs=[out], device=device)
    expected = [oracle.pack(oracle.plane(n, -d * n, w)) for n, d, w in zip(normal, offset, weight, strict=True)]
    np.testing.assert_allclose(blocks(out, 32)[0], expected, rtol=1e-5, atol=1e-6)


def test_matrix_product(evaluated):
    quadrics, x, (product, *_) = evaluated
    np.testing.assert_allclose(product, [q.A @ y for q, y in zip(quadrics, x, strict=True)], rtol=1e-5, atol=1e-5)


def test_linear_part(evaluated):
    quadrics, _, (_, linear, *_) = evaluated
    np.testing.assert_allclose(linear, [q.b for q in quadrics], rtol=1e-6)


def test_trace(evaluated):
    quadrics, _, (_, _, traces, *_) = evaluated
    np.testing.assert_allclose(traces, [np.trace(q.A) for q in quadrics], rtol=1e-6)


def test_value(evaluated):
    quadrics, x, (_, _, _, value, *_) = evaluated
    np.testing.assert_allclose(value, [q(y) for q, y in zip(quadrics, x, strict=True)], rtol=1e-5, atol=1e-5)


def test_shifted_origin_is_the_same_function_of_space(evaluated):
    quadrics, x, (_, _, _, _, shifted, *_) = evaluated
    expected = [oracle.pack(oracle.shifted(q, y)) for q, y in zip(quadrics, x, strict=True)]
    np.testing.assert_allclose(shifted, expected, rtol=1e-5, atol=2e-5)


def test_anchored_minimiser_solves_the_normal_equation(evaluated):
    quadrics, _, (*_, minimiser, _) = evaluated
    np.testing.assert_allclose(minimiser, [oracle.minimiser(q, EPSILON) for q in quadrics], rtol=1e-3, atol=1e-5)


def test_value_at_the_minimiser(evaluated):
    quadrics, _, (*_, minimum) = evaluated
    expected = [q(oracle.minimiser(q, EPSILON)) for q in quadrics]
    np.testing.assert_allclose(minimum, expected, rtol=2e-3, atol=1e-6)


def test_minimiser_does_not_depend_on_the_scale_of_the_areas(device):
    quadrics, x = random_quadrics(8)
    whole, tiny = (evaluate([q.scaled(s) for q in quadrics], x, device)[5] for s in (1.0, 2.0**-60))
    np.testing.assert_array_equal(whole, tiny)


def test_minimiser_stays_at_the_origin_along_soft_directions(device):
    plane = oracle.plane([0, 0, 1], [3, 4, 0.5], 1.0)
    minimiser = evaluate([plane], np.zeros((1, 3)), device)[5]
    np.testing.assert_allclose(minimiser, [[0, 0, 0.5 / (1 + EPSILON)]], rtol=1e-5, atol=1e-7)


def test_minimiser_of_an_empty_quadric_is_the_origin(device):
    outputs = evaluate([oracle.zero()], np.ones((1, 3)), device)
    np.testing.assert_array_equal(outputs[5], np.zeros((1, 3)))


def test_minimiser_is_accurate_at_the_least_stiffness_used(device):
    quadrics, x = random_quadrics(16, planes=3)
    minimiser = evaluate(quadrics, x, device, epsilon=1e-3)[5]
    expected = np.array([oracle.minimiser(q, 1e-3) for q in quadrics])
    assert np.abs(minimiser - expected).max() <= 1e-3 * np.abs(expected).max()
