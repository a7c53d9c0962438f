"""`warpqem progressive build`, `extract` and `info`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from warpqem.cli.console import PlainTable, load_usd, print_table, progress_bar, quiet_libraries, write_json
from warpqem.cli.examples import epilog
from warpqem.cli.options import (
    Coherence,
    Device,
    Distance,
    FieldOfView,
    Frames,
    ImageHeight,
    Input,
    JsonReport,
    KeyFrames,
    MeshMemory,
    Metric,
    MetricOption,
    Output,
    ScreenError,
)

if TYPE_CHECKING:
    from warpqem.progressive.header import FileInfo

__all__ = ["progressive"]

progressive = typer.Typer(
    name="progressive", help="Progressive meshes: every level of one animated mesh in one file, from one run."
)

MeshFile = Annotated[str, typer.Argument(metavar="FILE", help="Progressive mesh (.wpqm).")]


@progressive.command(epilog=epilog("build"))
def build(
    input_file: Input,
    output: Annotated[str, typer.Option("--output", "-o", metavar="FILE", help="Progressive mesh to write (.wpqm).")],
    prim: Annotated[
        str | None, typer.Option(metavar="PATH", help="Prim path of the mesh; needed where IN has more than one.")
    ] = None,
    base_faces: Annotated[
        int | None, typer.Option(help="Triangles of the coarsest level; by default as few as can be.")
    ] = None,
    metric: MetricOption = Metric.dsd,
    coherence: Coherence = 0.5,
    key_frames: KeyFrames = 16,
    frames: Frames = None,
    device: Device = None,
    json: JsonReport = None,
) -> None:
    """Build the progressive mesh of one mesh of a USD file: its poses in world space, without primvars and skin.

    Exit codes: 0 done; 1 an error; 2 wrong usage; 130 interrupted.
    """
    quiet_libraries()
    load_usd()
    from warpqem.outputs import named_outputs
    from warpqem.usd import FrameRange
    from warpqem.usd.progressive import BuildOptions, build_file

    options = BuildOptions(
        prim=prim,
        base_faces=base_faces,
        metric=metric.value,
        coherence=coherence,
        key_frames=key_frames,
        frames=FrameRange.parse(frames) if frames else None,
        device=device,
    )
    with progress_bar("reading") as progress:
        info = build_file(input_file, output, options, progress, named_outputs({"--json": json}))
    _show(f"{input_file} -> {output}", info, json)


@progressive.command(epilog=epilog("extract"))
def extract(
    file: MeshFile,
    output: Output,
    ratio: Annotated[float | None, typer.Option(help="Share of the input's triangles, above 0 and at most 1.")] = None,
    faces: Annotated[int | None, typer.Option(help="Triangles.")] = None,
    max_error: Annotated[
        float | None, typer.Option(metavar="PCT", help="Largest error, in % of the bounding-box diagonal.")
    ] = None,
    screen_error: ScreenError = None,
    distance: Distance = None,
    field_of_view: FieldOfView = 45.0,
    image_height: ImageHeight = 1080,
    memory: MeshMemory = None,
    json: JsonReport = None,
) -> None:
    """Write one level as a USD file. Give one of --ratio, --faces, --max-error and --screen-error.

    Exit codes: 0 done; 1 an error; 2 wrong usage; 130 interrupted.
    """
    quiet_libraries()
    load_usd()
    from warpqem.outputs import named_outputs
    from warpqem.usd.option_values import screen_view
    from warpqem.usd.progressive import LevelChoice, extract_level

    screen = screen_view(screen_error, distance, field_of_view, image_height)
    choice = LevelChoice(ratio, faces, max_error, screen)
    count, error = extract_level(file, output, choice, memory, named_outputs({"--json": json}))
    table = PlainTable(f"{file} -> {output}")
    for name in ("faces", "error %"):
        table.add_column(name, justify="right")
    table.add_row(str(count), f"{error:.4f}")
    print_table(table, to_stderr=json == "-")
    if json is not None:
        write_json(json, {"input": file, "output": output, "faces": count, "error": error})


@progressive.command(epilog=epilog("progressive info"))
def info(file: MeshFile, json: JsonReport = None) -> None:
    """Say what is in a progressive mesh.

    Exit codes: 0 done; 1 the file cannot be read; 2 wrong usage; 130 interrupted.
    """
    quiet_libraries()
    from warpqem.errors import StageError
    from warpqem.outputs import InputFile, check_outputs, named_outputs
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
    table.add_row(*map(str, rows.values()))
    print_table(table, to_stderr=json == "-")
    if json is not None:
        write_json(json, {**vars(info), "chunks": len(info.chunks)})
