"""`warpqem simplify`."""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape
from rich.table import Table

from warpqem.cli.console import EXIT_FAILED, print_table, progress_bar, quiet_warp, tell, write_json
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
    Metric,
    MetricOption,
    Output,
    Prims,
    ScreenError,
    screen_view,
)

if TYPE_CHECKING:
    from warpqem.memory import MemoryPlan
    from warpqem.usd.report import PrimReport, StageReport

__all__ = ["simplify"]


class MorphWeights(str, Enum):
    """Ways from the distances of morph targets to weights."""

    thirds = "thirds"
    rank = "rank"
    distance = "distance"
    usage = "usage"


class Placement(str, Enum):
    """Vertex placements."""

    optimal = "optimal"
    endpoint = "endpoint"


def simplify(
    input_file: Input,
    output: Output,
    ratio: Annotated[
        float | None, typer.Option(help="Share of its triangles that each mesh keeps, above 0 and at most 1.")
    ] = None,
    faces: Annotated[
        int | None,
        typer.Option(help="Triangles of all meshes together; each mesh gets its part by what its faces are worth."),
    ] = None,
    max_error: Annotated[
        float | None,
        typer.Option(metavar="PCT", help="Largest error of each mesh, in % of its bounding-box diagonal."),
    ] = None,
    screen_error: ScreenError = None,
    distance: Distance = None,
    field_of_view: FieldOfView = 45.0,
    image_height: ImageHeight = 1080,
    lods: Annotated[
        str | None,
        typer.Option(
            metavar="RATIOS",
            help="Levels of detail, such as 0.5,0.25,0.1: OUT offers IN as LOD0 and one level for each ratio as LOD1, "
            "LOD2, ... in the variant set LOD of its default prim.",
        ),
    ] = None,
    usd_lod: Annotated[
        bool,
        typer.Option(
            "--usd-lod",
            help="With --lods: write the levels with the UsdLod schemas, for renderers to choose by size or distance.",
        ),
    ] = False,
    metric: MetricOption = Metric.dsd,
    coherence: Coherence = 0.5,
    refit: Annotated[
        bool,
        typer.Option("--refit/--no-refit", help="Fit the whole surface once more at the end: better shape, slower."),
    ] = False,
    placement: Annotated[
        Placement, typer.Option(help="Merged vertices at the optimal point, or at an endpoint of the edge.")
    ] = Placement.optimal,
    key_frames: KeyFrames = 16,
    uv_weight: Annotated[
        float,
        typer.Option(
            metavar="FLOAT",
            help="Weight of texture-coordinate error in the choice of collapses: at 1 the whole UV square counts as "
            "much as the bounding-box diagonal; 0 does not look at UVs.",
        ),
    ] = 0.0,
    attribute_weight: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=FLOAT", help="The same for the primvar NAME; may be given several times."),
    ] = None,
    weight_primvar: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Primvar of numbers, painted on the meshes, that scale the cost: 10 is ten times as important as 1, "
            "infinity locks.",
        ),
    ] = None,
    morph_weights: Annotated[
        MorphWeights | None,
        typer.Option(
            help="Keep more detail where blend shapes or poses move the surface more: weights by thirds of the points, "
            "by rank, by distance, or by distance as an animation uses the shapes."
        ),
    ] = None,
    lock_borders: Annotated[bool, typer.Option("--lock-borders", help="Keep the points of open borders.")] = False,
    memory: Annotated[
        str | None,
        typer.Option(
            metavar="BYTES",
            help="Memory that the work on a mesh may take beside the program itself, such as 8G or 500M; by default "
            "most of what is free. It decides how many frames are in memory at once, and no bit of the result.",
        ),
    ] = None,
    frames: Frames = None,
    poses: Annotated[
        str | None,
        typer.Option(
            metavar="FILE",
            help="USD file with example poses at the same prim paths, such as another clip: they decide how skinned "
            "meshes are simplified, instead of the animation in IN.",
        ),
    ] = None,
    influences: Annotated[
        int | None,
        typer.Option(help="Joints that move a point of a skinned mesh at most; by default as many as in IN."),
    ] = None,
    skin_fit: Annotated[
        bool,
        typer.Option(
            "--skin-fit/--no-skin-fit",
            help="Fit rest points and joint influences of skinned meshes together to their poses; or interpolate them.",
        ),
    ] = True,
    prim: Prims = None,
    device: Device = None,
    bake: Annotated[
        bool, typer.Option("--bake", help="Write skinned and blend-shaped meshes as point samples, without their skin.")
    ] = False,
    weld: Annotated[
        bool,
        typer.Option(
            "--weld/--no-weld", help="Join points that lie together in every frame, such as those split at UV seams."
        ),
    ] = True,
    flatten: Annotated[
        bool, typer.Option("--flatten", help="Write one self-contained file instead of a layer over IN.")
    ] = False,
    strict: Annotated[
        bool, typer.Option("--strict", help="Stop at the first mesh that cannot be done, and write nothing.")
    ] = False,
    json: JsonReport = None,
) -> None:
    """Simplify every mesh over all its frames. Give one of --ratio, --faces, --max-error,
    --screen-error and --lods.

    OUT is a small layer over IN that holds the new meshes; keep the two files together, or use --flatten. Primvars,
    normals, subsets, skins and blend shapes come along. What does not fit the new meshes is dropped, with a warning.

    Exit codes: 0 all done; 1 an error, or some mesh failed; 2 wrong usage.
    """
    quiet_warp()
    from warpqem.usd import FrameRange, SimplifyOptions, simplify_stage
    from warpqem.usd.attributes import parse_attribute_weight
    from warpqem.usd.lods import parse_lods

    options = SimplifyOptions(
        ratio=ratio,
        faces=faces,
        max_error=max_error,
        screen=screen_view(screen_error, distance, field_of_view, image_height),
        lods=() if lods is None else parse_lods(lods),
        usd_lod=usd_lod,
        metric=metric.value,
        coherence=coherence,
        refit=refit,
        placement=placement.value,
        key_frames=key_frames,
        uv_weight=uv_weight,
        attribute_weights=tuple(parse_attribute_weight(text) for text in attribute_weight or ()),
        weight_primvar=weight_primvar,
        morph_weights=None if morph_weights is None else morph_weights.value,
        lock_borders=lock_borders,
        memory=memory,
        frames=FrameRange.parse(frames) if frames else None,
        poses=poses,
        influences=influences,
        skin_fit=skin_fit,
        prims=tuple(prim or ()),
        device=device,
        bake=bake,
        weld=weld,
        flatten=flatten,
        strict=strict,
    )
    with progress_bar("reading") as progress:
        report = simplify_stage(
            input_file, output, options, progress, lambda name, plan: tell("plan", f"{name}: {plan}")
        )
    _tell_problems(report)
    print_table(_table(report), to_stderr=json == "-")
    if json is not None:
        write_json(json, report.to_dict())
    if report.failed:
        raise typer.Exit(EXIT_FAILED)


def _tell_plan(name: str, plan: MemoryPlan) -> None:
    tell("plan", f"{name}: {plan}")


def _level(prim: PrimReport) -> str:
    """Name of the level of detail, empty where there are none."""
    from warpqem.usd.lods import LevelReport

    return prim.level if isinstance(prim, LevelReport) else ""


def _tell_problems(report: StageReport) -> None:
    for prim in report.prims:
        level = f"{_level(prim)}: " if _level(prim) else ""
        if prim.dropped:
            tell("warning", f"{level}{prim.path}: dropped, does not fit the new mesh: {', '.join(prim.dropped)}")
        if prim.stopped == "no legal collapse":
            tell("warning", f"{level}{prim.path}: stopped at {prim.faces_after} faces, no legal collapse is left")
        if prim.status == "failed":
            tell("error", level + (prim.message or prim.path))
    if report.output is None:
        tell("error", f"nothing written: no mesh of {report.input} could be simplified")


def _table(report: StageReport) -> Table:
    table = Table(title=escape(f"{report.input} -> {report.output or 'nothing written'}"))
    levels = {_level(prim): [other for other in report.prims if _level(other) == _level(prim)] for prim in report.prims}
    if any(levels):
        table.add_column("level")
    table.add_column("mesh", overflow="fold")
    for name in ("frames", "faces before", "faces after", "error %"):
        table.add_column(name, justify="right")
    table.add_column("stopped")
    table.add_column("seconds", justify="right")
    for level, prims in levels.items():
        rows = [_row(prim) for prim in prims]
        if len(prims) > 1:
            rows.append(_total(prims))
        for index, row in enumerate(rows):
            # The total stands apart from its meshes, and each level from the next.
            end_section = index == len(rows) - 1 or (len(prims) > 1 and index == len(prims) - 1)
            table.add_row(*([level] if level else []), *row, end_section=end_section)
    return table


def _total(prims: list[PrimReport]) -> list[str]:
    failed = sum(prim.status == "failed" for prim in prims)
    return [
        f"{len(prims)} meshes",
        "",
        str(sum(prim.faces_before for prim in prims)),
        str(sum(prim.faces_after for prim in prims)),
        "",
        f"{failed} failed" if failed else "",
        f"{sum(prim.seconds for prim in prims):.1f}",
    ]


def _row(prim: PrimReport) -> list[str]:
    error = "" if prim.error is None else f"{prim.error:.4f}"
    stopped = prim.stopped if prim.status == "simplified" else prim.status
    counts = [str(count) if prim.frames else "" for count in (prim.frames, prim.faces_before, prim.faces_after)]
    return [prim.path, *counts, error, stopped or "", f"{prim.seconds:.1f}"]
