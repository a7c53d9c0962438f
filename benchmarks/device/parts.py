"""The parts of the command, in the order they run in, and how long each may take."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["NO_GPU", "PARTS", "Part"]

# Exit code of a part where no device is asked for and there is no GPU: nobody wants six minutes of a CPU.
NO_GPU = 78


@dataclass(frozen=True)
class Part:
    """One process.

    Attributes:
        name: on the command line.
        seconds: that it may take, more with ``--quick``. Time that the parts before it have left over is its own, too.
        function: ``module:name`` in this package; it gets :class:`benchmarks.device.findings.Findings`.
        what: it does, in words.
    """

    name: str
    seconds: float
    function: str
    what: str


# Together 350 seconds: ten are left for starting and ending ten processes.
PARTS = (
    Part("probe", 25, "probe:run", "what the driver, Warp's graphs and the memory pool can do"),
    Part("modules", 60, "modules:run", "all kernels compiled or found, and loaded"),
    Part("bits", 35, "checks:same_bits", "three runs give the same bits"),
    Part("quality", 40, "checks:quality", "RMS distance beside the CPU's"),
    Part("scenes", 25, "timings:scenes", "times of the scenes"),
    Part("million", 60, "timings:million", "one million faces, 48 frames"),
    Part("static", 30, "timings:static", "1.3 million faces, one frame"),
    Part("refit", 20, "timings:refit", "--quality best"),
    Part("floors", 30, "floors:run", "every kernel beside its floor"),
    Part("sanitizer", 25, "sanitizer:run", "compute-sanitizer on a small mesh"),
)
