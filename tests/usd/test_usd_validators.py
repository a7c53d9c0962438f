"""Validators of USD and of NVIDIA find in an output nothing that they do not find in its input."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from pathlib import Path

import pytest
from pxr import Usd

from tests.support.rich_stage import rich_stage
from tests.support.usd_composition import clip_stage
from tests.support.usd_findings import nvidia_findings, usd_findings
from tests.support.usd_rig import shaped_rig
from tests.support.usd_stages import cloth_stage, instanced_stage, skinned_stage
from tests.support.usd_validators import new_findings
from warpqem.usd import FrameRange, SimplifyOptions, simplify_stage

SCENES = Path(__file__).parents[2] / "scenes"
FORMS = {
    "layer": {"ratio": 0.4},
    "flat": {"ratio": 0.4, "flatten": True},
    "lods": {"lods": (0.5, 0.2)},
} | ({} if importlib.util.find_spec("pxr.UsdLod") is None else {"usd_lod": {"lods": (0.5, 0.2), "usd_lod": True}})
STAGES: dict[str, Callable[[Path], object]] = {
    "cloth": cloth_stage,
    "skin": skinned_stage,
    "rich": rich_stage,
    "instances": lambda path: instanced_stage(path, local=True),
    "instances_of_file": instanced_stage,
    "clips": lambda path: clip_stage(path.parent),
}


@pytest.mark.parametrize("find", [usd_findings, nvidia_findings])
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", STAGES)
def test_validators_find_nothing_new_on_stages(name, form, find, tmp_path):
    STAGES[name](tmp_path / "in.usda")
    report = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", SimplifyOptions(device="cpu", **FORMS[form]))
    assert report.output
    assert new_findings(tmp_path / "in.usda", tmp_path / "out.usda", find) == {}


@pytest.mark.parametrize("find", [usd_findings, nvidia_findings])
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", ["quadruped_gallop", "cape_wind", "talking_head"])
def test_validators_find_nothing_new_on_scenes(name, form, find, tmp_path):
    source = SCENES / f"{name}.usdc"
    start = Usd.Stage.Open(str(source)).GetStartTimeCode()
    # A few frames, to be quick.
    options = SimplifyOptions(key_frames=2, frames=FrameRange(start, start + 2), device="cpu", **FORMS[form])
    simplify_stage(source, tmp_path / "out.usdc", options)
    assert new_findings(source, tmp_path / "out.usdc", find) == {}


@pytest.mark.parametrize("find", [usd_findings, nvidia_findings])
def test_validators_find_nothing_new_with_fewer_joints_and_shapes(find, tmp_path):
    shaped_rig(tmp_path / "in.usda")
    fewer = {"lods": (0.4, 0.2), "joints": (4, 3), "shapes": (3, 2), "reduce_skeleton": True}
    simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", SimplifyOptions(device="cpu", **fewer))
    assert new_findings(tmp_path / "in.usda", tmp_path / "out.usda", find) == {}
