"""Simplify animated glTF files: as a stage that Blender writes of them, and back by Blender."""

from __future__ import annotations

import json
import os
import time
import urllib.parse
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from warpqem.arguments.progress import share_of
from warpqem.errors import MeshFileError, OptionError
from warpqem.files.outputs import InputFile, OutputFile, check_outputs
from warpqem.files.temporary import remove_path, temporary_path
from warpqem.gltf.blender import blender_command, run_blender
from warpqem.gltf.inventory import SUFFIXES, compare_gltf, frame_rate, gltf_parts, read_gltf
from warpqem.usd.commands.context import Announce, Progress
from warpqem.usd.commands.output_names import output_files
from warpqem.usd.commands.simplify import simplify_stage
from warpqem.usd.commands.simplify_options import SimplifyOptions
from warpqem.usd.write.layer_files import check_output_path
from warpqem.usd.write.package import is_package
from warpqem.usd.write.stage_report import StageReport

__all__ = ["simplify_gltf"]

# Parts of the progress that Blender takes before and after.
OPEN_SHARE, CLOSE_SHARE = 0.15, 0.15


def simplify_gltf(
    path: str | os.PathLike[str],
    output: str | os.PathLike[str],
    options: SimplifyOptions,
    *,
    progress: Progress | None = None,
    announce: Announce | None = None,
    other_outputs: Sequence[OutputFile] = (),
    before_end: Callable[[StageReport], None] | None = None,
) -> StageReport:
    """Simplify an animated glTF file over all its clips.

    Args:
        path: A .glb or .gltf file.
        output: A .glb file, in which all but the meshes is as Blender writes what it has read; or a USD file.
        options: What to do; neither `bake`, `bake_normals` nor levels where the output is a .glb.
        progress: Called with the part done and what is being done.
        announce: See `warpqem.usd.simplify_stage`.
        other_outputs: See there.
        before_end: Called with the report, in which `input` is a temporary stage then.

    Returns:
        The report. Its `notes` say what the output kept of the input, its `problems` what it lost.

    Raises:
        OptionError: there is no Blender, or an option or a name is wrong.
        MeshFileError: Blender cannot read or write a file.
        StageError: see `warpqem.usd.simplify_stage`.
    """
    start, file, to_gltf = time.perf_counter(), read_gltf(path), Path(output).suffix.lower() in SUFFIXES
    outputs = _outputs(output, options, to_gltf)
    check_outputs([*outputs, *other_outputs], _inputs(file.path, file.json))
    command, rate, folder = blender_command(), frame_rate(file), Path(output).absolute().parent
    try:
        work = temporary_path(folder, ".gltf")
        work.mkdir()
    except OSError as error:
        raise MeshFileError(f"{folder}: cannot be written ({error.strerror})") from error
    try:
        show = progress or (lambda fraction, text: None)
        show(0.0, "opening the scene in Blender")
        # Out of a package textures go with a flat file.
        stage = work / ("scene.usdc" if to_gltf else "scene.usdz")
        _open(command, file.path, stage, file.json, rate)
        target = work / "simplified.usdc" if to_gltf else Path(output)
        asked = options if options.lods and not options.lod_files else replace(options, flatten=True)
        part = share_of(show, OPEN_SHARE, 1.0 - OPEN_SHARE - CLOSE_SHARE)
        report = simplify_stage(stage, target, asked, part, announce)
        if before_end is not None and report.output is not None:
            before_end(report)
        if to_gltf and report.output is not None:
            show(1.0 - CLOSE_SHARE, "writing the scene in Blender")
            _close(command, work, report, file.json, os.fspath(output))
            kept, lost = compare_gltf(gltf_parts(file), gltf_parts(read_gltf(work / "out.glb")), 1.0 / rate)
            os.replace(work / "out.glb", output)
            report.output, report.outputs = os.fspath(output), [os.fspath(output)]
            report.problems = [f"{os.fspath(path)}: {line}" for line in lost] + report.problems
            report.notes = [f"kept: {', '.join(kept)}", *report.notes]
        _name_as_in_file(report, work)
    finally:
        remove_path(work)
    report.input = os.fspath(path)
    if report.run is not None:
        report.run["seconds"] = time.perf_counter() - start
    return report


def _outputs(output: str | os.PathLike[str], options: SimplifyOptions, to_gltf: bool) -> list[OutputFile]:
    """The files that are going to be written.

    Raises:
        OptionError: they cannot be.
    """
    if not to_gltf:
        check_output_path(output, [], packages=True)
        if options.lods and not options.lod_files and not is_package(output):
            raise OptionError("lods: levels are layers over a stage; give lod_files, or a package (.usdz)")
        return [OutputFile("output", file) for file in output_files(output, options)]
    if Path(output).suffix.lower() != ".glb":
        raise OptionError(f"output {os.fspath(output)}: a glTF file is written as .glb, which holds all that it needs")
    for name in ("bake", "lods", "bake_normals"):
        if getattr(options, name):
            raise OptionError(f"{name}: needs a USD file as output, not {os.fspath(output)}")
    return [OutputFile("output", output)]


def _inputs(path: Path, found: dict[str, Any]) -> list[InputFile]:
    """The file and those that it names."""
    parts = [*found.get("buffers", []), *found.get("images", [])]
    named = [urllib.parse.unquote(part["uri"]) for part in parts if not part.get("uri", "data:").startswith("data:")]
    return [InputFile(path), *(InputFile(path.parent / name, f"a file of {path}") for name in named)]


def _open(command: list[str], path: Path, stage: Path, found: dict[str, Any], rate: int) -> None:
    """Let Blender write a stage of the scene."""
    meshes = found.get("meshes", [])
    shown = [node for node in found.get("nodes", []) if "mesh" in node and "skin" in node and "name" in node]
    skinned = [(node["name"], meshes[node["mesh"]].get("name", node["name"])) for node in shown]
    given = {"frames_per_second": rate, "skinned": skinned, "stage": stage.name}
    (stage.parent / "input.json").write_text(json.dumps(given), "utf-8")
    run_blender(command, ["open", os.fspath(path.absolute()), os.fspath(stage.parent)], os.fspath(path))


def _close(command: list[str], work: Path, report: StageReport, found: dict[str, Any], output: str) -> None:
    """Let Blender put the simplified meshes into the scene, and write it."""
    names = json.loads((work / "meshes.json").read_text("utf-8"))
    names["wanted"] = [prim.path.rpartition("/")[2] for prim in report.prims if prim.status == "simplified"]
    attributes = [part["attributes"] for mesh in found.get("meshes", []) for part in mesh["primitives"]]
    names["tangents"] = any("TANGENT" in given for given in attributes)
    names["influences"] = any("JOINTS_1" in given for given in attributes)
    (work / "meshes.json").write_text(json.dumps(names), "utf-8")
    run_blender(command, ["close", os.fspath(work), os.fspath(work / "out.glb")], output)


def _name_as_in_file(report: StageReport, work: Path) -> None:
    """Let the report name the objects of the scene, not prims of a stage that is gone."""
    objects = json.loads((work / "meshes.json").read_text("utf-8"))["objects"]
    names = {prim.path: objects.get(prim.path.rpartition("/")[2], prim.path) for prim in report.prims}

    def named(text: str) -> str:
        for path, name in sorted(names.items(), key=lambda item: -len(item[0])):
            text = text.replace(path, name)
        return text

    report.problems, report.notes = list(map(named, report.problems)), list(map(named, report.notes))
    for prim in report.prims:
        prim.path, prim.message = named(prim.path), None if prim.message is None else named(prim.message)
        prim.problems, prim.notes = list(map(named, prim.problems)), list(map(named, prim.notes))
