"""``articulated``: is it worth to order the collapses of a skinned mesh by ``E(v, a)``, which the fit minimises?

Ordered and fitted on the first half of a clip's poses, measured on the second. Every order goes through the placing,
the refit and the fit of warpqem, so that rows differ in the order alone. UV seams are left aside.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import warp as wp

import warpqem
from benchmarks.machine import describe_machine
from benchmarks.report import Column, Report, Row, Table
from benchmarks.settings import Settings
from benchmarks.skin_collapse import Collapsed, collapse_edges
from benchmarks.skin_order import JointOrder, PoseOrder
from warpqem.decimation.collapse_log import CollapseRecord
from warpqem.errors import UnreachableTargetError
from warpqem.frames.blocks import pack_frames
from warpqem.kernels.lanes import QUADRIC, width_of
from warpqem.measure import compare
from warpqem.mesh.mesh_input import is_proper, read_mesh
from warpqem.options import MeshOptions
from warpqem.pipeline.key_frames import KeyFrameChoice
from warpqem.pipeline.prepare import prepare
from warpqem.pipeline.result import SimplifiedMesh, finish
from warpqem.runtime.device import resolve_device
from warpqem.skinning.linear_skin import LinearSkin, pose_skin

__all__ = ["SkinnedClip", "read_clip", "run"]

SCENE = Path(__file__).parent.parent / "scenes" / "quadruped_gallop.usdc"
RATIOS, QUICK_RATIOS = (0.25, 0.1, 0.05), (0.1,)
# Poses to fit to and to measure on, at most; joints that move a vertex at most, as most game engines have it.
POSES, QUICK_POSES, INFLUENCES = 16, 4, 4
SAMPLES = 4000

COLUMNS = (
    Column("faces", "faces", "d"),
    Column("quadrics", "quadrics"),
    Column("order", "order"),
    Column("own", "own skin", ".4f"),
    Column("fit", "fitted", ".4f"),
    Column("refit", "refitted, fitted", ".4f"),
    Column("seconds", "order s", ".1f"),
)


@dataclass(frozen=True)
class SkinnedClip:
    """A skin whose rest shape has unit diagonal, and its motion.

    Attributes:
        skin: the skin of V vertices.
        faces: (N, 3).
        transforms: (F, J, 3, 4).
        parents: (J,), the joint above each.
        offsets: (F, V, 3), what blend shapes add to the rest shape; None without any.
    """

    skin: LinearSkin
    faces: np.ndarray
    transforms: np.ndarray
    parents: np.ndarray
    offsets: np.ndarray | None

    def poses(self, transforms: np.ndarray) -> np.ndarray:
        """(P, V, 3) float32."""
        return pose_skin(self.skin, transforms).astype(np.float32)

    def halves(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Transforms of the rest shape and of far poses of the first half, and of poses of the second half."""
        half = len(self.transforms) // 2
        first, second = self.transforms[:half], self.transforms[half:]
        poses = self.poses(first)
        choice = KeyFrameChoice(read_mesh(poses, self.faces), count)
        choice.observe(slice(0, half), poses)
        rest = np.broadcast_to(np.eye(4)[:3], (1, *first.shape[1:]))
        spread = np.unique(np.linspace(0, len(second) - 1, count).round().astype(int))
        return np.concatenate([rest, first[choice.choose()]]), second[spread]


def read_clip(path: Path, prim: str | None = None, shapes: bool = False) -> SkinnedClip:
    """Read a mesh with a linear skin, the one with the most faces if none is named.

    Raises:
        ValueError: it has another skin, or blend shapes, unless they are asked for.
    """
    from pxr import Usd

    from warpqem.usd.commands.mesh_job import MeshJob
    from warpqem.usd.commands.skin_fit import SkinPoses, why_not_fitted
    from warpqem.usd.read.open_stage import find_meshes, open_stage
    from warpqem.usd.read.read_mesh import MeshSource
    from warpqem.usd.read.skeleton_poses import StagePoses
    from warpqem.usd.read.skin_poses import joint_parents, joint_transforms, shape_offsets

    stage = open_stage(path)
    poses = StagePoses(stage)
    prims = find_meshes(stage, () if prim is None else (prim,)).prims
    jobs = [MeshJob.prepare(MeshSource(found, poses)) for found in prims]
    job = max(jobs, key=lambda each: len(each.faces))
    reason = "it has no skin" if job.skin is None else why_not_fitted(job.skin, job.source)
    if reason is not None:
        raise ValueError(f"{path}: {job.mesh.path} cannot be fitted: {reason}")
    times = job.source.frame_times(None)
    codes = [Usd.TimeCode.Default()] if times is None else [Usd.TimeCode(time) for time in times]
    given = SkinPoses(job, job.source, times)
    if given.poser.blend_shape_query is not None and not shapes:
        raise ValueError(f"{path}: {job.mesh.path} has blend shapes, which this benchmark does not know")
    transforms = given.fit.moved(joint_transforms(given.poser, codes))
    faces = job.faces[is_proper(job.faces)]
    used, index = np.unique(faces, return_inverse=True)
    rest = job.frames.read(slice(0, 1))[0].astype(np.float64)
    skin = given.skin(rest).checked(transforms.shape[1])
    diagonal = float(np.linalg.norm(np.ptp(rest[used], axis=0)))
    transforms[..., 3] /= diagonal
    weights = skin.weights[used] / skin.weights[used].sum(axis=1, keepdims=True)
    own = LinearSkin(rest[used] / diagonal, skin.joints[used], weights)
    offsets = shape_offsets(given.poser, job.skin.rest_points, codes)
    if offsets is not None:
        offsets = offsets[:, given.vertex_point[used]] * (given.fit.scale / diagonal)
    index = index.reshape(-1, 3).astype(np.int32)
    return SkinnedClip(own, index, transforms, joint_parents(given.poser), offsets)


def run(settings: Settings) -> Report:
    """Errors of skins ordered by warpqem, by poses and by ``E(v, a)`` on the poses that no one saw."""
    path = SCENE if settings.usd is None else settings.usd
    clip = read_clip(path, settings.prim)
    report = Report("articulated", "Order of collapses by E(v, a)", describe_machine(["warpqem"]))
    study = _Study(clip, settings)
    report.tables.append(Table(f"{path.name}, {len(clip.faces)} faces: RMS %", COLUMNS, list(study.rows())))
    return report


class _Study:
    """All orders of one clip."""

    def __init__(self, clip: SkinnedClip, settings: Settings) -> None:
        self._clip, self._device = clip, resolve_device(settings.device)
        self._seen, self._unseen = clip.halves(QUICK_POSES if settings.quick else POSES)
        self._poses, self._test = clip.poses(self._seen), clip.poses(self._unseen)
        self._targets = [int(ratio * len(clip.faces)) for ratio in (QUICK_RATIOS if settings.quick else RATIOS)]
        # The largest error of a collapse at a target, which bounds what the refit pairs.
        self._error: dict[int, float] = {}

    def rows(self) -> Iterator[Row]:
        """A row for each order and target."""
        for memoryless in (False, True):
            quadrics = "of present faces" if memoryless else "summed"
            for target in self._targets:
                yield {"quadrics": quadrics, "order": "warpqem", **self._of_product(target, memoryless)}
            joint = JointOrder(self._clip.skin, self._seen, self._clip.faces, INFLUENCES, self._device, memoryless)
            for name, order in (("poses", PoseOrder(self._poses, self._clip.faces, memoryless)), ("E(v, a)", joint)):
                begin = time.perf_counter()
                levels = collapse_edges(order, self._clip.faces, self._targets)
                for target, left in zip(self._targets, levels, strict=True):
                    seconds = time.perf_counter() - begin
                    errors = self._of_order(order, left, target)
                    yield {"quadrics": quadrics, "order": name, "seconds": seconds, **errors}

    def _of_product(self, target: int, memoryless: bool) -> Row:
        row: dict[str, float | int] = {}
        for refit in (False, True):
            result = self._simplified(target, refit=refit, memoryless=memoryless)
            self._error[target] = result.error / 100.0
            row |= {"faces": len(result.faces), "refit" if refit else "fit": self._fitted_error(result, refit)}
        return row

    def _simplified(self, target: int, **options: bool) -> SimplifiedMesh:
        goal = {"target_faces": target, "key_frames": None, "keep_components": True, "device": self._device}
        try:
            return warpqem.simplify(self._poses, self._clip.faces, **goal, **options)
        except UnreachableTargetError as error:
            # Pieces of a mesh none of which may go.
            return error.result

    def _of_order(self, order: PoseOrder, left: Collapsed, target: int) -> Row:
        row: dict[str, float | int] = {"faces": len(left.faces)}
        if isinstance(order, JointOrder):
            row["own"] = self._error_of(order.skin(left.vertex, INFLUENCES), left.faces)
        for refit in (False, True):
            row["refit" if refit else "fit"] = self._fitted_error(self._placed(order, left, target, refit), refit)
        return row

    def _fitted_error(self, result: SimplifiedMesh, refit: bool) -> float:
        fitted = warpqem.skinning.fit_skin(
            self._poses,
            self._clip.faces,
            result,
            self._clip.skin,
            self._seen,
            influences=INFLUENCES,
            to_planes=not refit,
            device=self._device,
        )
        return self._error_of(fitted.skin, result.faces)

    def _error_of(self, skin: LinearSkin, faces: np.ndarray) -> float:
        posed = pose_skin(skin, self._unseen).astype(np.float32)
        return compare(self._test, self._clip.faces, posed, faces, samples=SAMPLES, device=self._device).rms

    def _placed(self, order: PoseOrder, left: Collapsed, target: int, refit: bool) -> SimplifiedMesh:
        """The mesh that an order left, placed as warpqem places its own."""
        options = MeshOptions(target_faces=len(self._clip.faces), key_frames=None, device=self._device)
        work = prepare(self._poses, self._clip.faces, options)
        scale, p, given = 1.0 / work.mesh.diagonal, order.posed, order.quadrics
        slope = np.einsum("vpij,vpj->vpi", given.A, p) + given.b
        rest = np.maximum(((slope + given.b) * p).sum(axis=2) + given.c, 0.0)
        upper = given.A[..., [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
        packed = np.concatenate([upper * scale**2, slope * scale**3, rest[..., None] * scale**4], axis=2)
        points = np.ascontiguousarray(p.transpose(1, 0, 2), dtype=np.float32)
        position = pack_frames(points, self._device, centre=work.mesh.centre, scale=scale)
        width = width_of(position)
        values = np.zeros((len(p), position.shape[1] * width, 10), dtype=np.float32)
        values[:, : p.shape[1]] = packed
        blocks = np.ascontiguousarray(values.reshape(len(p), -1, width, 10).swapaxes(2, 3))
        # Of the log of collapses only the largest error is read.
        whole = work.order()
        log = CollapseRecord(**{**vars(whole.log.head(0)), "error": np.array([self._error[target]], dtype=np.float32)})
        root = np.where(left.vertex_map >= 0, left.vertex[left.vertex_map], -1).astype(np.int32)
        ordered = replace(
            whole,
            faces=root[self._clip.faces[left.face_map]],
            face_map=left.face_map,
            root=root,
            row=np.arange(len(p), dtype=np.int32),
            position=position,
            quadric=wp.array(blocks, dtype=QUADRIC[width], device=self._device),
            log=log,
        )
        return finish(work, ordered, refit)
