"""The bound on the distance of two meshes: proved for every point, both ways, in every frame."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.meshes import bumpy_sphere, grid, icosphere
from warpqem.arguments.distance_limit import DistanceLimit
from warpqem.frames.stream import NoFrames
from warpqem.measure import compare
from warpqem.measure.bound import DistanceBound
from warpqem.measure.bound_side import BoundSide
from warpqem.measure.closest_points import ClosestPointSearch
from warpqem.measure.piece_proof import PieceArrays, PieceProof
from warpqem.measure.unit_frames import UnitBlock, UnitFrames
from warpqem.mesh.mesh_input import read_mesh
from warpqem.pipeline.bound_sink import BoundSink, ExceededError


def excess(reference, test, limit, device):
    bound = DistanceBound(reference[1], test[1], limit, device)
    return bound.excess(0, reference[0].astype(np.float64), test[0].astype(np.float64))


def sampled_distance(reference, test):
    """The largest distance either way, of some thousand samples and all vertices."""
    found = 0.0
    for own, other in ((reference, test), (test, reference)):
        surface = trimesh.Trimesh(*own, process=False)
        samples = np.concatenate([surface.vertices, trimesh.sample.sample_surface(surface, 4000, seed=1)[0]])
        search = ClosestPointSearch(other[1], "cpu", "other")
        found = max(found, search.closest(other[0].astype(np.float64), samples, 0).distance.max())
    return found


def test_of_no_pieces_none_is_unproved(device):
    points, faces = icosphere(1)
    frames = UnitFrames(np.zeros((9, 3)), np.ones(9))
    blocks = [UnitBlock(np.stack([points] * 9), frames, device) for _ in range(2)]
    sides = [BoundSide(faces, device, None) for _ in range(2)]
    proof = PieceProof(*sides, *blocks, 0.1, device)
    rows, bits = proof.unproved(PieceArrays.none(), np.zeros((0, 2), dtype=np.int32))
    assert len(rows) == len(bits) == 0


def test_a_mesh_is_within_any_limit_of_itself(device):
    mesh = bumpy_sphere(2)
    assert excess(mesh, mesh, 1e-9, device) is None


@pytest.mark.parametrize("factor", [0.98, 1.02])
def test_parallel_sheets_are_as_far_apart_as_they_are(factor, device):
    points, faces = grid(5, 4)
    lifted = points + np.float32([0, 0, 0.25])
    found = excess((points, faces), (lifted, faces), 0.25 * factor, device)
    assert (found is None) == (factor > 1)


@pytest.mark.parametrize("factor", [0.98, 1.02])
def test_the_largest_distance_may_lie_inside_a_face(factor, device):
    # The tip of a pyramid above the middle of a face, which has no vertex near it.
    flat = np.float32([[0, 0, 0], [3, 0, 0], [0, 3, 0]]), np.int32([[0, 1, 2]])
    tip = np.float32([[0, 0, 0], [3, 0, 0], [0, 3, 0], [1, 1, 0.5]]), np.int32([[0, 1, 3], [1, 2, 3], [2, 0, 3]])
    for reference, test in ((flat, tip), (tip, flat)):
        assert (excess(reference, test, 0.5 * factor, device) is None) == (factor > 1)


def test_a_hole_between_vertices_that_lie_on_the_other_mesh_is_found(device):
    points, faces = grid(8, 8)
    # All vertices are kept; the middle cell has no faces.
    middle = np.linalg.norm(points[faces].mean(axis=1)[:, :2] - points[:, :2].mean(axis=0), axis=1)
    holed = faces[middle > np.sort(middle)[1]]
    found = excess((points, faces), (points, holed), 0.02, device)
    assert set(found.reference_faces) == set(np.flatnonzero(middle <= np.sort(middle)[1]))
    assert len(found.test_faces) == 0


def test_the_frame_and_the_faces_beyond_are_named(device):
    points, faces = icosphere(2)
    bound = DistanceBound(faces, faces, 0.05, device)
    moved = points.astype(np.float64).copy()
    moved[7] *= 1.2
    assert bound.excess(0, points.astype(np.float64), points.astype(np.float64)) is None
    found = bound.excess(1, points.astype(np.float64), moved)
    assert found.frame == 1
    assert set(found.test_faces) == set(np.flatnonzero((faces == 7).any(axis=1)))


def test_points_without_faces_do_not_count(device):
    points, faces = icosphere(1)
    more = np.concatenate([points, np.float32([[9, 9, 9]])])
    assert excess((more, faces), (points, faces), 1e-6, device) is None


@settings(deadline=None)
@given(seed=st.integers(0, 2**31), noise=st.floats(0.005, 0.2), factor=st.floats(0.3, 1.6))
def test_what_is_proved_no_sample_contradicts(seed, noise, factor):
    rng = np.random.default_rng(seed)
    points, faces = icosphere(2)
    reference = points, faces
    rough = icosphere(1)
    test = rough[0] + noise * rng.standard_normal(rough[0].shape).astype(np.float32), rough[1]
    largest = sampled_distance(reference, test)
    found = excess(reference, test, largest * factor, "cpu")
    if factor < 0.999:
        assert found is not None
    elif factor > 1.2:  # samples miss some of the distance
        assert found is None


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**31), factor=st.floats(0.3, 1.6), frames=st.integers(2, 20))
def test_what_is_proved_in_many_frames_no_sample_of_any_contradicts(seed, factor, frames):
    rng = np.random.default_rng(seed)
    (points, faces), (rough, rough_faces) = icosphere(2), icosphere(1)
    # What is near to a face differs from frame to frame.
    reference = points + 0.03 * rng.standard_normal((frames, *points.shape))
    test = rough + 0.1 * rng.standard_normal((frames, *rough.shape))
    largest = max(
        sampled_distance((own, faces), (other, rough_faces)) for own, other in zip(reference, test, strict=True)
    )
    found = DistanceBound(faces, rough_faces, largest * factor, "cpu").excess(0, reference, test)
    if factor < 0.999:
        assert found is not None
        frame = sampled_distance((reference[found.frame], faces), (test[found.frame], rough_faces))
        assert frame > 0.5 * largest * factor
    elif factor > 1.2:  # samples miss some of the distance
        assert found is None


def test_what_is_proved_by_a_face_that_then_moves_is_looked_at_again(device):
    triangle = np.float64([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    far = np.float64([10, 0, 0])
    # Two faces; the reference lies on the first one, where it is cut, and in the last frame on the second one.
    reference = np.stack([triangle, triangle, triangle + far])
    test = np.repeat(np.concatenate([triangle, triangle + far])[None], 3, axis=0)
    bound = DistanceBound(np.int32([[0, 1, 2]]), np.int32([[0, 1, 2], [3, 4, 5]]), 0.1, device)
    assert len(bound.excess(0, reference, test).reference_faces) == 0
    unknown = np.full(2, -1, dtype=np.int32)
    after = bound.succeeded_by(
        np.int32([[0, 1, 2], [3, 4, 5]]), np.arange(2), np.array([True, False]), unknown, unknown[:1]
    )
    test[:, 3:, 2] = 5.0
    found = after.excess(0, reference, test)
    assert list(found.reference_faces) == [0]


def test_nothing_counts_as_proved_in_frames_that_were_not_seen(device):
    points, faces = icosphere(2)
    bound = DistanceBound(faces, faces, 0.05, device)
    still = points.astype(np.float64)
    assert bound.excess(0, still, still) is None
    bound.look_again()
    same = np.ones(len(faces), dtype=bool)
    after = bound.succeeded_by(faces, np.arange(len(faces)), same, np.arange(len(faces)), np.arange(len(faces)))
    moved = still.copy()
    moved[7] *= 1.2
    assert set(after.excess(0, still, moved).test_faces) == set(np.flatnonzero((faces == 7).any(axis=1)))


@pytest.mark.parametrize("seed", range(6))
def test_no_limit_below_a_measured_distance_is_said_to_hold(seed, device):
    # What is measured is up to a thousandth above the distance of a point; a limit is not to be within that.
    rng = np.random.default_rng(seed)
    points, faces = bumpy_sphere(2) if seed % 2 else icosphere(2)
    points = (points * rng.uniform(0.5, 2, 3)).astype(np.float32)[None]
    other, other_faces = icosphere(1)
    other = (other * np.ptp(points[0], axis=0) / np.ptp(other, axis=0) + rng.normal(0, 0.02, other.shape))[None]
    other = other.astype(np.float32)
    measured = compare(points, faces, other, other_faces, samples=1000, device=device).hausdorff

    def holds(part):
        bound = BoundSink(NoFrames(), read_mesh(points, faces), DistanceLimit(part * measured / 100), 1.0, device)
        bound.begin(1, other.shape[1], other_faces)
        try:
            bound.write(slice(0, 1), other)
        except ExceededError:
            return False
        return True

    assert not any(holds(part) for part in (0.9999, 0.9996, 0.9993))
    assert holds(1.003)
