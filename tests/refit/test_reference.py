"""Key frames of the input for a refit, from the host and from the device."""

from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from tests.support import meshes
from warpqem.frames.device_frames import HeldFrames
from warpqem.frames.device_source import DeviceFrames
from warpqem.mesh.mesh_input import measure_mesh, read_mesh
from warpqem.refit import reference as module
from warpqem.refit.reference import Reference

POINTS, FACES = meshes.swaying_sphere(2, 12)
# A figure that crouches, beside a vertex without a face that is far away.
POINTS = (POINTS * np.linspace(1.0, 0.3, 12)[:, None, None]).astype(np.float32)
POINTS = np.concatenate([POINTS, np.full((12, 1, 3), 50.0, dtype=np.float32)], axis=1)
KEYS = np.array([0, 3, 4, 11])


@pytest.mark.parametrize("kind", ["held", "of the caller"])
def test_key_frames_that_are_on_the_device_are_those_of_the_host(kind, device, monkeypatch):
    mesh = measure_mesh(read_mesh(POINTS, FACES), device)
    expected = Reference.of(replace(mesh, held=None), KEYS, device)
    traits = module.device_traits(device)
    monkeypatch.setattr(module, "device_traits", lambda _: replace(traits, own_memory=True))
    monkeypatch.setattr("warpqem.frames.device_frames.device_traits", lambda _: replace(traits, own_memory=True))
    if kind == "held":
        there = replace(mesh, held=HeldFrames(wp.array(POINTS, dtype=wp.vec3, device=device)))
    else:
        there = replace(mesh, held=None, source=DeviceFrames(wp.array(POINTS, dtype=wp.float32, device=device)))
    found = Reference.of(there, KEYS, device)
    np.testing.assert_array_equal(found.points.numpy(), expected.points.numpy())
    np.testing.assert_allclose(found.frame_scale.numpy(), expected.frame_scale.numpy(), rtol=1e-6)
    assert found.frame_scale.numpy()[0] == 1.0
    assert found.frame_scale.numpy()[3] > 2.0
