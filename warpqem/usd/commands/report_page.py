"""HTML reports on what was done with USD files."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from pxr import Sdf, Usd

import warpqem
from warpqem.costs.models import cost_model
from warpqem.errors import WarpqemError
from warpqem.files.outputs import OutputFile
from warpqem.measure.appearance_rows import APPEARANCE_COLUMNS, APPEARANCE_TITLE, appearance_rows
from warpqem.report import Level, Report, Table, chosen_frames, write_report
from warpqem.runtime.device import resolve_device
from warpqem.usd.checks.input_files import check_stage_outputs
from warpqem.usd.commands.appearance import stage_looks
from warpqem.usd.commands.level_stages import level_names, level_root
from warpqem.usd.commands.lods import LevelReport
from warpqem.usd.commands.output_names import VARIANT_SET
from warpqem.usd.commands.report_rig import rig_curves, size_table
from warpqem.usd.commands.simplify_options import SimplifyOptions
from warpqem.usd.read.materials import Materials
from warpqem.usd.read.open_stage import open_stage
from warpqem.usd.read.variants import open_stages
from warpqem.usd.read.world import WorldMeshes, chosen_times, limit_places, longest_run
from warpqem.usd.read.world_rig import moving_joints, skeletons_of
from warpqem.usd.write.stage_report import PrimReport, StageReport

if TYPE_CHECKING:
    from warpqem.measure import Appearance
    from warpqem.usd.commands.compare import CompareOptions, PairReport
    from warpqem.usd.read.time_codes import FrameRange

__all__ = ["coarsest_level", "stage_report", "write_compare_report", "write_simplify_report"]

Progress = Callable[[float, str], None]

# What the table of options always says; others only where they are not the default.
ALWAYS = ("metric", "coherence", "key_frames", "refit")


def write_simplify_report(
    path: str | os.PathLike[str], report: StageReport, options: SimplifyOptions, progress: Progress | None = None
) -> None:
    """Write the report on a run of `simplify_stage` that wrote a file.

    Args:
        path: .html file; replaced if it exists.
        report: What came of it.
        options: What was asked for.
        progress: Called with the fraction done and what is being done.

    Raises:
        OptionError: the suffix of `path` is another one, or it is a file that is read.
        StageError: one of the files cannot be read, or the page cannot be written.
    """
    output = report.output or ""
    failed = [prim.path for prim in report.failed]
    original = WorldMeshes(report.input, options.prims, passing=failed)
    names = list(dict.fromkeys(prim.level for prim in report.prims if isinstance(prim, LevelReport)))
    if options.lod_files:
        named = zip(names, report.outputs, strict=True)
        levels = [(name, WorldMeshes(file, options.prims, passing=failed)) for name, file in named]
    else:
        levels = [(name, _open_level(output, name, options.prims, failed)) for name in names]
    levels = levels or [("simplified", WorldMeshes(output, options.prims, passing=failed))]
    check_stage_outputs([OutputFile("report", path)], [original.stage, *(level.stage for _, level in levels)])
    tables = [size_table(original, levels), _mesh_table(report.worst_first), _option_table(options)]
    notes = [prim.message for prim in report.prims if prim.message]
    notes += [
        f"{prim.path}: {prim.measured['verdict']}: {prim.measured['reason']}"
        for prim in report.worst_first
        if prim.measured is not None and prim.measured["reason"]
    ]
    notes += [note for prim in report.prims for note in prim.notes]
    notes += [f"{prim.path}: dropped: {', '.join(prim.dropped)}" for prim in report.prims if prim.dropped]
    if options.measure:
        tables[2:2] = _appearance_tables(_looks(report, original, levels, options, notes), notes)
    title = f"{original.name} → {os.path.basename(output)}"
    page = _gather(title, original, levels, options.frames, tables, list(dict.fromkeys(notes)))
    page = replace(page, curves=rig_curves(report.worst_first))
    page = replace(page, levels=[replace(level, meshes=_errors_by_mesh(level.name, report)) for level in page.levels])
    if len(report.prims) == len(page.levels):
        # Of one mesh, the page shows the errors that are known, of all its frames.
        known = [prim.measured for prim in report.prims]
        page = replace(
            page, levels=[replace(level, measured=found) for level, found in zip(page.levels, known, strict=True)]
        )
    if cost_model(options.metric).keeps_face:
        page = replace(page, markers=_feature_points(page))
    write_report(path, page, options.device, progress)


def write_compare_report(
    path: str | os.PathLike[str],
    reference: str,
    test: str,
    pairs: Sequence[PairReport],
    options: CompareOptions,
    progress: Progress | None = None,
) -> None:
    """Write the report on a run of `compare_stages`; see `write_simplify_report`.

    Args:
        path: .html file; replaced if it exists.
        reference: The USD file with the originals.
        test: The USD file that was compared with it.
        pairs: What came of it; a pair that failed is left out of the picture.
        options: What was asked for.
        progress: Called with the fraction done and what is being done.

    Raises:
        OptionError, StageError: as there.
    """
    failed = [pair.path for pair in pairs if pair.message is not None]
    if options.all_lods:
        original = WorldMeshes(reference, options.prims, passing=failed)
        opened = [(name, _open_level(test, name, options.prims, failed)) for name in _level_names(test)]
        levels = [(name, level) for name, level in opened if any(pair.level == name for pair in pairs)]
    else:
        stages = open_stages([reference, test], options.variants)
        both = zip((reference, test), stages, strict=True)
        original, level = (WorldMeshes(name, options.prims, passing=failed, stage=stage) for name, stage in both)
        levels = [(level.name, level)]
    check_stage_outputs([OutputFile("report", path)], [original.stage, *(level.stage for _, level in levels)])
    notes = [pair.message for pair in pairs if pair.message] + [note for pair in pairs for note in pair.notes]
    looks = [(_name(pair.path, pair.level), pair.appearance) for pair in pairs if pair.appearance is not None]
    tables = [_pair_table(pairs), *_appearance_tables(looks, notes)]
    title = f"{original.name} – {os.path.basename(test)}"
    page = _gather(title, original, levels, options.frames, tables, notes)
    if len(pairs) == 1 and not options.all_lods and pairs[0].comparison is not None:
        page = replace(page, levels=[replace(page.levels[0], measured=pairs[0].comparison.to_dict())])
    write_report(path, page, options.device, progress)


def stage_report(
    reference: str,
    test: str | None = None,
    prims: Sequence[str] = (),
    frames: FrameRange | None = None,
    variants: Sequence[str] = (),
) -> Report:
    """What there is to see in one file or two.

    Args:
        reference: USD file with the originals. Without `test`, its own levels of detail are shown if it has any.
        test: USD file with the simplified meshes, or with levels of detail; None for none.
        prims: Prim paths; meshes at and below them are shown. Empty for all.
        frames: Time codes to show; None for all authored ones.
        variants: Variants to show, `SET=NAME` or `/Prim/Path{SET=NAME}`, of each file that has them, instead of the
            levels of detail; empty for those that the files select.

    Raises:
        StageError: a file cannot be read, or has no mesh.
        OptionError: there is no such variant.
    """
    if variants:
        paths = [path for path in (reference, test) if path is not None]
        stages = open_stages(paths, variants)
        shown = [WorldMeshes(path, prims, stage=stage) for path, stage in zip(paths, stages, strict=True)]
        title = " – ".join([*(meshes.name for meshes in shown), ", ".join(variants)])
        return _gather(title, shown[0], [(meshes.name, meshes) for meshes in shown[1:]], frames, (), ())
    names = _level_names(test or reference)
    if test is None and names:
        original = _open_level(reference, names.pop(0), prims, ())
    else:
        original = WorldMeshes(reference, prims)
    if test is not None and names:
        # The first level is the original.
        names.pop(0)
    levels = [(name, _open_level(test or reference, name, prims, ())) for name in names]
    if test is not None and not levels:
        levels = [(os.path.basename(test), WorldMeshes(test, prims))]
    title = original.name if test is None else f"{original.name} – {os.path.basename(test)}"
    return _gather(title, original, levels, frames, (), ())


def coarsest_level(path: str, prims: Sequence[str] = ()) -> WorldMeshes:
    """The meshes of a file, those of its last level of detail where it has levels.

    Raises:
        StageError: the file cannot be read, or has no mesh.
    """
    names = _level_names(path)
    return _open_level(path, names[-1], prims, ()) if names else WorldMeshes(path, prims)


def _level_names(path: str) -> list[str]:
    """Names of the levels of detail of a file, the finest first; empty if it has none."""
    return level_names(open_stage(path))


def _open_level(path: str, name: str, prims: Sequence[str], failed: Sequence[str]) -> WorldMeshes:
    """One level of a file: a variant, or a prim below a prim that holds the levels."""
    stage = open_stage(path)
    root = level_root(stage)
    assert root is not None
    if root.GetVariantSets().HasVariantSet(VARIANT_SET):
        return WorldMeshes(path, prims, (root.GetPath(), VARIANT_SET, name), failed)
    place = root.GetPath().AppendChild(VARIANT_SET).AppendChild(name)
    moved, left_out = (
        [_moved(prim, root, place) for prim in paths] for paths in (prims or [str(root.GetPath())], failed)
    )
    return WorldMeshes(path, moved, passing=left_out)


def _moved(path: str, root: Usd.Prim, place: Sdf.Path) -> str:
    return str(Sdf.Path(path).ReplacePrefix(root.GetPath(), place))


def _gather(
    title: str,
    original: WorldMeshes,
    levels: Sequence[tuple[str, WorldMeshes]],
    frames: FrameRange | None,
    tables: Sequence[Table],
    notes: Sequence[str],
) -> Report:
    """Read as many frames as a page has room for."""
    all_meshes = [original, *(level for _, level in levels)]
    if limit_places(all_meshes):
        notes = [*notes, "Each mesh is shown once: its instances have more points than this page has room for."]
    times = chosen_times(all_meshes, frames)
    if any(meshes.changes for meshes in all_meshes):
        run = longest_run(all_meshes, times)
        span = f"time {run[0]:g}" if len(run) == 1 else f"times {run[0]:g} to {run[-1]:g}"
        part = f"{len(run)} of {len(times)} frames, in which it stays the same"
        notes = [*notes, f"The topology varies over time. Picture and curves are of {span}, {part}; tables of all."]
        times = run
    shown = chosen_frames(len(times), sum(meshes.point_count for meshes in all_meshes)) if times else range(0)
    own = [times[index] for index in shown] or None
    thinned = shown.step > 1
    left_out = dict.fromkeys(path for meshes in all_meshes for path in meshes.left_out)
    notes = [*notes, *(f"{path}: not shown, its topology varies over time" for path in left_out)]
    if thinned:
        left = f"Shown and measured: {len(shown)} of {len(times)} frames, one in {shown.step}: the page stays small."
        notes = [*notes, left]
    points, faces = original.read(own)
    skeletons = skeletons_of(original.sources, own)
    # Textures that all files have are on the page once.
    materials = Materials()
    rate = original.stage.GetTimeCodesPerSecond() / (float(np.median(np.diff(own))) if own and len(own) > 1 else 1.0)
    look = original.look(own, materials)
    shown_levels = [
        Level(name, *meshes.read(own), look=meshes.look(own, materials), used_joints=_used_joints(meshes))
        for name, meshes in levels
    ]
    return Report(
        title=title,
        points=points,
        faces=faces,
        levels=shown_levels,
        times=own,
        frames_per_second=rate,
        up=original.up,
        tables=tables,
        notes=[*notes, *materials.left_out],
        look=look,
        skeletons=skeletons,
        thinned=thinned,
    )


def _used_joints(meshes: WorldMeshes) -> dict[str, set[str]]:
    """Joints that move the meshes of a level, by skeleton."""
    used: dict[str, set[str]] = {}
    for source in meshes.sources:
        if source.poser is not None and source.poser.skinning_query.HasJointInfluences():
            path = str(source.poser.skeleton_query.GetPrim().GetPath())
            used.setdefault(path, set()).update(moving_joints(source.poser))
    return used


def _errors_by_mesh(level: str, report: StageReport) -> dict[str, dict[str, Any]]:
    """Verdict and errors of each mesh of a level, by its path."""
    of_level = [prim for prim in report.prims if not isinstance(prim, LevelReport) or prim.level == level]
    return {
        prim.path: {name: prim.measured[name] for name in ("verdict", "reason", "rms", "hausdorff")}
        for prim in of_level
        if prim.measured is not None
    }


def _mesh_table(prims: Sequence[PrimReport]) -> Table:
    errors = ("RMS %", "Hausdorff %", "flips a frame", "verdict")
    head = ("mesh", "frames", "faces before", "faces after", *errors, "stopped", "seconds")
    rows = []
    for prim in prims:
        level = f" ({prim.level})" if isinstance(prim, LevelReport) else ""
        stopped = prim.stopped if prim.status == "simplified" else prim.status
        counts = (prim.frames, prim.faces_before, prim.faces_after)
        found = prim.measured or {}
        figures = [found.get(name) for name in ("rms", "hausdorff", "flips", "verdict")]
        rows.append((prim.path + level, *counts, *figures, stopped, round(prim.seconds, 2)))
    return Table("Meshes", head, rows)


def _name(path: str, level: str | None) -> str:
    """What tables call a mesh."""
    return path if level is None else f"{path} ({level})"


def _pair_table(pairs: Sequence[PairReport]) -> Table:
    errors = ("RMS %", "Hausdorff %", "flips a frame", "verdict")
    motion = ("jitter %", "slide %", "slide 95 %", "edge length %")
    rows = []
    for pair in pairs:
        found = pair.comparison
        if found is not None:
            figures = (found.rms, found.hausdorff, found.flips, found.verdict.word)
            moving = (found.jitter, found.slide, found.slide_p95, found.edge_length_error)
            rows.append((_name(pair.path, pair.level), found.frame_count, *figures, *moving))
    return Table("Meshes", ("mesh", "frames", *errors, *motion), rows)


def _appearance_tables(found: Sequence[tuple[str, Appearance]], notes: list[str]) -> list[Table]:
    """The table of how meshes look different, if there is anything in it; ``notes`` takes why some have no figure."""
    rows = []
    for name, appearance in found:
        rows += [(name, *row) for row in appearance_rows(appearance)]
        notes += [f"{name}: {kind}: none, as {reason}" for kind, reason in appearance.not_measured.items()]
    return [Table(APPEARANCE_TITLE, ("mesh", "values", *APPEARANCE_COLUMNS), rows)] if rows else []


def _looks(
    report: StageReport,
    original: WorldMeshes,
    levels: Sequence[tuple[str, WorldMeshes]],
    options: SimplifyOptions,
    notes: list[str],
) -> list[tuple[str, Appearance]]:
    """How the simplified meshes of each level look different, by name; ``notes`` takes why one cannot be compared."""
    found = []
    for prim in report.prims:
        # Runs of different topologies have no appearance as a whole.
        if prim.status != "simplified" or prim.runs:
            continue
        level = prim.level if isinstance(prim, LevelReport) else levels[0][0]
        name = _name(prim.path, level if isinstance(prim, LevelReport) else None)
        stage = dict(levels)[level].stage
        try:
            found.append((name, stage_looks(original.stage, stage, prim.path, options.frames, options.device)))
        except WarpqemError as error:
            notes.append(f"{name}: texture, shading and colours: not compared: {error}")
    return found


def _option_table(options: SimplifyOptions) -> Table:
    rows: list[tuple[str, Any]] = []
    for field in fields(options):
        value = getattr(options, field.name)
        if field.name in ALWAYS or value != field.default:
            rows.append((field.name.replace("_", " "), _as_text(value)))
    rows = [row for row in rows if row[0] not in ("device", "metric")]
    model = cost_model(options.metric)
    rows.append(("metric", f"{model.name} ({model.source})" if model.source else model.name))
    rows += [("device", resolve_device(options.device)), ("warpqem", warpqem.__version__)]
    return Table("Options", ("", ""), rows)


def _feature_points(page: Report) -> dict[str, int]:
    """The feature points of the face on a page; none where it shows more than a face."""
    try:
        return dict(warpqem.face.facial_features(page.points, page.faces).vertices)
    except WarpqemError:
        return {}


def _as_text(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if value is None:
        return "–"
    return ", ".join(map(str, value)) if isinstance(value, tuple) else str(value)
