"""Who uses skeletons and blend shapes where no mesh is edited: in instances and in variants that are not selected."""

from __future__ import annotations

import os

from pxr import Sdf, Usd, UsdSkel

from warpqem.usd.checks.named_assets import layers_of

__all__ = ["hidden_properties", "shapes_in_proxies", "shapes_in_variants"]

SHAPES = "skel:blendShapes"


def shapes_in_proxies(stage: Usd.Stage) -> dict[Sdf.Path, set[str]]:
    """Names of the blend shapes that meshes of instances take from each animation."""
    found: dict[Sdf.Path, set[str]] = {}
    predicate = Usd.TraverseInstanceProxies(Usd.PrimAllPrimsPredicate)
    for prim in Usd.PrimRange(stage.GetPseudoRoot(), predicate):
        if not prim.IsInstanceProxy():
            continue
        names = list(prim.GetAttribute(SHAPES).Get() or []) if prim.HasAttribute(SHAPES) else []
        skeleton = UsdSkel.BindingAPI(prim).GetInheritedSkeleton() if names else None
        animation = UsdSkel.BindingAPI(skeleton.GetPrim()).GetInheritedAnimationSource() if skeleton else None
        if animation:
            found.setdefault(animation.GetPath(), set()).update(names)
    return found


def shapes_in_variants(stage: Usd.Stage) -> set[str]:
    """Names of the blend shapes of meshes in unselected variants, and in files that only these name.

    Which animation moves them is not known while the variant is not selected.
    """
    found = hidden_properties(stage, frozenset({SHAPES}))
    return {name for layer, path in found for name in layer.GetAttributeAtPath(path).default or []}


def hidden_properties(stage: Usd.Stage, names: frozenset[str]) -> list[tuple[Sdf.Layer, Sdf.Path]]:
    """Properties of some names in unselected variants, and in files that only these name; by layer and place there."""
    shown = {
        (spec.layer.identifier, spec.path)
        for prim in Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies(Usd.PrimAllPrimsPredicate))
        for name in names
        if prim.HasProperty(name)
        for spec in prim.GetProperty(name).GetPropertyStack()
    }
    used = {layer.identifier for layer in stage.GetUsedLayers()}
    return [
        (layer, path)
        for layer in _reachable(stage)
        for path in _properties(layer, names)
        if (layer.identifier not in used or path.ContainsPrimVariantSelection())
        and (layer.identifier, path) not in shown
    ]


def _reachable(stage: Usd.Stage) -> list[Sdf.Layer]:
    """The layers of a stage, and those that these name in any variant."""
    variables = dict(stage.GetRootLayer().expressionVariables)
    found = {layer.identifier: layer for layer in stage.GetUsedLayers()}
    left = list(found.values())
    while left:
        for place in layers_of(left.pop(), variables):
            # Only files are opened here: what is missing is reported where the stage is opened.
            layer = Sdf.Layer.FindOrOpen(place) if os.path.isfile(place) else None
            if layer and layer.identifier not in found:
                found[layer.identifier] = layer
                left.append(layer)
    return list(found.values())


def _properties(layer: Sdf.Layer, names: frozenset[str]) -> list[Sdf.Path]:
    found: list[Sdf.Path] = []
    layer.Traverse(Sdf.Path.absoluteRootPath, lambda path: found.append(path) if path.name in names else None)
    return [path for path in found if path.IsPropertyPath()]
