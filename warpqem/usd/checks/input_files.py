"""Files that a stage reads: layers in all variants, value clips, textures and whatever else its layers name.

They are found layer by layer, from the names that are written there, as USD resolves them. Of what is missing the place
is listed where it would be.
"""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from functools import partial

from pxr import Ar, Sdf, Tf, Usd, UsdUtils

from warpqem.errors import StageError
from warpqem.files.outputs import InputFile, OutputFile, OutputFiles
from warpqem.usd.checks.input_check import open_layer
from warpqem.usd.checks.named_assets import UDIM, evaluated, outer_file, place_of
from warpqem.usd.checks.named_by import role_of
from warpqem.usd.checks.usd_errors import usd_errors_named

__all__ = ["check_stage_outputs", "stage_files"]

# In a name the number of a value clip ("clip.###.usd").
NUMBER = re.compile(r"#+")


def check_stage_outputs(
    outputs: Iterable[OutputFile], stages: Iterable[Usd.Stage], files: Iterable[InputFile] = ()
) -> None:
    """Refuse outputs that a stage reads, and two that are the same file; see `warpqem.files.outputs.check_outputs`.

    To be called before anything is written.

    Args:
        outputs: All files that a command is going to write.
        stages: All stages that it reads, with their layers as they are on disk.
        files: Other files that it reads.

    Raises:
        OptionError: an output is an input, a layer, clip or texture of one, is named twice, or is a folder.
        StageError: USD cannot say what a layer names.
    """
    written = OutputFiles(outputs)
    written.check(files)
    if written.outputs:
        for stage in stages:
            written.check(stage_files(stage, written))


def stage_files(stage: Usd.Stage, outputs: OutputFiles) -> list[InputFile]:
    """The files that a stage reads, in any variant.

    Args:
        stage: The stage, opened from a file.
        outputs: What is going to be written. Those that fit the name of a set of tiles or of clips count as files of
            the stage. If none of them is there yet, none can be a file that only a value clip names, and clips are not
            opened to see what they name.

    Raises:
        StageError: USD cannot say what a layer names.
    """
    with Ar.ResolverContextBinder(stage.GetPathResolverContext()):
        return list(_Walk(stage, outputs).files())


class _Walk:
    """From layer to layer, each once."""

    def __init__(self, stage: Usd.Stage, outputs: OutputFiles) -> None:
        self._root = stage.GetRootLayer()
        self._used = [layer for layer in stage.GetUsedLayers(includeClipLayers=True) if layer.realPath]
        self._outputs = outputs
        self._seen: set[str] = set()

    def files(self) -> Iterator[InputFile]:
        if self._root.realPath:
            yield InputFile(outer_file(self._root.realPath))
        yield from self._named_from(self._root)
        # Layers that no walk finds, such as those of expressions whose variables a reference sets.
        for layer in self._used:
            yield InputFile(outer_file(layer.realPath), f"a layer of {self._root.realPath}")
            yield from self._named_from(layer)

    def _named_from(self, first: Sdf.Layer) -> Iterator[InputFile]:
        waiting = [first]
        while waiting:
            layer = waiting.pop()
            if layer.identifier in self._seen:
                continue
            self._seen.add(layer.identifier)
            arcs = _arcs(layer)
            for name in {**arcs, **dict.fromkeys(_names(layer))}:
                place = _place(layer, name)
                if not place:
                    continue
                role = partial(role_of, layer, name)
                for path in (place, *self._set_of(place)):
                    yield InputFile(outer_file(path), role)
                if name in arcs or (self._outputs.any_exists and Usd.Stage.IsSupportedFile(place)):
                    waiting += _opened(place)

    def _set_of(self, place: str) -> list[str]:
        """The files of a set of tiles or clips: those that are there, and outputs that would become a part of it."""
        folder, name = os.path.split(place)
        if UDIM in name:
            parts, digits, number = name.split(UDIM), "[0-9][0-9][0-9][0-9]", r"\d{4}"
        elif NUMBER.search(name) and not os.path.exists(place):
            parts, digits, number = NUMBER.split(name), "*", r"-?\d+"
        else:
            return []
        pattern = re.compile(number.join(map(re.escape, parts)))
        there = glob.glob(digits.join(map(glob.escape, parts)), root_dir=folder)
        return [os.path.join(folder, name) for name in there] + self._outputs.matching(folder, pattern)


def _names(layer: Sdf.Layer) -> list[str]:
    """All that a layer names, in variants, metadata and samples too."""
    with usd_errors_named(layer.identifier):
        found: Sequence[list[str]] = UsdUtils.ExtractExternalReferences(layer.identifier)
    return [name for names in found for name in names]


def _arcs(layer: Sdf.Layer) -> dict[str, None]:
    """Names of the layers that it is composed with."""
    with usd_errors_named(layer.identifier):
        named = [*layer.GetCompositionAssetDependencies(), *layer.GetExternalAssetDependencies()]
    variables = layer.expressionVariables
    return dict.fromkeys(evaluated(name, variables) for name in named if name)


def _place(layer: Sdf.Layer, name: str) -> str:
    """Absolute path of what a layer names, or of where it would be; empty for nothing."""
    place = place_of(layer, name)
    if not place or os.path.isabs(place):
        return place
    # A name that is searched for, and found nowhere: it would be beside the layer.
    return os.path.join(os.path.dirname(outer_file(layer.realPath)), place)


def _opened(place: str) -> list[Sdf.Layer]:
    """The layer at a place; none where USD could not open it either, so that it cannot name anything."""
    try:
        layer = Sdf.Layer.Find(place) or open_layer(place)
    except (StageError, Tf.ErrorException):
        return []
    return [] if layer is None else [layer]
