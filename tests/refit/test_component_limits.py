"""Components that a refit takes no further from the input: against the whole of it and against their own part."""

import numpy as np
import pytest
import trimesh

import warpqem
from tests.support import meshes
from warpqem.kernels.surface_limits import mark_far_samples
from warpqem.measure import compare
from warpqem.pipeline import prepare
from warpqem.refit import fit_surface
from warpqem.refit.component_limits import ComponentLimits
from warpqem.refit.matching import OUTPUT_SAMPLES


def bent_tubes(radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Six tubes of few faces around, each bent in another way: parts to which a fit of the whole can do harm."""
    tubes = []
    for k in range(6):
        tube = trimesh.creation.cylinder(radius, 1.0, sections=8)
        vertices, faces = trimesh.remesh.subdivide_to_size(tube.vertices, tube.faces, 0.2)
        bent = np.array(vertices)
        bent[:, 0] += 0.3 * np.sin(3 * bent[:, 2] + k) + k
        tubes.append(trimesh.Trimesh(bent, faces, process=False))
    whole = trimesh.util.concatenate(tubes)
    return np.array(whole.vertices, dtype=np.float32)[None], np.array(whole.faces, dtype=np.int32)


@pytest.mark.parametrize("quality", ["fast", "best"])
@pytest.mark.parametrize("radius", [0.02, 0.1])
@pytest.mark.parametrize("ratio", [0.03, 0.1, 0.3])
def test_refit_never_takes_a_part_much_further_from_the_input(quality, radius, ratio, device, monkeypatch):
    # Of the same faces: an exchange takes them from one part to another.
    monkeypatch.setattr(prepare, "SPARE", 0.0)
    check_parts(*bent_tubes(radius), 6, ratio, quality, device)


@pytest.mark.parametrize("seed", [4, 5, 7])
def test_where_walks_end_elsewhere_than_at_the_nearest_point_parts_come_no_further_either(seed, device, monkeypatch):
    # Moved by so little, collapses of equal costs come in other orders.
    monkeypatch.setattr(prepare, "SPARE", 0.0)
    points, faces = bent_tubes(0.1)
    points = (points + 1e-6 * np.random.default_rng(seed).normal(size=points.shape)).astype(np.float32)
    check_parts(points, faces, 6, 0.1, "fast", device)


@pytest.mark.parametrize("ratio", [0.05, 0.1])
@pytest.mark.parametrize("seed", [0, 3])
def test_parts_that_lie_in_each_other_come_no_further_from_where_they_were(ratio, seed, device, monkeypatch):
    # What is far from its own part may be near to another one.
    monkeypatch.setattr(prepare, "SPARE", 0.0)
    ball = trimesh.creation.icosphere(3)
    points = np.concatenate(
        [(1.0 + 0.05 * k) * ball.vertices + 0.1 * np.sin(3 * ball.vertices[:, [1, 2, 0]] + k) for k in range(5)]
    )
    points += 1e-6 * np.random.default_rng(seed).normal(size=points.shape)
    faces = np.concatenate([ball.faces + k * len(ball.vertices) for k in range(5)])
    check_parts(points[None].astype(np.float32), faces.astype(np.int32), 5, ratio, "best", device)


def check_parts(points, faces, part_count, ratio, quality, device):
    """Faces are those of one part after another, as many of each."""
    placed, refitted = (
        warpqem.simplify(points, faces, ratio=ratio, quality=quality, refit=refit, keep_components=True, device=device)
        for refit in (False, True)
    )
    for own in np.split(np.arange(len(faces)), part_count):
        before, after = (
            compare(points, faces[own], r.points, r.faces[np.isin(r.face_map, own)], device=device).hausdorff
            for r in (placed, refitted)
        )
        # Distances are looked at in some places of each face.
        assert after < 1.05 * before + 0.01


def test_a_component_may_come_as_far_from_the_input_as_its_samples_were(device, monkeypatch):
    # Of one frame, so that pairs show all distances: walks end there or further away.
    points, faces = bent_tubes(0.1)
    found, improve = [], fit_surface._Refit.improve

    def improved(self, reach, search=False, take_limits=False):
        improve(self, reach, search, take_limits)
        if take_limits:
            samples = self._matching._samples
            near, own = samples.input_pairs.near.numpy(), np.repeat(np.arange(len(self._faces)), len(OUTPUT_SAMPLES))
            face = np.concatenate([near, own, samples.vertex_face.numpy()])
            parts = samples.input_pairs.squared, samples.output_pairs.squared, samples.vertex_squared[0]
            squared = np.concatenate([part.numpy() for part in parts])
            largest = np.zeros(6, dtype=np.float32)
            np.maximum.at(largest, self._limits.sampled.component.numpy()[face[face >= 0]], squared[face >= 0])
            found.append((largest, self._limits.sampled.squared.numpy()))

    monkeypatch.setattr(fit_surface._Refit, "improve", improved)
    warpqem.simplify(points, faces, ratio=0.1, refit=True, keep_components=True, device=device)
    assert found
    for largest, limits in found:
        assert (limits > 0.2 * largest).all()
        assert (limits <= largest).all()
        assert (limits == largest).any()


def test_each_attempt_holds_one_more_ring_around_a_place_that_comes_further_away(device, monkeypatch):
    # The face stays too far: all attempts are made, and at last its component stays as placed.
    held, stiffen = [], fit_surface._Refit._stiffen
    monkeypatch.setattr(prepare, "SPARE", 0.0)

    def mark_far(self, moved):
        far = np.zeros(len(self.sampled.far), dtype=np.int32)
        far[self._faces[7]] = 1
        self.sampled.far.assign(far)
        return self.sampled.far

    monkeypatch.setattr(ComponentLimits, "mark_far", mark_far)
    monkeypatch.setattr(
        fit_surface._Refit, "_stiffen", lambda self, marks: (held.append(marks.numpy() != 0), stiffen(self, marks))[1]
    )
    points, faces = meshes.swaying_sphere(3, 4)
    result = warpqem.simplify(points, faces, ratio=0.3, device=device)
    ring = np.zeros(result.points.shape[1], dtype=bool)
    ring[result.faces[7]] = True
    for _ in range(fit_surface.ATTEMPTS):
        assert any(np.array_equal(ring, marked) for marked in held)
        ring[result.faces[ring[result.faces].any(axis=1)].ravel()] = True
    placed = warpqem.simplify(points, faces, ratio=0.3, refit=False, device=device)
    np.testing.assert_array_equal(result.faces, placed.faces)


@pytest.mark.parametrize("shift", [0.0, 0.05])
def test_places_that_moved_too_far_are_those_that_a_look_at_all_of_them_finds(shift, device, monkeypatch):
    # Distances are updated by what moves, and measured anew only where that may be too far.
    marks, looks = [], fit_surface._Refit._look

    def look(self):
        moved = self._correction.numpy()
        moved[::7] += shift
        self._correction.assign(moved)
        found = looks(self)
        limits, updated = self._limits.sampled, self._limits.sampled.far.numpy().copy()
        limits.far.zero_()
        self._matching.find(1.0)
        self._matching._measure_vertices(0)
        self._matching._note(mark_far_samples, 0, self._matching._show(0), limits)
        marks.append((updated, limits.far.numpy().copy()))
        # Nothing is far, nor is there anything to fit.
        found.zero_()
        return found

    monkeypatch.setattr(fit_surface._Refit, "_look", look)
    monkeypatch.setattr(fit_surface, "ATTEMPTS_AHEAD", 0)
    monkeypatch.setattr(prepare, "SPARE", 0.0)
    warpqem.simplify(*bent_tubes(0.1), ratio=0.1, refit=True, keep_components=True, device=device)
    ((updated, full),) = marks
    np.testing.assert_array_equal(updated, full)
    assert 0 < full.sum() < len(full)
