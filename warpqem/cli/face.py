"""`warpqem face detect`, `simplify` and `retarget`."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from warpqem.arguments.limits import Limits
from warpqem.cli.console import write_json
from warpqem.cli.examples import epilog
from warpqem.cli.help_option import Command, Group
from warpqem.cli.loading import loading
from warpqem.cli.logs import takes_verbosity
from warpqem.cli.number_parameters import number, whole
from warpqem.cli.option_parameters import takes_options
from warpqem.cli.parameters import Device, Frames, Input, JsonReport, Output, ReportPage
from warpqem.cli.simplify import run_simplify
from warpqem.cli.tables import PlainTable, print_table
from warpqem.usd.commands.simplify_options import POINT_WEIGHTS, SimplifyOptions

__all__ = ["face"]

face = typer.Typer(
    name="face",
    cls=Group,
    add_completion=False,
    help="Faces: named feature points, levels that keep them, expressions transferred.",
)

# Those of the metric, which the command names itself.
POINT_OPTIONS = ("metric", "face_points", "face_weight", "face_ring", "face_keep")

FacePrim = Annotated[
    str | None,
    typer.Option(
        "--prim", metavar="PATH", rich_help_panel="Input", help="Prim path of the face; by default the largest mesh."
    ),
]
Points = Annotated[
    str | None,
    typer.Option(
        metavar="FILE",
        help="JSON file with points by name, such as detect writes: they are taken as they are. Without it, point "
        "subsets of the family face and primvars such as face:chin on the mesh are.",
    ),
]
FindOrientation = Annotated[
    bool, typer.Option("--find-orientation", help="Find which way the face looks, instead of by the stage's up axis.")
]


@face.command(
    cls=Command,
    epilog=epilog(
        "warpqem face detect talking_head.usdc -o points.json --picture points.png",
    ),
)
@takes_verbosity
def detect(
    input_file: Input,
    output: Annotated[
        str | None,
        typer.Option(
            "--output", "-o", metavar="FILE", rich_help_panel="Output", help="JSON file to write the points to."
        ),
    ] = None,
    picture: Annotated[
        str | None,
        typer.Option(
            metavar="PNG",
            rich_help_panel="Output",
            help="Draw the points on the face, from the front and from the side.",
        ),
    ] = None,
    prim: FacePrim = None,
    frames: Frames = None,
    points: Points = None,
    find_orientation: FindOrientation = False,
    device: Device = None,
    json: JsonReport = None,
) -> None:
    """Find the named feature points of a face, each with its confidence, or why it is missing.

    Exit codes: 0 done; 1 an error; 2 wrong usage; 130 interrupted.
    """
    with loading():
        from warpqem.files.outputs import named_outputs
        from warpqem.usd import FrameRange
        from warpqem.usd.commands.face import FaceOptions, check_face_outputs, draw_face, read_face, write_points

    frame_range = FrameRange.parse(frames) if frames else None
    found = read_face(input_file, FaceOptions(prim, frame_range, find_orientation, points))
    check_face_outputs(named_outputs({"--output": output, "--picture": picture, "--json": json}), [found])
    if picture is not None:
        draw_face(found, picture, device)
    written = write_points(found)
    for target in (output, json):
        if target is not None:
            write_json(target, written)
    table = PlainTable(f"{found.path}: {len(written['points'])} points")
    for name in ("point", "index", "confidence"):
        table.add_column(name, "left" if name == "point" else "right", wraps=name == "confidence")
    for name, entry in written["points"].items():
        table.add_row(name, str(entry["point"]), f"{entry['confidence']:.2f}")
    for name, reason in written["missing"].items():
        table.add_row(name, "-", reason)
    print_table(table, to_stderr="-" in (json, output))


@face.command(
    cls=Command,
    epilog=epilog(
        "warpqem face simplify talking_head.usdc -o head_2000.usda --faces 2000",
        "warpqem face simplify talking_head.usdc -o head_620.usda --faces 620 --points points.json --ring 2",
    ),
)
@takes_verbosity
@takes_options(SimplifyOptions, without=POINT_OPTIONS, hidden=("bake", "flatten"))
def simplify(
    input_file: Input,
    output: Output,
    options: dict[str, Any],
    points: Points = None,
    weight: Annotated[
        float | None,
        typer.Option(
            metavar="WEIGHT",
            parser=number(POINT_WEIGHTS),
            hidden=True,
            help="Weight of the quadrics of a feature point and of its neighbours, which are summed at it (equation 1 "
            "of multiresolution facial animation); 100 by default.",
        ),
    ] = None,
    ring: Annotated[
        int | None,
        typer.Option(
            metavar="EDGES",
            parser=whole(Limits(0)),
            hidden=True,
            help="Neighbours up to so many edges away are summed; 1 by default.",
        ),
    ] = None,
    keep: Annotated[
        bool,
        typer.Option(
            "--keep/--no-keep",
            hidden=True,
            help="Feature points stay as they are at any face count; or as long as the weight holds.",
        ),
    ] = True,
    report: ReportPage = None,
    json: JsonReport = None,
    quiet: bool = False,
    verbose: int = 0,
) -> None:
    """Simplify and keep the feature points of the face as vertices: what simplify does with --metric face.

    Points come from --points, from point subsets of the family face and primvars such as face:chin on the mesh, and
    are found otherwise. The error of texture coordinates counts too, see --uv-weight.

    Exit codes: 0 all done; 1 an error, or some mesh failed; 2 wrong usage; 130 interrupted.
    """
    chosen = {"face_points": points, "face_weight": weight, "face_ring": ring, "face_keep": keep}
    run_simplify(
        input_file, output, {**options, "metric": "face", **chosen}, report, json, quiet=quiet, verbose=verbose
    )


@face.command(
    cls=Command,
    epilog=epilog(
        "warpqem face retarget talking_head.usdc head_2000.usda -o talking_2000.usdc",
    ),
)
@takes_verbosity
def retarget(
    source_file: Annotated[str, typer.Argument(metavar="SOURCE", help="USD file with the face that moves.")],
    target_file: Annotated[str, typer.Argument(metavar="TARGET", help="USD file with the face to move.")],
    output: Output,
    source_prim: Annotated[
        str | None, typer.Option(metavar="PATH", help="Prim path of the face in SOURCE; by default the largest mesh.")
    ] = None,
    target_prim: Annotated[
        str | None, typer.Option(metavar="PATH", help="Prim path of the face in TARGET; by default the largest mesh.")
    ] = None,
    source_points: Points = None,
    target_points: Points = None,
    blend_shapes: Annotated[
        bool, typer.Option("--blend-shapes", help="Write a blend shape for each frame instead of points over time.")
    ] = False,
    frames: Frames = None,
    device: Device = None,
    json: JsonReport = None,
) -> None:
    """Move one face as another one moves: a level of it, or a face with another topology.

    Both are taken to be at rest in their first frame. OUT is a file of its own with the points of the mesh over time,
    or with blend shapes.

    Exit codes: 0 done; 1 an error; 2 wrong usage; 130 interrupted.
    """
    with loading():
        from warpqem.files.outputs import named_outputs
        from warpqem.usd import FrameRange
        from warpqem.usd.commands.face import FaceOptions, read_face, retarget_file

    frame_range = FrameRange.parse(frames) if frames else None
    source = read_face(source_file, FaceOptions(source_prim, frame_range, points=source_points))
    target = read_face(target_file, FaceOptions(target_prim, points=target_points))
    others = named_outputs({"--json": json})
    moved = retarget_file(source, target, output, blend_shapes, device, others)
    row = {
        "frames": len(moved.points),
        "vertices": moved.points.shape[1],
        "shared points": len(moved.shared),
        "vertices that fade": int((moved.share < 1.0).sum()),
    }
    table = PlainTable(f"{source_file}, {target_file} -> {output}")
    for name in row:
        table.add_column(name, justify="right")
    table.add_row(*row.values())
    print_table(table, to_stderr=json == "-")
    if json is not None:
        write_json(json, {"source": source_file, "target": target_file, "output": output, **row})
