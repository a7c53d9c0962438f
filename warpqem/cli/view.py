"""`warpqem view`."""

from __future__ import annotations

import webbrowser
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from warpqem.arguments.limits import Limits
from warpqem.cli import messages
from warpqem.cli.console import print_message
from warpqem.cli.crash_guard import interruptible
from warpqem.cli.loading import loading
from warpqem.cli.logs import takes_verbosity
from warpqem.cli.number_parameters import whole
from warpqem.cli.parameters import Device, Frames, MeshMemory, Prims, Variants
from warpqem.cli.progress_bar import progress_bar
from warpqem.errors import MemoryLimitError, OptionError, StageError, WarpqemError

__all__ = ["EXAMPLES", "view"]

# Of TCP.
PORTS = Limits(0, 65535)
# Under its help; tests run them.
EXAMPLES = ("warpqem view cape_wind.usdc cape.usda",)


@takes_verbosity
def view(
    input_file: Annotated[
        str, typer.Argument(metavar="IN", help="USD file, or progressive mesh (.wpqm): any of its levels, live.")
    ],
    other: Annotated[
        str | None, typer.Argument(metavar="[OUT]", help="USD file to show beside it, such as what simplify wrote.")
    ] = None,
    port: Annotated[
        int,
        typer.Option(
            metavar="PORT", parser=whole(PORTS), help="Port of this machine to serve at; 0 takes any that is free."
        ),
    ] = 0,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the page in the browser, or only print its address.")
    ] = True,
    frames: Frames = None,
    prim: Prims = None,
    variant: Variants = None,
    device: Device = None,
    memory: MeshMemory = None,
) -> None:
    """Look at meshes in motion in the browser, until interrupted.

    The page is that of --report. It is served to this machine only, at an address that nobody can guess.

    Exit codes: 0 interrupted while it serves; 1 an error; 2 wrong usage; 130 interrupted before.
    """
    with loading(usd=False):
        from warpqem.report.page import report_page
        from warpqem.report.server import PageServer

    progressive = input_file.lower().endswith(".wpqm")
    if progressive and other is not None:
        raise OptionError("a progressive mesh is shown alone: leave OUT away")
    if progressive and (frames or prim or variant):
        raise OptionError(
            "--frames, --prim and --variant are for USD files; a progressive mesh holds one mesh and its frames"
        )
    if memory is not None and not progressive:
        raise OptionError("--memory is for progressive meshes")
    level = None
    if progressive:
        data, level = _live_data(input_file, device, memory)
    else:
        data = _stage_data(input_file, other, frames, prim, variant, device)
    server = PageServer(report_page(data), level, port)
    # Without a browser the address is all that there is of the page.
    if not (browser and messages.quiet):
        print(server.address, flush=True)
    print_message("note", "stop with Ctrl+C")
    if browser:
        webbrowser.open(server.address)
    try:
        with interruptible():
            server.serve()
    except KeyboardInterrupt:
        print_message("note", "stopped")


def _live_data(
    path: str, device: str | None, memory: str | None
) -> tuple[dict[str, Any], Callable[[int], dict[str, Any]]]:
    from warpqem.progressive.file import ProgressiveFile
    from warpqem.report.live import LiveLevels

    try:
        with ProgressiveFile(path) as file:
            live = LiveLevels(file.load(memory=memory), Path(path).name, file.info.extra, device)
        return live.data(), live.level
    except OSError as error:
        raise StageError(f"{path}: cannot be read ({error.strerror})") from error
    except MemoryError as error:
        if isinstance(error, WarpqemError):
            raise
        raise MemoryLimitError(f"{path}: there is not enough memory to show it") from error


def _stage_data(
    path: str,
    other: str | None,
    frames: str | None,
    prim: list[str] | None,
    variant: list[str] | None,
    device: str | None,
) -> dict[str, Any]:
    with loading():
        from warpqem.report import report_data
        from warpqem.usd import FrameRange
        from warpqem.usd.commands.report_page import stage_report

    with progress_bar("reading") as progress:
        chosen = FrameRange.parse(frames) if frames else None
        report = stage_report(path, other, tuple(prim or ()), chosen, tuple(variant or ()))
        for note in report.notes:
            print_message("note", note)
        return report_data(report, device, progress)
