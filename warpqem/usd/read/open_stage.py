"""Open a stage and find the meshes on it."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from pxr import Sdf, Tf, Usd, UsdGeom, UsdSkel

from warpqem.errors import StageError
from warpqem.usd.checks.input_check import check_composition, open_layers
from warpqem.usd.checks.usd_errors import first_line
from warpqem.usd.read.instances import SharedPrototype, end_instancing, open_instances, spec_places
from warpqem.usd.read.missing_textures import missing_lines, missing_textures
from warpqem.usd.read.stage_views import private_view

__all__ = [
    "MeshSelection",
    "find_meshes",
    "open_input",
    "open_stage",
    "open_with_problems",
    "world_scale",
]

_log = logging.getLogger(__name__)


@dataclass
class MeshSelection:
    """The meshes of a stage that can be edited, and why others cannot.

    Attributes:
        prims: `UsdGeom.Mesh` prims in stage order. For instances of a prim of the same file, such as a class, the
            meshes below that prim, if they are the same as those of the instances; for others the meshes of one
            instance, which is opened in the session layer of the stage.
        refused: (prim path, error) of meshes that exist only as instance proxies and cannot be edited, one for each
            mesh of a prototype.
        empty: (prim path, what it has none of) of meshes without geometry, which show nothing.
        shared: The prototypes whose meshes are edited in an instance that is opened.
        own_instances: Meshes that were instances themselves, which they cannot stay: their subsets are edited below.
        places: Every path at which the stage shows a mesh with geometry, in stage order, and the path of the mesh of
            `prims` or `refused` that it shows there: the mesh itself, or that of which it is an instance.
    """

    prims: list[Usd.Prim] = field(default_factory=list)
    refused: list[tuple[str, StageError]] = field(default_factory=list)
    empty: list[tuple[str, str]] = field(default_factory=list)
    shared: list[SharedPrototype] = field(default_factory=list)
    own_instances: list[Sdf.Path] = field(default_factory=list)
    places: dict[Sdf.Path, Sdf.Path] = field(default_factory=dict)

    def paths(self) -> list[Sdf.Path]:
        """Paths of all of them."""
        others = [path for path, _ in (*self.refused, *self.empty)]
        return [prim.GetPath() for prim in self.prims] + [Sdf.Path(path) for path in others]


def open_stage(path: str | os.PathLike[str], roots: Sequence[str | os.PathLike[str]] = ()) -> Usd.Stage:
    """Open a USD file for reading, with all payloads loaded.

    Args:
        path: The file.
        roots: Folders that all files it needs must be in, or in its own; empty for anywhere.

    Raises:
        StageError: the file does not exist, USD cannot read it, or could not read it safely; a file it needs lies
            elsewhere; or a layer or prim refers to itself.
    """
    return _opened(path, roots, None)[0]


def open_with_problems(
    path: str | os.PathLike[str],
    roots: Sequence[str | os.PathLike[str]] = (),
    prepare: Callable[[Usd.Stage], object] | None = None,
) -> tuple[Usd.Stage, list[str]]:
    """Open a USD file as `open_stage` does, and say what is wrong with files that it names; one line each.

    Args:
        path: As there.
        roots: As there.
        prepare: Called with the stage before it is looked through, such as to select variants.

    Raises:
        StageError: see `open_stage`.
    """
    stage, problems = _opened(path, roots, prepare)
    return stage, [*problems, *missing_lines(missing_textures(stage))]


def _opened(
    path: str | os.PathLike[str],
    roots: Sequence[str | os.PathLike[str]],
    prepare: Callable[[Usd.Stage], object] | None,
) -> tuple[Usd.Stage, list[str]]:
    """A stage, and what is wrong with how it is composed and with files that its layers name."""
    _log.info("%s: reading", os.fspath(path))
    opened = open_layers(path, roots)
    try:
        stage = Usd.Stage.Open(os.fspath(path))
    except (Tf.ErrorException, UnicodeDecodeError) as error:
        raise StageError(f"{path}: USD cannot open it ({first_line(error, path)})") from error
    if stage is None:
        raise StageError(f"{path}: USD cannot open it")
    if prepare is not None:
        prepare(stage)
    # The stage holds the layers now.
    return stage, [*check_composition(stage), *opened.problems]


def open_input(
    source: str | os.PathLike[str] | Usd.Stage, roots: Sequence[str | os.PathLike[str]] = ()
) -> tuple[Usd.Stage, list[str]]:
    """A stage to read from, whose session layer nobody else uses, and what is wrong with files that it names.

    Args:
        source: What to open, or an open stage, of which this is a view.
        roots: As for `open_stage`.

    Raises:
        StageError: see `open_stage`.
    """
    if not isinstance(source, Usd.Stage):
        return open_with_problems(source, roots)
    view = private_view(source)
    return view, [*check_composition(view), *missing_lines(missing_textures(view))]


def find_meshes(stage: Usd.Stage, prim_paths: Sequence[str] = (), by_root: bool = False) -> MeshSelection:
    """Every active mesh of the stage, or those at and below `prim_paths`.

    A stage is asked once: instances that are opened for one call are none for the next.

    Args:
        stage: The stage; its session layer is edited where instances are opened.
        prim_paths: Prim paths; empty for all.
        by_root: Edit the source of an instance only if it is below the same root prim.

    Raises:
        StageError: one of `prim_paths` is no path, does not exist, or has no mesh at or below it.
    """
    roots = [_prim_at(stage, path) for path in prim_paths] or [stage.GetPseudoRoot()]
    selection = MeshSelection()
    apart: list[list[Usd.Prim]] = []
    for proxies in _add_shown(selection, roots, must_hold=bool(prim_paths)):
        source = _instance_source(proxies[0], [root.GetPath() for root in roots], by_root)
        if source is None:
            apart.append(proxies)
            continue
        selection.places.update((proxy.GetPath(), source.GetPath()) for proxy in proxies)
        if source not in selection.prims:
            selection.prims.append(source)
    _add_opened(selection, stage, apart)
    selection.own_instances = [prim.GetPath() for prim in selection.prims if prim.IsInstance()]
    if selection.own_instances:
        paths_of_all = [prim.GetPath() for prim in selection.prims]
        end_instancing(stage.GetSessionLayer(), selection.own_instances)
        selection.prims = [stage.GetPrimAtPath(path) for path in paths_of_all]
    return selection


def _add_shown(selection: MeshSelection, roots: Sequence[Usd.Prim], must_hold: bool) -> list[list[Usd.Prim]]:
    """Add the meshes at and below some prims that are no instance proxies, and those without geometry.

    Returns:
        Instance proxies with geometry, those of one mesh of a prototype together.

    Raises:
        StageError: one of the prims must hold a mesh, and does not.
    """
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
            lacking = _lacking_geometry(UsdGeom.Mesh(prim))
            if lacking:
                selection.empty.append((str(prim.GetPath()), lacking))
                continue
            selection.places[prim.GetPath()] = prim.GetPath()
            if prim.IsInstanceProxy():
                instanced.setdefault(prim.GetPrimInPrototype().GetPath(), []).append(prim)
            else:
                selection.prims.append(prim)
        if not found and must_hold:
            raise StageError(f"{root.GetPath()}: no mesh at or below this prim")
    return list(instanced.values())


def _add_opened(selection: MeshSelection, stage: Usd.Stage, apart: list[list[Usd.Prim]]) -> None:
    """Add meshes that exist as instance proxies only: one instance of each is opened."""
    # Proxies expire when instances are opened.
    groups = [[proxy.GetPath() for proxy in proxies] for proxies in apart]
    opened = open_instances(stage, apart)
    for paths, mesh in zip(groups, opened.meshes, strict=True):
        if isinstance(mesh, StageError):
            selection.refused.append((str(paths[0]), mesh))
        else:
            selection.prims.append(mesh)
        shown = paths[0] if isinstance(mesh, StageError) else mesh.GetPath()
        selection.places.update((path, shown) for path in paths)
    selection.shared = opened.shared


def _lacking_geometry(mesh: UsdGeom.Mesh) -> str:
    """The attributes that a mesh would show something by but that nothing says a value of; empty if it has faces."""
    names = ("points", "faceVertexCounts", "faceVertexIndices")
    lacking = [name for name in names if not _is_given(mesh.GetPrim().GetAttribute(name))]
    return ", ".join(lacking) if "faceVertexCounts" in lacking else ""


def _is_given(attribute: Usd.Attribute) -> bool:
    """Whether a layer says a value, or that there is none."""
    return bool(attribute.HasAuthoredValue() or attribute.GetResolveInfo().ValueIsBlocked())


def _instance_source(proxy: Usd.Prim, roots: Sequence[Sdf.Path], by_root: bool) -> Usd.Prim | None:
    """The mesh of the same file that an instance proxy gets its opinions from, which all its instances share.

    Opinions below an instance are ignored, but not those below the prim that it refers to or inherits from. A mesh of
    another variant, or with opinions from elsewhere, is another mesh, and so is one that nothing deforms there, such as
    below a class that has not the type of its instances, SkelRoot.
    """
    stage = proxy.GetStage()
    places = spec_places(proxy)
    layers = stage.GetLayerStack(includeSessionLayers=False)
    within = proxy.GetPath().GetPrefixes()[0] if by_root else Sdf.Path.absoluteRootPath
    ancestor = proxy
    while ancestor.IsInstanceProxy() or ancestor.IsInstance():
        for spec in ancestor.GetPrimStack():
            path = proxy.GetPath().ReplacePrefix(ancestor.GetPath(), spec.path.StripAllVariantSelections())
            prim = stage.GetPrimAtPath(path) if spec.layer in layers and path.HasPrefix(within) else None
            if prim and prim.IsA(UsdGeom.Mesh) and not prim.IsInstanceProxy():
                chosen = any(path.HasPrefix(root) for root in roots)
                same = chosen and spec_places(prim) == places and _is_bound(prim) == _is_bound(proxy)
                return prim if same else None
        ancestor = ancestor.GetParent()
    return None


def _is_bound(prim: Usd.Prim) -> tuple[bool, bool]:
    """Whether a mesh is where UsdSkel deforms meshes, and whether a skeleton is bound to it."""
    return bool(UsdSkel.Root.Find(prim)), bool(UsdSkel.BindingAPI(prim).GetInheritedSkeleton())


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
