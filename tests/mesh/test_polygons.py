"""Polygons of any shape as triangles: they cover it once, in its winding, with all of its edges."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pxr import Gf, Usd, UsdGeom, Vt

from warpqem.mesh.polygons import ear_clipped, polygon_normals, repeated_polygons
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.commands.compare import CompareOptions, compare_stages
from warpqem.usd.read.triangulation import read_topology

L_SHAPE = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [1, 1, 0], [1, 2, 0], [0, 2, 0]], dtype=np.float32)
# A square with a square hole that two edges on top of each other lead to.
HOLED = np.array(
    [[0, 0, 0], [3, 0, 0], [3, 3, 0], [0, 3, 0], [0, 0, 0], [1, 1, 0], [1, 2, 0], [2, 2, 0], [2, 1, 0], [1, 1, 0]],
    dtype=np.float32,
)
DART = np.array([[0, 0, 0], [2, -1, 0], [0.5, 0, 0], [2, 1, 0]], dtype=np.float32)


def read(points, counts, indices=None):
    """The triangles that a mesh of these polygons is read as."""
    stage = Usd.Stage.CreateInMemory()
    mesh = UsdGeom.Mesh.Define(stage, "/Mesh")
    mesh.CreateFaceVertexCountsAttr(counts)
    mesh.CreateFaceVertexIndicesAttr(list(range(len(points))) if indices is None else indices)
    return read_topology(mesh, len(points), points).triangles


def area(points, triangles):
    a, b, c = (points[triangles[:, k]].astype(np.float64) for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


@pytest.mark.parametrize(("ring", "expected"), [(L_SHAPE, 3.0), (HOLED, 8.0), (DART, 0.5)])
@pytest.mark.parametrize("start", range(4))
def test_concave_polygon_is_covered_once(ring, expected, start):
    ring = np.roll(ring, start, axis=0)
    triangles = read(ring, [len(ring)])
    assert len(triangles) == len(ring) - 2
    assert area(ring, triangles) == pytest.approx(expected)


@pytest.mark.parametrize("turn", [Gf.Rotation((1, 2, 3), 77), Gf.Rotation((0, 1, 0), 90), Gf.Rotation((1, 0, 0), 180)])
def test_winding_stays_in_any_plane(turn):
    matrix = np.array(Gf.Matrix3d(turn))
    ring = (L_SHAPE @ matrix + 1000).astype(np.float32)
    normal = polygon_normals(ring, np.array([len(ring)]))[0]
    triangles = read(ring, [len(ring)])
    assert area(ring, triangles) == pytest.approx(3.0, rel=1e-3)
    assert (polygon_normals(ring[triangles.ravel()], np.full(len(triangles), 3)) @ normal > 0).all()


def test_corners_on_a_straight_line_are_kept():
    """A neighbour may have edges that end there."""
    ring = np.insert(L_SHAPE, [1, 1, 3, 5], [[0.5, 0, 0], [1.5, 0, 0], [1.5, 1, 0], [0.5, 2, 0]], axis=0)
    triangles = read(ring, [len(ring)])
    assert len(triangles) == len(ring) - 2
    assert area(ring, triangles) == pytest.approx(3.0)
    edges = {(a, b) for t in triangles.tolist() for a, b in zip(t, [*t[1:], t[0]], strict=True)}
    assert edges >= {(k, (k + 1) % len(ring)) for k in range(len(ring))}


def test_convex_polygons_are_fans():
    angle = np.arange(6) * np.pi / 3
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1).astype(np.float32)
    np.testing.assert_array_equal(read(ring, [6]), [[0, k, k + 1] for k in range(1, 5)])


@pytest.mark.parametrize(
    "indices",
    [[0, 0, 0, 0], [0, 1, 0, 1], [0, 1, 1, 2], [0, 1, 2, 0, 1, 2], [0, 1, 2, 3, 2, 1], [3, 3, 2, 1, 1, 0]],
)
@pytest.mark.parametrize("points", [L_SHAPE, 0 * L_SHAPE, L_SHAPE * [1, 0, 0], np.full_like(L_SHAPE, np.nan)])
def test_polygons_without_a_shape_do_no_harm(indices, points):
    triangles = read(points.astype(np.float32), [len(indices), 4], [*indices, 0, 1, 2, 3])
    assert (triangles != np.roll(triangles, 1, axis=1)).all()


@st.composite
def star_polygons(draw):
    """A polygon around the origin, with random radii, some corners repeated or on a line, on a bent surface."""
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    count = draw(st.integers(4, 40))
    angle = np.sort(random.choice(720, count, replace=False)) * (2 * np.pi / 720)
    radius = random.uniform(0.2, 1.0, count)
    ring = np.stack([np.cos(angle) * radius, np.sin(angle) * radius, 0 * angle], axis=1)
    for place in random.integers(count, size=draw(st.integers(0, 5))):
        ring = np.insert(
            ring, place + 1, ring[place] + random.choice([0, 0.5]) * (ring[place - count + 1] - ring[place]), 0
        )
    ring[:, 2] = draw(st.sampled_from([0.0, 0.1])) * ring[:, 0] * ring[:, 1]
    return ring.astype(np.float32)


@given(star_polygons())
@settings(max_examples=200, deadline=None)
def test_any_star_is_cut_into_all_its_triangles(ring):
    triangles = read(ring, [len(ring)])
    normal = polygon_normals(ring, np.array([len(ring)]))[0]
    found = ear_clipped(ring, normal)
    assume(found is not None)
    assert found.shape == (len(ring) - 2, 3)
    assert np.unique(found).tolist() == list(range(len(ring)))
    # Seen along the axis that it faces most: a ring that turns back on itself need not face up.
    axis = np.abs(normal).argmax()
    flat = ring * (np.arange(3) != axis)
    assert area(flat, found) == pytest.approx(abs(normal[axis]) / 2, rel=1e-4)
    assert area(flat, triangles) == pytest.approx(abs(normal[axis]) / 2, rel=1e-4)


def test_comparison_cuts_its_reference_the_same_way(tmp_path):
    stage = Usd.Stage.CreateNew(str(tmp_path / "in.usda"))
    mesh = UsdGeom.Mesh.Define(stage, "/Mesh")
    grid = np.stack(np.meshgrid(np.arange(5) / 4 + 3, np.arange(5) / 4, [0]), axis=-1).reshape(-1, 3)
    quads = [[5 * j + i, 5 * j + i + 1, 5 * j + i + 6, 5 * j + i + 5] for j in range(4) for i in range(4)]
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(np.concatenate([grid, L_SHAPE]).astype(np.float32)))
    mesh.CreateFaceVertexCountsAttr([4] * 16 + [6])
    mesh.CreateFaceVertexIndicesAttr([*np.ravel(quads).tolist(), *range(25, 31)])
    mesh.CreateSubdivisionSchemeAttr("none")
    stage.Save()
    simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", SimplifyOptions(ratio=0.5, device="cpu"))
    opened = Usd.Stage.Open(str(tmp_path / "out.usda"))
    out = UsdGeom.Mesh(opened.GetPrimAtPath("/Mesh"))
    faces = np.array(out.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    assert area(np.array(out.GetPointsAttr().Get()), faces) == pytest.approx(4.0, rel=1e-3)
    [pair] = compare_stages(tmp_path / "in.usda", tmp_path / "out.usda", CompareOptions(device="cpu"))
    assert pair.comparison.hausdorff < 1e-3


@pytest.mark.parametrize("sides", [4, 5, 7])
@pytest.mark.parametrize("shift", [0, 1, 3])
@pytest.mark.parametrize("back", [False, True])
def test_repeated_polygon_is_cut_along_the_same_diagonals(sides, shift, back):
    angles = np.arange(sides) * 2 * np.pi / sides
    ring = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    # Concave, so that from five corners on no fan from most of them covers it.
    ring[1] *= 0.2
    points = np.concatenate([[[5, 5, 5], [6, 5, 5], [5, 6, 5]], ring]).astype(np.float32)
    polygon = np.arange(3, 3 + sides)
    copy = np.roll(polygon[::-1] if back else polygon, shift)
    stage = Usd.Stage.CreateInMemory()
    mesh = UsdGeom.Mesh.Define(stage, "/M")
    mesh.CreateFaceVertexCountsAttr([sides, 3, sides])
    mesh.CreateFaceVertexIndicesAttr([*polygon.tolist(), 0, 1, 2, *copy.tolist()])
    topology = read_topology(mesh, len(points), points)
    assert topology.triangle_polygons.tolist() == [0] * (sides - 2) + [1] + [2] * (sides - 2)
    indices = np.array(mesh.GetFaceVertexIndicesAttr().Get())
    np.testing.assert_array_equal(indices[topology.triangle_corners], topology.triangles)
    first, last = (topology.triangles[topology.triangle_polygons == number] for number in (0, 2))

    def wound(triangles):
        return sorted(tuple(np.roll(corners, -corners.argmin()).tolist()) for corners in triangles)

    assert wound(last) == wound(first[:, ::-1] if back else first)


def test_polygons_of_the_same_points_in_another_order_are_no_repeats():
    assert repeated_polygons(np.array([4, 4], np.int32), np.array([0, 1, 2, 3, 0, 2, 1, 3], np.int32)) is None
