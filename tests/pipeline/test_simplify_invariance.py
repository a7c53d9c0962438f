"""What must not change the result of ``warpqem.simplify``."""

from dataclasses import replace

import numpy as np
import pytest

import warpqem
from tests.support import meshes
from tests.support.moving_meshes import BAR, METRICS, SPHERE, rms
from warpqem.measure import compare


def test_shape_is_kept_far_from_the_origin(device):
    points, faces = SPHERE
    points = points.astype(np.float64) * 2000
    far = np.array([1e6, -1e6, 1e6])
    near, moved = (warpqem.simplify(p, faces, ratio=0.3, device=device) for p in (points, points + far))
    # Rounding may decide between edges of nearly the same cost, so the shape is compared, not the vertices. 0.0625 is
    # the step of float32 at a million, 0.002 % of the diagonal.
    back = replace(moved, points=(moved.points - far).astype(np.float32))
    errors = [rms((points, faces), result, device) for result in (near, back)]
    assert errors[1] == pytest.approx(errors[0], rel=0.05, abs=0.002)


@pytest.mark.parametrize("exponent", [-20, 20])
def test_scale_by_a_power_of_two_scales_the_result_exactly(exponent, device):
    points, faces = BAR
    plain = warpqem.simplify(points, faces, ratio=0.3, device=device)
    scaled = warpqem.simplify(points * np.float32(2.0**exponent), faces, ratio=0.3, device=device)
    np.testing.assert_array_equal(scaled.faces, plain.faces)
    np.testing.assert_array_equal(scaled.points, plain.points * np.float32(2.0**exponent))


def test_rigid_motion_of_the_input_gives_the_same_quality(device):
    points, faces = SPHERE
    turn, move = meshes.rotation([1, -2, 3], 1.0), np.array([3, 4, 5])
    still = warpqem.simplify(points, faces, ratio=0.3, device=device)
    turned = warpqem.simplify((points @ turn.T + move).astype(np.float32), faces, ratio=0.3, device=device)
    # Turned back, so that both are measured against the same bounding box.
    back = compare(points, faces, (turned.points - move) @ turn, turned.faces, samples=20000, device=device).rms
    there = compare(points, faces, still.points, still.faces, samples=20000, device=device).rms
    # Rounding decides between edges that cost the same: eight turns lie within 3 % of their mean.
    assert back == pytest.approx(there, rel=0.06)


def test_order_of_the_frames_changes_no_quality(device):
    points, faces = SPHERE
    shuffled = points[[3, 0, 5, 1, 4, 2]]
    errors = [rms((p, faces), warpqem.simplify(p, faces, ratio=0.3, device=device), device) for p in (points, shuffled)]
    assert errors[1] == pytest.approx(errors[0], rel=0.02)


@pytest.mark.parametrize("metric", METRICS)
def test_rerun_gives_the_same_bits(metric, device):
    first, second = (warpqem.simplify(*BAR, ratio=0.2, metric=metric, device=device) for _ in range(2))
    np.testing.assert_array_equal(first.points, second.points)
    np.testing.assert_array_equal(first.faces, second.faces)
    np.testing.assert_array_equal(first.vertex_map, second.vertex_map)


def test_still_repetition_of_a_pose_equals_the_pose(device):
    points, faces = meshes.bumpy_sphere(2)
    # The refit magnifies rounding: a sample on an edge is paired with one face or the other.
    one = warpqem.simplify(points, faces, ratio=0.4, refit=False, device=device)
    four = warpqem.simplify(np.stack([points] * 4), faces, ratio=0.4, refit=False, device=device)
    np.testing.assert_array_equal(one.faces, four.faces)
    np.testing.assert_allclose(four.points, np.repeat(one.points, 4, axis=0), atol=1e-5)
