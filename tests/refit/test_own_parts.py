"""Components that are held against their own parts of the input, at more places where they have few faces."""

import numpy as np
import pytest
import trimesh
import warp as wp

import warpqem
from warpqem.measure import compare
from warpqem.refit.own_parts import OwnParts


def small_washer() -> tuple[np.ndarray, np.ndarray]:
    """A part of few faces, whose edges bridge its hole."""
    washer = trimesh.creation.annulus(0.5, 1.0, 0.3, sections=16)
    return np.array(washer.vertices, dtype=np.float32)[None], np.array(washer.faces, dtype=np.int32)


class Part:
    """A small part as placed, and what it is when its vertices move by random ways."""

    def __init__(self, device: str) -> None:
        self.points, self.corners = small_washer()
        self.placed = warpqem.simplify(self.points, self.corners, ratio=0.3, refit=False, device=device)
        self.distance = self.distance_of(self.placed.points, device)

    def distance_of(self, points: np.ndarray, device: str) -> float:
        """The largest distance from the input in % of its diagonal, in many places."""
        return compare(self.points, self.corners, points, self.placed.faces, device=device).hausdorff

    def moved(self, seed: int) -> np.ndarray:
        """(K, C, 3), further or less far."""
        rng, placed = np.random.default_rng(seed), self.placed.points
        return (placed + rng.uniform(0.01, 0.1) * rng.normal(size=placed.shape)).astype(np.float32)

    def own_parts(self, device: str, frame_scale: float = 1.0) -> tuple[OwnParts, wp.array]:
        """What holds it, and its limit."""
        limits = wp.full(1, 1e-12, dtype=wp.float32, device=device)
        given = self.points, self.placed.points
        source, placed = (wp.array(points, dtype=wp.vec3, device=device) for points in given)
        component = np.zeros(placed.shape[1], dtype=np.int32)
        scale = wp.full(1, frame_scale, dtype=wp.float32, device=device)
        vertex_map, faces = self.placed.vertex_map, self.placed.faces
        return OwnParts(
            source, self.corners, np.unique(self.corners), vertex_map, placed, faces, component, limits, scale, device
        ), limits

    def marks(self, own: OwnParts, points: np.ndarray, device: str) -> np.ndarray:
        """(C,) int32 of vertices at places too far."""
        marks = wp.zeros(points.shape[1], dtype=wp.int32, device=device)
        own.mark_far(wp.array(points, dtype=wp.vec3, device=device), marks)
        return marks.numpy()


@pytest.fixture(scope="module")
def part(device):
    return Part(device)


def test_a_small_part_that_comes_further_away_inside_of_faces_is_seen(part, device):
    own, _ = part.own_parts(device)
    far = 0
    for seed in range(40):
        moved = part.moved(seed)
        if part.distance_of(moved, device) > 1.05 * part.distance:
            far += 1
            assert part.marks(own, moved, device).any(), seed
    assert 5 < far < 35


def test_a_part_as_placed_is_nowhere_further_away(part, device):
    own, _ = part.own_parts(device)
    assert not part.marks(own, part.placed.points, device).any()


def test_looks_one_after_another_mark_what_each_alone_marks(part, device):
    own, _ = part.own_parts(device)
    counts = []
    for seed in (3, 3, 0, 1, 1, 2):
        found, alone = (part.marks(one, part.moved(seed), device) for one in (own, part.own_parts(device)[0]))
        np.testing.assert_array_equal(found, alone)
        counts.append(found.sum())
    assert min(counts) < max(counts)


def test_distances_are_in_the_unit_of_their_frame(part, device):
    (_, limits), (_, doubled) = part.own_parts(device), part.own_parts(device, 2.0)
    np.testing.assert_allclose(doubled.numpy(), 4.0 * limits.numpy(), rtol=1e-5)
