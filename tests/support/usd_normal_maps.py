"""Baking normal maps for the meshes of a small stage."""

from __future__ import annotations

from pathlib import Path

from pxr import Usd

from warpqem.usd import SimplifyOptions, simplify_stage

__all__ = ["SIZE", "bake", "baked"]

# Texels across.
SIZE = 32


def bake(source: Path, output: Path, **options: object):
    given = {"ratio": 0.2, "bake_normals": SIZE, "device": "cpu", **options}
    return simplify_stage(source, output, SimplifyOptions(**given))


def baked(source: Path, output: Path, **options: object) -> Usd.Stage:
    report = bake(source, output, **options)
    assert not [line for prim in report.prims for line in prim.problems], report
    return Usd.Stage.Open(str(output))
