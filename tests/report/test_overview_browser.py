"""The overview of a batch in headless Chromium."""

from __future__ import annotations

import os

import numpy as np
import pytest

from tests.support.browser import CHROMIUM, open_page
from warpqem.report.overview import Asset, overview_page

pytest.importorskip("playwright.sync_api", reason="the browser extra is not installed")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium")

PHONE = {"viewport": {"width": 390, "height": 844}, "is_mobile": True, "has_touch": True}
AXE = os.environ.get("AXE_CORE")
PICTURE = np.full((6, 8, 3), 90, dtype=np.uint8)
ASSETS = [
    Asset("b", "done", 12345, 10, "poor", "Hausdorff 3 % is above 2", rms=0.5, seconds=1.0, pictures=[PICTURE, PICTURE],
          link="out/b.usdc", page="pages/b.html"),
    Asset("a", "failed", message="lost"),
    Asset("c", "done", 20, 10, "good", rms=0.1),
]  # fmt: skip


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    path = tmp_path_factory.mktemp("overview") / "page.html"
    path.write_text(overview_page("three", ASSETS), "utf-8")
    return path.as_uri()


@pytest.fixture
def page(browser, address):
    with open_page(browser, address, ready="window.warpqem") as page:
        yield page


def names(page) -> list[str]:
    return page.locator(".asset-name:visible").all_inner_texts()


def test_grid_shows_every_asset_with_figures_and_dashes_for_what_did_not_happen(page):
    assert names(page) == ["b", "a", "c"]
    first, second = page.locator(".asset").all_inner_texts()[:2]
    assert "12\u202f345 → 10" in first
    assert "Hausdorff 3 % is above 2" in first
    assert "– → –" in second
    assert "lost" in second
    assert page.locator(".asset img").count() == 2


def test_names_lead_to_the_reports_and_files_are_beside_them(page):
    assert page.locator(".asset a").evaluate_all("(links) => links.map((a) => a.getAttribute('href'))") == [
        "pages/b.html", "out/b.usdc"
    ]  # fmt: skip


def test_table_is_sorted_by_its_heads(page):
    page.click("#form [data-value=table]")
    for column, order in (("RMS", ["c", "b", "a"]), ("verdict", ["b", "c", "a"]), ("status", ["a", "b", "c"])):
        page.click(f"thead button:text-is('{column}')")
        assert names(page) == order
    page.click("thead button:text-is('asset')")
    page.click("thead button:text-is('asset')")
    assert names(page) == ["c", "b", "a"]
    reasons = page.locator("tbody td:last-child").all_inner_texts()
    assert sorted(reasons) == ["Hausdorff 3 % is above 2", "lost", "–"]


def test_order_can_be_chosen_in_the_grid(page):
    page.select_option("#order", label="RMS, least first")
    assert names(page) == ["c", "b", "a"]
    page.select_option("#order", label="the worst first")
    assert names(page) == ["b", "a", "c"]


def test_assets_are_limited_by_status_and_text(page):
    page.click("#status [data-value=failed]")
    assert names(page) == ["a"]
    assert page.locator("#facts").inner_text() == "1 of 3 assets"
    page.click("#status [data-value=all]")
    page.fill("#search", "HAUSDORFF")
    assert names(page) == ["b"]


def test_phone_has_large_targets_and_no_sideways_scroll(browser, address):
    with open_page(browser, address, ready="window.warpqem", **PHONE) as page:
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        heights = page.locator("button:visible, select:visible, .asset a").evaluate_all(
            "(all) => all.map((e) => e.getBoundingClientRect().height)"
        )
        assert min(heights) >= 44
        page.click("#form [data-value=table]")
        assert page.locator(".hint").is_visible()
        assert page.evaluate("document.documentElement.scrollWidth") <= 390


@pytest.mark.skipif(AXE is None, reason="AXE_CORE does not name the script of axe-core")
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("form", ["grid", "table"])
@pytest.mark.parametrize("options", [{}, PHONE], ids=["desktop", "phone"])
def test_overview_is_accessible(browser, address, scheme, form, options):
    with open_page(browser, address, ready="window.warpqem", color_scheme=scheme, **options) as page:
        page.click(f"#form [data-value={form}]")
        page.add_script_tag(path=AXE)
        found = page.evaluate("axe.run().then((r) => r.violations.map((v) => [v.id, v.nodes.map((n) => n.html)]))")
        assert found == []
