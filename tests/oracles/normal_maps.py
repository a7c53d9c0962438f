"""Normal maps in NumPy: tangents face by face, a map texel by texel, margins by shifted copies."""

from __future__ import annotations

import numpy as np

Array = np.ndarray


def unit(vector: Array) -> Array:
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.divide(vector, length, out=np.zeros_like(vector, dtype=float), where=length > 0)


def tangents(corners: Array, normals: Array, uvs: Array) -> Array:
    """Tangents (N, 3, 4) as MikkTSpace defines them: sums over all corners that agree, one after the other."""
    found = np.zeros((len(corners), 3, 4))
    sums: dict[tuple, Array] = {}
    keys = []
    for corner, normal, uv in zip(corners, normals, uvs, strict=True):
        a, b = uv[1] - uv[0], uv[2] - uv[0]
        area = a[0] * b[1] - a[1] * b[0]
        # The gradient of the first texture coordinate on the face.
        along = unit(np.sign(area) * ((corner[1] - corner[0]) * b[1] - (corner[2] - corner[0]) * a[1]))
        for k in range(3):
            n = normal[k]
            key = (*corner[k], *n, *uv[k], area < 0)
            keys.append(key)
            upright = [e - n * (e @ n) for e in (corner[(k + 1) % 3] - corner[k], corner[(k + 2) % 3] - corner[k])]
            angle = np.arccos(np.clip(unit(upright[0]) @ unit(upright[1]), -1, 1))
            sums[key] = sums.get(key, 0) + angle * unit(along - n * (along @ n))
    for index, key in enumerate(keys):
        found[index // 3, index % 3] = [*unit(sums[key]), -1 if key[-1] else 1]
    return found


def ray_hit(corner: Array, start: Array, direction: Array) -> tuple[float, Array] | None:
    """How far a ray goes to a triangle, and barycentric coordinates there; None where it passes by."""
    matrix = np.stack([corner[1] - corner[0], corner[2] - corner[0], -direction], axis=1)
    if abs(np.linalg.det(matrix)) < 1e-14:
        return None
    second, third, way = np.linalg.solve(matrix, start - corner[0])
    share = np.array([1 - second - third, second, third])
    return (float(way), share) if share.min() >= -1e-9 else None


def baked(output: dict[str, Array], source: dict[str, Array], size: int) -> tuple[Array, Array]:
    """Vectors (size, size, 3) at the middles of texels, by rays alone; and which texels a face is on and a ray hits."""
    frames = tangents(output["corners"], output["normals"], output["uvs"])
    vectors, is_known = np.zeros((size, size, 3)), np.zeros((size, size), dtype=bool)
    for row in range(size):
        for column in range(size):
            p = np.array([(column + 0.5) / size, 1 - (row + 0.5) / size])
            for f, uv in enumerate(output["uvs"]):
                second, third = np.linalg.solve(np.stack([uv[1] - uv[0], uv[2] - uv[0]], axis=1), p - uv[0])
                share = np.array([1 - second - third, second, third])
                if share.min() < 1e-3:
                    continue
                point, normal = share @ output["corners"][f], share @ output["normals"][f]
                hits = []
                for g, corner in enumerate(source["corners"]):
                    if np.cross(corner[1] - corner[0], corner[2] - corner[0]) @ normal <= 0:
                        continue
                    hit = ray_hit(corner, point, unit(normal))
                    if hit is not None:
                        hits.append((abs(hit[0]), unit(hit[1] @ source["normals"][g])))
                if not hits:
                    continue
                wanted = min(hits, key=lambda hit: hit[0])[1]
                tangent = share @ frames[f, :, :3]
                frame = np.stack([tangent, frames[f, 0, 3] * np.cross(normal, tangent), normal], axis=1)
                vectors[row, column] = unit(np.linalg.solve(frame, wanted))
                is_known[row, column] = True
    return vectors, is_known


def dilated(normal: Array, filled: Array) -> tuple[Array, Array]:
    """Texels beside filled ones with the mean of these."""
    total, count = np.zeros_like(normal), np.zeros(filled.shape)
    padded, there = np.pad(normal * filled[..., None], ((1, 1), (1, 1), (0, 0))), np.pad(filled, 1)
    height, width = filled.shape
    for y in range(3):
        for x in range(3):
            total += padded[y : y + height, x : x + width]
            count += there[y : y + height, x : x + width]
    grown = ~filled & (count > 0)
    return np.where(grown[..., None], unit(total), normal), filled | grown
