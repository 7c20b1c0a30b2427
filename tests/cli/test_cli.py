"""The command line: what it prints, where, and how it ends."""

import errno
import io
import os
import re
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
import typer.testing
from mpi4py import MPI
from rich.console import Console

import valvefsi
from valvefsi import cli
from valvefsi.case import case_defaults, load_case
from valvefsi.cli import progress as progress_module
from valvefsi.cli.closing import show_run
from valvefsi.cli.tables import show_result
from valvefsi.post.columns import Units

RUNNER = typer.testing.CliRunner()


def python(script, *arguments, ranks=1):
    """Run a script that ends in cli.main(), with the arguments of a command line."""
    start = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    environment = {
        k: v for k, v in os.environ.items() if not k.startswith(("PMI", "OMPI_", "PMIX", "HYDRA", "MPI"))
    }
    return subprocess.run(
        [*start, sys.executable, "-c", textwrap.dedent(script), *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=60,
        env=environment,
    )


MAIN = "from valvefsi.cli import main; main()"

FAKE = """
import sys, types
from mpi4py import MPI
from valvefsi.errors import *
from valvefsi.post.columns import Units
build = types.ModuleType("valvefsi.case.build")
def run_case(case, *, out, comm, progress, **options):
    {body}
build.run_case = run_case
from valvefsi.bodies.body import Entry
entry = Entry(quantity="elastic step limit", value=0.0125, unit="s", note="[block]")
build.plan_case = lambda case, comm, out: {{"plan": [entry]}}
sys.modules["valvefsi.case.build"] = build
from valvefsi.cli import main
main()
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "case.toml"
    path.write_text(case_defaults())
    return path


def alone(comm):
    return pytest.mark.skipif(comm.size > 1, reason="starts processes of its own")


pytestmark = alone(MPI.COMM_WORLD)


def test_version_and_module_and_command_agree():
    by_module = subprocess.run(
        [sys.executable, "-m", "valvefsi", "--version"], capture_output=True, text=True
    )
    assert by_module.stdout == f"valvefsi {valvefsi.__version__}\n"
    assert python(MAIN, "--version").stdout == by_module.stdout


def test_help_imports_nothing_heavy():
    script = """
        import sys
        sys.argv = ["valvefsi", "--help"]
        try:
            from valvefsi.cli import main; main()
        finally:
            heavy = {"numpy", "pydantic", "pint", "mpi4py", "dolfinx", "ufl", "numba", "gmsh", "matplotlib"}
            print("loaded:", sorted(heavy & set(sys.modules)))
        """
    answer = python(script)
    assert "bench" in answer.stdout
    assert "loaded: []" in answer.stdout


def test_the_printed_case_can_be_read(tmp_path):
    answer = RUNNER.invoke(cli.app, ["case", "--defaults"])
    path = tmp_path / "case.toml"
    path.write_text(answer.stdout)
    assert load_case(path).solid[0].name == "block"
    assert RUNNER.invoke(cli.app, ["case", "--schema"]).stdout.startswith("{")


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["run", "{file}", "--set", "fluid.viscosty=1"], "error: --set: fluid.viscosty = 1: unknown key"),
        (["run", "{file}x"], "error: {file}x: no such case file; did you mean 'case.toml'?"),
        (["case"], "expected one of --defaults and --schema"),
        (
            ["bench", "compression", "--nu-stab", "0.5"],
            "error: --nu-stab = 0.5: expected a number above -1 and below 0.5",
        ),
        (["bench", "speed", "--sizes", "x"], "error: --sizes = 'x': expected whole numbers"),
        (["rn"], "No such command"),
        (["run"], "Missing argument"),
    ],
)
def test_what_the_user_got_wrong_ends_with_2_and_no_traceback(file, arguments, text):
    answer = python(MAIN, *(argument.format(file=file) for argument in arguments))
    assert answer.returncode == 2
    assert text.format(file=file) in answer.stderr
    assert "Traceback" not in answer.stderr
    if text.startswith("error"):
        assert answer.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("body", "code", "text"),
    [
        ("raise ConvergenceError('no convergence in the load step')", 3, "ConvergenceError: no convergence"),
        (
            "raise OSError(28, 'No space left on device', 'history.csv')",
            4,
            "error: history.csv: No space left",
        ),
        ("raise MemoryError('of 8 TB')", 4, "error: out of memory (of 8 TB)"),
        ("raise SurroundingsError('disk full; step_1.vfc is written')", 4, "error: disk full; step_1.vfc"),
        ("raise StabilityError('NaN in u at t = 1 s')", 3, "StabilityError: NaN in u at t = 1 s"),
        ("raise KeyboardInterrupt", 130, "interrupted"),
        ("raise Stopped('stopped; go on with --resume', 15)", 143, "go on with --resume"),
        ("raise RuntimeError('a bug')", 1, "RuntimeError: a bug"),
        ("return {}", 0, ""),
    ],
)
@pytest.mark.parametrize("ranks", [1, 2])
def test_each_way_to_end_has_its_code_and_is_said_once(file, body, code, text, ranks):
    answer = python(FAKE.format(body=body), "run", file, ranks=ranks)
    assert answer.returncode == code
    assert answer.stderr.count(text) == 1 or code in (0, 1)
    assert text in answer.stderr
    assert ("Traceback" in answer.stderr) == (code == 1)


@pytest.mark.parametrize("error", ["RuntimeError", "StabilityError"])
def test_a_rank_that_fails_alone_does_not_leave_the_others_waiting(file, error):
    body = f"comm.rank == 1 and (_ for _ in ()).throw({error}('alone')); comm.barrier()"
    script = FAKE.format(body=body).replace(
        "from valvefsi.cli import",
        "from valvefsi import errors; errors.PATIENCE = 0.3\nfrom valvefsi.cli import",
    )
    answer = python(script, "run", file, ranks=2)
    assert answer.returncode != 0
    assert f"{error}: alone" in answer.stderr


def test_only_rank_0_speaks(file):
    assert python(MAIN, "--version", ranks=2).stdout.count("valvefsi") == 1
    assert python(MAIN, "run", file, "--set", "a=1", ranks=2).stderr.count("unknown key") == 1
    assert python(MAIN, "rn", ranks=2).stderr.count("No such command") == 1


def test_a_result_is_shown_against_its_reference(capsys):
    row = {"quantity": "u_y", "computed": -3.96, "reference": -3.9212, "unit": "cm"}
    timing = {"wall_s": 12.5, "phases": {"solve": 3.0}}
    result = {"benchmark": "b", "table": [row | {"difference_percent": -0.99}], "timing": timing}
    show_result(result, Rank(0), Path("somewhere"))
    lines = capsys.readouterr().out.splitlines()
    line = next(line for line in lines if "u_y" in line)
    assert line.split() == ["u_y", "-3.96", "-3.9212", "-0.99", "%", "cm"]
    assert lines[-2:] == ["wall_s: 12.5", "results in somewhere"]


LAST = {
    "t_s": 0.5,
    "courant": 0.125,
    "u_x_tip_cm": 0.25,
    "u_y_tip_cm": 1e-13,
    "pressure_in_dyn_per_cm2": 13332.236842105262,
    "flow_in_cm3_per_s": 12.0,
    "q_z_upper_ml_s": 3.0,
    "kinetic_energy_erg": 5e4,
    "beam_area_change_percent": -0.5,
}


@pytest.mark.parametrize(
    ("units", "words"),
    [
        ("lab", ["u x tip 2.5 mm", "u y tip 0 mm", "pressure in 10 mmHg", "flow in 12 ml/s"]),
        ("lab", ["t 0.5 s", "Courant number 0.125", "kinetic energy 5 mJ", "beam area change -0.5 %"]),
        ("lab", ["q z upper 3 ml/s"]),
        ("cgs", ["u x tip 0.25 cm", "pressure in 13332 dyn/cm^2", "flow in 12 cm^3/s"]),
    ],
)
def test_a_run_ends_with_numbers_in_units_and_what_to_do_next(tmp_path, capsys, units, words):
    (tmp_path / "flow.png").write_bytes(b"")
    timing = {"steps": 7, "wall_s": 75.0, "warnings": [{"text": "too coarse"}], "phases": {"solve": 3.0}}
    show_run({"last": LAST, "timing": timing}, Rank(0), tmp_path, Units(system=units))
    lines = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert set(words) <= set(lines)
    assert "7 steps in 1 min 15 s" in lines
    assert {"warning: too coarse", f"results in {tmp_path}", "pictures: flow.png"} <= set(lines)
    following = lines[lines.index("next:") + 1 :]
    assert following[:2] == [f"valvefsi plot {tmp_path}", f"valvefsi report {tmp_path}"]
    show_run({"last": {"leaflets_post_1_inward_mm": 0.491}}, Rank(0), tmp_path, Units())
    assert "leaflets post 1 inward 0.491 mm" in [
        " ".join(s.split()) for s in capsys.readouterr().out.splitlines()
    ]
    show_run({"last": LAST}, Rank(1), tmp_path, Units())
    assert capsys.readouterr().out == ""


def test_a_valve_ends_with_its_numbers_and_what_is_plausible(tmp_path, capsys):
    within = {"from": 2.0, "to": 20.0, "unit": "mmHg"}
    numbers = {
        "mean difference": within | {"value": 12.0, "plausible": True},
        "closing volume": within | {"value": 30.0, "plausible": False},
        "leakage volume": within | {"value": None, "plausible": None},
    }
    show_run({"last": LAST, "valve": {"plausible": numbers}}, Rank(0), tmp_path, Units())
    lines = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert "mean difference 12 mmHg" in lines
    assert "closing volume 30 mmHg plausible are 2 to 20" in lines
    assert not [line for line in lines if "leakage" in line]


def test_a_run_that_had_ended_says_so(tmp_path, capsys):
    show_run(
        {"last": LAST, "timing": {"steps": 7, "wall_s": 75.0}, "finished": True}, Rank(0), tmp_path, Units()
    )
    text = capsys.readouterr().out
    assert "this run is finished: nothing was computed" in text
    assert "7 steps" not in text


def test_a_plan_is_shown_and_nothing_is_run(file):
    plan = python(FAKE.format(body="raise RuntimeError"), "run", file, "--plan")
    line = next(line for line in plan.stdout.splitlines() if "step limit" in line)
    assert line.split() == ["elastic", "step", "limit", "12.5", "ms", "[block]"]
    assert plan.stdout.splitlines()[0].startswith(
        "compressed block in a box of fluid: 64 x 64 cells of 6.25 mm"
    )
    assert "results in" not in plan.stdout


class Rank:
    size = 2

    def __init__(self, rank):
        self.rank = rank


def shown(monkeypatch, rank=0, terminal=False, width=200, title="block"):
    clock = iter(range(0, 10000))
    monkeypatch.setattr(progress_module.time, "perf_counter", lambda: float(next(clock)))
    console = Console(file=io.StringIO(), force_terminal=terminal, width=width, _environ={"TERM": "xterm"})
    with progress_module.Progress(Rank(rank), title, console) as progress:
        for step in range(1, 22):
            progress(
                step,
                0.1 * step,
                2.1,
                {"step": step, "t_s": 0.1 * step, "courant": 0.25, "a": 1, "b": 2, "c": 3},
            )
    return console.file.getvalue()


def test_without_a_terminal_progress_is_a_plain_line_every_few_seconds(monkeypatch):
    lines = shown(monkeypatch).splitlines()
    assert len(lines) == 4
    assert lines[0] == " 28.6 %  t = 0.6 of 2.1 s, step 6, Courant number 0.25, a 1, b 2, 15 s left"
    assert lines[-1] == "100.0 %  t = 2.1 of 2.1 s, step 21, Courant number 0.25, a 1, b 2, done in 20 s"
    assert shown(monkeypatch, rank=1) == ""


def test_the_step_shown_is_a_step_that_was_taken(monkeypatch):
    """The run goes back from step 8 to step 5."""
    clock = iter(range(0, 10000, 10))
    monkeypatch.setattr(progress_module.time, "perf_counter", lambda: float(next(clock)))
    console = Console(file=io.StringIO(), width=200)
    with progress_module.Progress(Rank(0), "block", console, period=1.0) as progress:
        for step, t in ((6, 0.6), (7, 0.7), (8, 0.8), (5, 0.5), (6, 0.55), (7, 0.6), (8, 0.65)):
            progress(step, t, 2.0)
    steps = [line.partition("dt ")[2].split()[0] for line in console.file.getvalue().splitlines()]
    assert steps == ["0.1", "0.1", "0.05"]  # until it is further than at first there is no time left to tell


def test_a_sum_of_steps_that_misses_the_end_by_round_off_is_at_the_end():
    console = Console(file=io.StringIO(), width=200)
    with progress_module.Progress(Rank(0), "block", console) as progress:
        progress(1, 0.4, 0.8)
        progress(2, 0.8 * (1 - 1e-12), 0.8)
    assert console.file.getvalue().startswith("100.0 %  t = 0.8 of 0.8 s, step 2, done in ")


@pytest.mark.parametrize(
    ("width", "numbers"),
    [
        (60, "t = 2.1 of 2.1 s"),
        (80, "t = 2.1 of 2.1 s, step 21"),
        (120, "t = .*, Courant number 0.25, a 1, b 2"),
    ],
)
def test_bar_percent_and_time_left_stay_on_a_narrow_terminal(monkeypatch, width, numbers):
    title = "a long title of a run that nobody can read to its end on any terminal"
    lines = shown(monkeypatch, terminal=True, width=width, title=title).replace("\r", "\n").splitlines()
    last = [without_styles(line).rstrip() for line in lines if "t = " in line][-1]
    assert len(last) <= width
    assert re.fullmatch(rf"a long .*… ━{{12}} 100% in 20 s {numbers}", last)


def test_a_bar_at_its_end_says_what_is_still_done(monkeypatch):
    console = Console(file=io.StringIO(), force_terminal=True, width=120, _environ={"TERM": "xterm"})
    with progress_module.Progress(Rank(0), "block", console) as progress:
        progress(1, 0.4, 0.8)
        progress(2, 0.8, 0.8)
        progress.live.refresh()
        assert "drawing pictures" in console.file.getvalue()
    last = without_styles(console.file.getvalue()).replace("\r", "\n").split("\n")
    assert [line for line in last if "block" in line][-1].rstrip().endswith("t = 0.8 of 0.8 s, step 2")


def test_progress_has_the_units_of_the_run():
    console = Console(file=io.StringIO(), width=200)
    with progress_module.Progress(Rank(0), "block", console, units=Units(dim=2)) as progress:
        progress(1, 0.8, 0.8, {"kinetic_energy_erg": 2e4, "q_z_lower_ml_s": 3.0})
    assert "q z lower 3 ml/s per cm" in console.file.getvalue()
    assert "_" not in console.file.getvalue()


def test_a_terminal_that_understands_no_escape_codes_gets_plain_lines():
    console = Console(file=io.StringIO(), force_terminal=True, width=100, _environ={"TERM": "dumb"})
    with progress_module.Progress(Rank(0), "block", console) as progress:
        progress(1, 0.4, 0.8)
        progress(2, 0.8, 0.8)
    assert "\x1b" not in console.file.getvalue()
    assert console.file.getvalue().startswith("100.0 %")


def test_the_longest_time_left_fits_beside_title_and_numbers():
    numbers = ["t = 0.4436 of 0.857 s", "step 123456", "beat 1 at 52 %"]
    for width in (80, 100, 200):
        title, text = progress_module.fitted("pericardial valve, 25 mm, 70 beats a minute", numbers, width)
        assert len(f"{title} {'━' * 12} 100% 12 h 02 min left {text}") <= width
    assert (title, text) == ("pericardial valve, 25 mm, 70 beats a minute", ", ".join(numbers))


def without_styles(text):
    return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text)


def test_on_a_terminal_progress_is_a_bar(monkeypatch):
    text = shown(monkeypatch, terminal=True)
    assert "block" in text
    assert "\x1b[" in text
    assert "step 21" in text


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(3.14, "3.1 s"), (59.4, "59 s"), (61, "1 min 01 s"), (3725, "1 h 02 min"), (None, "unknown time")],
)
def test_durations_read_well(seconds, text):
    assert progress_module.format_time(seconds) == text


def test_a_warning_is_one_line_without_code():
    script = """
        import warnings, valvefsi.cli
        valvefsi.cli.app = lambda **options: warnings.warn("the mesh is coarse")
        valvefsi.cli.main()
        """
    answer = python(script)
    assert answer.returncode == 0
    assert answer.stderr == "warning: the mesh is coarse\n"


def test_recoveries_and_warnings_end_a_result_as_lines(capsys):
    timing = {
        "steps": 3,
        "recoveries": [{"t_s": 0.1, "reason": "too fast"}],
        "warnings": [{"text": "too coarse"}],
    }
    show_result({"table": [], "timing": timing}, Rank(0))
    assert capsys.readouterr().out.splitlines()[-3:] == [
        "steps: 3",
        "recovery: too fast",
        "warning: too coarse",
    ]


@pytest.mark.serial
def test_a_file_where_results_go_is_refused_before_any_work(file, tmp_path):
    there = tmp_path / "there"
    there.write_text("mine")
    record = tmp_path / "record.csv"  # is never read
    for command in (
        ["run", file],
        ["bench", "channel"],
        ["fit", "biaxial", record],
        ["fit", "windkessel", record],
        ["plot", tmp_path],
    ):
        for out, said in ((there, "this is a file"), (there / "a" / "b", f"{there} is a file")):
            result = RUNNER.invoke(cli.app, [*map(str, command), "--out", str(out)])
            assert f"--out = '{out}': {said}, expected a folder" in str(result.exception), command
    assert there.read_text() == "mine"
    for command in (["movie", tmp_path], ["mesh", "valve"], ["mesh", "import", there], ["bench", "table"]):
        result = RUNNER.invoke(cli.app, [*map(str, command), "--out", str(tmp_path)])
        assert "this is a folder, expected the name of a file" in str(result.exception), command


@pytest.mark.serial
def test_a_fit_without_a_disk_ends_like_any_command_without_one(tmp_path, monkeypatch, capsys):
    from valvefsi.fitting import biaxial

    def full(self, out):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(out))

    monkeypatch.setattr(biaxial.BiaxialFit, "write", full)
    record = tmp_path / "record.csv"
    rows = "".join(f"{1 + 0.01 * k},{1 + 0.01 * k},{k},{k}\n" for k in range(8))
    record.write_text(f"stretch1,stretch2,P11_kPa,P22_kPa\n{rows}")
    command = ["fit", "biaxial", str(record), "--model", "neo-hookean", "--starts", "1"]
    monkeypatch.setattr(sys, "argv", ["valvefsi", *command, "--out", str(tmp_path / "fit")])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 4
    assert f"error: {tmp_path / 'fit'}: No space left on device\n" in capsys.readouterr().err
