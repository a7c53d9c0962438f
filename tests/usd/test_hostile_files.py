"""Files that would end, fill or block a process that trusts them."""

from __future__ import annotations

import os
import socket
import sys
import zipfile
from pathlib import Path

import pytest
from pxr import Sdf, Usd, UsdGeom

from tests.support.cli import run
from tests.support.hostile_files import MESH, NESTED, refused, text_file
from tests.support.usd_stages import cloth_stage, define_cloth
from warpqem.batching.fingerprint import take_fingerprint
from warpqem.batching.jobs import BatchJob
from warpqem.errors import OptionError, StageError
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.checks import input_check as checks
from warpqem.usd.read.open_stage import open_stage


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
    monkeypatch.setattr(checks, "MAX_PRIMS", 100)
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
    monkeypatch.setattr(checks, "MAX_LAYERS", 3)
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


CLOTH_CLIP = "int[] faceVertexCounts = [3]\nint[] faceVertexIndices = [0, 1, 2]\n"


def clip_file(folder: Path, clips: str, name: str = "in.usda") -> Path:
    """A mesh whose points come from value clips; clip.usda holds such points, and manifest.usda says so."""
    samples = "{1: [(0,0,0),(1,0,0),(0,1,0)], 2: [(0,0,0),(1,0,0),(0,2,0)]}"
    text_file(folder, f'over "M"\n{{\npoint3f[] points.timeSamples = {samples}\n}}\n', "clip.usda")
    text_file(folder, 'over "M"\n{\npoint3f[] points\n}\n', "manifest.usda")
    times = "double2[] active = [(1, 0)]\ndouble2[] times = [(1, 1), (2, 2)]\n"
    settings = f'dictionary default = {{\n{clips}\nstring primPath = "/M"\n{times}}}'
    return text_file(folder, f'def Mesh "M" (\nclips = {{\n{settings}\n}}\n)\n{{\n{CLOTH_CLIP}}}\n', name)


MANIFEST = "asset manifestAssetPath = @./manifest.usda@\n"


def odd_files(folder: Path) -> dict[str, str]:
    """Paths of what is no regular file, and what an error calls it."""
    os.mkfifo(folder / "pipe.usda")
    (folder / "folder.usda").mkdir()
    with socket.socket(socket.AF_UNIX) as server:
        # The path of a socket may have no more than some hundred characters.
        before = os.getcwd()
        os.chdir(folder)
        server.bind("socket.usda")
        os.chdir(before)
    (folder / "round.usda").symlink_to("round.usda")
    (folder / "device.usda").symlink_to("/dev/zero")
    (folder / "memory.usda").symlink_to("/proc/self/mem")
    kinds = {"pipe": "a pipe", "folder": "a folder", "socket": "a socket", "round": "a path that leads nowhere"}
    kinds |= {"device": "a device", "memory": "made up by the system"}
    return {f"{name}.usda": kind for name, kind in kinds.items()}


ODD_NAMES = ["pipe.usda", "folder.usda", "socket.usda", "round.usda", "device.usda", "memory.usda"]
only_linux = pytest.mark.skipif(sys.platform != "linux", reason="pipes, devices and /proc")


@only_linux
@pytest.mark.parametrize("name", ODD_NAMES)
@pytest.mark.parametrize(
    "role", ["input", "layer", "layer with arguments", "expression", "clip", "manifest", "template"]
)
def test_what_is_no_regular_file_is_named_with_who_names_it(tmp_path, name, role):
    kind = odd_files(tmp_path)[name]
    stem = name.removesuffix(".usda")
    if role == "input":
        refused(tmp_path / name, f"{name}: no regular file, but {kind}")
        return
    if role in ("clip", "manifest", "template"):
        (tmp_path / "c.1.usda").symlink_to(name)
        template = 'string templateAssetPath = "./c.#.usda"\ndouble templateStartTime = 1\n'
        template += "double templateEndTime = 3\ndouble templateStride = 1\n"
        clips = {
            "clip": f"asset[] assetPaths = [@./{name}@]",
            "manifest": f"asset manifestAssetPath = @./{name}@\nasset[] assetPaths = [@./clip.usda@]",
            "template": template,
        }[role]
        by = r"value clip of /M, clips 'default' in .*in\.usda"
        refused(
            clip_file(tmp_path, clips), rf"{'c.1.usda' if role == 'template' else name} \({by}\): no regular .*{kind}"
        )
        return
    layer = {"layer": name, "layer with arguments": f"{name}:SDF_FORMAT_ARGS:a=b", "expression": '`"${N}.usda"`'}[role]
    layer = layer if role == "expression" else f"./{layer}"
    head = f'expressionVariables = {{\nstring N = "./{stem}"\n}}\n' if role == "expression" else ""
    path = text_file(tmp_path, f"({head}subLayers = [@{layer}@])\n{MESH}")
    refused(path, rf"{name} \(named by .*in\.usda\): no regular file, but {kind}")


@only_linux
def test_texture_that_is_no_regular_file_is_noted_with_prim_and_attribute(tmp_path):
    kinds = odd_files(tmp_path)
    stage = cloth_stage(tmp_path / "in.usda")
    prim = stage.GetPrimAtPath("/Root/Cloth")
    for index, name in enumerate(kinds):
        attribute = prim.CreateAttribute(f"a{index}", Sdf.ValueTypeNames.Asset)
        attribute.Set(f"./{name}", *([1.0] if index % 2 else []))
    prim.CreateAttribute("tiles", Sdf.ValueTypeNames.AssetArray).Set([Sdf.AssetPath("./t.<UDIM>.png")])
    os.mkfifo(tmp_path / "t.1001.png")
    stage.Save()
    report = simplify_stage(tmp_path / "in.usda", tmp_path / "o.usda", SimplifyOptions(ratio=0.5, device="cpu"))
    assert report.prims[0].status == "simplified"
    assert len(report.problems) == len(kinds) + 1
    for index, kind in enumerate(kinds.values()):
        assert any(f"/Root/Cloth.a{index} in " in text and f"but {kind}" in text for text in report.problems)
    assert any("/Root/Cloth.tiles" in text and "a pipe" in text for text in report.problems)
    assert "note: /Root/Cloth.tiles in" in run("info", tmp_path / "in.usda").stderr
    # Neither does the fingerprint of a batch, nor the look at where files are, open them.
    job = BatchJob(str(tmp_path / "in.usda"), str(tmp_path / "o.usda"), SimplifyOptions(ratio=0.5))
    files = take_fingerprint(job)["files"]
    assert {files[str(tmp_path / name)] for name in ("pipe.usda", "memory.usda", "t.1001.png")} == {None}
    refused(tmp_path / "in.usda", "/dev/zero|outside of", roots=[tmp_path])


def test_clips_count_as_files_of_the_input(tmp_path):
    path = clip_file(tmp_path, MANIFEST + "asset[] assetPaths = [@./clip.usda@, @./gone.usda@]")
    files = take_fingerprint(BatchJob(str(path), str(tmp_path / "o.usda"), SimplifyOptions(ratio=0.5)))["files"]
    assert [Path(name).name for name in files] == ["clip.usda", "gone.usda", "in.usda", "manifest.usda"]
    assert files[str(tmp_path / "gone.usda")] is None
    assert "gone.usda (value clip of /M, clips 'default' in" in run("info", path).stderr


@pytest.mark.parametrize("times", ["1, 1e9, 1", "0, 1, 1e-9", "1, inf, 1", "-inf, 1, 1", "1e17, 1e17, 1", "1, 2, nan"])
def test_template_of_clips_without_an_end_is_refused(tmp_path, times):
    start, end, stride = times.split(", ")
    clips = f'string templateAssetPath = "./c.###.usda"\ndouble templateStartTime = {start}\n'
    path = clip_file(tmp_path, clips + f"double templateEndTime = {end}\ndouble templateStride = {stride}")
    refused(path, r"in\.usda: /M, clips 'default': a template with times from .* more than 1000000 files")


def test_damaged_clip_is_named_before_a_value_is_read(tmp_path):
    (tmp_path / "bad.usdc").write_bytes(b"PXR-USDC" + b"\xff" * 200)
    path = clip_file(tmp_path, MANIFEST + "asset[] assetPaths = [@./bad.usdc@]")
    refused(path, r"bad\.usdc \(value clip of /M, clips 'default' in .*in\.usda\): USD cannot open it")
    text_file(tmp_path, NESTED["prims"], "deep.usda")
    refused(clip_file(tmp_path, MANIFEST + "asset[] assetPaths = [@./deep.usda@]"), "brackets nested")


@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
@pytest.mark.parametrize("rate", ["timeCodesPerSecond", "framesPerSecond"])
def test_rates_that_are_no_numbers_are_named(tmp_path, rate, value):
    path = text_file(tmp_path, f"(\n    {rate} = {value}\n)\n")
    # USD's own parser refuses some of them.
    refused(path, rf"in\.usda: ({rate} is {value}$|USD cannot open it \(line 3, column 5: invalid value for field)")


def test_rate_of_a_binary_file_that_is_no_number_is_named(tmp_path):
    layer = Sdf.Layer.CreateNew(str(tmp_path / "in.usdc"))
    layer.timeCodesPerSecond = float("nan")
    layer.Save()
    del layer
    refused(tmp_path / "in.usdc", r"in\.usdc: timeCodesPerSecond is nan$")


@pytest.fixture
def outside(tmp_path) -> Path:
    """An input in a folder, and files beside that folder."""
    for name in ("show", "library", "secret"):
        (tmp_path / name).mkdir()
        cloth_stage(tmp_path / name / "cloth.usda")
        (tmp_path / name / "map.png").write_bytes(b"png")
    return tmp_path


@pytest.mark.parametrize(
    "way", ["reference", "payload in a variant", "sublayer", "texture", "expression", "address", "link"]
)
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
    elif way == "address":
        prim.CreateAttribute("file", Sdf.ValueTypeNames.Asset).Set(f"file://{outside}/secret/map.png")
    elif way == "expression":
        stage.GetRootLayer().expressionVariables = {"WHERE": "../secret"}
        prim.CreateAttribute("file", Sdf.ValueTypeNames.Asset).Set('`"${WHERE}/map.png"`')
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
