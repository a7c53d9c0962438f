"""Open a stage and find the meshes on it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field

from pxr import Sdf, Tf, Usd, UsdGeom

from warpqem.errors import StageError
from warpqem.usd.input_check import check_composition, open_layers
from warpqem.usd.usd_errors import first_line

__all__ = ["MeshSelection", "SavedStage", "find_meshes", "open_stage", "open_with_problems", "world_scale"]


@dataclass
class MeshSelection:
    """The meshes of a stage that can be edited, and why others cannot.

    Attributes:
        prims: `UsdGeom.Mesh` prims in stage order. For instances of a prim of the same file, such as a class, the
            meshes below that prim.
        refused: (prim path, error) of meshes that exist only as instance proxies, one for each mesh of a prototype.
    """

    prims: list[Usd.Prim] = field(default_factory=list)
    refused: list[tuple[str, StageError]] = field(default_factory=list)


def open_stage(path: str | os.PathLike[str], roots: Sequence[str | os.PathLike[str]] = ()) -> Usd.Stage:
    """Open a USD file for reading, with all payloads loaded.

    Args:
        path: The file.
        roots: Folders that all files it needs must be in, or in its own; empty for anywhere.

    Raises:
        StageError: the file does not exist, USD cannot read it, or could not read it safely; a file it needs lies
            elsewhere; or a layer or prim refers to itself.
    """
    return open_with_problems(path, roots)[0]


def open_with_problems(
    path: str | os.PathLike[str], roots: Sequence[str | os.PathLike[str]] = ()
) -> tuple[Usd.Stage, list[str]]:
    """Open a USD file as `open_stage` does, and say what is wrong with files that it names; one line each.

    Raises:
        StageError: see `open_stage`.
    """
    opened = open_layers(path, roots)
    try:
        stage = Usd.Stage.Open(os.fspath(path))
    except (Tf.ErrorException, UnicodeDecodeError) as error:
        raise StageError(f"{path}: USD cannot open it ({first_line(error, path)})") from error
    if stage is None:
        raise StageError(f"{path}: USD cannot open it")
    # The stage holds the layers now.
    return stage, [*check_composition(stage), *opened.problems]


@dataclass(frozen=True)
class SavedStage:
    """What another process opens a stage by.

    Attributes:
        path: File of the root layer; None for one in memory.
        text: What that layer holds, as .usda; None for a file.
    """

    path: str | None
    text: str | None

    @classmethod
    def of(cls, stage: Usd.Stage) -> SavedStage:
        """Of a stage whose layers are as they are on disk, apart from its root layer."""
        root = stage.GetRootLayer()
        return cls(None, root.ExportToString()) if root.anonymous else cls(root.realPath, None)

    def open(self) -> Usd.Stage:
        """The stage.

        Raises:
            StageError: see `open_stage`.
        """
        if self.path is not None:
            return open_stage(self.path)
        layer = Sdf.Layer.CreateAnonymous(".usda")
        layer.ImportFromString(self.text)
        return Usd.Stage.Open(layer)


def find_meshes(
    stage: Usd.Stage, prim_paths: Sequence[str] = (), within: Sdf.Path = Sdf.Path.absoluteRootPath
) -> MeshSelection:
    """Every active mesh of the stage, or those at and below `prim_paths`.

    Args:
        stage: The stage.
        prim_paths: Prim paths; empty for all.
        within: Prim that the source of an instance must be below, as well as below one of `prim_paths`, to be edited.

    Raises:
        StageError: one of `prim_paths` is no path, does not exist, or has no mesh at or below it.
    """
    roots = [_prim_at(stage, path) for path in prim_paths] or [stage.GetPseudoRoot()]
    selection = MeshSelection()
    seen: set[Sdf.Path] = set()
    instanced: dict[Sdf.Path, list[Usd.Prim]] = {}
    for root in roots:
        found = False
        for prim in Usd.PrimRange(root, Usd.TraverseInstanceProxies()):
            if not prim.IsA(UsdGeom.Mesh):
                continue
            found = True
            if prim.GetPath() in seen:
                continue
            seen.add(prim.GetPath())
            if prim.IsInstanceProxy():
                instanced.setdefault(prim.GetPrimInPrototype().GetPath(), []).append(prim)
            else:
                selection.prims.append(prim)
        if not found and prim_paths:
            raise StageError(f"{root.GetPath()}: no mesh at or below this prim")
    for proxies in instanced.values():
        source = _instance_source(proxies[0], [root.GetPath() for root in roots], within)
        if source is None:
            selection.refused.append(_refusal(proxies))
        elif source not in selection.prims:
            selection.prims.append(source)
    return selection


def _instance_source(proxy: Usd.Prim, roots: Sequence[Sdf.Path], within: Sdf.Path) -> Usd.Prim | None:
    """The mesh of the same file that an instance proxy gets its opinions from, which all its instances share.

    Opinions below an instance are ignored, but not those below the prim that it refers to or inherits from.
    """
    stage = proxy.GetStage()
    layers = stage.GetLayerStack(includeSessionLayers=False)
    ancestor = proxy
    while ancestor.IsInstanceProxy() or ancestor.IsInstance():
        for spec in ancestor.GetPrimStack():
            path = proxy.GetPath().ReplacePrefix(ancestor.GetPath(), spec.path.StripAllVariantSelections())
            prim = stage.GetPrimAtPath(path) if spec.layer in layers and path.HasPrefix(within) else None
            if prim and prim.IsA(UsdGeom.Mesh) and not prim.IsInstanceProxy():
                return prim if any(path.HasPrefix(root) for root in roots) else None
        ancestor = ancestor.GetParent()
    return None


def world_scale(prim: Usd.Prim, time: Usd.TimeCode) -> float:
    """How many world units one unit of the prim's local space measures (cube root of the volume ratio)."""
    matrix = UsdGeom.XformCache(time).GetLocalToWorldTransform(prim)
    return float(abs(matrix.GetDeterminant3()) ** (1.0 / 3.0))


def _prim_at(stage: Usd.Stage, path: str) -> Usd.Prim:
    if not Sdf.Path.IsValidPathString(path) or not Sdf.Path(path).IsAbsoluteRootOrPrimPath():
        raise StageError(f"'{path}' is no absolute prim path, such as /Root/Body")
    prim = stage.GetPrimAtPath(path)
    if not prim:
        raise StageError(f"{path}: no prim at this path")
    return prim


def _refusal(proxies: list[Usd.Prim]) -> tuple[str, StageError]:
    path = str(proxies[0].GetPath())
    instance = proxies[0]
    while not instance.IsInstance():
        instance = instance.GetParent()
    shared = f" (shared by {len(proxies)} instances)" if len(proxies) > 1 else ""
    return path, StageError(
        f"{path}: the mesh is an instance proxy{shared} and cannot be edited; "
        f"simplify the asset that {instance.GetPath()} instances, or set instanceable = false on it"
    )
