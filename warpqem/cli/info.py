"""`warpqem info`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from warpqem.cli.console import print_message, write_json
from warpqem.cli.loading import loading
from warpqem.cli.logs import takes_verbosity
from warpqem.cli.parameters import Input, JsonReport, Variants
from warpqem.cli.tables import PlainTable, print_table

if TYPE_CHECKING:
    from warpqem.usd.read.inspect import MeshInfo

__all__ = ["EXAMPLES", "info"]

# Under its help; tests run them.
EXAMPLES = ("warpqem info talking_head.usdc",)
# Figures that a terminal has no room for are left out from the end of this.
LAST_SHOWN = (
    "frames",
    "blend shapes",
    "joints",
    "triangles",
    "border edges",
    "non-manifold edges",
    "UV sets",
    "subsets",
)


@takes_verbosity
def info(input_file: Input, variant: Variants = None, json: JsonReport = None) -> None:
    """Describe every mesh: frames, vertices, faces, edges, skin, blend shapes, UV sets, subsets, problems.

    Exit codes: 0 done, whatever the meshes are like; 1 the file cannot be read; 2 wrong usage; 130 interrupted.
    """
    with loading():
        from warpqem.files.outputs import named_outputs
        from warpqem.usd.read.inspect import inspect_with_problems

    meshes, problems = inspect_with_problems(input_file, named_outputs({"--json": json}), variant or ())
    print_table(_table(input_file, meshes), to_stderr=json == "-")
    for problem in problems:
        print_message("note", problem)
    for mesh in meshes:
        for problem in mesh.problems:
            print_message("note", problem if problem.startswith(mesh.path) else f"{mesh.path}: {problem}")
    if json is not None:
        write_json(json, {"input": input_file, "meshes": [mesh.to_dict() for mesh in meshes], "problems": problems})


def _table(input_file: str, meshes: list[MeshInfo]) -> PlainTable:
    table = PlainTable(f"{input_file}: {len(meshes)} mesh{'' if len(meshes) == 1 else 'es'}")
    table.add_column("mesh", is_path=True)
    names = ("frames", "vertices", "faces", "triangles", "border edges", "non-manifold edges", "joints", "blend shapes")
    for name in names:
        table.add_column(name, "right", rank=_rank(name))
    table.add_column("UV sets", rank=_rank("UV sets"))
    for name in ("subsets", "problems"):
        table.add_column(name, "right", rank=_rank(name))
    for mesh in meshes:
        counts = (
            mesh.frames,
            mesh.vertices,
            mesh.faces,
            mesh.triangles,
            mesh.border_edges,
            mesh.non_manifold_edges,
            mesh.joints,
            mesh.blend_shapes,
        )
        table.add_row(mesh.path, *counts, " ".join(mesh.uv_sets), len(mesh.subsets), len(mesh.problems))
    return table


def _rank(name: str) -> int:
    return LAST_SHOWN.index(name) + 1 if name in LAST_SHOWN else 0
