"""Triangles that texture coordinates turn over, put right by small moves of their corners, one after the other."""

import warp as wp

# No gradients are taken. Products and sums are rounded one by one, as NumPy does, wherever this runs.
wp.set_module_options({"enable_backward": False, "fuse_fp": False})

# What a row is to the triangles that are turned over.
AT_TURNED = wp.constant(wp.int32(1))  # at a corner of one
MOVABLE = wp.constant(wp.int32(2))  # at a corner of a triangle that shares a corner with one


@wp.struct
class Chart:
    """Triangles (N',) of values (R, 2), and where these may be."""

    corner_row: wp.array2d[wp.int32]  # (N', 3), which value each corner has
    sign: wp.array[wp.int32]  # (N',) which way each triangle is to turn, 0 for either
    lower: wp.array2d[wp.float64]  # (R, 2)
    upper: wp.array2d[wp.float64]  # (R, 2)


@wp.struct
class Rounds:
    """What rounds over a chart write to."""

    mark: wp.array[wp.int32]  # (R,), AT_TURNED and MOVABLE
    watched: wp.array[wp.int32]  # (N',) the triangles with a movable corner and a sign, in order
    area: wp.array[wp.float64]  # (N',) twice the area of each of them, by its sign
    trial: wp.array2d[wp.float64]  # (R, 2) values
    total: wp.array2d[wp.float64]  # (R, 2) sum of the moves that triangles ask for
    asked: wp.array[wp.int32]  # (R,) how many these are


@wp.func
def as_written(value: wp.float64) -> wp.float64:
    """A value as files hold it: rounding turns triangles over that are next to none."""
    return wp.float64(wp.float32(value))


@wp.func
def signed_area(chart: Chart, values: wp.array2d[wp.float64], face: wp.int32) -> wp.float64:
    """Twice the area of a triangle by the values as files hold them, below 0 where it is turned over."""
    a = chart.corner_row[face, 0]
    b = chart.corner_row[face, 1]
    c = chart.corner_row[face, 2]
    x = as_written(values[a, 0])
    y = as_written(values[a, 1])
    left = (as_written(values[b, 0]) - x) * (as_written(values[c, 1]) - y)
    right = (as_written(values[b, 1]) - y) * (as_written(values[c, 0]) - x)
    return wp.float64(chart.sign[face]) * (left - right)


@wp.func
def count_turned(chart: Chart, values: wp.array2d[wp.float64], rounds: Rounds) -> wp.int32:
    """How many triangles are turned over; marks the values at their corners."""
    for row in range(rounds.mark.shape[0]):
        rounds.mark[row] = 0
    count = wp.int32(0)
    for face in range(chart.sign.shape[0]):
        if signed_area(chart, values, face) < wp.float64(0.0):
            count += 1
            for k in range(3):
                rounds.mark[chart.corner_row[face, k]] = AT_TURNED
    return count


@wp.func
def is_at(chart: Chart, rounds: Rounds, face: wp.int32, kind: wp.int32) -> wp.bool:
    """Whether a triangle has a corner of a kind."""
    kinds = wp.int32(0)
    for k in range(3):
        kinds = kinds | rounds.mark[chart.corner_row[face, k]]
    return (kinds & kind) != 0


@wp.func
def list_watched(chart: Chart, rounds: Rounds) -> wp.int32:
    """Mark the values that may move, and list the triangles that this may turn; how many these are."""
    face_count = chart.sign.shape[0]
    for face in range(face_count):
        if is_at(chart, rounds, face, AT_TURNED):
            for k in range(3):
                row = chart.corner_row[face, k]
                rounds.mark[row] = rounds.mark[row] | MOVABLE
    count = wp.int32(0)
    for face in range(face_count):
        if chart.sign[face] != 0 and is_at(chart, rounds, face, MOVABLE):
            rounds.watched[count] = face
            count += 1
    return count


@wp.func
def ask_for_moves(chart: Chart, rounds: Rounds, face: wp.int32, area: wp.float64, margin: wp.float64) -> wp.bool:
    """Add up the least moves of its corners that give a triangle its area; whether there are any."""
    zero = wp.float64(0.0)
    sign = wp.float64(chart.sign[face])
    longest = zero
    squared = zero
    gradient = wp.matrix(shape=(3, 2), dtype=wp.float64)
    for k in range(3):
        row = chart.corner_row[face, k]
        following = chart.corner_row[face, (k + 1) % 3]
        before = chart.corner_row[face, (k + 2) % 3]
        x = rounds.trial[following, 0] - rounds.trial[before, 0]
        y = rounds.trial[following, 1] - rounds.trial[before, 1]
        longest = wp.max(longest, x * x + y * y)
        turn = zero
        if (rounds.mark[row] & MOVABLE) != 0:
            turn = sign
        gradient[k, 0] = y * turn
        gradient[k, 1] = -x * turn
        squared += gradient[k, 0] * gradient[k, 0]
        squared += gradient[k, 1] * gradient[k, 1]
    share = zero
    if squared > zero:
        share = (margin * longest - area) / squared
    moves = wp.bool(False)
    for k in range(3):
        row = chart.corner_row[face, k]
        rounds.asked[row] = rounds.asked[row] + 1
        for axis in range(2):
            move = share * gradient[k, axis]
            moves = moves or move != zero
            rounds.total[row, axis] = rounds.total[row, axis] + move
    return moves


@wp.func
def take_moves(chart: Chart, rounds: Rounds) -> wp.bool:
    """Move each value by the mean of what was asked for, to where it may be; whether any is at another place then."""
    moved = wp.bool(False)
    for row in range(rounds.mark.shape[0]):
        count = wp.float64(wp.max(rounds.asked[row], 1))
        for axis in range(2):
            value = rounds.trial[row, axis]
            there = value + rounds.total[row, axis] / count
            there = wp.min(wp.max(there, chart.lower[row, axis]), chart.upper[row, axis])
            moved = moved or there != value
            rounds.trial[row, axis] = there
            rounds.total[row, axis] = wp.float64(0.0)
        rounds.asked[row] = 0
    return moved


@wp.func
def improve(
    chart: Chart,
    rounds: Rounds,
    values: wp.array2d[wp.float64],
    turned: wp.int32,
    margin: wp.float64,
    round_count: wp.int32,
):
    """Put the best values of so many rounds in the place of values that turn so many triangles over."""
    watched = list_watched(chart, rounds)
    for row in range(values.shape[0]):
        for axis in range(2):
            rounds.trial[row, axis] = values[row, axis]
    left = turned
    for _ in range(round_count):
        count = wp.int32(0)
        for i in range(watched):
            area = signed_area(chart, rounds.trial, rounds.watched[i])
            rounds.area[i] = area
            if area < wp.float64(0.0):
                count += 1
        if count < left:
            left = count
            for row in range(values.shape[0]):
                for axis in range(2):
                    values[row, axis] = rounds.trial[row, axis]
        # A triangle without area is next to one that is turned over.
        any_flat = wp.bool(False)
        moves = wp.bool(False)
        for i in range(watched):
            if rounds.area[i] <= wp.float64(0.0):
                any_flat = True
                asks = ask_for_moves(chart, rounds, rounds.watched[i], rounds.area[i], margin)
                moves = moves or asks
        if not any_flat:
            break
        moved = take_moves(chart, rounds)
        if not (moves or moved):
            # Nothing that may move puts any of them right.
            break


@wp.kernel
def turn_back(
    # in
    chart: Chart,
    margin_in: wp.array[wp.float64],
    round_count: wp.int32,
    # in and out
    values: wp.array2d[wp.float64],
    rounds: Rounds,
):
    """Turn triangles back that the values (R, 2) turn over: rounds with one margin after the other, by one thread.

    ``rounds`` has nothing asked for, before and afterwards.
    """
    for i in range(margin_in.shape[0]):
        turned = count_turned(chart, values, rounds)
        if turned == 0:
            return
        improve(chart, rounds, values, turned, margin_in[i], round_count)
