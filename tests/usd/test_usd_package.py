"""Packages (.usdz), textures of flat files, and levels as a file each."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path

import pytest
from pxr import Sdf, Usd, UsdGeom, UsdShade, UsdUtils
from typer.testing import CliRunner

from tests.support.usd_checks import check_stage
from tests.support.usd_findings import nvidia_findings, usd_findings
from tests.support.usd_stages import cloth_stage, instanced_stage
from tests.support.usd_validators import new_findings
from warpqem.cli.app import app
from warpqem.errors import OptionError, StageError
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.read.copy_asset import copy_asset
from warpqem.usd.write import package as package_module

CLOTH, FRAMES = "/Root/Cloth", [1.0, 2.0, 4.0]
# Textures by their names from the input: two of one name, tiles, and one of a kind that no package may have.
TEXTURES = ("skin.png", "maps/skin.png", "tile.<UDIM>.png", "cloth.tif")
FILES = ("skin.png", "maps/skin.png", "tile.1001.png", "tile.1002.png", "cloth.tif")


def textured_stage(folder: Path, suffix: str = ".usda") -> Path:
    """A moving cloth with textures, as a file or a package; each texture holds its own name."""
    (folder / "maps").mkdir(parents=True)
    for name in FILES:
        (folder / name).write_text(name)
    stage = cloth_stage(folder / "in.usda", times=FRAMES)
    material = UsdShade.Material.Define(stage, "/Root/Look")
    for index, name in enumerate(TEXTURES):
        shader = UsdShade.Shader.Define(stage, f"/Root/Look/Texture{index}")
        shader.CreateIdAttr("UsdUVTexture")
        shader.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(Sdf.AssetPath(f"./{name}"))
    UsdShade.MaterialBindingAPI.Apply(stage.GetPrimAtPath(CLOTH)).Bind(material)
    stage.GetRootLayer().Save()
    if suffix == ".usdz":
        UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(folder / "in.usda")), str(folder / "in.usdz"))
    return folder / f"in{suffix}"


def texture_texts(stage: Usd.Stage) -> list[str]:
    """What the textures hold, in the order of TEXTURES; of tiles the first one."""
    texts = []
    for index in range(len(TEXTURES)):
        value = stage.GetPrimAtPath(f"/Root/Look/Texture{index}").GetAttribute("inputs:file").Get()
        layer = stage.GetRootLayer()
        place = Sdf.ComputeAssetPathRelativeToLayer(layer, value.path.replace("<UDIM>", "1001"))
        outer, _, inner = place.partition("[")
        if inner:
            texts.append(zipfile.ZipFile(outer).read(inner.removesuffix("]")).decode())
        else:
            texts.append(Path(place).read_text())
    return texts


def simplified(source: Path, output: Path, **options: object):
    return simplify_stage(source, output, SimplifyOptions(**{"ratio": 0.5, "device": "cpu", **options}))


@pytest.mark.parametrize("suffix", [".usda", ".usdz"])
def test_package_holds_all_that_it_needs(tmp_path, suffix):
    source = textured_stage(tmp_path / "in", suffix)
    report = simplified(source, tmp_path / "out.usdz")
    (tmp_path / "in").rename(tmp_path / "gone")
    stage = Usd.Stage.Open(str(tmp_path / "out.usdz"))
    check_stage(stage)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH))
    assert len(mesh.GetFaceVertexCountsAttr().Get()) == report.prims[0].faces_after == 64
    assert mesh.GetPointsAttr().GetTimeSamples() == [float(time) for time in FRAMES]
    assert texture_texts(stage) == ["skin.png", "maps/skin.png", "tile.1001.png", "cloth.tif"]


def test_package_follows_the_specification(tmp_path):
    simplified(textured_stage(tmp_path / "in"), tmp_path / "out.usdz")
    data = (tmp_path / "out.usdz").read_bytes()
    with zipfile.ZipFile(tmp_path / "out.usdz") as archive:
        entries = archive.infolist()
    assert entries[0].filename == "out.usdc"
    assert sorted(entry.filename for entry in entries[1:]) == sorted(
        ["textures/skin.png", "textures/2_skin.png", "textures/tile.1001.png", "textures/tile.1002.png",
         "textures/cloth.tif"]
    )  # fmt: skip
    for entry in entries:
        assert entry.compress_type == zipfile.ZIP_STORED
        start = entry.header_offset
        name, extra = (int.from_bytes(data[start + at : start + at + 2], "little") for at in (26, 28))
        assert (start + 30 + name + extra) % 64 == 0


def test_texture_that_packages_may_not_have_is_named(tmp_path):
    report = simplified(textured_stage(tmp_path / "in"), tmp_path / "out.usdz")
    [problem] = report.problems
    assert "textures/cloth.tif: no kind of file" in problem


def test_package_has_the_same_bytes_on_every_run(tmp_path):
    source = textured_stage(tmp_path / "in")
    packages = []
    for _ in range(2):
        simplified(source, tmp_path / "out.usdz")
        packages.append((tmp_path / "out.usdz").read_bytes())
        (tmp_path / "in" / "skin.png").touch()
    assert packages[0] == packages[1]


@pytest.mark.parametrize("find", [usd_findings, nvidia_findings])
@pytest.mark.parametrize("options", [{}, {"ratio": None, "lods": (0.5, 0.2)}], ids=["flat", "lods"])
def test_validators_find_nothing_new_in_a_package(tmp_path, find, options):
    source = textured_stage(tmp_path / "in")
    for name in ("in/cloth.tif", "in/tile.1002.png"):
        (tmp_path / name).unlink()
    layer = Sdf.Layer.FindOrOpen(str(source))
    layer.GetAttributeAtPath("/Root/Look/Texture3.inputs:file").default = Sdf.AssetPath("./skin.png")
    layer.Save()
    simplified(source, tmp_path / "out.usdz", **options)
    found = new_findings(source, tmp_path / "out.usdz", find)
    # Its place is the layer's, which has another name in the package.
    assert {key for key in found if key[0] != "UsdAsciiPerformanceChecker"} == set()


def test_levels_in_a_package_are_variants(tmp_path):
    source = textured_stage(tmp_path / "in")
    simplified(source, tmp_path / "out.usdz", ratio=None, lods=(0.5, 0.25))
    (tmp_path / "in").rename(tmp_path / "gone")
    stage = Usd.Stage.Open(str(tmp_path / "out.usdz"))
    for name, count in (("LOD0", 64), ("LOD1", 64), ("LOD2", 32)):
        stage.GetPrimAtPath("/Root").GetVariantSet("LOD").SetVariantSelection(name)
        assert len(UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH)).GetFaceVertexCountsAttr().Get()) == count
        check_stage(stage)


def test_missing_texture_is_named_and_the_rest_is_packed(tmp_path):
    source = textured_stage(tmp_path / "in")
    (tmp_path / "in" / "skin.png").unlink()
    report = simplified(source, tmp_path / "out.usdz", ratio=None, lods=(0.5,))
    assert any("skin.png: missing" in problem for problem in report.problems)
    with zipfile.ZipFile(tmp_path / "out.usdz") as archive:
        assert any(name.endswith("tile.1002.png") for name in archive.namelist())


def test_package_that_is_the_input_is_not_overwritten(tmp_path):
    source = textured_stage(tmp_path / "in", ".usdz")
    with pytest.raises(OptionError, match="never overwritten"):
        simplified(source, source)


def test_package_that_a_layer_of_the_input_lies_in_is_not_overwritten(tmp_path):
    source = textured_stage(tmp_path / "in", ".usdz")
    shot = Usd.Stage.CreateNew(str(tmp_path / "shot.usda"))
    shot.DefinePrim("/Root").GetReferences().AddReference("./in/in.usdz", "/Root")
    shot.GetRootLayer().Save()
    before = source.read_bytes()
    with pytest.raises(OptionError, match="never overwritten"):
        simplified(tmp_path / "shot.usda", source)
    assert source.read_bytes() == before


def test_nothing_is_left_behind_when_a_package_cannot_be_written(tmp_path, monkeypatch):
    source = textured_stage(tmp_path / "in")
    (tmp_path / "out").mkdir()
    monkeypatch.setattr(package_module, "MAX_BYTES", 100)
    with pytest.raises(StageError, match=r"out\.usdz: the files of the package have \d+ bytes"):
        simplified(source, tmp_path / "out" / "out.usdz")
    assert list((tmp_path / "out").iterdir()) == []


def test_flat_file_of_a_package_needs_no_package(tmp_path):
    source = textured_stage(tmp_path / "in", ".usdz")
    (tmp_path / "out").mkdir()
    simplified(source, tmp_path / "out" / "flat.usdc", flatten=True)
    (tmp_path / "in").rename(tmp_path / "gone")
    (tmp_path / "out").rename(tmp_path / "moved")
    stage = Usd.Stage.Open(str(tmp_path / "moved" / "flat.usdc"))
    assert texture_texts(stage) == ["skin.png", "maps/skin.png", "tile.1001.png", "cloth.tif"]
    assert sorted(path.name for path in (tmp_path / "moved" / "flat_textures").iterdir()) == sorted(
        ["skin.png", "2_skin.png", "tile.1001.png", "tile.1002.png", "cloth.tif"]
    )


def test_flat_file_takes_textures_of_other_folders_along(tmp_path):
    source = textured_stage(tmp_path / "in")
    (tmp_path / "out").mkdir()
    simplified(source, tmp_path / "out" / "flat.usda", flatten=True)
    (tmp_path / "in").rename(tmp_path / "gone")
    stage = Usd.Stage.Open(str(tmp_path / "out" / "flat.usda"))
    assert texture_texts(stage) == ["skin.png", "maps/skin.png", "tile.1001.png", "cloth.tif"]


def test_flat_file_leaves_textures_beside_it_where_they_are(tmp_path):
    source = textured_stage(tmp_path / "in")
    simplified(source, source.with_name("flat.usda"), flatten=True)
    assert not source.with_name("flat_textures").exists()
    assert texture_texts(Usd.Stage.Open(str(source.with_name("flat.usda"))))[1] == "maps/skin.png"


def test_texture_of_a_flat_file_never_takes_the_place_of_one_that_is_read(tmp_path):
    source = textured_stage(tmp_path / "in")
    (tmp_path / "out").mkdir()
    # What is written as out/flat_textures/skin.png would be written through this link.
    (tmp_path / "out" / "flat_textures").symlink_to(tmp_path / "in", target_is_directory=True)
    with pytest.raises(OptionError, match=r"texture .*: this is a texture of .*never overwritten"):
        simplified(source, tmp_path / "out" / "flat.usda", flatten=True)
    assert (tmp_path / "in" / "skin.png").read_text() == "skin.png"
    assert not (tmp_path / "out" / "flat.usda").exists()


@pytest.mark.parametrize("flatten", [False, True])
@pytest.mark.parametrize("suffix", [".usda", ".usdc", ".usdz"])
def test_levels_as_files_equal_what_their_ratios_alone_give(tmp_path, suffix, flatten):
    source = textured_stage(tmp_path / "in")
    report = simplified(
        source, tmp_path / f"out{suffix}", ratio=None, lods=(0.5, 0.25), lod_files=True, flatten=flatten
    )
    assert report.outputs == [str(tmp_path / f"out_LOD{level}{suffix}") for level in (1, 2)]
    assert not (tmp_path / f"out{suffix}").exists()
    for level, ratio in ((1, 0.5), (2, 0.25)):
        simplified(source, tmp_path / f"alone{suffix}", ratio=ratio, flatten=flatten)
        stages = [Usd.Stage.Open(str(tmp_path / f"{name}{suffix}")) for name in (f"out_LOD{level}", "alone")]
        points = [UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH)).GetPointsAttr() for stage in stages]
        assert [list(item.Get(time)) for time in FRAMES for item in points[:1]] == [
            list(item.Get(time)) for time in FRAMES for item in points[1:]
        ]
        check_stage(stages[0])
        del stages, points


def test_level_file_that_is_read_is_not_overwritten(tmp_path):
    source = textured_stage(tmp_path / "in")
    source = source.rename(source.with_name("cloth_LOD1.usda"))
    with pytest.raises(OptionError, match=r"cloth_LOD1\.usda: this is the input"):
        simplified(source, source.with_name("cloth.usda"), ratio=None, lods=(0.5,), lod_files=True)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"lod_files": True}, "lod_files needs lods"),
        ({"ratio": None, "lods": (0.5,), "lod_files": True, "usd_lod": True}, "exclude each other"),
        ({"ratio": None, "lods": (0.5,), "flatten": True}, "exclude each other"),
    ],
)
def test_level_files_exclude_other_ways(options, message):
    with pytest.raises(OptionError, match=message):
        SimplifyOptions(**{"ratio": 0.5, **options})


def test_other_commands_refuse_packages_by_name(tmp_path):
    source = textured_stage(tmp_path / "in")
    for arguments in (
        ["features", source, "-o", tmp_path / "out.usdz"],
        ["compare", source, source, "--heatmap", tmp_path / "out.usdz"],
    ):
        result = CliRunner().invoke(app, list(map(str, arguments)))
        assert result.exit_code == 2
        assert "simplify and batch write packages" in result.stderr


def test_batch_writes_packages_and_resumes_over_level_files(tmp_path):
    source = textured_stage(tmp_path / "in")
    arguments = ["batch", source, "-o", tmp_path / "out", "--device", "cpu", "--jobs", "1", "--json", "-"]

    def statuses(*more: object) -> list[str]:
        result = CliRunner().invoke(app, list(map(str, [*arguments, *more])))
        assert result.exit_code == 0, result.output
        return [json.loads(line)["status"] for line in result.stdout.splitlines()]

    assert statuses("--ratio", "0.5", "--format", "usdz") == ["done"]
    assert Usd.Stage.Open(str(tmp_path / "out" / "in.usdz")).GetPrimAtPath(CLOTH)
    levels = ("--lods", "0.5,0.25", "--lod-files", "--resume")
    assert [statuses(*levels), statuses(*levels)] == [["done"], ["skipped"]]
    (tmp_path / "out" / "in_LOD2.usda").unlink()
    assert statuses(*levels) == ["done"]


@pytest.mark.parametrize("suffix", [".usda", ".usdz"])
@pytest.mark.parametrize(
    ("output", "options"),
    [("o.usda", {"flatten": True}), ("o.usdz", {}), ("o.usdz", {"ratio": None, "lods": (0.5, 0.2)})],
    ids=["flat", "package", "levels"],
)
def test_texture_of_a_name_that_is_not_ascii_comes_along(tmp_path, suffix, output, options):
    (tmp_path / "in").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "in" / "Köper 布.png").write_text("woven")
    stage = cloth_stage(tmp_path / "in" / "in.usda")
    texture = stage.DefinePrim("/Root/Texture")
    texture.CreateAttribute("file", Sdf.ValueTypeNames.Asset).Set(Sdf.AssetPath("./Köper 布.png"))
    stage.Save()
    source = tmp_path / "in" / f"in{suffix}"
    if suffix == ".usdz":
        UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(tmp_path / "in" / "in.usda")), str(source))
    simplified(source, tmp_path / "out" / output, **options)
    (tmp_path / "in").rename(tmp_path / "gone")
    written = Usd.Stage.Open(str(tmp_path / "out" / output))
    found = written.GetAttributeAtPath("/Root/Texture.file").Get()
    copy = io.BytesIO()
    copy_asset(found.resolvedPath, copy)
    assert copy.getvalue() == b"woven"


def test_note_of_a_package_does_not_name_classes_that_it_lacks(tmp_path):
    instanced_stage(tmp_path / "in.usda")
    report = simplified(tmp_path / "in.usda", tmp_path / "out.usdz")
    assert report.output
    assert not any("come from the class" in note for note in report.notes)
    layered = simplified(tmp_path / "in.usda", tmp_path / "out.usda")
    assert any("come from the class" in note for note in layered.notes)
