"""Fewer blend shapes for a simplified mesh, see `warpqem.skinning.reduce_shapes`, and the weights of its animation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from pxr import Sdf, Usd, UsdSkel, Vt

from warpqem.errors import StageError
from warpqem.skinning.reduce_shapes import MAX_STEPS, ReducedShapes, ShapeGoals, shape_steps
from warpqem.skinning.shape_problem import weight_range
from warpqem.usd.commands.mesh_job import MeshJob
from warpqem.usd.commands.rig_options import RigOptions, single
from warpqem.usd.read.blend_shapes import ShapeData
from warpqem.usd.read.mesh_skin import Skin
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.write.attribute_transfer import Rows
from warpqem.usd.write.stage_report import ShapesReport

__all__ = ["MeshShapes", "ShapeReduction", "shape_tokens"]

# Attributes of a BlendShape prim are told apart by their namespace.
INBETWEEN = "inbetweens:"
# Normal offsets belong to unit normals; smaller ones turn nothing.
MIN_NORMAL_OFFSET = 1e-4
# Points that move by less than this share of the diagonal stand still.
MIN_OFFSET = 1e-4


@dataclass(frozen=True)
class ShapeReduction:
    """What came of the blend shapes of a mesh.

    Attributes:
        shapes: those that stay.
        removed_shapes: the BlendShape prims of those that went.
        report: which went.
        done: how weight goes from shape to shape.
        tokens: names of all shapes before.
        lower: smallest weights of those that stay.
        upper: largest weights of them.
        notes: what is worth knowing about how they were chosen.
    """

    shapes: list[ShapeData]
    removed_shapes: tuple[Sdf.Path, ...]
    report: ShapesReport
    done: ReducedShapes
    tokens: list[str]
    lower: npt.NDArray[np.float64]
    upper: npt.NDArray[np.float64]
    notes: list[str]

    def written(self, skin: Skin) -> Skin:
        """The skin of the mesh with the shapes that stay."""
        order = tuple(self.tokens[index] for index in self.done.kept)
        return replace(skin, shapes=self.shapes, shape_order=order, removed_shapes=self.removed_shapes)

    def changed(self, weights: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """The weights (S,) of all shapes that move as much as the corrected ones of those that stay, as they are."""
        found = np.zeros(len(self.tokens))
        new = self.done.corrected(_padded(weights, len(self.tokens)), self.upper, self.lower)
        found[self.done.kept] = new * self.done.scales
        return found

    def correct_animation(self, stage: Usd.Stage, source: MeshSource) -> Callable[[], None] | None:
        """Author the weights that shapes take over from others, at the times of the animation.

        Args:
            stage: stage whose edit target takes the edits.
            source: the mesh on the input.

        Returns:
            What takes that back; None where nothing had to be authored.
        """
        animation = _animation(source)
        changes = {
            self.tokens[heir]
            for column, heir in enumerate(self.done.kept)
            if (np.delete(self.done.parts[:, column], heir) > 0).any()
        }
        if animation is None or not changes:
            return None
        prim = UsdSkel.Animation(stage.GetPrimAtPath(animation.GetPath()))
        names = list(prim.GetBlendShapesAttr().Get())
        columns = [names.index(token) if token in names else -1 for token in self.tokens]
        attribute = UsdSkel.Animation(stage.OverridePrim(prim.GetPath())).GetBlendShapeWeightsAttr()
        codes = [Usd.TimeCode(time) for time in attribute.GetTimeSamples()]
        default = attribute.Get(Usd.TimeCode.Default())
        if default is not None:
            codes.append(Usd.TimeCode.Default())
        authored = [(code, attribute.Get(code)) for code in codes]
        for code, given in authored:
            values = np.array(given or [], dtype=np.float32)
            if not len(values):
                # No shape is active. It is written all the same: these samples hide all of a weaker layer.
                attribute.Set(Sdf.ValueBlock() if given is None else given, code)
                continue
            changed = _padded(values, len(names)).astype(np.float32)
            own = np.array([changed[column] if column >= 0 else 0.0 for column in columns], dtype=np.float64)
            new = self.done.corrected(own, self.upper, self.lower)
            for column, heir in enumerate(self.done.kept):
                if self.tokens[heir] in changes and columns[heir] >= 0:
                    changed[columns[heir]] = new[column]
            attribute.Set(Vt.FloatArray.FromNumpy(changed), code)

        def undo() -> None:
            for code, values in authored:
                attribute.Set(Sdf.ValueBlock() if values is None else values, code)

        return undo


class MeshShapes:
    """The blend shapes of a mesh, of which some are to go.

    Attributes:
        tokens: their names.
    """

    def __init__(self, job: MeshJob, skin: Skin, rows: Rows, options: RigOptions, others: set[str]) -> None:
        """Read them.

        Args:
            job: the mesh.
            skin: its skin.
            rows: the points of the simplified mesh as blends of the old ones.
            options: how many stay.
            others: names of shapes that other meshes take from the same animation: their weights stay as they are.
        """
        self._job, self._skin, self._options = job, skin, options
        self.tokens = shape_tokens(job)
        zero = np.zeros((len(skin.rest_points), 3), dtype=np.float32)
        self._offsets = np.stack([rows.blend(shape.arrays.get("offsets", zero)) for shape in skin.shapes])
        stage = job.source.prim.GetStage()
        places = [_inbetweens(UsdSkel.BlendShape(stage.GetPrimAtPath(shape.path))) for shape in skin.shapes]
        self._inbetweens = [
            {weight: rows.blend(shape.arrays[name]) for name, weight in each.items() if name in shape.arrays}
            for shape, each in zip(skin.shapes, places, strict=True)
        ]
        self._weights = _weights(job.examples or job.source, self.tokens)
        self._lower, self._upper = weight_range(self._weights, len(self.tokens))
        self._heirs, self._notes = _heirs(job, self.tokens, others)

    def steps(
        self, rest: npt.NDArray[np.float32], faces: npt.NDArray[np.int32], most: int = MAX_STEPS
    ) -> list[ShapeReduction]:
        """The shapes along their removal, of the fewest first and of all last.

        Args:
            rest: rest points of the simplified mesh.
            faces: its faces.
            most: steps at most; of one alone that of the fewest shapes.
        """
        shading = _normals_only(self._skin, rest, self._offsets, self._inbetweens)
        notes = list(self._notes)
        if len(shading):
            named = ", ".join(self.tokens[index] for index in shading)
            notes.append(f"{self._job.mesh.path}: these blend shapes move only normals, and stay: {named}")
        # An inbetween is where it is by the weight of its shape.
        scalable = np.flatnonzero([not _has_inbetweens(shape) for shape in self._skin.shapes])
        given = (rest, faces, self._offsets, self._weights, self._inbetweens, self._heirs, scalable)
        goals: ShapeGoals = {
            "shapes": single(self._options.shapes),
            "max_error": self._options.shape_error,
            "keep": shading,
        }
        return [self._reduction(done, notes) for done in shape_steps(given, goals, most=most)]

    def _reduction(self, done: ReducedShapes, notes: list[str]) -> ShapeReduction:
        shapes, tokens = self._skin.shapes, self.tokens
        kept = [_scaled(shapes[index], scale) for index, scale in zip(done.kept, done.scales, strict=True)]
        scales = {
            tokens[index]: float(scale) for index, scale in zip(done.kept, done.scales, strict=True) if scale != 1
        }
        longer = [
            f"{self._job.mesh.path}: the offsets of blend shape {token} are {scale:.4g} times as long and its weights "
            "as many times smaller, so that it can take the place of others with weights of 1 at most"
            for token, scale in scales.items()
        ]
        gone = tuple(shapes[index].path for index in sorted(done.removed))
        lower, upper = self._lower[done.kept], self._upper[done.kept]
        report = _report(done, tokens, scales)
        return ShapeReduction(kept, gone, report, done, tokens, lower, upper, [*notes, *longer])


def shape_tokens(job: MeshJob) -> list[str]:
    """The names of the blend shapes of a mesh."""
    return list(UsdSkel.BindingAPI(job.source.prim).GetBlendShapesAttr().Get() or [])


def _heirs(job: MeshJob, tokens: list[str], others: set[str]) -> tuple[npt.NDArray[np.int64], list[str]]:
    """The shapes that may take over weight of others, and why some may not."""
    animation = _animation(job.source)
    named: set[str] = set()
    if animation is not None and animation.GetPath().GetPrefixes()[0] == job.source.prim.GetPath().GetPrefixes()[0]:
        named = set(UsdSkel.Animation(animation).GetBlendShapesAttr().Get() or [])
    # What is animated stays so where it cannot be corrected; without an animation nothing has to be.
    heirs = [index for index, token in enumerate(tokens) if token in named and token not in others]
    notes = []
    if not _is_animated(job.source):
        heirs = list(range(len(tokens)))
    if not _is_animated(job.examples or job.source):
        notes.append(
            f"{job.mesh.path}: nothing animates its blend shapes, so that random weights alone decide which go"
        )
    shared = [token for token in tokens if token in named and token in others]
    if animation is not None and shared:
        notes.append(
            f"{job.mesh.path}: the weights of {', '.join(shared)} in {animation.GetPath()} stay as they are, as other "
            f"meshes use them, of this variant or another"
        )
    return np.array(heirs, dtype=np.int64), notes


def _normals_only(
    skin: Skin,
    rest: npt.NDArray[np.float32],
    offsets: npt.NDArray[np.float64],
    inbetweens: list[dict[float, npt.NDArray[np.float64]]],
) -> npt.NDArray[np.int64]:
    """The shapes that turn normals and leave the points of the simplified mesh where they are."""
    limit = MIN_OFFSET * float(np.linalg.norm(np.ptp(rest.astype(np.float64), axis=0)))
    found = []
    for index, shape in enumerate(skin.shapes):
        turns = [array for name, array in shape.arrays.items() if name.endswith("normalOffsets")]
        moves = [offsets[index], *inbetweens[index].values()]
        turned = max((np.abs(array).max(initial=0) for array in turns), default=0)
        if turned > MIN_NORMAL_OFFSET and max(np.abs(array).max(initial=0) for array in moves) <= limit:
            found.append(index)
    return np.array(found, dtype=np.int64)


def _has_inbetweens(shape: ShapeData) -> bool:
    return any(name.startswith(INBETWEEN) for name in shape.arrays)


def _scaled(shape: ShapeData, scale: float) -> ShapeData:
    """A shape with offsets so many times as long."""
    if scale == 1.0:
        return shape
    arrays = {name: array * np.float32(scale) for name, array in shape.arrays.items()}
    return replace(shape, arrays=arrays)


def _report(done: ReducedShapes, tokens: list[str], scales: dict[str, float]) -> ShapesReport:
    merged = {}
    for shape in done.removed:
        parts = {tokens[heir]: float(part) for heir, part in zip(done.kept, done.parts[shape], strict=True) if part > 0}
        if parts:
            merged[tokens[shape]] = parts
    return ShapesReport(
        before=len(tokens),
        after=len(done.kept),
        removed=[tokens[shape] for shape in done.removed],
        merged=merged,
        scales=scales,
        used_error=float(done.used_errors[-1]),
        random_error=float(done.random_errors[-1]),
        counts=done.counts.tolist(),
        used_errors=done.used_errors.tolist(),
        random_errors=done.random_errors.tolist(),
    )


def _animation(source: MeshSource) -> Usd.Prim | None:
    """The animation of a mesh's blend shapes, if its weights can be edited."""
    query = None if source.poser is None else source.poser.skeleton_query.GetAnimQuery()
    prim = query.GetPrim() if query else None
    if not prim or not prim.IsA(UsdSkel.Animation) or prim.IsInstanceProxy():
        return None
    return prim


def _is_animated(source: MeshSource) -> bool:
    return source.poser is not None and bool(source.poser.skeleton_query.GetAnimQuery())


def _weights(source: MeshSource, tokens: list[str]) -> npt.NDArray[np.float64] | None:
    """Weights that the animation of a mesh uses, (F, S); None without any."""
    if source.poser is None or source.poser.blend_shape_query is None:
        return None
    query = source.poser.skeleton_query.GetAnimQuery()
    times = query.GetBlendShapeWeightTimeSamples() or [Usd.TimeCode.EarliestTime()]
    names = list(query.GetBlendShapeOrder())
    columns = np.array([names.index(token) if token in names else len(names) for token in tokens], dtype=np.int64)
    rows = [np.array(query.ComputeBlendShapeWeights(time) or [], dtype=np.float64) for time in times]
    for time, row in zip(times, rows, strict=True):
        wrong = row[~np.isfinite(row)]
        if len(wrong):
            where = f"{query.GetPrim().GetPath()}.blendShapeWeights"
            raise StageError(f"{where}: {wrong[0]} at time {time} is not a finite number")
    # A last column of zeros is for shapes that the animation does not name.
    return np.stack([np.append(_padded(row, len(names)), 0.0)[columns] for row in rows])


def _padded(values: npt.NDArray[np.floating], count: int) -> npt.NDArray[np.float64]:
    """So many weights, as UsdSkel takes them: 0 for those that are missing, and none of those beyond."""
    found = np.zeros(count)
    found[: len(values)] = values[:count]
    return found


def _inbetweens(shape: UsdSkel.BlendShape) -> dict[str, float]:
    """Weights of the inbetweens of a shape by the names of their attributes."""
    found = {item.GetAttr().GetName(): item.GetWeight() for item in shape.GetInbetweens()}
    # Those at the ends add nothing between them.
    return {name: float(weight) for name, weight in found.items() if weight is not None and 0 < weight < 1}
