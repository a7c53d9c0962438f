"""A mesh in motion as arrays on a device, and results compared wherever they are."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

import warpqem
from tests.support import meshes

POINTS, FACES = meshes.swaying_sphere(3, 21)
POINTS = POINTS.astype(np.float32)
OPTIONS = {"ratio": 0.3, "key_frames": 4}
RESULT_ARRAYS = ("points", "faces", "vertex_map", "face_map")


def on(device: str, points: Any = POINTS, faces: Any = FACES) -> tuple[wp.array, wp.array]:
    return wp.array(points, device=device), wp.array(faces, device=device)


def assert_same(found: warpqem.SimplifiedMesh, expected: warpqem.SimplifiedMesh) -> None:
    here = found.numpy()
    for name in (*RESULT_ARRAYS, "flips", "key_frames"):
        np.testing.assert_array_equal(getattr(here, name), getattr(expected, name), err_msg=name)
    assert (found.stopped, found.error, found.diagonal) == (expected.stopped, expected.error, expected.diagonal)
