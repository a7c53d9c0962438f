"""``python -m benchmarks``: run a benchmark and write its report."""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.device.parts import PARTS
from benchmarks.report import write_report
from benchmarks.settings import Settings

# Each is a module of that name with a function `run`; loaded when it is asked for, as each needs something else.
COMMANDS = (
    "headline",
    "peers",
    "props",
    "samples",
    "scaling",
    "static",
    "kernels",
    "startup",
    "stream",
    "assemblies",
    "articulated",
    "joints",
    "images",
    "device",
    "registers",
)
TURNS, QUICK_TURNS = 5, 2


def parse(arguments: Sequence[str] | None = None) -> tuple[str, Settings]:
    """The command and its settings."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description="Run a benchmark and write its report.")
    parser.add_argument(
        "command",
        nargs="?",
        choices=COMMANDS,
        default="peers",
        help="headline: the shipped gallop through warpqem and its peers; peers (default): an animation through them; "
        "props: a stage of 1000 small meshes; samples: errors of small meshes by the number of samples; scaling: faces "
        "and frames; static: one large frame; kernels: time and floor of each kernel; startup: the command line on a "
        "small file; stream: memory on long clips and a large mesh; assemblies: meshes of many moving parts; "
        "articulated: the order of collapses of a skinned mesh by the error of its skin; "
        "joints: errors by the number of joints and influences; "
        "images: how much the shipped scenes look like themselves; "
        "device: verify and measure a GPU in six minutes, with NumPy and Warp alone; registers: what each kernel takes "
        "of a GPU's thread, by ptxas",
    )
    parser.add_argument("--out", type=Path, default=Path("benchmark_results"), help="folder for the reports")
    parser.add_argument("--quick", action="store_true", help="small meshes, few turns: whether it works, not how fast")
    parser.add_argument("--device", help="Warp device; by default the GPU if there is one")
    parser.add_argument("--turns", type=int, help=f"runs of each contender; {TURNS} by default, {QUICK_TURNS} if quick")
    parser.add_argument("--ratio", type=float, default=0.1, help="part of the faces to keep")
    parser.add_argument("--usd", type=Path, help="peers, articulated, joints, images: this file instead")
    parser.add_argument(
        "--prim", help="peers, articulated, joints, images: the mesh in that file; by default the largest"
    )
    parser.add_argument(
        "--data",
        type=Path,
        help="device: folder that --pack has filled; or .npz files, with points (F, V, 3) and faces (N, 3)",
    )
    parser.add_argument("--pack", type=Path, help="device: put the shipped scenes and what a CPU makes of them here")
    parser.add_argument("--part", action="append", choices=[part.name for part in PARTS], help="device: this part only")
    given = parser.parse_args(arguments)
    turns = given.turns if given.turns is not None else QUICK_TURNS if given.quick else TURNS
    if turns < 1:
        parser.error(f"--turns must be at least 1, got {turns}")
    if not 0.0 < given.ratio <= 1.0:
        parser.error(f"--ratio must be in (0, 1], got {given.ratio}")
    own = (given.data, given.pack, tuple(given.part or ()))
    settings = Settings(given.out, given.quick, given.device, turns, given.ratio, given.usd, given.prim, *own)
    return given.command, settings


def main() -> int:
    """Run one command; print its tables' file. The exit code: 1 where something did not hold."""
    command, settings = parse()
    report = importlib.import_module(f"benchmarks.{command}").run(settings)
    report.machine = {**report.machine, "load_after": [round(x, 2) for x in os.getloadavg()]}
    markdown, data = write_report(report, settings.out)
    print(markdown.read_text(encoding="utf-8"))
    print(f"written: {markdown}, {data}")
    return int(bool(report.failed))


if __name__ == "__main__":
    sys.exit(main())
