"""Fewer blend shapes for a simplified mesh, see `warpqem.skinning.reduce_shapes`, and the weights of its animation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdSkel, Vt

from warpqem.skinning.reduce_shapes import ReducedShapes, reduce_shapes
from warpqem.usd.commands.mesh_job import MeshJob
from warpqem.usd.commands.rig_options import RigOptions, single
from warpqem.usd.read.mesh_skin import Skin
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.write.attribute_transfer import Rows
from warpqem.usd.write.stage_report import ShapesReport

__all__ = ["ShapeReduction", "reduce_mesh_shapes"]

# Attributes of a BlendShape prim are told apart by their namespace.
INBETWEEN = "inbetweens:"


@dataclass(frozen=True)
class ShapeReduction:
    """What came of the blend shapes of a mesh.

    Attributes:
        skin: with the shapes that stay.
        report: which went.
        done: how weight goes from shape to shape.
        tokens: names of all shapes before.
        upper: largest weights of those that stay.
    """

    skin: Skin
    report: ShapesReport
    done: ReducedShapes
    tokens: list[str]
    upper: npt.NDArray[np.float64]

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
        authored = [(code, np.array(attribute.Get(code), dtype=np.float32)) for code in codes]
        for code, values in authored:
            own = np.array([values[column] if column >= 0 else 0.0 for column in columns], dtype=np.float64)
            new, changed = self.done.corrected(own, self.upper), values.copy()
            for column, heir in enumerate(self.done.kept):
                if self.tokens[heir] in changes and columns[heir] >= 0:
                    changed[columns[heir]] = new[column]
            attribute.Set(Vt.FloatArray.FromNumpy(changed), code)

        def undo() -> None:
            for code, values in authored:
                attribute.Set(Vt.FloatArray.FromNumpy(values), code)

        return undo


def reduce_mesh_shapes(
    job: MeshJob,
    skin: Skin,
    rest: npt.NDArray[np.float32],
    faces: npt.NDArray[np.int32],
    rows: Rows,
    options: RigOptions,
    others: set[str],
) -> ShapeReduction | None:
    """Choose the blend shapes that stay; None where the mesh has none.

    Args:
        job: the mesh.
        skin: its skin.
        rest: rest points of the simplified mesh.
        faces: its faces.
        rows: its points as blends of the old ones.
        options: how many stay.
        others: names of shapes that other meshes take from the same animation: their weights stay as they are.
    """
    tokens = list(UsdSkel.BindingAPI(job.source.prim).GetBlendShapesAttr().Get() or [])
    if not skin.shapes or len(tokens) != len(skin.shapes):
        return None
    zero = np.zeros((len(skin.rest_points), 3), dtype=np.float32)
    offsets = np.stack([rows.blend(shape.arrays.get("offsets", zero)) for shape in skin.shapes])
    stage = job.source.prim.GetStage()
    places = [_inbetweens(UsdSkel.BlendShape(stage.GetPrimAtPath(shape.path))) for shape in skin.shapes]
    inbetweens = [
        {weight: rows.blend(shape.arrays[name]) for name, weight in each.items() if name in shape.arrays}
        for shape, each in zip(skin.shapes, places, strict=True)
    ]
    animation, weights = _animation(job.source), _weights(job.examples or job.source, tokens)
    named: set[str] = set()
    if animation is not None and animation.GetPath().GetPrefixes()[0] == job.source.prim.GetPath().GetPrefixes()[0]:
        named = set(UsdSkel.Animation(animation).GetBlendShapesAttr().Get() or [])
    # What is animated stays so where it cannot be corrected; without an animation nothing has to be.
    heirs = [index for index, token in enumerate(tokens) if token in named and token not in others]
    if animation is None:
        heirs = list(range(len(tokens)))
    done = reduce_shapes(
        rest,
        faces,
        offsets,
        weights,
        shapes=single(options.shapes),
        max_error=options.shape_error,
        inbetweens=inbetweens,
        heirs=np.array(heirs, dtype=np.int64),
    )
    kept = [skin.shapes[index] for index in done.kept]
    gone = tuple(skin.shapes[index].path for index in sorted(done.removed))
    order = tuple(tokens[index] for index in done.kept)
    upper = np.ones(len(kept)) if weights is None else np.maximum(1.0, weights.max(axis=0, initial=0)[done.kept])
    reduced = replace(skin, shapes=kept, shape_order=order, removed_shapes=gone)
    return ShapeReduction(reduced, _report(done, tokens), done, tokens, upper)


def _report(done: ReducedShapes, tokens: list[str]) -> ShapesReport:
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


def _weights(source: MeshSource, tokens: list[str]) -> npt.NDArray[np.float64] | None:
    """Weights that the animation of a mesh uses, (F, S); None without any."""
    if source.poser is None or source.poser.blend_shape_query is None:
        return None
    query = source.poser.skeleton_query.GetAnimQuery()
    times = query.GetBlendShapeWeightTimeSamples() or [Usd.TimeCode.EarliestTime()]
    names = list(query.GetBlendShapeOrder())
    columns = np.array([names.index(token) if token in names else len(names) for token in tokens], dtype=np.int64)
    rows = [query.ComputeBlendShapeWeights(time) for time in times]
    if any(row is None for row in rows):
        return None
    values = np.array([np.array(row, dtype=np.float64) for row in rows]).reshape(len(rows), len(names))
    padded = np.concatenate([values, np.zeros((len(rows), 1))], axis=1)
    return np.asarray(padded[:, columns])


def _inbetweens(shape: UsdSkel.BlendShape) -> dict[str, float]:
    """Weights of the inbetweens of a shape by the names of their attributes."""
    found = {item.GetAttr().GetName(): item.GetWeight() for item in shape.GetInbetweens()}
    # Those at the ends add nothing between them.
    return {name: float(weight) for name, weight in found.items() if weight is not None and 0 < weight < 1}
