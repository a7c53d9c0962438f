"""Images that are made for meshes: beside the edits until these are saved, then beside the output."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
from pxr import Sdf, Usd

from warpqem.errors import StageError
from warpqem.files.outputs import OutputFile
from warpqem.files.temporary import remove_path, replacing, temporary_path
from warpqem.usd.checks.input_files import check_stage_outputs

__all__ = ["MapFiles", "place_maps", "texture_folder"]


def texture_folder(output: Path) -> str:
    """Name of the folder beside an output that its own textures are in."""
    return f"{output.stem}_textures"


class MapFiles:
    """Images in a temporary folder, which layers name by absolute paths meanwhile."""

    def __init__(self, parent: Path | None) -> None:
        """No image yet; there can be none where there is no folder to put theirs into."""
        self._parent = parent
        self.folder: Path | None = None
        self.files: list[Path] = []

    def add(self, name: str, pixels: npt.NDArray[np.uint8]) -> str:
        """Write an image (height, width, 3) as PNG.

        Args:
            name: What it is called, without a suffix; one that is taken, in any case of its letters, gets a number.
            pixels: Its pixels.

        Returns:
            The absolute path.

        Raises:
            StageError: it cannot be written.
        """
        # Loaded where there are maps: pictures take a while to load.
        from warpqem.picture.sheet import write_png

        assert self._parent is not None
        taken = {path.name.casefold() for path in self.files}
        file, count = f"{name}.png", 1
        while file.casefold() in taken:
            count += 1
            file = f"{count}_{name}.png"
        try:
            if self.folder is None:
                self.folder = temporary_path(self._parent, ".maps")
                self.folder.mkdir()
            path = self.folder / file
            write_png(pixels, path)
        except OSError as error:
            raise StageError(f"{self._parent}: no image can be written there ({error.strerror or error})") from error
        self.files.append(path)
        return os.fspath(path)

    def holds(self, place: str) -> bool:
        """Whether a file is one of these images."""
        return any(place == os.fspath(path) for path in self.files)

    def close(self) -> None:
        """Remove them."""
        if self.folder is not None:
            remove_path(self.folder)


def place_maps(
    layer: Sdf.Layer, sets: Sequence[tuple[str, MapFiles]], output: Path, stage: Usd.Stage, others: Sequence[OutputFile]
) -> None:
    """Write images into the folder of textures beside an output, and let a layer name them there.

    Args:
        layer: What is going to be saved as the output.
        sets: Images, and what goes in front of their names.
        output: The file.
        stage: The input, whose files none of them may replace.
        others: What else is going to be written.

    Raises:
        StageError: one cannot be written.
        OptionError: one would take the place of a file that is read, or of another output.
    """
    folder = texture_folder(output)
    names = {os.fspath(path): f"{folder}/{start}{path.name}" for start, maps in sets for path in maps.files}
    if not names:
        return
    written = [OutputFile("normal map", output.parent / name) for name in names.values()]
    check_stage_outputs([*written, *others], [stage])
    for source, name in names.items():
        target = output.parent / name
        try:
            target.parent.mkdir(exist_ok=True)
            with replacing(target) as temporary:
                temporary.write_bytes(Path(source).read_bytes())
        except OSError as error:
            raise StageError(f"{target}: cannot be written ({error.strerror or error})") from error
    _rename(layer, {source: f"./{name}" for source, name in names.items()})


def _rename(layer: Sdf.Layer, names: dict[str, str]) -> None:
    found: list[Sdf.Path] = []
    layer.Traverse(Sdf.Path.absoluteRootPath, found.append)
    for path in found:
        attribute = layer.GetAttributeAtPath(path) if path.IsPropertyPath() else None
        if attribute is not None and isinstance(attribute.default, Sdf.AssetPath) and attribute.default.path in names:
            attribute.default = Sdf.AssetPath(names[attribute.default.path])
