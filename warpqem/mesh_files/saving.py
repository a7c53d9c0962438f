"""Frames as arrays written to files: one USD file, or a mesh file for each."""

from __future__ import annotations

import importlib
import os
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from warpqem.errors import OptionError
from warpqem.mesh_files.file_names import numbered_files
from warpqem.mesh_files.writing import check_mesh_output, write_frames

__all__ = ["USD_SUFFIXES", "save_frames"]

USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")


def save_frames(
    points: npt.NDArray[np.floating],
    faces: npt.NDArray[np.int32],
    path: str | os.PathLike[str],
    numbers: Sequence[int] | None = None,
    fps: float = 24.0,
) -> list[str]:
    """Write frames; see `warpqem.SimplifiedMesh.save`.

    Args:
        points: (F, V, 3).
        faces: (N, 3).
        path: The file, or the files.
        numbers: (F,) the number of each frame.
        fps: Time codes per second of a USD file.

    Raises:
        OptionError, MeshFileError, StageError: see there.
    """
    chosen = list(range(1, len(points) + 1)) if numbers is None else [int(number) for number in numbers]
    if len(chosen) != len(points):
        raise OptionError(f"numbers: {len(chosen)} of them for {len(points)} frames")
    if os.path.splitext(os.fspath(path))[1].lower() in USD_SUFFIXES:
        # By its name, as the package loads its public names: the core needs no USD.
        importlib.import_module("warpqem.usd.checks.library").need_usd()
        importlib.import_module("warpqem.usd.commands.mesh_stage").save_stage(points, faces, path, chosen, fps)
        return [os.fspath(path)]
    check_mesh_output(path)
    files = numbered_files(path, chosen)
    write_frames(points, faces, points.shape[1], files)
    return files
