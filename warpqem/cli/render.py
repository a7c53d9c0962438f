"""`warpqem render`."""

from __future__ import annotations

from functools import partial
from typing import Annotated

import typer

from warpqem.arguments.limits import ANY, COUNT
from warpqem.cli.console import print_message
from warpqem.cli.loading import loading
from warpqem.cli.logs import takes_verbosity
from warpqem.cli.number_parameters import number, whole
from warpqem.cli.parameters import Device, Frames, Input, Prims, Variants
from warpqem.cli.progress_bar import progress_bar
from warpqem.errors import OptionError

__all__ = ["EXAMPLES", "render"]

# Under its help; tests run them.
EXAMPLES = ("warpqem render cape.usda -o sheet.png --reference cape_wind.usdc --heatmap --pictures 3",)


@takes_verbosity
def render(
    input_file: Input,
    output: Annotated[
        str, typer.Option("--output", "-o", metavar="PNG", rich_help_panel="Output", help="Picture to write (.png).")
    ],
    reference: Annotated[
        str | None, typer.Option(metavar="FILE", help="USD file to draw above IN, from the same view.")
    ] = None,
    heatmap: Annotated[
        bool, typer.Option("--heatmap", help="With --reference: a third row coloured by the distance from it.")
    ] = False,
    pictures: Annotated[
        int,
        typer.Option(metavar="COUNT", parser=whole(COUNT), help="Pictures in a row, spread evenly over the animation."),
    ] = 4,
    size: Annotated[str, typer.Option(metavar="WxH", help="Size of one picture, in pixels.")] = "480x360",
    azimuth: Annotated[
        float, typer.Option(metavar="DEG", parser=number(ANY, "DEG"), help="View about the up axis, in degrees.")
    ] = 30.0,
    elevation: Annotated[
        float, typer.Option(metavar="DEG", parser=number(ANY, "DEG"), help="View above the horizon, in degrees.")
    ] = 12.0,
    lines: Annotated[bool, typer.Option("--lines", help="Draw the edges.")] = False,
    smooth: Annotated[
        bool,
        typer.Option("--smooth/--faceted", help="Shade over the edges that are not hard, or every face for itself."),
    ] = True,
    plain: Annotated[
        bool, typer.Option("--plain", help="One colour instead of the textures and display colours of the file.")
    ] = False,
    frames: Frames = None,
    prim: Prims = None,
    variant: Variants = None,
    device: Device = None,
) -> None:
    """Draw a contact sheet: the meshes of IN at several times, beside those of a reference, without a browser.

    Exit codes: 0 done; 1 an error; 2 wrong usage; 130 interrupted.
    """
    with progress_bar("loading") as progress:
        with loading():
            from warpqem.usd import FrameRange
            from warpqem.usd.commands.render import RenderOptions, render_sheet

        options = RenderOptions(
            pictures=pictures,
            frames=FrameRange.parse(frames) if frames else None,
            prims=tuple(prim or ()),
            size=_parse_size(size),
            azimuth=azimuth,
            elevation=elevation,
            lines=lines,
            smooth=smooth,
            plain=plain,
            heatmap=heatmap,
            device=device,
            variants=tuple(variant or ()),
        )
        progress(0.0, "reading")
        scale = render_sheet(input_file, output, options, reference, progress, partial(print_message, "warning"))
    if scale is not None:
        print_message("note", f"the brightest colour is at {scale:.3g} % of the bounding-box diagonal")


def _parse_size(text: str) -> tuple[int, int]:
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(part.isascii() and part.isdecimal() for part in parts):
        raise OptionError(f"size '{text}': expected WIDTHxHEIGHT in pixels, such as 480x360")
    return int(parts[0]), int(parts[1])
