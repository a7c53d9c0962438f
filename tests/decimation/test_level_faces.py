"""Faces of one level after another are those that all faces looked at give."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support import meshes
from warpqem.decimation.level_faces import LevelFaces
from warpqem.decimation.pruning import DropRecord
from warpqem.measure.face_lists import FacesAround

FACES = np.ascontiguousarray(meshes.grid(4, 3)[1], dtype=np.int32)
VERTEX_COUNT = 20
NUMBERS = st.lists(st.integers(0, VERTEX_COUNT - 1), min_size=VERTEX_COUNT, max_size=VERTEX_COUNT)
DROPPED = st.lists(st.booleans(), min_size=VERTEX_COUNT, max_size=VERTEX_COUNT)
LEVELS = st.lists(st.tuples(NUMBERS, DROPPED), min_size=2, max_size=4)


def roots_of(numbers) -> np.ndarray:
    """What each vertex collapsed into: itself, or what one before it did."""
    root = np.minimum(np.array(numbers, dtype=np.int32), np.arange(VERTEX_COUNT, dtype=np.int32))
    while (root[root] != root).any():
        root = root[root]
    return root


class Ordered:
    """What the first level is near to."""

    def __init__(self, numbers, dropped):
        self.root, self.drops = roots_of(numbers), record(dropped)
        self.face_map = expected_faces(self.root, dropped)
        self.faces = self.root[FACES[self.face_map]]


def record(dropped) -> DropRecord:
    if not any(dropped):
        return DropRecord.none(VERTEX_COUNT)
    ones = np.ones(1, dtype=np.int64)
    return DropRecord(np.where(dropped, 0, -1).astype(np.int32), ones, ones, np.ones(1, dtype=np.float32))


def expected_faces(root, dropped) -> np.ndarray:
    """Indices of the faces whose corners have three roots, none of them dropped."""
    return np.array([i for i, f in enumerate(FACES) if len(set(root[f])) == 3 and not dropped[f[0]]], dtype=np.int32)


@settings(max_examples=100)
@given(LEVELS)
def test_faces_of_levels_are_those_with_three_roots_that_were_not_pruned(levels):
    around = FacesAround(FACES, VERTEX_COUNT)
    found = LevelFaces(FACES, around.repeated, Ordered(*levels[0]))
    before = roots_of(levels[0][0])
    for numbers, dropped in levels[1:]:
        roots = roots_of(numbers)
        changed = np.flatnonzero(roots != before)
        faces, face_map = found.at(roots, changed, before[changed], record(dropped))
        before = roots
        np.testing.assert_array_equal(face_map, expected_faces(roots, dropped))
        np.testing.assert_array_equal(faces, roots[FACES[face_map]])
        np.testing.assert_array_equal(np.flatnonzero(found.is_kept), np.unique(faces))
        assert faces.dtype == face_map.dtype == np.int32
