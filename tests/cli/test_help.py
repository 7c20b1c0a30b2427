"""Help shows what it says: units in brackets, on terminals of 80 columns."""

from __future__ import annotations

import ast
import re
from collections import Counter
from pathlib import Path

import pytest
import typer

from tests.test_documents import generate
from valvefsi.cli import app

pytestmark = pytest.mark.serial
SOURCES = sorted((Path(__file__).parents[2] / "valvefsi" / "cli").glob("*.py"))
COMMANDS = dict(generate.leaves(typer.main.get_command(app), "valvefsi"))


def brackets(text):
    """What stands in brackets in a text that rich reads: after a backslash a bracket is one."""
    return re.findall(r"\\?\[([^\]]*)\]", text)


@pytest.mark.parametrize("name", COMMANDS)
def test_help_keeps_what_is_in_brackets(name, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "200")
    command = COMMANDS[name]
    words = [command.help or "", *(getattr(option, "help", None) or "" for option in command.params)]
    with pytest.raises(SystemExit):
        command.main(["--help"], prog_name=name)
    shown = "".join(re.sub(r"[│╭╮╰╯─]", " ", capsys.readouterr().out).split())
    for inside in (inside for text in words for inside in brackets(text)):
        assert f"[{''.join(inside.split())}]" in shown, inside


def option_texts(source):
    """What the help of each option and argument says that is made in a source."""
    for call in (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call)):
        if isinstance(call.func, ast.Attribute) and call.func.attr in ("Option", "Argument"):
            yield from (ast.unparse(word.value) for word in call.keywords if word.arg == "help")


def test_no_option_is_written_twice():
    """What several commands share is an alias in options.py: texts, units and bounds cannot drift apart."""
    texts = Counter(text for path in SOURCES for text in option_texts(path.read_text(encoding="utf-8")))
    assert len(texts) > 60
    assert [text for text, count in texts.items() if count > 1] == []
