"""A first look at faces on a device."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support import meshes
from warpqem.mesh import used_vertices as module
from warpqem.mesh.used_vertices import used_vertices
from warpqem.repair.mended_topology import look_for_unclean


@pytest.fixture
def own_memory(monkeypatch, device):
    """A device with memory of its own, wherever it is."""
    traits = module.device_traits(device)
    monkeypatch.setattr(module, "device_traits", lambda _: replace(traits, own_memory=True))


def test_used_vertices_and_whether_faces_are_clean_come_together(own_memory, device):
    faces = meshes.grid(4, 3)[1].astype(np.int32)
    used, is_clean = used_vertices(faces[3:], 22, device, look_for_unclean)
    np.testing.assert_array_equal(used, np.isin(np.arange(22), faces[3:]))
    assert is_clean
    repeated = np.concatenate([faces, faces[:1]])
    assert used_vertices(repeated, 20, device, look_for_unclean)[1] is False


def test_nobody_knows_whether_faces_are_clean_without_a_look(own_memory, device):
    faces = meshes.grid(4, 3)[1].astype(np.int32)
    assert used_vertices(faces, 20, device, None)[1] is None


@pytest.mark.parametrize("face", [(0, 0, 1), (0, 1, 20), (0, -5, 1), (2**31 - 1, 0, 1)])
def test_unfit_faces_are_looked_at_by_nobody_else(face, own_memory, device):
    faces = np.concatenate([meshes.grid(4, 3)[1], [face]]).astype(np.int32)
    looked = []

    def look(corner_vertex, vertex_count):
        looked.append(corner_vertex.numpy())
        return look_for_unclean(corner_vertex, vertex_count)

    assert used_vertices(faces, 20, device, look) is None
    np.testing.assert_array_equal(looked[0][:-3], faces[:-1].ravel())
    np.testing.assert_array_equal(looked[0][-3:], -1)
