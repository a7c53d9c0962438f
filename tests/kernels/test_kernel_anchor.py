"""Material anchors: constant weights over the input vertices of a cluster."""

from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp

from tests.oracles import quadrics as oracle
from tests.support import meshes
from tests.support.mesh_state import build_mesh, packed, packed_quadrics
from warpqem.frames.blocks import pack_frames, unpack_frames
from warpqem.kernels.anchor import fill_gram_matrices, measure_cluster_distances, put_in_the_middle
from warpqem.kernels.lanes import width_of
from warpqem.place.anchors import (
    Anchors,
    Clusters,
    _find_by_sort,
    _find_in_order,
    fit_anchors,
    fit_weights,
    nearest_anchors,
)

POINTS, FACES = meshes.swaying_sphere(1, 3)
# A vertex with its ring, three times.
CLUSTERS = [np.unique(FACES[(v == FACES).any(axis=1)]) for v in (0, 5, 9)]


def gram(points, members, ordered, quadrics) -> np.ndarray:
    """``sum_t p_i^T A p_j + b.p_i + b.p_j + c`` over members, float64."""
    total = np.zeros((len(members), len(members)))
    for x, origin, q in zip(points.astype(np.float64), ordered.astype(np.float64), quadrics, strict=True):
        p = x[members] - origin
        total += p @ q.A @ p.T + (p @ q.b)[:, None] + (p @ q.b)[None] + q.c
    return total


def cluster_quadrics(points, members, ordered):
    """Sum of the members' quadrics per frame, about where ordering put the vertex."""
    result = []
    for x, origin in zip(points, ordered, strict=True):
        own = oracle.vertex_quadrics(x, FACES)
        total = oracle.zero()
        for m in members:
            total += oracle.shifted(own[m], origin.astype(np.float64) - x[m])
        result.append(total)
    return result


def fitted(members_of, regularisation, device, points=POINTS):
    """(weights per cluster, Gram matrices) for clusters put at their members' mean."""
    vertex_count, key_count = points.shape[1], len(points)
    ordered = np.zeros((vertex_count, key_count, 3), dtype=np.float32)
    quadric = np.zeros((vertex_count, key_count, 10), dtype=np.float32)
    grams = []
    for members in members_of:
        ordered[members[0]] = points[:, members].mean(axis=1)
        quadrics = cluster_quadrics(points, members, ordered[members[0]])
        quadric[members[0]] = [oracle.pack(q) for q in quadrics]
        grams.append(gram(points, members, ordered[members[0]], quadrics))
    size = np.array([len(m) for m in members_of])
    start = np.concatenate([[0], np.cumsum(size)])
    matrix_start = np.concatenate([[0], np.cumsum(size * (size + 1) // 2)])
    heads, member, first, first_entry = (
        wp.array(np.asarray(a), dtype=wp.int32, device=device)
        for a in ([m[0] for m in members_of], np.concatenate(members_of), start, matrix_start)
    )
    key_position = packed(points, device)
    matrix = wp.zeros(int(matrix_start[-1]), dtype=wp.float32, device=device)
    weight = wp.zeros(int(start[-1]), dtype=wp.float32, device=device)
    mesh = SimpleNamespace(
        key_position=key_position,
        position=packed(ordered.transpose(1, 0, 2), device),
        quadric=packed_quadrics(quadric, key_position),
    )
    stiffness = wp.full(len(members_of), regularisation, dtype=wp.float32, device=device)
    fit_weights(mesh, heads, Anchors(first, member, weight), first_entry, stiffness, matrix)
    return np.split(weight.numpy(), start[1:-1]), grams


def regularised(matrix, regularisation):
    return matrix + regularisation * np.trace(matrix) / len(matrix) * np.eye(len(matrix))


@pytest.mark.parametrize("lanes", [1, 3, 32])
def test_gram_matrices_are_the_sums_over_frames_by_any_number_of_threads(lanes, device):
    key_position = packed(POINTS, device)
    ordered = np.zeros((POINTS.shape[1], len(POINTS), 3), dtype=np.float32)
    quadric = np.zeros((POINTS.shape[1], len(POINTS), 10), dtype=np.float32)
    size = np.array([len(members) for members in CLUSTERS])
    start, entries = (np.concatenate([[0], np.cumsum(n)]) for n in (size, size * (size + 1) // 2))
    expected = []
    for members in CLUSTERS:
        ordered[members[0]] = POINTS[:, members].mean(axis=1)
        quadrics = cluster_quadrics(POINTS, members, ordered[members[0]])
        quadric[members[0]] = [oracle.pack(q) for q in quadrics]
        matrix = gram(POINTS, members, ordered[members[0]], quadrics)
        expected.append(matrix[np.tril_indices(len(members))])
    lists = [
        wp.array(values, dtype=wp.int32, device=device)
        for values in ([members[0] for members in CLUSTERS], start, np.concatenate(CLUSTERS), entries)
    ]
    found = wp.zeros(int(entries[-1]), dtype=wp.float32, device=device)
    frames = [key_position, packed(ordered.transpose(1, 0, 2), device), packed_quadrics(quadric, key_position)]
    wp.launch(
        fill_gram_matrices[width_of(key_position)],
        dim=(len(CLUSTERS), lanes),
        inputs=[*lists, *frames, lanes],
        outputs=[found],
        device=device,
    )
    np.testing.assert_allclose(found.numpy(), np.concatenate(expected), atol=1e-5)


@pytest.mark.parametrize("regularisation", [0.01, 0.1, 1.0])
def test_weights_sum_to_one(regularisation, device):
    for weight in fitted(CLUSTERS, regularisation, device)[0]:
        assert weight.sum() == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("regularisation", [0.01, 0.1, 1.0])
def test_weights_minimise_the_regularised_quadratic(regularisation, device):
    for weight, matrix in zip(*fitted(CLUSTERS, regularisation, device), strict=True):
        exact = np.linalg.solve(regularised(matrix, regularisation), np.ones(len(matrix)))
        np.testing.assert_allclose(weight, exact / exact.sum(), atol=2e-3)


def test_weights_are_better_than_equal_ones(device):
    for weight, matrix in zip(*fitted(CLUSTERS, 0.01, device), strict=True):
        equal = np.full(len(matrix), 1 / len(matrix))
        assert weight @ matrix @ weight < equal @ matrix @ equal


def test_strong_regularisation_gives_equal_weights(device):
    for weight in fitted(CLUSTERS, 1e5, device)[0]:
        np.testing.assert_allclose(weight, 1 / len(weight), rtol=1e-3)


def test_cluster_on_a_plane_gets_equal_weights(device):
    flat = POINTS * np.array([1, 1, 0], dtype=np.float32)
    for weight in fitted(CLUSTERS, 0.1, device, flat)[0]:
        np.testing.assert_allclose(weight, 1 / len(weight), rtol=1e-4)


def test_cluster_of_one_vertex_has_weight_exactly_one(device):
    assert fitted([np.array([3]), np.array([7])], 0.1, device)[0] == [1.0, 1.0]


def test_cluster_distance_is_the_squared_distance_summed_over_frames(device):
    root = np.arange(POINTS.shape[1], dtype=np.int32)
    root[[1, 2]] = 0
    ordered = np.roll(POINTS, 1, axis=0)
    out = wp.empty(len(root), dtype=wp.float32, device=device)
    inputs = [wp.array(root, device=device), packed(POINTS, device), packed(ordered, device)]
    wp.launch(
        measure_cluster_distances[width_of(inputs[1])], dim=len(root), inputs=inputs, outputs=[out], device=device
    )
    expected = ((POINTS.astype(np.float64) - ordered[:, root]) ** 2).sum(axis=(0, 2))
    np.testing.assert_allclose(out.numpy(), expected, rtol=1e-4, atol=1e-9)


def ordered_mesh(device, root, line_rank=None) -> SimpleNamespace:
    """What anchors need of an order stage in which vertices went to their roots without moving these."""
    frames = build_mesh(POINTS, FACES, device).frames
    line_rank = np.zeros(len(root), dtype=np.int32) if line_rank is None else line_rank
    return SimpleNamespace(
        root=root,
        row=np.arange(len(root), dtype=np.int32),
        key_position=frames.position,
        position=frames.position,
        quadric=frames.quadric,
        line_rank=line_rank,
    )


def fetched(anchors: Anchors) -> SimpleNamespace:
    """The same on the host."""
    return SimpleNamespace(**{name: getattr(anchors, name).numpy() for name in ("start", "vertex", "weight")})


def fitted_anchors(mesh, kept, cluster, regularisation) -> SimpleNamespace:
    clusters = Clusters.of(cluster.astype(np.int32), mesh.line_rank, len(kept), mesh.position.device)
    return fetched(fit_anchors(mesh, kept, clusters, regularisation))


def test_nearest_anchor_is_the_member_nearest_to_the_ordered_place(device):
    root = np.arange(POINTS.shape[1], dtype=np.int32)
    root[10:20] = 4
    kept, cluster = np.unique(root, return_inverse=True)
    mesh = ordered_mesh(device, root)
    clusters = Clusters.of(cluster.astype(np.int32), mesh.line_rank, len(kept), device)
    anchors = fetched(nearest_anchors(mesh, clusters))
    np.testing.assert_array_equal(anchors.vertex, kept)
    np.testing.assert_array_equal(anchors.weight, 1)


def test_large_cluster_keeps_its_thirty_two_nearest_members(device):
    root = np.zeros(POINTS.shape[1], dtype=np.int32)
    anchors = fitted_anchors(ordered_mesh(device, root), np.array([0]), root, np.array([0.1]))
    distance = ((POINTS.astype(np.float64) - POINTS[:, :1]) ** 2).sum(axis=(0, 2))
    assert set(anchors.vertex) == set(np.argsort(distance, kind="stable")[:32])
    assert anchors.weight.sum() == pytest.approx(1, abs=1e-5)


def test_vertices_without_a_cluster_are_in_no_anchor(device):
    root = np.arange(POINTS.shape[1], dtype=np.int32)
    cluster = np.where(root == 6, -1, root - (root > 6)).astype(np.int32)
    anchors = fitted_anchors(ordered_mesh(device, root), np.delete(root, 6), cluster, np.full(len(root) - 1, 0.1))
    np.testing.assert_array_equal(anchors.vertex, np.delete(root, 6))


@pytest.mark.parametrize(("corners", "expected"), [([], {12, 15}), ([15], {15})])
def test_vertices_on_a_line_or_corners_of_it_alone_anchor_their_cluster(corners, expected, device):
    root = np.arange(POINTS.shape[1], dtype=np.int32)
    root[10:20] = 4
    line_rank = np.zeros(len(root), dtype=np.int32)
    line_rank[[12, 15]] = 1
    line_rank[corners] = 2
    kept, cluster = np.unique(root, return_inverse=True)
    anchors = fitted_anchors(
        ordered_mesh(device, root, line_rank), kept, cluster.astype(np.int32), np.full(len(kept), 0.1)
    )
    at = int(np.searchsorted(kept, 4))
    assert set(anchors.vertex[anchors.start[at] : anchors.start[at + 1]].tolist()) == expected


def test_anchor_stays_within_its_cluster_where_planes_hardly_meet(device):
    # An arc of a thin band: its planes meet in the arc's axis, far from the band.
    angle = np.linspace(0, 0.1, 6)
    arc = np.stack([np.cos(angle), np.sin(angle), np.zeros(6)], axis=1)
    points = 10 * np.concatenate([arc, arc + np.array([0, 0, 0.01])]).astype(np.float32)[None]
    position = packed(points, device)
    quadric = oracle.zero()
    for direction in ([0.0, 1.0, 0.0], [0.0, 0.0, 1.0]):
        quadric += oracle.plane(np.array(direction), np.array([0.0, -8.0, 0.0]))
    quadrics = np.zeros((12, 1, 10))
    quadrics[0] = oracle.pack(quadric)
    mesh = SimpleNamespace(
        root=np.zeros(12, dtype=np.int32),
        row=np.arange(12, dtype=np.int32),
        key_position=position,
        position=packed(np.zeros_like(points), device),
        quadric=packed_quadrics(quadrics, position),
        line_rank=np.zeros(12, dtype=np.int32),
    )
    anchors = fitted_anchors(mesh, np.array([0]), np.zeros(12, dtype=np.int32), np.array([0.005]))
    offset = points[0] - points[0].mean(axis=0)
    place = anchors.weight.astype(np.float64) @ offset[anchors.vertex]
    assert anchors.weight.sum() == pytest.approx(1, abs=1e-4)
    assert np.linalg.norm(place) <= np.linalg.norm(offset, axis=1).max() * (1 + 1e-3)


def test_anchor_stays_near_the_end_of_a_ridge_that_its_planes_share(device):
    # The members lie along x from -1 to 5; the planes' optimum is anywhere on the ridge y = z = 0 at x = -6.
    points = np.array([[-1.0, 0.1, 0], [0, -0.1, 0], [1, 0.1, 0], [5, -0.1, 0]], dtype=np.float32)[None]
    position = packed(points, device)
    quadric = oracle.zero() + oracle.plane(np.array([1.0, 0.0, 0.0]), np.array([-6.0, 0.0, 0.0]))
    quadrics = np.zeros((4, 1, 10))
    quadrics[0] = oracle.pack(quadric)
    mesh = SimpleNamespace(
        root=np.zeros(4, dtype=np.int32),
        row=np.arange(4, dtype=np.int32),
        key_position=position,
        position=packed(np.zeros_like(points), device),
        quadric=packed_quadrics(quadrics, position),
        line_rank=np.zeros(4, dtype=np.int32),
    )
    anchors = fitted_anchors(mesh, np.array([0]), np.zeros(4, dtype=np.int32), np.array([1e-4]))
    place = anchors.weight.astype(np.float64) @ points[0][anchors.vertex]
    # A quarter of the radius, 3.75 about the mean at 1.25, beyond the member at -1.
    assert place[0] == pytest.approx(-1 - 0.25 * 3.75, abs=0.01)


def in_order(holder, distance, starts, found) -> None:
    _find_in_order(holder, distance, starts[1], found)


def by_sort(holder, distance, starts, found) -> None:
    _find_by_sort(holder, distance, *starts, found)


@pytest.mark.parametrize("find", [in_order, by_sort])
@pytest.mark.parametrize("most", [1, 3, 32])
def test_nearest_vertices_come_first_and_equal_ones_in_their_order(most, find, device):
    rng = np.random.default_rng(11)
    cluster = rng.integers(-1, 6, size=200).astype(np.int32)
    cluster[cluster == 4] = 5  # a cluster without a vertex
    distance = rng.integers(0, 9, size=200).astype(np.float32)
    first = np.concatenate([[0], np.cumsum(np.bincount(cluster[cluster >= 0], minlength=6))]).astype(np.int32)
    size = np.minimum(np.diff(first), most)
    start = np.concatenate([[0], np.cumsum(size)]).astype(np.int32)
    holder = wp.array(np.append(cluster, -1), dtype=wp.int32, device=device)
    starts = [wp.array(values, dtype=wp.int32, device=device) for values in (first, start)]
    found = wp.empty(int(start[-1]), dtype=wp.int32, device=device)
    find(holder, wp.array(distance, device=device), starts, found)
    chosen = found.numpy()
    for c in range(6):
        members = np.flatnonzero(cluster == c)
        expected = members[np.argsort(distance[members], kind="stable")][:most]
        np.testing.assert_array_equal(chosen[start[c] : start[c + 1]], expected)


def test_nearly_coincident_cluster_gets_equal_weights(device):
    """What rounding leaves of its quadric may be a negative constant, which no inverse survives."""
    members = np.arange(6)
    points = (0.1 + 1e-8 * np.arange(18).reshape(1, 6, 3)).astype(np.float32)
    quadric = np.zeros((6, 1, 10), dtype=np.float32)
    quadric[0, 0] = [7.5e-2, -3.8e-2, -6e-3, 2.2e-2, -3e-4, 1.5e-2, 0, 0, 0, -1.4e-10]
    row = wp.zeros(1, dtype=wp.int32, device=device)
    ordered = packed(points, device)
    weight = wp.zeros(6, dtype=wp.float32, device=device)
    mesh = SimpleNamespace(key_position=ordered, position=ordered, quadric=packed_quadrics(quadric, ordered))
    start, member, first_entry = (
        wp.array(values, dtype=wp.int32, device=device) for values in ([0, 6], members, [0, 21])
    )
    stiffness, matrix = wp.full(1, 0.02, dtype=wp.float32, device=device), wp.zeros(21, dtype=wp.float32, device=device)
    fit_weights(mesh, row, Anchors(start, member, weight), first_entry, stiffness, matrix)
    np.testing.assert_allclose(weight.numpy(), 1 / 6, rtol=1e-6)


def cluster_case(seed) -> tuple[np.ndarray, np.ndarray]:
    """Clusters of 90 vertices, -1 for none, one of seven without a vertex; and their ranks."""
    rng = np.random.default_rng(seed)
    cluster = rng.integers(-1, 7, size=90)
    cluster[cluster == 3] = 5
    return cluster, rng.choice(3, size=90, p=[0.8, 0.15, 0.05])


@pytest.mark.parametrize("seed", range(3))
def test_vertices_of_clusters_are_counted_and_those_of_the_highest_rank_marked(seed, device):
    cluster, rank = cluster_case(seed)
    clusters = Clusters.of(cluster.astype(np.int32), rank.astype(np.int32), 7, device)
    highest = np.zeros(7, dtype=int)
    np.maximum.at(highest, cluster[cluster >= 0], rank[cluster >= 0])
    np.testing.assert_array_equal(clusters.size, np.bincount(cluster[cluster >= 0], minlength=7))
    np.testing.assert_array_equal(clusters.highest_rank, highest)
    expected = np.where((cluster >= 0) & (rank == highest[cluster]), cluster, -1)
    np.testing.assert_array_equal(clusters.holder.numpy(), expected)
    np.testing.assert_array_equal(clusters.holder_count, np.bincount(expected[expected >= 0], minlength=7))


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_holders_come_in_threes(count, device):
    holder = Clusters.of(np.zeros(count, dtype=np.int32), np.zeros(count, dtype=np.int32), 1, device).holder
    assert holder.numpy().tolist() == [0] * count + [-1] * (-count % 3)


@pytest.mark.parametrize("seed", range(3))
def test_pinned_anchors_are_their_own_vertex_and_the_first_heaviest_member_is_found(seed, device):
    rng = np.random.default_rng(seed)
    size = rng.integers(1, 6, size=40)
    start = np.concatenate([[0], np.cumsum(size)])
    vertex, weight = rng.permutation(start[-1]), rng.choice([-0.5, 0.25, 0.5, 1.0], size=start[-1])
    kept, pinned = 1000 + np.arange(40), rng.random(40) < 0.3
    arrays = [wp.array(values, dtype=wp.int32, device=device) for values in (start, vertex)]
    anchors = Anchors(*arrays, wp.array(weight, dtype=wp.float32, device=device))
    heaviest = anchors.finish(kept, pinned).numpy()
    owner = np.repeat(np.arange(40), size)
    weight[pinned[owner]] = 0.0
    weight[start[:-1][pinned]], vertex[start[:-1][pinned]] = 1.0, kept[pinned]
    found = fetched(anchors)
    np.testing.assert_array_equal(found.vertex, vertex)
    np.testing.assert_array_equal(found.weight, weight)
    first = [start[c] + np.argmax(weight[start[c] : start[c + 1]]) for c in range(40)]
    np.testing.assert_array_equal(heaviest, vertex[first])


def test_vertices_are_put_in_the_middle_of_their_clusters(device):
    rng = np.random.default_rng(0)
    points = rng.normal(size=(3, 20, 3)).astype(np.float32)
    there = pack_frames(points, device)
    position = pack_frames(np.zeros((3, 5, 3), dtype=np.float32), device)
    members = [np.array([4, 0, 7]), np.array([11])]
    arrays = ([3, 1], [0, 3, 4], np.concatenate(members))
    inputs = [wp.array(np.array(values, dtype=np.int32), device=device) for values in arrays]
    kernel = put_in_the_middle[width_of(there)]
    wp.launch(kernel, dim=(2, there.shape[1]), inputs=[*inputs, there], outputs=[position], device=device)
    found = wp.empty((3, 5), dtype=wp.vec3, device=device)
    unpack_frames(position, found)
    expected = np.zeros((3, 5, 3))
    for row, member in zip((3, 1), members, strict=True):
        expected[:, row] = points[:, member].mean(axis=1)
    np.testing.assert_allclose(found.numpy(), expected, atol=1e-6)
