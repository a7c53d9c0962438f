"""Options of what moves a mesh on its levels: influences, joints and blend shapes, each one value or one per level."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from warpqem.arguments.limits import Limits
from warpqem.arguments.option_fields import option
from warpqem.errors import OptionError
from warpqem.options import MethodOptions

__all__ = ["RigOptions", "level_options", "read_counts", "single"]

Options = TypeVar("Options", bound="RigOptions")
# An error limit is a share of the bounding-box diagonal.
PERCENT = Limits(0.0, 100.0)
# Options that take a value for each level.
LEVEL_COUNTS = ("influences", "joints", "shapes")


def read_counts(value: Any) -> int | tuple[int, ...]:
    """A count, or one for each level from text such as "4,2,1".

    Raises:
        ValueError: it is neither.
    """
    if isinstance(value, bool):
        raise ValueError("expected a whole number, or one for each level such as 4,2,1")
    if isinstance(value, (int, float)):
        return _refuse() if isinstance(value, float) and not value.is_integer() else int(value)
    parts = value.split(",") if isinstance(value, str) else list(value)
    counts = tuple(_count(part) for part in parts)
    return counts[0] if len(counts) == 1 else counts


def _count(part: Any) -> int:
    text = str(part).strip()
    return int(text) if re.fullmatch(r"-?\d{1,9}", text, re.ASCII) else _refuse()


def _refuse() -> int:
    raise ValueError("expected a whole number, or one for each level such as 4,2,1")


@dataclass(frozen=True)
class RigOptions(MethodOptions):
    """How joints and blend shapes of the meshes are reduced.

    Attributes:
        influences: Joints that move a new point of a skinned mesh at most; None for as many as in the input. With
            `lods` it may be a tuple with one number for each level.
        joints: Joints that move a skinned mesh at most, chosen by the error over its poses, see
            `warpqem.skinning.reduce_joints`; None for as many as in the input; a tuple as `influences`.
        joint_error: Joints go as long as this adds so many % of the bounding-box diagonal to the RMS distance over the
            poses; None for no such limit. With `joints` too, it limits these. It is an estimate by distances from
            planes, which have no end: too low, up to half, where much motion goes.
        reduce_skeleton: Take joints that move nothing any more off skeletons and their animations, too.
        shapes: Blend shapes of a mesh at most, see `warpqem.skinning.reduce_shapes`; None for as many as in the input;
            a tuple as `influences`.
        shape_error: Blend shapes go as long as the RMS distance that this makes, over the animation and over random
            weights, is at most so many % of the bounding-box diagonal; None for no such limit.
    """

    influences: int | tuple[int, ...] | None = option(
        None,
        "Joints that move a point of a skinned mesh at most; by default as many as in IN. With --lods one number, or "
        "one for each level, such as 4,2,1.",
        "JOINTS",
        parse=read_counts,
        panel="Skin and shapes",
    )
    joints: int | tuple[int, ...] | None = option(
        None,
        "Joints that move a skinned mesh at most, chosen by the error over its poses; weights and rest points are "
        "solved for again. With --lods one number, or one for each level.",
        "JOINTS",
        parse=read_counts,
        panel="Skin and shapes",
    )
    joint_error: float | None = option(
        None,
        "Joints of a skinned mesh go as long as that adds so many % of the bounding-box diagonal to its RMS distance "
        "over the poses, by an estimate from planes that is too low where much motion goes; the table has what is "
        "measured.",
        "PCT",
        PERCENT,
        panel="Skin and shapes",
    )
    reduce_skeleton: bool = option(
        False,
        "Take joints that move nothing any more off the skeletons and their animations, too; on each level.",
        panel="Skin and shapes",
    )
    shapes: int | tuple[int, ...] | None = option(
        None,
        "Blend shapes of a mesh at most: those that the new mesh shows least go, and the weights of the animation are "
        "corrected. With --lods one number, or one for each level.",
        "SHAPES",
        parse=read_counts,
        panel="Skin and shapes",
    )
    shape_error: float | None = option(
        None,
        "Blend shapes go as long as that makes an RMS distance of so many % of the bounding-box diagonal at most, over "
        "the animation and over random weights.",
        "PCT",
        PERCENT,
        panel="Skin and shapes",
    )

    def check_rig(self, level_count: int) -> None:
        """Check the counts for so many levels.

        Raises:
            OptionError: one is no whole number of at least 1, or there is not one for each level.
        """
        from warpqem.arguments.number_input import whole_number

        for name in LEVEL_COUNTS:
            value = getattr(self, name)
            if value is None:
                continue
            for count in value if isinstance(value, tuple) else (value,):
                whole_number(count, name, expected="a whole number at least 1")
            if isinstance(value, tuple) and len(value) != max(level_count, 1):
                levels = f"there are {level_count} levels" if level_count else "there are no levels (`lods`)"
                raise OptionError(f"{name} has {len(value)} values, and {levels}")

    @property
    def reduces_joints(self) -> bool:
        """Whether joints are to go."""
        return self.joints is not None or self.joint_error is not None

    @property
    def reduces_shapes(self) -> bool:
        """Whether blend shapes are to go."""
        return self.shapes is not None or self.shape_error is not None


def level_options(options: Options, level: int) -> Options:
    """The options of one level, which has one number of each."""
    values = {name: getattr(options, name) for name in LEVEL_COUNTS}
    own = {name: value[level] for name, value in values.items() if isinstance(value, tuple)}
    return replace(options, **own)


def single(value: int | tuple[int, ...] | None) -> int | None:
    """The value of one level."""
    assert not isinstance(value, tuple)
    return value
