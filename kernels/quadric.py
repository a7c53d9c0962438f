"""Quadrics with a local origin: the algebra every other kernel is built on (Garland & Heckbert 1997).

A quadric ``Q(x) = x^T A x + 2 b.x + c`` is stored as ten floats ``(xx, xy, xz, yy, yz, zz, bx, by, bz, c)``, with ``x``
relative to an origin that the owner of the quadric keeps. With the origin at the vertex itself ``b`` and ``c`` stay
small, so float32 is enough at any distance from the world's origin.
"""

import warp as wp

# No gradients are taken through the simplifier; skipping the adjoint halves compile time.
wp.set_module_options({"enable_backward": False})

Quadric = wp.types.vector(length=10, dtype=wp.float32)

# A quadric whose trace is below this (areas on a mesh of unit diagonal) holds no plane that float32 can tell from none.
NO_PLANE = wp.constant(wp.float32(1.0e-30))


@wp.func
def plane_quadric(normal: wp.vec3, offset: wp.float32, weight: wp.float32) -> Quadric:
    """``weight * (normal.x + offset)^2``."""
    n = normal * weight
    d = offset * weight
    return Quadric(
        n[0] * normal[0], n[0] * normal[1], n[0] * normal[2],
        n[1] * normal[1], n[1] * normal[2], n[2] * normal[2],
        d * normal[0], d * normal[1], d * normal[2], d * offset,
    )  # fmt: skip


@wp.func
def apply_matrix(q: Quadric, x: wp.vec3) -> wp.vec3:
    """``A x``."""
    return wp.vec3(
        q[0] * x[0] + q[1] * x[1] + q[2] * x[2],
        q[1] * x[0] + q[3] * x[1] + q[4] * x[2],
        q[2] * x[0] + q[4] * x[1] + q[5] * x[2],
    )


@wp.func
def linear_part(q: Quadric) -> wp.vec3:
    """``b``."""
    return wp.vec3(q[6], q[7], q[8])


@wp.func
def trace(q: Quadric) -> wp.float32:
    """``tr A``: for planes weighted by area, the area gathered so far."""
    return q[0] + q[3] + q[5]


@wp.func
def shift_origin(q: Quadric, d: wp.vec3) -> Quadric:
    """The same quadric about an origin moved by ``d``: ``b' = b + A d``, ``c' = c + 2 b.d + d^T A d``."""
    b = linear_part(q)
    ad = apply_matrix(q, d)
    moved = b + ad
    return Quadric(
        q[0], q[1], q[2], q[3], q[4], q[5],
        moved[0], moved[1], moved[2], q[9] + wp.dot(d, b + moved),
    )  # fmt: skip


@wp.func
def anchored_minimiser(q: Quadric, epsilon: wp.float32) -> wp.vec3:
    """``argmin Q(x) + epsilon tr(A) |x|^2``: stiff directions follow the quadric, soft ones stay at the origin.

    The system is divided by its trace, so its entries are of order one whatever the areas are, and ``epsilon > 0``
    bounds its condition number by ``1 + 1 / epsilon``: the closed form by cofactors is safe in float32.
    """
    tr = trace(q)
    if tr <= NO_PLANE:
        return wp.vec3()
    s = 1.0 / tr
    a = q[0] * s + epsilon
    b = q[1] * s
    c = q[2] * s
    d = q[3] * s + epsilon
    e = q[4] * s
    f = q[5] * s + epsilon
    c00 = d * f - e * e
    c01 = c * e - b * f
    c02 = b * e - c * d
    c11 = a * f - c * c
    c12 = b * c - a * e
    c22 = a * d - b * b
    scale = -s / (a * c00 + b * c01 + c * c02)
    return scale * wp.vec3(
        c00 * q[6] + c01 * q[7] + c02 * q[8],
        c01 * q[6] + c11 * q[7] + c12 * q[8],
        c02 * q[6] + c12 * q[7] + c22 * q[8],
    )


@wp.func
def value_at_minimiser(q: Quadric, x: wp.vec3, epsilon: wp.float32) -> wp.float32:
    """``Q(x)`` at the anchored minimiser, where ``A x = -b - epsilon tr(A) x``; never negative."""
    return wp.max(q[9] + wp.dot(x, linear_part(q)) - epsilon * trace(q) * wp.dot(x, x), 0.0)
