"""Half-edges, adjacency, BORDER and NON_MANIFOLD of every kind of neighbourhood."""

from itertools import pairwise

import numpy as np
import pytest
import warp as wp

from tests.oracles import topology as oracle
from tests.support import meshes
from warpqem.decimation.adjacency import Adjacency, build_adjacency, classify_vertices
from warpqem.decimation.recorded_launches import run_once
from warpqem.kernels.topology import (
    BORDER,
    LOCKED,
    NON_MANIFOLD,
    VertexAdjacency,
    find_half_edge,
    half_edge_target,
    is_canonical,
    next_corner,
    previous_corner,
)

wp.set_module_options({"enable_backward": False})  # no gradients are taken

WELL_FORMED = {
    "triangle": meshes.triangle(),
    "tetrahedron": meshes.tetrahedron(),
    "octahedron": meshes.octahedron(),
    "sphere": meshes.icosphere(2),
    "torus": meshes.torus(8, 5),
    "grid": meshes.grid(4, 3),
    "tube": meshes.tube(5, 3),
    "cone": meshes.fan(7, 0.3),
    "back_to_back": meshes.back_to_back(),
    "pieces": meshes.joined(meshes.octahedron(), meshes.grid(2, 2), meshes.triangle()),
}
FLIPPED_FACE = (meshes.grid(3, 3)[0], np.concatenate([meshes.grid(3, 3)[1][:7], meshes.grid(3, 3)[1][7:, ::-1]]))
BROKEN = {
    "bow_tie": meshes.bow_tie(),
    "double_cone": meshes.double_cone(5),
    "book": meshes.book(3, 2),
    "moebius": meshes.moebius(6),
    "repeated_face": (meshes.octahedron()[0], np.concatenate([meshes.octahedron()[1], meshes.octahedron()[1][:1]])),
    "flipped_face": FLIPPED_FACE,
    "fins": meshes.welded(meshes.joined(meshes.tetrahedron(), meshes.tetrahedron()), {4: 0, 5: 1}),
}
ALL = WELL_FORMED | BROKEN


@wp.kernel
def query_half_edges(
    # in
    corner_vertex_in: wp.array[wp.int32],
    adjacency_in: VertexAdjacency,
    vertex_flags_in: wp.array[wp.int32],
    # out
    next_out: wp.array[wp.int32],
    previous_out: wp.array[wp.int32],
    target_out: wp.array[wp.int32],
    opposite_out: wp.array[wp.int32],
    canonical_out: wp.array[wp.int32],
):
    h = wp.tid()
    next_out[h] = next_corner(h)
    previous_out[h] = previous_corner(h)
    target_out[h] = half_edge_target(corner_vertex_in, h)
    opposite_out[h] = find_half_edge(corner_vertex_in, adjacency_in, target_out[h], corner_vertex_in[h])
    if is_canonical(corner_vertex_in, adjacency_in, vertex_flags_in, h):
        canonical_out[h] = 1


def classified(mesh, device, flags=None):
    """(adjacency, vertex flags, border marks) of a mesh."""
    points, faces = mesh
    corner_vertex = wp.array(faces.ravel(), dtype=wp.int32, device=device)
    adjacency = build_adjacency(corner_vertex, len(points))
    flags = wp.array(np.zeros(len(points)) if flags is None else flags, dtype=wp.int32, device=device)
    border = classify_vertices(corner_vertex, adjacency, flags)
    return adjacency, flags, border


def queried(mesh, device):
    _, faces = mesh
    adjacency, flags, _ = classified(mesh, device)
    outputs = [wp.zeros(faces.size, dtype=wp.int32, device=device) for _ in range(5)]
    corner_vertex = wp.array(faces.ravel(), dtype=wp.int32, device=device)
    wp.launch(
        query_half_edges,
        dim=faces.size,
        inputs=[corner_vertex, adjacency.lists, flags],
        outputs=outputs,
        device=device,
    )
    return [a.numpy() for a in outputs]


@pytest.mark.parametrize("name", ALL)
def test_adjacency_holds_every_corner_in_ascending_order(name, device):
    points, faces = ALL[name]
    adjacency, _, _ = classified(ALL[name], device)
    start, corner = adjacency.start.numpy(), adjacency.corner.numpy()
    rows = [corner[a:b].tolist() for a, b in pairwise(start)]
    assert rows == oracle.adjacency(faces, len(points))


def test_adjacency_is_sorted_where_threads_fill_it_in_any_order(device):
    faces = np.random.default_rng(0).permutation(meshes.fan(300)[1])
    adjacency, _, _ = classified((meshes.fan(300)[0], faces), device)
    centre = adjacency.corner.numpy()[: adjacency.start.numpy()[1]]
    assert len(centre) == 300
    assert (np.diff(centre) > 0).all()


@pytest.mark.parametrize("part_count", [1, 2, 3])
def test_adjacency_is_the_same_in_any_number_of_parts(part_count, device):
    points, faces = meshes.joined(meshes.icosphere(2), meshes.book(), meshes.moebius())
    faces = faces.copy()
    faces[17] = -1
    # The faces behind the count are dead, and one before it.
    corner_vertex, face_count = (wp.array(n, dtype=wp.int32, device=device) for n in (faces.ravel(), [len(faces) - 5]))
    adjacency = Adjacency(corner_vertex, face_count, len(points), spare=7)
    run_once(adjacency.launch_groups(part_count), device)
    start, corner, lists = adjacency.start.numpy(), adjacency.corner.numpy(), adjacency.lists
    alive = faces[: len(faces) - 5].ravel()
    expected = [np.flatnonzero(alive == v).tolist() for v in range(len(points))]
    assert [corner[a:b].tolist() for a, b in pairwise(start)] == expected
    assert (lists.start.numpy().tolist(), lists.end.numpy().tolist()) == (start[:-1].tolist(), start[1:].tolist())
    assert lists.used.numpy().tolist() == [start[-1]]


def test_dead_faces_are_left_out_of_the_adjacency(device):
    points, faces = meshes.octahedron()
    faces = faces.copy()
    faces[3] = -1
    corner_vertex = wp.array(faces.ravel(), dtype=wp.int32, device=device)
    adjacency = build_adjacency(corner_vertex, len(points))
    assert adjacency.start.numpy()[-1] == 21
    assert not np.isin([9, 10, 11], adjacency.corner.numpy()[:21]).any()


def test_next_and_previous_corner_go_round_each_face(device):
    following, before, *_ = queried(meshes.octahedron(), device)
    np.testing.assert_array_equal(following, np.arange(24).reshape(-1, 3)[:, [1, 2, 0]].ravel())
    np.testing.assert_array_equal(before, np.arange(24).reshape(-1, 3)[:, [2, 0, 1]].ravel())


def test_target_is_the_next_corners_vertex(device):
    mesh = meshes.octahedron()
    np.testing.assert_array_equal(queried(mesh, device)[2], np.roll(mesh[1], -1, axis=1).ravel())


@pytest.mark.parametrize("name", WELL_FORMED)
def test_opposite_half_edge(name, device):
    mesh = WELL_FORMED[name]
    tail, head = mesh[1].ravel(), np.roll(mesh[1], -1, axis=1).ravel()
    index = {pair: h for h, pair in enumerate(zip(tail.tolist(), head.tolist(), strict=True))}
    expected = [index.get((b, a), -1) for a, b in zip(tail.tolist(), head.tolist(), strict=True)]
    np.testing.assert_array_equal(queried(mesh, device)[3], expected)


@pytest.mark.parametrize("name", WELL_FORMED)
def test_each_edge_has_one_canonical_half_edge(name, device):
    _, faces = mesh = WELL_FORMED[name]
    canonical = np.flatnonzero(queried(mesh, device)[4])
    ends = np.stack([faces.ravel(), np.roll(faces, -1, axis=1).ravel()], axis=1)[canonical]
    assert sorted(map(tuple, np.sort(ends, axis=1).tolist())) == oracle.edges(faces)


@pytest.mark.parametrize("name", ALL)
def test_border_and_non_manifold_flags(name, device):
    points, faces = ALL[name]
    _, flags, _ = classified(ALL[name], device)
    np.testing.assert_array_equal(flags.numpy(), oracle.vertex_flags(faces, len(points)))


@pytest.mark.parametrize("name", WELL_FORMED)
def test_no_vertex_of_a_manifold_mesh_is_non_manifold(name, device):
    _, flags, _ = classified(WELL_FORMED[name], device)
    assert not (flags.numpy() & int(NON_MANIFOLD)).any()


@pytest.mark.parametrize(
    ("name", "non_manifold"),
    [("bow_tie", [0]), ("double_cone", [0]), ("book", [0, 3, 6]), ("repeated_face", [0, 2, 4]), ("fins", [0, 1])],
)
def test_non_manifold_vertices_of_a_broken_mesh(name, non_manifold, device):
    _, flags, _ = classified(BROKEN[name], device)
    np.testing.assert_array_equal(np.flatnonzero(flags.numpy() & int(NON_MANIFOLD)), non_manifold)


def test_border_of_a_tube_is_its_two_rims(device):
    _, flags, _ = classified(meshes.tube(5, 3), device)
    np.testing.assert_array_equal(np.flatnonzero(flags.numpy() & int(BORDER)), [0, 1, 2, 3, 4, 15, 16, 17, 18, 19])


@pytest.mark.parametrize("name", ALL)
def test_half_edges_without_an_opposite_one_are_marked(name, device):
    faces = ALL[name][1]
    directed = list(zip(faces.ravel().tolist(), np.roll(faces, -1, axis=1).ravel().tolist(), strict=True))
    expected = [(b, a) not in set(directed) for a, b in directed]
    np.testing.assert_array_equal(classified(ALL[name], device)[2].numpy(), expected)


def test_locked_flag_survives_classification(device):
    mesh = meshes.grid(2, 2)
    _, flags, _ = classified(mesh, device, np.where(np.arange(9) == 4, int(LOCKED), 0))
    np.testing.assert_array_equal(np.flatnonzero(flags.numpy() & int(LOCKED)), [4])


def test_vertex_without_a_face_has_no_flag(device):
    points, faces = meshes.triangle()
    _, flags, _ = classified((np.concatenate([points, points]), faces), device)
    np.testing.assert_array_equal(flags.numpy()[3:], 0)
