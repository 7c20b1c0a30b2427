"""Pages in a real browser: figures are drawn and move, nothing is asked of a network, nothing is complained of."""

from __future__ import annotations

import io
import re

import numpy as np
import pytest
from PIL import Image

from tests.report.browser import PROGRAM, Browser
from tests.report.folders import valve_folder
from valvefsi.report.folders import report
from valvefsi.report.writing import write_page

pytestmark = [
    pytest.mark.skipif(PROGRAM is None, reason="no chromium: apt-get install chromium"),
    pytest.mark.serial,
]
SLIDER = "document.querySelector('.when input')"
DRAWN = "document.querySelectorAll('.panels .view canvas').length"
EVIL = "<img src=x onerror=window.hacked=1></script><script>window.hacked=1</script>"


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """The page of a run whose title is an attack."""
    folder = tmp_path_factory.mktemp("browser")
    run = valve_folder(folder / "run", overrides=[f"title={EVIL!r}"])
    write_page(report([run]), folder / "page.html")
    return folder / "page.html"


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    """A browser; what it has complained of and asked for is looked at after each test."""
    made = Browser(tmp_path_factory.mktemp("profile"))
    yield made
    made.close()


@pytest.fixture(autouse=True)
def _quiet(browser):
    """Let no page complain, run what is text, or ask for anything but itself."""
    browser.faults.clear()
    browser.asked.clear()
    yield
    assert browser.value("window.hacked") is None
    assert browser.faults == []
    assert {url.split(":")[0] for url in browser.asked} <= {"file", "data", "blob"}
    assert {url for url in browser.asked if url.startswith("file")} <= {browser.value("location.href")}


def seen(browser, selector):
    """The pixels of an element, ``(height, width, 3)``, after what is drawn has settled."""
    browser.value(
        f"document.querySelector('{selector}').scrollIntoView({{behavior: 'instant', block: 'center'}})"
    )
    browser.until(f"document.querySelector('{selector}').closest('figure').dataset.done === 'yes'")
    box = browser.value(
        f"(() => {{ const b = document.querySelector('{selector}').getBoundingClientRect();"
        "return {x: b.x + scrollX, y: b.y + scrollY, width: b.width, height: b.height}; })()"
    )
    browser.value(
        "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done, 100))))"
    )
    return np.asarray(Image.open(io.BytesIO(browser.picture(**box))).convert("RGB")).astype(int)


def drawn(browser, page, **how):
    """Open the page unless it is open, have its scene drawn, and set its slider to the start."""
    browser.look(**how)
    if browser.value("location.href") != page.resolve().as_uri():
        browser.open(page, **how)
    if browser.value(DRAWN) == 0:
        seen(browser, "figure.drawn .drawing")
        browser.until(f"{DRAWN} > 0")
    move(browser, 0)


def move(browser, frame):
    """Move the slider as a user does."""
    browser.value(f"{SLIDER}.value = {frame}; {SLIDER}.dispatchEvent(new Event('input'))")


def test_nothing_is_drawn_before_it_comes_into_view(browser, page):
    browser.open(page, height=200)
    assert browser.value("typeof window.Plotly") == "undefined"
    assert browser.value(DRAWN) == 0


def test_a_scene_is_drawn_and_its_slider_moves_the_bodies(browser, page):
    drawn(browser, page)
    first = seen(browser, ".panels .view")
    assert len(np.unique(first.reshape(-1, 3), axis=0)) > 100, "the picture is not blank"
    top = "Math.max(...document.querySelector('.panels .view').data[0].z)"
    said = "document.querySelector('.when + output').textContent"
    start, before = browser.value(top), browser.value(said)
    move(browser, 2)
    assert browser.value(top) == pytest.approx(start + 2 * 0.3, abs=1e-3)
    assert (before, browser.value(said)) == ("0.8571 s", "1.714 s"), (
        "the last cycle, of which there are 3 frames"
    )
    assert (np.abs(seen(browser, ".panels .view") - first).max(axis=2) > 30).sum() > 200, (
        "the picture has changed"
    )


def test_the_colour_of_the_bodies_can_be_chosen(browser, page):
    drawn(browser, page)
    move(browser, 1)
    choice = "[...document.querySelectorAll('.controls select')][0]"
    names = browser.value(f"[...{choice}.options].map(option => option.textContent)")
    assert names == ["displacement", "von Mises stress", "J = det F"]
    browser.value(f"{choice}.value = 1; {choice}.dispatchEvent(new Event('change'))")
    shown = browser.value("Math.max(...document.querySelector('.panels .view').data[0].intensity)")
    assert shown == pytest.approx(21.0, rel=1e-3), "of frame 3, in kPa"
    title = browser.value("document.querySelector('.panels .view').data[0].colorbar.title.text")
    assert title == "von Mises stress [kPa]"


def test_the_plane_of_the_flow_moves_with_the_slider(browser, page):
    drawn(browser, page)
    corner = "document.querySelectorAll('.panels .view')[1].data[0].z[2][3]"
    assert browser.value(corner) == pytest.approx(2.0 + 3.0 + 20.0, abs=0.01)
    move(browser, 2)
    assert browser.value(corner) == pytest.approx(4.0 + 3.0 + 20.0, abs=0.01)


def test_curves_show_the_values_of_the_history(browser, page):
    drawn(browser, page)
    pixels = seen(browser, "figure[data-kind=chart] .drawing")
    assert len(np.unique(pixels.reshape(-1, 3), axis=0)) > 50
    flow = browser.value("Math.max(...document.querySelector('figure[data-kind=chart] .drawing').data[2].y)")
    table = browser.value(
        "[...document.querySelectorAll('tr')].find(r => /^peak flow/.test(r.textContent)).innerHTML"
    )
    assert flow == pytest.approx(float(re.search(r'value="([\d.]+)"', table)[1]), rel=1e-6)


def test_a_screen_reader_finds_tables_headings_and_a_named_slider(browser, page):
    drawn(browser, page)
    tree = browser.tree()
    roles = {role for role, _ in tree}
    assert {
        "main",
        "navigation",
        "heading",
        "table",
        "columnheader",
        "rowheader",
        "slider",
        "combobox",
    } <= roles
    named = {
        role: [name for r, name in tree if r == role] for role in ("table", "slider", "heading", "button")
    }
    assert "Hydrodynamic numbers of the valve" in named["table"]
    assert all(named["table"])
    assert named["slider"] == ["time"]
    assert "Warnings and recoveries" in named["heading"]
    assert "Play" in named["button"]


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_light_and_dark_have_contrast(browser, page, dark):
    drawn(browser, page, dark=dark)
    of = "(() => {{ const s = getComputedStyle(document.querySelector('{}')); return s.{}; }})()"
    paper, ink = (
        np.array([int(n) for n in re.findall(r"\d+", browser.value(of.format("body", what)))[:3]])
        for what in ("backgroundColor", "color")
    )
    assert (paper.mean() < 60) == dark
    assert contrast(paper, ink) > 7.0
    font = browser.value("document.querySelector('figure[data-kind=scene] .view').layout.font.color")
    assert contrast(paper, np.array([int(font[k : k + 2], 16) for k in (1, 3, 5)])) > 7.0


def contrast(a, b):
    """The contrast of two colours as accessibility guidelines define it."""
    c = np.array([a, b]) / 255.0
    linear = np.where(c <= 0.03928, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    light = np.sort(linear @ [0.2126, 0.7152, 0.0722])
    return (light[1] + 0.05) / (light[0] + 0.05)


def test_a_phone_shows_the_page_at_its_width(browser, page):
    drawn(browser, page, width=390, height=844)
    browser.until("document.documentElement.scrollWidth <= 390")  # a busy browser draws again some time after
    assert browser.value("document.querySelector('.panels .view').getBoundingClientRect().width") > 300


def test_printing_draws_every_figure_and_opens_what_is_folded(browser, page):
    drawn(browser, page)
    assert browser.value("document.querySelectorAll('details[open]').length") == 0
    browser.value("window.dispatchEvent(new Event('beforeprint'))")
    assert browser.value("[...document.querySelectorAll('details')].every(folded => folded.open)")
    assert browser.value(
        "[...document.querySelectorAll('figure.drawn')].every(f => f.dataset.done === 'yes')"
    )
    browser.call("Emulation.setEmulatedMedia", media="print")
    tall = "(s => document.querySelector(s).getBoundingClientRect().height)('.panels .view{}')"
    assert browser.value(tall.format("")) >= browser.value(tall.format(" .main-svg")) > 100, (
        "nothing lies over it"
    )
    browser.call("Emulation.setEmulatedMedia", media="")
    printed = browser.call("Page.printToPDF", printBackground=False)["data"]
    assert len(printed) > 50_000
