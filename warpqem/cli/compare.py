"""`warpqem compare`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from warpqem.arguments.limits import ABOVE_0, COUNT
from warpqem.cli.appearance_table import appearance_table
from warpqem.cli.console import EXIT_FAILED, print_message, write_json
from warpqem.cli.image_table import image_table
from warpqem.cli.loading import loading
from warpqem.cli.logs import takes_verbosity
from warpqem.cli.number_parameters import number, whole
from warpqem.cli.parameters import Device, Frames, JsonReport, Prims, ReportPage, Variants
from warpqem.cli.progress_bar import progress_bar
from warpqem.cli.tables import PlainTable, error_text, print_table, shortened_path, upper_text

if TYPE_CHECKING:
    from warpqem.usd.commands.compare import PairReport
    from warpqem.usd.commands.compare_images import ImageReport

__all__ = ["EXAMPLES", "compare"]

# Under its help; tests run them.
EXAMPLES = (
    "warpqem compare cape_wind.usdc cape.usda --heatmap heat.usdc --report compare.html",
    "warpqem compare cape_wind.usdc cape.usda --images --image-sheet pictures.png",
)
# Meshes that are not good of which the table says why, and characters of their paths.
MAX_WORST, NOTE_WIDTH = 8, 40
# Figures that a terminal has no room for are left out from the end of this.
LAST_SHOWN = ("normals deg", "frames", "mean %", "jitter %", "slide %", "slide 95 %", "edge length %")


@takes_verbosity
def compare(
    reference: Annotated[str, typer.Argument(metavar="REFERENCE", help="USD file with the original meshes.")],
    test: Annotated[
        str, typer.Argument(metavar="TEST", help="USD file that shows simplified meshes at the same paths.")
    ],
    samples: Annotated[
        int | None,
        typer.Option(
            metavar="COUNT",
            parser=whole(COUNT),
            help="Number of sample points on each mesh in each frame; by default as many as suit the number of frames, "
            "which are those of simplify.",
        ),
    ] = None,
    frames: Frames = None,
    prim: Prims = None,
    variant: Variants = None,
    all_lods: Annotated[
        bool,
        typer.Option("--all-lods", help="Measure every level of detail of TEST below the original, one after another."),
    ] = False,
    heatmap: Annotated[
        str | None,
        typer.Option(
            metavar="OUT",
            rich_help_panel="Output",
            help="Write a layer over TEST that colours each vertex by its distance to REFERENCE in each frame "
            "(primvars:displayColor); switch materials off to see it.",
        ),
    ] = None,
    images: Annotated[
        bool,
        typer.Option(
            "--images",
            help="Draw both files and compare the pictures: PSNR, SSIM and overlap of silhouettes, gray by the shading "
            "normals and with colours and textures.",
        ),
    ] = False,
    image_sheet: Annotated[
        str | None,
        typer.Option(
            metavar="PNG",
            rich_help_panel="Output",
            help="Write the pictures that --images compares, and their difference, to one .png file.",
        ),
    ] = None,
    scale: Annotated[
        float | None,
        typer.Option(
            metavar="PCT",
            parser=number(ABOVE_0, "PCT"),
            help="Distance of the heat map's last colour, in % of the bounding-box diagonal; by default the Hausdorff "
            "distance",
        ),
    ] = None,
    device: Device = None,
    report: ReportPage = None,
    json: JsonReport = None,
) -> None:
    """Measure the meshes that TEST shows against those that REFERENCE shows at the same prim path, at the frames of
    both. What instances share is measured once.

    Distances are in % of the reference's bounding-box diagonal in the frame, angles in degrees. RMS is the root mean
    square distance, of the two directions the larger, as a mean over the frames; Hausdorff the largest distance of any
    point in any frame; flips are faces that oppose the reference face nearest to them, a frame. Jitter and slide
    are second differences over time: how unsteady the surface is, and how much vertices move over the material that
    they are bound to; 95 % of the vertices slide no more than "slide 95 %". The verdict is good, look or poor,
    by the limits in docs/glossary.md. simplify gives the same figures under the same names.

    A second table compares what both meshes have of texture coordinates, shading normals and colours. With --images
    a third one compares pictures of both files, in 3 frames from 4 sides.

    Exit codes: 0 all done; 1 an error, or some pair failed; 2 wrong usage; 130 interrupted.
    """
    with progress_bar("loading") as progress:
        with loading():
            from warpqem.files.outputs import named_outputs
            from warpqem.usd import CompareOptions, FrameRange, compare_stages
            from warpqem.usd.commands.compare_images import check_sheet_path, compare_stage_images

        if report is not None:
            from warpqem.report.page import check_page_path

            check_page_path(report)
        if image_sheet is not None:
            check_sheet_path(image_sheet)
        options = CompareOptions(
            samples=samples,
            frames=FrameRange.parse(frames) if frames else None,
            prims=tuple(prim or ()),
            device=device,
            heatmap=heatmap,
            heatmap_scale=scale,
            variants=tuple(variant or ()),
            all_lods=all_lods,
        )
        progress(0.0, "reading")
        others = named_outputs({"--report": report, "--json": json})
        images = images or image_sheet is not None
        sheets = named_outputs({"--image-sheet": image_sheet})
        pairs = compare_stages(reference, test, options, progress, [*others, *sheets])
        scores = None
        if images:
            heatmaps = named_outputs({"--heatmap": heatmap})
            scores = compare_stage_images(
                reference, test, options, progress, sheet=image_sheet, other_outputs=[*others, *heatmaps]
            )
        if report is not None and any(pair.comparison for pair in pairs):
            from warpqem.usd.commands.report_page import write_compare_report

            write_compare_report(report, reference, test, pairs, options, progress)
    _show(reference, test, pairs, scores, json)
    if not pairs or any(found.message is not None for found in (*pairs, *(scores or ()))):
        raise typer.Exit(EXIT_FAILED)


def _show(
    reference: str, test: str, pairs: list[PairReport], scores: list[ImageReport] | None, json: str | None
) -> None:
    """Print and write what was found."""
    for found in (*pairs, *(scores or ())):
        if found.message is not None:
            print_message("error", found.message)
    for note in dict.fromkeys(note for pair in pairs for note in pair.notes):
        print_message("note", note)
    print_table(_table(reference, test, pairs), to_stderr=json == "-")
    if any(pair.appearance for pair in pairs):
        print_table(appearance_table(pairs), to_stderr=json == "-")
    if scores is not None:
        print_table(image_table(scores), to_stderr=json == "-")
    if json is not None:
        written = {"reference": reference, "test": test, "prims": [pair.to_dict() for pair in pairs]}
        if scores is not None:
            written["images"] = [score.to_dict() for score in scores]
        write_json(json, written)
    if not pairs:
        print_message("error", f"neither {reference} nor {test} has a mesh")


def _table(reference: str, test: str, pairs: list[PairReport]) -> PlainTable:
    table = PlainTable(f"{reference} - {test}")
    levels = any(pair.level for pair in pairs)
    if levels:
        table.add_column("level")
    table.add_column("mesh", is_path=True)
    names = ("frames", "faces", "RMS %", "mean %", "Hausdorff %", "normals deg", "flips", "jitter %", "slide %")
    for name in (*names, "slide 95 %", "edge length %"):
        table.add_column(name, "right", rank=LAST_SHOWN.index(name) + 1 if name in LAST_SHOWN else 0)
    table.add_column("verdict")
    wanting: list[str] = []
    for pair in sorted(pairs, key=_badness):
        measures = pair.comparison
        cells = [pair.level or "", pair.path] if levels else [pair.path]
        if measures is None:
            table.add_row(*cells, "no faces" if pair.message is None else "failed")
            continue
        distances = (error_text(measures.rms), error_text(measures.mean), upper_text(measures.hausdorff))
        values = (
            measures.normal_deviation,
            measures.flips,
            measures.jitter,
            measures.slide,
            measures.slide_p95,
            measures.edge_length_error,
        )
        faces = f"{measures.reference_topology.faces:,} / {measures.test_topology.faces:,}"
        verdict = measures.verdict
        table.add_row(*cells, measures.frame_count, faces, *distances, *map(error_text, values), verdict.word)
        if verdict.reason:
            wanting.append(f"{verdict.word}: {shortened_path(pair.path, NOTE_WIDTH)}: {verdict.reason}")
    for text in wanting[:MAX_WORST]:
        table.add_note(text)
    if len(wanting) > MAX_WORST:
        table.add_note(f"and {len(wanting) - MAX_WORST} more that are not good")
    return table


def _badness(pair: PairReport) -> tuple[int, tuple[int, float]]:
    """What pairs are sorted by: those that failed first, then the worst, and at last those without faces."""
    from warpqem.measure.verdict import rank

    if pair.comparison is None:
        return 2 if pair.message is None else 0, (0, 0.0)
    return 1, rank(pair.comparison.verdict.word, pair.comparison.hausdorff)
