"""Random hostile arrays and options of the core, each case from a seed; see :mod:`tests.support.fuzz_cases`."""

from __future__ import annotations

import contextlib
import functools
import warnings
from typing import Any

import numpy as np

import warpqem
from tests.support import array_kinds, meshes
from warpqem.errors import UnreachableTargetError, WarpqemError
from warpqem.frames.stream import ArraySink

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
