"""The page on a run that goes on: who is answered, what it says, and the button that stops the run."""

from __future__ import annotations

import contextlib
import http.client
import json
import os
import re
import subprocess
import sys
import threading
import time
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from mpi4py import MPI

from tests.campaign.comparison import differences
from tests.case.test_resuming import RAW, broken_off, case_with
from tests.cli.test_cli import RUNNER
from valvefsi import cli
from valvefsi.case import to_toml
from valvefsi.case.build import run_case
from valvefsi.errors import CaseError, Stopped
from valvefsi.io import folder
from valvefsi.report import live
from valvefsi.report.live import LiveRun
from valvefsi.report.serving import PageServer
from valvefsi.report.writing import live_html
from valvefsi.run import health, simulation
from valvefsi.runtime.surroundings import without_launcher

pytestmark = pytest.mark.serial
SELF = MPI.COMM_SELF
EVIL = "</script><script>window.hacked=1</script>"


@contextlib.contextmanager
def served(out):
    """The server of a folder's page, answering in a thread."""
    with PageServer(out) as server:
        threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True).start()
        yield server
        server.shutdown()


def ask(address, method="GET", path="", *, host=None):
    """Status and text of an answer; the path is taken from the page's address unless it begins with /."""
    parts = urlsplit(address)
    connection = http.client.HTTPConnection(parts.hostname, parts.port, timeout=180)
    connection.putrequest(method, path if path.startswith("/") else parts.path + path, skip_host=True)
    if host != "":
        connection.putheader("Host", host or parts.netloc)
    connection.putheader("Content-Length", "0")
    connection.endheaders()
    answer = connection.getresponse()
    text = answer.read().decode()
    connection.close()
    return answer.status, text


def news(address, **versions):
    query = "&".join(f"{kind}={version}" for kind, version in versions.items())
    status, text = ask(address, path=f"state?{query}")
    assert status == 200
    return json.loads(text)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The folder of the uninterrupted run."""
    out = tmp_path_factory.mktemp("whole")
    run_case(case_with(), out=out, comm=SELF)
    return out


def at_step(number, act):
    """A call after each step that does something once."""

    def progress(step, *_):
        if step == number:
            act()

    return progress


REFUSED = [
    ("GET", "/", None),
    ("GET", "//", None),
    ("GET", "/state", None),
    ("GET", "/favicon.ico", None),
    ("POST", "/stop", None),
    ("POST", "//stop", None),
    ("GET", "", "evil.example"),
    ("GET", "state", "127.0.0.1.evil.example:80"),
    ("POST", "stop", "evil.example"),
    ("POST", "stop", "[::1"),
    ("POST", "stop", ""),
    ("POST", "stop", "127.0.0.1"),
    ("POST", "stop", "127.0.0.1:1"),
    ("GET", "", "localhost:8000"),
    ("GET", "", "127.0.0.1:none"),
]


@pytest.mark.parametrize(("method", "path", "host"), REFUSED)
def test_without_the_token_or_to_another_host_every_request_is_refused(tmp_path, method, path, host):
    with folder.held(tmp_path, SELF), served(tmp_path) as server:
        assert ask(server.address, method, path, host=host)[0] == 403
        assert not (tmp_path / folder.STOP).exists()


@pytest.mark.parametrize(
    "change", [lambda t: t[:-1], lambda t: f"{t}A", lambda t: t.swapcase(), lambda t: "é"]
)
def test_a_token_that_is_nearly_right_is_refused(tmp_path, change):
    with folder.held(tmp_path, SELF), served(tmp_path) as server:
        path = f"/{change(server.token)}/stop".encode().decode("latin-1")
        with contextlib.suppress(UnicodeEncodeError):
            assert ask(server.address, "POST", path)[0] == 403
        assert not (tmp_path / folder.STOP).exists()
        assert len(server.token) >= 32


def test_the_page_is_at_this_machine_only_under_its_own_port(tmp_path):
    with served(tmp_path) as one, served(tmp_path) as other:
        assert one.socket.getsockname()[0] == "127.0.0.1"
        assert one.server_port != other.server_port
        assert one.token != other.token
        assert ask(one.address, host=f"localhost:{one.server_port}")[0] == 200
        status, said = ask(one.address, host=f"localhost:{other.server_port}")
        assert status == 403
        assert f"ssh -L {one.server_port}:127.0.0.1:{one.server_port}" in said
        assert ask(one.address, path="other")[0] == 404
        assert ask(one.address, "POST")[0] == 404


def test_the_button_ends_the_run_with_a_checkpoint_from_which_it_goes_on_to_the_same_answer(
    tmp_path, monkeypatch, whole
):
    monkeypatch.setattr(simulation, "LOOK_S", 0.0)
    out, said = tmp_path / "run", []
    with served(out) as server:
        assert news(server.address)["state"] == "waiting"

        def press():
            said.append(news(server.address))
            said.append(json.loads(ask(server.address, "POST", "stop")[1]))
            said.append(news(server.address))

        with pytest.raises(Stopped, match=r"stopped at step 21, .*--resume") as caught:
            run_case(case_with(), out=out, comm=SELF, progress=at_step(20, press))
        assert caught.value.signal == 2, "as Ctrl-C"
        before, answer, after = said
        assert (before["state"], after["state"]) == ("running", "stopping")
        assert answer == {"said": "The run is asked to stop."}
        assert before["share"] == pytest.approx(0.04 / 0.08)
        end = news(server.address)
        assert end["state"] == "stopped"
        assert "--resume goes on from the checkpoint of t = 0.042 s" in end["line"]
        assert "no run holds this folder" in ask(server.address, "POST", "stop")[1]
    assert not (out / folder.STOP).exists()
    run_case(case_with(), out=out, comm=SELF, resume=True)
    assert differences(out, whole, checkpoints=False) == {}


def test_what_the_page_shows_grows_with_the_run(tmp_path):
    out, said = tmp_path / "run", []
    with served(out) as server:

        def look(step, *_):
            if step in (3, 30, 31):
                known = {k: f["data"]["version"] for s in said for k, f in s["figures"].items()}
                said.append(news(server.address, **known))

        run_case(case_with(), out=out, comm=SELF, progress=look)
        assert "is finished, t = 0.08 of 0.08 s; valvefsi report" in news(server.address)["line"]
    first, later, again = said
    assert set(first["figures"]) == {"scene"}, "one row is no curve"
    assert set(later["figures"]) == {"scene", "chart"}
    assert again["figures"] == {}, "nothing is new"
    times = [s["figures"]["scene"]["data"]["t"] for s in (first, later)]
    assert times == [[0.0], [pytest.approx(0.06)]], "the newest of the frames at quarters of the run"
    curve = later["figures"]["chart"]["data"]["panels"][0]["curves"][0]
    assert curve["x"]["shape"] == [7], "a row every five steps"
    assert first["layout"] != later["layout"], "the page is loaded again where a figure is added"
    assert later["layout"] == again["layout"]


def test_a_page_that_nobody_looks_at_loads_nothing_and_yields_to_its_run(whole):
    """Of what reads a run and draws it, nothing is loaded before the first request with the token."""
    words = [sys.executable, "-m", "valvefsi", "watch", str(whole), "--with-run"]
    with subprocess.Popen(
        words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=without_launcher()
    ) as process:
        address, maps = process.stdout.readline().strip(), Path(f"/proc/{process.pid}/maps")
        assert ask(address, path="/state")[0] == 403
        before = maps.read_text()
        assert ask(address)[0] == 200
        after = maps.read_text()
        lower = os.getpriority(os.PRIO_PROCESS, process.pid) - os.getpriority(os.PRIO_PROCESS, 0)
        process.kill()
    for library in ("numpy", "dolfinx"):
        assert (f"/{library}/" in before, f"/{library}/" in after) == (False, True)
    assert "/matplotlib/" not in after, "the page draws in the browser"
    assert lower == 5


def test_a_request_for_an_earlier_run_stops_no_later_one(tmp_path, monkeypatch, whole):
    monkeypatch.setattr(simulation, "LOOK_S", 0.0)
    out = broken_off(tmp_path / "run")
    lock = json.dumps({"host": "other", "process": 1, "since": "2026-01-01 00:00:00"})
    (out / folder.STOP).write_text(lock)
    late = at_step(25, lambda: (out / folder.STOP).write_text(lock))  # it was asked for just before the end
    run_case(case_with(), out=out, comm=SELF, resume=True, progress=late)
    assert differences(out, whole, checkpoints=False) == {}


def test_a_run_is_asked_by_the_clock_not_at_every_step(tmp_path, monkeypatch):
    looks = []
    monkeypatch.setattr(simulation, "LOOK_S", 1e9)
    monkeypatch.setattr(simulation, "stop_requested", lambda out: bool(looks.append(out)))
    run_case(case_with("time.t_end='10 ms'", "output.frames=0"), out=tmp_path, comm=SELF)
    assert looks == [tmp_path]


def test_a_torn_row_is_not_shown_and_comes_when_it_is_whole(tmp_path):
    out = broken_off(tmp_path / "run", 20)
    run = LiveRun(out)
    assert "its last row is of t = 0.04 of 0.08 s" in run.view().line
    text = (out / "history.csv").read_text()
    row = text.splitlines()[-1].replace("20,", "25,", 1).replace("0.04", "0.05", 1)
    for part, shown in ((row[:9], "t = 0.04 of"), (row[9:], "t = 0.04 of"), ("\n", "t = 0.05 of")):
        with (out / "history.csv").open("a") as file:
            file.write(part)
        assert shown in run.view().line
    with (out / "history.csv").open("a") as file:
        file.write("30,nonsense\n")
    assert "t = 0.05 of" in run.view().line
    (out / "history.csv").write_text(text)  # as a run that goes on cuts it
    assert "t = 0.04 of" in run.view().line


def test_time_left_is_that_at_the_pace_so_far(tmp_path, monkeypatch):
    out = broken_off(tmp_path / "run", 20)
    now = time.time()
    with folder.held(out, SELF):
        provenance = json.loads((out / "provenance.json").read_text())
        provenance["calls"][-1]["command"] = ["run", "case.toml"]
        (out / "provenance.json").write_text(json.dumps(provenance))
        os.utime(out / "provenance.json", (now - 100.0, now - 100.0))
        os.utime(out / folder.LOCK, (now - 105.0, now - 105.0))
        os.utime(out / "history.csv", (now - 10.0, now - 10.0))
        monkeypatch.setattr(live.time, "time", lambda: now)
        line = LiveRun(out).view().line  # half of it took 90 s and that was 10 s ago
        assert line == "Runs, t = 0.04 of 0.08 s (50.0 %), about 1 min 20 s left."
        os.utime(out / "history.csv", (now - 110.0, now - 110.0))
        assert "is being built" in LiveRun(out).view().line, "its rows are older than the run"
        (out / "provenance.json").write_text(
            json.dumps(provenance).replace('"case.toml"', '"case.toml", "--resume"')
        )
        os.utime(out / "history.csv", (now, now))
        assert "left" not in LiveRun(out).view().line, "where a run has gone on from, its pace is seen first"


def test_warnings_are_those_of_the_newest_checkpoint(tmp_path, monkeypatch):
    run = LiveRun(tmp_path / "run")
    assert "there is none yet" in run.news({})["told"]
    monkeypatch.setattr(health, "LONGEST_GAP", 0.5)
    with pytest.warns(UserWarning, match="may leak"):
        broken_off(tmp_path / "run", 20)
    told = run.news({})["told"]
    assert 'class="warning">fluid may leak through block' in told
    assert "up to the last checkpoint, t = 0.032 s" in told


def test_text_of_a_case_stays_text(tmp_path):
    out = broken_off(tmp_path / "run", 10, f"title={EVIL!r}")
    page, view = LiveRun(out).page()
    text = live_html(page, view)
    assert page.title == EVIL
    assert EVIL not in text
    assert text.count("connect-src 'self'") == 1


def test_a_folder_that_is_none_or_holds_something_else_is_one_line(tmp_path):
    (tmp_path / "file").write_text("")
    (tmp_path / "fit").mkdir()
    (tmp_path / "fit" / "fit.json").write_text("{}")
    with pytest.raises(CaseError, match=r"file: this is a file, expected the folder of a run$"):
        LiveRun(tmp_path / "file")
    with pytest.raises(CaseError, match=r"fit: there is no run in this folder, but other files$"):
        LiveRun(tmp_path / "fit")
    assert LiveRun(tmp_path / "none").view().line == f"There is no run in {tmp_path / 'none'} yet."


def test_a_finished_run_is_one_line(whole):
    result = RUNNER.invoke(cli.app, ["watch", str(whole)])
    assert result.exit_code == 0
    assert result.output.split("\n") == [
        f"The run in {whole} is finished, t = 0.08 of 0.08 s; valvefsi report {whole} writes its page.",
        "",
    ]


def test_a_lock_that_a_killed_process_left_is_no_run(tmp_path):
    out = broken_off(tmp_path / "run")
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    with folder.held(out, SELF):
        lock = json.loads((out / folder.LOCK).read_text())
        (out / folder.LOCK).write_text(json.dumps(lock | {"process": process.pid}))
        assert LiveRun(out).view().state == "stopped"
        with pytest.raises(CaseError, match="no run holds this folder"):
            folder.request_stop(out)
        (out / folder.LOCK).write_text(json.dumps(lock | {"process": process.pid, "host": "another"}))
        assert LiveRun(out).view().state != "stopped", "of another host nothing is known"


@pytest.mark.slow
@pytest.mark.parametrize("ranks", [1, 2])
def test_a_run_with_a_view_is_stopped_through_its_page_and_goes_on(tmp_path, ranks):
    (tmp_path / "case.toml").write_text(to_toml(case_with("time.t_end='100 s'", "output.frames=0")))
    start = [str(Path(sys.executable).parent / "mpirun"), "-n", str(ranks)] if ranks > 1 else []
    words = [*start, sys.executable, "-m", "valvefsi", "run", str(tmp_path / "case.toml"), "--out"]
    how = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "env": without_launcher()}
    with subprocess.Popen([*words, str(tmp_path / "run"), "--view"], **how) as process:
        line = next(line for line in process.stdout if "can be watched at" in line)
        address = line.split()[-1]
        while news(address)["state"] != "running" or not news(address)["share"]:
            assert process.poll() is None
            time.sleep(0.1)
        assert json.loads(ask(address, "POST", "stop")[1])["said"] == "The run is asked to stop."
        _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert errors.count("stopped at step") == 1
    with pytest.raises(ConnectionRefusedError):
        ask(address)
    stopped = re.search(r"stopped at step (\d+), t = (\S+) s; \S+ is written", errors)
    end = f"time.t_end='{2e-3 * (int(stopped[1]) + 20)} s'"  # not far from there, however fast the machine is
    for name, *more in (["run", "--resume"], ["whole"]):
        subprocess.run(
            [*words, str(tmp_path / name), "--set", end, *more], check=True, env=without_launcher()
        )
    ours, theirs = ((tmp_path / name / "history.csv").read_bytes() for name in ("run", "whole"))
    assert ours == theirs
    assert int(ours.splitlines()[-1].split(b",")[0]) == int(stopped[1]) + 20


assert RAW["time"] == {"dt": "2 ms", "t_end": "80 ms"}, "what the numbers above are of"
