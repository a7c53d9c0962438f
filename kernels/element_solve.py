"""Conjugate gradients on element matrices: one 9 x 9 block per face, three unknowns per vertex, nothing assembled.

Sums run in a fixed order (per vertex along its corners, dot products over fixed slices), so that results do not depend
on threads. ``warp.optim.linear`` does the same on assembled matrices; on a CPU its tiled dot products take 60 times the
time of the rest.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})  # no gradients are taken

# Slices that a dot product is summed in: enough to keep a GPU busy, few enough for one thread to add up.
SLICES = wp.constant(256)


@wp.struct
class Elements:
    """A symmetric matrix over C vertices as blocks of the faces between them."""

    corner_vertex: wp.array[wp.int32]  # (3N',)
    adjacency_start: wp.array[wp.int32]  # (C+1,)
    adjacent_corner: wp.array[wp.int32]  # (3N',)
    block: wp.array2d[wp.mat33]  # (N', 9), row-major over the corners of the face


@wp.struct
class Solve:
    """State of the iteration: unknown, residual, direction, matrix times direction, and scalars."""

    x: wp.array[wp.vec3]
    residual: wp.array[wp.vec3]
    direction: wp.array[wp.vec3]
    image: wp.array[wp.vec3]
    inverse: wp.array[wp.mat33]  # of the diagonal blocks: the preconditioner
    slice_sum: wp.array[wp.float64]  # (SLICES,)
    scalar: wp.array[wp.float64]  # (4,) residual . preconditioned residual now and before, curvature, where to stop
    report: wp.array[wp.int32]  # (2,) 1 as long as there is another step; steps made


@wp.kernel
def start_solve(
    # in
    e: Elements,
    corner_right_in: wp.array[wp.vec3],
    # out
    s: Solve,
):
    """From ``x = 0``: the residual is the right side, gathered from the corners; invert the diagonal blocks."""
    c = wp.tid()
    right = wp.vec3()
    diagonal = wp.mat33()
    for i in range(e.adjacency_start[c], e.adjacency_start[c + 1]):
        h = e.adjacent_corner[i]
        right += corner_right_in[h]
        diagonal += e.block[h / 3, 4 * (h % 3)]
    s.x[c] = wp.vec3()
    s.residual[c] = right
    s.direction[c] = wp.vec3()
    s.inverse[c] = wp.inverse(diagonal)


@wp.kernel
def multiply_direction(
    # in
    e: Elements,
    # in and out
    s: Solve,
):
    """``image = matrix direction``."""
    c = wp.tid()
    total = wp.vec3()
    for i in range(e.adjacency_start[c], e.adjacency_start[c + 1]):
        h = e.adjacent_corner[i]
        f = h / 3
        row = 3 * (h % 3)
        for k in range(3):
            total += e.block[f, row + k] * s.direction[e.corner_vertex[3 * f + k]]
    s.image[c] = total


@wp.kernel
def sum_curvature(
    # in and out
    s: Solve,
):
    """Slices of ``direction . image``."""
    j = wp.tid()
    count = s.x.shape[0]
    total = wp.float64(0.0)
    for c in range(j * count / SLICES, (j + 1) * count / SLICES):
        total += wp.float64(wp.dot(s.direction[c], s.image[c]))
    s.slice_sum[j] = total


@wp.kernel
def sum_residual(
    # in and out
    s: Solve,
):
    """Slices of ``residual . preconditioned residual``."""
    j = wp.tid()
    count = s.x.shape[0]
    total = wp.float64(0.0)
    for c in range(j * count / SLICES, (j + 1) * count / SLICES):
        total += wp.float64(wp.dot(s.residual[c], s.inverse[c] * s.residual[c]))
    s.slice_sum[j] = total


@wp.func
def sum_slices(s: Solve) -> wp.float64:
    """The slices added up in their order."""
    total = wp.float64(0.0)
    for j in range(SLICES):
        total += s.slice_sum[j]
    return total


@wp.kernel
def close_curvature(
    # in and out
    s: Solve,
):
    """One thread: the slices of ``direction . image`` added up."""
    s.scalar[2] = sum_slices(s)


@wp.kernel
def begin_steps(
    # in
    tolerance_squared: wp.float64,
    wanted_in: wp.array[wp.int32],
    # in and out
    s: Solve,
):
    """One thread: the residual at the beginning, and where it has fallen far enough; no step where none is wanted."""
    s.scalar[0] = sum_slices(s)
    s.scalar[1] = wp.float64(0.0)
    s.scalar[3] = tolerance_squared * s.scalar[0]
    s.report[0] = wanted_in[0]
    s.report[1] = 0


@wp.kernel
def end_step(
    # in
    most_steps: wp.int32,
    # in and out
    s: Solve,
):
    """One thread: the residual after a step, with the one before put aside, and whether another step follows."""
    if s.report[0] == 0:
        return
    s.scalar[1] = s.scalar[0]
    s.scalar[0] = sum_slices(s)
    s.report[1] = s.report[1] + 1
    s.report[0] = wp.where(s.scalar[0] <= s.scalar[3] or s.report[1] >= most_steps, 0, 1)


@wp.kernel
def step_forward(
    # in and out
    s: Solve,
):
    """Along the direction to its minimum. After the last step nothing moves any more."""
    c = wp.tid()
    if s.report[0] == 1 and s.scalar[2] > wp.float64(0.0):
        step = wp.float32(s.scalar[0] / s.scalar[2])
        s.x[c] = s.x[c] + step * s.direction[c]
        s.residual[c] = s.residual[c] - step * s.image[c]


@wp.kernel
def turn_direction(
    # in and out
    s: Solve,
):
    """The next direction: the preconditioned residual, conjugate to the direction before."""
    c = wp.tid()
    turn = wp.float32(0.0)
    if s.scalar[1] > wp.float64(0.0):
        turn = wp.float32(s.scalar[0] / s.scalar[1])
    s.direction[c] = s.inverse[c] * s.residual[c] + turn * s.direction[c]
