"""Small meshes of a stage are read, simplified and written in groups, each as if it were alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Usd, UsdGeom, Vt

from tests.support import meshes
from tests.support.usd_topology_runs import define_capture
from warpqem.errors import CancelledError
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.commands import small_meshes
from warpqem.usd.commands.run import Run

SMALL, LARGE = meshes.bumpy_sphere(2), meshes.bumpy_sphere(3)


@pytest.fixture
def stage_file(tmp_path) -> Path:
    """/S/M0 to /S/M6: small meshes, but M3 has 1280 faces, and the topology of M5 varies."""
    path = tmp_path / "in.usda"
    stage = Usd.Stage.CreateNew(str(path))
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/S").GetPrim())
    for index in range(7):
        name = f"/S/M{index}"
        if index == 5:
            define_capture(stage, [6, 8], 2, path=name)
            continue
        points, faces = LARGE if index == 3 else SMALL
        mesh = UsdGeom.Mesh.Define(stage, name)
        mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy((points * [1, 1, 1 + 0.1 * index]).astype(np.float32)))
        mesh.CreateFaceVertexCountsAttr([3] * len(faces))
        mesh.CreateFaceVertexIndicesAttr(np.asarray(faces).ravel().tolist())
        mesh.CreateSubdivisionSchemeAttr("none")
    stage.Save()
    return path


def run(path: Path, **keywords: Any) -> Any:
    options = SimplifyOptions(ratio=0.25, quality="fast", device="cpu")
    return simplify_stage(path, path.with_name("out.usda"), options, **keywords)


def outcome(path: Path) -> tuple[Any, bytes]:
    report = run(path)
    # The plan has the free memory.
    found = [
        {name: value for name, value in vars(prim).items() if name not in ("seconds", "plan")} for prim in report.prims
    ]
    return found, path.with_name("out.usda").read_bytes()


def mesh_at(given: Any) -> str:
    """The path of a prim, or of the mesh of a job or of a result."""
    if isinstance(given, Usd.Prim):
        return str(given.GetPath())
    path: str = getattr(given, "job", given).mesh.path
    return path


@pytest.mark.parametrize("size", [1, 2, 3])
def test_what_comes_of_meshes_does_not_depend_on_their_group(size, stage_file, monkeypatch):
    together = outcome(stage_file)
    assert [prim["status"] for prim in together[0]] == ["simplified"] * 7
    monkeypatch.setattr(small_meshes, "MAX_TOGETHER", size)
    assert outcome(stage_file) == together


@pytest.mark.parametrize(("memory", "most"), [(None, 128), ("8G", 128), ("40M", 10), ("1M", 1)])
def test_a_group_takes_a_part_of_a_limited_memory(memory, most):
    assert small_meshes._most_together(memory) == most


def test_each_step_of_a_group_comes_before_the_next_one_and_other_meshes_between_groups(stage_file, monkeypatch):
    steps = []

    def note(name):
        call = getattr(Run, name)

        def noted(self, given, *arguments, **options):
            steps.append((name, mesh_at(given)))
            return call(self, given, *arguments, **options)

        monkeypatch.setattr(Run, name, noted)

    for name in ("read", "simplify_read", "write"):
        note(name)
    run(stage_file)
    group = [(name, f"/S/M{index}") for name in ("simplify_read", "write") for index in range(3)]
    read = [("read", f"/S/M{index}") for index in range(4)]
    assert steps[:12] == [*read, *group, ("simplify_read", "/S/M3"), ("write", "/S/M3")]
    assert steps[-3:] == [(name, "/S/M6") for name in ("read", "simplify_read", "write")]


@pytest.mark.parametrize("name", ["read", "simplify_read", "write"])
def test_an_error_in_a_step_is_that_of_its_mesh_alone(name, stage_file, monkeypatch):
    whole = {prim.path: prim.measured for prim in run(stage_file).prims}
    call = getattr(Run, name)

    def broken(self, given, *arguments, **options):
        found = call(self, given, *arguments, **options)
        if mesh_at(given) == "/S/M1":
            raise IndexError("odd")
        return found

    monkeypatch.setattr(Run, name, broken)
    report = run(stage_file)
    assert [prim.status for prim in report.prims] == ["simplified", "failed", *["simplified"] * 5]
    assert report.prims[1].message.startswith("/S/M1: unexpected error while ")
    assert report.prims[1].message.endswith(": IndexError: odd")
    assert [prim.measured for prim in report.prims] == [
        None if path == "/S/M1" else measured for path, measured in whole.items()
    ]
    written = Usd.Stage.Open(str(stage_file.with_name("out.usda")))
    shown = UsdGeom.Mesh(written.GetPrimAtPath("/S/M1"))
    assert len(shown.GetFaceVertexCountsAttr().Get()) == len(SMALL[1])


def test_progress_goes_on_through_groups(stage_file):
    seen = []
    run(stage_file, progress=lambda fraction, text: seen.append((fraction, text)))
    fractions = [fraction for fraction, _ in seen]
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0
    assert any("M2 (3 of 7): writing the simplified mesh, 320 faces x 1 frames" in text for _, text in seen)


def test_a_run_ends_within_a_group(stage_file):
    def stop(fraction: float, text: str) -> None:
        if "M1" in text and "writing" in text:
            raise CancelledError("enough")

    with pytest.raises(CancelledError):
        run(stage_file, progress=stop)
    assert not stage_file.with_name("out.usda").exists()
    assert [path.name for path in stage_file.parent.iterdir()] == ["in.usda"]
