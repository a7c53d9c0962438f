"""``python -m benchmarks device``: whole under CUDA semantics, with NumPy and Warp alone; parts that fail are named."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import warp as wp

from benchmarks.device import checks, data, probe, runner, sanitizer
from benchmarks.device.findings import Findings, read_findings
from benchmarks.device.parts import PARTS, Part
from benchmarks.settings import Settings
from benchmarks.work import save_work, torus_work

ROOT = Path(__file__).resolve().parents[2]
# Everything that warpqem depends on but NumPy and Warp, and what its tests do.
MISSING = ("pxr", "typer", "rich", "PIL", "trimesh", "zstandard", "mapbox_earcut", "scipy", "skimage", "hypothesis")
# Blocks them in every process; the ways of a GPU are for the parts alone: what is packed is a CPU's.
SITE = f"""
import sys
for name in {MISSING!r}:
    sys.modules[name] = None
if "benchmarks.device.child" in sys.orig_argv:
    from tests.support import cuda_semantics
    cuda_semantics.install("shuffled")
    open({{marker!r}}, "a").write("x")
"""


def start(folder: Path, *arguments: str) -> subprocess.Popen:
    """The command, where ``folder`` is looked at first for modules."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(folder), str(ROOT)])}
    command = [sys.executable, "-m", "benchmarks", "device", "--quick", "--device", "cpu", *arguments]
    return subprocess.Popen(
        command, env=environment, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Output and folder of a run of all parts on what was packed before."""
    folder = tmp_path_factory.mktemp("device")
    (folder / "sitecustomize.py").write_text(SITE.replace("{marker!r}", repr(str(folder / "marker"))))
    packing = start(folder, "--pack", "data")
    assert "data" in packing.communicate()[0]
    assert packing.returncode == 0
    running = start(folder, "--data", "data", "--out", "out")
    output = running.communicate()[0]
    assert running.returncode == 0, output
    return output, folder


def rows_of(folder: Path) -> list[dict]:
    return json.loads((folder / "out" / "device.json").read_text())["tables"][0]["rows"]


def test_all_parts_hold_under_cuda_semantics_without_what_a_gpu_machine_lacks(whole):
    output, folder = whole
    assert (folder / "marker").read_text() == len(PARTS) * "x"
    for part in PARTS:
        assert f"{part.name} (from " in output
    assert {row["part"] for row in rows_of(folder)} == {part.name for part in PARTS}
    assert [row for row in rows_of(folder) if row.get("verdict") == "FAILED"] == []


def test_what_each_part_is_for_is_in_the_report(whole):
    found = [(row["part"], row["check"], row.get("verdict")) for row in rows_of(whole[1])]
    assert sum(part == "bits" and verdict == "ok" for part, _, verdict in found) == len(checks.OPTIONS)
    assert sum(part == "quality" and verdict == "ok" for part, _, verdict in found) == len(data.QUALITIES)
    assert sum(part == "probe" and verdict == "ok" for part, _, verdict in found) == 4
    for part in ("scenes", "million", "static", "refit"):
        assert any(part == name and "first run" in check for name, check, _ in found)
    assert ("sanitizer", "compute-sanitizer", "not run") in found or any(name == "memcheck" for _, name, _ in found)


def test_quality_is_beside_figures_of_a_cpu_that_were_packed(whole):
    quality = [row for row in rows_of(whole[1]) if row["part"] == "quality" and row["check"] != "time"]
    assert all("(CPU, packed)" in row["expected"] for row in quality)
    assert all(0.8 < row["value"] < 1.1 for row in quality)


def test_report_is_a_section_that_the_notes_take_as_it_is(whole):
    text = (whole[1] / "out" / "device.md").read_text()
    headings = re.findall(r"^#+ .*", text, re.M)
    assert headings[0].startswith("## GPU: ")
    assert all(heading.startswith("### ") for heading in headings[1:])
    for table in re.findall(r"(?:^\|.*\n)+", text, re.M):
        assert len({line.count(" | ") for line in table.splitlines() if "---" not in line}) == 1
    for kernel in ("compute_all_costs", "assemble_elements (best)", "move_trajectories (dod)"):
        assert f"| {kernel} |" in text


def test_every_part_prints_as_it_goes(whole):
    lines = whole[0].splitlines()
    first = next(n for n, line in enumerate(lines) if line.startswith("probe (from"))
    second = next(n for n, line in enumerate(lines) if line.startswith("modules (from"))
    assert any("loop on the device, 1 kernels: 1000 turns" in line for line in lines[first:second])


def test_six_minutes_are_enough_for_all_parts():
    assert sum(part.seconds for part in PARTS) + 10 <= 360


PART = Part("probe", 5, "probe:run", "something")


def child(monkeypatch, code: str) -> None:
    """Let a part run this code; its file is ``sys.argv[1]``."""
    monkeypatch.setattr(runner, "_command", lambda part, settings, file: [sys.executable, "-c", code, str(file)])


FINDS = """
import json, sys
with open(sys.argv[1], "a") as file:
    row = {"part": "probe", "check": "a", "measured": "1", "expected": "", "verdict": ""}
    file.write(json.dumps({"row": row}) + "\\n")
"""


def gone(number: int) -> bool:
    """Whether a process is gone, or a zombie that nobody has waited for."""
    try:
        return Path(f"/proc/{number}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
    except OSError:
        return True


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="no /proc")
def test_a_part_that_overruns_is_ended_with_all_that_it_has_started(monkeypatch, tmp_path):
    wait = f"""{FINDS}
import subprocess, time
child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
open(sys.argv[1] + ".pid", "w").write(str(child.pid))
time.sleep(60)
"""
    child(monkeypatch, wait)
    file = tmp_path / "found"
    assert runner.run_part(PART, Settings(tmp_path), file, 1.5) == "overran 2 s and was ended"
    assert [entry["row"]["check"] for entry in read_findings(file)] == ["a"]
    grandchild = int(Path(f"{file}.pid").read_text())
    end = time.monotonic() + 5
    while not gone(grandchild) and time.monotonic() < end:
        time.sleep(0.01)
    assert gone(grandchild)


@pytest.mark.parametrize(
    ("code", "failure"),
    [
        ("import os; os.abort()", "was ended by SIGABRT"),
        ("import sys; sys.exit(3)", "failed with exit code 3"),
        ("1 / 0", "failed with exit code 1"),
    ],
)
def test_a_part_that_fails_is_named_and_the_others_go_on(code, failure, monkeypatch, tmp_path, capfd):
    codes = iter([f"{FINDS}\n{code}", *[FINDS] * 2])
    monkeypatch.setattr(runner, "_command", lambda part, settings, file: [sys.executable, "-c", next(codes), str(file)])
    report = runner.run(Settings(tmp_path, parts=("probe", "bits", "floors")))
    rows = report.tables[0].rows
    assert [row["check"] for row in rows] == 3 * ["a", "time"]
    assert failure in rows[1]["measured"]
    assert report.failed == ["probe: time"]
    assert "1 do not hold: probe: time" in report.notes[-1]
    assert f"probe {failure}" in capfd.readouterr().out


@pytest.mark.parametrize("quick", [False, True])
def test_time_that_a_part_leaves_over_goes_to_the_next(monkeypatch, tmp_path, quick):
    limits = []
    monkeypatch.setattr(runner, "run_part", lambda *given: limits.append(given[3]))
    runner.run(Settings(tmp_path, quick=quick, parts=("probe", "bits", "floors")))
    by_name = {part.name: part.seconds for part in PARTS}
    times = runner.QUICK_PATIENCE if quick else 1
    expected = np.cumsum([times * by_name[name] for name in ("probe", "bits", "floors")])
    np.testing.assert_allclose(limits, expected, atol=1)


def test_parts_that_took_all_the_time_leave_the_later_ones_none(monkeypatch, tmp_path):
    child(monkeypatch, "import time; time.sleep(60)")
    begin = time.monotonic()
    assert "overran" in runner.run_part(PART, Settings(tmp_path), tmp_path / "found", -3.0)
    assert time.monotonic() - begin < 5


@pytest.mark.skipif(wp.is_cuda_available(), reason="this machine has a GPU")
def test_without_a_gpu_nothing_runs_unless_the_cpu_is_asked_for(tmp_path, capfd):
    with pytest.raises(SystemExit, match="Warp sees no GPU on this machine; --quick --device cpu"):
        runner.run(Settings(tmp_path))
    assert "modules (from" not in capfd.readouterr().out


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_command_that_is_ended_leaves_no_part_behind(number, tmp_path):
    running = start(tmp_path, "--part", "million")
    for line in running.stdout:
        if line.startswith("million"):
            break
    children = Path(f"/proc/{running.pid}/task/{running.pid}/children")
    while not children.read_text().split():
        time.sleep(0.01)
    numbers = [int(text) for text in children.read_text().split()]
    running.send_signal(number)
    assert running.wait(timeout=20) == 128 + number
    running.stdout.close()
    assert all(map(gone, numbers))


@pytest.fixture
def found(tmp_path):
    return Findings("part", Settings(tmp_path, quick=True), "cpu", tmp_path / "found")


def verdicts(found: Findings) -> list[str]:
    return [entry["row"]["verdict"] for entry in read_findings(found._file) if "row" in entry]


def test_an_ability_that_is_missing_is_named_and_the_next_is_tried(found, monkeypatch):
    def refuse(*_, **__):
        raise RuntimeError("no such\nnode")

    monkeypatch.setattr(wp, "capture_if", refuse)
    probe.run(found)
    rows = [entry["row"] for entry in read_findings(found._file) if "row" in entry]
    failed = [row for row in rows if row["verdict"] == "FAILED"]
    assert [row["measured"] for row in failed] == ["RuntimeError: no such node"]
    assert rows[-1]["check"] == "allocation in a loop's body"


def test_a_loop_that_stops_early_does_not_hold(found, monkeypatch):
    monkeypatch.setattr(wp, "capture_while", lambda condition, body: body())
    probe._loop(found, wp.get_device("cpu"))
    assert verdicts(found) == ["FAILED", "FAILED"]


def test_other_bits_do_not_hold(found, monkeypatch):
    hashes = iter("ab" * 50)
    monkeypatch.setattr(checks, "fingerprint", lambda *_, **__: next(hashes))
    checks.same_bits(found)
    assert verdicts(found) == ["FAILED"] * len(checks.OPTIONS)


@pytest.mark.parametrize(
    ("rms", "faces", "verdict"), [(1.0, 59, "ok"), (0.5, 59, "ok"), (1.2, 59, "FAILED"), (1.0, 61, "FAILED")]
)
def test_quality_holds_where_the_distance_is_no_larger_and_the_faces_no_more(rms, faces, verdict, found, monkeypatch):
    monkeypatch.setattr(checks, "figures_of", lambda *_: {"rms": rms, "faces": faces})
    monkeypatch.setattr(checks, "cpu_figures", lambda *_: ({"rms": 1.0, "faces": 59}, "here"))
    checks.quality(found)
    assert verdicts(found) == [verdict] * len(data.QUALITIES)


def test_quality_without_a_cpu_is_left_out(found, monkeypatch):
    monkeypatch.setattr(wp, "is_cpu_available", lambda: False)
    checks.quality(found)
    assert verdicts(found) == ["not run"] * len(data.QUALITIES)


@pytest.mark.parametrize(("code", "expected"), [(0, ["ok"] * 3), (99, ["FAILED"] * 3)])
def test_what_the_sanitizer_finds_does_not_hold(code, expected, found, monkeypatch, tmp_path):
    program = tmp_path / "compute-sanitizer"
    program.write_text(f'#!/bin/sh\necho "========= ERROR SUMMARY: $2 {code} errors"\nexit {code}\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    sanitizer.run(found)
    assert verdicts(found) == expected
    texts = [entry["row"]["measured"] for entry in read_findings(found._file)]
    assert texts[0] == f"exit code {code}, ERROR SUMMARY: memcheck {code} errors"


def test_the_sanitizer_runs_the_pipeline_without_graphs(monkeypatch):
    from warpqem.runtime import device

    monkeypatch.setattr(device, "_TRAITS", dict(device._TRAITS))
    sanitizer.main("cpu")
    assert not device.device_traits("cpu").captures


def test_meshes_of_a_folder_are_worked_on_and_an_empty_one_is_named(tmp_path):
    settings = Settings(tmp_path, data=tmp_path)
    with pytest.raises(FileNotFoundError, match=re.escape(f"{tmp_path}: no .npz file")):
        data.works(settings)
    work = torus_work(200, 2, 0.5)
    save_work(work, tmp_path / "a.npz")
    (found,) = data.works(settings)
    assert (found.name, found.target_faces) == (work.name, work.target_faces)
    assert data.packed_figures(settings) == {}


def test_a_mesh_of_your_own_needs_points_and_faces_alone(tmp_path):
    work = torus_work(200, 2, 0.5)
    file = tmp_path / "horse.npz"
    np.savez(file, points=work.points.astype(np.float64), faces=work.faces.astype(np.int64))
    (found,) = data.works(Settings(tmp_path, data=file, ratio=0.25))
    assert (found.name, found.target_faces) == ("horse", round(0.25 * len(work.faces)))
    np.testing.assert_array_equal(found.points, work.points)
    np.savez(file, points=work.points, triangles=work.faces)
    with pytest.raises(ValueError, match=r"horse\.npz: expected the arrays points and faces, found points, triangles"):
        data.works(Settings(tmp_path, data=file))
    with pytest.raises(FileNotFoundError, match=r"nothing\.npz: no \.npz file"):
        data.works(Settings(tmp_path, data=tmp_path / "nothing.npz"))


def test_settings_reach_the_part_as_they_are(tmp_path):
    settings = Settings(tmp_path, True, "cpu", 3, 0.2, None, None, tmp_path / "data", None, ("bits",))
    assert Settings.from_json(settings.to_json()) == settings


def test_what_is_measured_on_a_gpu_is_said_to_be_and_nothing_else():
    # The heading of a report of this command, put into the notes.
    measured = re.search(r"^## GPU: .*(NVIDIA|H100|H200)", (ROOT / "benchmarks" / "NOTES.md").read_text("utf-8"), re.M)
    for page in ("README.md", "docs/install.md", "benchmarks/NOTES.md"):
        said = "GPU: not measured" in (ROOT / page).read_text("utf-8")
        assert said == (measured is None), page
