"""``props``: a stage of many small meshes, surfaces of revolution, crates, pipes and rocks, no two of them alike."""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.figures import median
from benchmarks.machine import describe_machine
from benchmarks.report import Column, Report, Table
from benchmarks.settings import Settings
from benchmarks.startup import time_process

__all__ = ["Prop", "props", "run", "run_once", "write_props"]

# Faces of the smallest and the largest prop.
FEWEST, MOST = 200, 500


@dataclass(frozen=True)
class Prop:
    """One mesh.

    Attributes:
        name: of its prim.
        points: (V, 3) float32.
        faces: (N, 3) int32.
        uv: (V, 2) float32, texture coordinates at the points.
    """

    name: str
    points: NDArray[np.float32]
    faces: NDArray[np.int32]
    uv: NDArray[np.float32]


def props(count: int, seed: int = 0) -> Iterator[Prop]:
    """So many props, the same ones for a seed; no two of them are congruent."""
    for index in range(count):
        rng = np.random.default_rng([seed, index])
        kind = KINDS[index % len(KINDS)]
        yield kind(f"{kind.__name__.strip('_')}_{index}", rng)


def write_props(path: Path, count: int, *, shaded: bool = False, seed: int = 0) -> None:
    """Write a stage of props beside each other; ``shaded`` ones have normals and texture coordinates."""
    from pxr import Gf, Sdf, Usd, UsdGeom, Vt

    stage = Usd.Stage.CreateNew(str(path))
    world = UsdGeom.Xform.Define(stage, "/World")
    stage.SetDefaultPrim(world.GetPrim())
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    side = int(np.ceil(np.sqrt(count)))
    for index, prop in enumerate(props(count, seed)):
        mesh = UsdGeom.Mesh.Define(stage, f"/World/{prop.name}")
        mesh.AddTranslateOp().Set(Gf.Vec3d(3.0 * (index % side), 3.0 * (index // side), 0.0))
        mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(prop.points))
        mesh.CreateFaceVertexCountsAttr(Vt.IntArray([3] * len(prop.faces)))
        mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(prop.faces.ravel()))
        mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        mesh.CreateExtentAttr([Gf.Vec3f(*map(float, end(axis=0))) for end in (prop.points.min, prop.points.max)])
        if shaded:
            mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(_normals(prop)))
            mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
            coordinates = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(
                "st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.vertex
            )
            coordinates.Set(Vt.Vec2fArray.FromNumpy(prop.uv))
    stage.Save()


def _normals(prop: Prop) -> NDArray[np.float32]:
    """(V, 3) unit normals, those of the faces around weighted by area."""
    a, b, c = (prop.points[prop.faces[:, corner]] for corner in range(3))
    normals = np.zeros_like(prop.points)
    np.add.at(normals, prop.faces, np.cross(b - a, c - a)[:, None])
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


def _grid(rows: int, columns: int, closed: bool) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Faces and texture coordinates of rows x columns points; ``closed`` joins the last column to the first."""
    last = columns if closed else columns - 1
    i, j = (index.ravel() for index in np.mgrid[: rows - 1, :last])
    a, b = i * columns + j, i * columns + (j + 1) % columns
    c, d = a + columns, b + columns
    faces = np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)])
    row, column = np.divmod(np.arange(rows * columns), columns)
    return faces.astype(np.int32), np.stack([column / columns, row / rows], axis=1).astype(np.float32)


def _size(rng: np.random.Generator) -> tuple[int, int]:
    """Rows and columns of a grid of about as many faces as a prop has."""
    columns = int(rng.integers(9, 15))
    # A sheet has a column of faces less than it has columns of points.
    fewest, most = -(-FEWEST // (2 * (columns - 1))), MOST // (2 * columns)
    return int(rng.integers(fewest, most + 1)) + 1, columns


def _vase(name: str, rng: np.random.Generator) -> Prop:
    """A surface of revolution, open at its ends."""
    rows, columns = _size(rng)
    height = np.linspace(0, rng.uniform(0.8, 2.0), rows)
    radius = 0.5 + sum(
        rng.uniform(0.02, 0.15) * np.sin(k * height * rng.uniform(1, 3) + rng.uniform(0, 6)) for k in (1, 2, 3)
    )
    angle = 2 * np.pi * np.arange(columns) / columns
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    across = radius[:, None, None] * ring
    points = np.concatenate([across, np.broadcast_to(height[:, None, None], (rows, columns, 1))], axis=2)
    faces, uv = _grid(rows, columns, closed=True)
    return Prop(name, points.reshape(-1, 3).astype(np.float32), faces, uv)


def _pipe(name: str, rng: np.random.Generator) -> Prop:
    """A bent pipe."""
    rows, columns = _size(rng)
    t = np.linspace(0, 1, rows)
    bend, rise, thickness = rng.uniform(1, 4), rng.uniform(0.2, 1), rng.uniform(0.08, 0.2)
    centre = np.stack([np.cos(bend * t), np.sin(bend * t), rise * t], axis=1)
    out = np.stack([np.cos(bend * t), np.sin(bend * t), np.zeros(rows)], axis=1)
    angle = 2 * np.pi * np.arange(columns) / columns
    ring = np.cos(angle)[:, None] * out[:, None] + np.sin(angle)[:, None] * np.array([0, 0, 1.0])
    swell = 1 + 0.3 * np.sin(2 * np.pi * rng.integers(1, 5) * t)
    points = centre[:, None] + thickness * swell[:, None, None] * ring
    faces, uv = _grid(rows, columns, closed=True)
    return Prop(name, points.reshape(-1, 3).astype(np.float32), faces, uv)


def _panel(name: str, rng: np.random.Generator) -> Prop:
    """A bumpy sheet with borders."""
    rows, columns = _size(rng)
    y, x = np.mgrid[:rows, :columns] / np.array([rows, columns])[:, None, None]
    height = sum(
        rng.uniform(0.02, 0.1) * np.sin(2 * np.pi * (rng.uniform(0.5, 2) * x + rng.uniform(0.5, 2) * y)) for _ in "abc"
    )
    points = np.stack([x * rng.uniform(1, 2), y * rng.uniform(1, 2), height], axis=2)
    faces, uv = _grid(rows, columns, closed=False)
    return Prop(name, points.reshape(-1, 3).astype(np.float32), faces, uv)


def _crate(name: str, rng: np.random.Generator) -> Prop:
    """A closed box of quads with rounded edges: six welded sides."""
    cells = int(rng.integers(5, 7))
    side = np.arange(cells + 1) / cells * 2 - 1
    u, v = (value.ravel() for value in np.meshgrid(side, side, indexing="ij"))
    sides, faces = [], []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            points = np.insert(np.stack([u, v], axis=1), axis, sign, axis=1)
            grid, uv = _grid(cells + 1, cells + 1, closed=False)
            flips = (sign > 0) == (axis == 1)
            faces.append((grid if flips else grid[:, ::-1]) + len(sides) * len(points))
            sides.append(np.concatenate([points, uv], axis=1))
    every = np.concatenate(sides)
    _, first, vertex = np.unique(np.round(every[:, :3], 6), axis=0, return_index=True, return_inverse=True)
    points = every[first, :3]
    # Towards a ball, so that edges are round.
    ball = points / np.linalg.norm(points, axis=1, keepdims=True)
    points = (points + rng.uniform(0.05, 0.4) * (ball - points)) * rng.uniform(0.3, 0.8, 3)
    welded = vertex.reshape(-1)[np.concatenate(faces)].astype(np.int32)
    return Prop(name, points.astype(np.float32), welded, every[first, 3:].astype(np.float32))


def _rock(name: str, rng: np.random.Generator) -> Prop:
    """A bumpy torus, squeezed."""
    rows, columns = _size(rng)
    rows -= 1
    u, v = 2 * np.pi * np.arange(rows) / rows, 2 * np.pi * np.arange(columns) / columns
    bump = 1 + 0.3 * np.sin(rng.integers(2, 5) * u + rng.uniform(0, 6))[:, None] * np.cos(2 * v)[None]
    minor = rng.uniform(0.15, 0.35) * bump
    ring = 0.6 + minor * np.cos(v)
    x, y, z = ring * np.cos(u)[:, None], ring * np.sin(u)[:, None], minor * np.sin(v)
    points = np.stack([x, y, z], axis=2) * rng.uniform(0.6, 1.2, 3)
    faces, uv = _grid(rows + 1, columns, closed=True)
    faces = faces[:, ::-1] % (rows * columns)
    return Prop(name, points.reshape(-1, 3).astype(np.float32), faces, uv[: rows * columns])


KINDS: tuple[Callable[[str, np.random.Generator], Prop], ...] = (_vase, _pipe, _panel, _crate, _rock)

COLUMNS = (
    Column("quality", "quality"),
    Column("shaded", "normals and UVs"),
    Column("meshes", "meshes", "d"),
    Column("reached", "at their count", "d"),
    Column("cpu_seconds", "CPU s", ".2f"),
    Column("each", "ms each", ".1f"),
)
# Props of a stage, and what is left of their faces.
COUNT, QUICK_COUNT, RATIO = 1000, 5, 0.25


def run(settings: Settings) -> Report:
    """`warpqem simplify` on stages of props, whole command, and how many meshes reached their count."""
    report = Report("props", "Many small meshes", describe_machine(["warpqem", "usd-core"]))
    count = QUICK_COUNT if settings.quick else COUNT
    rows = []
    with tempfile.TemporaryDirectory(prefix="warpqem-bench-") as folder:
        for shaded in (False, True):
            source = Path(folder) / f"props_{shaded}.usdc"
            write_props(source, count, shaded=shaded)
            for quality in ("fast", "best"):
                times, reached = zip(*(run_once(source, quality, settings) for _ in range(settings.turns)), strict=True)
                seconds = median(times)
                rows.append(
                    {
                        "quality": quality,
                        "shaded": "yes" if shaded else "no",
                        "meshes": count,
                        "reached": min(reached),
                        "cpu_seconds": seconds,
                        "each": 1000 * seconds / count,
                        "all_cpu_seconds": times,
                    }
                )
    report.tables.append(Table(f"Props of {FEWEST} to {MOST} faces to {RATIO:.0%}, whole command", COLUMNS, rows))
    return report


def run_once(source: Path, quality: str, settings: Settings) -> tuple[float, int]:
    """CPU seconds of a command, and the meshes that have no more faces than asked for."""
    target, figures = source.with_suffix(".out.usdc"), source.with_suffix(".json")
    command = [sys.executable, "-m", "warpqem", "simplify", str(source), "-o", str(target), "--ratio", str(RATIO)]
    command += ["--quality", quality, "--json", str(figures), "-q"]
    _, seconds = time_process([*command, *(["--device", settings.device] if settings.device else [])])
    prims = json.loads(figures.read_text("utf-8"))["prims"]
    return seconds, sum(prim["faces_after"] <= max(1, round(RATIO * prim["faces_before"])) for prim in prims)
