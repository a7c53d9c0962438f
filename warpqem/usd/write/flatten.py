"""One flat layer of a stage and the edits over it, and that layer as a file beside its textures, or as a package."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from pxr import Sdf, Usd

from warpqem.files.outputs import OutputFile
from warpqem.usd.checks.input_files import check_stage_outputs
from warpqem.usd.layers.asset_paths import move_asset_paths
from warpqem.usd.read.instances import flat_places
from warpqem.usd.read.stage_views import open_like, without_edits
from warpqem.usd.write.collect_files import collect_files, lies_elsewhere, write_collected
from warpqem.usd.write.layer_files import export_layer
from warpqem.usd.write.map_files import MapFiles, texture_folder
from warpqem.usd.write.package import is_package, write_package
from warpqem.usd.write.remove_properties import Dropped

__all__ = ["flattened", "write_flat"]


def flattened(stage: Usd.Stage, edits: Sdf.Layer, classes: Iterable[Sdf.Path], dropped: Iterable[Dropped]) -> Sdf.Layer:
    """A layer that shows by itself what the edits show over a stage.

    Args:
        stage: The input.
        edits: The layer over it.
        classes: Classes in it that instances inherit their edits from.
        dropped: What the edits took off the meshes, which a flat layer leaves out.
    """
    session = without_edits(stage.GetSessionLayer())
    layer = open_like(stage, edits, session).Flatten(addSourceFileComment=False)
    for path in classes:
        # What instances inherited is in their flattened prototypes.
        del layer.GetPrimAtPath(path.GetParentPath()).nameChildren[path.name]
    for spec in layer.rootPrims:
        # Flattening leaves what instances share as overs, which nothing defines.
        if spec.name.startswith("Flattened_Prototype_") and spec.specifier == Sdf.SpecifierOver:
            spec.specifier = Sdf.SpecifierClass
    for part in dropped:
        for path in flat_places(layer, part.blocked):
            _remove_property(layer, path)
        for path in flat_places(layer, part.deactivated):
            spec = layer.GetPrimAtPath(path)
            if spec:
                # Nothing weaker is left in a flat file that an inactive prim would have to hide.
                del layer.GetPrimAtPath(path.GetParentPath()).nameChildren[spec.name]
        for path in flat_places(layer, part.unbound):
            _author_empty_relationship(layer, path)
        for path in flat_places(layer, part.unskinned):
            _remove_api(layer, path, "SkelBindingAPI")
    return layer


def write_flat(
    layer: Sdf.Layer, stage: Usd.Stage, output: Path, other_outputs: Sequence[OutputFile], maps: MapFiles
) -> list[str]:
    """Write a flat layer, and the files that it names where they lie elsewhere.

    Args:
        layer: What `flattened` gives; its asset paths are changed.
        stage: The input.
        output: The file. A package holds all files; pictures and sounds that lie in packages, or outside of the
            output's folder, go into the folder NAME_textures beside another one.
        other_outputs: What else is going to be written: no texture may take its place.
        maps: Images that were made for its meshes, which are gathered as well.

    Returns:
        What was left behind, or programs may not read; one line each.

    Raises:
        StageError: the file cannot be written; nothing is left behind.
        OptionError: a texture would take the place of a file that is read, or of another output.
    """
    source = stage.GetRootLayer()
    if is_package(output):
        collection = collect_files(layer, "textures", lambda place: True, stage)
        # What is left outside, and is mostly missing, is named as from the input.
        move_asset_paths(layer, source, Path(source.realPath).parent)
        return collection.problems + write_package(layer, collection, output)

    def is_gathered(place: str) -> bool:
        return maps.holds(place) or lies_elsewhere(place, output.parent)

    collection = collect_files(layer, texture_folder(output), is_gathered, stage)
    written = [OutputFile("texture", output.parent / name) for name in collection.files]
    check_stage_outputs([*written, *other_outputs] if written else [], [stage])
    write_collected(collection, output.parent)
    move_asset_paths(layer, source, output.parent)
    export_layer(layer, output)
    return collection.problems


def _remove_property(layer: Sdf.Layer, path: Sdf.Path) -> None:
    spec = layer.GetPropertyAtPath(path)
    if spec:
        layer.GetPrimAtPath(path.GetPrimPath()).RemoveProperty(spec)


def _remove_api(layer: Sdf.Layer, path: Sdf.Path, name: str) -> None:
    spec = layer.GetPrimAtPath(path)
    applied = spec.GetInfo("apiSchemas").GetAppliedItems()
    spec.SetInfo("apiSchemas", Sdf.TokenListOp.CreateExplicit([api for api in applied if api != name]))


def _author_empty_relationship(layer: Sdf.Layer, path: Sdf.Path) -> None:
    """Flattening leaves out relationships without targets, even if they are empty on purpose."""
    spec = layer.GetRelationshipAtPath(path)
    if not spec:
        spec = Sdf.RelationshipSpec(layer.GetPrimAtPath(path.GetPrimPath()), path.name, custom=False)
    spec.targetPathList.ClearEditsAndMakeExplicit()
