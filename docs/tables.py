"""Write the tables of README and documents from ``docs/results``; no number in them is typed by hand.

    python docs/tables.py            write them
    python docs/tables.py --check    say which differ, and exit with 1 if any does

A document says where a table stands, and this program writes what is between the two comments:

    <!-- table: cook rows=case -->
    <!-- end -->

``rows=list`` gives one line per quantity, with reference and difference; ``rows=case`` one line per case and a column
per quantity; ``rows=quantity`` a column per case. ``only=REGEX`` takes the quantities that match, ``case=REGEX`` the
cases (no spaces in either, ``.`` stands for one). ``<!-- table: summary -->`` is the table of the README.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "docs" / "results"
BLOCK = re.compile(r"(<!-- table: (?P<name>[\w-]+)(?P<options>[^>]*?) -->\n).*?(<!-- end -->)", re.DOTALL)

SUMMARY = (
    ("E.1, compressed block: incompressible statics", "statics", r"E\.1", r"^u_y"),
    ("E.1 immersed, 128 x 128 cells", "compression-grids", "64 x 32, 128 x 128", "^u_y"),
    ("E.2, torsion of a column by 2.5 pi: statics", "statics", r"E\.2", "^u_y, 1 of"),
    ("leaflet strip, solid shell: bending stiffness ratio", "bending", "", "^stiffness_ratio$"),
    ("FSI3, flag behind a cylinder: u_y, amplitude", "turek-fsi3", "12 cells", "^u_y.*amplitude"),
    ("the same, frequency", "turek-fsi3", "12 cells", "^u_y, freq"),
    ("FSI2, density ratio 10: u_y, amplitude", "turek-fsi2", "8 cells", "^u_y.*amplitude"),
    ("FSI1, steady: u_y of the tip, a third of h", "turek-fsi1", "8 cells", "^u_y"),
    ("two leaflets in a channel: u_x of a tip", "valve-2d", "92", "^u_x"),
    ("cylinder, Re 100: drag coefficient", "cylinder", "Re 100, 48", "drag"),
    ("Taylor-Green, Re 1600: largest loss of energy", "taylor-green-stored", "192", "largest"),
    ("Womersley flow: observed order", "channel", "", "womersley.*order"),
    ("rigid test section shut, 100 mmHg: leak", "leakage", "", "leak"),
)
"""Rows of the README's table: label, file of results, case and quantity (regular expressions, first match)."""


def documents(root: Path = ROOT) -> list[Path]:
    """Return the documents that may hold tables."""
    pages = [path for path in (root / "docs").rglob("*.md") if "generated" not in path.parts]
    return [root / "README.md", *sorted(pages)]


def rewritten(text: str, results: Path = RESULTS) -> str:
    """Return a document with its tables written anew."""

    def block(match: re.Match[str]) -> str:
        options = dict(part.split("=", 1) for part in match["options"].split())
        return f"{match[1]}\n{table(match['name'], options, results)}\n{match[4]}"

    return BLOCK.sub(block, text)


def table(name: str, options: Mapping[str, str], results: Path = RESULTS) -> str:
    """Return one table in Markdown, with where its numbers come from under it."""
    if name == "summary":
        return summary(results)
    result = load(name, results)
    wanted = [
        row
        for row in result["quantities"]
        if re.search(options.get("only", ""), row["quantity"])
        and re.search(options.get("case", ""), row["case"])
    ]
    if not wanted:
        raise SystemExit(f"{name}: no quantity matches {dict(options)}")
    return LAYOUTS[options.get("rows", "list")](wanted, result.get("cases", "")) + f"\n{origin(result)}\n"


def load(name: str, results: Path = RESULTS) -> dict[str, Any]:
    """Return one file of results."""
    return json.loads((results / f"{name}.json").read_text(encoding="utf-8"))


def as_list(rows: Sequence[Mapping[str, Any]], cases_are: str) -> str:
    """Return one line per quantity."""
    cases = len({row["case"] for row in rows}) > 1
    compared = any("reference" in row for row in rows)
    head = ([cases_are or "case"] if cases else []) + ["quantity", "computed"]
    head += ["reference", "difference", "source"] if compared else []
    lines = []
    for row in rows:
        line = ([row["case"]] if cases else []) + [row["quantity"], with_unit(row)]
        lines.append(line + ([reference(row), difference(row), row.get("source", "")] if compared else []))
    return markdown(head, lines)


def by_case(rows: Sequence[Mapping[str, Any]], cases_are: str) -> str:
    """Return one line per case, a column per quantity."""
    names = list(dict.fromkeys((row["quantity"], row.get("unit", "")) for row in rows))
    cases = list(dict.fromkeys(row["case"] for row in rows))
    cells = {(row["case"], row["quantity"]): computed(row) for row in rows}
    lines = [[case, *(cells.get((case, name), "") for name, _ in names)] for case in cases]
    references = {row["quantity"]: reference(row) for row in rows if "reference" in row}
    if references:
        lines.append(["reference", *(references.get(name, "") for name, _ in names)])
    return markdown([cases_are, *(f"{name} [{unit}]" if unit else name for name, unit in names)], lines)


def by_quantity(rows: Sequence[Mapping[str, Any]], cases_are: str) -> str:
    """Return one line per quantity, a column per case."""
    cases = list(dict.fromkeys(row["case"] for row in rows))
    names = list(dict.fromkeys((row["quantity"], row.get("unit", "")) for row in rows))
    cells = {(row["quantity"], row["case"]): computed(row) for row in rows}
    references = {row["quantity"]: row for row in rows if "reference" in row}
    lines = []
    for name, unit in names:
        line = [f"{name} [{unit}]" if unit else name, *(cells.get((name, case), "") for case in cases)]
        lines.append(line + ([reference(references.get(name, {}))] if references else []))
    sources = list(dict.fromkeys(row.get("source", "") for row in references.values()))
    last = [sources[0] if len(sources) == 1 and sources[0] else "reference"] if references else []
    return markdown([cases_are, *cases, *last], lines)


LAYOUTS: dict[str, Callable[[Sequence[Mapping[str, Any]], str], str]] = {
    "list": as_list,
    "case": by_case,
    "quantity": by_quantity,
}


ORIGINS = {
    "run": "run at",
    "stored": "stored, published with",
    "checked": "checked outside the test suite at",
}
"""What is said of each kind of result before its commit."""


def summary(results: Path = RESULTS) -> str:
    """Return the table of the README."""
    lines = []
    for label, name, case, quantity in SUMMARY:
        result = load(name, results)
        fitting = [
            row
            for row in result["quantities"]
            if re.search(case, row["case"]) and re.search(quantity, row["quantity"])
        ]
        if not fitting:
            raise SystemExit(f"summary: {name} has no {quantity} of {case}")
        row = fitting[0]
        lines.append([label, with_unit(row), reference(row), difference(row), row["source"]])
    return markdown(["what", "computed", "reference", "difference", "source"], lines)


def origin(result: Mapping[str, Any]) -> str:
    """Return where the numbers come from: commands, date, ranks, version, commit."""
    commands = "".join(f" `{run['command']}`." for run in result["runs"])
    ranks = "one rank" if result["ranks"] == 1 else f"{result['ranks']} ranks"
    cores = f" of {result['cores']} cores" if result.get("cores") else ""
    scheme = f" {result['scheme']}." if result.get("scheme") else ""
    return (
        f"*{result['title']}.*{scheme}{commands} {result['date']}, {ranks}{cores}, version {result['version']}; "
        f"{ORIGINS[result['origin']]} commit {result['commit']}."
    )


def markdown(head: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    rows = [head, ["---"] * len(head), *lines]
    return (
        "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows) + "\n"
    )


def with_unit(row: Mapping[str, Any]) -> str:
    """Return the computed value of a row with its unit."""
    return f"{computed(row)} {row.get('unit', '')}".strip()


def reference(row: Mapping[str, Any]) -> str:
    """Return the reference of a row, empty where it has none."""
    return number(row["reference"]) if "reference" in row else ""


def difference(row: Mapping[str, Any]) -> str:
    """Return how far a number is off its reference, empty where that means nothing."""
    value, known = row["computed"], row.get("reference")
    if not isinstance(value, int | float) or not isinstance(known, int | float) or known == 0:
        return ""
    percent = 100 * (value - known) / abs(known)
    return f"{percent:+.2f} %" if abs(percent) < 100 else f"{percent:+.0f} %"


def number(value: object, digits: int = 5) -> str:
    """Return a value as text, large numbers without decimals."""
    if not isinstance(value, float):
        return str(value)
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.{digits}g}"


def computed(row: Mapping[str, Any]) -> str:
    """Return the computed value of a row: five digits where it is compared with a number, else four."""
    return number(row["computed"], 5 if row.get("reference") else 4)


def main(arguments: Sequence[str]) -> int:
    """Write the tables, or with ``--check`` only compare them."""
    wrong = []
    for path in documents():
        text = path.read_text(encoding="utf-8")
        if (new := rewritten(text)) != text:
            wrong.append(path.relative_to(ROOT))
            if "--check" not in arguments:
                path.write_text(new, encoding="utf-8")
    verb = "differs from its results" if "--check" in arguments else "written"
    for path in wrong:
        print(f"{path}: {verb}")
    return int(bool(wrong) and "--check" in arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
