"""A waving mesh, and the data that a report's page holds."""

from __future__ import annotations

import base64
import json
import re
import zlib

import numpy as np

from tests.support import meshes


def decode(text: str, dtype: type, shape: tuple[int, ...]) -> np.ndarray:
    """What decode.js makes of it, without the sum over frames."""
    planes = np.frombuffer(zlib.decompress(base64.b64decode(text)), dtype=np.uint8)
    return np.ascontiguousarray(planes.reshape(np.dtype(dtype).itemsize, -1).T).view(dtype).reshape(shape)


def waving(frame_count: int = 4) -> tuple[np.ndarray, np.ndarray]:
    points, faces = meshes.grid(6, 5)
    time = np.arange(frame_count)[:, None]
    moved = np.repeat(np.asarray(points, dtype=np.float64)[None], frame_count, axis=0)
    moved[..., 2] += 0.3 * np.sin(moved[..., 0] + time)
    return moved.astype(np.float32), faces


def data_of(page: str) -> dict:
    return json.loads(re.search(r'id="data">(.*?)</script>', page, re.S)[1])
