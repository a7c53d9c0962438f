"""Vertices that are held for far places, against the rings that NumPy finds."""

import numpy as np
import pytest
import warp as wp

from tests.support import meshes
from warpqem.refit.far_places import FarLook, FarPlaces

POINTS, FACES = meshes.bumpy_sphere(2)
COUNT = POINTS.shape[-2]
FEW = 3


def expected_marks(times: np.ndarray) -> np.ndarray:
    """A ring more for each time but the first."""
    marked = np.zeros(COUNT, dtype=bool)
    for rings in range(int(times.max(initial=0)) - 1, -1, -1):
        marked |= times > rings
        if rings:
            marked[FACES[marked[FACES].any(axis=1)].ravel()] = True
    return marked


def numbers(device, *values):
    return wp.array(values, dtype=wp.int32, device=device)


def looked_at(places, vertices, device, any_held=0, has_area=1, large=0):
    far = np.zeros(COUNT, dtype=np.int32)
    far[vertices] = 1
    there = wp.array(far, dtype=wp.int32, device=device)
    given = (numbers(device, value) for value in (any_held, has_area, large))
    return there, places.note(there, *given)


@pytest.fixture
def places(device):
    return FarPlaces(wp.array(FACES.ravel(), dtype=wp.int32, device=device), COUNT, FEW, device)


def test_a_ring_more_is_held_for_each_time_that_a_vertex_was_far(places, device):
    times = np.zeros(COUNT, dtype=np.int32)
    for attempt, vertices in enumerate([[5, 40], [5], [5, 77], [40]]):
        far, look = looked_at(places, vertices, device)
        times[vertices] += 1
        marks = places.to_hold(far, look, 0, attempt).numpy() != 0
        now = np.where(far.numpy() != 0, times, 0)
        np.testing.assert_array_equal(marks, expected_marks(now))


@pytest.mark.parametrize("lack", [{"any_held": 1}, {"has_area": 0}, {"large": 9}], ids=lambda lack: next(iter(lack)))
def test_nothing_is_held_for_a_look_that_is_not_complete(lack, places, device):
    far, look = looked_at(places, [5], device, **lack)
    assert not places.to_hold(far, look, 8, 0).numpy().any()
    # It did not count as a time.
    far, look = looked_at(places, [5], device)
    assert (places.to_hold(far, look, 8, 1).numpy() != 0).sum() == 1


def test_many_vertices_are_held_only_where_that_is_asked_for(places, device):
    vertices = [5, 20, 40, 77]
    far, look = looked_at(places, vertices, device)
    assert not places.to_hold(far, look, 0, 0).numpy().any()
    assert (places.to_hold(far, look, 0, 0, many=True).numpy() != 0).sum() == len(vertices)


def test_host_reads_what_looks_found(places, device):
    looks = np.concatenate([looked_at(places, vertices, device, 1, 0, 7)[1].numpy() for vertices in ([], [1, 2])])
    assert FarLook.from_numbers(looks) == [FarLook(0, True, False, 7), FarLook(2, True, False, 7)]
