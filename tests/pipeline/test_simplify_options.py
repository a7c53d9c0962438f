"""The options of ``warpqem.simplify``."""

import numpy as np

import warpqem
from tests.support import meshes
from tests.support.moving_meshes import BAR, SPHERE, kept_near, rms
from warpqem.errors import UnreachableTargetError
from warpqem.measure import compare


def test_locked_vertices_keep_their_position_in_every_frame(device):
    points, faces = SPHERE
    locked = np.arange(0, points.shape[1], 37)
    result = warpqem.simplify(points, faces, ratio=0.15, locked=locked, device=device)
    np.testing.assert_array_equal(result.points[:, result.vertex_map[locked]], points[:, locked])
    assert len(np.unique(result.vertex_map[locked])) == len(locked)


def test_locked_border_vertices_keep_their_position(device):
    points, faces = BAR
    locked = np.arange(16)
    result = warpqem.simplify(points, faces, ratio=0.3, locked=locked, device=device)
    np.testing.assert_array_equal(result.points[:, result.vertex_map[locked]], points[:, locked])


def test_locked_mask_and_indices_mean_the_same(device):
    points, faces = SPHERE
    mask = np.zeros(points.shape[1], dtype=bool)
    mask[[3, 50]] = True
    by_mask, by_index = (warpqem.simplify(points, faces, ratio=0.2, locked=v, device=device) for v in (mask, [50, 3]))
    np.testing.assert_array_equal(by_mask.points, by_index.points)


def test_locked_vertex_with_many_coincident_neighbours_keeps_its_position(device):
    points, faces = meshes.fan(60, 0.2)
    points, faces = meshes.joined((points, faces), meshes.icosphere(2), spacing=2.0)
    points[1:50] = points[1]
    locked = [40]
    try:
        result = warpqem.simplify(points, faces, ratio=0.2, locked=locked, device=device)
    except UnreachableTargetError as error:
        result = error.result
    np.testing.assert_array_equal(result.points[:, result.vertex_map[locked]], points[None][:, locked])


def test_endpoint_placement_gives_input_trajectories(device):
    points, faces = SPHERE
    result = warpqem.simplify(points, faces, ratio=0.2, placement="endpoint", device=device)
    inputs = {v.tobytes() for v in np.ascontiguousarray(points.transpose(1, 0, 2))}
    assert all(v.tobytes() in inputs for v in np.ascontiguousarray(result.points.transpose(1, 0, 2)))


def test_endpoint_placement_takes_a_vertex_of_the_cluster(device):
    points, faces = SPHERE
    result = warpqem.simplify(points, faces, ratio=0.2, placement="endpoint", device=device)
    same = (result.points[:, result.vertex_map] == points).all(axis=(0, 2))
    np.testing.assert_array_equal(np.unique(result.vertex_map[same]), np.arange(result.points.shape[1]))


def test_heavier_vertices_are_kept_in_greater_number(device):
    points, faces = SPHERE
    chosen = np.flatnonzero(points[0, :, 2] > 0.2)
    weights = np.ones(points.shape[1])
    weights[chosen] = 20
    plain = warpqem.simplify(points, faces, ratio=0.2, device=device)
    weighted = warpqem.simplify(points, faces, ratio=0.2, vertex_weights=weights, device=device)
    assert kept_near(weighted, chosen) > 1.3 * kept_near(plain, chosen)


def test_weight_zero_is_allowed_and_goes_first(device):
    points, faces = SPHERE
    chosen = np.flatnonzero(points[0, :, 2] > 0.2)
    weights = np.ones(points.shape[1])
    weights[chosen] = 0
    plain = warpqem.simplify(points, faces, ratio=0.5, device=device)
    weighted = warpqem.simplify(points, faces, ratio=0.5, vertex_weights=weights, device=device)
    assert kept_near(weighted, chosen) < kept_near(plain, chosen)


def test_equal_weights_change_nothing(device):
    points, faces = SPHERE
    plain = warpqem.simplify(points, faces, ratio=0.3, device=device)
    weighted = warpqem.simplify(points, faces, ratio=0.3, vertex_weights=np.ones(points.shape[1]), device=device)
    np.testing.assert_array_equal(plain.points, weighted.points)


def test_coherence_steadies_the_vertices(device):
    points, faces = meshes.waving_grid(16, 12)
    slides = []
    for coherence in (0.0, 0.5, 1.0):
        result = warpqem.simplify(points, faces, ratio=0.15, coherence=coherence, device=device)
        slides.append(compare(points, faces, result.points, result.faces, samples=1000, device=device).slide)
    assert slides[0] > slides[1] > slides[2]


def test_coherence_costs_shape(device):
    errors = [rms(SPHERE, warpqem.simplify(*SPHERE, ratio=0.1, coherence=c, device=device), device) for c in (0.0, 1.0)]
    assert errors[0] < errors[1]


def test_full_coherence_keeps_vertices_on_the_material(device):
    points, faces = meshes.bumpy_sphere(3)
    moved = meshes.rigid_motion(points, 5)
    result = warpqem.simplify(moved, faces, ratio=0.2, coherence=1.0, device=device)
    assert compare(moved, faces, result.points, result.faces, samples=1000, device=device).slide < 1e-3


def test_larger_max_error_leaves_fewer_faces(device):
    counts = [len(warpqem.simplify(*SPHERE, max_error=e, device=device).faces) for e in (0.2, 0.5, 2.0)]
    assert counts[0] > counts[1] > counts[2]


def test_max_error_stops_before_the_target(device):
    alone = warpqem.simplify(*SPHERE, max_error=0.1, device=device)
    both = warpqem.simplify(*SPHERE, max_error=0.1, target_faces=4, device=device)
    np.testing.assert_array_equal(both.points, alone.points)
    assert both.stopped == "max_error"


def test_target_stops_before_max_error(device):
    result = warpqem.simplify(*SPHERE, max_error=50.0, ratio=0.5, device=device)
    assert (result.stopped, len(result.faces)) == ("target", len(SPHERE[1]) // 2)


def test_key_frames_limit_how_many_frames_decide(device):
    result = warpqem.simplify(*BAR, ratio=0.3, key_frames=3, device=device)
    assert len(result.key_frames) == 3
    # The bend only grows: its straight and its most bent pose are the farthest apart.
    assert {0, 7} < set(result.key_frames.tolist())


def test_repeated_frames_are_no_key_frames(device):
    points, faces = BAR
    result = warpqem.simplify(points[[0, 0, 0, 7, 7]], faces, ratio=0.3, key_frames=4, device=device)
    assert result.key_frames.tolist() == [0, 3]


def test_travelling_frames_are_no_key_frames(device):
    points, faces = BAR
    frames = np.stack([points[0], points[0] + np.float32(64), points[4], points[0] - np.float32(32)])
    assert warpqem.simplify(frames, faces, ratio=0.3, key_frames=2, device=device).key_frames.tolist() == [0, 2]
