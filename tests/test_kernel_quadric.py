"""The quadric algebra against float64."""

import numpy as np
import pytest
import warp as wp
from oracles import quadrics as oracle

from warpqem.kernels.quadric import (
    Quadric,
    anchored_minimiser,
    apply_matrix,
    linear_part,
    plane_quadric,
    shift_origin,
    trace,
    value_at_minimiser,
)

wp.set_module_options({"enable_backward": False})  # no gradients are taken

EPSILON = 0.01


@wp.kernel
def evaluate_quadrics(
    quadric_in: wp.array[Quadric],
    x_in: wp.array[wp.vec3],
    epsilon: wp.float32,
    # outputs
    product_out: wp.array[wp.vec3],
    linear_out: wp.array[wp.vec3],
    trace_out: wp.array[wp.float32],
    value_out: wp.array[wp.float32],
    shifted_out: wp.array[Quadric],
    minimiser_out: wp.array[wp.vec3],
    minimum_out: wp.array[wp.float32],
):
    i = wp.tid()
    q = quadric_in[i]
    product_out[i] = apply_matrix(q, x_in[i])
    linear_out[i] = linear_part(q)
    trace_out[i] = trace(q)
    value_out[i] = shift_origin(q, x_in[i])[9]  # Q(x) is the constant about x
    shifted_out[i] = shift_origin(q, x_in[i])
    x = anchored_minimiser(q, epsilon)
    minimiser_out[i] = x
    minimum_out[i] = value_at_minimiser(q, x, epsilon)


@wp.kernel
def make_planes(
    normal_in: wp.array[wp.vec3],
    offset_in: wp.array[wp.float32],
    weight_in: wp.array[wp.float32],
    # outputs
    quadric_out: wp.array[Quadric],
):
    i = wp.tid()
    quadric_out[i] = plane_quadric(normal_in[i], offset_in[i], weight_in[i])


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
    n = len(quadrics)
    packed = wp.array(np.array([oracle.pack(q) for q in quadrics]), dtype=Quadric, device=device)
    dtypes = [wp.vec3, wp.vec3, wp.float32, wp.float32, Quadric, wp.vec3, wp.float32]
    outputs = [wp.empty(n, dtype=dtype, device=device) for dtype in dtypes]
    inputs = [packed, wp.array(x, dtype=wp.vec3, device=device), epsilon]
    wp.launch(evaluate_quadrics, dim=n, inputs=inputs, outputs=outputs, device=device)
    return [a.numpy() for a in outputs]


@pytest.fixture(scope="module")
def evaluated(device):
    quadrics, x = random_quadrics()
    return quadrics, x.astype(np.float64), evaluate(quadrics, x, device)


def test_plane_quadric_is_the_weighted_squared_distance_from_a_plane(device):
    random = np.random.default_rng(1)
    normal = random.normal(size=(32, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    offset, weight = random.normal(size=32), random.uniform(0.1, 2, 32)
    out = wp.empty(32, dtype=Quadric, device=device)
    inputs = [wp.array(normal, dtype=wp.vec3, device=device)]
    inputs += [wp.array(a, dtype=wp.float32, device=device) for a in (offset, weight)]
    wp.launch(make_planes, dim=32, inputs=inputs, outputs=[out], device=device)
    expected = [oracle.pack(oracle.plane(n, -d * n, w)) for n, d, w in zip(normal, offset, weight, strict=True)]
    np.testing.assert_allclose(out.numpy(), expected, rtol=1e-5, atol=1e-6)


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


def test_minimiser_is_accurate_at_the_least_pull_used(device):
    quadrics, x = random_quadrics(16, planes=3)
    minimiser = evaluate(quadrics, x, device, epsilon=1e-3)[5]
    expected = np.array([oracle.minimiser(q, 1e-3) for q in quadrics])
    assert np.abs(minimiser - expected).max() <= 1e-3 * np.abs(expected).max()
