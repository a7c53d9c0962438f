"""Lists of faces at vertices and clusters, made on the host and by a sort on a device."""

import itertools

import numpy as np
import pytest
import warp as wp

from tests.support import meshes
from warpqem.kernels import face_lists as kernels
from warpqem.measure import face_lists
from warpqem.measure.face_lists import FacesAround, faces_at_clusters

FACES = np.ascontiguousarray(meshes.grid(7, 5)[1], dtype=np.int32)
# The last vertex has no face.
VERTEX_COUNT = int(FACES.max()) + 2
RNG = np.random.default_rng(0)
CLUSTER = RNG.integers(-1, 6, VERTEX_COUNT).astype(np.int32)


def expected(numbers, count):
    """The faces with each of ``count`` numbers at a corner, once for each such corner, ascending."""
    return [np.repeat(np.arange(len(numbers)), (numbers == number).sum(axis=1)) for number in range(count)]


def listed(start, face):
    return [face[first:last] for first, last in itertools.pairwise(start)]


def assert_same(found, wanted):
    assert len(found) == len(wanted)
    for one, other in zip(found, wanted, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("cluster", [None, CLUSTER])
def test_lists_sorted_on_a_device_hold_the_faces_of_each_in_order(cluster, device):
    corners = wp.array(FACES.ravel(), dtype=wp.int32, device=device)
    there = None if cluster is None else wp.array(cluster, dtype=wp.int32, device=device)
    count = VERTEX_COUNT if cluster is None else 6
    start, face = (array.numpy() for array in face_lists._sorted_there(corners, there, count))
    assert_same(listed(start, face), expected(FACES if cluster is None else cluster[FACES], count))


def test_faces_around_vertices_are_the_same_on_the_host_and_the_device(device):
    around = FacesAround(FACES, VERTEX_COUNT)
    wanted = expected(FACES, VERTEX_COUNT)
    assert_same(listed(around.start, around.face), wanted)
    assert_same(listed(*(array.numpy() for array in around.on(device))), wanted)


@pytest.mark.parametrize("faces", [None, np.array([1, 4, 5, 17])])
def test_faces_at_clusters_are_those_asked_for_at_least(faces, device):
    cluster = np.abs(CLUSTER)
    lists = faces_at_clusters(FacesAround(FACES, VERTEX_COUNT), cluster, 6, faces, device)
    found = listed(*(array.numpy() for array in lists.on(device)))
    wanted = expected(cluster[FACES], 6)
    if faces is None:
        assert_same(found, wanted)
    else:
        assert_same([part[np.isin(part, faces)] for part in found], [part[np.isin(part, faces)] for part in wanted])


@pytest.mark.parametrize("count", [0, 1, 5, VERTEX_COUNT])
def test_faces_at_some_vertices_come_once_each(count):
    is_there = np.zeros(VERTEX_COUNT, dtype=bool)
    is_there[RNG.permutation(VERTEX_COUNT)[:count]] = True
    found = FacesAround(FACES, VERTEX_COUNT).at(is_there)
    np.testing.assert_array_equal(found, np.flatnonzero(is_there[FACES].any(axis=1)))


@pytest.mark.parametrize("room", [3, 100])
def test_corners_in_clusters_are_listed_as_far_as_there_is_room(room, device):
    cluster = CLUSTER[FACES.ravel()]
    inside = np.flatnonzero(cluster >= 0)
    there = wp.array(cluster, dtype=wp.int32, device=device)
    mark = wp.empty(len(cluster), dtype=wp.int32, device=device)
    wp.launch(kernels.mark_corners_in_clusters, len(cluster), [there], [mark], device=device)
    np.testing.assert_array_equal(mark.numpy(), cluster >= 0)
    before = wp.array(np.cumsum(cluster >= 0), dtype=wp.int32, device=device)
    key, corner = (wp.full(room, -7, dtype=wp.int32, device=device) for _ in range(2))
    wp.launch(kernels.key_corners_in_clusters, len(cluster), [there, before, room], [key, corner], device=device)
    listed = inside[:room]
    np.testing.assert_array_equal(corner.numpy()[: len(listed)], listed)
    np.testing.assert_array_equal(key.numpy()[: len(listed)], cluster[listed])
    assert (corner.numpy()[len(listed) :] == -7).all()
