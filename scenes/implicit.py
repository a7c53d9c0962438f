"""Signed distance fields built from smooth solids, their marching-cubes meshes and projection onto them.

A field is a function from points ``(P, 3)`` float64 to signed distances ``(P,)``, negative inside.
The solids and the smooth minimum follow Inigo Quilez, "Distance functions" and "Smooth minimum" (iquilezles.org).
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from skimage.measure import marching_cubes

Points = NDArray[np.float64]
Field = Callable[[Points], NDArray[np.float64]]

# Decimals kept of every coordinate before a decision on topology is taken from it. Processors differ in the last
# bit of a sum; rounding keeps that bit out of the order of collapses, so that every machine makes the same mesh.
COORDINATE_DECIMALS = 7


def dot(a: Points, b: Points) -> NDArray[np.float64]:
    """Return the scalar products ``(P,)`` of rows of three; far faster than a sum over so short an axis."""
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


def round_cone(start: ArrayLike, end: ArrayLike, start_radius: float, end_radius: float, width: float = 1.0) -> Field:
    """Return the field of a tapered capsule from `start` to `end`, its x extent scaled by `width` about its axis.

    For ``width`` other than 1 the field is a lower bound of the distance. The radii may not differ by more than the
    length of the axis.
    """
    scale = np.array([1.0 / width, 1.0, 1.0])
    centre = np.array([np.asarray(start, float)[0], 0.0, 0.0])
    a = np.asarray(start, float)
    axis = (np.asarray(end, float) - a) * scale
    length_squared = float(axis @ axis)
    radius_drop = start_radius - end_radius
    slant_squared = length_squared - radius_drop * radius_drop
    a = centre + (a - centre) * scale

    def field(points: Points) -> NDArray[np.float64]:
        offset = centre + (points - centre) * scale - a
        along = dot(offset, axis)
        beyond = along - length_squared
        off_axis = offset * length_squared - axis * along[:, None]
        across = dot(off_axis, off_axis)
        side = np.sign(radius_drop) * radius_drop * radius_drop * across
        at_end = np.sqrt(across + beyond * beyond * length_squared) / length_squared - end_radius
        at_start = np.sqrt(across + along * along * length_squared) / length_squared - start_radius
        flank = (np.sqrt(across * slant_squared / length_squared) + along * radius_drop) / length_squared - start_radius
        is_end = np.sign(beyond) * slant_squared * beyond * beyond * length_squared > side
        is_start = np.sign(along) * slant_squared * along * along * length_squared < side
        return np.where(is_end, at_end, np.where(is_start, at_start, flank)) * min(width, 1.0)

    return field


def ellipsoid(centre: ArrayLike, radii: ArrayLike, pitch: float = 0.0, yaw: float = 0.0) -> Field:
    """Return the (first order) field of an ellipsoid, turned by `pitch` about x, then by `yaw` about y (degrees)."""
    middle, half_axes = np.asarray(centre, float), np.asarray(radii, float)
    cp, sp = np.cos(np.radians(pitch)), np.sin(np.radians(pitch))
    cy, sy = np.cos(np.radians(yaw)), np.sin(np.radians(yaw))

    def field(points: Points) -> NDArray[np.float64]:
        x, y, z = (points - middle).T
        x, z = cy * x - sy * z, sy * x + cy * z
        y, z = cp * y + sp * z, cp * z - sp * y
        x, y, z = x / half_axes[0], y / half_axes[1], z / half_axes[2]
        scaled = np.sqrt(x * x + y * y + z * z)
        x, y, z = x / half_axes[0], y / half_axes[1], z / half_axes[2]
        gradient = np.sqrt(x * x + y * y + z * z)
        # The centre has no gradient; there the distance is the smallest half axis.
        return np.where(gradient > 0.0, scaled * (scaled - 1.0) / np.maximum(gradient, 1e-12), -half_axes.min())

    return field


def mirror(field: Field) -> Field:
    """Return the union of `field` with its mirror image in the plane x = 0; the solid must lie at x >= 0."""
    return lambda points: field(np.stack([np.abs(points[:, 0]), points[:, 1], points[:, 2]], axis=1))


def smooth_minimum(a: NDArray[np.float64], b: NDArray[np.float64], radius: float) -> NDArray[np.float64]:
    """Return the quadratic smooth minimum of two fields, which differs from the minimum where |a - b| < `radius`."""
    if radius <= 0.0:
        return np.minimum(a, b)
    overlap = np.maximum(radius - np.abs(a - b), 0.0) / radius
    return np.minimum(a, b) - overlap * overlap * radius / 4.0


def union(radius: float, *fields: Field) -> Field:
    """Return the union of solids, every joint filleted over `radius`."""

    def field(points: Points) -> NDArray[np.float64]:
        value = fields[0](points)
        for other in fields[1:]:
            value = smooth_minimum(value, other(points), radius)
        return value

    return field


def subtract(radius: float, solid: Field, *tools: Field) -> Field:
    """Return `solid` with the `tools` carved out of it, every edge rounded over `radius`."""

    def field(points: Points) -> NDArray[np.float64]:
        value = solid(points)
        for tool in tools:
            value = -smooth_minimum(-value, tool(points), radius)
        return value

    return field


# Corners of a tetrahedron: four samples give value and gradient (Quilez, "Normals for an SDF").
TETRAHEDRON = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])


def value_and_gradient(field: Field, points: Points, step: float) -> tuple[NDArray[np.float64], Points]:
    """Return the field ``(P,)`` and its gradient ``(P, 3)``, both from samples `step` away along each axis."""
    samples = [field(points + step * corner) for corner in TETRAHEDRON]
    slope = sum(value[:, None] * corner for value, corner in zip(samples, TETRAHEDRON, strict=True)) / (4.0 * step)
    return sum(samples) / 4.0, slope


def project(field: Field, points: Points, step: float, rounds: int = 2) -> Points:
    """Return the points moved to the zero set of the field by damped Newton steps along its gradient.

    One move is at most `step` long, so that a point near a crease does not jump to another sheet.
    """
    for _ in range(rounds):
        value, slope = value_and_gradient(field, points, 0.02 * step)
        move = value[:, None] * slope / np.maximum(dot(slope, slope), 1e-6)[:, None]
        length = np.sqrt(dot(move, move))
        points = points - move * np.minimum(1.0, step / np.maximum(length, 1e-12))[:, None]
    return np.round(points, COORDINATE_DECIMALS)


# Edge of the blocks of samples in grid steps, coarse and fine.
COARSE_BLOCK, FINE_BLOCK = 12, 4


def _evaluate(field: Field, points: Points) -> NDArray[np.float64]:
    # Parts of 8192 points keep the temporaries of the field in the cache.
    return np.concatenate([field(points[start : start + 8192]) for start in range(0, len(points), 8192)])


def _blocks(values: NDArray[np.float64], edge: int) -> NDArray[np.float64]:
    """View a grid as its blocks: ``(a, b, c, edge, edge, edge)``."""
    a, b, c = (n // edge for n in values.shape)
    return values.reshape(a, edge, b, edge, c, edge).transpose(0, 2, 4, 1, 3, 5)


def _sample(field: Field, origin: Points, shape: tuple[int, int, int], spacing: float) -> NDArray[np.float64]:
    """Sample the field on a grid, point by point only in blocks that the surface may enter.

    A block that the value at its middle keeps away from the surface is filled with that value, first in coarse
    blocks, then in fine ones.
    """
    values = np.empty([-(-n // COARSE_BLOCK) * COARSE_BLOCK for n in shape])
    near = np.indices(_blocks(values, COARSE_BLOCK).shape[:3]).reshape(3, -1).T
    for edge in (COARSE_BLOCK, FINE_BLOCK):
        middle = origin + (near * edge + 0.5 * (edge - 1)) * spacing
        value = _evaluate(field, middle)
        _blocks(values, edge)[tuple(near.T)] = value[:, None, None, None]
        # Half the diagonal of a block, twice: flattened solids and ellipsoids are distances to first order only.
        near = near[np.abs(value) < 2.0 * 0.5 * np.sqrt(3.0) * edge * spacing]
        if edge == COARSE_BLOCK:
            split = COARSE_BLOCK // FINE_BLOCK
            near = (near[:, None] * split + np.indices((split,) * 3).reshape(3, -1).T).reshape(-1, 3)
    local = np.indices((FINE_BLOCK,) * 3).reshape(3, -1).T
    samples = origin + (near[:, None] * FINE_BLOCK + local).reshape(-1, 3) * spacing
    _blocks(values, FINE_BLOCK)[tuple(near.T)] = _evaluate(field, samples).reshape(-1, *(FINE_BLOCK,) * 3)
    return values[: shape[0], : shape[1], : shape[2]]


def surface(field: Field, lower: ArrayLike, upper: ArrayLike, spacing: float) -> tuple[Points, NDArray[np.int64]]:
    """Return the marching-cubes mesh of the zero set in the box, as vertices ``(V, 3)`` and faces ``(N, 3)``.

    The faces are wound counter-clockwise seen from outside.
    """
    low, high = np.asarray(lower, float), np.asarray(upper, float)
    shape = tuple(int(n) + 1 for n in np.ceil((high - low) / spacing))
    values = _sample(field, low, shape, spacing)
    vertices, faces, _, _ = marching_cubes(values, 0.0, spacing=(spacing,) * 3, gradient_direction="descent")
    points = np.round(vertices.astype(np.float64) + low, COORDINATE_DECIMALS)
    return project(field, points, 0.5 * spacing, rounds=1), faces.astype(np.int64)
