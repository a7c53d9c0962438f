"""Errors that nobody foresees: they are the failure of one mesh, with its name, and the others go on."""

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom

import warpqem
from tests.support.usd_stages import cloth_stage, define_cloth
from warpqem.errors import StageError
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.read.inspect import inspect_stage
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.write.attribute_transfer import AttributeTransfer

SMALL = "/Root/Small"


@pytest.fixture
def two_meshes(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    define_cloth(stage, SMALL, size=5, times=[1.0, 2.0])
    stage.Save()
    return tmp_path


def break_small(monkeypatch, where, name, error):
    """Make a method or function fail for the small mesh."""
    real = getattr(where, name)

    def broken(*arguments, **options):
        held = arguments[0] if isinstance(where, type) and name == "points_at" else arguments[1]
        if getattr(held, "path", None) == SMALL or (isinstance(held, np.ndarray) and len(held) == 50):
            raise error
        return real(*arguments, **options)

    monkeypatch.setattr(where, name, broken)


def simplified(folder, **options):
    return simplify_stage(folder / "in.usda", folder / "out.usda", SimplifyOptions(device="cpu", ratio=0.5, **options))


def test_unexpected_error_is_the_failure_of_its_mesh(two_meshes, monkeypatch):
    break_small(monkeypatch, warpqem, "simplify", IndexError("index 28 is out of bounds"))
    report = simplified(two_meshes)
    [failed] = report.failed
    assert failed.path == SMALL
    assert failed.message.startswith(f"{SMALL}: unexpected error while reading the mesh: IndexError: index 28 is out")
    assert [prim.status for prim in report.prims] == ["simplified", "failed"]


def test_unexpected_error_of_writing_leaves_the_mesh_as_it_was(two_meshes, monkeypatch, flatten):
    real = AttributeTransfer.corners

    def broken(self, *arguments, **options):
        if str(self.prim.GetPath()) == SMALL:
            raise KeyError("odd")
        return real(self, *arguments, **options)

    stage = Usd.Stage.Open(str(two_meshes / "in.usda"))
    kind = Sdf.ValueTypeNames.TexCoord2fArray
    primvar = UsdGeom.PrimvarsAPI(stage.GetPrimAtPath(SMALL)).CreatePrimvar("st", kind, "faceVarying")
    primvar.Set(np.arange(200, dtype=np.float32).reshape(100, 2))
    stage.Save()
    monkeypatch.setattr(AttributeTransfer, "corners", broken)
    report = simplified(two_meshes, flatten=flatten)
    assert "while writing the simplified mesh: KeyError" in report.failed[0].message
    stages = [stage, Usd.Stage.Open(str(two_meshes / "out.usda"))]
    for name in ("points", "faceVertexIndices", "primvars:st"):
        values = [one.GetPrimAtPath(SMALL).GetAttribute(name).Get(2.0) for one in stages]
        assert list(values[0]) == list(values[1]), name


def test_strict_ends_at_an_unexpected_error(two_meshes, monkeypatch):
    break_small(monkeypatch, warpqem, "simplify", ZeroDivisionError("division by zero"))
    with pytest.raises(StageError, match=rf"{SMALL}: unexpected error .*ZeroDivisionError: division by zero"):
        simplified(two_meshes, strict=True)
    assert not (two_meshes / "out.usda").exists()


@pytest.mark.parametrize("error", [KeyboardInterrupt, MemoryError])
def test_interruption_and_lack_of_memory_end_the_run(error, two_meshes, monkeypatch):
    break_small(monkeypatch, warpqem, "simplify", error())
    with pytest.raises(error):
        simplified(two_meshes)


def test_info_names_the_mesh_of_an_unexpected_error(two_meshes, monkeypatch):
    break_small(monkeypatch, MeshSource, "points_at", IndexError("index 3"))
    infos = inspect_stage(two_meshes / "in.usda")
    assert [len(info.problems) for info in infos] == [0, 1]
    assert infos[1].problems == [f"{SMALL}: unexpected error while reading it: IndexError: index 3"]
