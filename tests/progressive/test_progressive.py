"""Progressive meshes: any level, from one run."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import warpqem
from tests.oracles.topology import collapsed
from tests.support import meshes
from warpqem.errors import DegenerateMeshError, OptionError
from warpqem.measure import compare, topology
from warpqem.progressive import load, save

TORUS = meshes.torus(18, 9)
MESHES = {
    "closed": meshes.swaying_sphere(3, 4),
    "open": meshes.waving_grid(14, 5),
    "torus": (meshes.bend(TORUS[0], 3), TORUS[1]),
}
SPHERE = MESHES["closed"]


@pytest.fixture(scope="module", params=list(MESHES))
def built(request, device):
    points, faces = MESHES[request.param]
    return points, faces, warpqem.build_progressive(points, faces, quality="fast", device=device)


@pytest.fixture(scope="module")
def sphere(device):
    return warpqem.build_progressive(*SPHERE, quality="fast", device=device)


@pytest.mark.parametrize("ratio", [1.0, 0.8, 0.33, 0.1])
def test_level_is_what_simplify_gives_to_the_bit(built, ratio, device):
    points, faces, mesh = built
    level = mesh.level(mesh.splits_for(ratio=ratio))
    result = warpqem.simplify(points, faces, ratio=ratio, quality="fast", device=device)
    np.testing.assert_array_equal(level.points, result.points)
    np.testing.assert_array_equal(level.faces, result.faces)
    np.testing.assert_array_equal(level.face_map, result.face_map)
    np.testing.assert_array_equal(mesh.vertex_map(level.split_count), result.vertex_map)
    assert level.error == result.error


@pytest.mark.parametrize(
    "options",
    [
        {"metric": "aqem"},
        {"metric": "dod"},
        {"placement": "endpoint"},
        {"coherence": 0.9},
        {"locked": np.array([3, 40, 41, 77])},
        {"seams": np.array([[0, 1], [1, 2], [2, 3]])},
    ],
    ids=lambda options: next(iter(options)) + "-" + str(next(iter(options.values())))[:9],
)
def test_level_is_what_simplify_gives_with_every_option(options, device):
    points, faces = MESHES["open"]
    mesh = warpqem.build_progressive(points, faces, quality="fast", device=device, **options)
    level = mesh.level(mesh.splits_for(ratio=0.3))
    result = warpqem.simplify(points, faces, ratio=0.3, quality="fast", device=device, **options)
    np.testing.assert_array_equal(level.faces, result.faces)
    np.testing.assert_array_equal(level.points, result.points)


def test_level_is_what_simplify_gives_with_attributes(device):
    points, faces = MESHES["open"]
    field = warpqem.costs.AttributeField(np.sin(points[0, :, :2] * 9), weight=0.5)
    mesh = warpqem.build_progressive(points, faces, quality="fast", device=device, attributes=[field])
    level = mesh.level(mesh.splits_for(ratio=0.3))
    result = warpqem.simplify(points, faces, ratio=0.3, quality="fast", device=device, attributes=[field])
    np.testing.assert_array_equal(level.points, result.points)


def test_level_is_what_simplify_gives_on_a_mesh_ordered_along_a_curve(device, monkeypatch):
    monkeypatch.setattr("warpqem.decimation.decimate.ARRANGED_FACES", 0)
    mesh = warpqem.build_progressive(*SPHERE, quality="fast", device=device)
    result = warpqem.simplify(*SPHERE, ratio=0.3, quality="fast", device=device)
    level = mesh.level(mesh.splits_for(ratio=0.3))
    np.testing.assert_array_equal(level.faces, result.faces)
    np.testing.assert_array_equal(level.points, result.points)


def test_finest_level_is_the_input(built):
    points, faces, mesh = built
    level = mesh.level(mesh.split_count)
    np.testing.assert_array_equal(level.points, points)
    np.testing.assert_array_equal(level.faces, faces)
    assert level.error == 0


def test_every_split_adds_one_vertex_and_the_faces_of_its_edge(built):
    _, _, mesh = built
    before = mesh.level(0)
    for split_count in range(1, mesh.split_count + 1):
        after = mesh.level(split_count)
        assert after.points.shape[1] == before.points.shape[1] + 1
        assert len(after.faces) - len(before.faces) in (1, 2)
        # Vertices that do not split stay, to the bit, in every frame.
        same = np.isin(after.vertex, before.vertex)
        assert (~same).sum() == 1
        moved = (after.points[:, same] != before.points).any(axis=(0, 2))
        assert moved.sum() <= 1
        before = after


def test_levels_are_manifold_with_the_topology_of_the_input(built):
    _, faces, mesh = built
    expected = topology(faces)
    for split_count in range(0, mesh.split_count + 1, 7):
        state = topology(mesh.level(split_count).faces)
        assert (state.euler_number, state.components) == (expected.euler_number, expected.components)
        assert state.non_manifold_edges == state.non_manifold_vertices == state.repeated_faces == 0


@settings(max_examples=40, deadline=None)
@given(target=st.integers(20, 1280))
def test_any_face_count_is_met_or_missed_by_one(sphere, target):
    level = sphere.level(sphere.splits_for(target_faces=target))
    assert target - 1 <= len(level.faces) <= target


@pytest.mark.parametrize("limit", [0.05, 0.5, 2.0])
def test_estimate_gives_the_coarsest_level_within(sphere, limit):
    split_count = sphere.splits_for(max_size_error=limit)
    assert sphere.level(split_count).error <= limit
    assert split_count == 0 or sphere.level(split_count - 1).error > limit
    assert sphere.level(max_size_error=limit).split_count == split_count


@pytest.mark.parametrize("limit", [0.3, 2.0, 6.0])
def test_max_error_is_proved_as_for_simplify(built, limit, device):
    points, faces, mesh = built
    level = mesh.level(max_error=limit, device=device)
    assert level.split_count == mesh.splits_for(max_error=limit, device=device)
    found = compare(points, faces, level.points, level.faces, device=device)
    assert found.hausdorff <= limit
    # No coarser one holds, to what measuring and proving take for themselves.
    if level.split_count:
        coarser = mesh.level(level.split_count - 1)
        assert compare(points, faces, coarser.points, coarser.faces, device=device).hausdorff > 0.998 * limit


def test_a_limit_below_all_errors_gives_the_input(sphere, device):
    assert sphere.splits_for(max_error=1e-9, device=device) == sphere.split_count


def test_nothing_is_proved_of_a_mesh_that_is_loaded_in_part(sphere, tmp_path):
    save(sphere, tmp_path / "sphere.wpqm")
    part = load(tmp_path / "sphere.wpqm", split_count=0)
    with pytest.raises(OptionError, match=r"max_error is proved against all faces: only 4 of 1280 faces are loaded"):
        part.level(max_error=1.0)
    assert part.level(max_size_error=100.0).split_count == 0


def test_a_mesh_without_extent_has_no_limit_in_percent(sphere, device):
    flat = warpqem.ProgressiveMesh(sphere.topology, np.zeros_like(sphere.points))
    with pytest.raises(DegenerateMeshError, match="no extent"):
        flat.level(max_error=1.0, device=device)


def test_error_grows_from_level_to_level(sphere):
    errors = [sphere.error(split_count) for split_count in range(sphere.split_count + 1)]
    assert errors == sorted(errors, reverse=True)


def test_morph_begins_on_the_coarser_level_and_ends_on_the_finer(built):
    _, _, mesh = built
    coarse, fine = mesh.split_count // 4, mesh.split_count // 2
    start, faces = mesh.morph(coarse, fine, 0.0)
    end, _ = mesh.morph(coarse, fine, 1.0)
    np.testing.assert_array_equal(end, mesh.level(fine).points)
    np.testing.assert_array_equal(faces, mesh.level(fine).faces)
    # Every vertex lies on one of the coarser level; faces between them have no area or are the coarser level's.
    before = {tuple(p) for p in mesh.level(coarse).points[0]}
    assert {tuple(p) for p in start[0]} == before
    corner = start[0][faces]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    assert (area > 1e-12).sum() <= len(mesh.level(coarse).faces)


def test_morph_is_straight(sphere):
    ends = [sphere.morph(40, 90, blend)[0] for blend in (0.0, 0.25, 1.0)]
    np.testing.assert_allclose(ends[1], 0.75 * ends[0] + 0.25 * ends[2], atol=1e-6)


def test_base_stops_where_asked(device):
    mesh = warpqem.build_progressive(*SPHERE, base_faces=200, device=device)
    assert mesh.base_face_count == 200


def test_unused_vertices_and_flawed_faces_are_left_out(device):
    points, faces = SPHERE
    more = np.concatenate([points, points[:, :3] + 1], axis=1)
    flawed = np.concatenate([[[0, 0, 1]], faces])
    mesh = warpqem.build_progressive(more, flawed, quality="fast", device=device)
    result = warpqem.simplify(more, flawed, ratio=0.3, quality="fast", device=device)
    level = mesh.level(mesh.splits_for(ratio=0.3))
    np.testing.assert_array_equal(level.points, result.points)
    np.testing.assert_array_equal(level.face_map, result.face_map)
    np.testing.assert_array_equal(mesh.vertex_map(level.split_count), result.vertex_map)


def test_float64_points_far_from_the_origin_come_out_as_from_simplify(device):
    points, faces = SPHERE
    far = points.astype(np.float64) + np.array([1e5, -2e5, 3e5])
    mesh = warpqem.build_progressive(far, faces, quality="fast", device=device)
    result = warpqem.simplify(far, faces, ratio=0.3, quality="fast", device=device)
    np.testing.assert_array_equal(mesh.level(mesh.splits_for(ratio=0.3)).points, result.points)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda m: m.splits_for(),
            "exactly one of ratio, target_faces, max_error and max_size_error is needed, got none",
        ),
        (lambda m: m.splits_for(ratio=0.5, target_faces=3), "exactly one .* got ratio and target_faces"),
        (lambda m: m.splits_for(max_error=0.0), "max_error must be a finite number above 0, got 0.0"),
        (lambda m: m.level(max_error=np.inf), "max_error must be a finite number above 0, got inf"),
        (lambda m: m.level(max_size_error=np.nan), "max_size_error must be a finite number above 0, got nan"),
        (lambda m: m.splits_for(ratio=1.5), r"ratio must be in \(0, 1\]"),
        (lambda m: m.splits_for(target_faces=1), "the base mesh has"),
        (lambda m: m.level(-1), "there are 0 to"),
        (lambda m: m.level(10**6), "there are 0 to"),
        (lambda m: m.morph(5, 3, 0.5), "coarser level has 5"),
        (lambda m: m.morph(3, 5, 1.5), "blend must be"),
    ],
)
def test_wrong_questions_are_named(sphere, call, message):
    with pytest.raises(OptionError, match=message):
        call(sphere)


@pytest.mark.parametrize("option", ["ratio", "max_distance", "refit", "sink"])
def test_options_of_one_level_are_refused(option, device):
    with pytest.raises(OptionError, match=option):
        warpqem.build_progressive(*SPHERE, device=device, **{option: 0.5})


@pytest.mark.parametrize("quality", ["fast", "best"])
def test_quality_decides_the_order_of_the_levels(quality, device):
    level = warpqem.build_progressive(*SPHERE, device=device, quality=quality).level(ratio=0.3)
    result = warpqem.simplify(*SPHERE, ratio=0.3, quality=quality, refit=False, device=device)
    np.testing.assert_array_equal(level.faces, result.faces)


def test_levels_follow_each_other_by_vertex_splits(built):
    # Hoppe 1996: a split undone is the collapse of the vertex that it adds.
    _, _, mesh = built

    def faces_of(level):
        first = level.argmin(axis=1)[:, None]
        return set(map(tuple, np.take_along_axis(level, (first + np.arange(3)) % 3, axis=1).tolist()))

    levels = [mesh.level(split_count) for split_count in range(mesh.split_count + 1)]
    for split_count, (coarse, fine) in enumerate(itertools.pairwise(levels)):
        [added] = set(fine.vertex.tolist()) - set(coarse.vertex.tolist())
        kept = int(coarse.vertex[mesh.vertex_map(split_count)[added]])
        expected = collapsed(fine.vertex[fine.faces], kept, added)
        assert faces_of(coarse.vertex[coarse.faces]) == faces_of(expected)
