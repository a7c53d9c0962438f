"""What a progressive file says of its stage: named by all who read it where it is none."""

from __future__ import annotations

import numpy as np
import pytest

import warpqem
from tests.support import progressive_changes
from tests.support.progressive_files import (
    NOTES,
    UNITS,
)
from warpqem.errors import ProgressiveFileError, WarpqemError
from warpqem.progressive import load, read_info, save
from warpqem.report.live import LiveLevels
from warpqem.usd.commands.progressive import LevelChoice, extract_level


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"times": [1.0, 2.0]}, "there are 2 times and 3 frames"),
        ({"times": [1.0, 3.0, 2.0]}, "time 2 comes after time 3"),
        ({"times": [1.0, 1.0, 2.0]}, "time 1 comes after time 1"),
        ({"times": [1.0, "2", 3.0]}, "times '2' in it is not a finite number"),
        ({"times": [1.0, True, 3.0]}, "times True in it is not a finite number"),
        ({"times": None}, "times None in it is not a list"),
        ({"times": {"a": 1}}, "is not a list"),
        ({"stage": [1]}, r"stage \[1\] in it is not an object"),
        ({"stage": {}}, "the stage in it has no up_axis"),
        ({"stage": {**UNITS, "up_axis": "X"}}, "up_axis 'X' in it is not Y or Z"),
        ({"stage": {**UNITS, "up_axis": ["Y"]}}, "is not Y or Z"),
        ({"stage": {**UNITS, "time_codes_per_second": "24"}}, "time_codes_per_second '24' in it is not"),
    ],
    ids=repr,
)
def test_stage_that_is_none_is_named_by_all_who_read_it(sphere, tmp_path, change, message):
    path = tmp_path / "bad.wpqm"
    save(sphere, path, {**NOTES, **change})
    with pytest.raises(ProgressiveFileError, match=rf"bad\.wpqm: .*{message}"):
        extract_level(path, tmp_path / "out.usda", LevelChoice(ratio=0.5))
    with pytest.raises(ProgressiveFileError, match=rf"bad\.wpqm: .*{message}"):
        LiveLevels(load(path), path.name, read_info(path).extra, device="cpu").data()
    assert not (tmp_path / "out.usda").exists()


@pytest.mark.parametrize("rate", [0.0, -24.0, 1e-320])
def test_rate_that_shows_nothing_is_named(sphere, rate):
    notes = {**NOTES, "times": [0.0, 1e10, 2e10], "stage": {**UNITS, "time_codes_per_second": rate}}
    with pytest.raises(ProgressiveFileError, match="time codes a second give"):
        LiveLevels(sphere, "a.wpqm", notes, device="cpu").data()


@pytest.mark.parametrize("prim", [*progressive_changes.PATHS, None, 3, ["/A"], "\0", "x" * 10**6])
def test_path_that_is_none_of_a_prim_is_named(sphere, tmp_path, prim):
    save(sphere, tmp_path / "bad.wpqm", {**NOTES, "prim": prim})
    with pytest.raises(WarpqemError, match=r"bad\.wpqm: .*prim") as raised:
        extract_level(tmp_path / "bad.wpqm", tmp_path / "out.usda", LevelChoice(ratio=0.5))
    assert len(str(raised.value)) < 500
    assert not (tmp_path / "out.usda").exists()


@pytest.mark.parametrize("diagonal", [0, 0.0, -1.0, "3", None, True, [3.0]])
def test_diagonal_that_is_none_is_named(sphere, tmp_path, diagonal):
    save(sphere, tmp_path / "bad.wpqm", {**NOTES, "diagonal": diagonal})
    choice = LevelChoice(screen=warpqem.costs.screen_error.ScreenView(1.0, 10.0))
    with pytest.raises(ProgressiveFileError, match=r"bad\.wpqm: diagonal .* in it is not"):
        extract_level(tmp_path / "bad.wpqm", tmp_path / "out.usda", choice)


def test_file_of_a_mesh_without_extent_is_named_where_a_limit_is_asked_for(sphere, tmp_path):
    save(warpqem.ProgressiveMesh(sphere.topology, np.zeros_like(sphere.points)), tmp_path / "bad.wpqm", NOTES)
    with pytest.raises(ProgressiveFileError, match=r"bad\.wpqm: the mesh has no extent"):
        extract_level(tmp_path / "bad.wpqm", tmp_path / "out.usda", LevelChoice(max_error=1.0))
