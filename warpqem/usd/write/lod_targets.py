"""Targets that lie outside the root prim that refers to them, such as materials beside the default prim.

Levels reference each root prim of the input on its own, and a reference loses targets outside what it refers to. They
are written again on the layer of the levels, whose opinion is stronger. USD ignores what is written below an instance;
there a class that the instances inherit from has the targets.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from pxr import Sdf, Usd

from warpqem.errors import OptionError

__all__ = ["OutsideTargets"]

# Name of the classes of instances, before a number.
CLASS_NAME = "Targets_Of_Prototype_"

Moved = Callable[[Sdf.Path], list[Sdf.Path]]


@dataclass(frozen=True)
class _Property:
    """A property with targets outside the root prim: its place relative to `base`, and a copy of its declaration."""

    place: Sdf.Path
    declared: Sdf.PropertySpec
    targets: list[Sdf.Path]


@dataclass
class _Instanced:
    """Such properties below instances of one prototype, relative to them."""

    first: Sdf.Path
    users: list[Sdf.Path] = field(default_factory=list)
    properties: list[_Property] = field(default_factory=list)


class OutsideTargets:
    """The targets of properties at and below one root prim that lie outside it."""

    def __init__(self, root: Usd.Prim) -> None:
        """Find them.

        Args:
            root: A root prim of a stage with no instances opened.

        Raises:
            OptionError: one is below an instance that is itself below an instance.
        """
        self._root = root.GetPath()
        # Specs are alive as long as their layer.
        self._declarations = Sdf.Layer.CreateAnonymous("targets.usda")
        self._plain: list[_Property] = []
        self._instanced: dict[Sdf.Path, _Instanced] = {}
        for prim in Usd.PrimRange(root, Usd.TraverseInstanceProxies(Usd.PrimAllPrimsPredicate)):
            for item in prim.GetAuthoredProperties():
                targets = item.GetTargets() if isinstance(item, Usd.Relationship) else item.GetConnections()
                if not all(target.HasPrefix(self._root) for target in targets):
                    self._add(prim, item, targets)

    def _add(self, prim: Usd.Prim, item: Usd.Property, targets: list[Sdf.Path]) -> None:
        declared = _declare(self._declarations, prim.GetPath(), item)
        if not prim.IsInstanceProxy():
            self._plain.append(_Property(item.GetPath(), declared, targets))
            return
        instance = _instance_of(prim)
        if instance.IsInstanceProxy():
            raise OptionError(
                f"lods: {item.GetPath()} refers to {', '.join(map(str, targets))}, outside the root prim {self._root}, "
                f"from an instance within an instance; levels need all that such a prim refers to below its root prim"
            )
        entry = self._instanced.setdefault(instance.GetPrototype().GetPath(), _Instanced(instance.GetPath()))
        if instance.GetPath() not in entry.users:
            entry.users.append(instance.GetPath())
        if instance.GetPath() == entry.first:
            entry.properties.append(_Property(item.GetPath(), declared, targets))

    def write(self, layer: Sdf.Layer, place: Sdf.Path, moved: Moved) -> None:
        """Write them, but where the layer has targets of its own.

        Args:
            layer: The layer of the levels.
            place: Where the root prim is on it, perhaps in a variant.
            moved: What a path of the input is there.
        """
        for item in self._plain:
            _write(layer, item.place.ReplacePrefix(self._root, place), item, moved)
        for number, entry in enumerate(self._instanced.values(), start=1):
            path = place.AppendChild(f"{CLASS_NAME}{number}")
            Sdf.CreatePrimInLayer(layer, path).specifier = Sdf.SpecifierClass
            home = path.StripAllVariantSelections()

            def moved_in(target: Sdf.Path, first: Sdf.Path = entry.first, home: Sdf.Path = home) -> list[Sdf.Path]:
                return [target.ReplacePrefix(first, home)] if target.HasPrefix(first) else moved(target)

            for item in entry.properties:
                _write(layer, item.place.ReplacePrefix(entry.first, path), item, moved_in)
            for user in entry.users:
                Sdf.CreatePrimInLayer(layer, user.ReplacePrefix(self._root, place)).inheritPathList.Append(home)


def _instance_of(proxy: Usd.Prim) -> Usd.Prim:
    prim = proxy.GetParent()
    while not prim.IsInstance():
        prim = prim.GetParent()
    return prim


def _declare(layer: Sdf.Layer, path: Sdf.Path, item: Usd.Property) -> Sdf.PropertySpec:
    prim = Sdf.CreatePrimInLayer(layer, path)
    if isinstance(item, Usd.Relationship):
        return Sdf.RelationshipSpec(prim, item.GetName(), custom=item.IsCustom())
    return Sdf.AttributeSpec(prim, item.GetName(), item.GetTypeName(), item.GetVariability(), item.IsCustom())


def _write(layer: Sdf.Layer, place: Sdf.Path, item: _Property, moved: Moved) -> None:
    targets = [path for target in item.targets for path in moved(target)]
    spec = layer.GetPropertyAtPath(place)
    if isinstance(item.declared, Sdf.RelationshipSpec):
        spec = spec or Sdf.RelationshipSpec(_holder(layer, place), place.name, custom=item.declared.custom)
        if not spec.HasInfo("targetPaths"):
            spec.targetPathList.explicitItems = targets
    else:
        kind = (item.declared.typeName, item.declared.variability, item.declared.custom)
        spec = spec or Sdf.AttributeSpec(_holder(layer, place), place.name, *kind)
        if not spec.HasInfo("connectionPaths"):
            spec.connectionPathList.explicitItems = targets


def _holder(layer: Sdf.Layer, place: Sdf.Path) -> Sdf.PrimSpec:
    return Sdf.CreatePrimInLayer(layer, place.GetPrimOrPrimVariantSelectionPath())
