"""Packages and arrays that would fill a process that trusts what they say of their size."""

from __future__ import annotations

import sys
import zipfile
from pathlib import Path

import pytest
from pxr import Sdf, Usd, UsdGeom, Vt

from tests.support.cli import run
from tests.support.hostile_files import MESH, NESTED, refused, text_file
from tests.support.usd_stages import cloth_stage
from warpqem.usd.read.open_stage import open_stage


def packed(path: Path, **files: bytes) -> bytes:
    """A package as USD writes it, with the files by the part of their name before the suffix."""
    writer = (
        Sdf.ZipFileWriter.CreateNew(str(path))
        if hasattr(Sdf, "ZipFileWriter")
        else Usd.ZipFileWriter.CreateNew(str(path))
    )
    for name, data in files.items():
        suffix = "usdz" if data.startswith(b"PK") else "usda"
        (path.parent / f"{name}.tmp").write_bytes(data)
        writer.AddFile(str(path.parent / f"{name}.tmp"), f"{name}.{suffix}")
    writer.Save()
    return path.read_bytes()


ROOT = b"#usda 1.0\n(subLayers = [@./inner.usdz@])\n"


def test_package_in_a_package_is_read(tmp_path):
    inner = packed(tmp_path / "p.usdz", g=f"#usda 1.0\n{MESH}".encode())
    packed(tmp_path / "in.usdz", root=ROOT, inner=inner)
    assert open_stage(tmp_path / "in.usdz").GetPrimAtPath("/M")
    path = text_file(tmp_path, "(subLayers = [@./in.usdz[inner.usdz[g.usda]]@])\n")
    assert open_stage(path).GetPrimAtPath("/M")


def test_what_is_wrong_in_a_package_in_a_package_is_named(tmp_path):
    deep = packed(tmp_path / "p.usdz", g=b"#usda 1.0\n" + NESTED["prims"].encode())
    packed(tmp_path / "in.usdz", root=ROOT, inner=deep)
    refused(tmp_path / "in.usdz", r"in\.usdz\[inner\.usdz\[g\.usda\]\]: brackets nested")
    packed(tmp_path / "in.usdz", root=ROOT, inner=deep[: len(deep) // 2])
    refused(tmp_path / "in.usdz", r"in\.usdz\[inner\.usdz\]: no package that could be read")
    text_file(tmp_path, "(subLayers = [@./in.usdz@])\n")
    refused(tmp_path / "in.usda", r"in\.usdz\[inner\.usdz\] \(named by .*in\.usda\): no package that could be read")


def test_packages_in_each_other_end(tmp_path):
    data = packed(tmp_path / "in.usdz", g=f"#usda 1.0\n{MESH}".encode())
    for _ in range(20):
        data = packed(tmp_path / "in.usdz", inner=data)
    refused(tmp_path / "in.usdz", "more than 16 packages in each other")


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
