"""Poses of a stage's meshes that another file gives: examples of how they will move."""

from __future__ import annotations

import os

import numpy as np
from pxr import Sdf, Usd

from warpqem.errors import StageError
from warpqem.usd.read.open_stage import open_stage
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.skeleton_poses import StagePoses
from warpqem.usd.read.stage_views import layer_name, open_like

__all__ = ["ExamplePoses"]


class ExamplePoses:
    """A file laid over the input: prims at the same paths, such as another clip of the same skeleton, move its meshes.

    Args:
        stage: The input.
        path: USD file with point samples of its meshes, or with animation of its skeletons or blend shapes.

    Raises:
        StageError: the file cannot be read.
    """

    def __init__(self, stage: Usd.Stage, path: str | os.PathLike[str]) -> None:
        self._path = os.fspath(path)
        self._own = open_stage(path)
        layer = Sdf.Layer.CreateAnonymous("poses.usda")
        # The examples may be those of the input itself; USD allows a layer once.
        layers = dict.fromkeys(layer_name(of.GetRootLayer()) for of in (self._own, stage))
        layer.subLayerPaths = list(layers)
        layer.timeCodesPerSecond = self._own.GetTimeCodesPerSecond()
        self._stage: Usd.Stage = open_like(stage, layer, stage.GetSessionLayer())
        self._poses = StagePoses(self._stage)

    def source(self, mesh: MeshSource) -> MeshSource:
        """The same mesh as the examples move it.

        Raises:
            StageError: nothing in the file moves the mesh, or its topology is another one there.
        """
        source = MeshSource(self._stage.GetPrimAtPath(mesh.path), self._poses)
        movers = [Sdf.Path(mesh.path)]
        if source.poser is not None:
            query = source.poser.skeleton_query
            movers += [prim.GetPath() for prim in (query.GetPrim(), query.GetAnimQuery().GetPrim()) if prim]
        if not any(self._own.GetPrimAtPath(path) for path in movers):
            raise StageError(f"{self._path}: no poses of {mesh.path}, no prim at {' or '.join(map(str, movers))}")
        if source.point_count != mesh.point_count or not np.array_equal(
            source.topology.triangles, mesh.topology.triangles
        ):
            raise StageError(
                f"{self._path}: {mesh.path} has other points or faces than in the input "
                f"({source.point_count} points for {mesh.point_count})"
            )
        return source
