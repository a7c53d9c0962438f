"""``joints``: fewer joints by the error over the poses, against joints that go from the leaves of the skeleton.

Fitted to every second frame of a clip, measured on frames between them. Both ways solve rest positions and weights
again after each joint, with the same solver and the same substitutes; they differ in which joint goes. *Leaf* takes the
deepest leaf, of several the one that costs least, as engines do by rule; *best leaf* the leaf that costs least.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import cast

import numpy as np

import warpqem
from benchmarks.articulated import SCENE, SkinnedClip, read_clip
from benchmarks.machine import describe_machine
from benchmarks.report import Column, Report, Row, Table
from benchmarks.settings import Settings
from warpqem.errors import UnreachableTargetError
from warpqem.measure import compare
from warpqem.pipeline.result import SimplifiedMesh
from warpqem.pipeline.surface_transfer import surface_transfer
from warpqem.runtime.device import resolve_device
from warpqem.skinning.fit_skin import prepare_fit
from warpqem.skinning.joint_course import JointsGone, choose_joints, joint_removal, reduced_skin
from warpqem.skinning.leaf_order import next_leaf
from warpqem.skinning.linear_skin import LinearSkin, blend_influences, pose_skin
from warpqem.skinning.reduce_joints import RemovalPlan, joint_steps

__all__ = ["run"]

RATIOS, QUICK_RATIOS = (0.25, 0.1), (0.1,)
# Poses to fit to and to measure on, at most.
FITTED, MEASURED, QUICK_POSES = 32, 16, 4
SAMPLES = 4000
# The order of removal in the first column decides the counts of the rows.
ORDERS = ("error", "leaf", "best leaf")
INFLUENCES = (8, 4, 2, 1)

COLUMNS = (
    Column("joints", "joints", "d"),
    Column("fit", "beyond the placement", ".4f"),
    Column("error", "by error", ".4f"),
    Column("leaf", "leaf first", ".4f"),
    Column("best leaf", "best leaf first", ".4f"),
)
INFLUENCE_COLUMNS = (
    Column("influences", "influences", "d"),
    Column("fitted", "fitted", ".4f"),
    Column("largest", "largest weights alone", ".4f"),
)


def run(settings: Settings) -> Report:
    """Errors on frames that were not fitted, by the number of joints and of influences."""
    path = SCENE if settings.usd is None else settings.usd
    clip = read_clip(path, settings.prim, shapes=True)
    report = Report("joints", "Fewer joints, by error and from the leaves", describe_machine(["warpqem"]))
    for ratio in QUICK_RATIOS if settings.quick else RATIOS:
        study = _Study(clip, ratio, settings)
        title = f"{path.name}, {len(study.result.faces)} faces, {len(study.result.points[0])} vertices: RMS %"
        rows = list(study.joints())
        report.tables.append(Table(f"{title}; by error in {study.seconds:.1f} s of CPU time", COLUMNS, rows))
        report.tables.append(Table(title, INFLUENCE_COLUMNS, list(study.influences())))
    return report


class _Study:
    """One clip at one ratio."""

    def __init__(self, clip: SkinnedClip, ratio: float, settings: Settings) -> None:
        self._clip, self._device, self.seconds = clip, resolve_device(settings.device), 0.0
        count = len(clip.transforms)
        fitted, measured = (QUICK_POSES, QUICK_POSES) if settings.quick else (FITTED, MEASURED)
        self._seen, self._unseen = (_spread(np.arange(first, count, 2), n) for first, n in ((0, fitted), (1, measured)))
        rest = np.broadcast_to(np.eye(4)[:3], (1, *clip.transforms.shape[1:]))
        self._transforms = np.concatenate([rest, clip.transforms[self._seen]])
        self._offsets = None
        if clip.offsets is not None:
            self._offsets = np.concatenate([np.zeros_like(clip.offsets[:1]), clip.offsets[self._seen]])
        self._poses = pose_skin(clip.skin, self._transforms, self._offsets).astype(np.float32)
        self._test = self._posed(clip.skin, clip.offsets)
        self.result = self._simplified(ratio)
        self._new_offsets = self._offsets_of_result()

    def joints(self) -> Iterator[Row]:
        """A row for each number of joints."""
        curves = [self._curve(order) for order in ORDERS]
        for count in sorted(curves[0], reverse=True):
            row: Row = {"joints": count, "fit": curves[0][count][0]}
            for order, curve in zip(ORDERS, curves, strict=True):
                # A count that an order jumped over has the error of the next lower one.
                reached = [number for number in curve if number <= count]
                row[order] = curve[max(reached)][1] if reached else None
            yield row

    def influences(self) -> Iterator[Row]:
        """A row for each limit on the joints of a vertex."""
        for limit in INFLUENCES:
            skins = []
            for most in (limit, max(INFLUENCES)):
                fitted = warpqem.skinning.fit_skin(
                    self._poses,
                    self._clip.faces,
                    self.result,
                    self._clip.skin,
                    self._transforms,
                    influences=most,
                    offsets=self._offsets,
                    device=self._device,
                )
                skins.append(fitted.skin)
            rows = np.arange(len(skins[1].rest))[:, None]
            cut = blend_influences(skins[1].joints, skins[1].weights, rows, np.ones(rows.shape), limit)
            largest = LinearSkin(skins[1].rest, *cut)
            yield {"influences": limit, "fitted": self._error(skins[0]), "largest": self._error(largest)}

    def _curve(self, order: str) -> dict[int, tuple[float, float]]:
        """By the number of joints: the error beyond the placement on fitted poses, and RMS on others, in %."""
        start = time.process_time()
        given = (self._poses, self._clip.faces, self.result, self._clip.skin, self._transforms)
        prepared = prepare_fit(*given, None, None, self._offsets, None, None, True, self._device)
        parents, every = self._clip.parents, np.ones(len(self._clip.parents), dtype=bool)
        if order == "error":
            plan = RemovalPlan(choose_joints(prepared, parents, every, 1))
            # At each count the better way, as `reduce_joints` takes it.
            counts = range(joint_removal(prepared, parents)[0].used().size, 0, -1)
            ways = [joint_steps(prepared, parents, every, count, np.inf, plan)[0][0] for count in counts]
            self.seconds = time.process_time() - start
            return {len(way.used): (float(way.errors[-1]), self._error(way.skin)) for way in ways}
        removal, size = joint_removal(prepared, parents)
        gone = JointsGone(removal)
        skins = [reduced_skin(prepared, removal)]
        while len(gone.used) > 1:
            joint = next_leaf(removal, parents, deepest=order == "leaf")
            assert joint is not None
            gone.remove(joint, exchanges=False)
            skins.append(reduced_skin(prepared, removal))
        fit = 100.0 * np.sqrt(np.array(gone.misses) / size)
        curve = zip(gone.counts, fit, skins, strict=True)
        return {count: (float(error), self._error(skin)) for count, error, skin in curve}

    def _simplified(self, ratio: float) -> SimplifiedMesh:
        try:
            return warpqem.simplify(self._poses, self._clip.faces, ratio=ratio, device=self._device)
        except UnreachableTargetError as error:
            # Pieces of a mesh none of which may go.
            return cast(SimplifiedMesh, error.result)

    def _offsets_of_result(self) -> np.ndarray | None:
        """What blend shapes add to the simplified rest shape in the frames that are measured."""
        if self._clip.offsets is None:
            return None
        transfer = surface_transfer(self._poses[0], self._clip.faces, self.result, device=self._device)
        return np.stack([transfer.from_vertices(self._clip.offsets[frame]) for frame in self._unseen])

    def _posed(self, skin: LinearSkin, offsets: np.ndarray | None) -> np.ndarray:
        own = None if offsets is None else offsets[self._unseen]
        return pose_skin(skin, self._clip.transforms[self._unseen], own).astype(np.float32)

    def _error(self, skin: LinearSkin) -> float:
        posed = pose_skin(skin, self._clip.transforms[self._unseen], self._new_offsets).astype(np.float32)
        faces = (self._clip.faces, self.result.faces)
        return compare(self._test, faces[0], posed, faces[1], samples=SAMPLES, device=self._device).rms


def _spread(items: np.ndarray, count: int) -> np.ndarray:
    """At most so many of the items, evenly spread."""
    return np.asarray(items[np.unique(np.linspace(0, len(items) - 1, count).round().astype(int))])
