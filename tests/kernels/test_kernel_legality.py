"""Every rule that refuses a collapse, one test each."""

import numpy as np
import pytest
import warp as wp

from tests.oracles import topology as oracle
from tests.oracles.inversion import inversion_sum
from tests.support import meshes
from tests.support.mesh_state import build_mesh, cost_model, edge_list, half_edge_between, one_part, packed
from warpqem.kernels.lanes import width_of
from warpqem.kernels.legality import check_collapses
from warpqem.kernels.topology import MIRROR, SEAM


def checked(built, half_edges, target, device, flip_tolerance=0, cost=1e30) -> np.ndarray:
    """Faces removed by each half-edge, 0 where illegal; ``target`` (E, K, 3).

    By default edges are so costly that no distance makes them costlier.
    """
    built.state.edge_cost.fill_(cost)
    out = wp.full(len(half_edges), -1, dtype=wp.int32, device=device)
    legal, space = (wp.zeros(1, dtype=wp.int32, device=device) for _ in range(2))
    blocks = packed(np.asarray(target).transpose(1, 0, 2), device)
    selected, work = edge_list(half_edges, device), one_part(device)
    inputs = [built.state, built.frames, cost_model(), selected, blocks, flip_tolerance, work]
    error = wp.zeros(len(half_edges), dtype=wp.float32, device=device)
    outputs = [out, error, legal, space]
    wp.launch(check_collapses[width_of(blocks)], dim=1, inputs=inputs, outputs=outputs, device=device)
    assert legal.numpy()[0] == (out.numpy() > 0).sum()
    return out.numpy()


def checked_at_middle(mesh, u, v, device, **options) -> int:
    points, faces = mesh
    points = points[None] if points.ndim == 2 else points
    built = build_mesh(points, faces, device)
    middle = (points[:, u] + points[:, v]) / 2
    return int(checked(built, [half_edge_between(faces, u, v)], middle[None], device, **options)[0])


def test_inner_edge_of_a_sphere_removes_two_faces(device):
    mesh = meshes.icosphere(1)
    assert checked_at_middle(mesh, *mesh[1][0, :2], device) == 2


def test_border_edge_of_a_grid_removes_one_face(device):
    assert checked_at_middle(meshes.grid(4, 4), 1, 2, device) == 1


def test_link_condition_refuses_a_common_neighbour_that_is_not_opposite(device):
    # Around a tube of three, the third vertex of the ring is a neighbour of both ends without a face on the edge.
    mesh = meshes.tube(3, 4)
    assert checked_at_middle(mesh, 6, 7, device) == 0
    wider = meshes.tube(4, 4)
    assert checked_at_middle(wider, 8, 9, device) == 2


def test_link_condition_refuses_to_close_a_hole_of_three_edges(device):
    points, faces = meshes.icosphere(1)
    hole, faces = faces[0], faces[1:]
    assert checked_at_middle((points, faces), hole[1], hole[0], device) == 0


def test_pinch_refuses_an_inner_edge_between_border_vertices(device):
    assert checked_at_middle(meshes.grid(4, 1), 2, 7, device) == 0


def test_mirror_rule_refuses_an_inner_edge_between_two_vertices_of_the_plane(device):
    # An inner vertex over three vertices of the border: into one of the outer two, it would join both.
    points, faces = meshes.grid(4, 3)
    faces = oracle.collapsed(faces, 6, 7)
    points[6, 0] = 1.5 / 4
    edges = [(6, 1), (6, 2), (6, 3), (6, 11)]
    half_edges = [half_edge_between(faces, u, v) for u, v in edges]
    target = np.array([[points[6]]] * len(edges))
    built = build_mesh(points, faces, device)
    assert (checked(built, half_edges, target, device, flip_tolerance=1) > 0).all()
    flags = built.state.vertex_flags.numpy()
    flags[:5] |= int(MIRROR)
    built.state.vertex_flags = wp.array(flags, device=device)
    assert (checked(built, half_edges, target, device, flip_tolerance=1) > 0).tolist() == [False, True, False, True]


def test_opposite_vertex_keeps_three_faces_inside(device):
    points, faces = meshes.split_faces(meshes.icosphere(1))
    u, v = meshes.icosphere(1)[1][0, :2]
    assert checked_at_middle((points, faces), u, v, device) == 0
    assert checked_at_middle(meshes.icosphere(1), u, v, device) == 2


def test_opposite_vertex_keeps_one_face_at_a_border(device):
    assert checked_at_middle(meshes.triangle(), 0, 1, device) == 0
    assert checked_at_middle(meshes.grid(1, 1), 0, 1, device) == 1


def test_opposite_vertex_keeps_the_last_triangles_of_a_tetrahedron(device):
    assert checked_at_middle(meshes.tetrahedron(), 0, 1, device) == 0


def test_last_face_of_a_merged_vertex_is_kept(device):
    # The wing is a bow tie: its other fan has faces enough for the wing rule.
    points, faces = meshes.welded(meshes.joined(meshes.triangle(), meshes.fan(4)), {3: 0})
    assert checked_at_middle((points, faces), 1, 2, device) == 0


def flat_fan_moved(frames, flipped, device, flip_tolerance):
    """Judge a border-free collapse in a grid whose target lies outside its ring in the ``flipped`` frames."""
    points, faces = meshes.grid(5, 5)
    built = build_mesh(np.stack([points] * frames), faces, device)
    good, bad = (points[14] + points[15]) / 2, points[14] + np.array([-0.7, 0.1, 0], np.float32)
    target = np.stack([bad if t in flipped else good for t in range(frames)])[None]
    return int(checked(built, [half_edge_between(faces, 14, 15)], target, device, flip_tolerance)[0])


def test_flip_in_one_frame_is_refused(device):
    assert flat_fan_moved(4, {}, device, 0) == 2
    assert flat_fan_moved(4, {2}, device, 0) == 0


def test_flip_in_few_frames_is_tolerated(device):
    assert flat_fan_moved(8, {2}, device, 1) == 2


def test_flip_in_more_frames_than_tolerated_is_refused(device):
    assert flat_fan_moved(8, {2, 3}, device, 1) == 0


def test_flip_of_the_whole_is_refused_however_many_frames_are_tolerated(device):
    assert flat_fan_moved(4, {0, 1, 2, 3}, device, 4) == 0


@pytest.mark.parametrize(("degrees", "faces_removed"), [(70, 2), (85, 0)])
def test_face_may_turn_by_78_degrees_at_most(degrees, faces_removed, device):
    # A hexagon around the edge 0 1, flat; lifting the merged vertex turns the six faces left by the same angle.
    angle = np.pi * np.arange(8) / 4
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(8)], axis=1) / 2
    points = np.concatenate([[[-1e-4, 0, 0], [1e-4, 0, 0]], ring]).astype(np.float32)
    right, left = [8, 9, 2, 3, 4], [4, 5, 6, 7, 8]
    faces = [[1, 2 + (i - 2) % 8, 2 + (i - 1) % 8] for i in right[:-1]]
    faces += [[0, 2 + (i - 2) % 8, 2 + (i - 1) % 8] for i in left[:-1]]
    faces = np.array([*faces, [0, 1, 4], [1, 0, 8]], dtype=np.int32)
    inradius = 0.5 * np.cos(np.pi / 8)
    target = np.array([[[0, 0, inradius * np.tan(np.radians(degrees))]]])
    built = build_mesh(points, faces, device)
    assert checked(built, [half_edge_between(faces, 0, 1)], target, device)[0] == faces_removed


def test_face_without_area_may_turn_anyhow(device):
    points, faces = meshes.icosphere(1)
    built = build_mesh(np.zeros_like(points), faces, device)
    half_edge = half_edge_between(faces, *faces[0, :2])
    assert checked(built, [half_edge], np.ones((1, 1, 3)), device)[0] == 2


def test_collapse_to_a_face_without_area_is_refused(device):
    points, faces = meshes.grid(5, 5)
    built = build_mesh(points, faces, device)
    # On the line through the ring's lower side, one face loses its area.
    target = (points[14] + points[15]) / 2 - np.array([0, 0.2, 0], np.float32)
    assert checked(built, [half_edge_between(faces, 14, 15)], target[None, None], device)[0] == 0


@pytest.mark.parametrize("scale", [1.0, 1e-3, 1e-4, 1e-5])
def test_verdict_does_not_depend_on_the_size_of_faces(scale, device):
    # A part of a hundred thousandth of the diagonal is small, but its faces still have areas far above NO_AREA.
    points, faces = meshes.grid(5, 5)
    small = (points * np.float32(scale), faces)
    assert checked_at_middle(small, 14, 15, device) == 2


def test_refused_edge_is_suspended_and_a_legal_one_is_not(device):
    points, faces = meshes.grid(4, 1)
    built = build_mesh(points, faces, device)
    pinched, border = half_edge_between(faces, 2, 7), half_edge_between(faces, 1, 2)
    middle = np.array([points[[2, 7]].mean(axis=0), points[[1, 2]].mean(axis=0)])[:, None]
    assert checked(built, [pinched, border], middle, device, cost=3.0).tolist() == [0, 1]
    assert built.state.edge_cost.numpy()[[pinched, border]].tolist() == [-3, 3]


TOPOLOGIES = {
    "tetrahedron": meshes.tetrahedron(),
    "octahedron": meshes.octahedron(),
    "sphere": meshes.icosphere(1),
    "torus": meshes.torus(5, 3),
    "thin_torus": meshes.torus(3, 4),
    "grid": meshes.grid(3, 3),
    "strip": meshes.grid(4, 1),
    "tube": meshes.tube(3, 3),
    "cone": meshes.fan(5, 0.2),
    "small_cone": meshes.fan(3, 0.2),
    "stellated": meshes.split_faces(meshes.octahedron()),
    "back_to_back": meshes.back_to_back(),
    "square": meshes.grid(1, 1),
}


def test_edge_that_seams_made_costly_is_put_back_at_its_new_cost(device):
    points, faces = meshes.grid(4, 4)
    built = build_mesh(points, faces, device)
    u, v = 6, 7
    h = half_edge_between(faces, u, v)
    middle = (points[None, u] + points[None, v]) / 2
    cheap = 1e-12
    assert checked(built, [h], middle[None], device, cost=cheap)[0] == 2
    flags = built.state.vertex_flags.numpy()
    flags[[u, v]] |= int(SEAM)
    built.state.vertex_flags = wp.array(flags, dtype=wp.int32, device=device)
    assert checked(built, [h], middle[None], device, cost=cheap)[0] == 0
    assert cheap < built.state.edge_cost.numpy()[h] < np.inf


@pytest.mark.parametrize("name", TOPOLOGIES)
def test_verdict_without_flips_is_that_of_the_result_staying_manifold(name, device):
    points, faces = TOPOLOGIES[name]
    edges = oracle.edges(faces)
    tail, head = faces.ravel().tolist(), np.roll(faces, -1, axis=1).ravel().tolist()
    directed = set(zip(tail, head, strict=True))
    half_edges = [half_edge_between(faces, *(e if e in directed else e[::-1])) for e in edges]
    # All points in one place: no face has an area, so none can flip.
    built = build_mesh(np.zeros_like(points), faces, device)
    legal = checked(built, half_edges, np.zeros((len(edges), 1, 3)), device) > 0
    assert legal.tolist() == [oracle.keeps_manifold(faces, u, v) for u, v in edges]


@pytest.mark.parametrize("seed", range(4))
def test_flip_of_the_whole_is_equation_7(seed, device):
    # All frames may flip, so that the sum over them alone decides. Weights of the vertices do not change its sign.
    points, faces = meshes.swaying_sphere(1, 5)
    rng = np.random.default_rng(seed)
    weight = rng.uniform(1, 50, points.shape[1])
    half_edge = np.flatnonzero(faces.ravel() < np.roll(faces, -1, axis=1).ravel())
    ends = np.stack([faces.ravel(), np.roll(faces, -1, axis=1).ravel()])[:, half_edge]
    middle = points[:, ends].mean(axis=1).transpose(1, 0, 2)
    target = middle + rng.normal(scale=0.3, size=middle.shape)
    built = build_mesh(points, faces, device)
    manifold = checked(built, half_edge, middle, device, len(points)) > 0
    found = checked(built, half_edge, target.astype(np.float32), device, len(points)) > 0
    refused = []
    for (u, v), place in zip(ends.T, target.astype(np.float32), strict=True):
        sums = []
        for face in faces[((faces == u) | (faces == v)).sum(axis=1) == 1]:
            moved = (face == u) | (face == v)
            after = np.where(moved[None, :, None], place[:, None], points[:, face])
            merged = np.where(moved, 0.5 * (weight[u] + weight[v]), weight[face])
            sums.append(inversion_sum(points[:, face], after, weight[face], merged))
        refused.append(min(sums) < 0)
    np.testing.assert_array_equal(found[manifold], ~np.array(refused)[manifold])
    assert 5 < found[manifold].sum() < manifold.sum() - 5
