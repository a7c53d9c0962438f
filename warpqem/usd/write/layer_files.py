"""Layers as files that are written: the names that they may have, and writing them whole."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from pxr import Sdf, Tf

from warpqem.errors import OptionError, StageError
from warpqem.files.formats import how_to_write
from warpqem.files.outputs import InputFile, OutputFile, check_outputs
from warpqem.files.temporary import replacing
from warpqem.usd.checks.text_numbers import make_readable
from warpqem.usd.checks.usd_errors import first_line
from warpqem.usd.write.package import PACKAGE_SUFFIX, is_package

__all__ = ["check_output_path", "export_layer"]

OUTPUT_SUFFIXES = (".usd", ".usda", ".usdc")


def check_output_path(
    output: str | os.PathLike[str],
    inputs: Iterable[str | os.PathLike[str]],
    option: str = "output",
    packages: bool = False,
) -> Path:
    """Check that there can be a USD file of a name, before the inputs are opened.

    Args:
        output: The file to write.
        inputs: Files to read, themselves; `warpqem.usd.checks.input_files.check_stage_outputs` looks at all that they
            name.
        option: Name of the option that names the output, for messages.
        packages: Whether it may be a package (.usdz), too.

    Returns:
        The absolute output path.

    Raises:
        OptionError: the suffix is not one of .usd, .usda, .usdc (.usdz), the folder does not exist, or the path is an
            input.
    """
    path = Path(output).absolute()
    suffixes = (*OUTPUT_SUFFIXES, PACKAGE_SUFFIX) if packages else OUTPUT_SUFFIXES
    if path.suffix.lower() not in suffixes:
        only = " (simplify and batch write packages)" if is_package(path) else ""
        raise OptionError(
            f"{option} {output}: the suffix must be one of {', '.join(suffixes)}{only}{how_to_write(path)}"
        )
    if not path.parent.is_dir():
        raise OptionError(f"{option} {output}: the folder {path.parent} does not exist")
    if path.is_dir():
        raise OptionError(f"{option} {output}: this is a folder")
    check_outputs([OutputFile(option, output)], map(InputFile, inputs))
    return path


def export_layer(layer: Sdf.Layer, output: Path) -> None:
    """Write a layer under a temporary name and rename it.

    Raises:
        StageError: the file cannot be written; nothing is left behind.
    """
    try:
        with replacing(output) as temporary:
            if not layer.Export(os.fspath(temporary)):
                raise StageError(f"{output}: USD cannot write it")
            make_readable(temporary)
    except (OSError, Tf.ErrorException) as error:
        raise StageError(f"{output}: cannot be written ({first_line(error)})") from error
