"""Properties of the result on random meshes in random motion."""

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import warpqem
from tests.support import meshes
from warpqem.errors import UnreachableTargetError
from warpqem.measure import topology

BASES = [
    meshes.icosphere(2),
    meshes.torus(14, 7),
    meshes.grid(9, 11),
    meshes.tube(8, 14),
    meshes.joined(meshes.icosphere(1), meshes.grid(5, 5), meshes.torus(9, 5), spacing=1.5),
]
few = settings(
    max_examples=25, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@st.composite
def moving_meshes(draw):
    """A base mesh, some of its faces left out (which may open holes), bumps, and a smooth motion of all that."""
    points, faces = BASES[draw(st.integers(0, len(BASES) - 1))]
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    if draw(st.booleans()):
        faces = _with_hole(faces, int(random.integers(len(points))))
    points = points + random.normal(size=points.shape) * 0.01 * draw(st.integers(0, 3))
    frames = draw(st.integers(1, 5))
    wave, phase = random.normal(size=(3, 3)) * 3, random.uniform(0, 6, 3)
    moved = [points + 0.08 * np.sin(points @ wave + phase + 0.7 * t) + 0.2 * t for t in range(frames)]
    return (np.asarray(moved) * 10.0 ** draw(st.integers(-3, 3))).astype(np.float32), faces


def _with_hole(faces, vertex):
    """Without the faces at one vertex, unless that makes the mesh non-manifold."""
    rest = faces[~(faces == vertex).any(axis=1)]
    after = topology(rest)
    return faces if after.non_manifold_vertices or after.components > topology(faces).components else rest


def simplified(mesh, device, **options):
    try:
        return warpqem.simplify(*mesh, device=device, **options)
    except UnreachableTargetError as error:
        return error.result


@few
@given(mesh=moving_meshes(), ratio=st.floats(0.05, 1), metric=st.sampled_from(["qem", "dsd", "dod", "aqem"]))
def test_result_stays_manifold_with_the_same_euler_number(mesh, ratio, metric, device):
    before = topology(mesh[1])
    result = simplified(mesh, device, ratio=ratio, metric=metric, keep_components=True)
    after = topology(result.faces)
    assert after.non_manifold_edges == after.non_manifold_vertices == after.repeated_faces == 0
    assert (after.euler_number, after.components) == (before.euler_number, before.components)


@few
@given(mesh=moving_meshes(), ratio=st.floats(0.3, 1))
def test_target_is_met_exactly_or_by_one_fewer(mesh, ratio, device):
    target = round(ratio * len(mesh[1]))
    assert target - 1 <= len(warpqem.simplify(*mesh, ratio=ratio, device=device).faces) <= target


@few
@given(mesh=moving_meshes(), ratio=st.floats(0.05, 1), coherence=st.floats(0, 1))
def test_indices_are_in_range_and_points_finite(mesh, ratio, coherence, device):
    result = simplified(mesh, device, ratio=ratio, coherence=coherence)
    np.testing.assert_array_equal(np.unique(result.faces), np.arange(result.points.shape[1]))
    assert result.vertex_map.min() >= -1
    assert result.vertex_map.max() < result.points.shape[1]
    assert np.isfinite(result.points).all()


@few
@given(mesh=moving_meshes(), ratio=st.floats(0.2, 1))
def test_result_stays_inside_the_inputs_box(mesh, ratio, device):
    points, faces = mesh
    result = simplified(mesh, device, ratio=ratio)
    used = points[:, np.unique(faces)]
    margin = 0.1 * np.linalg.norm(np.ptp(used, axis=1), axis=1).max()
    assert (result.points >= used.min(axis=1, keepdims=True) - margin).all()
    assert (result.points <= used.max(axis=1, keepdims=True) + margin).all()
