"""Help shows what it says: units in brackets, on terminals of 80 columns."""

from __future__ import annotations

import re

import pytest
import typer

from tests.test_documents import generate
from valvefsi.cli import app

pytestmark = pytest.mark.serial
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
