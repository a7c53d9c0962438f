"""Options of a simplification that need or exclude each other."""

from __future__ import annotations

from typing import TYPE_CHECKING

from warpqem.costs.models import cost_model
from warpqem.errors import OptionError

if TYPE_CHECKING:
    from warpqem.usd.commands.simplify_options import SimplifyOptions

__all__ = ["GOALS", "check_conflicts", "check_goals"]

# These say how far to simplify.
GOALS = ("ratio", "faces", "max_error", "max_distance", "screen", "lods")


def check_goals(options: SimplifyOptions) -> None:
    """Check that there is a goal, or several that go together.

    Raises:
        OptionError: there is none, or two exclude each other.
    """
    given = [name for name in GOALS if getattr(options, name) not in (None, ())]
    if not given:
        raise OptionError("one of `ratio`, `faces`, `max_error`, `max_distance`, `screen` and `lods` is needed")
    if given[:2] == ["ratio", "faces"]:
        raise OptionError(f"`ratio` {options.ratio} and `faces` {options.faces} exclude each other")
    if "lods" in given and len(given) > 1:
        raise OptionError(f"`lods` and `{given[0]}` exclude each other: the ratios of the levels say how far to go")


def check_conflicts(options: SimplifyOptions) -> None:
    """Check the options beside the goals; each is in its own range.

    Raises:
        OptionError: one needs another, or two exclude each other.
    """
    _check_face(options)
    # Those of features and cost models check their values when they are made.
    _ = options.motion
    _check_pose_independent(options)
    _check_levels(options)
    options.check_rig(len(options.lods))
    if options.reduces_joints and (options.pose_independent or options.bake or not options.skin_fit):
        raise OptionError("`joints` and `joint_error` exclude `bake`, `pose_independent` and an interpolated skin")
    if options.reduces_shapes and options.bake:
        raise OptionError("`shapes` and `shape_error` exclude `bake`")


def _check_levels(options: SimplifyOptions) -> None:
    if options.lods and options.flatten and not options.lod_files:
        raise OptionError(
            "`lods` and `flatten` exclude each other: every level is a layer over the input; with `lod_files` each "
            "level is a file that can be flat"
        )
    for name in ("usd_lod", "lod_files"):
        if getattr(options, name) and not options.lods:
            raise OptionError(f"`{name}` needs `lods`: the ratios of the levels")
    if options.usd_lod and options.lod_files:
        raise OptionError("`usd_lod` and `lod_files` exclude each other: all levels in one file, or one file for each")


def _check_pose_independent(options: SimplifyOptions) -> None:
    others = (
        options.symmetry
        or options.refit
        or options.memoryless
        or options.bake
        or options.lods
        or options.metric != "dsd"
        or options.placement != "optimal"
        or options.motion is not None
    )
    if options.pose_independent and others:
        raise OptionError(
            "`pose_independent` excludes `symmetry`, `refit`, `memoryless`, `bake`, `lods`, "
            "another `metric`, its options and another `placement`"
        )


def _check_face(options: SimplifyOptions) -> None:
    given = [name for name in ("face_points", "face_weight", "face_ring") if getattr(options, name) is not None]
    given += [] if options.face_keep else ["face_keep"]
    if given and not cost_model(options.metric).keeps_face:
        raise OptionError(f"`{given[0]}`: needs `metric` 'face', not {cost_model(options.metric).name!r}")
