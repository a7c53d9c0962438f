"""Moving assemblies: what the benchmark of meshes with many parts runs on."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from benchmarks.assemblies.kinds import ASSEMBLIES, assembly

FRAMES = 3


@pytest.fixture(scope="module", params=list(ASSEMBLIES))
def made(request):
    return assembly(request.param, FRAMES)


def test_parts_are_closed_and_face_outwards(made):
    mesh = trimesh.Trimesh(made.points[0].astype(np.float64), made.faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    parts = mesh.split(only_watertight=False)
    assert len(parts) == made.part_count
    assert min(part.volume for part in parts) > 0


def test_parts_move_and_are_never_crushed(made):
    assert np.isfinite(made.points).all()
    assert made.faces.min() == 0
    assert made.faces.max() == made.points.shape[1] - 1
    areas = np.stack([trimesh.triangles.area(points[made.faces].astype(np.float64)) for points in made.points])
    assert areas.min() > 0
    assert np.abs(made.points[1] - made.points[0]).max() > 0.01 * np.ptp(made.points[0], axis=0).max()


def test_an_assembly_is_the_same_every_time(made):
    assert (assembly(made.name, FRAMES).points == made.points).all()
