"""Which faces collapses and pruned components left."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support import meshes
from tests.support.mesh_state import corners_of
from warpqem.decimation.collapse_log import CollapseRecord
from warpqem.decimation.faces_left import faces_left
from warpqem.decimation.pruning import DropRecord

FACES = meshes.grid(4, 3)[1]
VERTEX_COUNT = 20


def expected_faces(root, dropped) -> np.ndarray:
    """Indices of the faces whose corners have three roots, none of them dropped."""
    return np.array([i for i, f in enumerate(FACES) if len(set(root[f])) == 3 and not dropped[f[0]]], dtype=np.int32)


def record(dropped) -> DropRecord:
    """One component with these vertices (V,) bool, or none."""
    if not dropped.any():
        return DropRecord.none(VERTEX_COUNT)
    ones = np.ones(1, dtype=np.int64)
    return DropRecord(np.where(dropped, 0, -1).astype(np.int32), ones, ones, np.ones(1, dtype=np.float32))


def collapse_log(faces_removed) -> CollapseRecord:
    """Collapses of which nothing is known but the faces that went with them."""
    count = len(faces_removed)
    vertices, numbers = np.zeros(count, dtype=np.int32), np.zeros(count, dtype=np.float32)
    return CollapseRecord(
        kept=vertices,
        removed=vertices,
        opposites=np.zeros((count, 2), dtype=np.int32),
        faces_removed=np.array(faces_removed, dtype=np.int32),
        cost=numbers,
        error=numbers,
        round_index=vertices,
        recent_error=numbers,
    )


@settings(max_examples=50)
@given(
    removed=st.lists(st.integers(1, 2), max_size=12),
    root=st.lists(st.integers(0, VERTEX_COUNT - 1), min_size=VERTEX_COUNT, max_size=VERTEX_COUNT),
    dropped=st.one_of(
        st.just([False] * VERTEX_COUNT), st.lists(st.booleans(), min_size=VERTEX_COUNT, max_size=VERTEX_COUNT)
    ),
)
def test_faces_left_have_three_roots_and_were_not_pruned_whatever_the_log_counts(device, removed, root, dropped):
    root, dropped = np.array(root, dtype=np.int32), np.array(dropped)
    faces, face_map = faces_left(FACES, corners_of(FACES, device), collapse_log(removed), root, record(dropped))
    np.testing.assert_array_equal(face_map, expected_faces(root, dropped))
    np.testing.assert_array_equal(faces, root[FACES[face_map]])


@pytest.mark.parametrize("left", [0, len(FACES)])
def test_all_or_none_may_be_left(left, device):
    root = np.arange(VERTEX_COUNT, dtype=np.int32) if left else np.zeros(VERTEX_COUNT, dtype=np.int32)
    log = collapse_log([] if left else [len(FACES)])
    faces, face_map = faces_left(FACES, corners_of(FACES, device), log, root, DropRecord.none(VERTEX_COUNT))
    assert faces.shape == (left, 3)
    assert face_map.tolist() == list(range(left))
