"""``max_error``: the surface stays within a distance of the input, proved in every frame, with the fewest faces."""

import numpy as np
import pytest

import warpqem
from tests.support import meshes, symmetry
from warpqem.arguments.distance_limit import DistanceLimit
from warpqem.arguments.figures import rounded_up
from warpqem.measure import compare
from warpqem.mesh.mesh_input import read_mesh
from warpqem.pipeline.bound_sink import BoundSink

BAR = meshes.bending_bar(20, 40, frames=6)
WAYS = {
    "default": {},
    "refit": {"refit": True},
    "best": {"refit": True, "memoryless": True},
    "steady": {"coherence": 1.0},
    "endpoint": {"placement": "endpoint"},
    "dod": {"metric": "dod"},
}


def largest_distance(mesh, result, device):
    points, faces = mesh
    return compare(points, faces, result.points, result.faces, samples=4000, device=device).hausdorff


@pytest.mark.parametrize("options", WAYS.values(), ids=WAYS)
def test_no_sample_is_beyond_max_error_in_any_frame(options, device):
    result = warpqem.simplify(*BAR, max_error=0.6, device=device, **options)
    assert result.stopped == "max_error"
    assert len(result.faces) < len(BAR[1])
    # What is measured is up to a thousandth above the distance of a point.
    assert largest_distance(BAR, result, device) <= 0.6 * 1.001


def test_a_mesh_with_much_fewer_faces_does_not_hold(device):
    result = warpqem.simplify(*BAR, max_error=0.6, device=device)
    fewer = warpqem.simplify(*BAR, target_faces=round(0.8 * len(result.faces)), device=device)
    assert largest_distance(BAR, fewer, device) > 0.6


def test_the_count_stops_first_where_it_is_the_larger(device):
    result = warpqem.simplify(*BAR, max_error=5.0, ratio=0.5, device=device)
    assert result.stopped == "target"
    assert len(result.faces) == len(BAR[1]) // 2


def test_a_flat_sheet_keeps_its_corners_exactly(device):
    points, faces = meshes.grid(10, 10)
    for coherence in (0.5, 1.0):
        result = warpqem.simplify(points, faces, max_error=0.001, coherence=coherence, device=device)
        assert len(result.faces) == 2
        assert largest_distance((points[None], faces), result, device) <= 0.001


def test_components_are_not_pruned_beyond_the_limit(device):
    points, faces = meshes.joined(meshes.bumpy_sphere(2), meshes.tetrahedron(), spacing=3.0)
    result = warpqem.simplify(points, faces, max_error=1.0, device=device)
    assert result.components_removed == 0
    assert largest_distance((points[None], faces), result, device) <= 1.0


class Kept:
    """Takes the frames of a result."""

    def begin(self, frame_count, vertex_count, faces):
        self.faces, self.blocks = faces, []

    def write(self, frames, points):
        self.blocks.append(points.copy())


# Levels that are tried after the one that holds must leave no trace in it: which are tried depends on size and limit.
@pytest.mark.parametrize("options", [{}, {"refit": True}, {"memoryless": True}], ids=["default", "refit", "memoryless"])
@pytest.mark.parametrize("coherence", [0.5, 1.0])
@pytest.mark.parametrize("limit", [0.5, 1.0, 2.0])
def test_a_sink_takes_the_frames_that_were_proved(limit, coherence, options, device):
    for size in (14, 17):
        points, faces = meshes.waving_grid(size, frames=4)
        asked = {"max_error": limit, "coherence": coherence, "device": device, **options}
        kept = Kept()
        result = warpqem.simplify(points, faces, sink=kept, **asked)
        delivered = np.concatenate(kept.blocks)
        assert np.array_equal(delivered, warpqem.simplify(points, faces, **asked).points)
        assert np.array_equal(kept.faces, result.faces)
        # Raises where one point is beyond the limit.
        bound = BoundSink(Kept(), read_mesh(points, faces), DistanceLimit(limit / 100), 1.0, device)
        bound.begin(len(points), delivered.shape[1], kept.faces)
        bound.write(slice(0, len(points)), delivered)


def test_blocks_of_frames_make_no_difference(device, monkeypatch):
    whole = warpqem.simplify(*BAR, max_error=0.6, device=device)
    monkeypatch.setattr("warpqem.pipeline.memory_plan.BLOCK_BYTES", 1)
    parts = warpqem.simplify(*BAR, max_error=0.6, device=device)
    assert np.array_equal(parts.points, whole.points)


def test_progress_only_grows_and_ends(device):
    seen = []
    warpqem.simplify(*BAR, max_error=0.6, device=device, progress=lambda done, stage: seen.append(done))
    assert seen == sorted(seen)
    assert seen[-1] <= 1.0


def test_a_limit_below_single_precision_is_refused(device):
    far = BAR[0].astype(np.float64) + 1e5
    with pytest.raises(warpqem.errors.OptionError, match="single precision does not place the input"):
        warpqem.simplify(far, BAR[1], max_error=1e-5, device=device)


def test_a_limit_below_single_precision_is_refused_where_nothing_collapses(device):
    points, faces = meshes.icosphere(2)
    with pytest.raises(warpqem.errors.OptionError, match="single precision does not place the input"):
        warpqem.simplify(points.astype(np.float64) + 0.1, faces, max_error=1e-9, device=device)


@pytest.mark.parametrize("count", [{}, {"ratio": 0.5}, {"target_faces": 10}], ids=["alone", "ratio", "target_faces"])
def test_a_limit_that_single_precision_does_not_resolve_is_refused_where_nothing_goes(count, device):
    with pytest.raises(warpqem.errors.OptionError, match="max_error 1e-09 %: nothing can be removed"):
        warpqem.simplify(*meshes.icosphere(2), max_error=1e-9, device=device, **count)


def test_such_a_limit_is_refused_of_a_symmetric_mesh_as_well(device):
    mirror = warpqem.find_mirror(symmetry.POINTS[0], symmetry.FACES, "x")
    with pytest.raises(warpqem.errors.OptionError, match="max_error 1e-09 %: nothing can be removed"):
        warpqem.simplify_symmetric(symmetry.POINTS, symmetry.FACES, mirror, max_error=1e-9, device=device)


def test_what_costs_nothing_goes_within_any_limit(device):
    # All vertices within go. Of the border rounding decides what goes, which is another on every kind of device.
    points, faces = meshes.grid(8, 8)
    result = warpqem.simplify(points, faces, max_error=1e-9, quality="fast", lock_borders=True, device=device)
    assert len(result.faces) == 4 * 8 - 2


def test_what_rounding_takes_beyond_a_limit_stays(device):
    result = warpqem.simplify(*meshes.grid(8, 8), max_error=1e-9, quality="fast", device=device)
    assert result.stopped == "max_error"
    assert 30 < len(result.faces) < 128


def test_the_unit_of_the_scene_makes_no_difference_where_a_frame_has_no_extent(device):
    points, faces = meshes.waving_grid(10, frames=3)
    points[1] = points[1, 40] + np.float32(3.3)
    counts = {
        len(warpqem.simplify(points * np.float32(s), faces, max_error=1.0, device=device).faces) for s in (1, 2**20)
    }
    assert len(counts) == 1


def test_the_plan_is_that_of_the_work(device):
    result = warpqem.simplify(*BAR, max_error=0.6, device=device)
    assert warpqem.plan(*BAR, max_error=0.6, device=device).order_bytes == result.plan.order_bytes


def test_max_distance_is_the_same_limit_as_a_length(device):
    points, faces = BAR
    diagonal = float(np.linalg.norm(np.ptp(points, axis=1), axis=1).max())
    by_length = warpqem.simplify(points, faces, max_distance=0.006 * diagonal, device=device)
    assert len(by_length.faces) < len(faces)
    apart = compare(points, faces, by_length.points, by_length.faces, samples=4000, device=device)
    assert apart.hausdorff <= 100 * 0.006 * diagonal / float(np.linalg.norm(np.ptp(points, axis=1), axis=1).min())


def test_every_frame_is_bounded_where_poses_come_later(device):
    # The first frames are still, so that what few of them prove does not hold for the rest.
    points, faces = meshes.waving_grid(14, frames=40)
    points[:24] = points[0]
    result = warpqem.simplify(points, faces, max_error=0.3, device=device)
    assert largest_distance((points, faces), result, device) <= 0.3


def test_the_plan_counts_the_proof_and_measuring_on_the_way_to_a_sink(device):
    def place_bytes(measure=False, sink=None, **goal):
        return warpqem.plan(*BAR, sink=sink, measure=measure, device=device, **goal).place_bytes

    nearly_all = {"target_faces": len(BAR[1]) - 1}
    assert place_bytes(max_error=0.6, **nearly_all) > place_bytes(**nearly_all)
    assert place_bytes(sink=Kept(), measure=True, **nearly_all) > place_bytes(sink=Kept(), **nearly_all)
    assert place_bytes(measure=True, **nearly_all) == place_bytes(**nearly_all)


def test_a_distance_beyond_the_size_stops_where_the_size_does(device):
    points, faces = meshes.icosphere(3)
    result = warpqem.simplify(points, faces, max_distance=100.0, max_size_error=5.0, device=device)
    assert result.stopped == "max_size_error"
    by_count = warpqem.simplify(points, faces, target_faces=1, max_size_error=5.0, device=device)
    assert len(result.faces) == len(by_count.faces)


@pytest.mark.parametrize("limit", [0.2, 0.4, 1.0])
@pytest.mark.parametrize("options", [{}, {"quality": "best"}])
def test_no_measured_distance_is_above_the_limit(limit, options, device):
    # Measured distances are up to a thousandth above those of points.
    for points, faces in (BAR, meshes.waving_grid(14, frames=4), meshes.swaying_sphere(3, 4)):
        result = warpqem.simplify(points, faces, max_error=limit, device=device, **options)
        assert 0.0 < result.measured.hausdorff <= limit
        apart = compare(points, faces, result.points, result.faces, samples=2000, device=device)
        assert apart.hausdorff <= limit
        assert apart.per_frame.hausdorff.max() <= limit
        assert float(rounded_up(result.measured.hausdorff)) <= limit
