"""Fewer influences, joints and blend shapes for a mesh while it is simplified, and what to say where more stay."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from warpqem.arguments.distance_limit import DistanceLimit
from warpqem.errors import MeshShapeError
from warpqem.pipeline.result import SimplifiedMesh
from warpqem.usd.commands.kept_mesh import wanted_changes
from warpqem.usd.commands.mesh_job import MeshJob
from warpqem.usd.commands.rig_bound import fewest_of_rig, simplify_with_fewer
from warpqem.usd.commands.rig_left import what_stays
from warpqem.usd.commands.rig_options import single
from warpqem.usd.commands.rig_steps import Rig, RigSteps, influence_steps
from warpqem.usd.commands.shape_reduction import MeshShapes, shape_tokens
from warpqem.usd.commands.simplify_options import SimplifyOptions
from warpqem.usd.commands.skin_bound import Attempt, interpolated, largest_diagonal, simplify_skinned, skin_holds
from warpqem.usd.commands.skin_fit import FittedMesh, SkinFitter, SkinPoses, has_linear_skin, skin_poses
from warpqem.usd.write.attribute_transfer import AttributeTransfer
from warpqem.usd.write.stage_report import PrimReport

__all__ = ["RigReduction"]


class RigReduction:
    """How the rig of one mesh is reduced.

    Args:
        job: the mesh.
        options: what is asked for.
        fitter: what fits its skin; None for none.
        limit: how far it may be from the input.
        report: gets notes.
        others: names of blend shapes that other meshes take from the same animation.
    """

    def __init__(
        self,
        job: MeshJob,
        options: SimplifyOptions,
        fitter: SkinFitter | None,
        limit: DistanceLimit,
        report: PrimReport,
        others: set[str],
    ) -> None:
        self._job, self._options, self._fitter, self._limit = job, options, fitter, limit
        self._report, self._others = report, others
        self._wanted = wanted_changes(job, options)
        self._poses = self._known_poses()
        self._fails = False

    def done(self, simplify: Callable[[float], SimplifiedMesh]) -> Attempt:
        """The mesh simplified by a share of the limit with which the rig of as little as may be holds the whole.

        Args:
            simplify: gets the share.
        """
        if self._limit and self._reduces:
            done = simplify_with_fewer(simplify, self._attempt)
        else:
            done = simplify_skinned(simplify, self._attempt)
        for line in what_stays(done, self._options, self._limit):
            self._note(line)
        return done

    @property
    def _reduces(self) -> bool:
        """Whether there is anything that a limit could give back."""
        joints = self._fitter is not None and self._fitter.reduces
        return joints or self._reduces_shapes or len(influence_steps(self._job.skin, self._influences)) > 1

    @property
    def _influences(self) -> int | None:
        return single(self._options.influences)

    @property
    def _reduces_shapes(self) -> bool:
        return self._options.reduces_shapes and self._job.skin is not None and bool(self._job.skin.shapes)

    def _known_poses(self) -> SkinPoses | None:
        """The poses of a mesh of which it can be calculated what its rig makes of it; None for others."""
        job = self._job
        if self._fitter is not None:
            return self._fitter.poses
        if not self._limit or job.skin is None or (job.examples or job.source).poser is None:
            return None
        # Without influences of single points the mesh moves as a whole.
        known = has_linear_skin(job) or (not job.skin.influences and bool(job.skin.shapes))
        return skin_poses(job, self._options) if known else None

    def _attempt(self, result: SimplifiedMesh) -> Attempt:
        job = self._job
        if not (self._wanted or job.is_simplified_by(result)):
            return Attempt(result, Rig())
        if self._poses is None and not self._reduces_shapes:
            return Attempt(result, Rig())
        transfer = job.transfer(result, self._options.device)
        steps = self._steps(result, transfer)
        asked = steps.at((0, 0, 0))
        if self._poses is None or self._fails or not self._limit:
            return Attempt(result, asked)
        diagonal = largest_diagonal(job)
        holds = partial(self._holds, self._poses, result, transfer, diagonal)
        return fewest_of_rig(result, steps, self._limit.relative(diagonal), holds)

    def _steps(self, result: SimplifiedMesh, transfer: AttributeTransfer) -> RigSteps:
        shapes = self._shapes(transfer)
        reduces_joints = self._fitter is not None and self._fitter.reduces
        limited = bool(self._limit) and self._poses is not None
        skins = partial(self._skins, result, transfer)
        return RigSteps.of_mesh(self._job, result, skins, self._options, shapes, limited, reduces_joints)

    def _shapes(self, transfer: AttributeTransfer) -> MeshShapes | None:
        """The blend shapes where some are to go."""
        skin = self._job.skin
        if skin is None or not self._reduces_shapes:
            return None
        tokens = shape_tokens(self._job)
        if len(tokens) != len(skin.shapes):
            self._note(
                f"all blend shapes stay, as skel:blendShapes has {len(tokens)} names and skel:blendShapeTargets "
                f"{len(skin.shapes)} targets"
            )
            return None
        return MeshShapes(self._job, skin, transfer.vertices(), self._options, self._others)

    def _skins(
        self, result: SimplifiedMesh, transfer: AttributeTransfer, most: int | None
    ) -> Sequence[FittedMesh | None]:
        """The skins with so many influences at most, of the fewest joints first."""
        device, skin = self._options.device, self._job.skin
        if self._fitter is None:
            linear = self._poses is not None and skin is not None and bool(skin.influences)
            return [interpolated(self._poses, result, transfer, most)] if linear and self._poses else [None]
        try:
            return self._fitter.fit_steps(result, transfer, most, device)
        except MeshShapeError as error:
            # What UsdSkel makes of the skin is not what its arrays say.
            self._fails = True
            self._report.skin = f"interpolated: {error}"
            if self._fitter.reduces:
                self._note(f"all joints stay, as its skin cannot be fitted: {error}")
            return [None]

    def _holds(
        self, poses: SkinPoses, result: SimplifiedMesh, transfer: AttributeTransfer, diagonal: float, rig: Rig
    ) -> bool:
        return skin_holds(poses, result, rig, transfer, self._limit, diagonal, self._options.device)

    def _note(self, text: str) -> None:
        line = f"{self._job.mesh.path}: {text}"
        if line not in self._report.notes:
            self._report.notes.append(line)
