"""Stages of small props: what the benchmark of many meshes runs on."""

from __future__ import annotations

import numpy as np
import trimesh

from benchmarks.props import FEWEST, MOST, props, run_once, write_props
from benchmarks.settings import Settings


def test_props_are_sound_and_of_the_size_they_say():
    for prop in props(40):
        assert FEWEST <= len(prop.faces) <= MOST
        mesh = trimesh.Trimesh(prop.points, prop.faces, process=False)
        assert mesh.is_winding_consistent
        assert mesh.area_faces.min() > 0
        assert set(prop.faces.ravel()) == set(range(len(prop.points)))
        assert len(prop.uv) == len(prop.points)
        # From outside.
        assert not mesh.is_watertight or mesh.volume > 0


def test_no_two_props_are_alike():
    shapes = [np.linalg.norm(np.ptp(prop.points, axis=0)) for prop in props(200)]
    assert len(np.unique(np.round(shapes, 6))) == 200
    first, again = next(props(1)), next(props(1))
    assert (first.points == again.points).all()


def test_a_stage_of_props_is_simplified_to_its_counts(tmp_path):
    write_props(tmp_path / "props.usdc", 3, shaded=True)
    seconds, reached = run_once(tmp_path / "props.usdc", "fast", Settings(tmp_path, device="cpu"))
    assert seconds > 0
    assert reached == 3
