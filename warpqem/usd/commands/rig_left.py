"""What is left of a rig: whether anything went, and why more stays than was asked for."""

from __future__ import annotations

from collections.abc import Sequence

from warpqem.arguments.distance_limit import DistanceLimit
from warpqem.usd.commands.rig_options import RigOptions, single
from warpqem.usd.commands.rig_steps import Rig
from warpqem.usd.commands.skin_bound import Attempt

__all__ = ["changes_left", "what_stays"]


def changes_left(wanted: Sequence[str], rig: Rig) -> list[str]:
    """Of the options that change a mesh whose faces all stay, those that still do: of joints and shapes some went.

    Args:
        wanted: names of the options.
        rig: what is left.
    """
    stay: set[str] = set()
    joints = None if rig.fitted is None else rig.fitted.joints
    if joints is None or joints.after >= joints.before:
        stay |= {"joints", "joint_error"}
    if rig.shapes is None or not rig.shapes.report.removed:
        stay |= {"shapes", "shape_error"}
    if rig.keeps_influences:
        stay.add("influences")
    return [name for name in wanted if name not in stay]


def what_stays(done: Attempt, options: RigOptions, limit: DistanceLimit) -> list[str]:
    """Why more influences, joints and blend shapes stay than were asked for, a line for each.

    Args:
        done: the mesh and what is left of its rig.
        options: what was asked for.
        limit: how far the mesh may be from the input.
    """
    reason = f"{limit} does not hold with fewer" if done.holds else f"{limit} does not hold even with all of them"
    influences, joints, shapes = (step > 0 for step in done.place)
    lines = []
    if influences:
        given = single(options.influences)
        lines.append(f"up to {done.rig.influences} joints move a point, as {reason}; asked for: {given}")
    fitted, reduced = done.rig.fitted, done.rig.shapes
    if fitted is not None and fitted.joints is not None:
        found = fitted.joints
        why = _why(found.after, single(options.joints), "joint_error", options.joint_error, reason if joints else None)
        if why is not None:
            lines.append(f"{found.after} of {found.before} joints stay, as {why}")
    if reduced is not None:
        counts = reduced.report
        why = _why(counts.after, single(options.shapes), "shape_error", options.shape_error, reason if shapes else None)
        if why is not None:
            lines.append(f"{counts.after} of {counts.before} blend shapes stay, as {why}")
    return lines


def _why(left: int, asked: int | None, name: str, error: float | None, limit: str | None) -> str | None:
    """Why more are left than were asked for, and what that was; None where no more are.

    Args:
        left: those that are left.
        asked: those that were asked for; None for none.
        name: the option with the error that they may make.
        error: its value; None for none.
        limit: why the limit on the distance asks for more; None where it does not.
    """
    if limit is None and (asked is None or left <= asked):
        return None
    wishes = [] if asked is None else [str(asked)]
    if limit is not None:
        wishes += [] if error is None else [f"{name} {error:g} %"]
        return f"{limit}; asked for: {' and '.join(wishes)}"
    reason = "the others may not go" if error is None else f"fewer would make more than {name} {error:g} %"
    return f"{reason}; asked for: {' and '.join(wishes)}"
