"""Rest position and skin weights of an output vertex, fitted together over poses.

"Simplification of articulated meshes" (Landreneau & Schaefer 2009), with quadrics about their least.

Pose ``j`` takes the rest position ``v`` to ``p_j = sum_k a_k (R_k^j (v + o_j) + t_k^j)`` with the transforms of its
joints, its skin weights ``a`` and the offset ``o_j`` of blend shapes. With the cluster's quadric matrix ``A_j`` and its
least ``y_j`` there, ``E(v, a) = sum_j (p_j - y_j)^T H_j (p_j - y_j)`` is minimised,
``H_j = A_j + s tr(A_j) I``: stiff across the surface, soft along it. E is quartic, but quadratic in either argument:

- position: a 3x3 system with the weights fixed;
- weights: with ``u_k = R_k (v + o) + t_k - y``, minimise ``a^T G a``, ``G_kl = sum_j u_k^T H u_l``, subject to
  ``sum a = 1``, ``a >= 0``: an active set, each step a Cholesky solve on the joints in use (Lawson & Hanson 1974).

Both are regularised a little towards where they start, which decides what no pose determines. All in float64: joints
that move nearly alike leave little between the eigenvalues of ``G``. One lane per vertex and a fixed order of sums, so
that the result is the same on every run.
"""

import warp as wp

from warpqem.kernels.closest_point import double_point

wp.set_module_options({"enable_backward": False})  # no gradients are taken

# Planes closer to none than this, in units of area on a mesh of unit diagonal, do not place a vertex.
MIN_TRACE = wp.constant(wp.float64(1.0e-30))
# The least of a cluster's planes counts as far as this from where placement put the vertex, in radii of a disc of the
# cluster's area: planes that hardly meet, as at a thin tip of few faces, would take it away as a spike.
REACH = wp.constant(wp.float64(0.25))
# A multiplier this far below zero, relative to the mean diagonal of G, lets a joint in again.
ENTRY_TOLERANCE = wp.constant(wp.float64(1.0e-10))
# Steps of the active set for each candidate joint: every joint may leave and come back.
STEPS_PER_JOINT = wp.constant(wp.int32(3))


@wp.struct
class SkinProblem:
    """C vertices with candidate joints in rows, P poses, J joints."""

    candidate_start: wp.array[wp.int32]  # (C + 1,)
    candidate: wp.array[wp.int32]  # joints
    start_weight: wp.array[wp.float64]  # of the candidates, sum 1 per vertex
    start_rest: wp.array[wp.vec3d]  # (C,)
    rotation: wp.array2d[wp.mat33d]  # (P, J)
    translation: wp.array2d[wp.vec3d]  # (P, J)
    offset: wp.array2d[wp.vec3d]  # (P, C), or (0, 0) for none
    goal: wp.array2d[wp.vec3d]  # (P, C)
    stiffness: wp.array2d[wp.mat33d]  # (C, P)
    position_regularisation: wp.float64
    regularisation_of_weight: wp.float64
    rounds: wp.int32
    max_influences: wp.int32


@wp.struct
class SkinScratch:
    """Work space; the row of a vertex with ``n`` candidates starts at its candidates, its matrices at ``n^2`` each."""

    matrix_start: wp.array[wp.int32]  # (C,)
    gram: wp.array[wp.float64]
    factor: wp.array[wp.float64]
    first: wp.array[wp.float64]
    second: wp.array[wp.float64]
    regularisation: wp.array[wp.float64]  # what the weights are regularised towards
    slot: wp.array[wp.int32]  # the joints in use, as indices into the row
    state: wp.array[wp.int32]  # 1 in use, 0 at zero, -1 not allowed


@wp.func
def plane_matrix(normal: wp.vec3d, weight: wp.float64) -> wp.mat33d:
    """``weight n n^T``."""
    return wp.outer(normal, normal) * weight


@wp.kernel
def gather_planes(
    # in
    face_start_in: wp.array[wp.int32],
    face_in: wp.array[wp.vec3i],
    face_weight_in: wp.array[wp.float32],
    border_start_in: wp.array[wp.int32],
    border_in: wp.array[wp.vec3i],
    border_weight_in: wp.array[wp.float32],
    points_in: wp.array2d[wp.vec3],
    placed_in: wp.array2d[wp.vec3d],
    regularisation: wp.float64,
    to_planes: wp.int32,
    # out
    stiffness_out: wp.array2d[wp.mat33d],
    goal_out: wp.array2d[wp.vec3d],
):
    """``H`` and ``y`` of each cluster in each pose from its faces and its border edges (edge, then the third vertex).

    About the place ``x`` that placement gave the vertex, the quadric is ``(p - x)^T A (p - x) + 2 g.(p - x)``. With the
    regularisation towards that place its least is ``y = x - H^-1 g``, or as far that way as ``REACH`` allows; where
    ``to_planes`` is 0, ``y = x``.
    """
    c, j = wp.tid()
    total = wp.mat33d()
    slope = wp.vec3d()
    place = placed_in[j, c]
    for i in range(face_start_in[c], face_start_in[c + 1]):
        face = face_in[i]
        p = double_point(points_in[j, face[0]])
        cross = wp.cross(double_point(points_in[j, face[1]]) - p, double_point(points_in[j, face[2]]) - p)
        length = wp.length(cross)
        if length > wp.float64(0.0):
            # area n n^T, with n = cross / length and area = length / 2
            weight = wp.float64(0.5) * wp.float64(face_weight_in[i]) / length
            total += plane_matrix(cross, weight)
            slope += cross * (weight * wp.dot(cross, place - p))
    for i in range(border_start_in[c], border_start_in[c + 1]):
        corner = border_in[i]
        p = double_point(points_in[j, corner[0]])
        edge = double_point(points_in[j, corner[1]]) - p
        across = wp.cross(edge, wp.cross(edge, double_point(points_in[j, corner[2]]) - p))
        length = wp.length(across)
        if length > wp.float64(0.0):
            weight = wp.dot(edge, edge) * wp.float64(border_weight_in[i]) / (length * length)
            total += plane_matrix(across, weight)
            slope += across * (weight * wp.dot(across, place - p))
    soft = regularisation * wp.trace(total) + MIN_TRACE
    stiffness = total + wp.mat33d(
        soft, wp.float64(0.0), wp.float64(0.0),
        wp.float64(0.0), soft, wp.float64(0.0),
        wp.float64(0.0), wp.float64(0.0), soft,
    )  # fmt: skip
    stiffness_out[c, j] = stiffness
    if to_planes == 1:
        away = wp.inverse(stiffness) * slope
        # Every face counts at its three corners.
        reach = REACH * wp.sqrt(wp.trace(total) / wp.float64(3.0 * wp.PI))
        place -= away * wp.min(wp.float64(1.0), reach / wp.max(wp.length(away), MIN_TRACE))
    goal_out[j, c] = place


@wp.func
def offset_of(problem: SkinProblem, j: wp.int32, c: wp.int32) -> wp.vec3d:
    """What blend shapes add to the rest position in a pose."""
    if problem.offset.shape[0] == 0:
        return wp.vec3d()
    return problem.offset[j, c]


@wp.func
def pose_misses(problem: SkinProblem, c: wp.int32, v: wp.vec3d, weight: wp.array[wp.float64]) -> wp.float64:
    """``E(v, a)``."""
    first = problem.candidate_start[c]
    n = problem.candidate_start[c + 1] - first
    total = wp.float64(0.0)
    for j in range(problem.rotation.shape[0]):
        moved = v + offset_of(problem, j, c)
        p = wp.vec3d()
        for k in range(n):
            joint = problem.candidate[first + k]
            p += weight[first + k] * (problem.rotation[j, joint] * moved + problem.translation[j, joint])
        d = p - problem.goal[j, c]
        total += wp.dot(d, problem.stiffness[c, j] * d)
    return total


@wp.func
def best_position(problem: SkinProblem, c: wp.int32, weight: wp.array[wp.float64], fallback: wp.vec3d) -> wp.vec3d:
    """The rest position that minimises E with the weights fixed."""
    first = problem.candidate_start[c]
    n = problem.candidate_start[c + 1] - first
    matrix = wp.mat33d()
    right = wp.vec3d()
    for j in range(problem.rotation.shape[0]):
        linear = wp.mat33d()
        shift = wp.vec3d()
        for k in range(n):
            a = weight[first + k]
            if a > wp.float64(0.0):
                joint = problem.candidate[first + k]
                linear += problem.rotation[j, joint] * a
                shift += problem.translation[j, joint] * a
        h = problem.stiffness[c, j]
        t = wp.transpose(linear) * h
        matrix += t * linear
        right += t * (problem.goal[j, c] - shift - linear * offset_of(problem, j, c))
    size = wp.trace(matrix) / wp.float64(3.0)
    if size <= MIN_TRACE:
        return fallback
    soft = problem.position_regularisation * size
    matrix += wp.mat33d(
        soft, wp.float64(0.0), wp.float64(0.0),
        wp.float64(0.0), soft, wp.float64(0.0),
        wp.float64(0.0), wp.float64(0.0), soft,
    )  # fmt: skip
    return wp.inverse(matrix) * (right + soft * problem.start_rest[c])


@wp.func
def fill_gram(problem: SkinProblem, scratch: SkinScratch, c: wp.int32, v: wp.vec3d) -> wp.float64:
    """``G`` at the position, with the regularisation on its diagonal; returns that regularisation."""
    first = problem.candidate_start[c]
    n = problem.candidate_start[c + 1] - first
    o = scratch.matrix_start[c]
    for i in range(n * n):
        scratch.gram[o + i] = wp.float64(0.0)
    for j in range(problem.rotation.shape[0]):
        moved = v + offset_of(problem, j, c)
        goal = problem.goal[j, c]
        h = problem.stiffness[c, j]
        for k in range(n):
            joint = problem.candidate[first + k]
            y = h * (problem.rotation[j, joint] * moved + problem.translation[j, joint] - goal)
            for other_k in range(k + 1):
                other = problem.candidate[first + other_k]
                u = problem.rotation[j, other] * moved + problem.translation[j, other] - goal
                scratch.gram[o + k * n + other_k] = scratch.gram[o + k * n + other_k] + wp.dot(y, u)
    total = wp.float64(0.0)
    for k in range(n):
        total += scratch.gram[o + k * n + k]
        for other_k in range(k):
            scratch.gram[o + other_k * n + k] = scratch.gram[o + k * n + other_k]
    soft = problem.regularisation_of_weight * total / wp.float64(n) + MIN_TRACE
    for k in range(n):
        scratch.gram[o + k * n + k] = scratch.gram[o + k * n + k] + soft
    return soft


@wp.func
def solve_in_use(scratch: SkinScratch, o: wp.int32, s: wp.int32, n: wp.int32, m: wp.int32, soft: wp.float64):
    """Minimum over the ``m`` joints in use with sum one: into ``scratch.first``; returns the multiplier of the sum."""
    for i in range(m):
        p = scratch.slot[s + i]
        for j in range(i + 1):
            q = scratch.slot[s + j]
            x = scratch.gram[o + p * n + q]
            for k in range(j):
                x -= scratch.factor[o + i * n + k] * scratch.factor[o + j * n + k]
            if i == j:
                scratch.factor[o + i * n + i] = wp.sqrt(wp.max(x, MIN_TRACE))
            else:
                scratch.factor[o + i * n + j] = x / scratch.factor[o + j * n + j]
    for i in range(m):
        x = soft * scratch.regularisation[s + scratch.slot[s + i]]
        y = wp.float64(1.0)
        for k in range(i):
            x -= scratch.factor[o + i * n + k] * scratch.first[s + k]
            y -= scratch.factor[o + i * n + k] * scratch.second[s + k]
        scratch.first[s + i] = x / scratch.factor[o + i * n + i]
        scratch.second[s + i] = y / scratch.factor[o + i * n + i]
    sum_first = wp.float64(0.0)
    sum_second = wp.float64(0.0)
    for back in range(m):
        i = m - 1 - back
        x = scratch.first[s + i]
        y = scratch.second[s + i]
        for k in range(i + 1, m):
            x -= scratch.factor[o + k * n + i] * scratch.first[s + k]
            y -= scratch.factor[o + k * n + i] * scratch.second[s + k]
        x = x / scratch.factor[o + i * n + i]
        y = y / scratch.factor[o + i * n + i]
        scratch.first[s + i] = x
        scratch.second[s + i] = y
        sum_first += x
        sum_second += y
    multiplier = (wp.float64(1.0) - sum_first) / sum_second
    for i in range(m):
        scratch.first[s + i] = scratch.first[s + i] + multiplier * scratch.second[s + i]
    return multiplier


@wp.func
def list_in_use(scratch: SkinScratch, s: wp.int32, n: wp.int32) -> wp.int32:
    """List the joints in use in ``scratch.slot``; returns their number."""
    m = wp.int32(0)
    for k in range(n):
        if scratch.state[s + k] == 1:
            scratch.slot[s + m] = k
            m += 1
    return m


@wp.func
def best_weights(problem: SkinProblem, scratch: SkinScratch, c: wp.int32, v: wp.vec3d, weight: wp.array[wp.float64]):
    """The weights that minimise E with the position fixed, from feasible ones, in place."""
    s = problem.candidate_start[c]
    n = problem.candidate_start[c + 1] - s
    o = scratch.matrix_start[c]
    soft = fill_gram(problem, scratch, c, v)
    tolerance = ENTRY_TOLERANCE * soft / wp.max(problem.regularisation_of_weight, wp.float64(1.0e-12))
    for k in range(n):
        if scratch.state[s + k] >= 0:
            scratch.state[s + k] = wp.where(weight[s + k] > wp.float64(0.0), 1, 0)
    steps = STEPS_PER_JOINT * n
    step = wp.int32(0)
    while step < steps:
        step += 1
        m = list_in_use(scratch, s, n)
        multiplier = solve_in_use(scratch, o, s, n, m, soft)
        # The longest part of the way to the minimum that keeps all weights from going below zero.
        share = wp.float64(1.0)
        blocking = wp.int32(-1)
        for i in range(m):
            k = scratch.slot[s + i]
            if scratch.first[s + i] <= wp.float64(0.0):
                part = weight[s + k] / wp.max(weight[s + k] - scratch.first[s + i], MIN_TRACE)
                if part < share or blocking < 0:
                    share = wp.min(part, share)
                    blocking = k
        for i in range(m):
            k = scratch.slot[s + i]
            weight[s + k] = wp.max(weight[s + k] + share * (scratch.first[s + i] - weight[s + k]), wp.float64(0.0))
        if blocking >= 0:
            weight[s + blocking] = wp.float64(0.0)
            scratch.state[s + blocking] = 0
        else:
            entering = wp.int32(-1)
            lowest = -tolerance
            for k in range(n):
                if scratch.state[s + k] == 0:
                    slope = -multiplier - soft * scratch.regularisation[s + k]
                    for i in range(m):
                        slope += scratch.gram[o + k * n + scratch.slot[s + i]] * scratch.first[s + i]
                    if slope < lowest:
                        lowest = slope
                        entering = k
            if entering < 0:
                step = steps
            else:
                scratch.state[s + entering] = 1


@wp.func
def keep_largest(problem: SkinProblem, scratch: SkinScratch, c: wp.int32, weight: wp.array[wp.float64]) -> wp.int32:
    """Forbid all but the largest weights, the first of equal ones; returns 1 if any went."""
    s = problem.candidate_start[c]
    n = problem.candidate_start[c + 1] - s
    used = wp.int32(0)
    for k in range(n):
        if weight[s + k] > wp.float64(0.0):
            used += 1
    if used <= problem.max_influences:
        return 0
    for k in range(n):
        rank = wp.int32(0)
        for other_k in range(n):
            if weight[s + other_k] > weight[s + k] or (weight[s + other_k] == weight[s + k] and other_k < k):
                rank += 1
        scratch.state[s + k] = wp.where(rank < problem.max_influences, 0, -1)
    total = wp.float64(0.0)
    target_sum = wp.float64(0.0)
    for k in range(n):
        if scratch.state[s + k] < 0:
            weight[s + k] = wp.float64(0.0)
            scratch.regularisation[s + k] = wp.float64(0.0)
        total += weight[s + k]
        target_sum += scratch.regularisation[s + k]
    for k in range(n):
        weight[s + k] = weight[s + k] / total
        if target_sum > wp.float64(0.0):
            scratch.regularisation[s + k] = scratch.regularisation[s + k] / target_sum
        else:
            scratch.regularisation[s + k] = weight[s + k]
    return 1


@wp.kernel
def fit_vertices(
    # in
    problem: SkinProblem,
    # in and out
    scratch: SkinScratch,
    # in
    first_vertex: wp.int32,
    # out
    rest_out: wp.array[wp.vec3d],
    weight_out: wp.array[wp.float64],
    before_out: wp.array[wp.float64],
    after_out: wp.array[wp.float64],
):
    """Alternate the two solves, drop to the largest weights, alternate again; E before and after."""
    c = first_vertex + wp.tid()
    s = problem.candidate_start[c]
    n = problem.candidate_start[c + 1] - s
    for k in range(n):
        weight_out[s + k] = problem.start_weight[s + k]
        scratch.regularisation[s + k] = problem.start_weight[s + k]
        scratch.state[s + k] = 0
    v = problem.start_rest[c]
    if n == 0:
        rest_out[c] = v
        before_out[c] = wp.float64(0.0)
        after_out[c] = wp.float64(0.0)
    else:
        before_out[c] = pose_misses(problem, c, v, weight_out)
        for _ in range(problem.rounds):
            v = best_position(problem, c, weight_out, v)
            best_weights(problem, scratch, c, v, weight_out)
        if keep_largest(problem, scratch, c, weight_out) == 1:
            for _ in range(problem.rounds):
                best_weights(problem, scratch, c, v, weight_out)
                v = best_position(problem, c, weight_out, v)
        rest_out[c] = v
        after_out[c] = pose_misses(problem, c, v, weight_out)
