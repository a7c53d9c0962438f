"""Placement of every output vertex in every frame, and the count of flipped faces."""

import numpy as np
import pytest
import warp as wp

from tests.oracles import quadrics as oracle
from tests.support import meshes
from tests.support.mesh_state import blocks, packed
from warpqem.kernels.cluster_rows import gather_corners, label_corners
from warpqem.kernels.lanes import width_of
from warpqem.kernels.placement import (
    STEPS,
    Clusters,
    copy_vertices,
    count_flips,
    place_vertices,
    restore_points,
)
from warpqem.place.block_placer import BlockPlacer, ClusterData
from warpqem.place.cluster_rows import ClusterFaces, sum_repeated

EPSILON = 0.3
MESHES = {"closed": meshes.swaying_sphere(1, 3), "open": meshes.waving_grid(5, 3)}


def gathered(faces, members, device, solved=1, other=(), other_weight=0.0) -> Clusters:
    """One cluster with equal weights of ``members``: face and border terms counted as in the ordering's quadrics.

    The faces at the vertices ``other`` count too, with a weight for each corner there.
    """
    corner_in = np.isin(faces, members).sum(axis=1)
    half_edges, weights = [], []
    directed = set(zip(faces.ravel().tolist(), np.roll(faces, -1, axis=1).ravel().tolist(), strict=True))
    for h, (a, b) in enumerate(zip(faces.ravel().tolist(), np.roll(faces, -1, axis=1).ravel().tolist(), strict=True)):
        if (b, a) not in directed and (a in members or b in members):
            half_edges.append(h)
            weights.append((a in members) + (b in members))
    clusters = Clusters()

    def whole(values, dtype):
        return wp.array(np.asarray(values), dtype=dtype, device=device)

    clusters.member_start, clusters.member = whole([0, len(members)], wp.int32), whole(members, wp.int32)
    clusters.member_weight = whole(np.full(len(members), 1 / len(members)), wp.float32)
    clusters.face_start = whole([0, (corner_in > 0).sum()], wp.int32)
    clusters.face = wp.array(faces[corner_in > 0], dtype=wp.vec3i, device=device)
    clusters.face_weight = whole(corner_in[corner_in > 0], wp.float32)
    other_in = np.isin(faces, list(other)).sum(axis=1)
    clusters.other_start = whole([0, (other_in > 0).sum()], wp.int32)
    clusters.other = wp.array(faces[other_in > 0], dtype=wp.vec3i, device=device)
    clusters.other_weight = whole(other_weight * other_in[other_in > 0], wp.float32)
    clusters.border_start = whole([0, len(half_edges)], wp.int32)
    clusters.border = whole(np.array(half_edges, dtype=np.int32), wp.int32)
    clusters.border_weight = whole(np.array(weights, dtype=np.float32), wp.float32)
    clusters.solved = whole([solved], wp.int32)
    return clusters


def placed(points, faces, clusters, device, epsilon=EPSILON):
    """(positions (F, 3), normals (F, 3)) of the one cluster."""
    position = packed(points, device)
    out = [wp.empty((1, position.shape[1]), dtype=position.dtype, device=device) for _ in range(2)]
    corner_vertex = wp.array(faces.ravel(), dtype=wp.int32, device=device)
    clusters.stiffness = wp.full(1, epsilon, dtype=wp.float32, device=device)
    inputs = [position, corner_vertex, clusters, 0]
    wp.launch(place_vertices[width_of(position)], dim=out[0].shape, inputs=inputs, outputs=out, device=device)
    return blocks(out[0], len(points))[0], blocks(out[1], len(points))[0]


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("members", [[0, 1], [0, 6, 7, 12], [8]])
def test_position_solves_the_normal_equation_of_the_cluster(name, members, device):
    points, faces = MESHES[name]
    x, _ = placed(points, faces, gathered(faces, members, device), device)
    for t, frame in enumerate(points.astype(np.float64)):
        anchor = frame[members].mean(axis=0)
        own = oracle.vertex_quadrics(frame, faces, origin=np.repeat(anchor[None], len(frame), axis=0))
        total = oracle.zero()
        for m in members:
            total += own[m]
        np.testing.assert_allclose(x[t], anchor + oracle.tangential_minimiser(total, EPSILON), atol=2e-6)


def test_planes_of_other_vertices_count_but_are_no_part_of_the_normal(device):
    points, faces = MESHES["closed"]
    members, other = [0, 1], [5, 7]
    plain = placed(points, faces, gathered(faces, members, device), device)
    x, normal = placed(points, faces, gathered(faces, members, device, other=other, other_weight=3.0), device)
    np.testing.assert_array_equal(normal, plain[1])
    for t, frame in enumerate(points.astype(np.float64)):
        anchor = frame[members].mean(axis=0)
        own = oracle.vertex_quadrics(frame, faces, origin=np.repeat(anchor[None], len(frame), axis=0))
        total = own[0] + own[1] + own[5].scaled(3.0) + own[7].scaled(3.0)
        np.testing.assert_allclose(x[t], anchor + oracle.tangential_minimiser(total, EPSILON), atol=2e-6)
    assert np.abs(x - plain[0]).max() > 1e-3


@pytest.mark.parametrize("name", MESHES)
def test_vertex_that_is_not_solved_is_its_anchor(name, device):
    points, faces = MESHES[name]
    x, _ = placed(points, faces, gathered(faces, [0, 1], device, solved=0), device)
    np.testing.assert_allclose(x, points[:, [0, 1]].mean(axis=1), atol=1e-7)


def test_high_stiffness_keeps_the_vertex_on_the_material(device):
    points, faces = MESHES["closed"]
    x, _ = placed(points, faces, gathered(faces, [0, 11, 5], device), device, epsilon=1e4)
    np.testing.assert_allclose(x, points[:, [0, 11, 5]].mean(axis=1), atol=1e-4)


def test_normal_is_the_sum_of_the_faces_cross_products(device):
    points, faces = MESHES["closed"]
    _, normal = placed(points, faces, gathered(faces, [0, 1], device), device)
    corner = points.astype(np.float64)[:, faces[np.isin(faces, [0, 1]).any(axis=1)]]
    cross = np.cross(corner[:, :, 1] - corner[:, :, 0], corner[:, :, 2] - corner[:, :, 0])
    np.testing.assert_allclose(normal, cross.sum(axis=1), rtol=1e-4, atol=1e-6)


CHOICES = np.geomspace(0.6, 0.001, int(STEPS)).astype(np.float32)


def measured(points, faces, clusters, device, choices=CHOICES) -> tuple[np.ndarray, np.ndarray, float]:
    """(errors with each choice, how far it wanders, area) of the one cluster."""
    position = packed(points, device)
    clusters.stiffness = wp.full(1, EPSILON, dtype=wp.float32, device=device)
    data = ClusterData(wp.array(faces.ravel(), dtype=wp.int32, device=device), rows_of(clusters))
    tried = wp.array(choices[None], dtype=wp.float32, device=device)
    (sums,) = BlockPlacer(data, device).measure_stiffness(position, len(points), tried).numpy()
    return sums[: len(choices)], sums[len(choices) : -1], float(sums[-1])


def rows_of(clusters) -> dict[str, wp.array]:
    return {name: getattr(clusters, name) for name in Clusters.vars}


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("members", [[0, 1], [0, 6, 7, 12]])
def test_error_of_a_stiffness_is_that_of_the_quadrics_where_it_leaves_the_vertex(name, members, device):
    points, faces = MESHES[name]
    error, area, offsets = np.zeros(len(CHOICES)), 0.0, []
    for frame in points.astype(np.float64):
        anchor = frame[members].mean(axis=0)
        own = oracle.vertex_quadrics(frame, faces, origin=np.repeat(anchor[None], len(frame), axis=0))
        total = oracle.zero()
        for m in members:
            total += own[m]
        area += np.trace(total.A)
        offsets.append([oracle.tangential_minimiser(total, float(stiffness)) for stiffness in CHOICES])
        error += [total(offset) for offset in offsets[-1]]
    found = measured(points, faces, gathered(faces, members, device), device)
    np.testing.assert_allclose(found[0], error, rtol=1e-3, atol=1e-6)
    about_mean = np.array(offsets) - np.mean(offsets, axis=0)
    np.testing.assert_allclose(found[1], (about_mean**2).sum(axis=(0, 2)), rtol=1e-2, atol=1e-6)
    np.testing.assert_allclose(found[2], area, rtol=1e-5)


def test_other_numbers_of_choices_than_the_kernel_has_room_for_are_refused(device):
    points, faces = MESHES["closed"]
    with pytest.raises(ValueError, match="8 stiffnesses of each cluster, 9 are tried"):
        measured(points, faces, gathered(faces, [0, 1], device), device, CHOICES[:-1])


def test_a_vertex_that_is_not_solved_has_no_error_by_stiffness(device):
    points, faces = MESHES["closed"]
    error, wander, area = measured(points, faces, gathered(faces, [0, 1], device, solved=0), device)
    assert not error.any()
    assert not wander.any()
    assert area == 0.0


def flips_of(points, normals, faces, device) -> np.ndarray:
    inputs = [packed(a, device) for a in (points, normals)]
    block_count = inputs[0].shape[1]
    count = wp.zeros(block_count * width_of(inputs[0]), dtype=wp.int32, device=device)
    inputs.append(wp.array(faces.ravel(), dtype=wp.int32, device=device))
    wp.launch(
        count_flips[width_of(inputs[0])], dim=(len(faces), block_count), inputs=inputs, outputs=[count], device=device
    )
    return count.numpy()[: len(points)]


def test_faces_that_agree_with_their_normals_are_no_flips(device):
    points, faces = MESHES["closed"]
    assert flips_of(points, points, faces, device).tolist() == [0, 0, 0]


def test_flips_are_counted_per_frame(device):
    points, faces = MESHES["closed"]
    normals = points.copy()
    normals[1] *= -1
    assert flips_of(points, normals, faces, device).tolist() == [0, len(faces), 0]


def test_repeated_items_of_a_row_are_summed():
    start, item, weight = sum_repeated(
        np.array([2, 0, 2, 2, 0]), np.array([5, 1, 5, 3, 1]), np.array([1.0, 2.0, 3.0, 4.0, 5.0]), 4
    )
    assert start.tolist() == [0, 1, 1, 3, 3]
    assert item.tolist() == [1, 3, 5]
    assert weight.tolist() == [7, 4, 4]


@pytest.mark.parametrize("is_counted", [False, True])
def test_faces_of_clusters_are_the_repeated_items_of_their_corners(is_counted, device):
    faces = MESHES["closed"][1]
    rng = np.random.default_rng(3)
    cluster = rng.integers(-1, 4, size=faces.max() + 1).astype(np.int32)[faces].ravel()
    weight = rng.uniform(1, 2, faces.size).astype(np.float32)
    corner_cluster, corner_weight = wp.array(cluster, device=device), wp.array(weight, device=device)
    count = int((cluster >= 0).sum()) if is_counted else None
    listed = ClusterFaces(corner_cluster, corner_weight, 5, count)
    found = [array.numpy() for array in (listed.start, *listed.listed(int(listed.total.numpy()[0])))]
    expected = sum_repeated(cluster, np.arange(faces.size) // 3, weight, 5)
    for a, b in zip(found, expected, strict=True):
        np.testing.assert_array_equal(a, b)


def test_no_item_makes_empty_rows():
    start, item, weight = sum_repeated(np.array([-1, -1]), np.array([0, 1]), np.ones(2), 3)
    assert start.tolist() == [0, 0, 0, 0]
    assert len(item) == len(weight) == 0


@pytest.mark.parametrize("frame_count", [1, 3, 8, 13])
def test_points_are_restored_with_a_single_rounding_of_the_sum(frame_count, device):
    rng = np.random.default_rng(5)
    unit = rng.normal(size=(frame_count, 40, 3)).astype(np.float32)
    diagonal, offset = 173.2000001, rng.normal(size=3) * 1e4
    position = packed(unit, device)
    out = wp.empty((frame_count, 40), dtype=wp.vec3, device=device)
    inputs = [position, diagonal, wp.vec3d(*offset)]
    wp.launch(restore_points[width_of(position)], dim=position.shape, inputs=inputs, outputs=[out], device=device)
    np.testing.assert_array_equal(out.numpy(), ((unit * np.float32(diagonal)) + offset).astype(np.float32))


@pytest.mark.parametrize("offset", [[0.1, 1e9, -3.0], [-0.0, -0.0, -0.0]])
def test_copies_go_to_their_columns_and_leave_the_others(offset, device):
    rng = np.random.default_rng(6)
    points = rng.normal(size=(4, 30, 3)).astype(np.float32)
    points[0, 3] = [-0.0, 0.0, 1e-40]
    vertex, column = np.array([3, 17, 8]), np.array([5, 0, 9])
    before = rng.normal(size=(4, 10, 3)).astype(np.float32)
    expected = before.copy()
    expected[:, column] = points[:, vertex] + np.array(offset)
    out = wp.array(before, dtype=wp.vec3, device=device)
    lists = [wp.array(values, dtype=wp.int32, device=device) for values in (vertex, column)]
    inputs = [wp.array(points, dtype=wp.vec3, device=device), lists[0], wp.vec3d(*offset), lists[1]]
    wp.launch(copy_vertices, dim=(4, 3), inputs=inputs, outputs=[out], device=device)
    np.testing.assert_array_equal(out.numpy().view(np.int32), expected.view(np.int32))


def test_corners_have_the_cluster_and_weight_of_their_vertex(device):
    faces = MESHES["open"][1]
    rng = np.random.default_rng(7)
    cluster = rng.integers(-1, 4, size=faces.max() + 1).astype(np.int32)
    weight = rng.uniform(1, 2, size=len(cluster)).astype(np.float32)
    inputs = [wp.array(values, device=device) for values in (faces.ravel(), cluster, weight)]
    outputs = [wp.empty(faces.size, dtype=dtype, device=device) for dtype in (wp.int32, wp.float32)]
    wp.launch(label_corners, dim=faces.size, inputs=inputs, outputs=outputs, device=device)
    for found, values in zip(outputs, (cluster, weight), strict=True):
        np.testing.assert_array_equal(found.numpy(), values[faces.ravel()])


def test_corners_of_listed_faces_are_gathered_as_many_as_there_are(device):
    faces = MESHES["open"][1]
    # Four of the list are told, and the launch begins with its second one; what comes after says nothing.
    listed = np.array([4, 0, 4, len(faces) - 1, 10**8], dtype=np.int32)
    arrays = [wp.array(values, device=device) for values in (listed[1:], faces.ravel(), np.array([4], dtype=np.int32))]
    out = wp.zeros(4, dtype=wp.vec3i, device=device)
    wp.launch(gather_corners, dim=4, inputs=[*arrays, 1], outputs=[out], device=device)
    np.testing.assert_array_equal(out.numpy(), [*faces[listed[1:4]], [0, 0, 0]])
