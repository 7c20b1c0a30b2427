"""Published numbers say where they come from."""

from __future__ import annotations

import pytest

from valvefsi.benchmarks import references

TABLES = sorted(references.FOLDER.glob("*.csv"))
KEYS = references.KEYS


def missing_keys(text: str) -> list[str]:
    """Return the keys that have no header line ``# key: value`` above the first data line."""
    return [key for key in KEYS if key not in references.header(text)]


@pytest.mark.parametrize("path", TABLES, ids=lambda path: path.name)
def test_a_reference_table_states_source_doi_units_and_method(path):
    missing = missing_keys(path.read_text(encoding="utf-8"))
    assert not missing, f"{path.name}: no header line for {', '.join(missing)}"


def test_every_table_is_read_and_rows_are_found_by_their_columns():
    assert len(TABLES) > 8
    for path in TABLES:
        table = references.read(path.stem)
        assert table.rows
        assert all(len(row) == len(table.rows[0]) and None not in row.values() for row in table.rows)
    ghia = references.read("ghia1982_cavity")
    assert ghia.value("velocity", reynolds=1000, component="v", position="0.5000") == 0.02526
    assert len(ghia.column("velocity", reynolds=100, component="u")) == 17
    with pytest.raises(ValueError, match="unpack"):
        ghia.value("velocity", reynolds=100, component="u")


@pytest.mark.parametrize("key", KEYS)
def test_a_missing_empty_or_late_header_line_is_noticed(key):
    header = {name: f"# {name}: something" for name in KEYS}
    table = "x,y\n1,2\n"
    assert missing_keys("\n".join([*header.values(), table])) == []
    without = [line for name, line in header.items() if name != key]
    assert missing_keys("\n".join([*without, table])) == [key]
    assert missing_keys("\n".join([*without, f"# {key}:", table])) == [key]
    assert missing_keys("\n".join([*without, table, header[key]])) == [key]
