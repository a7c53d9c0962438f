"""Vertices that count for more, or do not move at all."""

import numpy as np
import pytest

import warpqem
from tests.support.moving_meshes import BAR, SPHERE, kept_near
from warpqem.errors import MeshShapeError, OptionError


def test_infinite_weight_locks_a_vertex(device):
    points, faces = SPHERE
    weights = np.ones(points.shape[1])
    weights[[3, 50]] = np.inf
    by_weight = warpqem.simplify(points, faces, ratio=0.2, vertex_weights=weights, device=device)
    by_lock = warpqem.simplify(points, faces, ratio=0.2, locked=[3, 50], device=device)
    np.testing.assert_array_equal(by_weight.points, by_lock.points)


def test_locked_borders_keep_every_border_vertex_in_every_frame(device):
    points, faces = BAR
    ends = np.concatenate([np.arange(16), points.shape[1] - 16 + np.arange(16)])
    result = warpqem.simplify(points, faces, ratio=0.2, lock_borders=True, device=device)
    np.testing.assert_array_equal(result.points[:, result.vertex_map[ends]], points[:, ends])
    assert len(np.unique(result.vertex_map[ends])) == len(ends)


def test_closed_mesh_has_no_border_to_lock(device):
    points, faces = SPHERE
    plain, locked = (
        warpqem.simplify(points, faces, ratio=0.3, lock_borders=lock, device=device) for lock in (False, True)
    )
    np.testing.assert_array_equal(plain.points, locked.points)


def test_larger_quadrics_keep_more_vertices(device):
    points, faces = SPHERE
    chosen = np.flatnonzero(points[0, :, 2] > 0.2)
    scale = np.full(points.shape[1], 0.05)
    scale[chosen] = 1.0
    plain = warpqem.simplify(points, faces, ratio=0.2, device=device)
    scaled = warpqem.simplify(points, faces, ratio=0.2, quadric_scale=scale, device=device)
    assert kept_near(scaled, chosen) > 1.3 * kept_near(plain, chosen)


def test_quadrics_scaled_alike_by_a_power_of_two_change_nothing(device):
    points, faces = SPHERE
    plain = warpqem.simplify(points, faces, ratio=0.3, device=device)
    scaled = warpqem.simplify(points, faces, ratio=0.3, quadric_scale=np.full(points.shape[1], 2.0), device=device)
    # Costs have small constant terms beside the quadrics, so single ties may break otherwise, but not the whole.
    assert len(plain.faces) == len(scaled.faces)
    assert np.isclose(plain.error, scaled.error, rtol=0.05)


@pytest.mark.parametrize(
    ("scale", "error", "message"),
    [
        (-1.0, OptionError, r"quadric_scale must be in \[0, 1e\+12\], got -1.0 at vertex 7"),
        (np.nan, MeshShapeError, "quadric_scale of vertex 7 is nan"),
        (np.inf, MeshShapeError, "quadric_scale of vertex 7 is inf"),
    ],
)
def test_wrong_quadric_scale_is_named(scale, error, message):
    points, faces = SPHERE
    values = np.ones(points.shape[1])
    values[7] = scale
    with pytest.raises(error, match=message):
        warpqem.simplify(points, faces, ratio=0.3, quadric_scale=values, device="cpu")
