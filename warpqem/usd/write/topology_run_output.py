"""Put the runs of a mesh of varying topology, simplified one by one, together as samples of one mesh.

Two runs in a row never get the same number of points: USD would blend the points of one topology into those of the
next between their samples. Where the numbers are equal, the later run has one point more, which no face uses.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom, Vt

from warpqem.usd.read.topology_runs import TOPOLOGY, TopologyRun, held_value
from warpqem.usd.read.value_arrays import from_numpy
from warpqem.usd.write.remove_properties import Dropped
from warpqem.usd.write.write import OverLayer

__all__ = ["RunOutput"]

# Fields of an attribute that are not copied as they are.
VALUE_FIELDS = frozenset({"default", "timeSamples", "typeName", "variability", "custom"})
POINT_INTERPOLATIONS = ("vertex", "varying")
POINT_ARRAYS = ("points", "velocities", "accelerations")
INDICES = ":indices"


@dataclass
class _Written:
    """One run as it was written.

    Attributes:
        run: When it is.
        kept: It is as in the input.
        point_count: Its points, without the one that no face uses.
        padded: It has that point.
        faces: Its faceVertexIndices.
        counts: Its faceVertexCounts.
        interpolation: Interpolation of each primvar, and of normals, that it has values of, by path.
        blocked: Paths of what has no value in it.
    """

    run: TopologyRun
    kept: bool
    point_count: int
    padded: bool
    faces: Any
    counts: Any
    interpolation: dict[Sdf.Path, str]
    blocked: set[Sdf.Path]


class RunOutput:
    """Samples of all runs of one mesh in a layer over the input.

    Args:
        over: The layer.
        prim: The mesh on the input.
        runs: Its runs, in the order in which they are going to be added or kept.
    """

    def __init__(self, over: OverLayer, prim: Usd.Prim, runs: Sequence[TopologyRun]) -> None:
        self._over, self._prim, self._runs = over, prim, runs
        self._layer = over.layer
        self._done: list[_Written] = []
        # Authored paths, and the indices of the runs that they have values in.
        self._authored: dict[Sdf.Path, set[int]] = {}
        self._still: set[Sdf.Path] = set()
        # Child prims that each run has no use for.
        self._deactivated: list[set[Sdf.Path]] = []

    def add(self, edits: OverLayer) -> None:
        """Add the next run.

        Args:
            edits: What was made of it, over a stage that shows it as `warpqem.usd.read.topology_runs.open_run` does.
        """
        mesh = UsdGeom.Mesh(edits.stage.GetPrimAtPath(self._prim.GetPath()))
        points = _first(edits.layer, mesh.GetPath().AppendProperty("points"))
        written = self._begin(False, len(points), mesh.GetFaceVertexCountsAttr(), mesh.GetFaceVertexIndicesAttr())
        for spec in _prim_specs(edits.layer.GetPrimAtPath(mesh.GetPath())):
            self._copy_prim(spec)
            for attribute in spec.attributes:
                self._copy_attribute(edits, attribute, written)
        self._deactivated.append({path for part in edits.dropped for path in part.deactivated})

    def keep(self) -> None:
        """Let the next run be as it is in the input."""
        time = self._runs[len(self._done)].times[0]
        mesh = UsdGeom.Mesh(self._prim)
        points = held_value(mesh.GetPointsAttr(), time)
        self._deactivated.append(set())
        self._begin(True, len(points or ()), mesh.GetFaceVertexCountsAttr(), mesh.GetFaceVertexIndicesAttr(), time)

    def finish(self) -> None:
        """Write what was kept, and give all runs the same interpolation of what they have."""
        if len(self._runs) > 1:
            for path in list(self._authored):
                if path not in self._still:
                    for index, written in enumerate(self._done):
                        if index not in self._authored[path]:
                            self._fill(path, written)
            self._unify()
        dropped = Dropped(deactivated=sorted(set.intersection(*self._deactivated)))
        for path in set.union(*self._deactivated).difference(dropped.deactivated):
            self._layer.GetPrimAtPath(path).ClearActive()
        for path in self._authored:
            if all(path in written.blocked for written in self._done):
                spec = self._layer.GetAttributeAtPath(path)
                spec.ClearInfo("timeSamples")
                spec.default = Sdf.ValueBlock()
                dropped.blocked.append(path)
        self._over.add_dropped(str(self._prim.GetPath()), dropped)

    def discard(self) -> None:
        """Take back all that was written."""
        for path in self._authored:
            spec = self._layer.GetAttributeAtPath(path)
            if spec:
                owner = self._layer.GetPrimAtPath(path.GetPrimPath())
                owner.RemoveProperty(spec)
                self._layer.ScheduleRemoveIfInert(owner)

    def _begin(
        self, kept: bool, point_count: int, counts: Usd.Attribute, faces: Usd.Attribute, time: float | None = None
    ) -> _Written:
        run = self._runs[len(self._done)]
        before = self._done[-1].point_count + self._done[-1].padded if self._done else -1
        code = Usd.TimeCode.Default() if time is None else time
        indices, polygons = (attribute.Get(code) or Vt.IntArray() for attribute in (faces, counts))
        padded = point_count == before > 0
        self._done.append(_Written(run, kept, point_count, padded, indices, polygons, {}, set()))
        return self._done[-1]

    def _copy_prim(self, spec: Sdf.PrimSpec) -> None:
        target = Sdf.CreatePrimInLayer(self._layer, spec.path)
        for key in spec.ListInfoKeys():
            target.SetInfo(key, spec.GetInfo(key))
        for relationship in spec.relationships:
            Sdf.CopySpec(spec.layer, relationship.path, self._layer, relationship.path)

    def _copy_attribute(self, edits: OverLayer, spec: Sdf.AttributeSpec, written: _Written) -> None:
        path = spec.path
        target = self._target(spec)
        composed = edits.stage.GetAttributeAtPath(path)
        still = len(self._runs) == 1 or spec.variability == Sdf.VariabilityUniform or not spec.typeName.isArray
        times = edits.layer.ListTimeSamplesForPath(path)
        if still:
            self._still.add(path)
            if spec.HasInfo("default"):
                target.default = spec.default
            for time in times:
                self._set(path, time, edits.layer.QueryTimeSample(path, time))
            return
        interpolation = _interpolation(composed)
        if isinstance(spec.default, Sdf.ValueBlock):
            self._write(path, written, iter([(written.run.times[0], spec.default)]), None, 1)
            return
        size = _element_size(composed)
        samples: Iterator[tuple[float, Any]]
        if path.name in TOPOLOGY:
            samples = ((time, spec.default) for time in self._topology_times(path.name, written.run))
        elif times:
            samples = ((time, edits.layer.QueryTimeSample(path, time)) for time in times)
        else:
            samples = iter([(written.run.times[0], spec.default)])
        self._write(path, written, samples, interpolation, size)

    def _target(self, spec: Sdf.AttributeSpec) -> Sdf.AttributeSpec:
        self._authored.setdefault(spec.path, set()).add(len(self._done) - 1)
        target = self._layer.GetAttributeAtPath(spec.path)
        if not target:
            owner = self._layer.GetPrimAtPath(spec.path.GetPrimPath())
            target = Sdf.AttributeSpec(owner, spec.name, spec.typeName, spec.variability, spec.custom)
        for key in spec.ListInfoKeys():
            if key not in VALUE_FIELDS:
                target.SetInfo(key, spec.GetInfo(key))
        return target

    def _topology_times(self, name: str, run: TopologyRun) -> list[float]:
        """When a run has samples of its topology: where the input has, and where it begins."""
        attribute = self._prim.GetAttribute(name)
        times = [
            time for time in attribute.GetTimeSamples() if run.times[0] < time <= run.times[-1] and run.shows(time)
        ]
        return [run.times[0], *times]

    def _write(
        self,
        path: Sdf.Path,
        written: _Written,
        samples: Iterator[tuple[float, Any]],
        interpolation: str | None,
        element_size: int,
    ) -> None:
        """Write the samples of one run; the first of them holds from its beginning."""
        for index, (time, value) in enumerate(samples):
            if index == 0:
                if isinstance(value, Sdf.ValueBlock):
                    written.blocked.add(path)
                elif interpolation is not None:
                    written.interpolation[path] = interpolation
                time = min(time, written.run.times[0]) if written.run.start > -np.inf else time
                if time > written.run.times[0]:
                    self._set(
                        path, written.run.times[0], self._padded(path, value, written, interpolation, element_size)
                    )
            value = self._padded(path, value, written, interpolation, element_size)
            self._set(path, time, value)
            if written is self._done[0] and index == 0 and self._has_default(path):
                self._layer.GetAttributeAtPath(path).default = value

    def _has_default(self, path: Sdf.Path) -> bool:
        """True if the input has a default value that the samples would leave as it is."""
        attribute = self._prim.GetStage().GetAttributeAtPath(path)
        return bool(attribute) and attribute.Get() is not None

    def _padded(
        self, path: Sdf.Path, value: Any, written: _Written, interpolation: str | None, element_size: int
    ) -> Any:
        """The values of a run with those of the point that no face uses, where it has one and they are of points."""
        if not written.padded or isinstance(value, Sdf.ValueBlock) or path.GetPrimPath() != self._prim.GetPath():
            return value
        of_points = path.name in POINT_ARRAYS or interpolation in POINT_INTERPOLATIONS
        known = path.name in self._prim.GetPrimDefinition().GetPropertyNames() or path.name.startswith("primvars:")
        if not (of_points or not known) or len(value) != written.point_count * element_size:
            return value
        if hasattr(type(value), "FromNumpy"):
            array = np.array(value)
            return from_numpy(np.concatenate([array, array[-element_size:]]), value)
        return type(value)([*value, *value[-element_size:]])

    def _fill(self, path: Sdf.Path, written: _Written) -> None:
        """Write what a run has in the input of an attribute that others changed; nothing, where it was done."""
        attribute = self._prim.GetStage().GetAttributeAtPath(path)
        first = written.run.times[0]
        if not written.kept or not attribute or not attribute.HasAuthoredValue():
            self._write(path, written, iter([(first, Sdf.ValueBlock())]), None, 1)
            return
        if path.name in TOPOLOGY:
            times = self._topology_times(path.name, written.run)
        else:
            times = [time for time in attribute.GetTimeSamples() if written.run.shows(time)]
            times = [time for time in times if first <= time <= written.run.times[-1]]
        if not times or (path.name not in TOPOLOGY and times[0] > first):
            times.insert(0, first)
        own = set(attribute.GetTimeSamples())
        values = (attribute.Get(time) if time in own else held_value(attribute, time) for time in times)
        values = (Sdf.ValueBlock() if value is None else value for value in values)
        size = _element_size(attribute)
        self._write(path, written, zip(times, values, strict=True), _interpolation(attribute), size)

    def _unify(self) -> None:
        """Let primvars and normals have one interpolation, and indices in all runs or in none."""
        paths = {path for written in self._done for path in written.interpolation}
        for path in sorted(paths):
            found = {written.interpolation[path] for written in self._done if path in written.interpolation}
            mixed = len(found) > 1
            index_path = path.ReplaceName(path.name + INDICES)
            indexed = self._has_indices(index_path)
            if mixed:
                self._layer.GetAttributeAtPath(path).SetInfo("interpolation", UsdGeom.Tokens.faceVarying)
            for index, written in enumerate(self._done):
                if path not in written.interpolation:
                    continue
                corners = _corner_elements(written, written.interpolation[path]) if mixed else None
                if path.name == "normals":
                    if corners is not None:
                        self._expand(path, written, index, corners)
                elif mixed or indexed:
                    self._index(path, index_path, written, index, corners)

    def _has_indices(self, path: Sdf.Path) -> bool:
        return path in self._authored and any(path not in written.blocked for written in self._done)

    def _span(self, path: Sdf.Path, index: int) -> list[float]:
        """Samples of an attribute in one run."""
        end = self._runs[index + 1].times[0] if index + 1 < len(self._runs) else np.inf
        start = self._runs[index].times[0] if index else -np.inf
        return [time for time in self._layer.ListTimeSamplesForPath(path) if start <= time < end]

    def _expand(self, path: Sdf.Path, written: _Written, index: int, corners: np.ndarray) -> None:
        for time in self._span(path, index):
            value = self._layer.QueryTimeSample(path, time)
            if not isinstance(value, Sdf.ValueBlock):
                self._set(path, time, from_numpy(np.array(value)[corners], value))

    def _index(
        self, path: Sdf.Path, index_path: Sdf.Path, written: _Written, index: int, corners: np.ndarray | None
    ) -> None:
        """Give a primvar indices in one run: those it has, of corners where it is to be faceVarying."""
        times = self._span(index_path, index) if index_path in self._authored else []
        own = {time: self._layer.QueryTimeSample(index_path, time) for time in times}
        own = {time: np.asarray(value) for time, value in own.items() if not isinstance(value, Sdf.ValueBlock)}
        if own and corners is None:
            return
        if not own:
            values = self._layer.QueryTimeSample(path, self._span(path, index)[0])
            size = _element_size(self._over.stage.GetAttributeAtPath(path))
            own = {written.run.times[0]: np.arange(len(values) // size, dtype=np.int32)}
        if not self._layer.GetAttributeAtPath(index_path):
            owner = self._layer.GetPrimAtPath(index_path.GetPrimPath())
            Sdf.AttributeSpec(owner, index_path.name, Sdf.ValueTypeNames.IntArray)
        self._authored.setdefault(index_path, set()).add(index)
        written.blocked.discard(index_path)
        for time, value in own.items():
            chosen = value if corners is None else value[corners]
            self._set(index_path, time, Vt.IntArray.FromNumpy(np.ascontiguousarray(chosen, dtype=np.int32)))

    def _set(self, path: Sdf.Path, time: float, value: Any) -> None:
        self._layer.SetTimeSample(path, time, value)
        self._over.count_sample(12 * len(value) if hasattr(value, "__len__") else 0)


def _prim_specs(spec: Sdf.PrimSpec) -> Iterator[Sdf.PrimSpec]:
    yield spec
    for child in spec.nameChildren:
        yield from _prim_specs(child)


def _first(layer: Sdf.Layer, path: Sdf.Path) -> Any:
    times = layer.ListTimeSamplesForPath(path)
    return layer.QueryTimeSample(path, times[0]) if times else layer.GetAttributeAtPath(path).default


def _interpolation(attribute: Usd.Attribute) -> str | None:
    """Interpolation of a primvar or of normals; None of other attributes."""
    if attribute.GetName() == "normals":
        return str(UsdGeom.PointBased(attribute.GetPrim()).GetNormalsInterpolation())
    return str(UsdGeom.Primvar(attribute).GetInterpolation()) if UsdGeom.Primvar.IsPrimvar(attribute) else None


def _element_size(attribute: Usd.Attribute) -> int:
    return int(UsdGeom.Primvar(attribute).GetElementSize()) if UsdGeom.Primvar.IsPrimvar(attribute) else 1


def _corner_elements(written: _Written, interpolation: str) -> np.ndarray | None:
    """The element of each corner of a run; None where corners are the elements."""
    if interpolation in POINT_INTERPOLATIONS:
        return np.asarray(written.faces)
    if interpolation == UsdGeom.Tokens.uniform:
        return np.repeat(np.arange(len(written.counts)), np.asarray(written.counts))
    return None
