"""Compare meshes of which one has, or both have, a topology that varies over time: run by run of constant topology."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom

from warpqem.errors import StageError
from warpqem.measure import Comparison, Measured, compare, distance_colors
from warpqem.measure.comparison import FrameErrors
from warpqem.measure.measured import ERRORS, first_frames, joined_errors
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.skeleton_poses import StagePoses
from warpqem.usd.read.time_codes import FrameRange
from warpqem.usd.read.topology_runs import TopologyRun, find_runs, open_run

__all__ = ["RunPair", "VaryingMesh", "combine", "pair_runs", "run_colors"]


@dataclass(frozen=True)
class VaryingMesh:
    """One of two meshes to compare.

    Attributes:
        prim: The mesh.
        poses: The skin bindings of its stage.
        runs: Its runs of constant topology; one for a mesh whose topology does not vary.
        constant: The mesh itself, if its topology does not vary.
    """

    prim: Usd.Prim
    poses: StagePoses
    runs: Sequence[TopologyRun]
    constant: MeshSource | None

    @classmethod
    def of(cls, prim: Usd.Prim, poses: StagePoses, constant: MeshSource | None) -> VaryingMesh:
        """A mesh; ``constant`` is None where its topology varies."""
        if constant is None:
            return cls(prim, poses, find_runs(UsdGeom.Mesh(prim)), None)
        times = tuple(constant.authored_times)
        return cls(prim, poses, [TopologyRun(-np.inf, np.inf, times)], constant)

    def run_at(self, time: float) -> int:
        """The run that it shows at a time."""
        return next(index for index, run in enumerate(self.runs) if run.shows(time))

    @contextmanager
    def source(self, run: int, times: Sequence[float]) -> Iterator[MeshSource]:
        """The mesh in one run, to be read at some times of it."""
        if self.constant is not None:
            yield self.constant
            return
        with open_run(self.prim, replace(self.runs[run], times=tuple(times))) as alone:
            yield MeshSource(alone, self.poses)


@dataclass(frozen=True)
class RunPair:
    """Frames in which neither of two meshes changes its topology: the run of each, and their times."""

    reference: int
    test: int
    times: list[float]


def pair_runs(reference: VaryingMesh, test: VaryingMesh, frames: FrameRange | None) -> list[RunPair]:
    """The frames of both meshes, parted where one of them changes its topology; those that show nothing are left out.

    Raises:
        StageError: there is no frame in the range, or only one of them shows something at a time.
    """
    sides = (reference, test)
    times = sorted({time for side in sides for run in side.runs for time in run.times})
    if frames is not None:
        times = frames.select(times)
    pairs: list[RunPair] = []
    for time in times:
        runs = [side.run_at(time) for side in sides]
        empty = [side.runs[run].is_empty for side, run in zip(sides, runs, strict=True)]
        if all(empty):
            continue
        if any(empty):
            which = "the reference" if empty[0] else "the test"
            raise StageError(f"{test.prim.GetPath()}: {which} mesh has no faces at time {time:g}, the other has")
        if pairs and [pairs[-1].reference, pairs[-1].test] == runs:
            pairs[-1].times.append(time)
        else:
            pairs.append(RunPair(runs[0], runs[1], [time]))
    if not pairs:
        raise StageError(f"{test.prim.GetPath()}.points: no sample in the frame range {frames}")
    return pairs


Meshes = tuple[npt.NDArray[np.float32], npt.NDArray[np.int32], npt.NDArray[np.float32], npt.NDArray[np.int32]]


def _read(reference: VaryingMesh, test: VaryingMesh, pair: RunPair) -> tuple[Meshes, npt.NDArray[np.int32], int]:
    """Points and faces of both in a run, the points in use of the test mesh, and how many it has."""
    with reference.source(pair.reference, pair.times) as first, test.source(pair.test, pair.times) as second:
        # A mesh that stands still in a run is the same at every time of it.
        meshes = [source.read(pair.times) for source in (first, second)]
        return (
            (meshes[0].points, meshes[0].right_handed_faces, meshes[1].points, meshes[1].right_handed_faces),
            meshes[1].used_points,
            second.point_count,
        )


def combine(
    reference: VaryingMesh,
    test: VaryingMesh,
    pairs: Sequence[RunPair],
    progress: Callable[[int, int], None],
    **options: Any,
) -> Comparison:
    """Compare run by run; the options are those of `warpqem.measure.compare`.

    Distances are as of one sequence; the 95th percentile of slide is the largest of a run. Jitter, slide and edge
    lengths are root mean squares over the runs that are long enough, as nothing goes on from one run to the next; the
    figures of the topologies are those of the first run.
    """
    found = []
    for index, pair in enumerate(pairs):
        meshes, _, _ = _read(reference, test, pair)

        def part(done: int, total: int, index: int = index) -> None:
            progress(index * total + done, len(pairs) * total)

        found.append(compare(*meshes, progress=part, **options))
    return _combined(found)


def _combined(found: Sequence[Comparison]) -> Comparison:
    starts = first_frames(found)
    joined = {
        field.name: np.concatenate([getattr(part.per_frame, field.name) for part in found])
        for field in fields(FrameErrors)
    }
    joined["frame"] = np.concatenate([part.per_frame.frame + start for part, start in zip(found, starts, strict=True)])
    per_frame = FrameErrors(**joined)
    return replace(
        found[0],
        **asdict(joined_errors([Measured(**{name: getattr(part, name) for name in ERRORS}) for part in found])),
        per_frame=per_frame,
        jitter=_root_mean_square(found, "jitter"),
        slide=_root_mean_square(found, "slide"),
        slide_p95=max((part.slide_p95 for part in found if part.slide_p95 is not None), default=None),
        edge_length_error=_root_mean_square(found, "edge_length_error") or 0.0,
    )


def _root_mean_square(found: Sequence[Comparison], name: str) -> float | None:
    parts = [(getattr(part, name), part.frame_count) for part in found if getattr(part, name) is not None]
    if not parts:
        return None
    values, weights = np.array(parts, dtype=np.float64).T
    return float(np.sqrt((values**2 * weights).sum() / weights.sum()))


def run_colors(
    reference: VaryingMesh, test: VaryingMesh, pairs: Sequence[RunPair], scale: float | None, device: str | None
) -> tuple[list[npt.NDArray[np.float32]], float]:
    """Colours (points, 3) of each frame for the distance from the reference, black at unused points; their scale."""
    if scale is None:
        found = [distance_colors(*_read(reference, test, pair)[0], device=device)[1] for pair in pairs]
        scale = max(found)
    colors = []
    for pair in pairs:
        meshes, used, point_count = _read(reference, test, pair)
        own, _ = distance_colors(*meshes, scale=scale or None, device=device)
        for pose in own:
            spread = np.zeros((point_count, 3), dtype=np.float32)
            spread[used] = pose
            colors.append(spread)
    return colors, float(scale)
