"""What moves a simplified mesh: its skin and blend shapes, with as little as is asked for, and with more and more."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from warpqem.pipeline.result import SimplifiedMesh
from warpqem.skinning.reduce_joints import MAX_STEPS as JOINT_STEPS
from warpqem.skinning.reduce_shapes import MAX_STEPS as SHAPE_STEPS
from warpqem.usd.commands.mesh_job import MeshJob
from warpqem.usd.commands.rig_options import RigOptions, single
from warpqem.usd.commands.shape_reduction import MeshShapes, ShapeReduction
from warpqem.usd.commands.skin_fit import FittedMesh
from warpqem.usd.read.mesh_skin import Skin

__all__ = ["Place", "Rig", "RigSteps", "influence_steps"]

# A step of influences, one of joints and one of blend shapes, each from 0, as few as are asked for.
Place = tuple[int, int, int]
Skins = Callable[[int | None], Sequence[FittedMesh | None]]


@dataclass(frozen=True)
class Rig:
    """What moves a simplified mesh.

    Attributes:
        fitted: its skin; None for one to interpolate, and for a mesh that no joints of its own move.
        shapes: its blend shapes where some are to go; None where all stay.
        influences: joints that move a point at most; None for as many as in the input.
        keeps_influences: whether a limit leaves as many as in the input.
    """

    fitted: FittedMesh | None = None
    shapes: ShapeReduction | None = None
    influences: int | None = None
    keeps_influences: bool = False

    def written(self, skin: Skin) -> Skin:
        """The skin of the mesh with what is left."""
        if self.fitted is not None:
            skin = self.fitted.written(skin)
        return skin if self.shapes is None else self.shapes.written(skin)

    @property
    def added_error(self) -> float:
        """RMS distance over the poses that joints and blend shapes add that went, in %, as far as it is known."""
        joints = None if self.fitted is None else self.fitted.joints
        shapes = None if self.shapes is None else self.shapes.report
        return max(0.0 if joints is None else joints.added_error, 0.0 if shapes is None else shapes.used_error)

    @property
    def counts(self) -> tuple[int, int, int]:
        """Influences, joints and blend shapes that are left; 0 where all of them stay."""
        joints = None if self.fitted is None else self.fitted.joints
        shapes = None if self.shapes is None else self.shapes.report
        return self.influences or 0, 0 if joints is None else joints.after, 0 if shapes is None else shapes.after


class RigSteps:
    """Rigs of one simplified mesh, each made when it is asked for.

    Args:
        influences: joints that move a point at most, at each step.
        skins: the skins with so many influences, of the fewest joints first.
        joint_steps: steps of joints.
        shapes: the blend shapes along their removal with a skin, of the fewest first; None where none go.
        shape_steps: steps of them.

    Attributes:
        sizes: steps of influences, of joints and of blend shapes.
    """

    def __init__(
        self,
        influences: Sequence[int | None],
        skins: Skins,
        joint_steps: int = 1,
        shapes: Callable[[FittedMesh | None, int], Sequence[ShapeReduction]] | None = None,
        shape_steps: int = 1,
    ) -> None:
        self.sizes: Place = (len(influences), joint_steps, shape_steps)
        self._influences, self._make_skins, self._make_shapes = influences, skins, shapes
        self._skins: dict[int, Sequence[FittedMesh | None]] = {}
        self._shapes: dict[tuple[int, int], Sequence[ShapeReduction]] = {}

    @classmethod
    def of_mesh(
        cls,
        job: MeshJob,
        result: SimplifiedMesh,
        skins: Skins,
        options: RigOptions,
        shapes: MeshShapes | None,
        limited: bool,
        reduces_joints: bool,
    ) -> RigSteps:
        """Those of a mesh.

        Args:
            job: the mesh.
            result: what came of it.
            skins: its skins with so many influences.
            options: what is asked for.
            shapes: its blend shapes; None where all stay.
            limited: whether there is a limit, which may ask for more than the fewest.
            reduces_joints: whether `skins` has several steps.
        """

        def shapes_of(fitted: FittedMesh | None, most: int) -> list[ShapeReduction]:
            assert shapes is not None
            rest = job.rest_shape(result)[0] if fitted is None else fitted.rest_points
            return shapes.steps(rest, result.faces, most)

        given = single(options.influences)
        return cls(
            influence_steps(job.skin, given) if limited else [given],
            skins,
            JOINT_STEPS if limited and reduces_joints else 1,
            None if shapes is None else shapes_of,
            SHAPE_STEPS if limited and shapes is not None else 1,
        )

    @property
    def last(self) -> Place:
        """Where everything stays."""
        influences, joints, shapes = self.sizes
        return influences - 1, joints - 1, shapes - 1

    def at(self, place: Place) -> Rig:
        """The rig at a step of each."""
        row, column, layer = place
        if row not in self._skins:
            self._skins[row] = self._make_skins(self._influences[row])
        skins = self._skins[row]
        index = _scaled(column, self.sizes[1], len(skins))
        most, keeps = self._influences[row], 0 < row == self.sizes[0] - 1
        if self._make_shapes is None:
            return Rig(skins[index], None, most, keeps)
        key = row, index
        if key not in self._shapes:
            self._shapes[key] = self._make_shapes(skins[index], 1 if self.sizes[2] == 1 else SHAPE_STEPS)
        shapes = self._shapes[key]
        return Rig(skins[index], shapes[_scaled(layer, self.sizes[2], len(shapes))], most, keeps)


def influence_steps(skin: Skin | None, given: int | None) -> list[int | None]:
    """Limits on the joints of a point from the one that is given to the one that takes nothing away."""
    if skin is None or given is None:
        return [given]
    return [*range(given, max(given, skin.influence_count) + 1)]


def _scaled(step: int, size: int, count: int) -> int:
    """The place among so many that a step among `size` of them stands for: the first and the last are the same."""
    return 0 if size == 1 else -(-step * (count - 1) // (size - 1))
