"""Maps baked from one surface for another, against NumPy and against what they are to show."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from tests.oracles import normal_maps as oracle
from warpqem.mesh.directions import unit_vectors
from warpqem.normal_maps.bake import MARGIN, BakeSurface, bake_normals, dilated, overlap_share
from warpqem.normal_maps.maps import MappedNormals, NormalMap, decoded, encoded
from warpqem.normal_maps.tangents import corner_tangents

DEVICE = "cpu"
FLAT = [128, 128, 255]


def grid(side: int, height=lambda x, y: 0 * x) -> np.ndarray:
    """Corners (N, 3, 3) of a sheet over the unit square."""
    x, y = np.meshgrid(np.linspace(0, 1, side + 1), np.linspace(0, 1, side + 1))
    points = np.stack([x, y, height(x, y)], axis=-1).reshape(-1, 3)
    first = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    faces = np.concatenate([first[:, None] + [0, 1, side + 2], first[:, None] + [0, side + 2, side + 1]])
    return points[faces]


def ball(columns: int, rows: int, mirrored: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Corners and texture coordinates of a sphere by longitude and latitude, one seam, without its poles."""
    u, v = np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0.05, 0.95, rows + 1))
    longitude, latitude = 2 * np.pi * u, np.pi * (v - 0.5)
    points = np.stack(
        [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)], axis=-1
    ).reshape(-1, 3)
    uvs = np.stack([1 - u if mirrored else u, v], axis=-1).reshape(-1, 2)
    first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    faces = np.concatenate([first[:, None] + [0, 1, columns + 2], first[:, None] + [0, columns + 2, columns + 1]])
    return points[faces], uvs[faces]


def faceted(corners: np.ndarray) -> np.ndarray:
    normal = unit_vectors(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    return np.repeat(normal[:, None], 3, axis=1)


def surface(corners: np.ndarray, normals=None, uvs=None, part=None, mapped=None) -> BakeSurface:
    normals = faceted(corners) if normals is None else normals
    part = np.zeros(len(corners), dtype=int) if part is None else part
    return BakeSurface(corners, normals, part, uvs, mapped)


def shown(output: BakeSurface, pixels: np.ndarray, count: int = 3000) -> tuple[np.ndarray, np.ndarray]:
    """Points of a surface, and the normals that it has there with a map, by its nearest texel."""
    random = np.random.default_rng(5)
    face, weight = random.integers(0, len(output.corners), count), random.dirichlet([1, 1, 1], count)
    tangents = corner_tangents(output.corners, output.normals, output.uvs)
    point, uv, normal, tangent = (
        np.einsum("nk,nkc->nc", weight, values[face])
        for values in (output.corners, output.uvs, output.normals, tangents[..., :3])
    )
    size = len(pixels)
    place = np.clip((uv * size).astype(int), 0, size - 1)
    vector = decoded(pixels[size - 1 - place[:, 1], place[:, 0]])
    bitangent = tangents[face, 0, 3:] * np.cross(normal, tangent)
    found = vector[:, :1] * tangent + vector[:, 1:2] * bitangent + vector[:, 2:] * normal
    return point, unit_vectors(found)


def degrees(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    cosine = (unit_vectors(one) * unit_vectors(other)).sum(axis=-1)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def test_flat_sheet_of_a_flat_sheet_is_not_tilted():
    sheet = grid(4)
    baked = bake_normals(surface(sheet, uvs=sheet[..., :2]), surface(grid(7)), 32, device=DEVICE)
    assert baked.filled.all()
    assert (baked.pixels == FLAT).all()


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("smooth", [False, True])
def test_map_of_a_sphere_restores_its_normals_on_a_coarse_one(smooth, mirrored):
    fine, (coarse, uvs) = ball(128, 64)[0], ball(16, 8, mirrored)
    output = surface(coarse, unit_vectors(coarse) if smooth else None, uvs)
    baked = bake_normals(output, surface(fine, unit_vectors(fine)), 128, device=DEVICE)
    point, normal = shown(output, baked.pixels)
    error = degrees(normal, unit_vectors(point))
    # Beside an edge, a texel is of two faces, and has two frames where these are faceted.
    assert np.percentile(error, 99 if smooth else 85) < 2.0
    assert np.mean(error) < 2.0
    # Without the map, faces of 20 degrees are off by a part of that.
    assert smooth or degrees(faceted(coarse)[:, 0], unit_vectors(coarse[:, 0])).mean() > 10


@pytest.mark.parametrize("turned", [False, True])
def test_map_is_that_of_numpy(turned):
    def height(x, y):
        return 0.1 * np.sin(5 * x) * np.cos(4 * y)

    def normals_of(corners):
        x, y = corners[..., 0], corners[..., 1]
        slope = np.stack([-0.5 * np.cos(5 * x) * np.cos(4 * y), 0.4 * np.sin(5 * x) * np.sin(4 * y), 1 + 0 * x], -1)
        return unit_vectors(slope)

    fine, coarse = grid(6, height), grid(2, height)
    uvs = coarse[..., :2] * 0.8 + 0.1
    if turned:
        # Turned by a quarter and mirrored.
        uvs = uvs[..., ::-1].copy()
    output, source = surface(coarse, normals_of(coarse), uvs), surface(fine, normals_of(fine))
    size = 16
    baked = bake_normals(output, source, size, device=DEVICE)
    given = [{"corners": one.corners, "normals": one.normals, "uvs": one.uvs} for one in (output, source)]
    wanted, is_known = oracle.baked(*given, size)
    assert is_known.sum() > 100
    # Bytes, and the mean of four points of a texel instead of its middle.
    assert np.abs(decoded(baked.pixels)[is_known] - wanted[is_known]).max() < 0.03


def test_ray_meets_the_nearest_face_of_the_right_side():
    sheet = grid(2)
    above, below = sheet + np.array([0, 0, 0.2]), sheet - [0, 0, 0.1]
    # The upper one is tilted in its normals alone; the nearer one below faces away.
    tilted = np.broadcast_to(unit_vectors(np.array([0.5, 0.0, 1.0])), above.shape)
    source = np.concatenate([above, below[:, ::-1]])
    normals = np.concatenate([tilted, np.broadcast_to([0.0, 0.0, -1.0], below.shape)])
    baked = bake_normals(surface(sheet, uvs=sheet[..., :2]), surface(source, normals), 16, device=DEVICE)
    assert np.abs(decoded(baked.pixels) - tilted[0, 0]).max() < 0.01


def test_faces_look_for_those_of_their_own_part():
    sheet = grid(2)
    tilted = np.broadcast_to(unit_vectors(np.array([0.0, -0.5, 1.0])), sheet.shape)
    flat = np.broadcast_to([0.0, 0.0, 1.0], sheet.shape)
    source = surface(
        np.concatenate([sheet + np.array([0, 0, 0.2]), sheet + np.array([0, 0, 0.01])]),
        np.concatenate([tilted, flat]),
        part=np.repeat([7, 3], len(sheet)),
    )
    output = surface(sheet, uvs=sheet[..., :2], part=np.full(len(sheet), 7))
    baked = bake_normals(output, source, 16, device=DEVICE)
    assert np.abs(decoded(baked.pixels) - tilted[0, 0]).max() < 0.01


def test_point_that_no_ray_leads_from_takes_the_nearest_one():
    sheet = grid(2)
    tilted = np.broadcast_to(unit_vectors(np.array([0.5, 0.2, 1.0])), sheet.shape)
    # Beside the output, so that its rays pass by.
    baked = bake_normals(
        surface(sheet, uvs=sheet[..., :2]), surface(sheet + np.array([3, 0, 0.5]), tilted), 16, device=DEVICE
    )
    assert np.abs(decoded(baked.pixels) - tilted[0, 0]).max() < 0.01


def test_ray_along_a_wall_takes_the_nearest_point_instead():
    sheet = grid(2)
    # Hardly any of the way up, the floor; far up, a roof that the ray meets.
    floor, roof = sheet * [1, 1, 0] + [1.02, 0, 0], sheet + np.array([0, 0, 0.8])
    tilted = np.broadcast_to(unit_vectors(np.array([0.5, 0.0, 1.0])), floor.shape)
    flat = np.broadcast_to([0.0, 0.0, 1.0], roof.shape)
    source = surface(np.concatenate([floor, roof]), np.concatenate([tilted, flat]))
    baked = bake_normals(surface(sheet, uvs=sheet[..., :2]), source, 16, device=DEVICE)
    vectors = decoded(baked.pixels)
    assert np.abs(vectors[:, -1] - tilted[0, 0]).max() < 0.01
    assert np.abs(vectors[:, 0] - [0, 0, 1]).max() < 0.01


def test_map_of_the_source_tilts_its_normals():
    sheet = grid(3)
    vector = unit_vectors(np.array([0.4, -0.3, 1.0])).astype(np.float32)
    normals = np.broadcast_to([0.0, 0.0, 1.0], sheet.shape)
    mapped = MappedNormals(
        [NormalMap(np.broadcast_to(vector, (4, 4, 3)))], np.zeros(len(sheet), int), normals, sheet[..., :2]
    )
    output = surface(sheet, uvs=sheet[..., :2])
    baked = bake_normals(output, surface(sheet, normals, mapped=mapped), 16, device=DEVICE)
    assert np.abs(decoded(baked.pixels) - vector).max() < 0.01


def test_baked_again_a_map_is_itself():
    fine, (coarse, uvs) = ball(64, 32)[0], ball(16, 8)
    # Normals that are off, so that the map has something to put right.
    slanted = unit_vectors(unit_vectors(coarse) + np.array([0.3, 0.0, 0.2]))
    output = surface(coarse, slanted, uvs)
    baked = bake_normals(output, surface(fine, unit_vectors(fine)), 64, device=DEVICE)
    mapped = MappedNormals([NormalMap(decoded(baked.pixels))], np.zeros(len(coarse), int), slanted, uvs)
    again = bake_normals(output, surface(coarse, slanted, mapped=mapped), 64, device=DEVICE)
    assert degrees(decoded(baked.pixels)[again.filled], np.array([0.0, 0.0, 1.0])).mean() > 5
    error = degrees(decoded(again.pixels)[again.filled], decoded(baked.pixels)[again.filled])
    # Sampled between texels, and in bytes twice.
    assert np.percentile(error, 95) < 1.5


def test_bits_are_the_same_on_every_run():
    fine, (coarse, uvs) = ball(64, 32)[0], ball(16, 8)
    output, source = surface(coarse, uvs=uvs), surface(fine, unit_vectors(fine))
    one, other = (bake_normals(output, source, 64, device=DEVICE) for _ in range(2))
    assert np.array_equal(one.pixels, other.pixels)


def test_margin_goes_on_with_the_colours_of_the_border():
    sheet = grid(2)
    tilted = np.broadcast_to(unit_vectors(np.array([0.5, 0.0, 1.0])), sheet.shape)
    size = 128
    output = surface(sheet, uvs=sheet[..., :2] * 0.25 + 0.375)
    baked = bake_normals(output, surface(sheet, tilted), size, device=DEVICE)
    filled = np.argwhere(baked.filled)
    low, high = filled.min(axis=0), filled.max(axis=0) + 1
    vectors = decoded(baked.pixels)
    grown = vectors[low[0] - MARGIN : high[0] + MARGIN, low[1] - MARGIN : high[1] + MARGIN]
    assert np.abs(grown - tilted[0, 0]).max() < 0.01
    assert (baked.pixels[: low[0] - MARGIN] == FLAT).all()


def test_dilation_is_that_of_numpy():
    random = np.random.default_rng(2)
    filled = random.random((20, 24)) < 0.1
    normal = unit_vectors(random.normal(size=(20, 24, 3)) + np.array([0, 0, 2])).astype(np.float32) * filled[..., None]
    wanted, there = oracle.dilated(normal.astype(float), filled)
    arrays = wp.array(normal, dtype=wp.vec3, device=DEVICE), wp.array(filled.astype(np.int32), device=DEVICE)
    found = dilated(*arrays, 1, DEVICE)
    assert np.allclose(found, np.where(there[..., None], wanted, [0, 0, 1]), atol=1e-6)


def test_texels_under_two_triangles_overlap():
    uvs = grid(4)[..., :2]
    assert overlap_share(uvs, 64, device=DEVICE) == 0.0
    half = np.concatenate([uvs * 0.5, uvs * 0.5 + [0.25, 0.0]])
    # Of three strips of a quarter's width, the middle one is under both.
    assert overlap_share(half, 64, device=DEVICE) == pytest.approx(1 / 3, abs=0.01)
    assert overlap_share(np.concatenate([uvs, uvs[:, ::-1]]), 64, device=DEVICE) == 1.0


def test_triangles_that_share_edges_do_not_overlap():
    random = np.random.default_rng(3)
    side = 12
    x, y = np.meshgrid(np.arange(side + 1.0), np.arange(side + 1.0))
    points = (np.stack([x, y], axis=-1).reshape(-1, 2) + random.uniform(-0.3, 0.3, ((side + 1) ** 2, 2))) / (side + 1)
    first = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    faces = np.concatenate([first[:, None] + [0, 1, side + 2], first[:, None] + [0, side + 2, side + 1]])
    assert overlap_share(points[faces], 256, device=DEVICE) == 0.0


def test_vectors_survive_as_pixels():
    vectors = unit_vectors(np.random.default_rng(4).normal(size=(500, 3)))
    assert np.abs(decoded(encoded(vectors)) - vectors).max() <= 1 / 255 + 1e-6
    assert encoded(np.array([0.0, 0.0, 1.0])).tolist() == FLAT
