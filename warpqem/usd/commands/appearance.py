"""How the meshes of two stages look different, beyond their shape."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from pxr import Usd

from warpqem.errors import StageError
from warpqem.measure import Appearance, compare_appearance
from warpqem.usd.read.read_mesh import MeshSource, StageMesh
from warpqem.usd.read.skeleton_poses import StagePoses
from warpqem.usd.read.surface_values import compare_as_posed, surface_values
from warpqem.usd.read.time_codes import FrameRange

__all__ = ["compare_looks", "stage_looks"]


def compare_looks(
    sources: Sequence[MeshSource],
    meshes: Sequence[StageMesh],
    device: str | None,
    progress: Callable[[int, int], None] | None = None,
) -> Appearance:
    """Compare what a mesh is textured, shaded and coloured by with a reference.

    Args:
        sources: The reference and the test mesh.
        meshes: Both with all their poses, at the same times.
        device: Warp device; None for the default.
        progress: Called with the number of frames done, and of all.
    """
    times = meshes[0].times
    values = compare_as_posed(sources, [surface_values(source, times) for source in sources])
    sides = [(mesh.points, mesh.right_handed_faces, value) for mesh, value in zip(meshes, values, strict=True)]
    return compare_appearance(*sides[0], *sides[1], device=device, progress=progress)


def stage_looks(
    reference: Usd.Stage, test: Usd.Stage, path: str, frames: FrameRange | None, device: str | None
) -> Appearance:
    """The same of the meshes at a path of two stages, at the frames of the reference.

    Raises:
        WarpqemError: One of them cannot be read, or not compared.
    """
    prims = [stage.GetPrimAtPath(path) for stage in (reference, test)]
    if not all(prims):
        raise StageError(f"{path}: there is no such mesh in one of the files")
    sources = [MeshSource(prim, StagePoses(stage)) for prim, stage in zip(prims, (reference, test), strict=True)]
    times = sources[0].frame_times(frames)
    return compare_looks(sources, [source.read(times) for source in sources], device)
