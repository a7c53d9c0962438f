"""The page of a progressive mesh, whose levels are taken out of it when they are asked for."""

from __future__ import annotations

import itertools
import math
import statistics
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from warpqem.errors import DegenerateMeshError, ProgressiveFileError
from warpqem.measure import vertex_distances
from warpqem.progressive import ProgressiveMesh
from warpqem.progressive.stage_notes import StageNotes
from warpqem.report.content import Report
from warpqem.report.data import SCALE_QUANTILE, chosen_frames, report_data, scale_end
from warpqem.report.encoding import Grid
from warpqem.report.mesh_data import mesh_data

__all__ = ["LiveLevels"]

# Stops of the slider: from one to the next the faces change by about a tenth in the usual range of 1 to 100 %.
STOPS = 48
# The page opens with about so many of the faces: the difference shows, and the level is packed in a moment.
FIRST_SHARE = 0.1
# Levels that are kept packed.
KEPT_LEVELS = 64


class LiveLevels:
    """A progressive mesh as the data of a page, level by level.

    Attributes:
        splits: splits of each stop of the slider, the finest first.
    """

    def __init__(self, mesh: ProgressiveMesh, title: str, extra: Mapping[str, Any], device: str | None = None) -> None:
        """Take the finest level out.

        Args:
            mesh: all of it.
            title: heading of the page.
            extra: what a file of `warpqem progressive build` holds beside it: "times" and "stage"; may be empty.
            device: Warp device; None for the default.

        Raises:
            DegenerateMeshError: there are no faces, or no extent in any frame.
        """
        self._mesh, self._title, self._device = mesh, title, device
        self._notes = StageNotes(title, extra, mesh.frame_count)
        if not mesh.face_count:
            raise DegenerateMeshError(f"{title}: the mesh has no faces to show")
        full = mesh.level(mesh.split_count)
        shown = chosen_frames(mesh.frame_count, 2 * full.points.shape[1])
        self._shown = slice(0, None, shown.step)
        self._points, self._faces = full.points[self._shown], full.faces
        if not np.ptp(self._points, axis=1).any():
            raise DegenerateMeshError(f"{title}: the mesh has no extent in any frame")
        self._grid = Grid.around(self._points)
        faces = np.geomspace(max(mesh.base_face_count, 1), mesh.face_count, STOPS)
        stops = {mesh.splits_for(target_faces=int(np.ceil(count))) for count in faces}
        # A base mesh may have no faces at all, which no page can show.
        counts = mesh.topology.face_counts()
        self.splits = sorted((split for split in stops if counts[split]), reverse=True)
        # One level at a time is cheap to keep and slow to pack.
        self._packed: Callable[[int], dict[str, Any]] = lru_cache(KEPT_LEVELS)(self._pack)

    def data(self) -> dict[str, Any]:
        """The data of the page, see `report_data`; levels have the address ``level/INDEX`` instead of a mesh.

        Raises:
            ProgressiveFileError: what ``extra`` holds of times and stage is not what a build adds.
            DeviceError: there is no such device.
        """
        own, rate, up = self._times_and_units()
        notes = [f"{len(self._points)} of {self._mesh.frame_count} frames are shown."] if self._shown.step > 1 else []
        report = Report(
            title=self._title,
            points=self._points,
            faces=self._faces,
            levels=(),
            times=own,
            frames_per_second=rate,
            up=up,
            notes=notes,
        )
        found = report_data(report, self._device)
        counts = self._mesh.topology.face_counts()
        levels = [(int(counts[split]), self._mesh.error(split)) for split in self.splits]
        found["levels"] = [
            {
                "name": f"{100 * faces / self._mesh.face_count:.3g} %",
                "faces": faces,
                "mesh": None,
                "url": f"level/{index}",
                "has": {"heat": True},
            }
            for index, (faces, _) in enumerate(levels)
        ]
        shares = np.array([faces / self._mesh.face_count for faces, _ in levels])
        first = int(np.abs(np.log(shares / FIRST_SHARE)).argmin())
        found["firstLevel"] = first
        # The page asks for it at once.
        end = self.level(first)["heatEnd"]
        # Levels much coarser are yellow all over, and the legend says from where on.
        found["heatEnd"] = scale_end([end])
        found["curve"] = {"faces": [faces for faces, _ in levels], "error": [error for _, error in levels]}
        return found

    def _times_and_units(self) -> tuple[list[float] | None, float, str]:
        """Time of each frame that is shown, how many a second, and the axis that points up."""
        notes = self._notes
        times = notes.times() if "times" in notes.extra else None
        units = notes.units() if "stage" in notes.extra else None
        own = None if times is None else times[self._shown]
        codes = 24.0 if units is None else units.time_codes_per_second
        # Python's numbers, which overflow without a warning.
        steps = [after - before for before, after in itertools.pairwise(own or ())]
        rate = codes / (statistics.median(steps) if steps else 1.0)
        if not 0.0 < rate < math.inf:
            raise ProgressiveFileError(f"{self._title}: times and {codes:g} time codes a second give {rate:g} frames")
        return own, rate, "y" if units is None else units.up_axis.lower()

    def level(self, index: int) -> dict[str, Any]:
        """What the page adds to a level when it is asked for.

        Raises:
            IndexError: there is no such stop.
        """
        if not 0 <= index < len(self.splits):
            raise IndexError(f"there are {len(self.splits)} levels, not {index}")
        return self._packed(index)

    def _pack(self, index: int) -> dict[str, Any]:
        level = self._mesh.level(self.splits[index])
        points = level.points[self._shown]
        distance = vertex_distances(self._points, self._faces, points, level.faces, device=self._device)
        return {
            "mesh": mesh_data(points, level.faces, self._grid, None, distance),
            "heatEnd": float(np.quantile(distance, SCALE_QUANTILE)),
        }
