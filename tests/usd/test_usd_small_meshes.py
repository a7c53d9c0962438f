"""Small meshes are not destroyed for a face count, and budgets of whole stages are spent where they cost least."""

from __future__ import annotations

import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from pxr import Usd, UsdGeom, Vt

import warpqem
from tests.support import meshes
from warpqem.errors import OptionError
from warpqem.measure import compare
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.commands import measuring
from warpqem.usd.commands.option_values import read_options

Mesh = tuple[np.ndarray, np.ndarray]
CARD = (np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))


def box(*extents: float) -> Mesh:
    shape = trimesh.creation.box(extents)
    return np.asarray(shape.vertices), np.asarray(shape.faces)


def write(path: Path, items: Iterable[Mesh]) -> None:
    """A stage with these meshes in a row, /S/M0, /S/M1, ..."""
    stage = Usd.Stage.CreateNew(str(path))
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/S").GetPrim())
    for index, (points, faces) in enumerate(items):
        mesh = UsdGeom.Mesh.Define(stage, f"/S/M{index}")
        moved = np.asarray(points, dtype=np.float32) + np.float32([3 * index, 0, 0])
        mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(moved))
        mesh.CreateFaceVertexCountsAttr([3] * len(faces))
        mesh.CreateFaceVertexIndicesAttr(np.asarray(faces).ravel().tolist())
        mesh.CreateSubdivisionSchemeAttr("none")
    stage.Save()


def run(folder: Path, items: Iterable[Mesh], **options: Any) -> Any:
    write(folder / "in.usda", items)
    return simplify_stage(folder / "in.usda", folder / "out.usda", SimplifyOptions(device="cpu", **options))


def read(path: Path) -> list[Mesh]:
    stage = Usd.Stage.Open(str(path))
    found = []
    for prim in stage.Traverse():
        if prim.IsA(UsdGeom.Mesh):
            mesh = UsdGeom.Mesh(prim)
            indices = np.asarray(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
            found.append((np.asarray(mesh.GetPointsAttr().Get()), indices))
    return found


@pytest.mark.parametrize("width", [1.0, 0.1, 0.01])
def test_card_is_not_cut_in_half(width, tmp_path):
    [prim] = run(tmp_path, [(CARD[0] * [1, width, 1], CARD[1])], ratio=0.25).prims
    assert (prim.status, prim.faces_after) == ("kept", 2)


def test_cube_keeps_its_shape_and_the_report_says_why(tmp_path):
    [prim] = run(tmp_path, [box(1, 1, 1)], ratio=0.25).prims
    assert (prim.status, prim.faces_after, prim.stopped) == ("kept", 12, "max_size_error")
    assert prim.message == "nothing could be removed with an error below 5 % of its size"


def test_budget_that_small_meshes_cannot_meet_says_why(tmp_path):
    report = run(tmp_path, [box(1, 1, 1), CARD, box(1, 2, 1)], faces="25%")
    assert [(prim.status, prim.faces_after, prim.stopped) for prim in report.prims] == [
        ("kept", 12, "max_size_error"),
        ("kept", 2, "max_size_error"),
        ("kept", 12, "max_size_error"),
    ]


@pytest.mark.parametrize("goal", [{"max_distance": 100.0}, {"max_error": 90.0}])
def test_a_distance_larger_than_the_mesh_leaves_the_card_and_the_cube(goal, tmp_path):
    prims = run(tmp_path, [CARD, box(1, 1, 1)], **goal).prims
    assert [prim.faces_after for prim in prims] == [2, 12]
    [prim] = run(tmp_path, [CARD], max_size_error=None, **goal).prims
    assert prim.faces_after == 1


def test_a_mesh_without_a_legal_collapse_is_not_said_to_be_held_by_its_size(tmp_path):
    [prim] = run(tmp_path, [meshes.tetrahedron()], ratio=0.5).prims
    assert (prim.status, prim.stopped) == ("kept", "no legal collapse")


def test_without_the_limit_the_count_is_all_that_matters(tmp_path):
    [prim] = run(tmp_path, [CARD], ratio=0.25, max_size_error=None).prims
    assert prim.faces_after == 1


def test_larger_limit_removes_more(tmp_path):
    shape = trimesh.creation.cylinder(0.2, 1, sections=8)
    counts = []
    for limit in (1.0, 5.0, 30.0):
        [prim] = run(tmp_path, [(shape.vertices, shape.faces)], ratio=0.1, max_size_error=limit).prims
        counts.append(prim.faces_after)
    assert counts == sorted(counts, reverse=True)
    assert counts[0] > counts[1] > counts[2]


def test_error_of_a_mesh_that_stopped_is_below_the_limit(device):
    for points, faces in (meshes.icosphere(1), meshes.torus(8, 5), meshes.tube(6, 4)):
        result = warpqem.simplify(points, faces, target_faces=2, max_size_error=3.0, device=device)
        assert result.stopped == "max_size_error"
        assert result.error <= 3.0
        assert len(result.faces) > 2


def test_limit_that_is_not_reached_changes_no_bit(device):
    points, faces = meshes.bumpy_sphere(3)
    plain, limited = (
        warpqem.simplify(points, faces, ratio=0.1, max_size_error=limit, device=device) for limit in (None, 5.0)
    )
    np.testing.assert_array_equal(plain.points, limited.points)
    np.testing.assert_array_equal(plain.faces, limited.faces)


def test_component_does_not_go_for_a_count_where_no_edge_may(device):
    cards = meshes.joined((CARD[0], CARD[1]), (CARD[0], CARD[1]), spacing=3.0)
    result = warpqem.simplify(*cards, target_faces=1, max_size_error=5.0, device=device)
    assert (len(result.faces), result.components_removed) == (4, 0)


@pytest.mark.parametrize("value", [0, -1, float("nan")])
def test_limit_out_of_range_is_refused(value):
    with pytest.raises(OptionError, match="max_size_error"):
        SimplifyOptions(ratio=0.5, max_size_error=value)
    with pytest.raises(OptionError, match="max_size_error"):
        warpqem.simplify(*meshes.icosphere(1), ratio=0.5, max_size_error=value, device="cpu")


@pytest.mark.parametrize(("text", "expected"), [("5000", 5000), ("25%", "25%"), (" 12.5 % ", "12.5%"), (40, 40)])
def test_faces_are_a_number_or_a_share(text, expected):
    assert read_options({"faces": text}).faces == expected


@pytest.mark.parametrize("text", ["0", "0%", "101%", "-3", "25 percent", "%", "1e3", True, 0.25])
def test_faces_that_are_neither_are_refused(text):
    with pytest.raises(OptionError, match="faces"):
        read_options({"faces": text})


def zoo() -> list[Mesh]:
    """Meshes of 2 to 1280 faces: cards, boxes, sheets and spheres, flat and bumpy."""
    return [
        CARD,
        box(1, 1, 1),
        box(1, 0.3, 0.1),
        meshes.grid(6, 6),
        meshes.icosphere(1),
        meshes.icosphere(2),
        meshes.bumpy_sphere(3),
        meshes.torus(20, 10),
        CARD,
        meshes.tube(8, 6),
    ]


def mean_error(folder: Path) -> float:
    pairs = zip(read(folder / "in.usda"), read(folder / "out.usda"), strict=True)
    return float(np.mean([compare(*before, *after, samples=500, device="cpu").rms for before, after in pairs]))


def test_budget_has_a_third_of_the_error_of_a_ratio_at_the_same_total(tmp_path):
    report = run(tmp_path, zoo(), ratio=0.25, max_size_error=None)
    total, before = sum(prim.faces_after for prim in report.prims), mean_error(tmp_path)
    report = run(tmp_path, zoo(), faces=total)
    assert sum(prim.faces_after for prim in report.prims) <= total
    assert mean_error(tmp_path) < before / 3
    closed = 0
    for (_, faces), (_, left) in zip(read(tmp_path / "in.usda"), read(tmp_path / "out.usda"), strict=True):
        assert len(left) >= min(len(faces), 2)
        borders = [
            np.unique(np.sort(f[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)), axis=0, return_counts=True)[1]
            for f in (faces, left)
        ]
        if (borders[0] == 2).all():
            assert (borders[1] == 2).all()
            closed += 1
    assert closed == 6


def test_share_of_the_stage_is_the_number_that_it_is(tmp_path):
    total = sum(len(faces) for _, faces in zoo())
    by_share = [prim.faces_after for prim in run(tmp_path, zoo(), faces="30%").prims]
    by_count = [prim.faces_after for prim in run(tmp_path, zoo(), faces=round(0.3 * total)).prims]
    assert by_share == by_count
    assert sum(by_share) == pytest.approx(0.3 * total, abs=2)


def test_mesh_of_a_budget_has_the_bits_of_its_face_count(tmp_path):
    report = run(tmp_path, zoo(), faces="40%")
    compared = 0
    for prim, (points, faces), (placed, left) in zip(
        report.prims, read(tmp_path / "in.usda"), read(tmp_path / "out.usda"), strict=True
    ):
        if prim.status == "simplified" and len(points) > 100:
            alone = warpqem.simplify(points, faces, target_faces=prim.faces_after, max_size_error=5.0, device="cpu")
            np.testing.assert_array_equal(alone.points[0], placed)
            np.testing.assert_array_equal(alone.faces, left)
            compared += 1
    assert compared == 3


def test_each_mesh_is_ordered_once(tmp_path, monkeypatch):
    import warpqem.pipeline.levels as levels
    import warpqem.pipeline.prepare as preparation

    calls = []
    order = preparation.Prepared.order
    monkeypatch.setattr(preparation.Prepared, "order", lambda self, *rest: (calls.append(1), order(self, *rest))[1])
    assert levels.Prepared is preparation.Prepared
    items = [meshes.icosphere(2), meshes.torus(), meshes.bumpy_sphere(2)]
    run(tmp_path, items, faces="30%")
    assert len(calls) == len(items)


def test_budget_beyond_memory_orders_again_with_the_same_bits(tmp_path):
    items = [meshes.icosphere(3), meshes.bumpy_sphere(3)]
    run(tmp_path, items, faces="30%")
    kept = (tmp_path / "out.usda").read_bytes()
    run(tmp_path, items, faces="30%", memory="6M")
    assert (tmp_path / "out.usda").read_bytes() == kept


@pytest.mark.parametrize("options", [{"memoryless": True}, {"symmetry": "x"}], ids=["memoryless", "symmetry"])
def test_budget_without_shared_ordering_is_met(options, tmp_path):
    report = run(tmp_path, [meshes.icosphere(2), meshes.torus(24, 12)], faces="40%", **options)
    total = sum(prim.faces_before for prim in report.prims)
    assert sum(prim.faces_after for prim in report.prims) == pytest.approx(0.4 * total, abs=6)


def test_varying_mesh_counts_by_the_mean_of_its_frames(tmp_path):
    from tests.support.usd_topology_runs import PATH, define_capture

    write(tmp_path / "in.usda", [meshes.icosphere(2)])
    stage = Usd.Stage.Open(str(tmp_path / "in.usda"))
    define_capture(stage, [8, 14], 2, path=PATH)
    stage.Save()
    options = SimplifyOptions(faces="30%", device="cpu")
    report = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", options)
    before, after = (sum(getattr(prim, f"faces_{when}") for prim in report.prims) for when in ("before", "after"))
    assert before == 320 + (128 + 392) // 2
    assert after == pytest.approx(0.3 * before, abs=3)
    runs = next(prim.runs for prim in report.prims if prim.runs)
    assert all(4 <= run.faces_after < run.faces_before for run in runs)


def balls(count: int) -> list[Mesh]:
    shape = trimesh.creation.icosphere(subdivisions=2)
    return [(shape.vertices * (1.0, 1.0, 1.0 + 0.1 * index), shape.faces) for index in range(count)]


def figures(report: Any) -> list[Any]:
    return [prim.measured for prim in report.prims]


def test_small_meshes_that_wait_for_each_other_have_the_errors_of_each_alone(tmp_path, monkeypatch):
    together = run(tmp_path, balls(5), ratio=0.25)
    monkeypatch.setattr(measuring, "SMALL_FACES", 0)
    assert figures(run(tmp_path, balls(5), ratio=0.25)) == figures(together)
    assert all(found["frame_count"] == 1 for found in figures(together))


def test_no_more_small_meshes_wait_than_are_measured_together(tmp_path, monkeypatch):
    measured, measure = [], measuring.measure_together

    def counted(pairs, **options):
        measured.append(len(pairs))
        return measure(pairs, **options)

    monkeypatch.setattr(measuring, "measure_together", counted)
    monkeypatch.setattr(measuring, "MAX_TOGETHER", 2)
    report = run(tmp_path, balls(5), ratio=0.25)
    assert measured == [2, 2, 1]
    assert all(report.prims[index].measured for index in range(5))


def test_unexpected_error_of_measuring_is_the_failure_of_its_mesh(tmp_path, monkeypatch):
    measure = measuring.measure_together

    def broken(pairs, **options):
        if any(np.ptp(pair.reference[0, :, 2]) == pytest.approx(2.2) for pair in pairs):
            raise IndexError("odd")
        return measure(pairs, **options)

    monkeypatch.setattr(measuring, "measure_together", broken)
    report = run(tmp_path, balls(4), ratio=0.25)
    assert [prim.status for prim in report.prims] == ["simplified", "failed", "simplified", "simplified"]
    assert report.prims[1].message == "/S/M1: unexpected error while measuring: IndexError: odd"
    monkeypatch.undo()
    whole = figures(run(tmp_path, balls(4), ratio=0.25))
    assert figures(report) == [whole[0], None, *whole[2:]]


def test_time_of_a_mesh_that_is_measured_alone_after_an_error_counts_once(tmp_path, monkeypatch):
    measure = measuring.measure_together

    def broken(pairs, **options):
        if len(pairs) > 1:
            raise IndexError("odd")
        time.sleep(0.5)
        return measure(pairs, **options)

    monkeypatch.setattr(measuring, "measure_together", broken)
    start = time.perf_counter()
    report = run(tmp_path, balls(3), ratio=0.25)
    assert sum(prim.seconds for prim in report.prims) <= time.perf_counter() - start
