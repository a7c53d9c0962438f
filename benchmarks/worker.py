"""One contender in a process of its own: it waits for its turn, so that none warms or starves another.

Run by :mod:`benchmarks.turns` as ``python -m benchmarks.worker WORK.npz RESULT.npz CONTENDER [DEVICE]``. Each line on
stdin is a command, ``run`` or ``save``; each is answered by one line of JSON on stdout.
"""

from __future__ import annotations

import gc
import json
import os
import sys
import time
from pathlib import Path

from benchmarks.contenders import CONTENDERS
from benchmarks.simplified import save_simplified
from benchmarks.work import load_work, torus_work

__all__ = ["main"]

# Faces and frames of the run before the first that counts: it loads libraries and compiles kernels.
WARM_UP = (2000, 4)
STATUS, RESET = Path("/proc/self/status"), Path("/proc/self/clear_refs")


def _memory(field: str) -> int:
    """``VmRSS``, what the process holds, or ``VmHWM``, the most since the last reset, in bytes; 0 outside Linux."""
    lines = STATUS.read_text(encoding="utf-8").splitlines() if STATUS.exists() else []
    return next((int(line.split()[1]) * 1024 for line in lines if line.startswith(f"{field}:")), 0)


def _reset_peak() -> int:
    """Start the high-water mark anew; bytes held now."""
    if RESET.exists():
        RESET.write_text("5", encoding="utf-8")
    return _memory("VmRSS")


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
    answer(ready=1)
    result = None
    for command in sys.stdin:
        if command.strip() == "run":
            result = None
            gc.collect()
            held = _reset_peak()
            cpu, wall = time.process_time(), time.perf_counter()
            result = run(work, chosen_device)
            answer(
                seconds=time.perf_counter() - wall,
                cpu_seconds=time.process_time() - cpu,
                peak_bytes=_memory("VmHWM") - held,
            )
        elif result is not None:
            save_simplified(result, Path(result_path))
            answer(saved=1)


if __name__ == "__main__":
    main()
