"""How to build a progressive mesh from a USD file, and which level of one to take."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from warpqem.arguments.limits import ABOVE_0, COUNT, SHARE
from warpqem.arguments.option_fields import check_options, option, option_fields
from warpqem.costs.screen_error import ScreenView
from warpqem.errors import OptionError
from warpqem.options import MethodOptions
from warpqem.usd.commands.option_checks import FRAMES_HELP, read_frames
from warpqem.usd.read.time_codes import FrameRange

if TYPE_CHECKING:
    from warpqem.arguments.distance_limit import DistanceLimit
    from warpqem.progressive.stage_notes import StageNotes

__all__ = ["NOT_TO_BUILD", "BuildOptions", "LevelChoice"]

# Options of a mesh that a progressive mesh has no use for: it has all levels, and every vertex is placed once.
NOT_TO_BUILD = ("ratio", "max_error", "max_size_error", "refit", "keep_components")


@dataclass(frozen=True)
class BuildOptions(MethodOptions):
    """How to build a progressive mesh.

    Attributes:
        prim: Prim path of the mesh; None for the only one of the stage.
        base_faces: Faces of the base mesh; None for as few as legal collapses lead to.
        frames: Time codes to read; None for all authored ones.
    """

    prim: str | None = option(
        None, "Prim path of the mesh; needed where IN has more than one.", "PATH", basic=True, panel="Input"
    )
    base_faces: int | None = option(
        None, "Triangles of the coarsest level; by default as few as can be.", "FACES", COUNT, basic=True, panel="Goal"
    )
    frames: FrameRange | None = option(
        None, FRAMES_HELP, "START:END[:STEP]", basic=True, parse=read_frames, panel="Input"
    )

    def __post_init__(self) -> None:
        """Check the options.

        Raises:
            OptionError: one is of the wrong type or outside its range, or it is one that has no meaning here.
        """
        check_options(self)
        fields = option_fields(BuildOptions)
        given = [name for name in NOT_TO_BUILD if getattr(self, name) != fields[name].default]
        if given:
            raise OptionError(f"{', '.join(given)}: not with a progressive mesh, which has all levels")


@dataclass(frozen=True)
class LevelChoice:
    """Which level to take. Exactly one is given.

    Attributes:
        ratio: Share of the input's triangles.
        faces: Triangles.
        max_error: Largest distance from the input, in % of the diagonal of its bounding box in each frame; proved.
        screen: The same on a screen, at a distance in the units of the stage.
    """

    ratio: float | None = option(None, "Share of the input's triangles.", "SHARE", SHARE, basic=True, panel="Goal")
    faces: int | None = option(None, "Triangles.", "FACES", COUNT, basic=True, panel="Goal")
    max_error: float | None = option(
        None,
        "Largest distance from the input, in % of its bounding-box diagonal, proved for every point and pose.",
        "PCT",
        ABOVE_0,
        basic=True,
        panel="Goal",
    )
    screen: ScreenView | None = option(None, "")

    def __post_init__(self) -> None:
        """Refuse none and more than one."""
        given = [name for name, value in vars(self).items() if value is not None]
        if len(given) != 1:
            raise OptionError(
                f"exactly one of `ratio`, `faces`, `max_error` and `screen_error` must be given, not {given or 'none'}"
            )
        check_options(self)

    def limit(self, notes: StageNotes) -> DistanceLimit:
        """How far the level may be from the input.

        Args:
            notes: what the file says of its stage.

        Raises:
            ProgressiveFileError: the size that it says is none.
        """
        from warpqem.arguments.distance_limit import DistanceLimit

        if self.screen is not None:
            notes.diagonal()
            return DistanceLimit(length=self.screen.length)
        return DistanceLimit() if self.max_error is None else DistanceLimit(part=self.max_error / 100.0)
