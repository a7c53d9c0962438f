"""Meshes that exist only below instances: edited where one instance is opened, and shared again through a class.

What layers say below an instance is ignored (USD glossary, "Instancing"), so that such a mesh cannot be edited in its
place. One instance of each prototype is therefore opened in the session layer: it is not instanceable there, and its
meshes are prims like others. When all edits are made they move to a class that all instances of the prototype inherit
from. An inherited class is stronger than references, payloads and variants, and instances with the same arcs go on
sharing one prototype, so that they show the edits, stay instances, and nothing is written twice.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from pxr import Sdf, Usd

from warpqem.errors import StageError

__all__ = [
    "InstanceEdits",
    "SharedPrototype",
    "end_instancing",
    "flat_places",
    "move_to_classes",
    "open_instances",
    "spec_places",
]

# Name of the classes, before a number.
CLASS_NAME = "Simplified_Prototype_"


@dataclass
class SharedPrototype:
    """A prototype with meshes to edit.

    Attributes:
        path: The instance that is opened.
        users: The instances that are to show its edits. One in an instance of another prototype is named by its place
            in the opened instance of that.
    """

    path: Sdf.Path
    users: list[Sdf.Path] = field(default_factory=list)


@dataclass
class InstanceEdits:
    """What was opened.

    Attributes:
        shared: The prototypes.
        meshes: One prim for each group of instance proxies, or the error why there is none.
    """

    shared: list[SharedPrototype] = field(default_factory=list)
    meshes: list[Usd.Prim | StageError] = field(default_factory=list)


def spec_places(prim: Usd.Prim) -> list[tuple[str, str]]:
    """Layer and path of all specs that a prim is composed of, strongest first, without those of session layers."""
    session = prim.GetStage().GetSessionLayer()
    return [
        (spec.layer.identifier, str(spec.path))
        for spec in prim.GetPrimStack()
        if session is None or spec.layer != session
    ]


def open_instances(stage: Usd.Stage, groups: Sequence[Sequence[Usd.Prim]]) -> InstanceEdits:
    """Open one instance of each prototype, in the session layer of a stage.

    Args:
        stage: The stage, whose session layer nobody else uses.
        groups: Instance proxies of meshes; those of a group are the same prim of the same prototype.
    """
    places = _Places()
    for group in groups:
        for proxy in group:
            places.add(_instances_above(proxy))
    shared = {key: SharedPrototype(places.opened(stage, key)) for key in places.users}
    for key, item in shared.items():
        item.users = [
            place if holder is None else shared[holder].path.AppendPath(place) for holder, place in places.users[key]
        ]
    before = [_content(group[0]) for group in groups]
    targets = []
    for group in groups:
        innermost = _instances_above(group[0])[-1]
        opened = shared[innermost.GetPrototype().GetPath()].path
        targets.append(group[0].GetPath().ReplacePrefix(innermost.GetPath(), opened))
    # Proxies expire with this, so that errors about them are made before.
    refusals = [_refusal(group) for group in groups]
    session = stage.GetSessionLayer()
    end_instancing(session, [item.path for item in shared.values()])
    edits = InstanceEdits(list(shared.values()))
    for path, content, refusal in zip(targets, before, refusals, strict=True):
        prim = stage.GetPrimAtPath(path)
        same = prim and not prim.IsInstanceProxy() and _content(prim) == content
        edits.meshes.append(prim if same else refusal)
    return edits


def _content(prim: Usd.Prim) -> tuple[list[tuple[str, str]], list[float]]:
    """What a mesh has in common with an equal one in an opened instance: specs, and times, which clips may change."""
    return spec_places(prim), prim.GetAttribute("points").GetTimeSamples()


def end_instancing(layer: Sdf.Layer, paths: Iterable[Sdf.Path]) -> None:
    """Say in a layer that prims are no instances."""
    with Sdf.ChangeBlock():
        for path in paths:
            Sdf.CreatePrimInLayer(layer, path).instanceable = False


class _Places:
    """Where prototypes have instances.

    Attributes:
        users: By the path of the prototype: for each instance the prototype it is in, None for none, and its path,
            relative to the instance of that prototype.
    """

    def __init__(self) -> None:
        self.users: dict[Sdf.Path, dict[tuple[Sdf.Path | None, Sdf.Path], None]] = {}

    def add(self, chain: Sequence[Usd.Prim]) -> None:
        """Add instances in each other, the outermost first."""
        holder: Usd.Prim | None = None
        for instance in chain:
            path = instance.GetPath()
            place = (
                (None, path)
                if holder is None
                else (holder.GetPrototype().GetPath(), path.MakeRelativePath(holder.GetPath()))
            )
            self.users.setdefault(instance.GetPrototype().GetPath(), {})[place] = None
            holder = instance

    def opened(self, stage: Usd.Stage, key: Sdf.Path) -> Sdf.Path:
        """The instance of a prototype to open: one that is in no other if there is one."""
        outer = [path for holder, path in self.users[key] if holder is None]
        if outer:
            # What layers say below an instance would come to light in an opened one.
            clean = (path for path in outer if not _has_children(stage, path))
            return next(clean, outer[0])
        holder, place = next(iter(self.users[key]))
        assert holder is not None
        return self.opened(stage, holder).AppendPath(place)


def _has_children(stage: Usd.Stage, path: Sdf.Path) -> bool:
    specs = (layer.GetPrimAtPath(path) for layer in stage.GetLayerStack())
    return any(len(spec.nameChildren) for spec in specs if spec)


def _instances_above(proxy: Usd.Prim) -> list[Usd.Prim]:
    """The instances that an instance proxy is below, the outermost first."""
    chain: list[Usd.Prim] = []
    prim = proxy.GetParent()
    while prim and not prim.IsPseudoRoot():
        if prim.IsInstance():
            chain.insert(0, prim)
        prim = prim.GetParent()
    return chain


def _refusal(proxies: Sequence[Usd.Prim]) -> StageError:
    path = proxies[0].GetPath()
    instance = _instances_above(proxies[0])[-1]
    shared = f" (shared by {len(proxies)} instances)" if len(proxies) > 1 else ""
    return StageError(
        f"{path}: the mesh is an instance proxy{shared} and cannot be edited, as layers have opinions or clips "
        f"below the instance {instance.GetPath()} that USD ignores; remove them, or set instanceable = false on it"
    )


def move_to_classes(
    layer: Sdf.Layer, shared: Iterable[SharedPrototype], stage: Usd.Stage, by_root: bool
) -> dict[Sdf.Path, list[Sdf.Path]]:
    """Move the edits of opened instances to classes, and let all instances of their prototypes inherit them.

    Args:
        layer: The edits.
        shared: The prototypes.
        stage: The input, for names that are taken.
        by_root: For the instances below each root prim there is a class below it; else there is one for all, beside.

    Returns:
        The instances that inherit from each class.

    Raises:
        StageError: USD cannot copy the edits.
    """
    classes: dict[Sdf.Path, list[Sdf.Path]] = {}
    # What is in other prototypes is moved first, so that those move without it.
    for item in _inner_first(list(shared)):
        edits = layer.GetPrimAtPath(item.path)
        if not edits:
            continue
        users: dict[Sdf.Path, list[Sdf.Path]] = {}
        for user in item.users:
            users.setdefault(user.GetPrefixes()[0] if by_root else Sdf.Path.absoluteRootPath, []).append(user)
        places = {place: _free_name(layer, stage, place) for place in users}
        for path in places.values():
            Sdf.CreatePrimInLayer(layer, path)
            if not Sdf.CopySpec(layer, item.path, layer, path):
                raise StageError(f"{item.path}: USD cannot copy edits to {path}")
            layer.GetPrimAtPath(path).specifier = Sdf.SpecifierClass
            for child in layer.GetPrimAtPath(path).nameChildren:
                _define(child, item.path.AppendChild(child.name), stage)
        parent = edits.nameParent or layer.pseudoRoot
        del parent.nameChildren[edits.name]
        for place, path in places.items():
            for user in users[place]:
                Sdf.CreatePrimInLayer(layer, user).inheritPathList.Prepend(path)
        classes |= {path: users[place] for place, path in places.items()}
    return classes


def _define(spec: Sdf.PrimSpec, path: Sdf.Path, stage: Usd.Stage) -> None:
    """Define what is in a class as it is in the opened instance: validators take an over there for one of nothing."""
    prim = stage.GetPrimAtPath(path)
    if prim and prim.IsDefined():
        spec.specifier, spec.typeName = Sdf.SpecifierDef, prim.GetTypeName()
    for child in spec.nameChildren:
        _define(child, path.AppendChild(child.name), stage)


def _inner_first(shared: Sequence[SharedPrototype]) -> list[SharedPrototype]:
    """Each prototype before those that have instances of it."""
    by_path = {item.path: item for item in shared}
    inner: dict[Sdf.Path, list[SharedPrototype]] = {}
    for item in shared:
        holders = {prefix for user in item.users for prefix in user.GetPrefixes()[:-1] if prefix in by_path}
        for holder in holders:
            inner.setdefault(holder, []).append(item)
    ordered: dict[Sdf.Path, SharedPrototype] = {}

    def visit(item: SharedPrototype) -> None:
        if item.path not in ordered:
            for other in inner.get(item.path, ()):
                visit(other)
            ordered[item.path] = item

    for item in shared:
        visit(item)
    return list(ordered.values())


def _free_name(layer: Sdf.Layer, stage: Usd.Stage, parent: Sdf.Path) -> Sdf.Path:
    paths = (parent.AppendChild(f"{CLASS_NAME}{number}") for number in itertools.count(1))
    return next(path for path in paths if not stage.GetPrimAtPath(path) and not layer.GetPrimAtPath(path))


def flat_places(layer: Sdf.Layer, paths: Iterable[Sdf.Path]) -> list[Sdf.Path]:
    """Where prims and properties are in a flat layer: what is below instances is in prototypes that they refer to."""
    return [_flat_place(layer, path) for path in paths]


def _flat_place(layer: Sdf.Layer, path: Sdf.Path) -> Sdf.Path:
    place = Sdf.Path.absoluteRootPath
    for prefix in path.GetPrefixes():
        spec = layer.GetPrimAtPath(place)
        if spec and place != Sdf.Path.absoluteRootPath:
            prototypes = [arc.primPath for arc in spec.referenceList.GetAddedOrExplicitItems() if not arc.assetPath]
            place = prototypes[0] if prototypes else place
        place = place.AppendProperty(prefix.name) if prefix.IsPropertyPath() else place.AppendChild(prefix.name)
    return place
