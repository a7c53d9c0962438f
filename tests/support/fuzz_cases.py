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
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Tf, Usd, UsdGeom, UsdUtils

import warpqem
from tests.support import array_kinds, meshes
from tests.support.progressive_cases import progressive_case
from tests.support.rich_stage import rich_stage
from tests.support.usd_stages import cloth_stage, define_cloth, skinned_stage
from warpqem.errors import UnreachableTargetError, WarpqemError
from warpqem.frames.stream import ArraySink
from warpqem.usd import SimplifyOptions, inspect_stage, simplify_stage
from warpqem.usd.read.open_stage import open_stage

# Values that have broken meshes before: edges of the types, what is not finite, what vanishes when squared.
EDGES = [0.0, -0.0, 1.0, -1.0, 1e-45, 1e-38, -1e-30, 1e-20, 1e6, 1e10, 1e19, 1e20, 3e38, -3e38, np.nan, np.inf, -np.inf]
INDEX_EDGES = [0, 1, -1, -2, 2**15, 2**16, 2**31 - 1, -(2**31), 10**6]


class UnsoundError(AssertionError):
    """A result that must not come out."""


# Arrays.


@functools.cache
def _bases() -> list[meshes.Mesh]:
    return [
        meshes.triangle(),
        meshes.tetrahedron(),
        meshes.icosphere(1),
        meshes.torus(8, 5),
        meshes.grid(5, 4),
        meshes.fan(7, 0.3),
        meshes.bow_tie(),
        meshes.book(3, 3),
        meshes.moebius(9),
        meshes.back_to_back(),
        meshes.joined(meshes.tetrahedron(), meshes.grid(2, 2), spacing=1.0),
        meshes.soup(meshes.grid(3, 3)),
    ]


def array_case(seed: int) -> str:
    """Simplify a small mesh with something wrong with it, or call another function so; returns how it ended."""
    draw = np.random.default_rng(seed)
    return _argument_case(draw) if draw.random() < 0.35 else _mesh_case(draw)


def _mesh_case(draw: np.random.Generator) -> str:
    points, faces = _bases()[draw.integers(len(_bases()))]
    frames = int(draw.choice([1, 1, 2, 5, 9]))
    moving = points + 0.1 * draw.normal(size=(frames, *points.shape)) * draw.choice([0, 0, 1])
    moving, faces = moving.astype(draw.choice([np.float32, np.float64])), faces.copy()
    for _ in range(draw.integers(0, 4)):
        moving, faces = _change_arrays(draw, moving, faces)
    options = _array_options(draw, moving, faces)
    given: Any = moving[0] if draw.random() < 0.1 and len(moving) else moving
    if draw.random() < 0.15 and moving.ndim == 3:
        given = OddFrames(draw, moving)
        options["sink"] = draw.choice([None, ArraySink()])
    try:
        result = warpqem.simplify(given, faces, **options)
    except ReadError:
        return "what a source raised"
    except UnreachableTargetError as error:
        result = error.result
    except WarpqemError as error:
        if not str(error):
            raise UnsoundError("an error that says nothing") from error
        return type(error).__name__
    if isinstance(given, OddFrames) and given.must_fail:
        raise UnsoundError(f"a source that gives {given.kind} was taken")
    _check_arrays(result, moving, faces)
    return "done"


def _argument_case(draw: np.random.Generator) -> str:
    """One array argument of any function, of odd values, in an odd form, or both."""
    slots = array_kinds.slots()
    slot = slots[str(draw.choice(sorted(slots)))]
    array, form = slot.array.copy(), str(draw.choice(["plain", "refused", "refused", "accepted"]))
    changes = int(draw.integers(0, 3))
    for _ in range(changes):
        array = _change_values(draw, array)
    kinds = {"plain": {"plain": lambda a: a}, "refused": slot.refused, "accepted": slot.accepted}[form]
    kind = str(draw.choice(sorted(kinds)))
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            value = kinds[kind](array)
    except (ValueError, TypeError, OverflowError, IndexError):
        return "no such form of such an array"
    before = array.copy()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            slot.call(value)
    except WarpqemError as error:
        if not str(error):
            raise UnsoundError("an error that says nothing") from error
        return f"argument: {type(error).__name__}"
    if not np.array_equal(array, before, equal_nan=array.dtype.kind == "f"):
        raise UnsoundError("an argument was written to")
    if form == "refused" and not changes:
        raise UnsoundError(f"{kind} was taken")
    return "argument: done"


def _change_values(draw: np.random.Generator, array: np.ndarray) -> np.ndarray:
    kind, array = draw.integers(6), array.copy()
    edges = EDGES if array.dtype.kind == "f" else INDEX_EDGES
    with np.errstate(over="ignore"):
        if kind <= 1 and array.size:
            with contextlib.suppress(OverflowError):
                array.reshape(-1)[draw.integers(array.size)] = draw.choice(np.array(edges, dtype=object))
        elif kind == 2:
            array = array[: draw.integers(len(array) + 1)]
        elif kind == 3:
            array = np.concatenate([array, array])
        elif kind == 4:
            array = np.swapaxes(array, 0, array.ndim - 1)
        elif kind == 5 and len(array):
            array = array[draw.integers(len(array), size=len(array))]
    return array


class ReadError(Exception):
    """What a source of frames raises."""


class OddFrames:
    """A source of frames that may not do what it says."""

    def __init__(self, draw: np.random.Generator, points: np.ndarray) -> None:
        self._points, self._draw, self._reads = points, draw, 0
        self.frame_count, self.vertex_count, self.dtype = *points.shape[:2], points.dtype
        self.kind = str(draw.choice(["nothing odd", "one buffer", "None", "another count", "another type", "an error"]))
        self.from_read = int(draw.integers(0, 4))
        self.must_fail = False
        self._buffer = np.empty_like(points)

    def read(self, frames: slice) -> Any:
        """Consecutive frames, or something else."""
        self._reads += 1
        points = self._points[frames]
        if self.kind == "one buffer":
            self._buffer[: len(points)] = points
            return self._buffer[: len(points)]
        if self.kind == "nothing odd" or self._reads <= self.from_read:
            return points
        self.must_fail = True
        if self.kind == "an error":
            raise ReadError
        return {"None": None, "another count": points[:, 1:], "another type": points.astype(np.int16)}[self.kind]


def _change_arrays(draw: np.random.Generator, points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    kind = draw.integers(14)
    with np.errstate(over="ignore", invalid="ignore"):
        if kind == 0 and points.size:
            with contextlib.suppress(OverflowError, ValueError):
                points.reshape(-1)[draw.integers(points.size)] = float(draw.choice(EDGES))
        elif kind == 1:
            points = points * points.dtype.type(draw.choice(EDGES[4:14]))
        elif kind == 2:
            points = points + points.dtype.type(draw.choice([1e3, 1e6, -1e6, 1e8]))
        elif kind == 3 and faces.size:
            with contextlib.suppress(OverflowError):  # it has no place in this type
                faces.reshape(-1)[draw.integers(faces.size)] = int(draw.choice(INDEX_EDGES))
        elif kind == 4 and len(faces):
            faces = np.concatenate([faces, faces[draw.integers(len(faces), size=3)]])
        elif kind == 5 and len(faces):
            faces[draw.integers(len(faces)), 0] = faces[draw.integers(len(faces)), 1]
        elif kind == 6:
            faces = faces[: draw.integers(len(faces) + 1)]
        elif kind == 7:
            points = points[:, : draw.integers(points.shape[1] + 1)]
        elif kind == 8:
            points = points[: draw.integers(len(points) + 1)]
        elif kind == 9:
            points[:, :, draw.integers(3)] = 0
        elif kind == 10 and len(points):
            points[draw.integers(len(points))] = 0
        elif kind == 11:
            faces = faces.astype(draw.choice([np.int8, np.uint8, np.int64, np.uint64, np.float32, ">i4"]))
        elif kind == 12:
            points = points.astype(draw.choice([np.float16, ">f4", ">f8", np.float64, np.int32]))
        elif kind == 13 and len(faces):
            faces = draw.permutation(faces)[:, ::-1]
    return points, faces


def _array_options(draw: np.random.Generator, points: np.ndarray, faces: np.ndarray) -> dict[str, Any]:
    options: dict[str, Any] = {"device": "cpu", "metric": draw.choice(["qem", "dsd", "dsd", "dod", "aqem"])}
    goal = draw.choice(["ratio", "ratio", "target_faces", "max_error"])
    options[goal] = {"ratio": 0.4, "target_faces": 2, "max_error": 1.0}[goal]
    if draw.random() < 0.3:
        options["coherence"] = draw.choice([0.0, 1.0, 0.3])
    if draw.random() < 0.1:
        options["placement"] = "endpoint"
    if draw.random() < 0.1:
        options["refit"] = True
    if draw.random() < 0.2:
        options["key_frames"] = int(draw.choice([1, 2, 7]))
    count = points.shape[1] if points.ndim == 3 else 0
    for name in ("vertex_weights", "quadric_scale"):
        if draw.random() < 0.15:
            options[name] = draw.choice(
                [0.0, 1.0, 1e-30, 1e12, np.inf, np.nan, -1.0], size=count + draw.choice([0, 0, 1])
            )
    if draw.random() < 0.1:
        options["locked"] = draw.integers(-1, count + 1, size=3)
    if draw.random() < 0.1:
        options["seams"] = draw.integers(-1, max(count, 1) + 1, size=(4, 2))
    if draw.random() < 0.1:
        options["lock_borders"] = True
    return options


def _check_arrays(result: Any, points: np.ndarray, faces: np.ndarray) -> None:
    if not np.isfinite(result.points).all():
        raise UnsoundError("points that are not finite")
    if result.faces.size and not (result.faces.min() >= 0 and result.faces.max() < result.points.shape[1]):
        raise UnsoundError("faces out of range")
    if len(result.faces) > len(faces) or (result.faces == np.roll(result.faces, 1, axis=1)).any():
        raise UnsoundError("more faces than before, or one that names a vertex twice")
    if len(result.vertex_map) != points.shape[-2] or result.vertex_map.max(initial=-1) >= result.points.shape[1]:
        raise UnsoundError("a vertex map out of range")
    low, high = points.min(axis=(0, 1)).astype(float), points.max(axis=(0, 1)).astype(float)
    reach = float(np.linalg.norm(high - low)) + 1e-6 * float(np.abs([low, high]).max(initial=0)) + 1e-37
    if result.points.size and (
        (result.points.min(axis=(0, 1)) < low - reach).any() or (result.points.max(axis=(0, 1)) > high + reach).any()
    ):
        raise UnsoundError("points that fly off")


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
