"""README and documents: tables equal their results, commands are understood, links lead somewhere."""

from __future__ import annotations

import importlib
import importlib.util
import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import typer

from valvefsi.case import load_case
from valvefsi.cli import app
from valvefsi.studies.members import read_cases
from valvefsi.studies.sweep import make_sweep

ROOT = Path(__file__).parents[1]
RESULTS = sorted((ROOT / "docs" / "results").glob("*.json"))
DEMOS = sorted((ROOT / "demos").glob("*.py"))
BLOCK = re.compile(r"<!-- table: .*?<!-- end -->", re.DOTALL)
FENCE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
COMMAND = re.compile(r"(?:mpirun -n \d+ )?(valvefsi (?!setup).*)")


def program(name):
    """A program of the docs folder as a module."""
    spec = importlib.util.spec_from_file_location(f"docs_{name}", ROOT / "docs" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


tables = program("tables")
generate = program("generate")
DOCUMENTS = [*tables.documents(ROOT), ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md"]


def name_of(path):
    return path.relative_to(ROOT).as_posix()


# Numbers


@pytest.mark.parametrize("path", DOCUMENTS, ids=name_of)
def test_the_tables_of_a_document_equal_their_results(path):
    text = path.read_text(encoding="utf-8")
    assert tables.rewritten(text) == text, f"{name_of(path)}: call make tables"


def test_a_table_that_differs_from_its_results_is_noticed(tmp_path):
    text = (ROOT / "docs" / "validation" / "immersed.md").read_text(encoding="utf-8")
    assert tables.rewritten(text.replace("34.33", "34.35")) == text
    for path in RESULTS:
        changed = path.read_text(encoding="utf-8").replace("34.33", "34.31")
        (tmp_path / path.name).write_text(changed, encoding="utf-8")
    assert "| 34.31 |" in tables.rewritten(text, tmp_path)


@pytest.mark.parametrize("path", RESULTS, ids=lambda path: path.stem)
def test_a_file_of_results_says_where_its_numbers_come_from(path):
    result = json.loads(path.read_text(encoding="utf-8"))
    assert result["origin"] in tables.ORIGINS
    assert re.fullmatch(r"[0-9a-f]{7}(, [0-9a-f]{7})*", result["commit"])
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", result["date"])
    assert {"title", "version", "ranks", "cores", "runs"} <= set(result)
    assert result["quantities"]
    for row in result["quantities"]:
        assert {"case", "quantity", "computed"} <= set(row)
        assert "source" in row or "reference" not in row


def test_every_file_of_results_is_shown_and_every_table_is_right_where_it_stands():
    text = "".join(path.read_text(encoding="utf-8") for path in DOCUMENTS)
    shown = set(re.findall(r"<!-- table: ([\w-]+)", text))
    assert {path.stem for path in RESULTS} == shown - {"summary"}


MEASURED = re.compile(r"\d+\.\d+ ?(?:%|cm|mm|ms|ml|mmHg|MPa|N/m|Hz|h\b|s\b|min\b|pairs|times)")


def typed(text):
    """Numbers with a unit in the prose of a document."""
    return MEASURED.findall(FENCE.sub("", BLOCK.sub("", text)))


@pytest.mark.parametrize(
    "path", [ROOT / "README.md", *sorted((ROOT / "docs" / "validation").glob("*.md"))], ids=name_of
)
def test_no_measured_number_is_typed_by_hand(path):
    allowed = {"0.3 s", "0.5 to 1 h"}  # the length of the leakage test
    assert set(typed(path.read_text(encoding="utf-8"))) <= allowed


def test_a_number_typed_by_hand_is_noticed():
    assert typed("The error is 0.79 % there.") == ["0.79 %"]
    assert typed("<!-- table: x -->\n| 0.79 % |\n<!-- end -->") == []


# Commands


def commands_of(path):
    """Commands in the fenced blocks of a document, and those named in its text, as words."""
    text = path.read_text(encoding="utf-8")
    fenced = [line for block in FENCE.findall(text) for line in block.splitlines()[1:-1]]
    fenced = [match[1] for line in fenced if (match := COMMAND.match(line.strip()))]
    named = [
        match[1] for code in re.findall(r"`([^`\n]+)`", FENCE.sub("", text)) if (match := COMMAND.match(code))
    ]
    return [(shlex.split(line, comments=True), True) for line in fenced] + [
        (shlex.split(line), False) for line in named
    ]


def commands_of_results():
    for path in RESULTS:
        for run in json.loads(path.read_text(encoding="utf-8"))["runs"]:
            if match := COMMAND.match(run["command"]):
                yield path, shlex.split(match[1])


def understand(words, *, whole):
    """Let the command line read the words without running anything; a named command may lack arguments."""
    command, name = typer.main.get_command(app), "valvefsi"
    words = words[1:]
    while hasattr(command, "commands"):
        if not words or words[0].startswith("-"):
            return
        name, command, words = words[0], command.commands.get(words[0]), words[1:]
        assert command is not None, f"there is no command {name}"
    command = generate.with_options(command, name)
    words = [word for word in words if word not in ("--help", "...")]
    command.make_context(name, words, resilient_parsing=not whole)
    known = {text for parameter in command.params for text in parameter.opts}
    assert {word.partition("=")[0] for word in words if word.startswith("--")} <= known


@pytest.mark.parametrize("path", [*DOCUMENTS, *DEMOS], ids=name_of)
def test_every_command_of_a_document_is_understood(path):
    for words, whole in commands_of(path):
        understand(words, whole=whole)
        if whole and words[1] == "run":
            changes = [words[n + 1] for n, word in enumerate(words) if word == "--set"]
            load_case(ROOT / words[2], changes)
        if whole and words[1] == "sweep":
            over, changes = (
                [words[n + 1] for n, word in enumerate(words) if word == key] for key in ("--over", "--set")
            )
            read_cases(ROOT / words[2], make_sweep(over, changes).members)
        for word in words:
            if whole and word.startswith(("demos/", "calibration/")):
                assert (ROOT / word).exists(), word


@pytest.mark.parametrize(
    ("path", "words"), list(commands_of_results()), ids=lambda part: getattr(part, "stem", None)
)
def test_the_command_behind_a_number_is_understood(path, words):
    understand(words, whole=True)


@pytest.mark.parametrize(
    "line", ["valvefsi banch cavity", "valvefsi bench cavity --reynold 100", "valvefsi run"]
)
def test_a_wrong_command_is_noticed(line):
    with pytest.raises(Exception, match=r"(?i)no command|no such option|missing"):
        understand(line.split(), whole=True)


# Links and pages


@pytest.mark.parametrize("path", DOCUMENTS, ids=name_of)
def test_every_link_of_a_document_leads_somewhere(path):
    pages = ("case_keys", "study_keys", "commands", "valve_numbers", "credibility")
    made = {f"tutorials/{demo.stem}.md" for demo in DEMOS} | {f"{page}.md" for page in pages}
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", FENCE.sub("", path.read_text(encoding="utf-8"))):
        if "://" in target:
            continue
        if "generated/" in target:
            assert target.rpartition("generated/")[2] in made, target
        else:
            assert (path.parent / target).exists(), target


def test_every_key_of_a_case_is_on_its_page():
    page = generate.case_keys()
    for key in ("viscosity", "nu_stab", "backflow", "averages_from", "commissure", "cycles_from", "annulus"):
        assert f"| `{key}` |" in page
    assert "### `hgo`" in page
    assert "| `downstream` |" in page


def test_every_key_of_a_study_is_on_its_page():
    page = generate.study_keys()
    for key in ("grids", "max_beats", "without_offset", "fibre_angle", "R_c", "C_VIA", "fit_area", "linf"):
        assert f"| `{key}` |" in page
    for key in ("design", "distribution", "take", "joint", "degree", "tolerance"):
        assert f"| `{key}` |" in page
    assert "### `[record]` of `validate`" in page
    assert "### `[[input]]` of `sample`" in page


def test_every_command_is_on_its_page():
    page = generate.commands()
    for name in ("run", "bench cavity", "fit biaxial", "mesh import", "validate", "verify", "sample"):
        assert f"## `valvefsi {name}`" in page
    assert "| `--reynolds` |" in page


def test_every_number_of_a_valve_is_on_its_page():
    page = generate.valve_numbers()
    for name in (
        "effective_orifice_area_cm2",
        "forward_energy_loss_mJ",
        "opening_half_ms",
        "flutter",
        "exposure",
    ):
        assert f"| `{name}` |" in page
    assert "rms_flow/(51.6 sqrt(mean_pressure_difference/density))" in page


def test_every_module_has_a_page_and_can_be_imported():
    pages = "".join(map(generate.modules, generate.parts_of_the_package()))
    modules = re.findall(r"automodule:: (\S+)", pages)
    assert {"valvefsi.fsi", "valvefsi.coupling.kernels", "valvefsi.solid.statics.problem"} <= set(modules)
    for module in modules:
        importlib.import_module(module)


def test_a_demo_becomes_a_page():
    page = generate.tutorial(ROOT / "demos" / "01_minimal.py")
    assert page.splitlines()[2] == "# The smallest coupled run"
    assert "```python\nimport os" in page
    assert "# %%" not in page


@pytest.mark.slow
@pytest.mark.serial
def test_the_documents_build_without_a_warning(tmp_path):
    pytest.importorskip("sphinx", reason="make docs installs it")
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", str(ROOT / "docs")]
    done = subprocess.run([*command, str(tmp_path)], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-4000:]
    for page in ("index.html", "generated/tutorials/01_minimal.html", "generated/api/fsi.html"):
        assert (tmp_path / page).exists()
