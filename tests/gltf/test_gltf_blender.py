"""Animated glTF files and scenes of Blender through warpqem and back; needs Blender (warpqem.gltf.blender)."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Usd, UsdSkel

from tests.support.cli import run
from warpqem.errors import OptionError
from warpqem.gltf.blender import blender_command
from warpqem.gltf.inventory import compare_gltf, gltf_parts, read_gltf

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "tests" / "support" / "blender_scene.py"

try:
    COMMAND = blender_command()
except OptionError as error:
    pytest.skip(str(error), allow_module_level=True)


def blender(*arguments: object, **environment: str) -> str:
    command = [*COMMAND[: COMMAND.index(next(part for part in COMMAND if part.endswith("blender_script.py")))]]
    dashes = ["--"] if COMMAND[-1] == "--" else []
    done = subprocess.run(
        [*command, str(SCRIPT), *dashes, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **environment},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def shown(file: Path) -> dict[str, Any]:
    blender("boxes", file, file.with_suffix(".json"))
    return json.loads(file.with_suffix(".json").read_text("utf-8"))


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("blender")
    blender("make", folder)
    return folder


def boxes_agree(one: dict[str, Any], other: dict[str, Any], distance: float) -> None:
    assert one["boxes"].keys() == other["boxes"].keys() == {"Bend", "Twist"}
    for clip in one["boxes"]:
        assert np.abs(np.subtract(one["boxes"][clip], other["boxes"][clip])).max() <= distance


def test_a_glb_comes_back_with_all_it_held_and_the_same_motion(made):
    out, report = made / "out.glb", made / "report.json"
    done = run("simplify", made / "arm.glb", "-o", out, "--ratio", "0.3", "--json", report)
    assert done.exit_code == 0, done.output
    assert "kept: 2 clips, 1 skin, 1 mesh, 2 materials, 2 images, 2 morph targets" in done.output
    before, after = (gltf_parts(read_gltf(path)) for path in (made / "arm.glb", out))
    assert compare_gltf(before, after, 1 / 24)[1] == []
    assert len(after) == len(before)
    [mesh] = json.loads(report.read_text("utf-8"))["prims"]
    assert (mesh["path"], mesh["faces_before"], mesh["faces_after"]) == ("Arm", 960, 288)
    original, simplified = shown(made / "arm.glb"), shown(out)
    boxes_agree(original, simplified, mesh["measured"]["hausdorff_length"])
    [was], [has] = original["meshes"].values(), simplified["meshes"].values()
    assert has == {**was, "triangles": 288}
    # The clips do move it, so that equal boxes mean something.
    assert np.ptp(original["boxes"]["Bend"], axis=0).max() > 1.0
    assert not list(made.glob(".warpqem*"))


def test_a_glb_becomes_a_stage_with_skin_shapes_and_textures(made):
    out = made / "stage" / "arm.usdc"
    out.parent.mkdir()
    done = run("simplify", made / "arm.glb", "-o", out, "--ratio", "0.3")
    assert done.exit_code == 0, done.output
    stage = Usd.Stage.Open(os.fspath(out))
    [mesh] = [prim for prim in stage.Traverse() if prim.GetTypeName() == "Mesh"]
    binding = UsdSkel.BindingAPI(mesh)
    assert len(binding.GetBlendShapesAttr().Get()) == 2
    assert len(binding.GetJointWeightsAttr().Get()) > 0
    assert stage.GetEndTimeCode() - stage.GetStartTimeCode() > 45
    named = [
        attribute.Get().path
        for prim in stage.Traverse()
        for attribute in prim.GetAttributes()
        if attribute.GetTypeName() == "asset" and attribute.Get()
    ]
    assert len(named) == 2
    assert all((out.parent / path).is_file() for path in named)


def test_the_example_simplifies_a_scene_inside_blender(made, tmp_path):
    for name, arguments in (("warpqem", '-m warpqem "$@"'), ("python", '"$@"')):
        (tmp_path / name).write_text(f'#!/bin/sh\nexec "{sys.executable}" {arguments}\n')
        (tmp_path / name).chmod(0o755)
    out = tmp_path / "simple.blend"
    example = ROOT / "examples" / "blender_simplify.py"
    environment = {"WARPQEM": str(tmp_path / "warpqem"), "PYTHONPATH": str(ROOT)}
    said = blender("run", made / "arm.blend", example, out, "--ratio", "0.3", **environment)
    assert "Arm: " in said
    original, simplified = shown(made / "arm.blend"), shown(out)
    boxes_agree(original, simplified, 0.03)
    [was], [has] = original["meshes"].values(), simplified["meshes"].values()
    # One fewer where the last collapse would take a face too many.
    assert has.pop("triangles") in (287, 288)
    assert was.pop("triangles") == 960
    assert has == was


def test_a_file_that_blender_cannot_read_is_named(made):
    broken = made / "broken.glb"
    data = (made / "arm.glb").read_bytes()
    broken.write_bytes(data[: len(data) // 3])
    done = run("simplify", broken, "-o", made / "no.glb", "--ratio", "0.3")
    assert done.exit_code == 1
    assert "broken.glb: Blender fails" in done.output
    assert not (made / "no.glb").exists()
