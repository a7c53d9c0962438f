"""What validators find in an output and not in its input."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from pxr import Sdf, Usd

from tests.support.usd_findings import Finding


def new_findings(source: Path, output: Path, find: Callable[[Path], dict[Finding, str]]) -> dict[Finding, str]:
    """What is found in an output, on each of its levels, and at the same place of the input is not."""
    known, found = find(source), find(output)
    layer = Sdf.Layer.FindOrOpen(str(output))
    root = Sdf.Path.absoluteRootPath.AppendChild(layer.defaultPrim) if layer.defaultPrim else None
    if root and layer.GetPrimAtPath(root) and "LOD" in layer.GetPrimAtPath(root).variantSets:
        wrapper = Usd.Stage.Open(layer)
        wrapper.SetEditTarget(wrapper.GetSessionLayer())
        for name in layer.GetPrimAtPath(root).variantSets["LOD"].variants.keys():  # noqa: SIM118
            chosen = Sdf.Layer.CreateNew(str(output.with_name(f"{name}.usda")))
            chosen.subLayerPaths.append(f"./{output.name}")
            Sdf.CreatePrimInLayer(chosen, root).variantSelections["LOD"] = name
            for key in ("defaultPrim", "upAxis", "metersPerUnit", "timeCodesPerSecond"):
                if layer.pseudoRoot.HasInfo(key):
                    chosen.pseudoRoot.SetInfo(key, layer.pseudoRoot.GetInfo(key))
            chosen.Save()
            found |= find(Path(chosen.realPath))
    levels = [f"{root}/LOD/LOD{level}" for level in range(3)]
    places = {place: next((place.replace(at, str(root), 1) for at in levels if place.startswith(at)), place)
              for _rule, place in found}  # fmt: skip
    return {(rule, place): text for (rule, place), text in found.items() if (rule, places[place]) not in known}
