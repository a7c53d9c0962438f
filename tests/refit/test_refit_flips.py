"""A refit turns no face over that placing had not turned over."""

from unittest.mock import patch

import numpy as np
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

import warpqem
from tests.support.meshes import waving_grid
from warpqem.pipeline import prepare


@st.composite
def moving_meshes(draw):
    """Small meshes with noise whose points sway on waves of their own, from hardly to wildly."""
    kind = draw(st.sampled_from(["ball", "sheet", "ring"]))
    if kind == "sheet":
        points, faces = waving_grid(draw(st.integers(5, 14)), 1)
        points = points[0] / np.ptp(points[0], axis=0).max()
    elif kind == "ball":
        ball = trimesh.creation.icosphere(subdivisions=draw(st.integers(1, 2)))
        points, faces = ball.vertices, ball.faces
    else:
        ring = trimesh.creation.torus(1.0, draw(st.floats(0.1, 0.5)), major_sections=16, minor_sections=8)
        points, faces = ring.vertices, ring.faces
    random = np.random.default_rng(draw(st.integers(0, 2**31)))
    noise, size, rate = (draw(st.sampled_from(values)) for values in ((0, 0.01, 0.03), (0.02, 0.1, 0.3), (1, 4, 8)))
    wave, phase, speed = random.normal(0, rate, (3, 3)), random.uniform(0, 6, 3), random.uniform(0, 2, 3)
    rest = points + random.normal(0, noise, points.shape)
    frames = [rest + size * np.sin(points @ wave.T + phase + speed * time) for time in range(draw(st.integers(1, 4)))]
    return np.array(frames, dtype=np.float32), np.asarray(faces, dtype=np.int32)


@settings(max_examples=12, deadline=None)
@given(moving_meshes(), st.floats(0.1, 0.6))
def test_refit_turns_no_face_over_that_placing_had_not(mesh, ratio):
    # Without coherence, which a refit has place vertices more softly, both are placed alike.
    options = {"coherence": 0.0, "measure": False, "max_size_error": None, "device": "cpu"}
    target = max(2, int(ratio * len(mesh[1])))
    # An exchange, which a refit brings with it, may leave other faces.
    with patch.object(prepare, "SPARE", 0.0):
        placed, refitted = (_simplified(mesh, target, refit=refit, **options) for refit in (False, True))
    assert np.array_equal(placed.faces, refitted.faces)
    assert (refitted.flips <= placed.flips).all()


def _simplified(mesh, target, **options):
    """The result, also where fewer faces are left than can be reached."""
    try:
        return warpqem.simplify(*mesh, target_faces=target, **options)
    except warpqem.errors.UnreachableTargetError as error:
        return error.result
