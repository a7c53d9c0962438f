"""``python -m benchmarks``: run a benchmark and write its report."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Sequence
from pathlib import Path

from benchmarks import articulated, kernels, peers, scaling, startup, static, stream
from benchmarks.report import Report, write_report
from benchmarks.settings import Settings

COMMANDS: dict[str, Callable[[Settings], Report]] = {
    "peers": peers.run,
    "scaling": scaling.run,
    "static": static.run,
    "kernels": kernels.run,
    "startup": startup.run,
    "stream": stream.run,
    "articulated": articulated.run,
}
TURNS, QUICK_TURNS = 5, 2


def parse(arguments: Sequence[str] | None = None) -> tuple[str, Settings]:
    """The command and its settings."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description="Run a benchmark and write its report.")
    parser.add_argument(
        "command",
        nargs="?",
        choices=COMMANDS,
        default="peers",
        help="peers (default): an animation through warpqem and its peers; scaling: faces and frames; static: one "
        "large frame; kernels: time and floor of each kernel; startup: the command line on a small file; "
        "stream: memory on long clips and a large mesh; articulated: the order of collapses of a skinned mesh by the "
        "error of its skin",
    )
    parser.add_argument("--out", type=Path, default=Path("benchmark_results"), help="folder for the reports")
    parser.add_argument("--quick", action="store_true", help="small meshes, few turns: whether it works, not how fast")
    parser.add_argument("--device", help="Warp device; by default the GPU if there is one")
    parser.add_argument("--turns", type=int, help=f"runs of each contender; {TURNS} by default, {QUICK_TURNS} if quick")
    parser.add_argument("--ratio", type=float, default=0.1, help="part of the faces to keep")
    parser.add_argument("--usd", type=Path, help="peers, articulated: this file instead of a quadruped")
    parser.add_argument("--prim", help="peers, articulated: the mesh in that file; by default the largest")
    given = parser.parse_args(arguments)
    turns = given.turns if given.turns is not None else QUICK_TURNS if given.quick else TURNS
    if turns < 1:
        parser.error(f"--turns must be at least 1, got {turns}")
    if not 0.0 < given.ratio <= 1.0:
        parser.error(f"--ratio must be in (0, 1], got {given.ratio}")
    settings = Settings(given.out, given.quick, given.device, turns, given.ratio, given.usd, given.prim)
    return given.command, settings


def main() -> None:
    """Run one command; print its tables' file."""
    command, settings = parse()
    report = COMMANDS[command](settings)
    report.machine = {**report.machine, "load_after": [round(x, 2) for x in os.getloadavg()]}
    markdown, data = write_report(report, settings.out)
    print(markdown.read_text(encoding="utf-8"))
    print(f"written: {markdown}, {data}")


if __name__ == "__main__":
    main()
