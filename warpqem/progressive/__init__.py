"""Progressive deforming meshes: any level of an animated mesh, with the positions of all its frames."""

from warpqem.progressive.build import build_progressive
from warpqem.progressive.file import load, read_info, save, stream
from warpqem.progressive.progressive_mesh import MeshLevel, ProgressiveMesh

__all__ = ["MeshLevel", "ProgressiveMesh", "build_progressive", "load", "read_info", "save", "stream"]
