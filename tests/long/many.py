"""A batch of many generated assets, some of them bad in every way that the generators know.

python -m tests.long.many --assets 1000

Prints how many were done, what each kind of bad asset ended with, CPU seconds against the same assets one after another
in one process, and the most memory of each tenth of the run.
"""

from __future__ import annotations

import argparse
import collections
import os
import resource
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import warp as wp
from pxr import Usd, UsdGeom, Vt

import warpqem
from tests.support.usd_stages import cloth_stage, define_cloth, skinned_stage
from warpqem.batching.local_engine import LocalEngine
from warpqem.batching.perform_job import perform, warm_up
from warpqem.usd import SimplifyOptions

SUFFIXES = ("usda", "usdc", "usd")


def cloth(path: Path, number: int) -> None:
    cloth_stage(path, size=12 + number % 30, times=[float(t) for t in range(1, 2 + number % 12)])


def still(path: Path, number: int) -> None:
    cloth_stage(path, size=16 + number % 40, times=None, triangles=True)


def skinned(path: Path, number: int) -> None:
    skinned_stage(path)


def many_meshes(path: Path, number: int) -> None:
    stage = cloth_stage(path)
    for index in range(5):
        define_cloth(stage, f"/Root/Part{index}", size=10, times=[1.0, 2.0])
    stage.Save()


def referenced(path: Path, number: int) -> None:
    cloth_stage(path.with_name(f".{path.stem}_geo.usdc"), size=20)
    stage = Usd.Stage.CreateNew(str(path))
    stage.DefinePrim("/Root").GetReferences().AddReference(f"./.{path.stem}_geo.usdc", "/Root")
    stage.Save()


GOOD = (cloth, still, skinned, many_meshes, referenced)


def changed(path: Path, change: Callable[[UsdGeom.Mesh], object]) -> None:
    stage = cloth_stage(path)
    change(UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth")))
    stage.Save()


def points(path: Path, value: float) -> None:
    def change(mesh: UsdGeom.Mesh) -> None:
        array = np.array(mesh.GetPointsAttr().Get(2.0))
        array[7, 1] = value
        mesh.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(array), 2.0)

    changed(path, change)


def circle(path: Path) -> None:
    path.write_text(f'#usda 1.0\ndef "A" (references = @./{path.name}@</A>)\n{{\n}}\n')


BAD: dict[str, Callable[[Path], object]] = {
    "empty file": lambda path: path.write_bytes(b""),
    "garbage": lambda path: path.write_bytes(os.urandom(5000)),
    "half a crate": lambda path: (cloth_stage(path), path.write_bytes(path.read_bytes()[:900])),
    "nested deeply": lambda path: path.write_text("#usda 1.0\n" + 'def "a" {\n' * 200_000),
    "circle": circle,
    "no mesh": lambda path: Usd.Stage.CreateNew(str(path)).Save(),
    "point that is no number": lambda path: points(path, np.nan),
    "infinite point": lambda path: points(path, np.inf),
    "index out of range": lambda path: changed(
        path, lambda mesh: mesh.GetFaceVertexIndicesAttr().Set([0, 1, 999, 2] * 64)
    ),
    "negative index": lambda path: changed(path, lambda mesh: mesh.GetFaceVertexIndicesAttr().Set([0, 1, -1, 2] * 64)),
    "counts that do not fit": lambda path: changed(path, lambda mesh: mesh.GetFaceVertexCountsAttr().Set([4] * 63)),
    "negative count": lambda path: changed(path, lambda mesh: mesh.GetFaceVertexCountsAttr().Set([-4, 260])),
    "topology that varies": lambda path: changed(
        path, lambda mesh: mesh.GetFaceVertexCountsAttr().Set([4] * 63 + [3], 2.0)
    ),
    "no points": lambda path: changed(path, lambda mesh: mesh.GetPointsAttr().Clear()),
    "blocked points": lambda path: changed(path, lambda mesh: mesh.GetPointsAttr().Block()),
    "points of another number": lambda path: changed(path, lambda mesh: mesh.GetPointsAttr().Set([(0, 0, 0)] * 3, 2.0)),
}


def make(folder: Path, count: int) -> tuple[list[Path], dict[Path, str]]:
    paths, bad = [], {}
    for number in range(count):
        path = folder / f"{number % 10}" / f"asset{number}.{SUFFIXES[number % 3]}"
        path.parent.mkdir(parents=True, exist_ok=True)
        paths.append(path)
        if number % 20 == 10:
            kind = list(BAD)[number // 20 % len(BAD)]
            path = paths[-1] = path.with_suffix(".usdc" if kind == "half a crate" else ".usda")
            bad[path] = kind
            BAD[kind](path)
        else:
            GOOD[number % len(GOOD)](path, number)
    return paths, bad


def cpu_seconds(who: int) -> float:
    usage = resource.getrusage(who)
    return usage.ru_utime + usage.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--assets", type=int, default=1000)
    parser.add_argument("--singles", type=int, default=1000, help="so many of the assets are also done one by one")
    given = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="many-"))
    paths, bad = make(folder / "in", given.assets)
    options = SimplifyOptions(ratio=0.3, device="cpu")
    wp.config.log_level = wp.LOG_WARNING

    def jobs(output: str) -> list[warpqem.BatchJob]:
        return [
            warpqem.BatchJob(str(path), str(folder / output / path.parent.name / path.name), options) for path in paths
        ]

    begun, before = time.monotonic(), cpu_seconds(resource.RUSAGE_CHILDREN)
    results = list(warpqem.batch(jobs("out"), LocalEngine(timeout=60.0), journal=folder / "journal"))
    wall, cpu = time.monotonic() - begun, cpu_seconds(resource.RUSAGE_CHILDREN) - before
    print(f"{len(results)} results in {wall:.1f} s, {cpu:.1f} CPU s of workers, of them start-up and all")
    print("states:", dict(collections.Counter(result.status for result in results)))
    wrong = [r for r in results if (r.status == "done") == (Path(r.input) in bad)]
    for result in wrong:
        print("WRONG:", result.status, bad.get(Path(result.input)), result.message)
    for kind in BAD:
        said = [f"{r.error}: {r.message}" for r in results if bad.get(Path(r.input)) == kind]
        print(f"  {kind}: {len(said)}; {said[0][:200] if said else ''}")
    size = max(1, len(results) // 10)
    peaks = [
        max(r.peak_memory or 0 for r in results[i : i + size]) >> 20
        for i in range(0, size * (len(results) // size), size)
    ]
    print("most memory of a worker by tenths, MB:", peaks)

    os.environ["WARPQEM_THREADS"] = "1"
    warm_up("cpu")
    step = max(1, len(paths) // given.singles)
    chosen = jobs("single")[::step]
    before = cpu_seconds(resource.RUSAGE_SELF)
    for job in chosen:
        perform(job)
    single = cpu_seconds(resource.RUSAGE_SELF) - before
    again = {result.input: result for result in results}
    inside = sum(again[job.input].seconds for job in chosen)
    print(f"{len(chosen)} of them one by one: {single:.1f} CPU s; in the batch they took {inside:.1f} s of two workers")
    print(f"CPU of the batch / CPU one by one: {cpu / (single * len(paths) / len(chosen)):.3f}")
    same = sum(
        Path(job.output).read_bytes() == (folder / "out" / Path(job.output).relative_to(folder / "single")).read_bytes()
        for job in chosen
        if Path(job.output).exists()
    )
    print(f"{same} outputs have the same bytes both ways")
    shutil.rmtree(folder)


if __name__ == "__main__":
    main()
