"""Run fuzz cases in a process that may crash, hang or run out of memory; each such case is a find with its seed.

python -m tests.long.fuzz arrays --cases 1000000 --seconds 9000 --start 0
python -m tests.long.fuzz bytes --only 1234
(ulimit -v 6000000; python -m tests.long.fuzz progressive --cases 10000)
"""

from __future__ import annotations

import argparse
import collections
import os
import select
import subprocess
import sys
import time
import traceback

# A case takes some milliseconds; the first of a process loads kernels.
CASE_SECONDS, FIRST_SECONDS = 10.0, 120.0
MEMORY_BYTES = 4 * 2**30


def child(kind: str, start: int) -> None:
    """Run cases from a seed on, telling on stdout what begins and how it ends."""
    import resource

    import warp as wp

    out = os.fdopen(os.dup(1), "w")
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 1)
    os.dup2(nothing, 2)
    wp.config.log_level = wp.LOG_ERROR
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_BYTES, MEMORY_BYTES))
    from tests.support.fuzz_cases import CASES
    from warpqem.runtime.load_timeout import report_loading

    report_loading(lambda file, begins: None)
    for seed in range(start, 2**62):
        out.write(f"begin {seed}\n")
        out.flush()
        try:
            how = CASES[kind](seed)
        except Exception as error:
            place = traceback.extract_tb(error.__traceback__)[-1]
            text = " ".join(str(error).split())[:300]
            how = f"FIND {type(error).__name__}: {text} ({os.path.basename(place.filename)}:{place.lineno})"
        out.write(f"end {how}\n")
        out.flush()


def survives_in_program(seed: int) -> bool:
    """Whether a file that ends the process that reads it ends in an error of the command line, which has two."""
    command = [sys.executable, "-m", "tests.long.fuzz", "program", "--only", str(seed)]
    return subprocess.run(command, capture_output=True).returncode == 0


def run(kind: str, start: int, seconds: float, wanted: int) -> int:
    """Run so many cases, within some time; prints each find as it comes, then the counts. Returns how many finds."""
    begun = time.monotonic()
    seed, cases = start, 0
    ends: collections.Counter[str] = collections.Counter()
    finds: dict[str, list[int]] = {}

    def found(how: str, seed: int) -> None:
        finds.setdefault(how, []).append(seed)
        print(f"{kind} {seed}: {how}", flush=True)

    while time.monotonic() - begun < seconds and cases < wanted:
        command = [sys.executable, "-m", "tests.long.fuzz", kind, "--child", "--start", str(seed)]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stdin=subprocess.DEVNULL)
        assert process.stdout is not None
        buffer, limit = b"", FIRST_SECONDS
        running = None
        while time.monotonic() - begun < seconds and cases < wanted:
            ready, _, _ = select.select([process.stdout], [], [], limit)
            data = os.read(process.stdout.fileno(), 65536) if ready else b""
            if not data:
                process.kill()
                code = process.wait()
                cases += running is not None
                if kind == "bytes" and ready and survives_in_program(seed):
                    ends[f"ended with {code}, named by the program"] += 1
                else:
                    found(f"FIND hang over {limit:g} s" if not ready else f"FIND ended with {code}", seed)
                seed += 1
                break
            buffer += data
            *lines, buffer = buffer.split(b"\n")
            for line in lines:
                word, _, rest = line.decode().partition(" ")
                if word == "begin":
                    running = seed = int(rest)
                    continue
                cases, limit, running, seed = cases + 1, CASE_SECONDS, None, seed + 1
                if rest.startswith("FIND"):
                    found(rest, seed - 1)
                else:
                    ends[rest] += 1
        process.kill()
        process.wait()
    print(f"{kind}: {cases} cases in {time.monotonic() - begun:.0f} s, seeds from {start} to {seed}")
    print("ended:", dict(ends.most_common()))
    for how, seeds in finds.items():
        print(f"{how}: {len(seeds)} times, seeds {seeds[:5]}")
    return len(finds)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("kind", choices=["arrays", "values", "bytes", "program", "progressive"])
    parser.add_argument("--seconds", type=float, default=300.0)
    parser.add_argument("--cases", type=int, default=10**9)
    parser.add_argument("--start", type=int, default=0)
    parser.add_argument("--only", type=int, help="run one case in this process, with its traceback")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.child:
        child(given.kind, given.start)
    elif given.only is not None:
        from tests.support.fuzz_cases import CASES

        print(CASES[given.kind](given.only))
    else:
        sys.exit(1 if run(given.kind, given.start, given.seconds, given.cases) else 0)


if __name__ == "__main__":
    main()
