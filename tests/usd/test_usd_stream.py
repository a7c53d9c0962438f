"""Point samples read and written a block at a time: the same bits, bounded memory, and nothing left behind."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom

import warpqem
from tests.support.cli import run
from tests.support.usd_rig import rig
from tests.support.usd_stages import cloth_stage, define_cloth, quad_grid, skinned_stage, waves
from tests.support.usd_stream import CLOTH, STAGES, TIMES, simplify, text_of, written
from warpqem.errors import StageError
from warpqem.frames.stream import NoFrames, held_bytes
from warpqem.usd import SimplifyOptions, color_features, inspect_stage, simplify_stage
from warpqem.usd.commands.mesh_job import MeshJob
from warpqem.usd.read.read_mesh import MeshSource, PoseFrames
from warpqem.usd.read.skeleton_poses import StagePoses
from warpqem.usd.read.value_arrays import Samples
from warpqem.usd.write.write import OverLayer


@pytest.mark.parametrize("suffix", ["usdc", "usda"])
@pytest.mark.parametrize("name", STAGES)
def test_small_blocks_write_the_file_that_one_block_writes(name, suffix, tmp_path, in_small_blocks):
    make, options = STAGES[name]
    make(tmp_path / "in.usda")
    whole = written(tmp_path, f"whole.{suffix}", **options)
    in_small_blocks()
    assert written(tmp_path, f"blocks.{suffix}", **options) == whole
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []


def test_a_point_cache_gets_the_points_that_arrays_get(tmp_path, in_small_blocks):
    stage = cloth_stage(tmp_path / "in.usda", times=TIMES, triangles=True)
    poses = waves(quad_grid(8)[0], len(TIMES))
    faces = np.asarray(UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH)).GetFaceVertexIndicesAttr().Get())
    expected = warpqem.simplify(poses, faces.reshape(-1, 3), ratio=0.3, device="cpu")
    in_small_blocks()
    stage = simplify(tmp_path, "out.usdc")
    attribute = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH)).GetPointsAttr()
    np.testing.assert_array_equal([attribute.Get(time) for time in TIMES], expected.points)


def test_memory_decides_the_blocks_and_no_bit_of_the_result(tmp_path, monkeypatch):
    monkeypatch.setattr("warpqem.usd.commands.mesh_job.KEPT_BYTES", 0)
    cloth_stage(tmp_path / "in.usda", times=TIMES)
    whole = written(tmp_path, "whole.usda")
    options = SimplifyOptions(ratio=0.3, device="cpu", memory="400K")
    report = simplify_stage(tmp_path / "in.usda", tmp_path / "small.usda", options)
    assert report.prims[0].plan["block_count"] > 1
    assert report.prims[0].plan["peak_bytes"] <= 400 * 1024
    assert text_of(tmp_path / "small.usda") == whole


@pytest.mark.parametrize(("memory", "kept"), [(None, True), ("1G", True), ("150K", False)])
def test_small_clips_are_kept_where_memory_has_room_and_the_plan_counts_them(memory, kept):
    stage = cloth_stage(times=TIMES)
    source = MeshSource(stage.GetPrimAtPath(CLOTH), StagePoses(stage))
    options = SimplifyOptions(ratio=1.0, memory=memory)
    job = MeshJob.prepare(source, options)
    assert held_bytes(job.frames) == (12 * 21 * 81 if kept else 0)
    frames = PoseFrames(source, TIMES, job.mesh.used_points)
    arguments = {"ratio": 0.3, "sink": NoFrames(), "memory": "1G"}
    plans = [warpqem.plan(frames, job.faces, **arguments) for frames in (job.frames, frames)]
    assert plans[0].held_bytes - plans[1].held_bytes == held_bytes(job.frames)


def test_memory_that_cannot_do_fails_the_mesh_before_a_frame_is_written(tmp_path):
    cloth_stage(tmp_path / "in.usda", times=TIMES)
    options = SimplifyOptions(ratio=0.3, device="cpu", memory="50K")
    report = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", options)
    assert report.output is None
    assert "/Root/Cloth: 81 vertices" in report.prims[0].message
    assert "50K may be used; what would help: fewer key frames than 16" in report.prims[0].message
    assert [path.name for path in tmp_path.iterdir()] == ["in.usda"]


def test_the_plan_of_each_mesh_is_announced_before_its_work(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda", times=TIMES)
    define_cloth(stage, "/Root/Other")
    stage.Save()
    seen = []
    simplify_stage(
        tmp_path / "in.usda",
        tmp_path / "out.usda",
        SimplifyOptions(ratio=0.3, device="cpu"),
        progress=lambda part, text: seen.append(text),
        announce=lambda name, plan: seen.append((name, plan.frame_count)),
    )
    assert seen.index((CLOTH, 21)) < seen.index("Cloth (1 of 2): reading its frames, 128 faces x 21 frames")
    assert seen.index(("/Root/Other", 1)) < seen.index("Other (2 of 2): reading its frames, 128 faces x 1 frames")


def test_levels_of_one_order_announce_one_plan(tmp_path):
    cloth_stage(tmp_path / "in.usda", times=TIMES)
    names = []
    options = SimplifyOptions(lods=(0.5, 0.2), device="cpu")
    simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", options, announce=lambda name, plan: names.append(name))
    assert names == [CLOTH]


def test_the_command_line_prints_the_plan_and_reports_it(tmp_path):
    cloth_stage(tmp_path / "in.usda", times=TIMES)
    result = run(
        "simplify", tmp_path / "in.usda", "-o", tmp_path / "out.usda", "--ratio", 0.3, "--memory", "1G",
        "--device", "cpu", "--json", tmp_path / "report.json", "-v",
    )  # fmt: skip
    assert result.exit_code == 0
    assert "plan: /Root/Cloth: 81 vertices, 128 faces, 21 frames in 1 block of 21, 16 key frames" in result.stderr
    plan = json.loads((tmp_path / "report.json").read_text())["prims"][0]["plan"]
    assert (plan["limit_bytes"], plan["frame_count"]) == (2**30, 21)


def test_the_plan_of_a_skinned_mesh_counts_the_frames_of_the_table(tmp_path):
    rig(tmp_path / "in.usda")
    [mesh] = inspect_stage(tmp_path / "in.usda")
    plans = []
    options = SimplifyOptions(ratio=0.5, device="cpu", measure=False)
    report = simplify_stage(
        tmp_path / "in.usda", tmp_path / "out.usda", options, announce=lambda name, plan: plans.append(plan)
    )
    [prim] = report.prims
    assert prim.frames == mesh.frames == prim.plan["frame_count"] - prim.plan["added_poses"]
    assert prim.plan["added_poses"] == 1
    assert f" faces, {mesh.frames} frames and 1 pose more in 1 block of {mesh.frames + 1}, " in str(plans[0])


def test_memory_that_is_no_number_of_bytes_is_wrong_usage(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    result = run("simplify", tmp_path / "in.usda", "-o", tmp_path / "out.usda", "--ratio", 0.5, "--memory", "lots")
    assert result.exit_code == 2
    assert "error: --memory 'lots': expected bytes above 0" in result.stderr


def test_a_mesh_that_fails_half_way_leaves_no_trace(tmp_path, in_small_blocks):
    in_small_blocks()
    stage = cloth_stage(tmp_path / "in.usda", times=TIMES)
    broken = define_cloth(stage, "/Root/Broken", times=TIMES)
    broken.GetPointsAttr().Set(Sdf.ValueBlock(), 20.0)
    stage.Save()
    options = SimplifyOptions(ratio=0.3, device="cpu", weld=False)
    report = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", options)
    assert [prim.status for prim in report.prims] == ["simplified", "failed"]
    assert "no value at time 20" in report.prims[1].message
    layer = Sdf.Layer.FindOrOpen(str(tmp_path / "out.usda"))
    assert layer.GetPrimAtPath(CLOTH)
    assert not layer.GetPrimAtPath("/Root/Broken")


def test_a_mesh_that_is_kept_leaves_no_trace(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda", times=TIMES)
    single = define_cloth(stage, "/Root/Single", size=1)
    assert len(single.GetPointsAttr().Get()) == 4
    stage.Save()
    options = SimplifyOptions(max_error=1e-5, device="cpu")
    report = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", options)
    assert [prim.status for prim in report.prims] == ["kept", "kept"]
    assert report.prims[0].message == "nothing could be removed within max_error 1e-05 %"
    assert not Sdf.Layer.FindOrOpen(str(tmp_path / "out.usda")).GetPrimAtPath("/Root/Single")


def test_what_is_discarded_leaves_other_edits_of_the_prim(tmp_path):
    layer = OverLayer(cloth_stage(tmp_path / "in.usda", times=TIMES))
    layer.stage.OverridePrim(CLOTH).CreateAttribute("mark", Sdf.ValueTypeNames.Int).Set(1)
    samples = layer.point_samples(CLOTH, TIMES)
    samples.begin(21, 3, np.array([[0, 1, 2]], dtype=np.int32))
    samples.write(slice(0, 2), np.zeros((2, 3, 3), dtype=np.float32))
    samples.discard()
    assert [item.name for item in layer.layer.GetPrimAtPath(CLOTH).properties] == ["mark"]


def test_saved_samples_are_no_longer_held(tmp_path, in_small_blocks):
    in_small_blocks()
    layer = OverLayer(cloth_stage(tmp_path / "in.usda", times=TIMES), tmp_path)
    samples = layer.point_samples(CLOTH, TIMES)
    samples.begin(21, 3, np.array([[0, 1, 2]], dtype=np.int32))
    samples.write(slice(0, 2), np.arange(18, dtype=np.float32).reshape(2, 3, 3))
    assert not layer.layer.dirty
    again = Sdf.Layer.OpenAsAnonymous(layer.layer.realPath)
    assert again.ListTimeSamplesForPath(f"{CLOTH}.points") == TIMES[:2]
    layer.close()


def test_the_temporary_file_goes_away_with_its_layer(tmp_path):
    layer = OverLayer(cloth_stage(tmp_path / "in.usda", times=TIMES), tmp_path)
    file = Path(layer.layer.realPath)
    assert file.parent == tmp_path
    assert file.exists()
    layer.close()
    layer.close()
    assert not file.exists()


def test_no_temporary_file_is_left_when_a_run_fails(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda", times=TIMES)
    UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH)).GetPointsAttr().Set([Gf.Vec3f(0)], 3.0)
    stage.Save()
    with pytest.raises(StageError, match="there are 1 points") as held:
        simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", SimplifyOptions(ratio=0.5, strict=True))
    assert [path.name for path in tmp_path.iterdir()] == ["in.usda"]
    del held


def test_a_folder_without_room_is_named(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    with pytest.raises(StageError, match=r"in\.usda: cannot be written to"):
        OverLayer(stage, tmp_path / "in.usda")


def test_poses_are_read_as_they_are_asked_for():
    stage = cloth_stage(times=TIMES)
    source = MeshSource(stage.GetPrimAtPath(CLOTH), StagePoses(stage))
    frames = PoseFrames(source, TIMES, np.array([3, 1], dtype=np.int32))
    poses = waves(quad_grid(8)[0], len(TIMES))
    assert (frames.frame_count, frames.vertex_count) == (21, 2)
    np.testing.assert_array_equal(frames.read(slice(4, 7)), poses[4:7, [3, 1]])


def test_a_closed_mesh_is_not_read_for_welding(monkeypatch, tmp_path):
    cloth_stage(tmp_path / "in.usda", times=TIMES)
    read = []
    original = MeshSource.points_at
    monkeypatch.setattr(MeshSource, "points_at", lambda self, time: read.append(time) or original(self, time))
    monkeypatch.setattr("warpqem.usd.commands.mesh_job.KEPT_BYTES", 0)
    monkeypatch.setattr("warpqem.frames.blocks.BLOCK_BYTES", 1)
    monkeypatch.setattr("warpqem.pipeline.memory_plan.BLOCK_BYTES", 1)
    simplify(tmp_path, "out.usda", key_frames=4, quality="fast", measure=False)
    # Twice all frames, the key frames, the reference pose, and at most two blocks to see that no points coincide.
    assert len(read) <= 2 * len(TIMES) + 4 + 1 + 16


def test_features_are_found_block_by_block(tmp_path, in_small_blocks):
    skinned_stage(tmp_path / "in.usda")
    color_features(tmp_path / "in.usda", tmp_path / "whole.usda", device="cpu")
    in_small_blocks()
    color_features(tmp_path / "in.usda", tmp_path / "blocks.usda", device="cpu")
    assert (tmp_path / "blocks.usda").read_text() == (tmp_path / "whole.usda").read_text()


def test_samples_are_read_when_they_are_asked_for():
    read = []
    codes = [Usd.TimeCode.Default(), Usd.TimeCode(1.0)]
    samples = Samples(codes, lambda code: read.append(code) or np.array([len(read)]))
    assert (list(samples), len(samples), codes[1] in samples, Usd.TimeCode(2.0) in samples) == (codes, 2, True, False)
    assert read == []
    assert samples[codes[0]] is samples[codes[0]]
    assert [int(values[0]) for values in samples.map(lambda values: 10 * values).values()] == [10, 20]
    assert read == codes
