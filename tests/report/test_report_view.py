"""What the page of a report shows and how it is used, in headless Chromium."""

from __future__ import annotations

import io
import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.support import meshes
from tests.support.browser import CHROMIUM, changed, open_page, picture, state
from tests.support.report import waving
from warpqem.picture.look import Look, Part, Texture
from warpqem.report import Curve, Level, Report, Skeleton, Table, write_report

pytest.importorskip("playwright.sync_api", reason="the browser extra is not installed")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium")

PHONE = {"viewport": {"width": 390, "height": 844}, "is_mobile": True, "has_touch": True}
# Checks of accessibility: the script of axe-core (`npm install axe-core`).
AXE = os.environ.get("AXE_CORE")


def striped(faces: np.ndarray, points: np.ndarray) -> Look:
    """Two meshes: the first half textured red at its left and green at its right, the other half blue."""
    pixels = np.zeros((2, 2, 3), dtype=np.uint8)
    pixels[:, 0], pixels[:, 1] = [220, 20, 20], [20, 220, 20]
    half = np.arange(len(faces)) >= len(faces) // 2
    colors = np.ones((len(faces), 3, 3), dtype=np.float32)
    colors[half] = [0, 0, 1]
    place = points[0][faces][..., :2]
    uvs = (place - place.min(axis=(0, 1))) / np.ptp(place, axis=(0, 1))
    return Look(half.astype(int), [Part("/Root/First", 0), Part("/Root/Second")], [Texture(pixels)], colors, uvs)


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    points, faces = waving(6)
    # Farthest from the original in its fourth frame.
    off = points + np.float32([0, 0, 0.02]) * np.float32([1, 1, 1, 4, 1, 1])[:, None, None]
    look = striped(faces, points)
    verdicts = {"/Root/First": {"verdict": "poor", "reason": "too far", "rms": 0.1, "hausdorff": 3.0}}
    levels = [
        Level("LOD1", points + np.float32([0, 0, 0.005]), faces, look=look, meshes=verdicts),
        Level("LOD2", off, faces, look=look, meshes=verdicts),
    ]
    head = [f"column {k}" for k in range(12)]
    tables = [Table("Wide", head, [["/Root/A/long/path/of/a/mesh", *range(11)]])]
    path = tmp_path_factory.mktemp("view") / "report.html"
    write_report(path, Report("Waves", points, faces, levels, tables=tables, look=look), device="cpu")
    return path.as_uri()


@pytest.fixture
def page(browser, address):
    with open_page(browser, address) as page:
        yield page


def has_color(shown: np.ndarray, channel: int) -> bool:
    others = np.delete(shown, channel, axis=-1).max(axis=-1)
    return bool((shown[..., channel] - others > 60).sum() > 50)


def pane(shown: np.ndarray, index: int) -> np.ndarray:
    half = shown.shape[1] // 2
    return shown[60:, index * half : (index + 1) * half]


def test_textures_and_colours_are_shown_at_first(page):
    shown = picture(page)
    for index in (0, 1):
        assert all(has_color(pane(shown, index), channel) for channel in range(3))
    page.keyboard.press("p")
    assert not has_color(picture(page), 1)


def test_texture_lies_with_its_left_at_the_left(page):
    page.keyboard.press("3")
    shown = picture(page)
    red, green = ((shown[..., c] - np.delete(shown, c, -1).max(-1) > 60).nonzero()[1].mean() for c in (0, 1))
    assert red < green


def test_faceted_shading_is_a_choice(browser, tmp_path):
    points, faces = meshes.icosphere(1)
    write_report(tmp_path / "page.html", Report("Ball", points, faces, [Level("level", points, faces)]), device="cpu")
    with open_page(browser, (tmp_path / "page.html").as_uri()) as page:
        smooth = picture(page)
        page.click("#shading [data-value=flat]")
        flat = picture(page)
        assert changed(smooth, flat)
        # Steps at the edges of the faces.
        steps = [np.abs(np.diff(shown[200:300, 150:280, 0], axis=1)).max() for shown in (smooth, flat)]
        assert steps[1] > 2 * steps[0]
        page.keyboard.press("s")
        assert not changed(smooth, picture(page))


def test_worst_frame_is_at_one_click(page):
    page.locator("#level").fill("0")
    page.wait_for_function("document.getElementById('level-name').textContent.startsWith('LOD2')")
    page.click("#worst")
    assert state(page, "frame") == 3
    assert "Frame 4" in page.locator("#told").inner_text()


def test_all_levels_have_one_scale_with_ticks(page):
    page.click("#color [data-value=heat]")
    ticks = page.locator("#legend-ticks span").all_inner_texts()
    assert ticks[0] == "0"
    assert ticks[-1].startswith("≥ ")
    fine = picture(page)
    page.locator("#level").fill("0")
    page.wait_for_function("document.getElementById('level-name').textContent.startsWith('LOD2')")
    assert changed(pane(fine, 1), pane(picture(page), 1))
    assert page.locator("#legend-ticks span").all_inner_texts() == ticks


def test_level_slider_goes_from_coarse_to_fine(page):
    assert page.locator("#level").input_value() == "1"
    assert state(page, "level") == 0
    page.locator("#level").focus()
    page.keyboard.press("ArrowLeft")
    assert state(page, "level") == 1


def test_keys_of_a_focused_control_are_its_own(page):
    page.locator("#scrub").focus()
    page.keyboard.press("ArrowRight")
    assert state(page, "frame") == 1
    page.locator("#wire").focus()
    page.keyboard.press("Space")
    assert (state(page, "wire"), state(page, "playing")) == (True, False)
    page.locator("#layout [aria-checked=true]").focus()
    page.keyboard.press("ArrowRight")
    assert (state(page, "layout"), state(page, "frame")) == ("over", 1)
    assert page.evaluate("document.activeElement.dataset.value") == "over"


def test_slow_machines_play_with_fewer_pixels_and_stop_with_all(browser, address):
    context = browser.new_context()
    context.add_init_script("window.requestAnimationFrame = (draw) => setTimeout(() => draw(performance.now()), 80)")
    page = context.new_page()
    page.goto(address)
    width = "document.getElementById('canvas').width"
    page.wait_for_function(f"window.warpqem && window.warpqem.state.playing && {width} < 600")
    page.click("#play")
    page.wait_for_function(f"{width} === document.getElementById('canvas').clientWidth")
    context.close()


def test_wheel_keeps_what_is_under_the_cursor(page):
    page.keyboard.press("3")
    page.click("#shading [data-value=flat]")
    box = page.locator("#canvas").bounding_box()
    x, y = box["width"] * 0.6, box["height"] * 0.55
    before = picture(page)
    page.mouse.move(box["x"] + x, box["y"] + y)
    page.mouse.wheel(0, -300)
    page.wait_for_function("window.warpqem.state.dirty === false")
    after = picture(page)
    assert changed(before, after)
    # The borders of the texture and of the meshes have moved away from it, or stayed.
    here = slice(int(y) - 1, int(y) + 2), slice(int(x) - 1, int(x) + 2)
    assert np.abs(before[here].mean((0, 1)) - after[here].mean((0, 1))).max() < 30


def test_double_click_looks_at_that_point(page):
    page.keyboard.press("3")
    box = page.locator("#canvas").bounding_box()
    page.mouse.dblclick(box["x"] + box["width"] * 0.6, box["y"] + box["height"] * 0.5)
    before = picture(page)
    # What is turned about stays in the middle.
    middle = before.shape[0] // 2, before.shape[1] // 2
    page.mouse.move(box["x"] + 100, box["y"] + 100)
    page.mouse.down()
    page.mouse.move(box["x"] + 140, box["y"] + 100, steps=3)
    page.mouse.up()
    after = picture(page)
    assert changed(before, after)
    assert np.argmax(before[middle]) == np.argmax(after[middle])


def test_fit_and_reset_bring_the_mesh_back(page):
    first = picture(page)
    box = page.locator("#canvas").bounding_box()
    page.mouse.move(box["x"] + 100, box["y"] + 100)
    page.mouse.wheel(0, 3000)
    assert changed(first, picture(page))
    page.click("#fit")
    shown = picture(page)
    assert all(has_color(shown, channel) for channel in range(3))
    page.click("#reset")
    assert not changed(first, picture(page))


def test_meshes_are_listed_with_their_verdicts(page):
    names = page.locator("#meshes .mesh-name").all_inner_texts()
    assert names == ["First", "Second"]
    assert page.locator("#meshes .verdict").all_inner_texts() == ["poor"]


def test_mesh_can_be_hidden_and_looked_at_alone(page):
    page.uncheck("#meshes li:nth-child(2) input")
    assert not has_color(picture(page), 2)
    page.click("#meshes button:text('Show all')")
    assert has_color(picture(page), 2)
    page.click("#meshes li:nth-child(2) .mesh")
    shown = picture(page)
    assert has_color(shown, 2)
    assert not has_color(shown, 0)
    page.click("#meshes li:nth-child(2) .mesh")
    assert has_color(picture(page), 0)


def test_link_leads_to_the_same_view(page, browser):
    page.locator("#scrub").fill("2")
    page.click("#layout [data-value=level]")
    page.click("#color [data-value=heat]")
    page.click("#wire")
    box = page.locator("#canvas").bounding_box()
    page.mouse.move(box["x"] + 200, box["y"] + 200)
    page.mouse.wheel(0, -200)
    page.click("#link")
    page.wait_for_function("document.getElementById('told').textContent")
    shown = picture(page)
    with open_page(browser, page.url) as other:
        other.wait_for_function("window.warpqem.state.frame === 2")
        assert (state(other, "layout"), state(other, "colors"), state(other, "wire")) == ("level", "heat", True)
        # Its numbers are rounded: lines fall a little differently on the pixels.
        assert np.abs(shown - picture(other)).mean() < 0.5
        other.mouse.move(box["x"] + 200, box["y"] + 200)
        other.mouse.wheel(0, -20)
        assert np.abs(shown - picture(other)).mean() > 0.5


@pytest.mark.parametrize("part", ["frame=99&level=none&layout=up", "camera=1,2,x", "color=%3Cb%3E&mesh=%00"])
def test_link_that_says_nothing_sensible_is_ignored(browser, address, part):
    with open_page(browser, f"{address}#{part}") as page:
        assert (state(page, "frame"), state(page, "layout"), state(page, "colors")) == (0, "side", "look")


def test_picture_is_saved_with_its_captions(page):
    page.keyboard.press("h")
    with page.expect_download() as download:
        page.click("#picture")
    saved = Path(download.value.path())
    assert download.value.suggested_filename.endswith(".png")
    shot = np.asarray(Image.open(io.BytesIO(saved.read_bytes())).convert("RGB")).astype(int)
    canvas = page.locator("#canvas").bounding_box()
    assert shot.shape[1] == round(canvas["width"])
    assert shot.shape[0] > canvas["height"] + 60
    # Text above, the mesh, and the colours of the legend below.
    assert np.ptp(shot[:30].sum(axis=-1)) > 300
    assert ((shot[-36:, :, 0] - shot[-36:, :, 2]) > 100).any()


def test_skeleton_is_drawn_with_the_joints_that_went(browser, tmp_path):
    points, faces = waving(2)
    places = np.repeat(np.array([[[0.2, 0.2, 0.3], [0.8, 0.8, 0.3], [0.8, 0.2, 0.3]]]), 2, axis=0)
    skeleton = Skeleton("/Rig", ["a", "b", "c"], np.array([-1, 0, 1]), places, {"a", "b", "c"})
    level = Level("level", points, faces, used_joints={"/Rig": {"a"}})
    curve = Curve("Error over joints", "%", "joints", [("x", [3, 2, 1], [0.0, 0.1, 0.2])])
    report = Report("Rig", points, faces, [level], skeletons=[skeleton], curves=[curve])
    write_report(tmp_path / "page.html", report, device="cpu")
    with open_page(browser, (tmp_path / "page.html").as_uri()) as page:
        assert not has_color(picture(page), 0)
        page.click("#bones")
        shown = picture(page)
        red = [(pane(shown, index)[..., 0] - pane(shown, index)[..., 1] > 100).sum() for index in (0, 1)]
        assert red[0] == 0
        assert red[1] > 40
        page.keyboard.press("b")
        assert not has_color(picture(page), 0)
        assert page.locator("#plots h2:text('Error over joints')").is_visible()


def test_figures_say_what_they_mean(page):
    page.click("#tables button.term:text('RMS %')")
    assert "Root mean square" in page.locator("#tables .meaning").first.inner_text()
    page.click("#tables button.term:text('RMS %')")
    assert page.locator("#tables .meaning").first.inner_text() == ""


def test_phone_has_large_targets_and_hints_to_scroll(browser, address):
    with open_page(browser, address, **PHONE) as page:
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        heights = page.evaluate(
            "[...document.querySelectorAll('button, select, summary, input[type=range]')]"
            ".filter((e) => e.offsetParent).map((e) => [e.id || e.textContent, e.getBoundingClientRect().height])"
        )
        assert [entry for entry in heights if entry[1] < 44] == []
        hint = page.locator(".card:has(h2:text-is('Wide')) .hint")
        assert hint.is_visible()
        page.locator("[aria-label=Wide]").evaluate("(e) => { e.scrollLeft = e.scrollWidth; }")
        hint.wait_for(state="hidden")


def test_page_without_scripts_has_the_figures_of_the_levels(browser, address):
    context = browser.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto(address)
    text = page.locator("noscript").inner_text()
    assert "need JavaScript" in text
    assert "LOD2" in text
    context.close()


def test_page_without_webgl_says_so_and_has_its_tables(browser, address):
    context = browser.new_context()
    context.add_init_script("HTMLCanvasElement.prototype.getContext = ((get) => function (kind, ...rest) {"
                            " return kind.startsWith('webgl') ? null : get.call(this, kind, ...rest); })"
                            "(HTMLCanvasElement.prototype.getContext)")  # fmt: skip
    page = context.new_page()
    page.goto(address)
    page.wait_for_selector("#message:visible")
    assert "no WebGL" in page.locator("#message").inner_text()
    assert "LOD2" in page.locator("#tables").inner_text()
    page.keyboard.press("f")
    page.keyboard.press("x")
    context.close()


@pytest.mark.skipif(AXE is None, reason="AXE_CORE does not name the script of axe-core")
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("options", [{}, PHONE], ids=["desktop", "phone"])
def test_page_is_accessible(browser, address, scheme, options):
    with open_page(browser, address, color_scheme=scheme, **options) as page:
        page.click("#color [data-value=heat]")
        page.evaluate("document.querySelectorAll('details').forEach((e) => { e.open = true; })")
        page.add_script_tag(path=AXE)
        found = page.evaluate("axe.run().then((r) => r.violations.map((v) => [v.id, v.nodes.map((n) => n.html)]))")
        assert found == []
