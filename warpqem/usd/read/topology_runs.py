"""Runs of constant topology of a mesh whose topology varies over time, each shown as an ordinary mesh.

A capture or a remeshed simulation has one topology for some frames and another for the next. `find_runs` finds where it
changes; `open_run` shows the mesh in one run on a stage of its own, so that all that reads a mesh can read it. In a run
points are interpolated between its own samples and held beyond them, never blended over a change of topology.
"""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom

from warpqem.errors import StageError
from warpqem.files.temporary import temporary_path
from warpqem.usd.layers.sample_saver import SampleSaver
from warpqem.usd.read.stage_views import copy_stage_metadata, open_like
from warpqem.usd.read.time_codes import FrameRange
from warpqem.usd.read.value_arrays import anchored

__all__ = ["TOPOLOGY", "TopologyRun", "choose_runs", "describe_runs", "find_runs", "held_value", "open_run"]

# Attributes that make up the topology, which a run has one value of.
TOPOLOGY = ("faceVertexCounts", "faceVertexIndices", "holeIndices")


@dataclass(frozen=True)
class TopologyRun:
    """Frames that follow each other and have one topology.

    Attributes:
        start: Time code at which its topology begins; -inf for the first run.
        end: Time code at which the next one begins; inf for the last run.
        times: Time codes of its frames, ascending, at least one. The first is where its points begin.
        is_empty: True if topology or points are blocked or have no entries: the mesh shows nothing.
    """

    start: float
    end: float
    times: tuple[float, ...]
    is_empty: bool = False

    def shows(self, time: float) -> bool:
        """True if the mesh has this topology at a time."""
        return self.start <= time < self.end

    def __str__(self) -> str:
        """Its first and last frame."""
        return f"times {self.times[0]:g} to {self.times[-1]:g}" if len(self.times) > 1 else f"time {self.times[0]:g}"


def find_runs(mesh: UsdGeom.Mesh) -> list[TopologyRun]:
    """The runs of a mesh, in order of time: maximal spans without a change of faces, holes or number of points.

    A topology whose points come only later is left out until then: its faces would refer to points of another one.

    Raises:
        StageError: there is no time at which the mesh has points that its faces refer to.
    """
    point_times = mesh.GetPointsAttr().GetTimeSamples()
    starts = _changes(mesh)
    runs: list[TopologyRun] = []
    for start, end in zip(starts, [*starts[1:], math.inf], strict=True):
        times = [time for time in point_times if start <= time < end]
        # The first run has no beginning but that of its samples.
        begin = start if start > -math.inf else _first_time(mesh)
        if (not times or (start > -math.inf and times[0] > start)) and _fits_held_points(mesh, begin):
            times.insert(0, begin)
        if not times:
            continue
        if runs:
            # What is left out before it goes on showing the run before.
            runs[-1] = replace(runs[-1], end=times[0])
        runs.append(TopologyRun(times[0] if runs else -math.inf, end, tuple(times), _is_empty(mesh, times[0])))
    if not runs:
        raise StageError(f"{mesh.GetPath()}.faceVertexIndices: at no time are the points there that faces refer to")
    return [*runs[:-1], replace(runs[-1], end=math.inf)]


def _first_time(mesh: UsdGeom.Mesh) -> float:
    return min(time for name in (*TOPOLOGY, "points") for time in _times(mesh, name))


def _changes(mesh: UsdGeom.Mesh) -> list[float]:
    """Times from which the topology is another, after -inf for the first."""
    attributes = [mesh.GetPrim().GetAttribute(name) for name in TOPOLOGY]
    sampled = [set(attribute.GetTimeSamples()) if attribute else set() for attribute in attributes]
    points = mesh.GetPointsAttr()
    point_times = set(points.GetTimeSamples())
    key: list[Any] = [None] * (len(TOPOLOGY) + 1)
    known = [False] * len(key)
    changes = [-math.inf]
    for time in sorted(point_times.union(*sampled)):
        changed = False
        for index in range(len(key)):
            own = point_times if index == len(TOPOLOGY) else sampled[index]
            if time not in own:
                continue
            value = _length(points, time) if index == len(TOPOLOGY) else _digest(attributes[index], time)
            # The first sample holds before itself, too.
            changed |= known[index] and value != key[index]
            key[index], known[index] = value, True
        if changed:
            changes.append(time)
    return changes


def _times(mesh: UsdGeom.Mesh, name: str) -> list[float]:
    attribute = mesh.GetPrim().GetAttribute(name)
    times: list[float] = attribute.GetTimeSamples() if attribute else []
    return times


def _length(attribute: Usd.Attribute, time: float) -> int:
    value = attribute.Get(time)
    return len(value) if hasattr(value, "__len__") else -1


def _digest(attribute: Usd.Attribute, time: float) -> bytes | None:
    """A digest that differs where values do, so that not all of them are in memory."""
    value = attribute.Get(time)
    if value is None:
        return None
    return hashlib.blake2b(np.asarray(value, dtype=np.int64).tobytes(), digest_size=16).digest()


def held_value(attribute: Usd.Attribute, time: float) -> Any:
    """The value of the last sample at or before a time, or of the first one, or the default value."""
    times = attribute.GetTimeSamples()
    if not times:
        return attribute.Get()
    return attribute.Get(max((other for other in times if other <= time), default=times[0]))


def _fits_held_points(mesh: UsdGeom.Mesh, time: float) -> bool:
    points, indices = held_value(mesh.GetPointsAttr(), time), mesh.GetFaceVertexIndicesAttr().Get(time)
    if indices is None or not hasattr(points, "__len__"):
        return True
    return int(np.asarray(indices).max(initial=-1)) < len(points)


def _is_empty(mesh: UsdGeom.Mesh, time: float) -> bool:
    values = [held_value(mesh.GetPointsAttr(), time), *(mesh.GetPrim().GetAttribute(n).Get(time) for n in TOPOLOGY[:2])]
    return any(value is None or (hasattr(value, "__len__") and not len(value)) for value in values)


def choose_runs(mesh: UsdGeom.Mesh, frames: FrameRange | None) -> list[TopologyRun]:
    """The runs of a mesh with the frames of a range; those without any are left out.

    Raises:
        StageError: the mesh has no sample in the range, or nowhere fitting points.
    """
    runs = find_runs(mesh)
    if frames is None:
        return runs
    times = sorted(time for run in runs for time in run.times)
    wanted = frames.select(times)
    chosen = [(run, tuple(time for time in wanted if run.shows(time))) for run in runs]
    chosen_runs = [replace(run, times=own) for run, own in chosen if own]
    if not chosen_runs:
        raise StageError(
            f"{mesh.GetPath()}.points: no sample between the times {frames.start:g} and {frames.end:g} "
            f"(samples from {times[0]:g} to {times[-1]:g}); add a step to interpolate"
        )
    return chosen_runs


def describe_runs(mesh: UsdGeom.Mesh, runs: Sequence[TopologyRun]) -> str:
    """How a mesh varies, in words for a report."""
    counts = [_length(mesh.GetFaceVertexCountsAttr(), run.times[0]) for run in runs if not run.is_empty]
    least, most = min(counts, default=0), max(counts, default=0)
    faces = f"{most} faces" if least == most else f"{least} to {most} faces"
    if len(runs) > 1 and all(len(run.times) == 1 for run in runs):
        return f"topology differs in each of {len(runs)} frames ({faces})"
    return f"topology varies over time: {len(runs)} runs of constant topology ({faces})"


def _sampled_arrays(prim: Usd.Prim) -> list[Usd.Attribute]:
    """Array attributes of a mesh and its subsets that have time samples, but for those of its topology and extent."""
    subsets = [subset.GetPrim() for subset in UsdGeom.Subset.GetAllGeomSubsets(UsdGeom.Mesh(prim))]
    attributes = [attribute for owner in (prim, *subsets) for attribute in owner.GetAuthoredAttributes()]
    return [
        attribute
        for attribute in attributes
        if attribute.GetName() not in (*TOPOLOGY, "extent")
        and attribute.GetTypeName().isArray
        and attribute.GetTimeSamples()
    ]


@contextmanager
def open_run(prim: Usd.Prim, run: TopologyRun, folder: Path | None = None) -> Iterator[Usd.Prim]:
    """The mesh in one run, as an ordinary mesh on a stage of its own.

    Args:
        prim: The mesh on the input.
        run: One of its runs.
        folder: Where to keep a temporary file with the samples of the run; None to keep them in memory.

    Yields:
        The prim at the same path of a stage over the input that has this mesh alone, and samples of this run alone.
    """
    # A prim does not keep its stage alive.
    if folder is None:
        stage = _run_stage(prim, run, Sdf.Layer.CreateAnonymous("run.usda"))
        yield stage.GetPrimAtPath(prim.GetPath())
        return
    file = temporary_path(folder, ".usdc")
    try:
        stage = _run_stage(prim, run, Sdf.Layer.CreateNew(os.fspath(file)))
        yield stage.GetPrimAtPath(prim.GetPath())
    finally:
        file.unlink(missing_ok=True)


def _run_stage(prim: Usd.Prim, run: TopologyRun, layer: Sdf.Layer) -> Usd.Stage:
    stage = prim.GetStage()
    root = stage.GetRootLayer()
    copy_stage_metadata(root, layer)
    layer.subLayerPaths.append(root.realPath or root.identifier)
    _SampleWriter(prim, run, layer).write()
    mask = Usd.StagePopulationMask([prim.GetPath()])
    return open_like(stage, layer, stage.GetSessionLayer(), mask)


class _SampleWriter:
    """Writes the values of a mesh in one run into a layer over the input."""

    def __init__(self, prim: Usd.Prim, run: TopologyRun, layer: Sdf.Layer) -> None:
        self._prim, self._run, self._layer = prim, run, layer
        self._saver = SampleSaver(layer)

    def write(self) -> None:
        """Write topology and points, and whatever else has samples; the rest shows through from the input."""
        first = self._run.times[0]
        for name in TOPOLOGY:
            attribute = self._prim.GetAttribute(name)
            if attribute and attribute.GetTimeSamples():
                self._author(attribute, None, attribute.Get(first))
        for attribute in _sampled_arrays(self._prim):
            if attribute.GetName() == "points":
                self._write_points(attribute)
            else:
                self._write_samples(attribute, first)
        self._saver.save()

    def _write_points(self, attribute: Usd.Attribute) -> None:
        own = [time for time in attribute.GetTimeSamples() if self._run.shows(time)]
        wanted = [time for time in own if self._run.times[0] <= time <= self._run.times[-1]]
        # Frames between samples are interpolated, so that their neighbours have to be there.
        before = [time for time in own if time < self._run.times[0]][-1:]
        after = [time for time in own if time > self._run.times[-1]][:1]
        needed = [*before, *wanted, *after]
        if not before and (not wanted or wanted[0] > self._run.times[0]):
            self._author(attribute, self._run.times[0], held_value(attribute, self._run.times[0]))
        for time in needed:
            self._author(attribute, time, attribute.Get(time))
        if attribute.Get() is not None:
            self._author(attribute, None, held_value(attribute, self._run.times[0]))

    def _write_samples(self, attribute: Usd.Attribute, first: float) -> None:
        times = [time for time in attribute.GetTimeSamples() if self._run.shows(time)]
        for time in times:
            self._author(attribute, time, attribute.Get(time))
        if not times or attribute.Get() is not None:
            self._author(attribute, None, attribute.Get(times[0]) if times else held_value(attribute, first))

    def _author(self, attribute: Usd.Attribute, time: float | None, value: Any) -> None:
        path = attribute.GetPath()
        spec = self._layer.GetAttributeAtPath(path)
        if not spec:
            owner = Sdf.CreatePrimInLayer(self._layer, path.GetPrimPath())
            custom, variability = attribute.IsCustom(), attribute.GetVariability()
            spec = Sdf.AttributeSpec(owner, path.name, attribute.GetTypeName(), variability, custom)
        value = Sdf.ValueBlock() if value is None else _anchored(attribute, time, value)
        if time is None:
            spec.default = value
        else:
            self._layer.SetTimeSample(path, time, value)
        self._saver(12 * len(value) if hasattr(value, "__len__") else 0)


def _anchored(attribute: Usd.Attribute, time: float | None, value: Any) -> Any:
    if not isinstance(value, Sdf.AssetPathArray):
        return value
    layer = attribute.GetPropertyStack(Usd.TimeCode.Default() if time is None else time)[0].layer
    return Sdf.AssetPathArray([anchored(asset, layer) for asset in value])
