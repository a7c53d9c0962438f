"""Single precision far from the origin: said where it takes of the shape, and nowhere else."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from pxr import UsdGeom

import warpqem
from tests.support import meshes
from tests.support.cli import run
from tests.support.usd_stages import cloth_stage
from warpqem.mesh.rounding import rounding_lines, rounding_of

POINTS, FACES = meshes.swaying_sphere(1, 3)
DOUBLE = POINTS.astype(np.float64)
CALLS = {
    "simplify": lambda points: warpqem.simplify(points, FACES, ratio=0.5, device="cpu"),
    "limit": lambda points: warpqem.simplify(points, FACES, max_error=20.0, device="cpu"),
    "levels": lambda points: warpqem.simplify_levels(points, FACES, ratios=(0.5,), device="cpu")[0],
    "progressive": lambda points: warpqem.build_progressive(points, FACES, device="cpu"),
}


@pytest.mark.parametrize("name", CALLS)
def test_double_precision_far_from_the_origin_is_warned_of(name):
    with pytest.warns(UserWarning, match=r"moves the points of the result by up to \d.*% of the diagonal") as caught:
        found = CALLS[name](DOUBLE + np.array([0.0, 1e6, 0.0]))
    assert len(caught) == 1
    if name != "progressive":
        assert found.notes == [str(caught[0].message)]


@pytest.mark.parametrize(
    "points", [POINTS, DOUBLE, DOUBLE + 100.0, 1e7 * DOUBLE, (POINTS + 1e4).astype(np.float32)], ids=range(5)
)
def test_other_points_are_not(points):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert warpqem.simplify(points, FACES, ratio=0.5, device="cpu").notes == []


def test_a_mesh_that_travels_far_in_double_precision_is_warned_of():
    far = DOUBLE.copy()
    far[-1] += 1e7
    with pytest.warns(UserWarning, match="of the diagonal"):
        warpqem.simplify(far, FACES, ratio=0.5, device="cpu")


def test_the_figure_is_what_rounding_does_at_most():
    points = DOUBLE + np.array([3e5, -8e5, 1e5])
    diagonal = np.linalg.norm(np.ptp(points, axis=1), axis=1).max()
    moved = 100 * np.abs(points.astype(np.float32) - points).max() / diagonal
    said = rounding_of(points.min(axis=1), points.max(axis=1), np.zeros(3), diagonal)
    assert 0.9 * said < moved <= said
    assert len(rounding_lines(said)) == 1


def test_the_command_line_says_it_as_a_line(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    UsdGeom.Xformable(stage.GetPrimAtPath("/Root")).AddTranslateOp().Set((1e8, 0, 0))
    stage.Save()
    files = (tmp_path / "in.usda", "-o", tmp_path / "a.wpqm")
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        done = run("progressive", "build", *files, "--device", "cpu")
        assert done.exit_code == 0
        assert done.stderr.startswith("warning: single precision moves the points of the result by up to ")
        assert done.stderr.count("\n") == 1
        assert run("progressive", "build", *files, "--device", "cpu", "-q").output == ""
