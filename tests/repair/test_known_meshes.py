"""Small meshes are looked at once, whoever asks."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support import meshes
from warpqem.repair import mended_topology
from warpqem.repair.mended_topology import repair_topology

FACES = np.ascontiguousarray(meshes.icosphere(2)[1], dtype=np.int32)
COUNT = int(FACES.max()) + 1


@pytest.fixture
def looks(monkeypatch):
    """How often a mesh was looked at."""
    found, look = [], mended_topology._found_clean
    monkeypatch.setattr(mended_topology, "_found_clean", lambda *mesh: found.append(mesh) or look(*mesh))
    monkeypatch.setattr(mended_topology, "_known_clean", {})
    return found


def test_the_same_faces_are_looked_at_once(looks):
    for _ in range(3):
        assert repair_topology(FACES.copy(), COUNT, "cpu") is None
    assert len(looks) == 1


def test_faces_that_were_changed_in_place_are_another_mesh(looks):
    faces = FACES.copy()
    assert repair_topology(faces, COUNT, "cpu") is None
    faces[0] = faces[1]
    assert repair_topology(faces, COUNT, "cpu").findings.repeated_faces == 1
    assert len(looks) == 2


def test_large_meshes_are_not_held(looks, monkeypatch):
    monkeypatch.setattr(mended_topology, "REMEMBERED_FACES", len(FACES) - 1)
    for _ in range(2):
        repair_topology(FACES, COUNT, "cpu")
    assert len(looks) == 2
    assert not mended_topology._known_clean


def test_no_more_meshes_are_known_than_there_is_room_for(looks, monkeypatch):
    monkeypatch.setattr(mended_topology, "REMEMBERED_MESHES", 2)
    for count in (COUNT, COUNT + 1, COUNT + 2, COUNT + 2, COUNT):
        assert repair_topology(FACES, count, "cpu") is None
    assert len(looks) == 4
    assert len(mended_topology._known_clean) == 2
