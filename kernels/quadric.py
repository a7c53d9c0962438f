"""Quadrics with a local origin: the algebra every other kernel is built on (Garland & Heckbert 1997).

A quadric ``Q(x) = x^T A x + 2 b.x + c`` is stored as ten floats ``(xx, xy, xz, yy, yz, zz, bx, by, bz, c)``, with ``x``
relative to an origin that the owner of the quadric keeps. With the origin at the vertex itself ``b`` and ``c`` stay
small, so float32 is enough at any distance from the world's origin.

Everything here works on a block of frames at once (see :mod:`warpqem.kernels.lanes`): quadrics are (10, width)
matrices, points (3, width), numbers (width,) vectors.
"""

from typing import Any

import warp as wp

from warpqem.kernels.lanes import lane_dot, lane_max, lane_scale

# No gradients are taken through the simplifier; skipping the adjoint halves compile time.
wp.set_module_options({"enable_backward": False})

# A quadric whose trace is below this (areas on a mesh of unit diagonal) holds no plane that float32 can tell from none.
NO_PLANE = wp.constant(wp.float32(1.0e-30))


@wp.func
def zero_quadric(x: Any):
    """A quadric without planes, for a block as wide as the points ``x``."""
    return wp.matrix(shape=(10, len(x[0])), dtype=x.dtype)


@wp.func
def add_plane(q: Any, normal: Any, offset: Any, weight: Any):
    """``Q + weight (normal.x + offset)^2``."""
    n = lane_scale(weight, normal)
    d = wp.cw_mul(weight, offset)
    r = type(q)(q)
    r[0] += wp.cw_mul(n[0], normal[0])
    r[1] += wp.cw_mul(n[0], normal[1])
    r[2] += wp.cw_mul(n[0], normal[2])
    r[3] += wp.cw_mul(n[1], normal[1])
    r[4] += wp.cw_mul(n[1], normal[2])
    r[5] += wp.cw_mul(n[2], normal[2])
    r[6] += wp.cw_mul(d, normal[0])
    r[7] += wp.cw_mul(d, normal[1])
    r[8] += wp.cw_mul(d, normal[2])
    r[9] += wp.cw_mul(d, offset)
    return r


@wp.func
def apply_matrix(q: Any, x: Any):
    """``A x``."""
    y = type(x)()
    y[0] = wp.cw_mul(q[0], x[0]) + wp.cw_mul(q[1], x[1]) + wp.cw_mul(q[2], x[2])
    y[1] = wp.cw_mul(q[1], x[0]) + wp.cw_mul(q[3], x[1]) + wp.cw_mul(q[4], x[2])
    y[2] = wp.cw_mul(q[2], x[0]) + wp.cw_mul(q[4], x[1]) + wp.cw_mul(q[5], x[2])
    return y


@wp.func
def linear_part(q: Any):
    """``b``."""
    return q[6:9]


@wp.func
def trace(q: Any):
    """``tr A``: for planes weighted by area, the area gathered so far."""
    return q[0] + q[3] + q[5]


@wp.func
def shift_origin(q: Any, d: Any):
    """The same quadric about an origin moved by ``d``: ``b' = b + A d``, ``c' = c + 2 b.d + d^T A d``."""
    b = linear_part(q)
    moved = b + apply_matrix(q, d)
    r = type(q)(q)
    r[6] = moved[0]
    r[7] = moved[1]
    r[8] = moved[2]
    r[9] = q[9] + lane_dot(d, b + moved)
    return r


@wp.func
def regularised_minimiser(q: Any, share: wp.float32, epsilon: wp.float32):
    """``x`` with ``(share A + epsilon tr(A) I) x = -b``.

    The system is divided by its trace, so its entries are of order one whatever the areas are, and ``epsilon > 0``
    bounds its condition number: the closed form by cofactors is safe in float32. Where there is no plane the linear
    part is zero too, and so is the result.
    """
    tr = lane_max(trace(q), NO_PLANE)
    s = wp.cw_div(type(tr)(wp.float32(1.0)), tr)
    m = s * share
    regularisation = type(tr)(epsilon)
    a = wp.cw_mul(q[0], m) + regularisation
    b = wp.cw_mul(q[1], m)
    c = wp.cw_mul(q[2], m)
    d = wp.cw_mul(q[3], m) + regularisation
    e = wp.cw_mul(q[4], m)
    f = wp.cw_mul(q[5], m) + regularisation
    c00 = wp.cw_mul(d, f) - wp.cw_mul(e, e)
    c01 = wp.cw_mul(c, e) - wp.cw_mul(b, f)
    c02 = wp.cw_mul(b, e) - wp.cw_mul(c, d)
    c11 = wp.cw_mul(a, f) - wp.cw_mul(c, c)
    c12 = wp.cw_mul(b, c) - wp.cw_mul(a, e)
    c22 = wp.cw_mul(a, d) - wp.cw_mul(b, b)
    determinant = wp.cw_mul(a, c00) + wp.cw_mul(b, c01) + wp.cw_mul(c, c02)
    scale = wp.cw_div(type(tr)(wp.float32(-1.0)), determinant)
    g = lane_scale(s, linear_part(q))
    x = type(g)()
    x[0] = wp.cw_mul(scale, wp.cw_mul(c00, g[0]) + wp.cw_mul(c01, g[1]) + wp.cw_mul(c02, g[2]))
    x[1] = wp.cw_mul(scale, wp.cw_mul(c01, g[0]) + wp.cw_mul(c11, g[1]) + wp.cw_mul(c12, g[2]))
    x[2] = wp.cw_mul(scale, wp.cw_mul(c02, g[0]) + wp.cw_mul(c12, g[1]) + wp.cw_mul(c22, g[2]))
    return x


@wp.func
def anchored_minimiser(q: Any, epsilon: wp.float32):
    """``argmin Q(x) + epsilon tr(A) |x|^2``: stiff directions follow the quadric, soft ones stay at the origin."""
    return regularised_minimiser(q, 1.0, epsilon)


@wp.func
def tangential_minimiser(q: Any, epsilon: wp.float32):
    """``argmin Q(x) + epsilon x^T (tr(A) I - A) x``: regularised along the surface alone.

    Across a flat place ``A`` has its whole trace, so that the regularisation is zero there.
    """
    return regularised_minimiser(q, 1.0 - epsilon, epsilon)


@wp.func
def value_at_minimiser(q: Any, x: Any, epsilon: wp.float32):
    """``Q(x)`` at the anchored minimiser, where ``A x = -b - epsilon tr(A) x``; never negative."""
    regularisation = wp.cw_mul(trace(q) * epsilon, lane_dot(x, x))
    return lane_max(q[9] + lane_dot(x, linear_part(q)) - regularisation, 0.0)
