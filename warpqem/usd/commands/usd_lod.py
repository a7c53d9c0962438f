"""Levels of detail of one file through the schemas of UsdLod.

The children of a prim with LODRootAPI are its levels, and heuristics say which of them a renderer shows (the schemas'
own documentation, usdLod/schema.usda of USD 26.08). A program that does not know UsdLod shows all levels at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Gf, Kind, Sdf, Usd, UsdGeom, Vt

from warpqem.errors import OptionError
from warpqem.usd.commands.lods import LevelLayer
from warpqem.usd.read.open_stage import MeshSelection
from warpqem.usd.write.write import OverLayer

__all__ = ["UsdLodLevels"]

# Children of the root prim. All children of an LOD root count as levels, so its heuristics cannot be among them.
LEVELS = "LOD"
SCREEN_SIZE = "LODScreenSize"
DISTANCE = "LODDistance"

# Boxes of a moving model are authored at so many times at most; renderers interpolate between them.
MAX_BOXES = 100

# Guides are no part of the picture.
PURPOSES = (UsdGeom.Tokens.default_, UsdGeom.Tokens.render, UsdGeom.Tokens.proxy)

Boxes = npt.NDArray[np.float32]


class UsdLodLevels(LevelLayer):
    """Levels as the children LOD0, LOD1, ... of a prim with LODRootAPI, and two heuristics that choose between them.

    The root prim becomes a plain Xform with the children `LOD`, whose children are the levels, `LODScreenSize` and
    `LODDistance`. A level with the share s of the faces shows where the model covers no more than the share s of the
    picture, so that its faces are never smaller on the screen than those of the original when that fills the picture.
    The distances say the same for a camera with the fallback values of UsdGeomCamera.
    """

    def __init__(self, source: Usd.Stage, selection: MeshSelection) -> None:
        """Start a layer with LOD0, the input as it is; see `LevelLayer`.

        Raises:
            OptionError: this version of USD has no UsdLod.
        """
        try:
            from pxr import UsdLod
        except ImportError:
            version = ".".join(f"{part:02}" for part in Usd.GetVersion()[1:])
            raise OptionError(f"usd_lod: UsdLod is part of USD from 26.08 on, and this is USD {version}") from None
        self._schemas = UsdLod
        self._thresholds: list[float] = []
        self._models: dict[Sdf.Path, _Model] = {}
        super().__init__(source, selection)

    def add(self, edits: OverLayer, share: float) -> str:
        """Add the next level; see `LevelLayer`."""
        name = self._add(edits)
        # A level that stopped short of its ratio may have as many faces as the one before.
        self._thresholds.append(min([share, *self._thresholds]))
        for model in self._models.values():
            model.screen_size.CreateThresholdsAttr(self._thresholds)
            distances = [model.radius * _distance_at(covered) for covered in self._thresholds]
            model.distance.CreateThresholdsAttr(distances)
        return name

    def _start(self, root: Usd.Prim) -> None:
        # Schema objects do not keep their stage alive.
        if not self._models:
            self._stage = Usd.Stage.Open(self._layer, Usd.Stage.LoadNone)
        stage, path = self._stage, root.GetPath()
        model = UsdGeom.Xform.Define(stage, path).GetPrim()
        levels = UsdGeom.Xform.Define(stage, path.AppendChild(LEVELS)).GetPrim()
        item_kind = _set_kinds(Usd.ModelAPI(root).GetKind(), model, levels)
        screen_size = self._schemas.ScreenSizeHeuristic.Define(stage, path.AppendChild(SCREEN_SIZE))
        distance = self._schemas.DistanceHeuristic.Define(stage, path.AppendChild(DISTANCE))
        lod = self._schemas.RootAPI.Apply(levels)
        lod.CreateLodDefaultIndexAttr(0)
        lod.CreateLodHeuristicsRel().SetTargets([screen_size.GetPath(), distance.GetPath()])
        for heuristic in (screen_size, distance):
            heuristic.CreateLodDomainAttr(self._schemas.Tokens.imaging)
        screen_size.CreateProjectionMethodAttr(self._schemas.Tokens.projectedSphere)
        boxes = _boxes(root)
        _write_boxes(boxes, screen_size.CreateExtentAttr(), distance.CreateCenterAttr())
        # Thresholds are the same at all times, so that the largest sphere around a box counts.
        radius = max(float(np.linalg.norm(box[1] - box[0])) for box in boxes.values()) / 2
        self._models[path] = _Model(levels.GetPath(), item_kind, screen_size, distance, radius)

    def _place(self, root: Usd.Prim, name: str) -> Sdf.Path:
        model = self._models[root.GetPath()]
        spec = Sdf.CreatePrimInLayer(self._layer, model.levels.AppendChild(name))
        spec.specifier = Sdf.SpecifierDef
        if model.item_kind:
            spec.SetInfo("kind", model.item_kind)
        return spec.path

    def _copy(self, edits: Sdf.Layer, root: Sdf.Path, place: Sdf.Path) -> None:
        spec = self._layer.GetPrimAtPath(place)
        own = {key: spec.GetInfo(key) for key in ("specifier", "kind") if spec.HasInfo(key)}
        super()._copy(edits, root, place)
        for key, value in own.items():
            self._layer.GetPrimAtPath(place).SetInfo(key, value)


@dataclass(frozen=True)
class _Model:
    """A root prim with levels.

    Attributes:
        levels: The prim whose children are the levels.
        item_kind: The kind that each level is given; "" for its own.
        screen_size: The heuristic by the share of the picture.
        distance: That by the distance from the camera.
        radius: Radius of the largest sphere around the model.
    """

    levels: Sdf.Path
    item_kind: str
    screen_size: Any
    distance: Any
    radius: float


def _write_boxes(boxes: dict[float, Boxes], extent: Usd.Attribute, center: Usd.Attribute) -> None:
    first = next(iter(boxes.values()))
    # The first box stands at the default time, too, where there would be the schemas' fallback otherwise.
    moves = any(not np.array_equal(box, first) for box in boxes.values())
    codes = {Usd.TimeCode.Default(): first} | ({Usd.TimeCode(t): box for t, box in boxes.items()} if moves else {})
    for code, box in codes.items():
        extent.Set(Vt.Vec3fArray.FromNumpy(box), code)
        center.Set(Gf.Vec3f(*((box[0] + box[1]) / 2).tolist()), code)


def _distance_at(covered: float) -> float:
    """How far from a sphere's centre, in radii, it covers a share of the picture of the fallback camera.

    A sphere of radius r at distance d covers an ellipse of about pi (f r / d)^2 on a film of a width and height at the
    focal length f; UsdLodScreenSizeHeuristic reckons with the same.
    """
    camera = Gf.Camera()
    film = camera.horizontalAperture * camera.verticalAperture
    return camera.focalLength * math.sqrt(math.pi / (film * covered))


def _set_kinds(kind: str, model: Usd.Prim, levels: Usd.Prim) -> str:
    """Keep the model hierarchy whole around the levels; returns the kind that each level is given, "" for its own."""
    if not kind:
        return ""
    Usd.ModelAPI(model).SetKind(kind)
    if Kind.Registry.IsA(kind, Kind.Tokens.group):
        # Models are found through an unbroken chain of groups only.
        Usd.ModelAPI(levels).SetKind(Kind.Tokens.group)
        return ""
    # A component holds no other components.
    return str(Kind.Tokens.subcomponent)


def _boxes(root: Usd.Prim) -> dict[float, Boxes]:
    """Bounding boxes (2, 3) of a root prim over the time codes of its stage.

    Raises:
        OptionError: there is nothing to see at one of them.
    """
    stage = root.GetStage()
    # A stage without a range has both at nought, where attributes without samples give their default.
    start, end = stage.GetStartTimeCode(), stage.GetEndTimeCode()
    count = min(MAX_BOXES, max(1, 1 + math.floor(end - start)))
    boxes = {}
    for time in np.linspace(start, end, count).tolist():
        # A new cache for each, as one takes meshes without an authored extent for still.
        cache = UsdGeom.BBoxCache(Usd.TimeCode(time), PURPOSES, useExtentsHint=False, ignoreVisibility=True)
        found = cache.ComputeWorldBound(root).ComputeAlignedRange()
        if found.IsEmpty():
            raise OptionError(f"usd_lod: {root.GetPath()} has no bounding box at time {time:g}")
        boxes[time] = np.array([list(found.GetMin()), list(found.GetMax())], dtype=np.float32)
    return boxes
