"""``assemblies``: meshes of many moving parts through warpqem and its peers."""

from benchmarks.assemblies.run import run

__all__ = ["run"]
