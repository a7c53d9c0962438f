"""``warpqem.simplify``: face counts, validity of the result, kinds of input."""

import os

import numpy as np
import pytest
import trimesh
import warp as wp

import warpqem
from tests.support import cuda_semantics, meshes
from tests.support.moving_meshes import BAR, CLOTH, MESHES, METRICS, SPHERE
from warpqem.measure import topology
from warpqem.options import read_keywords
from warpqem.pipeline import exchange
from warpqem.pipeline.prepare import prepare

# Counts and shapes


@pytest.mark.parametrize("ratio", [0.9, 0.5, 0.25, 0.1])
@pytest.mark.parametrize("name", MESHES)
def test_face_count_is_the_target_or_one_fewer(name, ratio, device):
    points, faces = MESHES[name]
    count = len(warpqem.simplify(points, faces, ratio=ratio, device=device).faces)
    assert round(ratio * len(faces)) - 1 <= count <= round(ratio * len(faces))


@pytest.mark.parametrize("target", [4, 5, 6, 7, 50, 51, 1278, 1279])
def test_every_target_of_a_closed_mesh_is_met(target, device):
    points, faces = SPHERE
    result = warpqem.simplify(points, faces, target_faces=target, device=device)
    assert len(result.faces) == target - target % 2


def test_ratio_one_returns_the_input(device):
    points, faces = BAR
    result = warpqem.simplify(points, faces, ratio=1.0, device=device)
    np.testing.assert_array_equal(result.points, points)
    np.testing.assert_array_equal(result.faces, faces)
    assert result.stopped == "target"


def test_target_above_the_face_count_returns_the_input(device):
    points, faces = BAR
    np.testing.assert_array_equal(warpqem.simplify(points, faces, target_faces=10**6, device=device).faces, faces)


def test_result_has_the_documented_shapes_and_types(device):
    points, faces = BAR
    result = warpqem.simplify(points, faces, ratio=0.3, device=device)
    vertex_count = int(result.faces.max()) + 1
    assert (result.points.shape, result.points.dtype) == ((8, vertex_count, 3), np.float32)
    assert (result.faces.shape[1], result.faces.dtype) == (3, np.int32)
    assert (result.vertex_map.shape, result.vertex_map.dtype) == ((points.shape[1],), np.int32)
    assert (result.flips.shape, result.flips.dtype) == ((8,), np.int32)
    assert result.stopped == "target"
    assert 0 < result.error < 100
    assert result.key_frames.tolist() == list(range(8))


def test_every_output_vertex_is_used(device):
    result = warpqem.simplify(*CLOTH, ratio=0.2, device=device)
    np.testing.assert_array_equal(np.unique(result.faces), np.arange(result.points.shape[1]))


# Validity


@pytest.mark.parametrize("ratio", [0.5, 0.1])
@pytest.mark.parametrize("metric", METRICS)
@pytest.mark.parametrize("name", MESHES)
def test_topology_is_kept(name, metric, ratio, device):
    points, faces = MESHES[name]
    before = topology(faces)
    after = topology(warpqem.simplify(points, faces, ratio=ratio, metric=metric, device=device).faces)
    assert (after.euler_number, after.components) == (before.euler_number, before.components)
    assert after.non_manifold_edges == after.non_manifold_vertices == 0
    assert after.repeated_faces == after.collapsed_faces == 0
    assert (after.border_edges > 0) == (before.border_edges > 0)


@pytest.mark.parametrize("name", MESHES)
def test_vertex_map_reaches_every_output_vertex(name, device):
    result = warpqem.simplify(*MESHES[name], ratio=0.2, device=device)
    np.testing.assert_array_equal(np.unique(result.vertex_map), np.arange(result.points.shape[1]))


def test_vertex_map_gives_the_output_faces_from_the_input_faces(device):
    points, faces = SPHERE
    result = warpqem.simplify(points, faces, ratio=0.2, device=device)
    mapped = result.vertex_map[faces]
    proper = (mapped[:, 0] != mapped[:, 1]) & (mapped[:, 1] != mapped[:, 2]) & (mapped[:, 2] != mapped[:, 0])
    found = {tuple(np.roll(f, -f.argmin())) for f in mapped[proper]}
    assert {tuple(np.roll(f, -f.argmin())) for f in result.faces} <= found


def test_output_vertices_are_near_their_clusters(device):
    points, faces = SPHERE
    result = warpqem.simplify(points, faces, ratio=0.3, device=device)
    distance = np.linalg.norm(result.points[:, result.vertex_map] - points, axis=2)
    assert distance.max() < 0.2


def test_vertex_without_a_face_maps_to_nothing(device):
    points, faces = meshes.icosphere(2)
    points = np.insert(points, 5, [0.1, 0.1, 0.1], axis=0)
    result = warpqem.simplify(points, faces + (faces >= 5), ratio=0.5, device=device)
    assert np.flatnonzero(result.vertex_map < 0).tolist() == [5]


def test_vertex_without_a_face_does_not_change_the_result(device):
    points, faces = meshes.bumpy_sphere(2)
    with_stray = np.concatenate([points, [[1e6, 0, 0]]]).astype(np.float32)
    plain, stray = (warpqem.simplify(p, faces, ratio=0.3, device=device) for p in (points, with_stray))
    np.testing.assert_array_equal(stray.faces, plain.faces)
    np.testing.assert_allclose(stray.points, plain.points, atol=1e-5)


def test_flips_are_none_on_a_smooth_mesh(device):
    assert warpqem.simplify(*SPHERE, ratio=0.5, device=device).flips.max() == 0


# Input kinds


def test_single_pose_gives_one_frame(device):
    points, faces = meshes.bumpy_sphere(2)
    flat = warpqem.simplify(points, faces, ratio=0.5, device=device)
    stacked = warpqem.simplify(points[None], faces, ratio=0.5, device=device)
    np.testing.assert_array_equal(flat.points, stacked.points)
    assert len(flat.points) == 1


def test_trimesh_is_taken_without_faces(device):
    points, faces = meshes.bumpy_sphere(2)
    mesh = trimesh.Trimesh(points, faces, process=False)
    result = warpqem.simplify(mesh, ratio=0.5, device=device)
    assert len(result.faces) == len(faces) // 2


def test_warp_arrays_give_the_same_bits_as_numpy(device):
    points, faces = BAR
    expected = warpqem.simplify(points, faces, ratio=0.3, device=device)
    on_device = wp.array(points, dtype=wp.vec3, device=device), wp.array(faces, dtype=wp.int32, device=device)
    result = warpqem.simplify(*on_device, ratio=0.3, device=device)
    np.testing.assert_array_equal(result.points, expected.points)


def test_lists_give_the_same_faces_as_numpy(device):
    points, faces = meshes.bumpy_sphere(1)
    expected = warpqem.simplify(points.astype(np.float64), faces, ratio=0.5, device=device)
    result = warpqem.simplify(points.astype(np.float64).tolist(), faces.tolist(), ratio=0.5, device=device)
    np.testing.assert_array_equal(result.faces, expected.faces)
    np.testing.assert_array_equal(result.points, expected.points)


class DlpackOnly:
    """An array that offers nothing but DLPack."""

    def __init__(self, array):
        self._array = array

    def __dlpack__(self, **options):
        return self._array.__dlpack__(**options)

    def __dlpack_device__(self):
        return self._array.__dlpack_device__()


class RefusesNumpy(DlpackOnly):
    """As tensors on a GPU do: ``__array__`` is there and raises, DLPack works."""

    def __array__(self, *_, **__):
        raise TypeError("can't convert a device tensor to numpy")


@pytest.mark.parametrize("kind", [DlpackOnly, RefusesNumpy])
def test_dlpack_arrays_are_taken(kind, device):
    points, faces = meshes.bumpy_sphere(1)
    expected = warpqem.simplify(points, faces, ratio=0.5, device=device)
    result = warpqem.simplify(kind(points), kind(faces), ratio=0.5, device=device)
    np.testing.assert_array_equal(result.points, expected.points)


def test_input_arrays_are_left_as_they_were(device):
    points, faces = (a.copy() for a in BAR)
    warpqem.simplify(points, faces, ratio=0.3, device=device)
    np.testing.assert_array_equal(points, BAR[0])
    np.testing.assert_array_equal(faces, BAR[1])


@pytest.mark.skipif("CUDA_SEMANTICS" not in os.environ, reason="needs CUDA_SEMANTICS")
@pytest.mark.parametrize("name", ["sphere", "cloth"])
@pytest.mark.parametrize(("quality", "most"), [("fast", 5), ("best", 7)])
def test_host_waits_for_a_gpu_a_few_times(quality, most, name):
    points, faces = {"sphere": SPHERE, "cloth": CLOTH}[name]
    with cuda_semantics.counted() as traffic:
        warpqem.simplify(points, faces, ratio=0.1, quality=quality, device="cpu")
    assert traffic.readbacks <= most


@pytest.mark.skipif("CUDA_SEMANTICS" not in os.environ, reason="needs CUDA_SEMANTICS")
def test_host_waits_for_a_gpu_once_in_a_round_of_an_exchange(monkeypatch):
    # For how far a level is; once more to begin with.
    points, faces = SPHERE
    work = prepare(points, faces, read_keywords({"target_faces": 1000, "device": "cpu"}))
    ordered, rounds, finer = exchange.order_with_spare(work), [], exchange._Search._finer
    monkeypatch.setattr(
        exchange._Search, "_finer", lambda self, left_out: (rounds.append(left_out), finer(self, left_out))[1]
    )
    with cuda_semantics.counted() as traffic:
        exchange.exchanged(work, ordered, 1000)
    assert len(rounds) > 2
    assert traffic.readbacks <= 1 + len(rounds)
