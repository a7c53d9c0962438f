"""Blend-shape weights of the meshes of a stage: neutral shape and targets from blend shapes or from poses."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom, UsdSkel

from warpqem.costs.blend_shape_weights import MORPH_METHODS, morph_weights
from warpqem.errors import OptionError, StageError
from warpqem.frames.stream import SomeFrames
from warpqem.usd.commands.mesh_job import MeshJob
from warpqem.usd.read.blend_shapes import read_shapes
from warpqem.usd.read.read_mesh import MeshSource

__all__ = ["check_morph", "morph_scale"]


def check_morph(prims: Iterable[Usd.Prim], method: str | None, has_examples: bool) -> None:
    """Check the method, and that one of the meshes at least has something to morph into.

    Raises:
        OptionError: there is no such method, or no mesh has blend shapes, several poses or example poses.
    """
    if method is None:
        return
    if method not in MORPH_METHODS:
        raise OptionError(f"morph_weights {method!r}: expected one of {', '.join(MORPH_METHODS)}")
    prims = list(prims)
    if prims and not has_examples and not any(_morphs(prim) for prim in prims):
        raise OptionError(f"morph_weights: none of the {len(prims)} meshes has blend shapes or several poses")


def _morphs(prim: Usd.Prim) -> bool:
    has_shapes = UsdSkel.BindingAPI(prim).GetBlendShapeTargetsRel().HasAuthoredTargets()
    return has_shapes or len(UsdGeom.Mesh(prim).GetPointsAttr().GetTimeSamples()) > 1


def morph_scale(job: MeshJob, method: str | None, examples: MeshSource | None = None) -> npt.NDArray[np.float32] | None:
    """Quadric scales of the vertices of a mesh, (V,); None for a mesh that does not morph.

    A mesh with blend shapes is neutral at rest, and they are the targets. One that has neither them nor a skeleton is
    neutral at its first pose; example poses are its targets, or else its own other poses.

    Args:
        job: The mesh.
        method: See `warpqem.costs.morph_weights`; None for no weights.
        examples: The mesh in example poses, if there are any.

    Raises:
        StageError: the method asks for the usage of targets and no animation drives them.
    """
    if method is None:
        return None
    source = job.source
    # Read anew: a mesh that is baked has no skin to go by.
    shapes = enumerate(read_shapes(source.prim, source.point_count) or [])
    offsets = {index: shape.arrays["offsets"] for index, shape in shapes if "offsets" in shape.arrays}
    if offsets:
        point = np.empty(job.frames.vertex_count, dtype=np.int64)
        point[job.faces] = source.topology.triangles
        usage = _shape_weights(examples or source)[:, list(offsets)] if method == "usage" else None
        # From the offsets themselves: added to the rest points, equal ones would round apart.
        targets = np.stack([array[point] for array in offsets.values()])
        return morph_weights(np.zeros_like(targets[0]), targets, method, usage)
    if source.has_skin_binding:
        return None
    own = SomeFrames(job.frames, job.pose_start, job.frames.frame_count)
    if job.pose_start:
        moved = SomeFrames(job.frames, 0, job.pose_start)
    else:
        moved = SomeFrames(job.frames, 1, job.frames.frame_count)
    if not moved.frame_count:
        return None
    if method == "usage":
        raise StageError(f"{job.mesh.path}: blend-shape weights by usage need blend shapes that an animation drives")
    return morph_weights(own.read(slice(0, 1))[0], moved, method)


def _shape_weights(source: MeshSource) -> npt.NDArray[np.float64]:
    """Weights of the mesh's blend shapes at the times of its frames, (F, T)."""
    poser = source.poser
    if poser is None or poser.blend_shape_query is None:
        raise StageError(f"{source.path}: no animation drives its blend shapes, so that their usage is not known")
    animation, mapper = poser.skeleton_query.GetAnimQuery(), poser.skinning_query.GetBlendShapeMapper()
    rows = []
    for time in source.frame_times() or [Usd.TimeCode.Default()]:
        weights = animation.ComputeBlendShapeWeights(time)
        if weights is None:
            raise StageError(f"{animation.GetPrim().GetPath()}.blendShapeWeights: no value at time {time}")
        rows.append(np.asarray(weights if mapper is None else mapper.Remap(weights), dtype=np.float64))
    return np.stack(rows)
