"""The page on a run that goes on, in a real browser: it follows the run by itself, and its button stops the run."""

from __future__ import annotations

import threading
from urllib.parse import urlsplit

import numpy as np
import pytest
from mpi4py import MPI

from tests.report.browser import PROGRAM, Browser
from tests.report.folders import valve_folder
from tests.report.test_browser import contrast, seen
from valvefsi.io import folder
from valvefsi.report.serving import PageServer

pytestmark = [
    pytest.mark.skipif(PROGRAM is None, reason="no chromium: apt-get install chromium"),
    pytest.mark.serial,
]
EVIL = "<img src=x onerror=window.hacked=1></script><script>window.hacked=1</script>"
LINE = "document.getElementById('line').textContent"
STOP = "document.getElementById('stop')"
VIEW = "document.querySelector('.panels .view')"


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The folder of a run that goes on, whose newest frame is yet to come: times of the frames are withheld."""
    made = valve_folder(
        tmp_path_factory.mktemp("live") / "run", overrides=[f"title={EVIL!r}", "time.t_end='4 s'"]
    )
    (made / "summary.json").unlink()
    for series in (made / "paraview").glob("*.pvd"):
        *first, last = series.read_text().split("<DataSet")
        series.write_text("<DataSet".join(first) + "</Collection></VTKFile>")
        series.with_suffix(".whole").write_text("<DataSet".join([*first, last]))
    with folder.held(made, MPI.COMM_SELF):
        (made / "history.csv").touch()  # after the lock
        yield made


@pytest.fixture(scope="module")
def address(run):
    """Where its page is."""
    with PageServer(run) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield server.address
        server.shutdown()


@pytest.fixture(scope="module")
def browser(tmp_path_factory, address):
    """A browser that has the page open, which asks for nothing but what is at its own address."""
    made = Browser(tmp_path_factory.mktemp("profile"))
    made.look(height=900)
    made.call("Page.navigate", url=address)
    made.until("document.readyState === 'complete'")
    yield made
    own = urlsplit(address).netloc
    assert {urlsplit(url).netloc for url in made.asked if url.startswith("http")} == {own}
    assert {url.split(":")[0] for url in made.asked} <= {"http", "data", "blob"}
    assert made.faults == []
    assert made.value("window.hacked") is None
    made.close()


def test_progress_is_shown_and_grows_with_the_history(browser, run):
    assert browser.value(LINE).startswith("Runs, t = 1.714 of 4 s (42.9 %)")
    assert browser.value("document.querySelector('progress').value") == pytest.approx(1.714 / 4, abs=1e-3)
    seen(browser, "figure[data-kind=chart] .drawing")
    last = "document.querySelector('figure[data-kind=chart] .drawing').data[0].x.at(-1)"
    assert browser.value(last) == pytest.approx(1.714, abs=1e-3)
    row = (run / "history.csv").read_text().splitlines()[-1].split(",")
    with (run / "history.csv").open("a") as file:
        file.write(",".join([str(float(row[0]) + 1), "2.5", *row[2:]]) + "\n")
    browser.until(f"{LINE}.startsWith('Runs, t = 2.5 of 4 s (62.5 %)')")
    browser.until(f"{last} === 2.5")
    assert browser.value("document.title").startswith("62 % ")


def test_a_newer_frame_takes_the_place_of_the_one_before_as_the_reader_has_turned_it(browser, run):
    before = seen(browser, ".panels .view")
    assert len(np.unique(before.reshape(-1, 3), axis=0)) > 100, "the picture is not blank"
    top = f"Math.max(...{VIEW}.data[0].z)"
    start = browser.value(top)
    eye = "{x: 0.3, y: -0.4, z: 1.9}"
    browser.value(f"Plotly.relayout({VIEW}, {{'scene.camera.eye': {eye}}}).then(() => 1)")
    for series in (run / "paraview").glob("*.whole"):
        series.rename(series.with_suffix(".pvd"))
    browser.until(f"{top} > {start + 0.29}")
    assert browser.value(f"{VIEW}.layout.scene.camera.eye") == {"x": 0.3, "y": -0.4, "z": 1.9}
    assert browser.value("document.querySelectorAll('.when').length") == 0, "one frame has no slider"


def test_a_phone_in_the_dark_shows_it_at_its_width(browser):
    browser.look(width=390, height=844, dark=True)
    browser.until("document.documentElement.scrollWidth <= 390")  # what is drawn follows the window
    of = "getComputedStyle(document.getElementById('{}')).{}.match(/\\d+/g).slice(0, 3).map(Number)"
    paper, ink = (
        np.array(browser.value(of.format(*what))) for what in (("live", "backgroundColor"), ("line", "color"))
    )
    assert paper.mean() < 60
    assert contrast(paper, ink) > 7.0
    browser.look(height=900)


def test_a_screen_reader_finds_the_button_the_bar_and_the_table(browser):
    tree = browser.tree()
    assert ("button", "Stop the run") in tree
    assert ("progressbar", "Part of the run that is done") in tree
    assert ("table", "Progress") in tree


def test_the_button_asks_once_more_and_then_stops_the_run(browser, run):
    browser.value(f"{STOP}.click()")
    assert browser.value(f"{STOP}.textContent") == "Write a checkpoint and stop"
    assert not folder.stop_requested(run)
    browser.value(f"{STOP}.click()")
    browser.until("document.getElementById('answer').textContent === 'The run is asked to stop.'")
    assert folder.stop_requested(run)
    browser.until(f"{LINE}.startsWith('Asked to stop at t = 2.5 of 4 s')")
    assert browser.value(f"{STOP}.disabled")
    said = browser.value("document.getElementById('answer').textContent")
    assert said == "The run is asked to stop.", "it stays to be read"
