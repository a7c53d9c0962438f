"""Exchange of collapses where the surface is furthest from the input."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

import warpqem
from tests.support.moving_meshes import MESHES
from warpqem.measure import compare
from warpqem.options import read_keywords
from warpqem.pipeline import exchange
from warpqem.pipeline.cut_levels import CutLevel
from warpqem.pipeline.key_frames import looked_frames
from warpqem.pipeline.prepare import prepare


def bumpy_ball(seed=0):
    """A ball with bumps and spikes that swell over six frames."""
    ball = trimesh.creation.icosphere(subdivisions=4)
    rng = np.random.default_rng(seed)
    direction = np.asarray(ball.vertices)
    phase, wave = rng.uniform(0, 6, 5), rng.normal(size=(5, 3)) * 3
    bumps = sum(np.sin(direction @ w + p) for w, p in zip(wave, phase, strict=True))
    spikes = (direction @ rng.normal(size=(3, 12)) > 2.2).sum(axis=1)
    frames = [direction * (1 + (0.03 + 0.02 * t) * bumps + 0.1 * np.sin(t) * spikes)[:, None] for t in range(6)]
    return np.stack(frames).astype(np.float32), np.asarray(ball.faces, dtype=np.int32)


def parting_lips():
    """Two sheets whose rims part over six frames, and a strip of triangles between the rims that grow long."""
    rows, columns = 20, 40
    x, z = np.meshgrid(np.linspace(0, 2, columns), np.linspace(0, 1, rows))
    corner, count = np.arange(rows * columns).reshape(rows, columns), rows * columns
    quads = np.stack([corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]], axis=-1).reshape(-1, 4)
    sheet = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    left, right = corner[0, :-1], corner[0, 1:]
    strip = np.concatenate(
        [np.stack([right, left, left + count], axis=1), np.stack([right, left + count, right + count], axis=1)]
    )
    frames = []
    for t in range(6):
        gap = 0.002 + 0.15 * t * np.sin(np.pi * x / 2)
        bend = 0.08 * np.sin(3 * x + t)
        sheets = [np.stack([x, side * (z + gap), bend], axis=-1).reshape(-1, 3) for side in (1, -1)]
        frames.append(np.concatenate(sheets))
    faces = np.concatenate([sheet, sheet[:, ::-1] + count, strip])
    return np.stack(frames).astype(np.float32), faces.astype(np.int32)


def largest_distance(points, faces, result):
    return compare(points, faces, result.points, result.faces).hausdorff


def test_the_largest_distance_is_less_than_without_an_exchange(device, monkeypatch):
    # Single balls depend on the order of equal costs, which a GPU has in another way.
    ratios = []
    for seed in range(8):
        points, faces = bumpy_ball(seed)
        options = {"ratio": 0.15, "device": device, "measure": False}
        exchanged = largest_distance(points, faces, warpqem.simplify(points, faces, **options))
        with monkeypatch.context() as patch:
            patch.setattr(exchange, "ROUNDS", 0)
            ratios.append(exchanged / largest_distance(points, faces, warpqem.simplify(points, faces, **options)))
    assert np.mean(ratios) < 0.95
    assert max(ratios) < 1.1


@pytest.mark.parametrize("name", list(MESHES))
def test_faces_are_as_many_as_asked_for_or_one_fewer(name, device):
    points, faces = MESHES[name]
    for target in (300, 221):
        result = warpqem.simplify(points, faces, target_faces=target, keep_components=True, device=device)
        assert target - 1 <= len(result.faces) <= target


def test_a_closed_surface_stays_closed_and_in_one_piece(device):
    points, faces = bumpy_ball()
    result = warpqem.simplify(points, faces, ratio=0.15, device=device)
    mesh = trimesh.Trimesh(result.points[0], result.faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.euler_number == 2


def test_a_rerun_gives_the_same_bits(device):
    points, faces = bumpy_ball()
    first, second = (warpqem.simplify(points, faces, ratio=0.15, device=device) for _ in range(2))
    assert first.points.tobytes() == second.points.tobytes()
    assert first.faces.tobytes() == second.faces.tobytes()


def test_nothing_is_ordered_beyond_the_goal_where_few_faces_could_be_exchanged(device):
    points, faces = MESHES["sphere"]
    work = prepare(points, faces, read_keywords({"target_faces": 100, "device": device}))
    assert exchange.spare_faces(work, 100) == 100
    assert exchange.spare_faces(work, 1000) == 950
    assert exchange.spare_faces(work, len(faces)) == len(faces)


def largest_of_level(points, faces, search, level):
    placed = search._frames.points(level)
    rank = np.searchsorted(level.kept, level.ordered.faces)
    return compare(points, faces, placed, rank).hausdorff


def test_a_hole_between_vertices_that_stay_is_seen_where_input_faces_are_larger(device):
    points, faces = parting_lips()
    work = prepare(points, faces, read_keywords({"target_faces": 700, "device": device}))
    search = exchange._Search(work, exchange.order_with_spare(work), 700)
    level = search._first_level()
    ordered = level.ordered
    at = search._frames.level_points.numpy()[-1][ordered.faces]
    is_hole = (np.abs(at[..., 0].mean(axis=1) - 1.0) < 0.3) & (np.ptp(at[..., 1], axis=1) > 1.0)
    assert is_hole.any()
    torn = replace(ordered, faces=ordered.faces[~is_hole], face_map=ordered.face_map[~is_hole])
    level = CutLevel(level.choice, torn, level.last)
    found = 100 * search._distances.renew(level, None)
    largest = largest_of_level(points, faces, search, level)
    assert largest > 5.0
    assert found > 0.7 * largest


@pytest.mark.parametrize("ratio", [0.8, 0.9])
def test_where_pruning_alone_reaches_the_goal_nothing_is_exchanged(ratio, device):
    rng = np.random.default_rng(0)
    points = (3 * rng.normal(size=(400, 1, 3)) + 0.1 * rng.normal(size=(400, 3, 3))).reshape(-1, 3)
    faces = np.arange(1200).reshape(-1, 3)
    result = warpqem.simplify(points, faces, ratio=ratio, measure=False, device=device)
    assert len(result.faces) == round(400 * ratio)
    levels = warpqem.simplify_levels(points, faces, ratios=(ratio, 0.1), device=device)
    assert [len(level.faces) for level in levels] == [round(400 * ratio), 40]


def test_frames_looked_at_are_key_frames_and_others_between_them():
    looked, fitted = looked_frames(np.arange(0, 96, 6), np.arange(96))
    assert fitted.tolist() == list(range(0, 96, 6))
    assert len(looked) == 32
    assert np.isin(fitted, looked).all()
    assert np.diff(looked).max() <= 6


def test_all_frames_are_looked_at_where_there_are_few():
    looked, fitted = looked_frames(np.array([0, 5]), np.arange(9))
    assert looked.tolist() == list(range(9))
    assert fitted.tolist() == [0, 5]


def test_only_frames_that_count_are_looked_at():
    counted = np.array([2, 3, 7])
    looked, _ = looked_frames(np.array([2]), counted)
    assert looked.tolist() == counted.tolist()


def test_distances_at_samples_come_near_the_largest_one_and_hardly_beyond(device):
    points, faces = bumpy_ball()
    work = prepare(points, faces, read_keywords({"target_faces": 700, "device": device}))
    search = exchange._Search(work, exchange.order_with_spare(work), 700)
    level = search._first_level()
    found = 100 * search._distances.renew(level, None)
    largest = largest_of_level(points, faces, search, level)
    # Samples are vertices and four points of each face of the result: between them it may be further off.
    assert 0.7 * largest < found < 1.02 * largest
