"""The nearest point of a triangle: what needs no comparison of edges is what comparing them gives, to the bit."""

import numpy as np
import pytest
import warp as wp

from warpqem.kernels.closest_point import closest_barycentric, offset_squared, segment_parameter


@wp.func
def compared_barycentric(p: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3) -> wp.vec3:
    """All three edges, and then the foot of the perpendicular."""
    t = segment_parameter(p, a, b)
    best = wp.vec3(1.0 - t, t, 0.0)
    t = segment_parameter(p, b, c)
    other = wp.vec3(0.0, 1.0 - t, t)
    if offset_squared(p, a, b, c, other) < offset_squared(p, a, b, c, best):
        best = other
    t = segment_parameter(p, c, a)
    other = wp.vec3(t, 0.0, 1.0 - t)
    if offset_squared(p, a, b, c, other) < offset_squared(p, a, b, c, best):
        best = other
    normal = wp.cross(b - a, c - a)
    squared = wp.dot(normal, normal)
    if squared > 0.0:
        v = wp.dot(wp.cross(p - a, c - a), normal) / squared
        w = wp.dot(wp.cross(b - a, p - a), normal) / squared
        other = wp.vec3(1.0 - v - w, v, w)
        nearer = offset_squared(p, a, b, c, other) < offset_squared(p, a, b, c, best)
        if v >= 0.0 and w >= 0.0 and v + w <= 1.0 and nearer:
            best = other
    return best


@wp.kernel
def find_both(
    # in
    p: wp.array[wp.vec3],
    corner: wp.array2d[wp.vec3],
    # out
    found: wp.array[wp.vec3],
    compared: wp.array[wp.vec3],
):
    i = wp.tid()
    found[i] = closest_barycentric(p[i], corner[i, 0], corner[i, 1], corner[i, 2])
    compared[i] = compared_barycentric(p[i], corner[i, 0], corner[i, 1], corner[i, 2])


def triangles(kind, count, random):
    """(count, 3, 3)."""
    corner = random.normal(size=(count, 3, 3))
    if kind == "thin":
        corner[:, 2] = corner[:, 0] + random.random((count, 1)) * (corner[:, 1] - corner[:, 0])
        corner[:, 2] += 10.0 ** random.uniform(-6, 0, (count, 1)) * random.normal(size=(count, 3))
    elif kind == "small":
        corner = random.normal(size=(count, 1, 3)) + 10.0 ** random.uniform(-5, -1, (count, 1, 1)) * corner
    elif kind == "lattice":
        corner = random.integers(-2, 3, size=(count, 3, 3)).astype(float)
    return corner


@pytest.mark.parametrize("kind", ["any", "thin", "small", "lattice"])
def test_points_are_those_of_comparing_all_edges_to_the_bit(kind, device):
    count, random = 50_000, np.random.default_rng(1)
    corner = triangles(kind, count, random)
    # On edges and at corners and beside them, near and far.
    weight = random.choice([0.0, 1.0, 0.5, 1e-7, -1e-7, 1e-3, -0.3, 2.0], size=(count, 3))
    weight[::2] = random.normal(size=weight[::2].shape)
    weight[:, 0] = 1.0 - weight[:, 1] - weight[:, 2]
    point = np.einsum("nk,nkc->nc", weight, corner)
    size = np.ptp(corner, axis=1).max(axis=1)[:, None]
    point += size * random.choice([0.0, 1e-7, 1e-4, 0.1, 3.0], size=(count, 1)) * random.normal(size=(count, 3))
    if kind == "lattice":
        point[::3] = random.integers(-3, 4, size=point[::3].shape)
    given = wp.array(point, dtype=wp.vec3, device=device), wp.array(corner, dtype=wp.vec3, device=device)
    found, compared = (wp.empty(count, dtype=wp.vec3, device=device) for _ in range(2))
    wp.launch(find_both, dim=count, inputs=given, outputs=[found, compared], device=device)
    np.testing.assert_array_equal(found.numpy(), compared.numpy())
