"""What a glTF file holds, what of it another one has, and what is said where there is no Blender."""

from __future__ import annotations

import base64
import importlib.util
import json
import os
import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.cli import run
from warpqem.errors import MeshFileError, OptionError
from warpqem.gltf.blender import BLENDER_VARIABLE, blender_command, run_blender
from warpqem.gltf.inventory import (
    GltfPart,
    compare_gltf,
    frame_rate,
    gltf_parts,
    is_animated,
    is_animated_gltf,
    read_gltf,
)

FRAME = 1.0 / 24.0


def times_file(times: list[float]) -> dict[str, Any]:
    """A scene with one clip whose keys are at these times, in a buffer within the JSON."""
    data = np.array(times, dtype="<f4").tobytes()
    return {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": len(data), "uri": f"data:;base64,{base64.b64encode(data).decode()}"}],
        "bufferViews": [{"buffer": 0, "byteLength": len(data)}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": len(times), "type": "SCALAR"}
            | {"min": [min(times)], "max": [max(times)]}
        ],
        "nodes": [{"name": "Hero", "mesh": 0, "skin": 0}, {"name": "Hip"}],
        "meshes": [
            {"name": "Body", "primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 0}, "targets": [{}, {}]}]}
        ],
        "skins": [{"joints": [1]}],
        "materials": [{"name": "Cloth", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "animations": [
            {"name": "Run", "channels": [{"target": {"node": 1, "path": "rotation"}}], "samplers": [{"input": 0}]}
        ],
    }


def write_glb(path: Path, found: dict[str, Any], binary: bytes = b"") -> Path:
    text = json.dumps(found).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    if binary:
        chunks += struct.pack("<II", len(binary), 0x004E4942) + binary
    path.write_bytes(struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks)
    return path


@pytest.fixture
def glb(tmp_path) -> Path:
    return write_glb(tmp_path / "hero.glb", times_file([0.0, 0.5, 1.0]))


def test_parts_of_a_file_are_found(glb):
    found = {(part.kind, part.name): part for part in gltf_parts(read_gltf(glb))}
    assert found["clip", "Run"].seconds == 1.0
    assert found["mesh", "Hero"].counts == {"morph targets": 2, "UV sets": 1}
    assert found["skin", ""].counts == {"joints": 1}
    assert found["material", "Cloth"].counts == {"textures": 1}


def test_text_and_binary_files_are_read_alike(glb):
    text = glb.with_suffix(".gltf")
    text.write_text(json.dumps(times_file([0.0, 0.5, 1.0])), "utf-8")
    assert gltf_parts(read_gltf(text)) == gltf_parts(read_gltf(glb))


def test_what_is_missing_shorter_or_fewer_is_lost():
    before = [
        GltfPart("clip", "Run", 1.0),
        GltfPart("clip", "Walk", 2.0),
        GltfPart("clip", "Sit", 3.0),
        GltfPart("skin", "", None, {"joints": 24}),
        GltfPart("mesh", "Body", None, {"morph targets": 3, "UV sets": 2}),
        GltfPart("material", "Cloth"),
        GltfPart("extension", "KHR_materials_sheen"),
    ]
    after = [
        GltfPart("clip", "Run", 1.03),
        GltfPart("clip", "Walk", 1.5),
        GltfPart("skin", "Rig", None, {"joints": 25}),
        GltfPart("mesh", "Body", None, {"morph targets": 3, "UV sets": 1}),
        GltfPart("material", "Cloth.001"),
        GltfPart("extension", "KHR_texture_transform"),
    ]
    kept, lost = compare_gltf(before, after, FRAME)
    assert kept == ["1 clip", "1 skin", "3 morph targets"]
    assert sorted(lost) == [
        "clip 'Sit' is lost",
        "clip 'Walk': 1.500 s of 2.000 s are left",
        "extension 'KHR_materials_sheen' is lost",
        "material 'Cloth' is named 'Cloth.001' now",
        "mesh 'Body': 1 of 2 UV sets are left",
    ]


def test_a_file_keeps_all_of_itself(glb):
    parts = gltf_parts(read_gltf(glb))
    kept, lost = compare_gltf(parts, parts, FRAME)
    assert lost == []
    assert kept == ["1 clip", "1 skin", "1 mesh", "1 material", "2 morph targets"]


@pytest.mark.parametrize("rate", [24, 25, 30, 50, 60])
def test_the_rate_is_that_of_the_keys(tmp_path, rate):
    times = [frame / rate for frame in (0, 1, 7, 20, 43)]
    assert frame_rate(read_gltf(write_glb(tmp_path / "a.glb", times_file(times)))) == rate


def test_the_rate_is_found_in_a_binary_part_and_a_file_beside(tmp_path):
    found, data = times_file([0.0, 1 / 25, 3 / 25]), np.array([0.0, 1 / 25, 3 / 25], dtype="<f4").tobytes()
    found["buffers"] = [{"byteLength": len(data)}]
    assert frame_rate(read_gltf(write_glb(tmp_path / "in.glb", found, data))) == 25
    found["buffers"][0]["uri"] = "some%20keys.bin"
    (tmp_path / "some keys.bin").write_bytes(data)
    assert frame_rate(read_gltf(write_glb(tmp_path / "beside.glb", found))) == 25
    (tmp_path / "some keys.bin").unlink()
    assert frame_rate(read_gltf(write_glb(tmp_path / "gone.glb", found))) == 30


@pytest.mark.parametrize(
    "data", [b"", b"glTF", b"solid", b"[]", b'{"asset": {"version": "1.0"}}', struct.pack("<III", 0x46546C67, 2, 12)]
)
def test_what_is_no_gltf_file_is_named(tmp_path, data):
    (tmp_path / "a.glb").write_bytes(data)
    with pytest.raises(MeshFileError, match=r"a\.glb: no glTF"):
        read_gltf(tmp_path / "a.glb")
    assert not is_animated_gltf(tmp_path / "a.glb")


def test_animated_are_clips_skins_and_targets(tmp_path):
    whole = times_file([0.0, 1.0])
    still = {name: value for name, value in whole.items() if name not in ("animations", "skins")}
    assert is_animated(read_gltf(write_glb(tmp_path / "a.glb", whole)))
    assert is_animated(read_gltf(write_glb(tmp_path / "b.glb", still)))
    still["meshes"] = [{"primitives": [{"attributes": {"POSITION": 0}}]}]
    assert not is_animated_gltf(write_glb(tmp_path / "c.glb", still))
    assert not is_animated_gltf(tmp_path / "none.glb")


@pytest.fixture
def without_blender(monkeypatch):
    monkeypatch.delenv(BLENDER_VARIABLE, raising=False)
    real = importlib.util.find_spec
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name == "bpy" else real(name))


@pytest.mark.usefixtures("without_blender")
def test_without_blender_the_extra_is_named_and_nothing_written(glb):
    before = sorted(glb.parent.iterdir())
    done = run("simplify", glb, "-o", glb.with_name("out.glb"), "--ratio", "0.5")
    assert done.exit_code == 2
    assert "pip install 'warpqem[gltf]'" in done.output
    assert BLENDER_VARIABLE in done.output
    assert sorted(glb.parent.iterdir()) == before


def test_a_program_that_is_none_is_named(monkeypatch):
    monkeypatch.setenv(BLENDER_VARIABLE, "/no/such/blender")
    with pytest.raises(OptionError, match="WARPQEM_BLENDER is '/no/such/blender', and there is no such program"):
        blender_command()


def test_blender_and_a_python_with_its_module_are_called_in_their_ways(monkeypatch, tmp_path):
    for name in ("blender", "python3"):
        (tmp_path / name).write_text("#!/bin/sh\n")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv(BLENDER_VARIABLE, os.fspath(tmp_path / "blender"))
    command = blender_command()
    assert command[1:5] == ["--background", "--factory-startup", "--python-exit-code", "1"]
    assert command[-1] == "--"
    monkeypatch.setenv(BLENDER_VARIABLE, os.fspath(tmp_path / "python3"))
    assert blender_command()[1] == "-P"


def test_what_blender_says_last_is_in_the_message():
    code = "import sys; print('RuntimeError: no mesh'); print('bye'); sys.exit(3)"
    with pytest.raises(MeshFileError, match=r"hero\.glb: Blender fails \(RuntimeError: no mesh\)"):
        run_blender([sys.executable, "-c", code], [], "hero.glb")


@pytest.mark.parametrize(
    ("more", "match"),
    [
        (["-o", "{folder}/hero.glb", "--ratio", "0.5"], "never overwritten"),
        (["-o", "{folder}/out.gltf", "--ratio", "0.5"], "is written as .glb"),
        (["-o", "{folder}/out.glb", "--lods", "0.5,0.2"], "lods: needs a USD file"),
        (["-o", "{folder}/out.glb", "--ratio", "0.5", "--bake-normals", "64"], "bake-normals: needs a USD file"),
        (["-o", "{folder}/out.glb", "--ratio", "0.5", "--bake"], "bake: needs a USD file"),
        (["-o", "{folder}/out.glb", "--ratio", "0.5", "--fps", "30"], "--fps is for mesh files"),
        (["-o", "{folder}/out.usdc", "--lods", "0.5,0.2"], "lods: levels are layers over a stage"),
    ],
)
def test_wrong_outputs_and_options_are_refused_before_the_work(glb, more, match):
    done = run("simplify", glb, *(part.format(folder=glb.parent) for part in more))
    assert done.exit_code == 2
    assert match in done.output
