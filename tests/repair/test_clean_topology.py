"""Which topologies need no repair: those whose faces are one fan at each vertex, and no two on the same vertices."""

import numpy as np
import pytest
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.oracles.topology import NON_MANIFOLD, vertex_flags
from tests.support import meshes
from warpqem.kernels.clean_topology import count_non_manifold
from warpqem.repair.mended_topology import repair_topology

PATCH = meshes.grid(3, 2)[1]
CLEAN = {
    "closed": meshes.octahedron()[1],
    "open": PATCH,
    "apart": meshes.joined(meshes.octahedron(), meshes.tetrahedron(), meshes.grid(2, 2))[1],
}
OTHERS = {
    "two sides": meshes.back_to_back()[1],
    "two sides beside others": meshes.joined(meshes.octahedron(), meshes.back_to_back())[1],
    "sheet of two sides": np.concatenate([PATCH, PATCH[:, ::-1]]),
    "strip of two sides": np.concatenate([PATCH[:2], PATCH[:2, ::-1]]),
    "repeated": np.concatenate([PATCH, np.roll(PATCH[:1], 1, axis=1)]),
    "triangle twice": np.array([[0, 1, 2], [1, 2, 0]], dtype=np.int32),
    "turned": np.concatenate([PATCH[:1, ::-1], PATCH[1:]]),
    "pages": meshes.book()[1],
    "touching": meshes.bow_tie()[1],
    "one-sided": meshes.klein_bottle()[1],
}


def is_clean(faces, device) -> bool:
    return repair_topology(faces.astype(np.int32), int(faces.max()) + 1, device) is None


@pytest.mark.parametrize("name", CLEAN)
def test_clean_topology_is_left_alone(name, device):
    assert is_clean(CLEAN[name], device)


@pytest.mark.parametrize("name", OTHERS)
def test_other_topology_is_repaired(name, device):
    assert not is_clean(OTHERS[name], device)


@settings(max_examples=80)
@given(
    chosen=st.lists(st.tuples(st.integers(0, len(PATCH) - 1), st.booleans(), st.integers(0, 2)), min_size=1, max_size=6)
)
def test_what_is_clean_has_distinct_faces_in_fans(device, chosen):
    faces = np.array([np.roll(PATCH[f][:: -1 if back else 1], turn) for f, back, turn in chosen])
    distinct = len(np.unique(np.sort(faces, axis=1), axis=0)) == len(faces)
    in_fans = not (vertex_flags(faces, faces.max() + 1) & NON_MANIFOLD).any()
    assert is_clean(faces, device) == (distinct and in_fans)


@pytest.mark.parametrize("name", [*CLEAN, *OTHERS])
def test_non_manifold_vertices_are_counted(name, device):
    faces = (CLEAN | OTHERS)[name]
    flags = vertex_flags(faces, faces.max() + 1).astype(np.int32)
    count = wp.zeros(1, dtype=wp.int32, device=device)
    wp.launch(
        count_non_manifold, dim=len(flags), inputs=[wp.array(flags, device=device)], outputs=[count], device=device
    )
    assert count.numpy()[0] == np.count_nonzero(flags & NON_MANIFOLD)
