"""Published numbers say where they come from."""

from __future__ import annotations

from pathlib import Path

import pytest

TESTS = Path(__file__).parent
REFERENCE = (TESTS / "reference", TESTS.parent / "valvefsi" / "benchmarks" / "reference")
TABLES = [path for folder in REFERENCE for path in sorted(folder.rglob("*.csv"))]
KEYS = ("source", "doi", "units", "method")


def missing_keys(text: str) -> list[str]:
    """Return the keys that have no header line ``# key: value`` above the first data line."""
    found = set()
    for line in text.splitlines():
        if not line.startswith("#"):
            break
        key, _, value = line[1:].partition(":")
        if value.strip():
            found.add(key.strip())
    return [key for key in KEYS if key not in found]


@pytest.mark.parametrize("path", TABLES, ids=lambda path: path.name)
def test_a_reference_table_states_source_doi_units_and_method(path):
    missing = missing_keys(path.read_text(encoding="utf-8"))
    assert not missing, f"{path.name}: no header line for {', '.join(missing)}"


def test_there_are_reference_tables_to_check():
    for folder in REFERENCE:
        assert any(path.is_relative_to(folder) for path in TABLES), folder


@pytest.mark.parametrize("key", KEYS)
def test_a_missing_empty_or_late_header_line_is_noticed(key):
    header = {name: f"# {name}: something" for name in KEYS}
    table = "x,y\n1,2\n"
    assert missing_keys("\n".join([*header.values(), table])) == []
    without = [line for name, line in header.items() if name != key]
    assert missing_keys("\n".join([*without, table])) == [key]
    assert missing_keys("\n".join([*without, f"# {key}:", table])) == [key]
    assert missing_keys("\n".join([*without, table, header[key]])) == [key]
