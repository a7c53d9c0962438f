"""How firmly clusters are held, chosen on the device: :mod:`warpqem.place.stiffness` says why, and does it too."""

import warp as wp

wp.set_module_options({"enable_backward": False})  # no gradients are taken

# Sums over all clusters are taken by so many threads, each over every so many of them, and added in order.
SLICES = wp.constant(wp.int32(256))
# Where logarithms end.
TINY = wp.constant(wp.float64(2.2250738585072014e-308))


@wp.struct
class SoftnessRule:
    """What the constants of :mod:`warpqem.place.stiffness` come to for one mesh."""

    max_added: wp.float64  # in what the whole mesh has come to
    min_added: wp.float64  # in diagonals
    least: wp.int32  # choices that come before are none
    shares: wp.int32  # 1 where the whole mesh is softened for what stiffness costs it
    error_factor: wp.float64  # of the softest mesh's error
    wander_weight: wp.float64  # of the logarithm of what vertices wander
    min_wander_squared: wp.float64  # of one vertex


@wp.kernel
def choose_alone(
    # in
    sum_in: wp.array2d[wp.float32],
    recent_in: wp.array[wp.float32],
    rule: SoftnessRule,
    # out
    chosen_out: wp.array[wp.int32],
):
    """The first choice (C,) that adds little to each cluster's own error; ``sum_in`` (C, 2 S + 1) is of S choices."""
    c = wp.tid()
    last = (sum_in.shape[1] - 1) / 2 - 1
    bound = wp.max(rule.max_added * wp.float64(recent_in[c]), rule.min_added)
    most = wp.float64(sum_in[c, last]) + bound * bound * wp.float64(sum_in[c, 2 * last + 2])
    chosen = last
    for back in range(last):
        step = last - 1 - back
        if wp.float64(sum_in[c, step]) <= most:
            chosen = step
    chosen_out[c] = wp.max(chosen, rule.least)


@wp.kernel
def sum_choices(
    # in
    sum_in: wp.array2d[wp.float32],
    chosen_in: wp.array[wp.int32],
    # out
    total_out: wp.array2d[wp.float64],
):
    """Parts of the sums over all clusters, (slices, 2 S + 2), where each is at least as soft as a choice.

    Errors come first, then what vertices wander that have a choice left, then how many these are, and areas.
    """
    first = wp.tid()
    steps = (sum_in.shape[1] - 1) / 2
    for column in range(total_out.shape[1]):
        total_out[first, column] = wp.float64(0.0)
    for c in range(first, sum_in.shape[0], total_out.shape[0]):
        chosen = chosen_in[c]
        for step in range(steps):
            choice = wp.max(chosen, step)
            total_out[first, step] += wp.float64(sum_in[c, choice])
            if chosen < steps - 1:
                total_out[first, steps + step] += wp.float64(sum_in[c, steps + choice])
        if chosen < steps - 1:
            total_out[first, 2 * steps] += wp.float64(1.0)
        total_out[first, 2 * steps + 1] += wp.float64(sum_in[c, 2 * steps])


@wp.func
def added_up(totals: wp.array2d[wp.float64], column: wp.int32) -> wp.float64:
    """The sum of all slices."""
    total = wp.float64(0.0)
    for i in range(totals.shape[0]):
        total += totals[i, column]
    return total


@wp.kernel
def choose_together(
    # in
    total_in: wp.array2d[wp.float64],
    rule: SoftnessRule,
    # out
    least_out: wp.array[wp.int32],
):
    """One thread: the choice that all clusters are at least as soft as."""
    steps = (total_in.shape[1] - 2) / 2
    least_out[0] = rule.least
    if rule.shares == 0:
        return
    area = rule.min_added * rule.min_added * added_up(total_in, 2 * steps + 1)
    most = rule.error_factor * (area + added_up(total_in, steps - 1))
    # Vertices that are as soft as can be in any case say nothing of the others.
    still = added_up(total_in, 2 * steps - 1) <= added_up(total_in, 2 * steps) * rule.min_wander_squared
    best = wp.float64(0.0)
    found = wp.int32(-1)
    for step in range(rule.least, steps):
        error = area + added_up(total_in, step)
        if error <= most:
            # Of clusters without area all errors are zero.
            cost = wp.log(wp.max(error, TINY))
            cost += rule.wander_weight * wp.log(wp.max(added_up(total_in, steps + step), TINY))
            if found < 0 or (not still and cost < best):
                best = cost
                found = step
    least_out[0] = wp.where(found < 0, steps - 1, found)


@wp.kernel
def take_choices(
    # in
    choice_in: wp.array2d[wp.float32],
    chosen_in: wp.array[wp.int32],
    least_in: wp.array[wp.int32],
    # in and out
    softest: wp.array[wp.int32],
    # out
    stiffness_out: wp.array[wp.float32],
):
    """The stiffness (C,) of each cluster, of its choices (C, S), and the least number of a choice that is taken."""
    c = wp.tid()
    chosen = wp.max(chosen_in[c], least_in[0])
    stiffness_out[c] = choice_in[c, chosen]
    wp.atomic_min(softest, 0, chosen)
