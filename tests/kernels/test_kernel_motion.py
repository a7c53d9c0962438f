"""Dihedral angles over frames, and the motion features built on them."""

import numpy as np
import pytest
import warp as wp

import warpqem
from tests.oracles import motion as oracle
from tests.support import meshes
from warpqem.costs.motion_features import MotionWatch
from warpqem.errors import OptionError
from warpqem.frames.blocks import MIN_STEPS, chunk_steps
from warpqem.kernels.motion import dihedral_angle, measure_dihedral_changes, wrapped
from warpqem.mesh.edges import edge_table
from warpqem.mesh.mesh_input import read_mesh
from warpqem.runtime.device import _TRAITS, GPU

wp.set_module_options({"enable_backward": False})  # no gradients are taken

HINGE_EDGE = np.array([[0, 1, 2, 3]], dtype=np.int32)


@wp.kernel
def measure_angles(
    # in
    points_in: wp.array2d[wp.vec3],
    # out
    angle_out: wp.array[wp.float32],
):
    t = wp.tid()
    angle_out[t] = dihedral_angle(points_in[t, 0], points_in[t, 1], points_in[t, 2], points_in[t, 3])


@wp.kernel
def wrap_angles(
    # in
    angle_in: wp.array[wp.float32],
    # out
    angle_out: wp.array[wp.float32],
):
    angle_out[wp.tid()] = wrapped(angle_in[wp.tid()])


def hinge(angles) -> np.ndarray:
    """(F, 4, 3): faces ``0 1 2`` and ``1 0 3`` about the x axis; a positive angle folds the second one down."""
    frames = [[[0, 0, 0], [1, 0, 0], [0.5, 1, 0], [0.5, -np.cos(a), -np.sin(a)]] for a in angles]
    return np.asarray(frames, dtype=np.float32)


def changes(points, edges, device, chunk=None) -> np.ndarray:
    steps = len(points) - 1
    chunk = max(steps, 1) if chunk is None else chunk
    change = wp.zeros(len(edges), dtype=wp.float32, device=device)
    inputs = [wp.array(edges, dtype=wp.int32, device=device), wp.array(points, dtype=wp.vec3, device=device), chunk]
    dim = (-(-steps // chunk), len(edges))
    wp.launch(measure_dihedral_changes, dim=dim, inputs=inputs, outputs=[change], device=device)
    return np.degrees(change.numpy())


@pytest.mark.parametrize("degrees", [-170, -90, -10, 0, 10, 45, 90, 179])
def test_angle_of_a_hinge_is_zero_when_flat_and_positive_at_a_ridge(degrees, device):
    angle = wp.empty(1, dtype=wp.float32, device=device)
    points = wp.array(hinge([np.radians(degrees)]), dtype=wp.vec3, device=device)
    wp.launch(measure_angles, dim=1, inputs=[points], outputs=[angle], device=device)
    assert np.degrees(angle.numpy()[0]) == pytest.approx(degrees, abs=1e-3)


def test_change_of_a_hinge_that_opens_by_a_known_angle(device):
    assert changes(hinge(np.radians([30, 75])), HINGE_EDGE, device)[0] == pytest.approx(45, abs=1e-3)


def test_change_takes_the_largest_step_of_all(device):
    assert changes(hinge(np.radians([0, 5, 25, 20, 10])), HINGE_EDGE, device)[0] == pytest.approx(20, abs=1e-3)


def test_change_wraps_past_half_a_turn(device):
    assert changes(hinge(np.radians([170, 195])), HINGE_EDGE, device)[0] == pytest.approx(25, abs=1e-3)


def test_change_of_a_rigid_motion_is_rounding(device):
    points, faces = meshes.icosphere(1)
    opposites = oracle.edge_opposites(faces)
    edges = [[p, q, *(c for _, _, c in sorted(s, key=lambda h: h[0] != p))] for (p, q), s in opposites.items()]
    assert changes(meshes.rigid_motion(points), np.array(edges), device).max() < 0.01


def test_one_frame_changes_nothing(device):
    assert changes(hinge([1.0]), HINGE_EDGE, device)[0] == 0


@pytest.mark.parametrize("turns", [-1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5])
def test_wrapped_angle_is_equivalent_and_at_most_half_a_turn(turns, device):
    angle = wp.array([turns * np.pi], dtype=wp.float32, device=device)
    out = wp.empty(1, dtype=wp.float32, device=device)
    wp.launch(wrap_angles, dim=1, inputs=[angle], outputs=[out], device=device)
    result = out.numpy()[0]
    assert abs(result) <= np.float32(np.pi)
    assert np.exp(1j * result) == pytest.approx(np.exp(1j * turns * np.pi), abs=1e-5)


@pytest.mark.parametrize("mesh", [meshes.bending_bar(8, 12, 5), meshes.waving_grid(6, 4)], ids=["bar", "grid"])
def test_edge_factors_match_the_oracle(mesh, device):
    points, faces = mesh
    result = warpqem.motion_features(points, faces, device=device)
    expected = oracle.dihedral_changes(points, faces)
    assert result.edges.tolist() == [list(edge) for edge in expected]
    np.testing.assert_allclose(result.factor, list(expected.values()), atol=0.05)


@pytest.mark.parametrize("chunk", [1, 2, 3, 7])
def test_chunks_of_frames_give_the_same_bits(chunk, device):
    points, faces = meshes.waving_grid(6, 8)
    table = edge_table(faces)
    edges = np.concatenate([table.ends, table.opposites], axis=1)[table.face_count == 2]
    whole = changes(points, edges, device)
    assert whole.max() > 1
    np.testing.assert_array_equal(changes(points, edges, device, chunk), whole)


@pytest.mark.parametrize("block_frames", [1, 2, 5])
def test_blocks_of_frames_give_the_same_bits(block_frames, device):
    points, faces = meshes.waving_grid(6, 11)
    mesh = read_mesh(points, faces)
    watch = MotionWatch(mesh, device)
    for first in range(0, len(points), block_frames):
        block = slice(first, min(first + block_frames, len(points)))
        watch.observe(block, points[block])
    whole = warpqem.motion_features(points, faces, device=device)
    np.testing.assert_array_equal(watch.features().factor, whole.factor)


@pytest.mark.parametrize(("steps", "edges"), [(1, 5), (47, 5), (47, 30_000), (300, 2_000_000)])
def test_a_thread_of_a_gpu_takes_no_more_steps_than_fill_it(steps, edges, monkeypatch):
    monkeypatch.setitem(_TRAITS, "cpu", GPU)
    chunk = chunk_steps(steps, edges, "cpu")
    assert 1 <= chunk <= steps
    # As many threads as the GPU wants, where that leaves each the least number of steps.
    assert -(-steps // chunk) * edges >= min(GPU.launch_threads // 2, edges * -(-steps // MIN_STEPS))


def test_threshold_is_the_mean_factor(device):
    result = warpqem.motion_features(*meshes.waving_grid(6, 4), device=device)
    assert result.threshold == pytest.approx(result.factor.mean(), rel=1e-5)
    assert result.threshold > 1


@pytest.mark.parametrize("mesh", [meshes.bending_bar(8, 12, 5), meshes.waving_grid(6, 4)], ids=["bar", "grid"])
def test_labels_and_weights_match_the_oracle(mesh, device):
    points, faces = mesh
    result = warpqem.motion_features(points, faces, device=device)
    label, weight = oracle.features(points, faces, points.shape[1])
    np.testing.assert_array_equal(result.label, label)
    np.testing.assert_array_equal(result.weight, weight)
    assert result.feature_count == label.max() + 1


def test_still_closed_mesh_has_no_feature(device):
    points, faces = meshes.icosphere(1)
    result = warpqem.motion_features(np.stack([points] * 3), faces, device=device)
    assert result.feature_count == 0
    np.testing.assert_array_equal(result.weight, 1)


def test_joint_of_a_bending_bar_is_a_feature_and_its_rigid_ends_are_not(device):
    points, faces = meshes.bending_bar(12, 30, 6)
    label = warpqem.motion_features(points, faces, device=device).label.reshape(31, 12)
    assert (label[14:17] >= 0).any(axis=1).all()
    assert (label[3:8] == -1).all()


def test_mesh_without_an_inner_edge_has_features_of_border_edges_only(device):
    result = warpqem.motion_features(*meshes.triangle(), device=device)
    np.testing.assert_array_equal(result.factor, 0)
    np.testing.assert_array_equal(result.label, 0)


BAR = meshes.bending_bar(8, 12, 5)


@pytest.mark.parametrize("threshold", [0.0, 3.0, 20.0])
def test_threshold_and_floor_are_what_is_asked_for(threshold, device):
    points, faces = BAR
    weighting = warpqem.costs.MotionWeighting(threshold=threshold, floor=2.0)
    result = warpqem.motion_features(points, faces, weighting=weighting, device=device)
    assert result.threshold == max(threshold, 2.0)
    label, weight = oracle.features(points, faces, points.shape[1], threshold, 2.0)
    np.testing.assert_array_equal(result.label, label)
    np.testing.assert_array_equal(result.weight, weight)


@pytest.mark.parametrize("method", ["root", "log", "bend"])
def test_other_weights_match_the_oracle(method, device):
    points, faces = BAR
    result = warpqem.motion_features(
        points, faces, weighting=warpqem.costs.MotionWeighting(weight=method), device=device
    )
    expected = oracle.feature_weights(points, faces, points.shape[1], method)
    np.testing.assert_allclose(result.weight, expected, rtol=2e-3)
    assert (result.weight >= 1).all()
    assert (result.weight[result.label < 0] == 1).all()
    assert (result.weight > 1).any()


def test_function_gets_the_features_and_gives_the_weights(device):
    def outside(features):
        return np.where(features.label < 0, 5.0, features.weight)

    points, faces = BAR
    result = warpqem.motion_features(
        points, faces, weighting=warpqem.costs.MotionWeighting(weight=outside), device=device
    )
    plain = warpqem.motion_features(points, faces, device=device)
    np.testing.assert_array_equal(result.weight, np.where(plain.label < 0, 5.0, plain.weight))


@pytest.mark.parametrize("given", [np.ones(3), np.full(104, -1.0), np.full(104, np.nan), ["a"] * 104])
def test_function_that_gives_no_weights_is_refused(given, device):
    points, faces = BAR
    assert points.shape[1] == 104
    with pytest.raises(OptionError, match="weights of motion features"):
        warpqem.motion_features(
            points, faces, weighting=warpqem.costs.MotionWeighting(weight=lambda _: given), device=device
        )


@pytest.mark.parametrize(
    "wrong", [{"threshold": -1}, {"threshold": 181}, {"threshold": np.nan}, {"floor": -0.1}, {"weight": "area"}]
)
def test_weighting_that_is_none_is_refused(wrong):
    with pytest.raises(OptionError, match=f"{next(iter(wrong))} of motion features"):
        warpqem.costs.MotionWeighting(**wrong)


def test_weights_of_one_make_aqem_dsd(device):
    points, faces = BAR
    motion = warpqem.costs.MotionWeighting(weight=lambda features: np.ones(len(features.label)))
    even = warpqem.simplify(points, faces, ratio=0.4, metric="aqem", motion=motion, device=device)
    dsd = warpqem.simplify(points, faces, ratio=0.4, device=device)
    aqem = warpqem.simplify(points, faces, ratio=0.4, metric="aqem", device=device)
    np.testing.assert_array_equal(even.log.removed, dsd.log.removed)
    assert not np.array_equal(aqem.log.removed, dsd.log.removed)


def test_weighting_needs_a_metric_that_keeps_features(device):
    with pytest.raises(OptionError, match="not 'dsd'"):
        warpqem.simplify(*BAR, ratio=0.5, motion=warpqem.costs.MotionWeighting(), device=device)
