"""Levels from one ordering."""

import numpy as np
import pytest

import warpqem
from tests.support import meshes
from tests.support.moving_meshes import CLOTH, MESHES, SPHERE
from warpqem.decimation.arrangement import ARRANGED_FACES
from warpqem.errors import OptionError, UnreachableTargetError
from warpqem.face import FaceProtection, FacialFeatures
from warpqem.measure import compare

RATIOS = (0.8, 0.3, 0.3, 0.1)


@pytest.mark.parametrize("refit", [False, True])
@pytest.mark.parametrize("name", list(MESHES))
def test_every_level_is_what_simplify_gives_to_the_bit(name, refit, device):
    points, faces = MESHES[name]
    levels = warpqem.simplify_levels(points, faces, ratios=RATIOS, refit=refit, device=device)
    for ratio, level in zip(RATIOS, levels, strict=True):
        result = warpqem.simplify(points, faces, ratio=ratio, refit=refit, device=device)
        np.testing.assert_array_equal(level.points, result.points)
        for field in ("faces", "vertex_map", "face_map", "flips"):
            np.testing.assert_array_equal(getattr(level, field), getattr(result, field), err_msg=field)
        assert (level.error, level.stopped, len(level.log)) == (result.error, result.stopped, len(result.log))


def weights_of(points, faces):
    return np.where(np.arange(points.shape[1]) % 5 == 0, 3.0, 1.0)


# Options that have a part in quadrics, each made for a mesh.
PARTS = {
    "plain": lambda points, faces: {},
    "refit": lambda points, faces: {"refit": True},
    "quadric_scale": lambda points, faces: {"quadric_scale": weights_of(points, faces)},
    "vertex_weights": lambda points, faces: {"vertex_weights": weights_of(points, faces)},
    "attributes": lambda points, faces: {"attributes": [warpqem.costs.AttributeField(points[0][:, :2].copy(), 0.3)]},
    "seams": lambda points, faces: {"seams": faces[: len(faces) // 4, :2]},
    "locked borders": lambda points, faces: {"lock_borders": True},
    "components": lambda points, faces: {"keep_components": True},
}


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("name", list(MESHES))
def test_levels_of_a_memoryless_order_are_what_simplify_gives_to_the_bit(name, part, device):
    points, faces = MESHES[name]
    options = {**PARTS[part](points, faces), "memoryless": True, "device": device}
    levels = warpqem.simplify_levels(points, faces, ratios=RATIOS, **options)
    for ratio, level in zip(RATIOS, levels, strict=True):
        try:
            result = warpqem.simplify(points, faces, ratio=ratio, **options)
        except UnreachableTargetError as error:
            result = error.result
        assert level.points.tobytes() == result.points.tobytes()
        assert level.faces.tobytes() == result.faces.tobytes()


def test_levels_of_a_large_memoryless_order_have_the_bits_of_simplify(device):
    # So many faces are put in another order first.
    points, faces = meshes.grid(150, 150)
    points = np.stack([points, points + 0.05 * np.sin(5 * points[:, [1, 2, 0]])]).astype(np.float32)
    assert len(faces) >= ARRANGED_FACES
    options = {"quality": "best", "seams": faces[1000:1300, :2], "device": device}
    levels = warpqem.simplify_levels(points, faces, ratios=(0.31, 0.02), **options)
    for ratio, level in zip((0.31, 0.02), levels, strict=True):
        assert level.points.tobytes() == warpqem.simplify(points, faces, ratio=ratio, **options).points.tobytes()


def test_levels_of_a_memoryless_order_keep_the_sums_at_feature_points(device):
    points, faces = MESHES["sphere"]
    features = FacialFeatures({"nose_tip": 3, "chin": 30}, {"nose_tip": 1.0, "chin": 1.0}, {}, np.eye(3))
    options = {"metric": "face", "face": FaceProtection(features, ring=2), "memoryless": True, "device": device}
    levels = warpqem.simplify_levels(points, faces, ratios=RATIOS, **options)
    for ratio, level in zip(RATIOS, levels, strict=True):
        assert level.points.tobytes() == warpqem.simplify(points, faces, ratio=ratio, **options).points.tobytes()


def test_progressive_mesh_of_a_memoryless_order_fits_better(device):
    points, faces = CLOTH
    error = {}
    for memoryless in (False, True):
        mesh = warpqem.build_progressive(points, faces, memoryless=memoryless, device=device)
        level = mesh.level(mesh.splits_for(ratio=0.1))
        error[memoryless] = compare(points, faces, level.points, level.faces, samples=3000, device=device).rms
    assert error[True] < error[False]


def test_levels_nest(device):
    fine, coarse = warpqem.simplify_levels(*CLOTH, ratios=(0.5, 0.1), device=device)
    # What is one vertex on the finer level is one on the coarser.
    pairs = np.unique(np.stack([fine.vertex_map, coarse.vertex_map], axis=1), axis=0)
    assert len(pairs) == fine.points.shape[1]


def test_level_out_of_reach_is_the_coarsest_there_is(device):
    fine, coarse = warpqem.simplify_levels(*SPHERE, ratios=(0.5, 0.001), device=device)
    assert fine.stopped == "target"
    assert coarse.stopped == "no legal collapse"
    assert len(coarse.faces) == 4


def test_level_at_which_the_order_ended_is_no_failure(device):
    points, faces = meshes.perforated_plate(1)
    order = warpqem.order_levels(points, faces, target_faces=1, device=device)
    with pytest.raises(UnreachableTargetError) as caught:
        order.level(1)
    fewest = len(caught.value.result.faces)
    level = order.level(fewest)
    assert (len(level.faces), level.stopped) == (fewest, "target")


def test_progress_rises_to_one_over_all_levels(device):
    seen = []
    warpqem.simplify_levels(*SPHERE, ratios=(0.5, 0.1), device=device, progress=lambda *call: seen.append(call))
    parts = [part for part, _ in seen]
    assert parts == sorted(parts)
    assert parts[-1] == pytest.approx(1)


@pytest.mark.parametrize(
    ("options", "message"),
    [({"ratios": ()}, "need ratios"), ({"ratios": (0.5, 1.5)}, "got 1.5"), ({"ratios": (0.5,), "sink": 1}, "sink")],
)
def test_wrong_levels_are_named(options, message, device):
    with pytest.raises(OptionError, match=message):
        warpqem.simplify_levels(*SPHERE, device=device, **options)
