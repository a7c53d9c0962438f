"""Random hostile cases: arrays, values on a stage, bytes of files, and progressive files, each from a seed.

A case ends with a result that is sound, or with a named error. Anything else is a find.
"""

from __future__ import annotations

import contextlib
import functools
import random
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from pxr import Sdf, Tf, Usd, UsdGeom, UsdUtils

from tests.support.fuzz_arrays import EDGES, INDEX_EDGES, UnsoundError, array_case
from tests.support.progressive_cases import progressive_case
from tests.support.rich_stage import rich_stage
from tests.support.usd_stages import cloth_stage, define_cloth, skinned_stage
from warpqem.errors import WarpqemError
from warpqem.usd import SimplifyOptions, inspect_stage, simplify_stage
from warpqem.usd.read.open_stage import open_stage

# Values on a stage.


@functools.cache
def _stages() -> Path:
    """A folder of stages to start from, made once for each process."""
    folder = Path(tempfile.mkdtemp(prefix="fuzz-"))
    rich_stage(folder / "rich.usda")
    skinned_stage(folder / "skinned.usda")
    stage = cloth_stage(folder / "cloth.usda", size=4)
    define_cloth(stage, "/Root/Still", size=3)
    stage.Save()
    for name in ("rich", "skinned", "cloth"):
        layer = Sdf.Layer.FindOrOpen(str(folder / f"{name}.usda"))
        layer.Export(str(folder / f"{name}.usdc"))
    UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(folder / "cloth.usdc")), str(folder / "cloth.usdz"))
    return folder


def remove_stages() -> None:
    """Remove what `_stages` made."""
    if _stages.cache_info().currsize:
        shutil.rmtree(_stages(), ignore_errors=True)
        _stages.cache_clear()


def value_case(seed: int) -> str:
    """Change values of attributes on a stage, then simplify it; returns how it ended."""
    draw = random.Random(seed)
    source = _stages() / draw.choice(["rich.usda", "skinned.usda", "skinned.usda"])
    path = _stages() / "case.usdc"
    Sdf.Layer.OpenAsAnonymous(str(source)).Export(str(path))
    stage = Usd.Stage.Open(str(path))
    attributes = [a for prim in stage.Traverse() for a in prim.GetAttributes() if a.HasAuthoredValue()]
    changed = []
    for _ in range(draw.choice([1, 1, 2])):
        attribute = draw.choice(attributes)
        changed.append(f"{attribute.GetPath()}: {_change_value(draw, attribute)}")
    stage.Save()
    del stage, attributes
    try:
        return _simplify_file(draw, path, ".usda")
    except UnsoundError as error:
        raise UnsoundError(f"{error} after {changed}") from error


def _change_value(draw: random.Random, attribute: Usd.Attribute) -> str:
    times = [Usd.TimeCode(time) for time in attribute.GetTimeSamples()] or [Usd.TimeCode.Default()]
    time = draw.choice(times)
    value = attribute.Get(time)
    kind = draw.choice(["empty", "short", "long", "edge", "edges", "clear", "block", "time"])
    try:
        if kind == "clear":
            attribute.Clear()
        elif kind == "block":
            attribute.Block()
        elif kind == "time":
            attribute.Set(value, draw.choice([1e300, -1e300, 1e-300, 2.5, float("inf"), float("nan")]))
        elif not hasattr(type(value), "FromNumpy"):
            kind = "a number"
            attribute.Set(type(value)(draw.choice([0, -1, 7])), time)
        else:
            array = np.array(value)
            if kind == "empty":
                array = array[:0]
            elif kind == "short":
                array = array[: draw.randrange(len(array) + 1)]
            elif kind == "long":
                array = np.concatenate([array, array])
            elif array.size:
                edges = EDGES if array.dtype.kind == "f" else INDEX_EDGES
                with np.errstate(over="ignore"):
                    new = np.array([draw.choice(edges) for _ in range(array.size)]).astype(array.dtype)
                    keep = np.random.default_rng(draw.randrange(2**32)).random(array.size) < (kind == "edge") * 0.98
                array = np.where(keep.reshape(array.shape), array, new.reshape(array.shape)).astype(array.dtype)
            attribute.Set(type(value).FromNumpy(np.ascontiguousarray(array)), time)
    except (TypeError, OverflowError, ValueError, Tf.ErrorException) as error:
        return f"{kind} refused ({type(error).__name__})"
    return f"{kind} at {time}"


# Bytes of files.


def byte_case(seed: int) -> str:
    """Change bytes of a text, crate or package file, then simplify it; returns how it ended."""
    draw = random.Random(seed)
    return _simplify_file(draw, _damaged_file(draw), ".usdc")


def byte_case_by_program(seed: int) -> str:
    """The same file through the command line, for what USD does not survive."""
    path = _damaged_file(random.Random(seed))
    output = path.with_name("out.usdc")
    command = [sys.executable, "-m", "warpqem", "simplify", str(path), "--ratio", "0.4", "-o", str(output)]
    process = subprocess.run(command, capture_output=True, text=True, errors="replace", timeout=60)
    lines = [line for line in process.stderr.splitlines() if line.startswith("error: ")]
    if process.returncode != 1 or not lines or str(path) not in lines[-1] or output.exists():
        raise UnsoundError(f"ended with {process.returncode}: {process.stderr[-300:]}")
    return "named by the program"


def _damaged_file(draw: random.Random) -> Path:
    source = _stages() / draw.choice(
        [
            "rich.usda",
            "skinned.usda",
            "cloth.usda",
            "rich.usdc",
            "skinned.usdc",
            "cloth.usdc",
            "cloth.usdc",
            "cloth.usdz",
        ]
    )
    data = bytearray(source.read_bytes())
    for _ in range(draw.choice([1, 1, 1, 2, 4, 16])):
        data = _change_text(draw, data) if source.suffix == ".usda" else _change_binary(draw, data)
    path = _stages() / f"case{source.suffix}"
    path.write_bytes(data)
    return path


def _change_text(draw: random.Random, data: bytearray) -> bytearray:
    text = data.decode("utf-8", "replace")
    kind = draw.randrange(6)
    one, other = (_token_near(draw, text, _NUMBER if kind in (1, 2) else _TOKEN) for _ in range(2))
    if kind == 0 or one is None or other is None:
        return _change_binary(draw, data)
    if kind in (1, 2):
        new = draw.choice(["nan", "inf", "-inf", "1e39", "1e-46", "-1", "0", str(2**31), str(2**63), "9" * 30, "1.5"])
    elif kind == 3:
        new = other[0]
    elif kind == 4:
        new = ""
    else:
        new = one[0] * draw.choice([2, 3, 50])
    return bytearray((text[: one.start()] + new + text[one.end() :]).encode())


_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")
_TOKEN = re.compile(rf"{_NUMBER.pattern}|\w+|[^\w\s]")


def _token_near(draw: random.Random, text: str, kind: re.Pattern[str]) -> re.Match[str] | None:
    return kind.search(text, draw.randrange(max(1, len(text))))


def _change_binary(draw: random.Random, data: bytearray) -> bytearray:
    if not data:
        return data
    place, length = draw.randrange(len(data)), draw.choice([1, 1, 2, 4, 8, 64])
    # The tables of a crate are at its end, and its header at the beginning.
    if draw.random() < 0.4:
        place = draw.choice([draw.randrange(min(96, len(data))), len(data) - 1 - draw.randrange(min(700, len(data)))])
    kind = draw.randrange(6)
    if kind == 0:
        data[place] ^= 1 << draw.randrange(8)
    elif kind == 1:
        data[place : place + length] = draw.randbytes(length)
    elif kind == 2:
        data[place : place + length] = draw.choice([b"\xff", b"\x00", b"\x7f", b"\x80"]) * length
    elif kind == 3:
        del data[place : place + length]
    elif kind == 4:
        data[place:place] = data[place : place + length * draw.choice([1, 30])]
    else:
        del data[place:]
    return data


def _simplify_file(draw: random.Random, path: Path, suffix: str) -> str:
    output = _stages() / f"out{suffix}"
    output.unlink(missing_ok=True)
    options = SimplifyOptions(
        ratio=0.4,
        device="cpu",
        bake=draw.random() < 0.2,
        weld=draw.random() < 0.8,
        flatten=draw.random() < 0.3,
        memory="1G",
    )
    if draw.random() < 0.1:
        with contextlib.suppress(WarpqemError):
            inspect_stage(path)
    try:
        report = simplify_stage(path, output, options)
    except WarpqemError as error:
        if not str(error):
            raise UnsoundError("an error that says nothing") from error
        if list(_stages().glob(".warpqem.*")) or output.exists():
            raise UnsoundError("a file is left behind") from error
        return type(error).__name__
    for prim in report.failed:
        if not prim.message or not prim.message.startswith(prim.path):
            raise UnsoundError(f"a message without its prim: {prim.message}")
    if report.output is not None:
        _check_output(output, [prim.path for prim in report.prims if prim.status == "simplified"])
    return "done" if not report.failed else "prim failed"


def _check_output(output: Path, simplified: list[str]) -> None:
    stage = open_stage(output)
    for path in simplified:
        mesh = UsdGeom.Mesh(stage.GetPrimAtPath(path))
        counts = np.array(mesh.GetFaceVertexCountsAttr().Get())
        indices = np.array(mesh.GetFaceVertexIndicesAttr().Get())
        attribute = mesh.GetPointsAttr()
        for time in attribute.GetTimeSamples() or [Usd.TimeCode.Default()]:
            points = np.array(attribute.Get(time))
            if not len(points) or not np.isfinite(points).all():
                raise UnsoundError(f"{path}: points that are not finite at {time}")
            if counts.sum() != len(indices) or indices.min() < 0 or indices.max() >= len(points):
                raise UnsoundError(f"{path}: faces out of range at {time}")
        lengths = {"uniform": len(counts), "vertex": len(points), "varying": len(points), "faceVarying": len(indices)}
        for primvar in UsdGeom.PrimvarsAPI(mesh).GetPrimvars():
            wanted = lengths.get(primvar.GetInterpolation())
            indexed = primvar.IsIndexed() or not primvar.HasAuthoredValue()
            values = None if indexed else primvar.Get()
            if wanted and values is not None and len(values) != wanted * primvar.GetElementSize():
                raise UnsoundError(f"{primvar.GetName()}: {len(values)} values for {wanted}")


CASES = {
    "arrays": array_case,
    "values": value_case,
    "bytes": byte_case,
    "program": byte_case_by_program,
    "progressive": progressive_case,
}
