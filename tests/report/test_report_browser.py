"""The HTML report in a real browser: headless Chromium, WebGL in software."""

from __future__ import annotations

import threading

import numpy as np
import pytest

import warpqem
from tests.support.browser import CHROMIUM, changed, open_page, picture, state
from tests.support.report import waving
from warpqem.report import Level, Report, Table, report_page, write_report
from warpqem.report.live import LiveLevels
from warpqem.report.server import PageServer

pytest.importorskip("playwright.sync_api", reason="the browser extra is not installed")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium")


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    points, faces = waving(6)
    levels = [
        Level(name, points + np.float32([0, 0, 0.02 * k]) * points[..., :1], faces[: len(faces) // k])
        for k, name in ((1, "LOD1"), (2, "LOD2"))
    ]
    path = tmp_path_factory.mktemp("report") / "report.html"
    tables = [Table("Options", ("", ""), [("metric", "dsd")])]
    write_report(path, Report("Waves", points, faces, levels, tables=tables), device="cpu")
    return path.as_uri()


@pytest.fixture
def page(browser, address):
    """The page, paused; its console has to stay free of errors and the network unused."""
    with open_page(browser, address) as page:
        yield page


def test_both_meshes_are_drawn(page):
    shown = picture(page)
    half = shown.shape[1] // 2
    for pane in (shown[60:, :half], shown[60:, half:]):
        background = pane[-1, -1]
        assert (np.abs(pane - background).sum(axis=-1) > 30).mean() > 0.05


def test_scrubber_moves_the_meshes(page):
    before = picture(page)
    page.locator("#scrub").fill("3")
    assert state(page, "frame") == 3
    assert page.locator("#time").inner_text() == "4 (4/6)"
    assert changed(before, picture(page))


def test_space_plays_and_pauses(page):
    page.keyboard.press("Space")
    page.wait_for_function("window.warpqem.state.frame > 1")
    page.keyboard.press("Space")
    assert state(page, "playing") is False


def test_it_plays_by_itself_where_motion_is_welcome(browser, address):
    context = browser.new_context(reduced_motion="no-preference")
    page = context.new_page()
    page.goto(address)
    page.wait_for_function("window.warpqem && window.warpqem.state.frame > 1")
    context.close()


def test_arrows_step_and_wrap_around(page):
    page.keyboard.press("ArrowLeft")
    assert state(page, "frame") == 5
    page.keyboard.press("ArrowRight")
    assert state(page, "frame") == 0


def test_heat_map_toggles(page):
    # Of the coarser level: both have one scale.
    page.locator("#level").fill("0")
    page.wait_for_function("document.getElementById('level-name').textContent.startsWith('LOD2')")
    page.evaluate("document.activeElement.blur()")
    plain = picture(page)
    page.click("#color [data-value=heat]")
    heat = picture(page)
    assert page.locator("#legend").is_visible()
    assert changed(plain, heat)
    # The farthest vertices are green, which nothing else on the page is.
    assert ((heat[..., 1] - heat[..., 2] > 30) & (heat[..., 1] - heat[..., 0] > 30)).any()
    page.keyboard.press("h")
    assert not changed(plain, picture(page))
    assert page.locator("#legend").is_hidden()


def test_wireframe_adds_lines(page):
    plain = picture(page)
    page.click("#wire")
    assert changed(plain, picture(page))


def test_level_slider_changes_the_simplified_mesh_alone(page):
    before = picture(page)
    # From coarse at the left to fine at the right.
    page.locator("#level").fill("0")
    page.wait_for_function("document.getElementById('level-name').textContent.startsWith('LOD2')")
    after = picture(page)
    half = before.shape[1] // 2
    assert not changed(before[:, : half - 2], after[:, : half - 2])
    assert changed(before[:, half:], after[:, half:])


@pytest.mark.parametrize("key", ["2", "3", "4"])
def test_layouts_use_the_whole_view(page, key):
    page.keyboard.press(key)
    shown = picture(page)
    middle = shown[60:, shown.shape[1] // 2 - 20 : shown.shape[1] // 2 + 20]
    assert (np.abs(middle - shown[-1, -1]).sum(axis=-1) > 30).any()


def test_both_panes_turn_together(page):
    before = picture(page)
    box = page.locator("#canvas").bounding_box()
    x, y = box["x"] + box["width"] / 4, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 60, y + 20, steps=3)
    page.mouse.up()
    after = picture(page)
    half = before.shape[1] // 2
    assert changed(before[:, :half], after[:, :half])
    assert changed(before[:, half:], after[:, half:])


def test_plots_follow_the_frame_and_choose_it(page):
    line = page.locator("#plots .now").first
    before = line.get_attribute("x1")
    page.locator("#plots svg").first.click(position={"x": 300, "y": 60})
    assert state(page, "frame") > 0
    assert line.get_attribute("x1") != before


def test_tables_name_the_levels_and_the_options(page):
    text = page.locator("#tables").inner_text()
    for word in ("LOD1", "LOD2", "Validity", "Options", "dsd"):
        assert word in text


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_colours_follow_the_system(browser, address, scheme):
    context = browser.new_context(color_scheme=scheme)
    page = context.new_page()
    page.goto(address)
    background = page.evaluate("getComputedStyle(document.body).backgroundColor")
    dark = sum(map(int, background.removeprefix("rgb(").removesuffix(")").split(","))) < 380
    assert dark == (scheme == "dark")
    context.close()


def test_phone_has_no_sideways_scroll_and_stacks_the_panes(browser, address):
    context = browser.new_context(viewport={"width": 375, "height": 760}, is_mobile=True, has_touch=True)
    page = context.new_page()
    page.goto(address)
    page.wait_for_function("window.warpqem && window.warpqem.ready")
    assert page.evaluate("document.documentElement.scrollWidth") <= 375
    left, right = (page.locator(f"#tag-{side}").bounding_box() for side in ("left", "right"))
    assert right["y"] > left["y"] + 100
    context.close()


def test_levels_come_from_the_server_of_view(browser):
    points, faces = waving(4)
    live = LiveLevels(warpqem.build_progressive(points, faces, device="cpu"), "waves", {}, device="cpu")
    server = PageServer(report_page(live.data()), live.level)
    thread = threading.Thread(target=server.serve)
    thread.start()
    try:
        page = browser.new_page(reduced_motion="reduce")
        errors = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(server.address)
        page.wait_for_function("window.warpqem && window.warpqem.ready")
        before = picture(page)
        page.locator("#level").fill("0")
        page.wait_for_function("!document.getElementById('level-name').textContent.endsWith('…')")
        assert changed(before, picture(page))
        page.keyboard.press("h")
        assert page.locator("#legend").is_visible()
        assert errors == []
        page.close()
    finally:
        server.stop()
        thread.join()


def test_markers_can_be_hidden(browser, tmp_path):
    points, faces = waving(4)
    report = Report("marked", points, faces, [Level("level", points, faces)], markers={"corner": 0, "other": 20})
    write_report(tmp_path / "page.html", report, device="cpu")
    page = browser.new_page(reduced_motion="reduce")
    page.goto((tmp_path / "page.html").as_uri())
    page.wait_for_function("window.warpqem && window.warpqem.ready")

    def red() -> int:
        shown = picture(page)
        return int(((shown[..., 0] > 180) & (shown[..., 1] < 110)).sum())

    assert red() > 20
    page.click("#dots")
    assert red() == 0
    page.close()


@pytest.mark.parametrize("room", [2500, 100])
def test_page_without_some_meshes_or_all_shows_the_rest(browser, tmp_path, monkeypatch, room):
    monkeypatch.setattr("warpqem.report.data.LARGEST_MESHES", room)
    points, faces = waving(4)
    report = Report("large", points, faces, [Level("level", points + np.float32([0, 0, 0.1]), faces)])
    write_report(tmp_path / "page.html", report, device="cpu")
    page = browser.new_page(reduced_motion="reduce")
    errors = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto((tmp_path / "page.html").as_uri())
    if room == 100:
        page.wait_for_selector("#message:visible")
    else:
        page.wait_for_function("window.warpqem && window.warpqem.ready")
    assert "Validity" in page.locator("#tables").inner_text()
    page.locator("#scrub").fill("2")
    assert errors == []
    page.close()
