"""``valvefsi target``: how far a beat of a run is from its target, and the case corrected by it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from valvefsi.cli.options import Trust
from valvefsi.cli.tables import number, print_lines, print_table, terminal
from valvefsi.units import LITRE_PER_MINUTE, MMHG

if TYPE_CHECKING:
    from valvefsi.case.target_beat import Correction

CORRECTED = "corrected.toml"


def target(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a run whose case has a target.")],
    trust: Trust = False,
) -> None:
    """Correct pump and resistance of a run with a target by its last whole beat, into DIR/corrected.toml."""
    from valvefsi.case.target_beat import correct_target
    from valvefsi.case.writing import to_toml
    from valvefsi.io.folder import write_text

    found = correct_target(folder, trust=trust)
    write_text(folder / CORRECTED, to_toml(found.case))
    console = terminal()
    headings = {"quantity": "left", "target": "right", f"beat {found.beats}": "right", "off by": "right"}
    headings |= {"the loop then": "right", "next": "right", "unit": "left"}
    print_table(console, "target", headings, rows_of(found))
    later = f"time.t_end='{(found.beats + 2) * found.chosen.period:.6g} s'"
    print_lines(
        console,
        [
            f"response of the valve, its flow over that of the orifice: {found.response:.4g}",
            f"amplitude of the pump: {found.chosen.amplitude:.4g}",
            f"written: {folder / CORRECTED}",
            "next, two beats with the corrected pump, or from the start:",
            f"  valvefsi run {folder / CORRECTED} --out {folder} --resume --allow-change --set {later}",
            f"  valvefsi run CASE.toml --set target.response={found.response:.4g}",
        ],
    )


def rows_of(found: Correction) -> list[tuple[str, ...]]:
    """Return the lines of the table: what was wanted, what the beat has, and what is expected next."""
    wanted = found.case.target
    assert wanted is not None  # it was corrected
    lines = (
        (
            "cardiac output",
            (wanted.cardiac_output, found.cardiac_output, found.loop_output, found.chosen.cardiac_output),
            LITRE_PER_MINUTE,
            "l/min",
        ),
        (
            "mean aortic pressure",
            (
                wanted.mean_aortic_pressure,
                found.mean_aortic_pressure,
                None,
                found.chosen.mean_aortic_pressure,
            ),
            MMHG,
            "mmHg",
        ),
    )
    rows: list[tuple[str, ...]] = []
    for name, values, unit, word in lines:
        goal, now, loop, then = ("" if v is None else number(v / unit) for v in values)
        off = 100.0 * (values[1] / values[0] - 1.0)
        rows.append((name, goal, now, f"{off:+.2g} %", loop, then, word))
    return rows
