"""``device``: verify and measure a GPU in at most six minutes, with NumPy and Warp alone.

Each part is a process of its own (:mod:`benchmarks.device.child`) with a time limit, so that one that hangs, crashes or
fails costs the others nothing. What a part finds it prints at once.
"""

from benchmarks.device.runner import run

__all__ = ["run"]
