"""One contender in a process of its own: it waits for its turn, so that none warms or starves another.

Run by :mod:`benchmarks.turns` as ``python -m benchmarks.worker WORK.npz RESULT.npz CONTENDER [DEVICE]``. Each line on
stdin is a command, ``run`` or ``save``; each is answered by one line of JSON on stdout.
"""

from __future__ import annotations

import gc
import json
import os
import resource
import sys
import time
from pathlib import Path

from benchmarks.contenders import CONTENDERS
from benchmarks.simplified import save_simplified
from benchmarks.work import load_work, torus_work

__all__ = ["main"]

# Faces and frames of the run before the first that counts: it loads libraries and compiles kernels.
WARM_UP = (2000, 4)
# ru_maxrss counts in KiB on Linux, in bytes on macOS.
RSS_UNIT = 1 if sys.platform == "darwin" else 1024


def _peak_memory() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * RSS_UNIT


def main() -> None:
    """Serve the commands on stdin until it ends."""
    work_path, result_path, name, *device = sys.argv[1:]
    # Libraries print where they like; the answers have stdout for themselves.
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)

    def answer(**values: float) -> None:
        print(json.dumps(values), file=answers, flush=True)

    chosen_device = device[0] if device else None
    run = CONTENDERS[name].run
    run(torus_work(*WARM_UP, ratio=0.5), chosen_device)
    work = load_work(Path(work_path))
    before = _peak_memory()
    answer(ready=1)
    for command in sys.stdin:
        if command.strip() == "run":
            result = None
            gc.collect()
            cpu, wall = time.process_time(), time.perf_counter()
            result = run(work, chosen_device)
            answer(
                seconds=time.perf_counter() - wall,
                cpu_seconds=time.process_time() - cpu,
                peak_bytes=_peak_memory() - before,
            )
        else:
            save_simplified(result, Path(result_path))
            answer(saved=1)


if __name__ == "__main__":
    main()
