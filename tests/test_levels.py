"""Levels from one ordering."""

import numpy as np
import pytest
from moving_meshes import CLOTH, MESHES, SPHERE

import warpqem
from warpqem.errors import OptionError

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
