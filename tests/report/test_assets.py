"""The page in a browser: it requests nothing, logs nothing, and shows what was asked for."""

import shutil
from urllib.parse import urlencode

import pytest

from spoofbench.report import write_site
from spoofbench.scoring.leaderboard import leaderboard

CHROMIUM = (
    shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
)


@pytest.fixture(scope="module")
def browser():
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("no chromium is installed")
    with playwright.sync_playwright() as running:
        browser = running.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture
def visit(browser, tmp_path):
    """Open a folder's page; afterwards it must have requested itself alone and logged nothing."""
    requests, messages, contexts = [], [], []

    def open_page(folder, fragment="", **options):
        path = write_site(folder, leaderboard(folder), tmp_path / f"site{len(contexts)}")
        context = browser.new_context(**options)
        contexts.append(context)
        page = context.new_page()
        page.on("request", lambda request: requests.append(request.url.partition("#")[0]))
        page.on("console", lambda message: messages.append(message.text))
        page.on("pageerror", lambda error: messages.append(str(error)))
        page.goto(f"{path.as_uri()}{fragment}")
        page.wait_for_selector("#map svg")
        requests.remove(path.as_uri())
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert not requests
    assert not messages


def address(detector, attack, window, recording="drive"):
    return "#" + urlencode(
        {"detector": detector, "recording": recording, "attack": attack, "window": window}
    )


def column(page, number):
    return page.eval_on_selector_all(
        f".board >> nth=0 >> tbody tr > :nth-child({number})",
        "cells => cells.map(cell => cell.dataset.sort)",
    )


def test_a_link_leads_to_its_run_and_choosing_another_changes_it(folder, visit):
    page = visit(folder, address("correlation", "replay", "2"))
    assert page.inner_text("#run-title") == "correlation on replay, window 2"
    page.select_option("#choose-detector", "acceleration")
    assert page.inner_text("#run-title") == "acceleration on replay, window 2"
    assert "detector=acceleration" in page.evaluate("location.hash")
    page.click(".heat a >> nth=0")
    assert page.inner_text("#run-title").endswith("on replay, window 1")


def test_a_really_attacked_run_is_drawn_on_the_track_that_was_reported(calibrated_folder, visit):
    page = visit(calibrated_folder, address("acceleration", "as recorded", "-", "flight"))
    assert page.inner_text("#run-title") == "acceleration on as recorded"
    assert page.locator("#map .clean-track").count() == 1
    assert page.locator("#map .spoofed-track").count() == 1
    assert "as published" in page.inner_text("#facts")


def test_a_failed_run_says_so_and_still_has_its_map(folder, visit):
    page = visit(folder, address("n" * 64, "replay", "1"))
    assert page.inner_text("#status") == "failed: ValueError: no"
    assert page.locator("#timeline canvas").count() == 0
    assert page.locator("#map .spoofed-track").count() == 1


def test_the_map_has_one_scale_both_ways(folder, visit):
    page = visit(folder, address("acceleration", "replay", "1"))
    page.evaluate(
        "view = projection(track(DATA.variants[0]).clean, 800, 500, {left: 60, right: 10, top: "
        "10, bottom: 40})"
    )
    east, north = page.evaluate(
        "[view.pixel([100, 0])[0] - view.pixel([0, 0])[0], view.pixel([0, 0])[1] - view.pixel([0, "
        "100])[1]]"
    )
    assert east == pytest.approx(north)
    assert east > 0


def test_headings_sort_by_click_and_key_with_unknown_last(folder, visit):
    page = visit(folder)
    heading = page.locator(".board thead th >> nth=3")
    heading.locator("button").click()
    assert heading.get_attribute("aria-sort") == "descending"
    known = [float(key) for key in column(page, 4)]
    assert known == sorted(known, reverse=True)
    heading.locator("button").focus()
    page.keyboard.press("Enter")
    assert heading.get_attribute("aria-sort") == "ascending"
    assert [float(key) for key in column(page, 4)] == sorted(known)
    assert page.locator("th[aria-sort]").count() == 1
    page.click(".board thead th >> nth=2 >> button")
    assert column(page, 3)[-1] == ""


def test_arrow_keys_read_values_from_the_timeline(folder, visit):
    page = visit(folder, address("acceleration", "replay", "1"))
    page.focus("#timeline")
    page.keyboard.press("ArrowRight")
    assert page.inner_text("#readout") == "0.0 s: unavailable"
    for _ in range(4):
        page.keyboard.press("PageDown")
    assert page.inner_text("#readout").startswith("240.0 s: score ")
    assert "m from the clean position" in page.inner_text("#readout")
    assert page.locator("#map .reported-position").get_attribute("visibility") == "visible"


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [400, 1400])
def test_no_width_scrolls_the_page_sideways(folder, visit, width, scheme):
    page = visit(folder, viewport={"width": width, "height": 900}, color_scheme=scheme)
    assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_hostile_texts_run_nothing(hostile_folder, visit):
    page = visit(hostile_folder)
    for index in range(page.locator("#choose-attack option").count()):
        page.select_option("#choose-attack", index=index)
    assert page.title() != "owned"
    assert page.locator("img").count() == 0
