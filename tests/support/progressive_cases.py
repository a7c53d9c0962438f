"""Random progressive files that somebody has changed, each from a seed; checksums fit unless they are the change.

A case ends with a named error, or with a mesh that is sound on every level and comes out as USD and as a page. It takes
no more memory than the size of its file accounts for.
"""

from __future__ import annotations

import functools
import json
import random
import re
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

import warpqem
from tests.support import meshes
from tests.support.progressive_changes import (
    ALL_CHANGES,
    LAST_CHANGES,
    VALUES,
    change_extra,
    change_numbers,
    change_table,
)
from tests.support.progressive_files import Chunks, Header, file_bytes, read_file, with_table
from warpqem.costs.screen_error import ScreenView
from warpqem.errors import OptionError, WarpqemError
from warpqem.progressive import ProgressiveMesh, load, read_info, save, stream
from warpqem.report.live import LiveLevels
from warpqem.usd.commands.progressive import LevelChoice, extract_level

# A file may unpack to 64 MiB, or 256 times its size; while it is decoded, shown and written the process takes some
# times as much, and some for the libraries that it uses for the first time.
ACCOUNTED_BYTES, RATIO, TIMES_AS_MUCH, LIBRARY_BYTES = 64 * 2**20, 256, 4, 192 * 2**20


@functools.cache
def _folder() -> Path:
    return Path(tempfile.mkdtemp(prefix="fuzz-progressive-"))


def remove_files() -> None:
    """Remove what the cases made."""
    if _folder.cache_info().currsize:
        shutil.rmtree(_folder(), ignore_errors=True)
        _folder.cache_clear()
        _bases.cache_clear()


@functools.cache
def _bases() -> list[tuple[Header, Chunks]]:
    """Files to start from: of one frame and several, without splits, with one chunk of them, and with three."""
    made = []
    still = meshes.octahedron()
    for points, faces, goal in (
        (*meshes.swaying_sphere(1, 3), None),
        (*meshes.waving_grid(6, 4), None),
        (still[0][None], still[1], 8),
        (*meshes.swaying_sphere(2, 1), None),
        (*meshes.swaying_sphere(4, 2), None),
    ):
        mesh = warpqem.build_progressive(points, faces, base_faces=goal, device="cpu")
        times = [float(2 * frame) for frame in range(len(points))] if len(points) > 1 else None
        units = {"up_axis": "Y", "metres_per_unit": 0.01, "time_codes_per_second": 24.0, "frames_per_second": 24.0}
        path = _folder() / "base.wpqm"
        save(mesh, path, {"prim": "/Root/Mesh", "times": times, "diagonal": 3.5, "stage": units})
        made.append(read_file(path))
    return made


def progressive_case(seed: int) -> str:
    """Change a file, and load and use it as a whole; returns how it ended."""
    draw = random.Random(seed)
    path = _folder() / "case.wpqm"
    path.write_bytes(_changed_file(draw))
    before = _restart_peak()
    try:
        end = _use(path, draw)
    except WarpqemError as error:
        _demand(str(error) and "\n" not in str(error) and len(str(error)) < 2000, "an error of no use: {error!r}")
        # A goal that no level meets is named by itself.
        named = path.name in str(error) or isinstance(error, OptionError)
        _demand(named, f"an error that does not name the file: {error}")
        end = type(error).__name__
    allowed = TIMES_AS_MUCH * max(ACCOUNTED_BYTES, RATIO * path.stat().st_size) + LIBRARY_BYTES
    grown = _peak_bytes() - before
    _demand(grown <= allowed, f"{grown >> 20} MiB for a file of {path.stat().st_size} bytes")
    return end


def _changed_file(draw: random.Random) -> bytes:
    bases = _bases()
    header, chunks = draw.choice([*bases[:4], *bases[:4], bases[4]])
    header, chunks = json.loads(json.dumps(header)), [list(parts) for parts in chunks]
    last: Callable[[random.Random, bytes], bytes] | None = None
    # Most changes end in an error early: some are of what is only looked at in the end.
    changes = draw.choice([ALL_CHANGES, ALL_CHANGES, ALL_CHANGES, [change_extra, change_numbers]])
    for _ in range(draw.choice([1, 1, 1, 2, 3])):
        change = draw.choice(changes)
        if change in LAST_CHANGES:
            last = change
        else:
            change(draw, header, chunks)
    if len(header["chunks"]) == len(chunks) and draw.random() < 0.95:
        header = with_table(header, chunks)
    if draw.random() < 0.15:
        change_table(draw, header)
    if draw.random() < 0.03:
        header[draw.choice(["chunks", "extra"])] = draw.choice(VALUES)
    data = file_bytes(header, chunks)
    return data if last is None else last(draw, data)


# What is done with it.


def _use(path: Path, draw: random.Random) -> str:
    """All that can be done with a file; the first error ends it."""
    info = read_info(path)
    json.dumps(info.extra, allow_nan=False).encode()
    part = load(path, target_faces=draw.choice([1, 2, 20, max(1, info.face_count)]))
    _check_mesh(part)
    mesh = load(path)
    _check_mesh(mesh)
    _demand(mesh.is_complete, "not complete")
    _demand(mesh.vertex_map(0).max(initial=-1) < info.base_vertex_count, "a vertex map out of range")
    *_, last = stream(path)
    _demand(last.split_count == mesh.split_count, "a stream that ends early")
    choices = [{"ratio": 1.0}, {"faces": info.face_count}, {"max_error": 1e9}, {"screen": ScreenView(1.0, 10.0)}]
    for choice in draw.sample(choices, 2):
        extract_level(path, _folder() / draw.choice(["out.usda", "out.usdc"]), LevelChoice(**choice))
    if draw.random() < 0.3:
        live = LiveLevels(mesh, path.name, info.extra, device="cpu")
        json.dumps(live.data(), allow_nan=False).encode()
        json.dumps(live.level(draw.randrange(len(live.splits))), allow_nan=False)
    return "done"


def _check_mesh(mesh: ProgressiveMesh) -> None:
    """Whether levels are meshes, and each is within the one that is coarser."""
    _demand(np.isfinite(mesh.points).all(), "points that are not finite")
    counts = sorted({0, 1, mesh.split_count // 2, mesh.split_count} & set(range(mesh.split_count + 1)))
    for count in counts:
        level = mesh.level(count)
        vertices = mesh.topology.base_count + count
        _demand(level.points.shape == (mesh.frame_count, vertices, 3), "points of another shape")
        _demand(len(set(level.vertex.tolist())) == vertices, "two vertices for one of the input")
        _demand(level.faces.min(initial=0) >= 0 and level.faces.max(initial=0) < vertices, "faces out of range")
        _demand((level.faces != np.roll(level.faces, 1, axis=1)).all(), "a face with a vertex twice")
        _demand(0.0 <= level.error < np.inf, "an error that is none")
    _demand(mesh.error(counts[0]) >= mesh.error(counts[-1]), "errors that rise")
    points, faces = mesh.morph(counts[0], counts[-1], 0.5)
    _demand(len(faces) == mesh.loaded_face_count and points.shape[1] > faces.max(initial=0), "a morph out of range")


def _demand(holds: bool, text: str) -> None:
    if not holds:
        raise AssertionError(text)


def _restart_peak() -> int:
    """Bytes that the process takes now, from which its peak is measured again; 0 where the system does not say."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return 0
    return _status("VmRSS")


def _peak_bytes() -> int:
    try:
        return _status("VmHWM")
    except OSError:
        return 0


def _status(name: str) -> int:
    """An entry of the process's state, in bytes."""
    found = re.search(rf"^{name}:\s+(\d+) kB", Path("/proc/self/status").read_text(), re.MULTILINE)
    return 1024 * int(found[1]) if found else 0
