"""Arrays as callers may give them, by kind, and every array argument of the public functions.

A kind makes another form of a sound array. Some forms mean the same and give the same bits; the others must be refused.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import warpqem
from tests.support import meshes
from warpqem.face import facial_features
from warpqem.measure import compare, distance_colors, topology, vertex_distances
from warpqem.picture import fit_view, render
from warpqem.pipeline.mirror import find_mirror
from warpqem.pipeline.surface_transfer import surface_transfer
from warpqem.skinning.fit_skin import fit_skin
from warpqem.skinning.linear_skin import LinearSkin, pose_skin
from warpqem.skinning.rest_pose_quadrics import simplify_pulled_back


class Raising:
    """Something array-like that fails, as a tensor with gradients or one on another device does."""

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        raise RuntimeError("cannot convert: call .cpu() first")


class RaisingExchange(Raising):
    """The same by DLPack."""

    def __dlpack__(self, **options: Any) -> Any:
        raise BufferError("tensor requires grad")

    def __dlpack_device__(self) -> tuple[int, int]:
        return 1, 0


class Wrapped:
    """An array behind ``__array__``, as a data frame is."""

    def __init__(self, array: np.ndarray) -> None:
        self.array = array

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return self.array if dtype is None else self.array.astype(dtype)


def _first(array: np.ndarray, value: Any, dtype: Any) -> np.ndarray:
    changed = array.astype(dtype)
    changed.reshape(-1)[0] = value
    return changed


def _ragged(array: np.ndarray) -> Any:
    rows = array.tolist()
    return [*rows, [1, [2, 3]]]


def _masked(array: np.ndarray) -> np.ma.MaskedArray:
    mask = np.zeros(array.shape, dtype=bool)
    mask.reshape(-1)[array.size // 2] = True
    return np.ma.MaskedArray(array, mask)


# Refused wherever an array is expected.
REFUSED: dict[str, Callable[[np.ndarray], Any]] = {
    "masked": _masked,
    "text": lambda a: a.astype(str),
    "text list": lambda a: a.astype(str).tolist(),
    "bytes": lambda a: a.astype("S"),
    "objects": lambda a: _first(a, None, object),
    "objects that are numbers": lambda a: a.astype(object),
    "complex": lambda a: a + 0j,
    "structured": lambda a: np.zeros(a.shape, dtype=[("x", "f4"), ("y", "f4")]),
    "datetime": lambda a: a.astype("M8[s]"),
    "timedelta": lambda a: a.astype("m8[s]"),
    "ragged": _ragged,
    "raising": lambda a: Raising(),
    "raising exchange": lambda a: RaisingExchange(),
    "number": lambda a: 3,
    "float": lambda a: 0.5,
    "0-d": lambda a: np.array(3),
    "string": lambda a: "1.5",
    "set": lambda a: {1, 2, 3},
    "dict": lambda a: {"x": a},
    "generator": lambda a: (row for row in a),
    "function": lambda a: max,
    "type": lambda a: np.ndarray,
    "true": lambda a: True,
    "too deep": lambda a: a[None, None, None],
    "rows short": lambda a: a[..., :-1],
}
# Refused beside those where indices are expected.
REFUSED_INDICES: dict[str, Callable[[np.ndarray], Any]] = {
    "fractions": lambda a: a + 0.25,
    "whole floats": lambda a: a.astype(np.float64),
    "-1": lambda a: _first(a, -1, np.int64),
    "2**31": lambda a: _first(a, 2**31, np.int64),
    "2**32 + 1": lambda a: _first(a, 2**32 + 1, np.int64),
    "2**63 unsigned": lambda a: _first(a, 2**63, np.uint64),
    "2**64 - 1 unsigned": lambda a: _first(a, 2**64 - 1, np.uint64),
    "bool": lambda a: a.astype(bool),
}
# Refused beside those where finite numbers are expected.
REFUSED_REALS: dict[str, Callable[[np.ndarray], Any]] = {
    "nan": lambda a: _first(a, np.nan, np.float64),
    "-inf": lambda a: _first(a, -np.inf, np.float64),
    "beyond single": lambda a: _first(a, -1e300, np.float64),
}
# Taken, with the same bits.
ACCEPTED: dict[str, Callable[[np.ndarray], Any]] = {
    "list": lambda a: a.tolist(),
    "tuple": lambda a: tuple(a.tolist()),
    "no mask": lambda a: np.ma.MaskedArray(a),
    "mask of nothing": lambda a: np.ma.MaskedArray(a, np.zeros(a.shape, bool)),
    "negative strides": lambda a: a[::-1].copy()[::-1],
    "byte-swapped": lambda a: a.astype(a.dtype.newbyteorder()),
    "Fortran order": lambda a: np.asfortranarray(a),
    "every other": lambda a: np.repeat(a, 2, axis=0)[::2],
    "wrapped": Wrapped,
    "memory map": lambda a: a.view(np.memmap) if a.flags.owndata else a,
}
ACCEPTED_INDICES: dict[str, Callable[[np.ndarray], Any]] = {
    "int64": lambda a: a.astype(np.int64),
    "uint64": lambda a: a.astype(np.uint64),
    "uint32": lambda a: a.astype(np.uint32),
    "int16": lambda a: a.astype(np.int16),
}


@dataclass(frozen=True)
class Slot:
    """One array argument of one function.

    Attributes:
        array: a sound one.
        call: the function with another one.
        kind: "indices", or "reals" (finite ones).
        taken: kinds that this argument takes although others refuse them.
    """

    array: np.ndarray
    call: Callable[[Any], Any]
    kind: str
    taken: tuple[str, ...] = ()

    @property
    def refused(self) -> dict[str, Callable[[np.ndarray], Any]]:
        own = REFUSED | (REFUSED_INDICES if self.kind == "indices" else REFUSED_REALS)
        return {name: make for name, make in own.items() if name not in self.taken}

    @property
    def accepted(self) -> dict[str, Callable[[np.ndarray], Any]]:
        return ACCEPTED | (ACCEPTED_INDICES if self.kind == "indices" else {})


@functools.cache
def slots() -> dict[str, Slot]:
    """Every array argument, by function and name."""
    return {**_simplify_slots(), **_skin_slots(), **_other_slots()}


def _skin() -> tuple[LinearSkin, np.ndarray, np.ndarray, np.ndarray]:
    """A tube on two joints: skin, faces, transforms (3, 2, 3, 4) and its poses."""
    points, faces = meshes.tube(8, 6)
    share = np.clip(points[:, 0], 0.0, 1.0).astype(np.float64)
    joints = np.tile(np.array([0, 1], dtype=np.int32), (len(points), 1))
    skin = LinearSkin(points, joints, np.stack([1.0 - share, share], axis=1))
    transforms = np.tile(np.eye(4)[:3], (3, 2, 1, 1))
    transforms[1, 1, 2, 3], transforms[2, 1, 1, 3] = 0.25, 0.5
    return skin, faces, transforms, pose_skin(skin, transforms).astype(np.float32)


def _simplify_slots() -> dict[str, Slot]:
    points, faces = meshes.swaying_sphere(1, 3)
    points = points.astype(np.float32)
    count = points.shape[1]
    options = {"ratio": 0.5, "device": "cpu"}
    ones = np.ones(count)
    seams = np.array([[faces[0, 0], faces[0, 1]], [faces[0, 1], faces[0, 2]]])
    simplify = functools.partial(warpqem.simplify, **options)

    def fields(values: Any) -> Any:
        return simplify(points, faces, attributes=[warpqem.costs.AttributeField(values)])

    slots = {
        "vertex_weights": Slot(ones, lambda a: simplify(points, faces, vertex_weights=a), "reals"),
        "quadric_scale": Slot(ones, lambda a: simplify(points, faces, quadric_scale=a), "reals"),
        "locked": Slot(np.array([0, 3, 2]), lambda a: simplify(points, faces, locked=a), "indices", ("rows short",)),
        "seams": Slot(seams, lambda a: simplify(points, faces, seams=a), "indices"),
        "attributes at vertices": Slot(points[0].copy(), fields, "reals", ("rows short",)),
        "attributes at corners": Slot(points[0][faces], fields, "reals", ("rows short",)),
        "plan attributes": Slot(
            points[0].copy(),
            lambda a: warpqem.plan(points, faces, attributes=[warpqem.costs.AttributeField(a)], memory="1G", **options),
            "reals",
            ("rows short",),
        ),
    }
    for name, call in {
        "simplify": simplify,
        "plan": functools.partial(warpqem.plan, memory="1G", **options),
        "simplify_levels": functools.partial(warpqem.simplify_levels, ratios=[0.5], device="cpu"),
        "order_levels": functools.partial(warpqem.order_levels, target_faces=40, device="cpu"),
        "build_progressive": functools.partial(warpqem.build_progressive, base_faces=70, device="cpu"),
        "motion_features": functools.partial(warpqem.motion_features, device="cpu"),
    }.items():
        if name != "plan":
            slots[f"{name} points"] = Slot(points, lambda a, call=call: call(a, faces), "reals")
        slots[f"{name} faces"] = Slot(faces, lambda a, call=call: call(points, a), "indices")
    return slots


def _skin_slots() -> dict[str, Slot]:
    skin, faces, transforms, poses = _skin()
    still, seam = np.zeros_like(poses), faces[:1, :2].copy()

    # As many vertices as before, so that arrays of theirs have a shape that is known here.
    @functools.cache
    def result(count: int) -> warpqem.SimplifiedMesh:
        return warpqem.simplify(poses[:count], faces, ratio=1.0, device="cpu")

    @functools.cache
    def start() -> LinearSkin:
        return fit_skin(poses, faces, result(3), skin, transforms, device="cpu").skin

    def fit(**change: Any) -> Any:
        given = {"points": poses, "faces": faces, "result": result(3), "skin": skin, "transforms": transforms, **change}
        return fit_skin(**given, device="cpu")

    def pull_back(**change: Any) -> Any:
        given = {"points": poses, "faces": faces, "skin": skin, "transforms": transforms, **change}
        return simplify_pulled_back(**given, ratio=0.5, device="cpu")

    slots = {
        "pose_skin transforms": Slot(transforms, lambda a: pose_skin(skin, a), "reals"),
        "pose_skin offsets": Slot(still, lambda a: pose_skin(skin, transforms, a), "reals"),
        "fit_skin offsets": Slot(still, lambda a: fit(offsets=a), "reals"),
        "fit_skin start_offsets": Slot(still, lambda a: fit(offsets=still, start=start(), start_offsets=a), "reals"),
        "surface_transfer points": Slot(
            poses[0].copy(), lambda a: surface_transfer(a, faces, result(1), device="cpu"), "reals"
        ),
        "surface_transfer faces": Slot(
            faces, lambda a: surface_transfer(poses[0], a, result(1), device="cpu"), "indices"
        ),
        "surface_transfer seams": Slot(
            seam, lambda a: surface_transfer(poses[0], faces, result(1), seams=a, device="cpu"), "indices"
        ),
    }
    for name, call in {"fit_skin": fit, "simplify_pulled_back": pull_back}.items():
        slots |= {
            f"{name} points": Slot(poses, lambda a, call=call: call(points=a), "reals"),
            f"{name} faces": Slot(faces, lambda a, call=call: call(faces=a), "indices"),
            f"{name} transforms": Slot(transforms, lambda a, call=call: call(transforms=a), "reals"),
            f"{name} rest": Slot(skin.rest, lambda a, call=call: call(skin=replace(skin, rest=a)), "reals"),
            f"{name} joints": Slot(skin.joints, lambda a, call=call: call(skin=replace(skin, joints=a)), "indices"),
            f"{name} weights": Slot(skin.weights, lambda a, call=call: call(skin=replace(skin, weights=a)), "reals"),
            f"{name} seams": Slot(seam, lambda a, call=call: call(seams=a), "indices"),
        }
    return slots


def _other_slots() -> dict[str, Slot]:
    points, faces = meshes.swaying_sphere(1, 3)
    points, rest = points.astype(np.float32), meshes.icosphere(1)[0]
    # The regular sphere is symmetric, and none of its faces lies across the plane.
    even, even_faces = meshes.octahedron()
    targets = points - rest
    sides = (points, faces, points, faces)
    compared = functools.partial(compare, samples=50, device="cpu")
    slots = {
        "morph_weights neutral": Slot(rest, lambda a: warpqem.costs.morph_weights(a, targets), "reals"),
        "morph_weights targets": Slot(targets, lambda a: warpqem.costs.morph_weights(rest, a), "reals"),
        "morph_weights usage": Slot(
            np.ones((5, 3)),
            lambda a: warpqem.costs.morph_weights(rest, targets, "usage", a),
            "reals",
            ("beyond single",),
        ),
        "morph_weights method": Slot(
            np.ones(len(rest)), lambda a: warpqem.costs.morph_weights(rest, targets, lambda distance: a), "reals"
        ),
        "find_mirror points": Slot(even, lambda a: find_mirror(a, even_faces), "reals"),
        "find_mirror faces": Slot(even_faces, lambda a: find_mirror(even, a), "indices"),
        "simplify_symmetric points": Slot(
            even[None], lambda a: warpqem.simplify_symmetric(a, even_faces, ratio=1.0, device="cpu"), "reals"
        ),
        "simplify_symmetric faces": Slot(
            even_faces, lambda a: warpqem.simplify_symmetric(even, a, ratio=1.0, device="cpu"), "indices"
        ),
        "facial_features points": Slot(points, lambda a: facial_features(a, faces), "reals"),
        "facial_features faces": Slot(faces, lambda a: facial_features(points, a), "indices"),
        "topology faces": Slot(faces, topology, "indices"),
        "fit_view points": Slot(points, fit_view, "reals"),
        "render points": Slot(rest, lambda a: _picture(a, faces), "reals"),
        "render faces": Slot(faces, lambda a: _picture(rest, a), "indices"),
        "render colors": Slot(rest, lambda a: _picture(rest, faces, a), "reals"),
    }
    for name, call in {
        "compare": compared,
        "vertex_distances": functools.partial(vertex_distances, device="cpu"),
        "distance_colors": functools.partial(distance_colors, device="cpu"),
    }.items():
        for index, side in enumerate(("reference_points", "reference_faces", "test_points", "test_faces")):

            def one(a: Any, call: Any = call, index: int = index) -> Any:
                return call(*sides[:index], a, *sides[index + 1 :])

            slots[f"{name} {side}"] = Slot(sides[index], one, "indices" if index % 2 else "reals")
    return slots


def _picture(points: Any, faces: Any, colors: Any = None) -> np.ndarray:
    view = fit_view(meshes.icosphere(1)[0])
    return render(points, faces, view, colors=colors, size=(8, 6), device="cpu")
