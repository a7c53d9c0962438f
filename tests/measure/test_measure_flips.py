"""Flips are faces that oppose both sides of the surface below them: repeats, backs and mixed winding are none."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import warpqem
from tests.support import meshes
from tests.support.moving_meshes import SPHERE
from warpqem.measure import compare

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
