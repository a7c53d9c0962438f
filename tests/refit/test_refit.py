"""The refit: a better fit of the whole surface that adds neither flips nor motion over the surface."""

import os
from dataclasses import replace

import numpy as np
import pytest
import trimesh
import warp as wp

import warpqem
import warpqem.runtime.device
from tests.support import cuda_semantics, meshes
from tests.support.moving_meshes import BAR, SPHERE, rms
from warpqem.decimation.adjacency import build_adjacency
from warpqem.kernels.element_solve import Elements
from warpqem.measure import compare
from warpqem.pipeline import place_frames, prepare
from warpqem.refit import fit_surface, material_frames
from warpqem.refit.matching import OUTPUT_SAMPLES
from warpqem.refit.seam_edges import find_seams
from warpqem.refit.solve import ElementSolver

RATIO = 0.12


@pytest.fixture(scope="module", params=["sphere", "bar"])
def both(request, device):
    """(input, result as placed, result refitted)."""
    mesh = {"sphere": SPHERE, "bar": BAR}[request.param]
    return mesh, *(warpqem.simplify(*mesh, ratio=RATIO, refit=refit, device=device) for refit in (False, True))


def test_refit_lowers_the_error(both, device):
    mesh, placed, refitted = both
    assert rms(mesh, refitted, device) < 0.95 * rms(mesh, placed, device)


def test_refit_keeps_the_topology(both):
    _, placed, refitted = both
    np.testing.assert_array_equal(refitted.faces, placed.faces)
    np.testing.assert_array_equal(refitted.vertex_map, placed.vertex_map)


def test_refit_adds_no_flip(both):
    _, placed, refitted = both
    assert (refitted.flips <= placed.flips).all()


def test_refit_slides_little_more_than_placement(both, device):
    (points, faces), placed, refitted = both
    before, after = (compare(points, faces, r.points, r.faces, samples=500, device=device) for r in (placed, refitted))
    assert after.slide < 1.5 * before.slide + 0.01


def border_edges(faces):
    """(B, 2) vertices, along the faces."""
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    directed = set(map(tuple, edges.tolist()))
    return np.array([e for e in edges.tolist() if (e[1], e[0]) not in directed])


def distance_to_segments(query, a, b):
    """(Q,) distances of points from the nearest of some segments."""
    along = ((query[:, None] - a) * (b - a)).sum(axis=-1) / ((b - a) ** 2).sum(axis=-1)
    foot = a + np.clip(along, 0, 1)[..., None] * (b - a)
    return np.linalg.norm(query[:, None] - foot, axis=-1).min(axis=1)


def border_error(mesh, result):
    """RMS distance of the input's border vertices from the output's border, over the frames."""
    points, faces = mesh
    vertex, edge = np.unique(border_edges(faces)), border_edges(result.faces)
    squared = [
        distance_to_segments(p[vertex], q[edge[:, 0]], q[edge[:, 1]]) ** 2
        for p, q in zip(points, result.points, strict=True)
    ]
    return np.sqrt(np.mean(squared))


def round_cloth():
    """A disc that waves: its border is curved in the surface and across it."""
    points, faces = meshes.waving_grid(20, 4)
    x, y = 2 * points[0, :, 0] / np.ptp(points[0, :, 0]), 2 * points[0, :, 1] / np.ptp(points[0, :, 1])
    x, y = x - (x.max() + x.min()) / 2, y - (y.max() + y.min()) / 2
    disc = points.copy()
    disc[:, :, 0], disc[:, :, 1] = x * np.sqrt(1 - y**2 / 2), y * np.sqrt(1 - x**2 / 2)
    return disc, faces


def test_refit_fits_borders_to_borders(device):
    cloth = round_cloth()
    placed, refitted = (warpqem.simplify(*cloth, ratio=0.1, refit=r, device=device) for r in (False, True))
    assert border_error(cloth, refitted) < 0.95 * border_error(cloth, placed)


def seam_error(mesh, seams, result):
    """RMS distance of the input's seam vertices from the edges that seams have become, over the frames."""
    edge = result.vertex_map[seams]
    squared = [
        distance_to_segments(p[np.unique(seams)], q[edge[:, 0]], q[edge[:, 1]]) ** 2
        for edge in [edge[edge[:, 0] != edge[:, 1]]]
        for p, q in zip(mesh[0], result.points, strict=True)
    ]
    return np.sqrt(np.mean(squared))


def test_refit_fits_seams_to_seams(device):
    points, faces = meshes.waving_grid(24, 4)
    points[:, :, 0] += 0.05 * np.sin(2 * np.pi * points[:, :, 1])
    column = np.arange(25) * 25 + 12
    seams = np.stack([column[:-1], column[1:]], axis=1)
    placed, refitted = (
        warpqem.simplify(points, faces, ratio=0.1, seams=seams, refit=r, device=device) for r in (False, True)
    )
    assert seam_error((points, faces), seams, refitted) < 0.95 * seam_error((points, faces), seams, placed)


def test_seams_of_an_island_that_is_gone_are_fitted_to_nothing():
    faces = np.array([[0, 1, 2], [1, 3, 2]], dtype=np.int32)
    # Both half-edges between vertices 1 and 2, which one vertex of the output stands for.
    half_edges = np.array([1, 5])
    is_left, out_faces = np.ones(2, dtype=bool), np.array([[0, 1, 2]], dtype=np.int32)
    there = find_seams(half_edges, faces, is_left, np.array([0, 1, 2, 2], dtype=np.int32), out_faces, 3)
    gone = find_seams(half_edges, faces, is_left, np.array([0, 1, 1, 2], dtype=np.int32), out_faces, 3)
    assert [seams.half_edge.tolist() for seams in there] == [[1], [1]]
    assert [seams.half_edge.tolist() for seams in gone] == [[], []]


def test_refit_leaves_the_ends_of_seams_where_they_are(device, monkeypatch):
    # Both are placed alike.
    monkeypatch.setattr(prepare, "cost_of_coherence", lambda _: np.inf)
    points, faces = meshes.waving_grid(20, 4)
    column = np.arange(5, 15) * 21 + 10
    seams = np.stack([column[:-1], column[1:]], axis=1)
    placed, refitted = (
        warpqem.simplify(points, faces, ratio=0.1, seams=seams, refit=r, coherence=0.0, device=device)
        for r in (False, True)
    )
    ends = placed.vertex_map[column[[0, -1]]]
    np.testing.assert_array_equal(refitted.points[:, ends], placed.points[:, ends])
    assert not np.array_equal(refitted.points, placed.points)


@pytest.mark.parametrize("radius", [0.1, 0.15, 0.25])
def test_refit_draws_no_needles_out_of_parts_of_few_faces(radius, device):
    """Near the tips of a tetrahedron that stands for a tube no point of the tube faces the same way."""
    cylinder = trimesh.creation.cylinder(radius, 1.0, sections=12)
    points, faces = trimesh.remesh.subdivide_to_size(cylinder.vertices, cylinder.faces, 1 / 3)
    tube = trimesh.Trimesh(points, faces, process=True)
    placed, refitted = (
        compare(tube.vertices, tube.faces, result.points, result.faces, samples=3000, device=device)
        for refit in (False, True)
        for result in [
            warpqem.simplify(
                tube.vertices, tube.faces, target_faces=4, memoryless=True, refit=refit, measure=False, device=device
            )
        ]
    )
    assert refitted.rms < 0.8 * placed.rms
    assert refitted.hausdorff < placed.hausdorff


def test_refit_of_a_mesh_that_grows_lowers_the_error_in_all_sizes(device):
    points, faces = meshes.bumpy_sphere(3)
    frames = points * np.geomspace(1.0, 25.0, 8)[:, None, None]
    placed, refitted = (
        warpqem.simplify(frames, faces, ratio=0.1, memoryless=True, refit=refit, device=device)
        for refit in (False, True)
    )
    small, large = (
        [rms((frames[t : t + 1], faces), replace(r, points=r.points[t : t + 1]), device) for r in (placed, refitted)]
        for t in (0, 7)
    )
    assert small[1] < 0.95 * small[0]
    assert large[1] < 0.95 * large[0]


@pytest.mark.parametrize("smallest", [1e-3, 1e-2, 0.1])
def test_a_mesh_that_grows_out_of_a_point_is_fitted_alike_in_all_sizes(smallest, device):
    """Seams have rings that are nearly lines, which say little about how much the surface stretches across them."""
    points, faces = meshes.grid(29, 29)
    points = points - 0.5
    points[:, 2] = 0.1 * np.sin(9 * points[:, 0]) * np.cos(7 * points[:, 1])
    frames = points * np.linspace(smallest, 1.0, 12)[:, None, None]
    row = np.arange(900).reshape(30, 30)[15]
    seams = np.stack([row[:-1], row[1:]], axis=1)
    result = warpqem.simplify(frames, faces, ratio=0.25, seams=seams, coherence=1.0, device=device)
    largest = compare(frames, faces, result.points, result.faces, device=device).per_frame.hausdorff
    assert largest.max() < 1.05 * largest.min()


def test_refit_of_a_mesh_without_area_changes_nothing(device):
    points, faces = meshes.grid(8, 8)
    line = points * np.array([1, 0, 0], dtype=np.float32)
    placed, refitted = (warpqem.simplify(line, faces, ratio=0.5, refit=r, device=device) for r in (False, True))
    np.testing.assert_array_equal(refitted.points, placed.points)


def test_refit_moves_vertices_of_seams_across_the_surface(device, monkeypatch):
    # Of the same vertices, held alike where they are placed.
    monkeypatch.setattr(prepare, "SPARE", 0.0)
    monkeypatch.setattr(prepare, "cost_of_coherence", lambda _: np.inf)
    points, faces = meshes.icosphere(4)
    seams = np.array(
        [
            e
            for e in np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
            if (np.abs(points[e, 2]) < 1e-6).all()
        ]
    )
    placed, refitted = (
        warpqem.simplify(points, faces, ratio=0.05, seams=seams, refit=r, device=device) for r in (False, True)
    )
    seam = np.unique(placed.vertex_map[seams])
    move = (refitted.points - placed.points)[0, seam]
    normal = placed.points[0, seam] / np.linalg.norm(placed.points[0, seam], axis=1, keepdims=True)
    across = np.abs((move * normal).sum(axis=1))
    assert across.max() > 1e-3
    assert seam_error((points[None], faces), seams, refitted) < seam_error((points[None], faces), seams, placed)


def test_refit_leaves_locked_vertices_where_they_are(device):
    points, faces = SPHERE
    locked = [0, 7, 30]
    result = warpqem.simplify(points, faces, ratio=RATIO, refit=True, locked=locked, device=device)
    np.testing.assert_array_equal(result.points[:, result.vertex_map[locked]], points[:, locked])


def test_refit_is_the_same_on_every_run(both, device):
    mesh, _, refitted = both
    again = warpqem.simplify(*mesh, ratio=RATIO, refit=True, device=device)
    np.testing.assert_array_equal(again.points, refitted.points)


def test_refit_is_the_same_where_its_frames_are_not_kept(both, device, monkeypatch):
    never = property(lambda self: False, lambda self, keeps: None)
    monkeypatch.setattr(material_frames.MaterialFrames, "_keeps", never, raising=False)
    mesh, _, refitted = both
    again = warpqem.simplify(*mesh, ratio=RATIO, refit=True, device=device)
    np.testing.assert_array_equal(again.points, refitted.points)


def test_refit_has_no_effect_on_endpoint_placement(device):
    plain, refitted = (
        warpqem.simplify(*SPHERE, ratio=RATIO, placement="endpoint", refit=r, device=device) for r in (False, True)
    )
    np.testing.assert_array_equal(plain.points, refitted.points)


def test_refit_does_not_depend_on_the_scale(device):
    points, faces = SPHERE
    plain, large = (
        warpqem.simplify(points * np.float32(s), faces, ratio=RATIO, refit=True, device=device) for s in (1, 1024)
    )
    np.testing.assert_allclose(large.points, 1024 * plain.points, rtol=1e-5, atol=0.02)


def test_refit_of_a_still_mesh_lowers_the_error(device):
    points, faces = meshes.icosphere(4)
    placed, refitted = (warpqem.simplify(points, faces, ratio=0.1, refit=r, device=device) for r in (False, True))
    assert rms((points, faces), refitted, device) < rms((points, faces), placed, device)


def test_samples_of_a_face_are_distinct_and_lie_in_it():
    np.testing.assert_allclose(OUTPUT_SAMPLES.sum(axis=1), 1, atol=1e-12)
    assert (OUTPUT_SAMPLES > 0).all()
    assert len(np.unique(OUTPUT_SAMPLES.round(9), axis=0)) == len(OUTPUT_SAMPLES)


def test_samples_of_a_face_have_its_middle():
    np.testing.assert_allclose(OUTPUT_SAMPLES.mean(axis=0), 1 / 3, atol=1e-12)


@pytest.fixture(params=[True, False], ids=["loop in the graph", "turns"])
def graph_loops(request, monkeypatch, device):
    """Devices whose graphs hold loops, and those whose do not."""
    name = "cpu" if wp.get_device(device).is_cpu else "cuda"
    traits = replace(warpqem.runtime.device._TRAITS[name], graph_loops=request.param)
    monkeypatch.setitem(warpqem.runtime.device._TRAITS, name, traits)


def random_system(device):
    """Elements and the right side of their corners; the same as a matrix and a vector."""
    faces = meshes.icosphere(1)[1]
    vertex_count = int(faces.max()) + 1
    random = np.random.default_rng(0)
    factor = random.normal(size=(len(faces), 9, 9))
    local = factor @ factor.transpose(0, 2, 1) + 0.5 * np.eye(9)
    right = random.normal(size=(len(faces), 3, 3))
    matrix, vector = np.zeros((3 * vertex_count, 3 * vertex_count)), np.zeros(3 * vertex_count)
    for face, block, part in zip(faces, local, right, strict=True):
        index = (3 * face[:, None] + np.arange(3)).ravel()
        matrix[np.ix_(index, index)] += block
        vector[index] += part.ravel()
    elements = Elements()
    elements.corner_vertex = wp.array(faces.ravel(), dtype=wp.int32, device=device)
    adjacency = build_adjacency(elements.corner_vertex, vertex_count)
    elements.adjacency_start, elements.adjacent_corner = adjacency.start, adjacency.corner
    blocks = local.reshape(-1, 3, 3, 3, 3).transpose(0, 1, 3, 2, 4).reshape(-1, 9, 3, 3)
    elements.block = wp.array(np.ascontiguousarray(blocks), dtype=wp.mat33, device=device)
    return elements, wp.array(right.reshape(-1, 3), dtype=wp.vec3, device=device), matrix, vector


def test_conjugate_gradients_solve_the_assembled_system(graph_loops, device):
    elements, right, matrix, vector = random_system(device)
    solution = ElementSolver(elements).solve(right).numpy()
    expected = np.linalg.solve(matrix, vector).reshape(-1, 3)
    assert np.abs(solution - expected).max() <= 2e-3 * np.abs(expected).max()


def test_turns_ahead_of_the_host_move_the_solution_no_further(monkeypatch, device):
    elements, right, *_ = random_system(device)
    once = ElementSolver(elements).solve(right).numpy()
    name = "cpu" if wp.get_device(device).is_cpu else "cuda"
    monkeypatch.setitem(
        warpqem.runtime.device._TRAITS, name, replace(warpqem.runtime.device._TRAITS[name], graph_loops=False)
    )
    monkeypatch.setattr("warpqem.runtime.loops.AHEAD", 9)
    np.testing.assert_array_equal(ElementSolver(elements).solve(right).numpy(), once)


@pytest.mark.skipif("CUDA_SEMANTICS" not in os.environ, reason="needs CUDA_SEMANTICS")
def test_solving_does_not_wait_for_the_device():
    elements, right, *_ = random_system("cpu")
    with cuda_semantics.counted() as traffic:
        ElementSolver(elements).solve(right)
    assert (traffic.graph_launches, traffic.readbacks) == (1, 0)


def test_a_solver_solves_again_after_its_elements_have_changed(device):
    elements, right, *_ = random_system(device)
    solver = ElementSolver(elements)
    solver.solve(right)
    elements.block.assign(2.0 * elements.block.numpy())
    np.testing.assert_array_equal(solver.solve(right).numpy(), ElementSolver(elements).solve(right).numpy())


@pytest.mark.parametrize("roughly", [False, True], ids=["whole", "rough"])
@pytest.mark.skipif("CUDA_SEMANTICS" not in os.environ, reason="needs CUDA_SEMANTICS")
def test_rounds_of_the_fit_do_not_wait_for_the_device(roughly, monkeypatch):
    # Marks of vertices and faces come after the rounds.
    monkeypatch.setattr(fit_surface._Refit, "hold_back", lambda *_, **__: None)
    monkeypatch.setattr(prepare, "SPARE", 0.0)
    waited, fit = [], place_frames.fit_corrections

    def counted(*arguments, **_):
        with cuda_semantics.counted() as traffic:
            corrections = fit(*arguments[:-1], roughly)
        waited.append(traffic.readbacks)
        return corrections

    monkeypatch.setattr(place_frames, "fit_corrections", counted)
    warpqem.simplify(*meshes.swaying_sphere(3, 4), ratio=0.3, refit=True, device="cpu")
    assert waited == [0]


@pytest.mark.parametrize("locked", [[], [0, 7, 30]], ids=["none copied", "some copied"])
def test_frames_that_stay_on_the_device_are_those_kept_on_the_host(locked, device, monkeypatch):
    here = warpqem.simplify(*BAR, ratio=RATIO, refit=True, locked=locked, device=device)
    traits = place_frames.device_traits(device)
    own_memory = not traits.own_memory
    monkeypatch.setattr(place_frames, "device_traits", lambda _: replace(traits, own_memory=own_memory))
    there = warpqem.simplify(*BAR, ratio=RATIO, refit=True, locked=locked, device=device)
    np.testing.assert_array_equal(there.points, here.points)
    np.testing.assert_array_equal(there.flips, here.flips)
