"""What meshes look like: colours, textures and which of their edges are hard, at the corners of their triangles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from warpqem.arguments.array_record import ArrayRecord
from warpqem.mesh.components import lowest_members
from warpqem.normal_maps.maps import MappedNormals, NormalMap

__all__ = ["PLAIN", "Look", "Part", "Texture", "corner_normals", "joined", "plain_look", "smoothing_groups"]

# Surfaces without a colour, linear: a warm grey, lighter than most.
PLAIN = (0.55, 0.53, 0.50)
# Edges of a mesh without normals are hard from this angle between their faces, in degrees: those of boxes are, those of
# a coarse level of something round are not.
CREASE_ANGLE = 60.0
# Authored normals at both sides of an edge that are so many degrees apart differ, and do not by rounding.
SAME_NORMAL = 1.0

Ints = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False, repr=False)
class Texture(ArrayRecord):
    """An image on a surface.

    Attributes:
        pixels: (height, width, 3) uint8 sRGB, the top row first.
        repeats: whether it repeats beyond its left and right, and its lower and upper border; else its last colours do.
    """

    pixels: npt.NDArray[np.uint8]
    repeats: tuple[bool, bool] = (True, True)


@dataclass(frozen=True)
class Part:
    """Faces of one mesh that have one texture.

    Attributes:
        name: of the mesh.
        texture: index in the textures; None for none.
    """

    name: str
    texture: int | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Look(ArrayRecord):
    """What a mesh of N triangles looks like.

    Attributes:
        face_part: (N,) integers, which part each face is of.
        parts: what these are.
        textures: what parts refer to.
        colors: (N, 3, 3) linear Rec. 709 at the corners, which textures are multiplied with; None for plain ones.
        uvs: (N, 3, 2) texture coordinates at the corners, from the lower left; None without textures.
        normals: (N, 3, 3) authored normals of any pose at the corners, whose directions alone say which edges are hard;
            NaN where there are none. None without any.
        mapped: normal maps, and the normals that they tilt, in the pose of `rest_corners`; None without any.
        rest_corners: (N, 3, 3) the corners in that pose; None without maps.
    """

    face_part: npt.NDArray[np.integer]
    parts: Sequence[Part]
    textures: Sequence[Texture] = ()
    colors: npt.NDArray[np.floating] | None = None
    uvs: npt.NDArray[np.floating] | None = None
    normals: npt.NDArray[np.floating] | None = None
    mapped: MappedNormals | None = None
    rest_corners: npt.NDArray[np.floating] | None = None

    @property
    def is_plain(self) -> bool:
        """Whether there is neither a colour nor a texture."""
        return self.colors is None and all(part.texture is None for part in self.parts)


def plain_look(face_count: int, name: str = "") -> Look:
    """The look of one mesh without colours, textures and normals."""
    return Look(np.zeros(face_count, dtype=np.int64), [Part(name)])


def joined(looks: Sequence[Look]) -> Look:
    """The look of several meshes as one; textures that are the same object are one."""
    parts: list[Part] = []
    textures: list[Texture] = []
    face_part = []
    for look in looks:
        face_part.append(np.asarray(look.face_part, dtype=np.int64) + len(parts))
        for part in look.parts:
            texture = None if part.texture is None else _index_of(look.textures[part.texture], textures)
            parts.append(Part(part.name, texture))
    counts = [len(look.face_part) for look in looks]
    return Look(
        np.concatenate(face_part) if face_part else np.zeros(0, dtype=np.int64),
        parts,
        textures,
        _stack([look.colors for look in looks], counts, PLAIN),
        _stack([look.uvs for look in looks], counts, (0.0, 0.0)),
        _stack([look.normals for look in looks], counts, (np.nan,) * 3),
        _joined_maps(looks, counts),
        _stack([look.rest_corners for look in looks], counts, (0.0, 0.0, 0.0)),
    )


def _joined_maps(looks: Sequence[Look], counts: Sequence[int]) -> MappedNormals | None:
    maps: list[NormalMap] = []
    face_map = []
    for look, count in zip(looks, counts, strict=True):
        own = np.full(count, -1) if look.mapped is None else np.asarray(look.mapped.face_map)
        face_map.append(np.where(own < 0, own, own + len(maps)))
        maps += [] if look.mapped is None else look.mapped.maps
    if not maps:
        return None
    found = [look.mapped for look in looks]
    uvs, frame_uvs, normals = (
        _stack([None if one is None else getattr(one, name) for one in found], counts, (0.0,) * width)
        for name, width in (("uvs", 2), ("frame_uvs", 2), ("normals", 3))
    )
    assert uvs is not None
    assert normals is not None
    return MappedNormals(maps, np.concatenate(face_map), normals, uvs, frame_uvs)


def _index_of(texture: Texture, textures: list[Texture]) -> int:
    for index, known in enumerate(textures):
        if known is texture:
            return index
    textures.append(texture)
    return len(textures) - 1


def _stack(
    values: Sequence[npt.NDArray[np.floating] | None], counts: Sequence[int], missing: tuple[float, ...]
) -> npt.NDArray[np.floating] | None:
    if all(found is None for found in values):
        return None
    filled = [
        np.broadcast_to(np.array(missing, dtype=np.float32), (count, 3, len(missing))) if found is None else found
        for found, count in zip(values, counts, strict=True)
    ]
    return np.concatenate(filled).astype(np.float32)


def smoothing_groups(
    points: npt.NDArray[np.floating], faces: npt.NDArray[np.integer], normals: npt.NDArray[np.floating] | None = None
) -> npt.NDArray[np.int32]:
    """Corners at one place that are shaded as one surface have one number, (N, 3), from 0 on.

    They do across edges whose authored normals are the same on both sides and, where there are none, across edges at
    which the faces meet at less than `CREASE_ANGLE`. Corners of different vertices at one place count as one, so that
    seams of texture coordinates do not show.

    Args:
        points: (V, 3), one pose.
        faces: (N, 3).
        normals: (N, 3, 3), NaN for none; None for none at all.
    """
    if not len(faces):
        return np.zeros((0, 3), dtype=np.int32)
    _, place = np.unique(points, axis=0, return_inverse=True)
    corner_place = place.ravel()[faces]
    first, second = _edge_neighbours(corner_place)
    # Corners at both ends of each edge, of the two faces that share it.
    links = np.concatenate([_corners_at(corner_place, first, second, end) for end in (0, 1)])
    face_normals = _unit(_face_normals(points, faces))
    own = np.repeat(face_normals, 3, axis=0)
    apart = np.einsum("ij,ij->i", own[links[:, 0]], own[links[:, 1]]) < np.cos(np.radians(CREASE_ANGLE))
    if normals is not None:
        given = _unit(np.asarray(normals, dtype=np.float64).reshape(-1, 3))
        one, other = given[links[:, 0]], given[links[:, 1]]
        known = np.isfinite(one).all(axis=1) & np.isfinite(other).all(axis=1)
        differ = np.einsum("ij,ij->i", one, other) < np.cos(np.radians(SAME_NORMAL))
        apart = np.where(known, differ, apart)
    lowest = lowest_members(faces.size, links[~apart])
    groups: npt.NDArray[np.int32] = np.unique(lowest, return_inverse=True)[1].reshape(faces.shape).astype(np.int32)
    return groups


def corner_normals(
    points: npt.NDArray[np.floating], faces: npt.NDArray[np.integer], groups: npt.NDArray[np.integer]
) -> npt.NDArray[np.float32]:
    """Unit normals at the corners, (N, 3, 3): of each group the mean of its faces, by area."""
    normal = _face_normals(points, faces)
    flat = groups.ravel()
    count = int(flat.max(initial=-1)) + 1
    total = np.stack([np.bincount(flat, np.repeat(axis, 3), count) for axis in normal.T], axis=1)
    unit: npt.NDArray[np.float64] = _unit(total.astype(np.float64))
    return unit[groups].astype(np.float32)


def _face_normals(points: npt.NDArray[np.floating], faces: npt.NDArray[np.integer]) -> npt.NDArray[np.float64]:
    corner = points[faces].astype(np.float64)
    normal: npt.NDArray[np.float64] = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    return normal


def _unit(vectors: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=~(length <= 0))


def _edge_neighbours(faces: Ints) -> tuple[Ints, Ints]:
    """Half edges that follow each other among those of one edge, as 3 * face + corner they start at."""
    start, end = faces, np.roll(faces, -1, axis=1)
    key = (np.minimum(start, end) * (int(faces.max()) + 1) + np.maximum(start, end)).ravel()
    order = np.argsort(key, kind="stable")
    same = key[order[1:]] == key[order[:-1]]
    return order[:-1][same], order[1:][same]


def _corners_at(faces: Ints, first: Ints, second: Ints, end: int) -> Ints:
    """Pairs of corners (E, 2) at one end of shared edges."""
    flat = faces.ravel()
    corner = _along(first, end)
    # The other face may go along the edge in either direction.
    same_way = flat[second] == flat[first]
    other = np.where(same_way, _along(second, end), _along(second, 1 - end))
    return np.stack([corner, other], axis=1)


def _along(half_edge: Ints, end: int) -> Ints:
    """Corner at the start (0) or the end (1) of half edges."""
    return half_edge // 3 * 3 + (half_edge % 3 + end) % 3
