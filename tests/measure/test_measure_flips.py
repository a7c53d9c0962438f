"""Flips are faces that oppose both sides of the surface below them: repeats, backs and mixed winding are none."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import warpqem
from tests.support import meshes
from tests.support.moving_meshes import SPHERE
from warpqem.measure import compare
from warpqem.measure.winding import read_winding

POINTS, FACES = SPHERE


def flawed(faces, flaw: str, seed: int = 0):
    """Faces with some, or all, of them twice, on both sides, or turned over."""
    random = np.random.default_rng(seed)
    some = random.permutation(len(faces))[: len(faces) // 3]
    turned = faces.copy()
    turned[::2] = turned[::2, ::-1]
    return {
        "repeated": lambda: np.concatenate([faces, faces[some]]),
        "backs first": lambda: np.concatenate([faces[:, ::-1], faces]),
        "some backs": lambda: random.permutation(np.concatenate([faces, faces[some][:, ::-1]])),
        "alternating": lambda: turned,
        "all in one": lambda: random.permutation(np.concatenate([turned, turned[some], turned[some][:, ::-1]])),
    }[flaw]()


FLAWS = ["repeated", "backs first", "some backs", "alternating", "all in one"]


@pytest.mark.parametrize("flaw", FLAWS)
def test_flawed_mesh_does_not_oppose_itself(flaw, device):
    faces = flawed(FACES, flaw)
    found = compare(POINTS, faces, POINTS, faces, samples=200, device=device)
    assert found.per_frame.flips.tolist() == [0] * len(POINTS)
    assert found.normal_deviation < 1e-4
    assert found.verdict.word == "good"


@pytest.mark.parametrize("flaw", FLAWS)
def test_flawed_mesh_has_the_flips_of_the_clean_one_when_simplified(flaw, device):
    faces = flawed(FACES, flaw)
    result = warpqem.simplify(POINTS, faces, ratio=0.1, device=device)
    assert 100 * result.measured.flips / len(result.faces) < 1
    assert result.measured == compare_measured(POINTS, faces, result, device)


def compare_measured(points, faces, result, device):
    found = compare(points, faces, result.points, result.faces, device=device)
    return type(result.measured)(**{name: getattr(found, name) for name in result.measured.__dataclass_fields__})


def test_face_that_opposes_a_clean_surface_is_still_a_flip(device):
    turned = FACES.copy()
    turned[:3] = turned[:3, ::-1]
    assert compare(POINTS, FACES, POINTS, turned, samples=200, device=device).flips == 3


def test_thin_shell_has_two_surfaces_and_no_other_side(device):
    points, faces = meshes.grid(6, 6)
    shell = np.concatenate([points, points + np.array([0, 0, 0.01])])
    both = np.concatenate([faces, faces[:, ::-1] + len(points)])
    turned = both.copy()
    turned[: len(faces)] = turned[: len(faces), ::-1]
    found = compare(shell, both, shell, turned, samples=200, device=device)
    assert found.flips == len(faces)


@st.composite
def flawed_meshes(draw):
    """Meshes with folds, repeated and opposite faces, in any winding."""
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    kind = draw(st.sampled_from(["sphere", "sheet", "strip", "soup"]))
    points, faces = {
        "sphere": lambda: meshes.icosphere(1),
        "sheet": lambda: meshes.grid(6, 5),
        "strip": lambda: meshes.moebius(12),
        "soup": lambda: (random.random((30, 3)), random.permuted(np.tile(np.arange(30), (20, 1)), axis=1)[:, :3]),
    }[kind]()
    count = len(faces)
    again = random.integers(count, size=draw(st.integers(0, count)))
    behind = random.integers(count, size=draw(st.integers(0, count)))
    faces = np.concatenate([faces, faces[again], faces[behind][:, ::-1]])
    turned = random.random(len(faces)) < draw(st.sampled_from([0.0, 0.1, 0.5]))
    faces[turned] = faces[turned, ::-1]
    points = points + draw(st.sampled_from([0.0, 0.0, 0.3])) * random.random(points.shape)
    return points, random.permutation(faces) if draw(st.booleans()) else faces


@settings(max_examples=100, deadline=None)
@given(flawed_meshes())
def test_no_mesh_opposes_itself(mesh):
    points, faces = mesh
    assert compare(points, faces, points, faces, samples=20, device="cpu").flips == 0


def cut(polygon: list[int], random: np.random.Generator) -> list[list[int]]:
    """Triangles of a convex polygon, by random diagonals."""
    if len(polygon) == 3:
        return [polygon]
    at = int(random.integers(1, len(polygon) - 1))
    parts = [part for part in (polygon[: at + 1], [*polygon[at:]]) if len(part) > 2]
    return [[polygon[0], polygon[at], polygon[-1]], *itertools.chain(*(cut(part, random) for part in parts))]


TILINGS = ["quads", "hexagons", "bricks"]


def sheet_of_polygons(tiling: str, columns: int, rows: int) -> tuple[np.ndarray, list[list[int]]]:
    """A waving sheet of polygons: points (3, V, 3), and the corners of each. Bricks have three corners in line."""
    wide = 1 if tiling == "quads" else 2
    line = columns * wide + 2
    row, column = np.divmod(np.arange((rows + 1) * line), line)
    bulge = {"quads": 0.0, "hexagons": 0.25, "bricks": 0.0}[tiling]
    x, y = column / line, (row + bulge * (-1.0) ** (row + column)) / rows
    points = np.stack([np.stack([x, y, 0.03 * np.sin(5 * x + t) * np.cos(4 * y)], axis=1) for t in (0.0, 0.3, 0.6)])
    polygons = []
    for j, k in itertools.product(range(rows), range(columns)):
        first = j * line + k * wide + (j % 2 if wide == 2 else 0)
        below = list(range(first, first + wide + 1))
        polygons.append([*below, *(vertex + line for vertex in reversed(below))])
    return points.astype(np.float32), polygons


def two_sided(points, polygons, random, share: float = 1.0, apart: bool = True):
    """Both sides of a sheet, or the front and a part of the back, cut along diagonals of their own."""
    front = [face for polygon in polygons for face in cut(polygon, random)]
    behind = polygons[: round(share * len(polygons))]
    back = [face for polygon in behind for face in cut(polygon[::-1], random)]
    if apart:
        points = np.concatenate([points, points], axis=1)
        back = (np.array(back) + points.shape[1] // 2).tolist()
    return points, random.permutation(np.array(front + back))


@pytest.mark.parametrize("apart", [True, False], ids=["points of their own", "the same points"])
@pytest.mark.parametrize("tiling", TILINGS)
def test_sides_of_a_sheet_that_are_cut_along_other_diagonals_are_no_flips(tiling, apart, device):
    random = np.random.default_rng(1)
    points, faces = two_sided(*sheet_of_polygons(tiling, 10, 12), random, apart=apart)
    result = warpqem.simplify(points, faces, ratio=0.5, device=device)
    assert result.measured.flips == 0
    assert result.measured.normal_deviation < 10
    # Sides that share points are torn at some edges.
    assert not apart or result.measured.verdict.word == "good"


def test_face_turned_over_where_a_sheet_has_no_back_is_a_flip(device):
    random = np.random.default_rng(0)
    points, polygons = sheet_of_polygons("quads", 12, 12)
    points, faces = two_sided(points, polygons, random, share=0.5)
    middle = points[0, faces].mean(axis=1)
    # The back is that of the lower half.
    turned = np.flatnonzero((middle[:, 1] > 0.6) & (middle[:, 0] > 0.5))[:5]
    flipped = faces.copy()
    flipped[turned] = flipped[turned, ::-1]
    assert compare(points, faces, points, faces, samples=50, device=device).flips == 0
    assert compare(points, faces, points, flipped, samples=50, device=device).flips == len(turned)


def test_lens_whose_rim_is_all_that_its_sides_share_is_no_sheet(device):
    points, faces = meshes.icosphere(2)
    lens = points * np.array([1.0, 1.0, 0.02])
    turned = faces.copy()
    turned[:50] = turned[:50, ::-1]
    assert compare(lens, faces, lens, turned, samples=50, device=device).flips == 50


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from(TILINGS), st.floats(0, 1), st.booleans())
def test_all_faces_of_a_sheet_with_a_back_have_one_and_no_others(seed, tiling, share, apart):
    random = np.random.default_rng(seed)
    points, polygons = sheet_of_polygons(tiling, int(random.integers(2, 6)), int(random.integers(2, 6)))
    points, faces = two_sided(points, polygons, random, share, apart)
    behind = {frozenset(polygon) for polygon in polygons[: round(share * len(polygons))]}
    within = faces % (points.shape[1] // 2 if apart else points.shape[1])
    expected = [any(polygon.issuperset(face) for polygon in behind) for face in within.tolist()]
    assert read_winding(points[0], faces).both.tolist() == expected
