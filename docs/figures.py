"""Draw every picture of the documentation: ``python -m docs.figures [NAME ...]``, from the root of a checkout.

It needs the extra `scenes`; the picture of a report needs the extra `browser` and a Chromium, and stays as it is
without them.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

import warpqem
from examples import before_after, paper_tables
from scenes import head
from scenes.generate import SCENES, VIEWS
from scenes.generate import picture as scenes_picture
from warpqem.measure import vertex_distances
from warpqem.measure.heatmap import COLOR_MAP, distance_colors
from warpqem.normal_maps.maps import NormalMap
from warpqem.picture import View, caption, fit_view, render, tile, write_gif, write_png
from warpqem.picture.layers import render_layers
from warpqem.picture.render import place_scene
from warpqem.usd import FrameRange, SimplifyOptions, simplify_stage
from warpqem.usd.commands.motion_features import feature_colors
from warpqem.usd.commands.report_page import write_simplify_report
from warpqem.usd.read.materials import Materials
from warpqem.usd.read.normal_textures import NormalTextures
from warpqem.usd.read.world import WorldMeshes

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
SIZE = (440, 290)
# A frame in which the legs of the quadruped are far apart.
STRIDE = 11
# Its eyes and mouth, and pictures of three in a row.
FACE_VIEW, FACE_SIZE = View(16.0, 2.0, (0.0, -5.0, 1.0), 15.0), (300, 300)
# The face of the head, from the front.
HEAD_VIEW = View(16.0, 2.0, (0.0, 0.5, 1.0), 27.0)

Pixels = np.ndarray


@cache
def _gallop() -> tuple[np.ndarray, np.ndarray]:
    scene = SCENES["quadruped_gallop"]()
    return scene.baked(), scene.faces


def _colors(result: warpqem.SimplifiedMesh | None = None) -> np.ndarray:
    """Colours of the quadruped's vertices; of a simplified one the means of those that each vertex stands for."""
    colors = SCENES["quadruped_gallop"]().colors
    if result is None:
        return colors
    kept = result.vertex_map >= 0
    count = np.bincount(result.vertex_map[kept], minlength=result.points.shape[1])
    sums = [np.bincount(result.vertex_map[kept], channel[kept], result.points.shape[1]) for channel in colors.T]
    return np.stack(sums, axis=1) / np.maximum(count, 1)[:, None]


def _view() -> View:
    return VIEWS["quadruped_gallop"]


def _simplify(ratio: float, **options: object) -> warpqem.SimplifiedMesh:
    points, faces = _gallop()
    return warpqem.simplify(points, faces, ratio=ratio, **options)


def _draw(points: np.ndarray, faces: np.ndarray, text: str, **options: object) -> Pixels:
    return caption(render(points, faces, _view(), size=SIZE, **options), text)


def _heat(results: dict[str, warpqem.SimplifiedMesh], path: Path) -> None:
    """One frame of each result, with the distance to the original as colours of one scale."""
    points, faces = _gallop()
    scale = max(float(vertex_distances(points, faces, r.points, r.faces).max()) for r in results.values())
    pictures = []
    for name, result in results.items():
        colors, _ = distance_colors(points, faces, result.points, result.faces, scale=scale)
        text = f"{name}: {len(result.faces):,} faces"
        drawn = render(result.points[STRIDE], result.faces, _view(), size=SIZE, colors=colors[STRIDE], smooth=True)
        pictures.append(caption(drawn, text, (COLOR_MAP, f"{scale:.2f} %")))
    write_png(tile(pictures, 2), path)


def gallop(path: Path) -> None:
    """The quadruped and a tenth of it, galloping."""
    points, faces = _gallop()
    result = _simplify(0.1)
    pictures = []
    meshes = (points, faces, _colors(), False), (result.points, result.faces, _colors(result), True)
    # One stride of two, frame by frame.
    for frame in range(len(points) // 2):
        pair = [
            caption(
                render(p[frame], f, _view(), size=(440, 290), colors=c, lines=lines, smooth=True), f"{len(f):,} faces"
            )
            for p, f, c, lines in meshes
        ]
        pictures.append(tile(pair, 2))
    write_gif(pictures, path, frames_per_second=25, colors=64)


def levels(path: Path) -> None:
    """Levels of one ordering."""
    points, faces = _gallop()
    ratios = (0.5, 0.2, 0.08, 0.03)
    results = warpqem.simplify_levels(points, faces, ratios=ratios)
    pictures = [
        _draw(
            result.points[STRIDE],
            result.faces,
            f"{len(result.faces):,} faces",
            lines=True,
            smooth=True,
            colors=_colors(result),
        )
        for result in results
    ]
    write_png(tile(pictures, 2), path)


def metrics(path: Path) -> None:
    """The cost models, each at 4 %."""
    _heat({name: _simplify(0.04, metric=name) for name in ("qem", "dsd", "dod", "aqem")}, path)


def joints(path: Path) -> None:
    """What bends, and where the edges go because of it."""
    points, faces = _gallop()
    found = warpqem.motion_features(points, faces)
    result = _simplify(0.08, metric="aqem")
    pictures = [
        _draw(points[STRIDE], faces, f"{found.feature_count} joints", colors=feature_colors(found.label), smooth=True),
        _draw(result.points[STRIDE], result.faces, f"aqem, {len(result.faces):,} faces", lines=True, smooth=True),
    ]
    write_png(tile(pictures, 2), path)


def morph(path: Path) -> None:
    """A head at the ratio of surface simplification guided by morph-targets, without and with its weights.

    The neutral shape, coloured by its distance from the result: what MESH draws in that paper.
    """
    # As many triangles as there, or nearly.
    scene = head.build(face_count=3128)
    frames = paper_tables.shapes_of(scene)
    thirds = warpqem.costs.morph_weights(frames[0], frames[1:], method="thirds")
    options = {"ratio": paper_tables.PAPER_RATIO, "metric": "qem"}
    results = {
        "qem": warpqem.simplify(frames, scene.faces, **options),
        "qem, thirds": warpqem.simplify(frames, scene.faces, quadric_scale=thirds, **options),
    }
    pairs = [(result.points[0], result.faces, frames[0], scene.faces) for result in results.values()]
    # The few farthest vertices would leave all others dark.
    scale = max(float(np.quantile(vertex_distances(*pair), 0.99)) for pair in pairs)
    pictures = []
    for (name, result), pair in zip(results.items(), pairs, strict=True):
        colors, _ = distance_colors(*pair, scale=scale)
        text = f"{name}: {len(result.faces):,} of {len(scene.faces):,} faces"
        drawn = render(frames[0], scene.faces, HEAD_VIEW, size=SIZE, colors=colors[0], smooth=True)
        pictures.append(caption(drawn, text, (COLOR_MAP, f"{scale:.2f} %")))
    write_png(tile(pictures, 2), path)


def appearance(path: Path) -> None:
    """Eyes and mouth of the head, and the cape: the input, and a twentieth of it without and with fitted normals."""
    pictures = []
    for name, view, time in (("talking_head", FACE_VIEW, 12.0), ("cape_wind", VIEWS["cape_wind"], 30.0)):
        file = ROOT / "scenes" / f"{name}.usdc"
        with tempfile.TemporaryDirectory() as folder:
            drawn = {"input": file}
            for title, normals in (("5 %, normals of its faces", "keep"), ("5 %, fitted normals", "fit")):
                drawn[title] = Path(folder) / f"{normals}.usdc"
                simplify_stage(file, drawn[title], SimplifyOptions(ratio=0.05, normals=normals, measure=False))
            for title, shown in drawn.items():
                mesh = WorldMeshes(shown).shown(time, Materials(), NormalTextures())
                scene = place_scene(mesh.points, mesh.faces, view, FACE_SIZE, normals=mesh.normals, look=mesh.look)
                pictures.append(caption(render_layers(scene).gray, title))
    write_png(tile(pictures, 3), path)


def scenes(path: Path) -> None:
    """The shipped scenes."""
    scenes_picture({name: build() for name, build in SCENES.items()}, path)


def normal_map(path: Path) -> None:
    """The cape in its first frame, and 5 % of it: shaded by its normals, and with a normal map over them."""
    scene = ROOT / "scenes" / "cape_wind.usdc"
    flat = NormalMap(np.array([[[0.0, 0.0, 1.0]]], dtype=np.float32))
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "cape.usdc"
        # One frame is drawn, and so one is simplified.
        options = SimplifyOptions(ratio=0.05, bake_normals=512, normals="fit", frames=FrameRange(1.0, 1.0))
        simplify_stage(scene, output, options)
        drawn = [WorldMeshes(file) for file in (scene, output)]
        (points, faces), (fewer_points, fewer) = (mesh.read([1.0]) for mesh in drawn)
        look = drawn[1].look([1.0], Materials(), NormalTextures())
    plain = replace(look, colors=None, textures=(), parts=[replace(part, texture=None) for part in look.parts])
    assert plain.mapped is not None
    without = replace(plain, mapped=replace(plain.mapped, maps=[flat]))
    view = fit_view(points, up=drawn[0].up, aspect=SIZE[0] / SIZE[1])
    pictures = [
        caption(render(*mesh, view, size=SIZE, smooth=True, look=shown), text)
        for mesh, shown, text in (
            ((points[0], faces), None, f"{len(faces):,} faces"),
            ((fewer_points[0], fewer), without, f"{len(fewer):,} faces"),
            ((fewer_points[0], fewer), plain, f"{len(fewer):,} faces and a normal map"),
        )
    ]
    write_png(tile(pictures, 3), path)


def report(path: Path) -> None:
    """The page of --report, as a browser shows it."""
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        chromium = None
    if chromium is None:
        print(f"{path}: left as it is, it needs playwright and a Chromium")
        return
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        page_file, output = Path(folder) / "report.html", Path(folder) / "quadruped_10.usdc"
        options = SimplifyOptions(ratio=0.1)
        done = simplify_stage(ROOT / "scenes" / "quadruped_gallop.usdc", output, options)
        write_simplify_report(page_file, done, options)
        flags = ["--no-sandbox", "--disable-gpu", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
        browser = playwright.chromium.launch(executable_path=chromium, args=flags)
        page = browser.new_page(viewport={"width": 1200, "height": 860}, reduced_motion="reduce")
        page.goto(page_file.as_uri())
        page.wait_for_function("window.warpqem && window.warpqem.ready")
        page.locator("#scrub").fill(str(STRIDE))
        # No mark of the keyboard's focus on the scrubber.
        page.evaluate("document.activeElement.blur()")
        page.wait_for_function("!window.warpqem.state.dirty")
        page.screenshot(path=str(path))
        browser.close()


FIGURES: dict[str, Callable[[Path], None]] = {
    "gallop.gif": gallop,
    "before_after.png": lambda path: before_after.main(str(path)),
    "levels.png": levels,
    "metrics.png": metrics,
    "joints.png": joints,
    "morph.png": morph,
    "appearance.png": appearance,
    "normal_map.png": normal_map,
    "report.png": report,
    "scenes.png": scenes,
}


def main(names: list[str]) -> None:
    """Draw those that are named, or all."""
    for name in names or FIGURES:
        FIGURES[name](DOCS / name)
        print(DOCS / name)


if __name__ == "__main__":
    main(sys.argv[1:])
