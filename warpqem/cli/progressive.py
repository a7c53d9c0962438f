"""`warpqem progressive build`, `extract` and `info`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from warpqem.cli.console import write_json
from warpqem.cli.examples import epilog
from warpqem.cli.help_option import Command, Group
from warpqem.cli.loading import loading
from warpqem.cli.logs import takes_verbosity
from warpqem.cli.option_parameters import takes_options
from warpqem.cli.parameters import Input, JsonReport, MeshMemory, Output
from warpqem.cli.progress_bar import progress_bar
from warpqem.cli.tables import PlainTable, error_text, print_table, upper_text
from warpqem.usd.commands.option_values import read_options
from warpqem.usd.commands.progressive_options import NOT_TO_BUILD, BuildOptions, LevelChoice

if TYPE_CHECKING:
    from warpqem.progressive.header import FileInfo

__all__ = ["progressive"]

progressive = typer.Typer(
    name="progressive",
    cls=Group,
    add_completion=False,
    help="Progressive meshes: every level of one animated mesh in one file, from one run.",
)

MeshFile = Annotated[str, typer.Argument(metavar="FILE", help="Progressive mesh (.wpqm).")]


@progressive.command(
    cls=Command,
    epilog=epilog(
        "warpqem progressive build cape_wind.usdc -o cape.wpqm",
    ),
)
@takes_verbosity
@takes_options(BuildOptions, without=NOT_TO_BUILD)
def build(
    input_file: Input,
    output: Annotated[
        str,
        typer.Option(
            "--output", "-o", metavar="FILE", rich_help_panel="Output", help="Progressive mesh to write (.wpqm)."
        ),
    ],
    options: dict[str, Any],
    json: JsonReport = None,
) -> None:
    """Build the progressive mesh of one mesh of a USD file: its poses in world space, without primvars and skin.

    Exit codes: 0 done; 1 an error; 2 wrong usage; 130 interrupted.
    """
    with progress_bar("loading") as progress:
        with loading():
            from warpqem.files.outputs import named_outputs
            from warpqem.usd.commands.progressive import build_file

        asked = read_options(options, BuildOptions)
        progress(0.0, "reading")
        info = build_file(input_file, output, asked, progress, named_outputs({"--json": json}))
    _show(f"{input_file} -> {output}", info, json)


@progressive.command(
    cls=Command,
    epilog=epilog(
        "warpqem progressive extract cape.wpqm -o level.usda --faces 700",
    ),
)
@takes_verbosity
@takes_options(LevelChoice)
def extract(
    file: MeshFile, output: Output, options: dict[str, Any], memory: MeshMemory = None, json: JsonReport = None
) -> None:
    """Write one level as a USD file. Give one of --ratio, --faces, --max-error and --screen-error.

    A level by a limit is proved to be within it and measured; one by its faces has an estimate of its error.

    Exit codes: 0 done; 1 an error; 2 wrong usage; 130 interrupted.
    """
    with loading():
        from warpqem.files.outputs import named_outputs
        from warpqem.usd.commands.progressive import extract_level

    choice = read_options(options, LevelChoice)
    level = extract_level(file, output, choice, memory, named_outputs({"--json": json}))
    table = PlainTable(f"{file} -> {output}")
    cells: dict[str, str | int] = {"faces": level.faces, "estimate %": error_text(level.estimate)}
    if level.measured is not None:
        cells |= {"RMS %": error_text(level.measured.rms), "Hausdorff %": upper_text(level.measured.hausdorff)}
    for name in cells:
        table.add_column(name, justify="right")
    table.add_row(*cells.values())
    print_table(table, to_stderr=json == "-")
    if json is not None:
        measured = None if level.measured is None else level.measured.to_dict()
        found = {"faces": level.faces, "estimate": level.estimate, "measured": measured}
        write_json(json, {"input": file, "output": output, **found})


@progressive.command(
    cls=Command,
    epilog=epilog(
        "warpqem progressive info cape.wpqm",
    ),
)
@takes_verbosity
def info(file: MeshFile, json: JsonReport = None) -> None:
    """Say what is in a progressive mesh.

    Exit codes: 0 done; 1 the file cannot be read; 2 wrong usage; 130 interrupted.
    """
    with loading(usd=False):
        from warpqem.errors import StageError
        from warpqem.files.outputs import InputFile, check_outputs, named_outputs
        from warpqem.progressive import read_info

    check_outputs(named_outputs({"--json": json}), [InputFile(file)])
    try:
        found = read_info(file)
    except OSError as error:
        raise StageError(f"{file}: cannot be read ({error.strerror})") from error
    _show(file, found, json)


def _show(title: str, info: FileInfo, json: str | None) -> None:
    table = PlainTable(title)
    rows = {
        "frames": info.frame_count,
        "vertices": info.vertex_count,
        "faces": info.face_count,
        "base faces": info.base_face_count,
        "splits": info.split_count,
        "chunks": len(info.chunks),
    }
    for name in rows:
        table.add_column(name, justify="right")
    table.add_row(*rows.values())
    print_table(table, to_stderr=json == "-")
    if json is not None:
        write_json(json, {**vars(info), "chunks": len(info.chunks)})
