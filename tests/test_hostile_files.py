"""Files that would end, fill or block a process that trusts them."""

from __future__ import annotations

import os
import sys
import zipfile
from pathlib import Path

import pytest
from pxr import Sdf, Usd, UsdGeom, Vt
from test_cli import run
from test_usd_stages import cloth_stage, define_cloth

from warpqem.errors import OptionError, StageError
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd import input_check as checks
from warpqem.usd.stage import open_stage

MESH = 'def Mesh "M"\n{\npoint3f[] points = [(0,0,0),(1,0,0),(0,1,0)]\nint[] faceVertexCounts = [3]\n'
MESH += "int[] faceVertexIndices = [0,1,2]\n}\n"


def text_file(folder: Path, text: str, name: str = "in.usda") -> Path:
    (folder / name).write_text(f"#usda 1.0\n{text}")
    return folder / name


def refused(path: Path, match: str, **options: object) -> None:
    with pytest.raises(StageError, match=match):
        open_stage(path, **options)


NESTED = {
    "prims": 'def "a" {\n' * 200_000 + MESH + "}\n" * 200_000,
    "dictionaries": "(customLayerData = " + "{ dictionary a = " * 200_000 + "{ }" + "}" * 200_000 + ")\n" + MESH,
    "tuples": f'def Mesh "M"\n{{\npoint3f[] points = {"(" * 200_000}{")" * 200_000}\n}}\n',
    "behind strings": '"}}}}}" # }}}}\n/* } */ @}@ """\n}\n"""' * 1000 + 'def "a" {\n' * 1500,
    "never closed": "[" * 200_000,
}


@pytest.mark.parametrize("kind", NESTED)
def test_deep_nesting_is_refused_before_usd_reads_it(tmp_path, kind):
    refused(text_file(tmp_path, NESTED[kind]), r"in\.usda: brackets nested more than 1000 deep")


def test_deep_nesting_in_a_layer_is_named_with_who_names_it(tmp_path):
    text_file(tmp_path, NESTED["prims"], "deep.usda")
    path = text_file(tmp_path, f"(subLayers = [@./deep.usda@])\n{MESH}")
    refused(path, r"deep\.usda \(named by .*in\.usda\): brackets nested")


def test_deep_nesting_in_a_package_is_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "in.usdz", "w") as package:
        package.writestr("a.usda", "#usda 1.0\n" + NESTED["prims"])
    refused(tmp_path / "in.usdz", r"in\.usdz\[a\.usda\]: brackets nested")


@pytest.mark.parametrize(
    "text", ['string a = "' + "{" * 5000 + '"\n', "# " + "(" * 5000 + "\n", "/* " + "[" * 5000 + " */\n"]
)
def test_brackets_in_strings_and_comments_are_none(tmp_path, text):
    text = text.replace("{}", "{" * 5000)
    path = text_file(tmp_path, f'def Xform "X"\n{{\n{text}}}\n{MESH}')
    assert open_stage(path).GetPrimAtPath("/M")


def test_references_that_double_at_every_level_are_refused(tmp_path):
    text = MESH.replace('"M"', '"P0"')
    for level in range(1, 40):
        twins = "".join(f'def "{name}" (references = </P{level - 1}>) {{\n}}\n' for name in "xy")
        text += f'def "P{level}"\n{{\n{twins}}}\n'
    refused(text_file(tmp_path, text), "references make more than 20000000 prims")


def test_instances_count_once(tmp_path, monkeypatch):
    monkeypatch.setattr(checks, "MOST_PRIMS", 100)
    cloth = "".join(f'def "part{index}" {{\n}}\n' for index in range(40))
    users = "".join(f'def "u{i}" (instanceable = true\nreferences = </A>) {{\n}}\n' for i in range(20))
    path = text_file(tmp_path, f'def "A"\n{{\n{cloth}}}\n{users}')
    assert open_stage(path)
    refused(
        text_file(tmp_path, path.read_text()[10:].replace("instanceable = true", ""), "b.usda"), "more than 100 prims"
    )


CIRCLES = {
    "reference to itself": f'def "A" (references = @./in.usda@</A>)\n{{\n{MESH}}}\n',
    "references to each other": f'def "A" (references = </B>)\n{{\n}}\ndef "B" (references = </A>)\n{{\n{MESH}}}\n',
    "reference to a parent": f'def "A"\n{{\ndef "B" (references = </A>) {{\n}}\n{MESH}}}\n',
    "inherits in a circle": f'def "A" (inherits = </B>)\n{{\n}}\ndef "B" (inherits = </A>)\n{{\n{MESH}}}\n',
    "layer below itself": f"(subLayers = [@./in.usda@])\n{MESH}",
}


@pytest.mark.parametrize("kind", CIRCLES)
def test_circle_is_named(tmp_path, kind):
    refused(text_file(tmp_path, CIRCLES[kind]), r"in\.usda: .*([Cc]ycle|CANNOT)")


def test_too_many_layers_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(checks, "MOST_LAYERS", 3)
    for index in range(4):
        text_file(tmp_path, "", f"l{index}.usda")
    path = text_file(tmp_path, f"(subLayers = [{', '.join(f'@./l{i}.usda@' for i in range(4))}])\n")
    refused(path, "more than 3 layers")


def test_reference_to_what_is_missing_is_reported(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    stage.OverridePrim("/Root/Prop").GetReferences().AddReference("./gone.usda")
    stage.Save()
    report = simplify_stage(tmp_path / "in.usda", tmp_path / "o.usda", SimplifyOptions(ratio=0.5, device="cpu"))
    assert len(report.problems) == 1
    assert "gone.usda" in report.problems[0]
    assert report.prims[0].status == "simplified"


@pytest.mark.skipif(os.name != "posix", reason="pipes in folders")
def test_layer_that_never_ends_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe.usda")
    refused(text_file(tmp_path, f"(subLayers = [@./pipe.usda@])\n{MESH}"), r"pipe\.usda \(named by .*: no regular file")
    refused(tmp_path / "pipe.usda", "no regular file")


def write_package(path: Path, **info: object) -> None:
    entry = zipfile.ZipInfo(str(info.get("name", "a.usda")))
    entry.compress_type = zipfile.ZIP_DEFLATED if info.get("deflate") else zipfile.ZIP_STORED
    with zipfile.ZipFile(path, "w") as package:
        package.writestr(entry, f"#usda 1.0\n{MESH}" + " " * 10_000_000 * bool(info.get("deflate")))


@pytest.mark.parametrize(
    ("info", "message"),
    [
        ({"deflate": True}, "a.usda in the package is compressed"),
        ({"name": "../../a.usda"}, "names a place outside of it"),
        ({"name": "/etc/a.usda"}, "names a place outside of it"),
    ],
)
def test_package_that_unpacks_to_more_or_elsewhere_is_refused(tmp_path, info, message):
    write_package(tmp_path / "in.usdz", **info)
    refused(tmp_path / "in.usdz", message)


def test_package_that_is_cut_short_is_refused(tmp_path):
    write_package(tmp_path / "in.usdz")
    data = (tmp_path / "in.usdz").read_bytes()
    for size in (0, 4, 40, len(data) - 10):
        (tmp_path / "in.usdz").write_bytes(data[:size])
        refused(tmp_path / "in.usdz", "no package|cannot open")


def test_package_that_lies_about_a_size_is_refused(tmp_path):
    write_package(tmp_path / "in.usdz")
    data = bytearray((tmp_path / "in.usdz").read_bytes())
    central = data.index(b"PK\x01\x02")
    data[central + 20 : central + 28] = (2**31).to_bytes(4, "little") * 2
    (tmp_path / "in.usdz").write_bytes(data)
    refused(tmp_path / "in.usdz", "said to be larger|no package")


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux limits what is mapped")
def test_array_that_unpacks_to_more_than_the_memory_allows_is_named(tmp_path):
    stage = cloth_stage(tmp_path / "in.usdc")
    # Equal numbers: half a gigabyte of them is some hundred kilobytes of a file.
    count = 2**27
    UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth")).GetFaceVertexIndicesAttr().Set(Vt.IntArray(count, 0))
    stage.Save()
    del stage
    assert (tmp_path / "in.usdc").stat().st_size < 2**20
    result = run("simplify", tmp_path / "in.usdc", "-o", tmp_path / "o.usda", "--ratio", 0.5, "--memory", "16M")
    assert result.exit_code == 1
    assert "error: /Root/Cloth: USD fails on a value of it" in result.stderr


@pytest.fixture
def outside(tmp_path) -> Path:
    """An input in a folder, and files beside that folder."""
    for name in ("show", "library", "secret"):
        (tmp_path / name).mkdir()
        cloth_stage(tmp_path / name / "cloth.usda")
        (tmp_path / name / "map.png").write_bytes(b"png")
    return tmp_path


@pytest.mark.parametrize("way", ["reference", "payload in a variant", "sublayer", "texture", "link"])
def test_files_outside_of_the_asset_roots_are_refused(outside, way):
    path = outside / "show" / "in.usda"
    stage = Usd.Stage.CreateNew(str(path))
    define_cloth(stage, "/Cloth")
    place = {"texture": "../secret/map.png", "link": "./link.usda"}.get(way, "../secret/cloth.usda")
    if way == "link":
        (outside / "show" / "link.usda").symlink_to(outside / "secret" / "cloth.usda")
    prim = stage.DefinePrim("/Other")
    if way in ("reference", "link"):
        prim.GetReferences().AddReference(place)
    elif way == "sublayer":
        stage.GetRootLayer().subLayerPaths.append(place)
    elif way == "texture":
        prim.CreateAttribute("file", Sdf.ValueTypeNames.Asset).Set(place)
    else:
        variants = prim.GetVariantSets().AddVariantSet("kind")
        variants.AddVariant("other")
        variants.SetVariantSelection("other")
        with variants.GetVariantEditContext():
            prim.GetPayloads().AddPayload(place)
        variants.ClearVariantSelection()
    stage.Save()
    refused(path, r"secret.* \(named by .*in\.usda\): outside of|link.*: outside of", roots=[outside / "library"])
    assert open_stage(path, roots=[outside / "secret"])
    options = SimplifyOptions(ratio=0.5, device="cpu", asset_roots=(str(outside / "library"),))
    with pytest.raises(StageError, match="outside of"):
        simplify_stage(path, outside / "o.usda", options)


def test_output_that_is_a_layer_of_the_input_is_refused(tmp_path):
    cloth_stage(tmp_path / "geo.usda")
    before = (tmp_path / "geo.usda").read_bytes()
    path = text_file(tmp_path, "(subLayers = [@./geo.usda@])\n")
    with pytest.raises(OptionError, match="never overwritten"):
        simplify_stage(path, tmp_path / "geo.usda", SimplifyOptions(ratio=0.5, device="cpu"))
    assert (tmp_path / "geo.usda").read_bytes() == before


@pytest.mark.parametrize("name", ["with space", "Ünïcode 日本", "quote'\"", "-o", "%s{0}", "[1]*?"])
def test_odd_file_names_work(tmp_path, name):
    (tmp_path / name).mkdir()
    cloth_stage(tmp_path / name / "in.usda")
    output = tmp_path / name / f"{name}.usda"
    report = simplify_stage(tmp_path / name / "in.usda", output, SimplifyOptions(ratio=0.5, device="cpu"))
    assert report.prims[0].status == "simplified"
    stage = Usd.Stage.Open(str(output))
    assert len(UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth")).GetFaceVertexCountsAttr().Get()) in (63, 64)


def test_file_name_that_no_layer_can_hold_is_refused(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    (tmp_path / "in.usda").rename(tmp_path / "new\nline.usda")
    with pytest.raises(StageError, match="no layer can name a file of this name"):
        simplify_stage(tmp_path / "new\nline.usda", tmp_path / "o.usda", SimplifyOptions(ratio=0.5, device="cpu"))
    assert not (tmp_path / "o.usda").exists()


@pytest.mark.parametrize("suffix", [".usda", ".usdc", ".usdz", ".usd"])
@pytest.mark.parametrize("data", [b"", b"\0" * 100, b"PXR-USDC" + b"\xff" * 200, b"#usda 1.0\ndef", b"PK\x03\x04junk"])
def test_garbage_is_refused(tmp_path, suffix, data):
    (tmp_path / f"in{suffix}").write_bytes(data)
    refused(tmp_path / f"in{suffix}", rf"in\{suffix}: ")


def test_report_says_with_what_it_was_made(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    options = SimplifyOptions(ratio=0.5, device="cpu")
    run = simplify_stage(tmp_path / "in.usda", tmp_path / "o.usda", options).to_dict()["run"]
    assert set(run["versions"]) == {"warpqem", "warp", "usd", "numpy", "python"}
    assert (run["device"], run["options"]["ratio"]) == ("cpu", 0.5)
    assert run["seconds"] > 0
