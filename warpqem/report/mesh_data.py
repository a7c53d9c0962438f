"""Meshes and textures as text that the page decodes."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from warpqem.picture.look import Look, Texture, plain_look, smoothing_groups
from warpqem.picture.render import encoded_srgb
from warpqem.report.encoding import STEPS, Grid, encode

__all__ = ["mesh_data", "packed_textures"]

# The page has room for so many colours in one byte; the last value stands for no feature.
NO_FEATURE = 255
# Distances have 8 bits, as a share of the largest.
DISTANCE_STEPS = 255
# All textures of a page together, in bytes; where they take more, all are made smaller.
LARGEST_TEXTURES = 3 * 2**20
# Of JPEG, 0 to 100: the blocks of less show on a surface that fills the window.
TEXTURE_QUALITY = 82
# A texture of one pixel cannot be made smaller.
MAX_HALVINGS = 9


def mesh_data(
    points: np.ndarray,
    faces: np.ndarray,
    grid: Grid,
    labels: np.ndarray | None = None,
    distance: np.ndarray | None = None,
    scale: float | None = None,
    look: Look | None = None,
    textures: list[Texture] | None = None,
) -> dict[str, Any]:
    """A mesh as the page decodes it.

    Corners that have one vertex, one smoothing group, one colour and one place on the texture are one *wedge*; the page
    draws wedges.

    Args:
        points: (F, V, 3).
        faces: (N, 3) integers.
        grid: what positions are rounded to.
        labels: (V,) integers, motion feature of each vertex, -1 for none; None where nothing was looked for.
        distance: (F, V), in % of the diagonal; None where nothing was measured.
        scale: distance of the last step of the 8 bits; None for the largest of these.
        look: colours and textures; None for none.
        textures: those of the page, which takes those of the look that are not in it yet.
    """
    largest = scale if scale is not None else 0.0 if distance is None else float(distance.max(initial=0.0))
    heat = None
    if distance is not None:
        steps = np.rint(distance * (DISTANCE_STEPS / largest if largest > 0 else 0))
        heat = encode(np.minimum(steps, DISTANCE_STEPS).astype(np.uint8))
    faces = np.asarray(faces, dtype=np.int64)
    look = plain_look(len(faces)) if look is None else look
    # Faces of one part follow each other.
    order = np.argsort(look.face_part, kind="stable")
    found = _wedges(points[0], faces[order], order, look)
    return {
        "vertexCount": points.shape[1],
        "faceCount": len(faces),
        "points": encode(grid.round(points), over_time=True),
        "features": None if labels is None else encode(_feature_bytes(labels)),
        "heat": heat,
        "heatScale": largest,
        "parts": _parts(look, order, [] if textures is None else textures),
        **found,
    }


def _wedges(pose: np.ndarray, faces: npt.NDArray[np.int64], order: npt.NDArray[np.int64], look: Look) -> dict[str, Any]:
    """Faces of wedges, and what each wedge is of."""
    normals = None if look.normals is None else look.normals[order]
    groups = smoothing_groups(pose, faces, normals)
    columns = [faces.reshape(-1, 1), groups.reshape(-1, 1).astype(np.int64)]
    low, step = np.zeros(2), 1.0
    if look.uvs is not None:
        uvs = look.uvs[order].reshape(-1, 2)
        low = uvs.min(axis=0, initial=0.0).astype(np.float64)
        step = float(np.max(uvs.max(axis=0, initial=0.0) - low)) / STEPS or 1.0
        columns.append(np.rint((uvs - low) / step).astype(np.int64))
    if look.colors is not None:
        columns.append(encoded_srgb(look.colors[order].reshape(-1, 3)).astype(np.int64))
    unique, wedge = np.unique(np.concatenate(columns, axis=1), axis=0, return_inverse=True)
    same = len(unique) == len(pose) and np.array_equal(unique[:, 0], np.arange(len(pose)))
    smooth = np.array_equal(unique[:, 1], unique[:, 0])
    at = 2
    data: dict[str, Any] = {
        "faces": encode(wedge.reshape(-1, 3).astype(np.uint32)),
        "wedges": None if same else encode(unique[:, 0].astype(np.uint32), over_time=True),
        "smooth": None if smooth else encode(unique[:, 1].astype(np.uint32), over_time=True),
        "uv": None,
        "colors": None,
    }
    if look.uvs is not None:
        data["uv"] = {"low": low.tolist(), "step": step, "nodes": encode(unique[:, at : at + 2].astype(np.uint16))}
        at += 2
    if look.colors is not None:
        data["colors"] = encode(unique[:, at : at + 3].astype(np.uint8))
    return data


def _parts(look: Look, order: npt.NDArray[np.int64], textures: list[Texture]) -> list[dict[str, Any]]:
    """Name, faces and texture of each part, one after the other."""
    part_of = np.asarray(look.face_part)[order]
    ends = np.searchsorted(part_of, np.arange(len(look.parts)), side="right").tolist()
    found, start = [], 0
    for part, end in zip(look.parts, ends, strict=True):
        index = None if part.texture is None else _index_of(look.textures[part.texture], textures)
        found.append({"name": part.name, "start": start, "count": end - start, "texture": index})
        start = end
    return found


def _index_of(texture: Texture, textures: list[Texture]) -> int:
    place = next((index for index, known in enumerate(textures) if known is texture), len(textures))
    if place == len(textures):
        textures.append(texture)
    return place


def packed_textures(textures: Sequence[Texture]) -> list[dict[str, Any]]:
    """Textures as addresses that hold them, all of them smaller where they would take too much room."""
    for halvings in range(MAX_HALVINGS + 1):
        files = [_jpeg(texture.pixels, 2**halvings) for texture in textures]
        if sum(map(len, files)) <= LARGEST_TEXTURES:
            break
    return [
        {
            "address": "data:image/jpeg;base64," + base64.b64encode(file).decode("ascii"),
            "repeats": list(texture.repeats),
        }
        for file, texture in zip(files, textures, strict=True)
    ]


def _jpeg(pixels: npt.NDArray[np.uint8], smaller: int) -> bytes:
    image = Image.fromarray(pixels)
    if smaller > 1:
        size = max(1, image.width // smaller), max(1, image.height // smaller)
        image = image.resize(size, Image.Resampling.LANCZOS)
    file = io.BytesIO()
    # Colours as fine as brightness: borders between flat colours stay sharp, and images of a few pixels as they are.
    image.save(file, "JPEG", quality=TEXTURE_QUALITY, subsampling=0, optimize=True)
    return file.getvalue()


def _feature_bytes(labels: np.ndarray) -> np.ndarray:
    return np.where(labels < 0, NO_FEATURE, labels % NO_FEATURE).astype(np.uint8)
