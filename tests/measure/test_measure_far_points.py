"""Points and places far from the faces around, in many frames at once, against the closest points of trimesh."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
import warp as wp

import warpqem.runtime.device
from tests.support import meshes
from warpqem.measure.face_lists import FacesAround
from warpqem.measure.far_points import PointLists, PointsAndFaces, furthest_from, longest_edges
from warpqem.measure.surface_places import (
    SAMPLES,
    InputVertices,
    SampledFaces,
    Side,
    SimplifiedVertices,
    furthest_of,
    input_side,
    squared_distances,
)
from warpqem.measure.unit_frames import ChangingBlock, UnitBlock, UnitFrames

FACES = meshes.grid(6, 6)[1]
VERTEX_COUNT = 49


def blocks(rng, frame_count, device):
    """Points (F, V, 3) around a wavy grid, that grid, and both in lanes."""
    other = np.repeat(meshes.grid(6, 6)[0][None], frame_count, axis=0).astype(np.float32)
    other += rng.normal(scale=0.02, size=other.shape).astype(np.float32)
    own = other + rng.normal(scale=0.05, size=other.shape).astype(np.float32)
    units = UnitFrames(np.zeros((frame_count, 3)), np.ones(frame_count))
    return own, other, UnitBlock(own, units, device).lanes, UnitBlock(other, units, device).lanes


def distances(own, other, faces):
    """The distance (F,) of points (F, 3) from some faces."""
    found = []
    for point, points in zip(own, other, strict=True):
        triangles = points[faces].astype(np.float64)
        closest = trimesh.triangles.closest_point(triangles, np.repeat(point[None], len(faces), axis=0))
        found.append(np.linalg.norm(closest - point, axis=1).min())
    return np.array(found)


def second_ring(vertex):
    ring = FACES[(vertex == FACES).any(axis=1)]
    return FACES[np.isin(FACES, ring).any(axis=1)]


def every_place(reference, test, device):
    """Places of one grid and of another one with the same faces, each vertex of which is a cluster of its own."""
    around, vertex = FacesAround(FACES, VERTEX_COUNT), np.arange(VERTEX_COUNT)
    simplified = Side(test, around, around)
    given = input_side(reference, around, vertex, VERTEX_COUNT)
    return {
        "input vertices": InputVertices(reference, simplified, vertex, vertex),
        "input faces": SampledFaces(reference, FACES, FACES, simplified, around),
        "faces": SampledFaces(test, FACES, FACES, given, around),
        "vertices": SimplifiedVertices(test, given, vertex, around),
    }


def two_rings(clusters):
    """The faces around some clusters and around those next to them."""
    return np.unique(np.concatenate([second_ring(cluster) for cluster in clusters]), axis=0)


@pytest.mark.parametrize("name", ["input vertices", "input faces", "faces", "vertices"])
@pytest.mark.parametrize("frame_count", [1, 3, 21])
def test_a_place_is_as_far_as_two_rings_of_faces_around_its_clusters_show(frame_count, name, device):
    own, other, reference, test = blocks(np.random.default_rng(frame_count), frame_count, device)
    place = every_place(reference, test, device)[name]
    here, there = (own, other) if name.startswith("input") else (other, own)
    largest = np.zeros(place.count)
    for index, clusters in enumerate(place.clusters):
        points = here[:, clusters]
        if isinstance(place, SampledFaces):
            points = np.einsum("sk,fkc->fsc", SAMPLES, points)
        faces = two_rings(clusters)
        largest[index] = max(distances(points[:, k], there, faces).max() for k in range(points.shape[1]))
    (found,) = furthest_of([place], [np.zeros(place.count)], device)
    np.testing.assert_allclose(found, largest, atol=1e-5)
    # Each with a limit of its own: beyond it the distance is the same, within it no more than the limit.
    limits = np.median(largest) * np.linspace(0.5, 1.5, place.count)
    (within,) = furthest_of([place], [limits], device)
    clear = np.abs(largest - limits) > 1e-5
    is_far = largest > limits
    np.testing.assert_allclose(within[clear & is_far], largest[clear & is_far], atol=1e-5)
    assert (within[clear & ~is_far] <= limits[clear & ~is_far] + 1e-5).all()
    assert 0 < is_far.sum() < place.count


def test_places_that_are_looked_at_together_are_as_far_as_each_alone(device):
    *_, reference, test = blocks(np.random.default_rng(2), 3, device)
    places = list(every_place(reference, test, device).values())
    limits = [np.full(place.count, 0.05) for place in places]
    for place, limit, found in zip(places, limits, furthest_of(places, limits, device), strict=True):
        (alone,) = furthest_of([place], [limit], device)
        np.testing.assert_array_equal(found, alone)


def test_distances_are_the_same_however_many_threads_have_the_frames_of_a_point(device, monkeypatch):
    *_, reference, test = blocks(np.random.default_rng(0), 21, device)
    around, vertex = FacesAround(FACES, VERTEX_COUNT), np.arange(5)
    given = PointsAndFaces(reference, test, around, PointLists.at(vertex, vertex), around, around)
    within = wp.full(len(vertex), 1e-6, dtype=wp.float32, device=device)
    name = "cpu" if wp.get_device(device).is_cpu else "cuda"
    found = []
    for threads in (1, 10, 25, 1000):
        traits = replace(warpqem.runtime.device._TRAITS[name], launch_threads=threads)
        monkeypatch.setitem(warpqem.runtime.device._TRAITS, name, traits)
        found.append(furthest_from([given], within, device).numpy())
    assert found[0].min() > 1e-6
    for other in found[1:]:
        np.testing.assert_array_equal(other, found[0])


def test_points_that_come_one_after_another_are_measured_as_at_once(device):
    *_, reference, test = blocks(np.random.default_rng(0), 3, device)
    around, vertex = FacesAround(FACES, VERTEX_COUNT), np.arange(VERTEX_COUNT)
    within = wp.full(VERTEX_COUNT, 1e-6, dtype=wp.float32, device=device)
    whole, *parts = (
        PointsAndFaces(reference, test, around, PointLists.at(some, some), around, around)
        for some in (vertex, vertex[:9], vertex[9:9], vertex[9:])
    )
    found = [furthest_from(given, within, device).numpy() for given in ([whole], parts)]
    np.testing.assert_array_equal(*found)


@pytest.mark.parametrize("name", ["input vertices", "faces"])
def test_a_look_that_begins_where_the_last_one_ended_finds_the_same(name, device):
    *_, reference, test = blocks(np.random.default_rng(4), 21, device)
    place = every_place(reference, test, device)[name]
    count = place.count * place.points_of_each
    exact = squared_distances([place], wp.zeros(count, dtype=wp.float32, device=device), device).numpy()
    limit = np.median(exact)
    within = wp.full(count, limit, dtype=wp.float32, device=device)
    nearest = wp.full(count, -1, dtype=wp.int32, device=device)
    for _ in range(2):
        found = squared_distances([place], within, device, nearest).numpy()
        np.testing.assert_array_equal(found[exact > limit], exact[exact > limit])
        assert (found[exact <= limit] <= limit).all()


@pytest.mark.parametrize("name", ["input vertices", "faces"])
def test_points_of_a_negative_limit_are_not_looked_at(name, device):
    *_, reference, test = blocks(np.random.default_rng(4), 21, device)
    place = every_place(reference, test, device)[name]
    count = place.count * place.points_of_each
    exact = squared_distances([place], wp.zeros(count, dtype=wp.float32, device=device), device).numpy()
    is_left_out = np.arange(count) % 3 == 1
    within = wp.array(np.where(is_left_out, -1.0, 0.0), dtype=wp.float32, device=device)
    nearest = wp.full(count, -1, dtype=wp.int32, device=device)
    found = squared_distances([place], within, device, nearest).numpy()
    np.testing.assert_array_equal(found, np.where(is_left_out, 0.0, exact))
    assert (nearest.numpy()[is_left_out] == -1).all()


def test_points_of_faces_are_where_weights_say(device):
    own, other, reference, test = blocks(np.random.default_rng(4), 3, device)
    weights = np.array([[0.5, 0.3, 0.2], [0.1, 0.9, 0.0]])
    given = Side(reference, FacesAround(FACES, VERTEX_COUNT), FacesAround(FACES, VERTEX_COUNT))
    place = SampledFaces(test, FACES, FACES, given, FacesAround(FACES, VERTEX_COUNT), weights)
    (found,) = furthest_of([place], [np.zeros(place.count)], device)
    points = np.einsum("sk,fnkc->fnsc", weights, other[:, FACES])
    for index in (0, 7, len(FACES) - 1):
        faces = two_rings(FACES[index])
        expected = max(distances(points[:, index, k], own, faces).max() for k in range(len(weights)))
        np.testing.assert_allclose(found[index], expected, atol=1e-5)


def test_faces_around_a_vertex_are_those_with_a_corner_there():
    around = FacesAround(FACES, VERTEX_COUNT)
    face, row = around.of(np.array([7, 48, 0]))
    for index, vertex in enumerate((7, 48, 0)):
        assert set(face[row == index]) == set(np.flatnonzero((vertex == FACES).any(axis=1)))


@pytest.mark.parametrize("frame_count", [1, 3, 21])
def test_vertices_put_in_place_some_at_a_time_are_those_put_there_at_once(frame_count, device):
    rng = np.random.default_rng(5)
    points = rng.normal(size=(frame_count, 10, 3)).astype(np.float32)
    units = UnitFrames(rng.normal(size=(frame_count, 3)), rng.uniform(1.0, 2.0, frame_count))
    changing, whole = ChangingBlock((frame_count, 10), units, device), UnitBlock(points, units, device)
    order = rng.permutation(10)
    for vertex in (order[:4], order[4:]):
        index = wp.array(vertex, dtype=wp.int32, device=device)
        changing.put(index, wp.array(points[:, vertex], dtype=wp.vec3, device=device))
    assert np.array_equal(changing.double.numpy(), whole.double.numpy())
    assert np.array_equal(changing.lanes.numpy(), whole.lanes.numpy())


@pytest.mark.parametrize("frame_count", [1, 3, 21])
def test_the_longest_edge_of_a_face_is_that_of_the_frame_in_which_it_is_longest(frame_count, device):
    rng = np.random.default_rng(5)
    own, _, block, _ = blocks(rng, frame_count, device)
    corner = own[:, FACES].astype(np.float64)
    expected = np.linalg.norm(corner - np.roll(corner, 1, axis=2), axis=3).max(axis=(0, 2))
    found = longest_edges([(block, FACES), (block, FACES[5:9])], device)
    np.testing.assert_allclose(found[0], expected, rtol=1e-5)
    np.testing.assert_array_equal(found[1], found[0][5:9])
