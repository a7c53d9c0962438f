"""`warpqem features`."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import typer

from warpqem.cli.console import EXIT_FAILED, print_message, write_json
from warpqem.cli.loading import loading
from warpqem.cli.logs import takes_verbosity
from warpqem.cli.option_parameters import takes_options
from warpqem.cli.parameters import Input, JsonReport, Output
from warpqem.cli.progress_bar import progress_bar
from warpqem.cli.tables import PlainTable, print_table
from warpqem.usd.commands.simplify_options import SimplifyOptions

__all__ = ["EXAMPLES", "features"]

# Under its help; tests run them.
EXAMPLES = ("warpqem features quadruped_gallop.usdc -o joints.usda",)


@takes_verbosity
@takes_options(SimplifyOptions, only=("frames", "feature_threshold", "feature_floor", "prim", "device"))
def features(
    input_file: Input,
    output: Output,
    options: dict[str, Any],
    json: JsonReport = None,
) -> None:
    """Colour the motion features, the parts that bend while a mesh moves: one colour for each, grey for the rest.

    After Yang et al. 2019: edges that bend more than the mean hang together in features, see --metric aqem of
    `warpqem simplify`.

    OUT is a layer over IN with primvars:displayColor on each mesh; switch materials off to see it.

    Exit codes: 0 all done; 1 an error, or some mesh failed; 2 wrong usage; 130 interrupted.
    """
    with progress_bar("loading") as progress:
        with loading():
            from warpqem.files.outputs import named_outputs
            from warpqem.usd import color_features
            from warpqem.usd.commands.option_values import read_options

        # Nothing is simplified.
        asked = read_options({**options, "ratio": 1.0})
        progress(0.0, "reading")
        reports = color_features(
            input_file,
            output,
            prims=asked.prims,
            frames=asked.frames,
            weighting=asked.motion,
            device=asked.device,
            progress=progress,
            other_outputs=named_outputs({"--json": json}),
        )
    table = PlainTable(f"{input_file} -> {output}")
    table.add_column("mesh", is_path=True)
    for name in ("frames", "features", "vertices in features", "vertices"):
        table.add_column(name, "right")
    for report in reports:
        if report.message is not None:
            print_message("error", report.message)
        counts = (report.frames, report.features, report.feature_vertices, report.vertices)
        table.add_row(report.path, *(["failed"] if report.message else counts))
    print_table(table, to_stderr=json == "-")
    if json is not None:
        write_json(json, {"input": input_file, "output": output, "prims": [asdict(report) for report in reports]})
    if any(report.message is not None for report in reports):
        raise typer.Exit(EXIT_FAILED)
