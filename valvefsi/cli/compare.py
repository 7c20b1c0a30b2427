"""``valvefsi compare``: a run of a valve with another, or with a record of a pulse duplicator."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from valvefsi.cli.fit_output import console
from valvefsi.cli.labels import LABELS
from valvefsi.cli.option_groups import options_of
from valvefsi.cli.options import MARKS, Decimal, Out, Style, Trust, read_seconds
from valvefsi.cli.tables import number, print_table
from valvefsi.errors import CaseError

if TYPE_CHECKING:
    from rich.console import Console

    from valvefsi.case import Case
    from valvefsi.post.valve_beat import Beat
    from valvefsi.types import Scalar


@dataclass(frozen=True, kw_only=True)
class CompareCommand:
    """Arguments and options of ``compare``."""

    a: Annotated[Path, typer.Argument(metavar="A", help="Folder of a run, or a record (CSV).")]
    b: Annotated[Path, typer.Argument(metavar="B", help="The same; the reference.")]
    start: Annotated[
        str, typer.Option(metavar="TIME", help="Time in the cycle of B at which that of A begins.")
    ] = "0 s"
    shift_max: Annotated[
        str, typer.Option(metavar="TIME", help="Largest common shift of A in time; 0 for none.")
    ] = "7 ms"
    period: Annotated[
        str | None,
        typer.Option(
            metavar="TIME", help="Length of a cycle of both, where a pump or a record says another or none."
        ),
    ] = None
    decimal: Decimal = "point"
    out: Out = None
    trust: Trust = False
    style: Style = "screen"


@options_of(CompareCommand)
def compare(options: CompareCommand) -> None:
    """Compare a run of a valve with a record or another run: norms, numbers, comparison.json, comparison.png.

    A run is a folder with history.csv and case.toml of a valve between two circuits; its last whole cycle counts.
    A record is a CSV file; one of several cycles is averaged. Columns, any of them, sd_ for standard deviations:

    t_s,p_lv_mmHg,p_ao_mmHg,q_ao_ml_s,pdva_cm2,sd_p_lv,sd_p_ao,sd_q_ao,sd_pdva

    The results go to --out, else to A where that is a run, else to results/compare-A.
    """
    from mpi4py import MPI

    if MPI.COMM_WORLD.rank != 0:
        return
    from valvefsi.post.plots.paper import paper
    from valvefsi.post.valve_comparison import compare_pair
    from valvefsi.studies.comparison import write_comparison

    start, most = read_seconds(options.start, "start"), read_seconds(options.shift_max, "shift-max")
    period = None if options.period is None else read_seconds(options.period, "period")
    if period == 0.0:
        raise CaseError("expected a positive time", key="period", value=options.period)
    (case_a, a), (case_b, b) = (_read(path, period, options) for path in (options.a, options.b))
    pair, result = compare_pair(a, b, start=start, shift_max=most)
    if case_a is not None and case_b is not None:
        result["case"] = _differences(case_a, case_b)
    folder = options.out or (
        options.a if options.a.is_dir() else Path("results") / f"compare-{options.a.stem}"
    )
    with paper(options.style == "paper"):
        picture = write_comparison(pair, result, folder)
    _show(console(), result)
    typer.echo(f"results in {folder / 'comparison.json'} and {picture}")


def _read(path: Path, period: float | None, options: CompareCommand) -> tuple[Case | None, Beat]:
    """Return the beat of a run or a record, and the case of a run."""
    if path.is_dir():
        from valvefsi.case.valve_runs import read_run

        return read_run(path, period=period, trust=options.trust)
    if not path.exists():
        raise CaseError("no such folder of a run, and no such record", file=path)
    from valvefsi.fitting.bench_beat import read_bench_beat

    return None, read_bench_beat(path, period=period, decimal=MARKS[options.decimal])


def _differences(a: Case, b: Case) -> dict[str, dict[str, object]]:
    """Return the values of two cases where they differ, CGS."""
    from valvefsi.case.values import case_differences

    return {key: {"a": first, "b": second} for key, (first, second) in case_differences(a, b).items()}


def _show(page: Console, result: dict[str, Any]) -> None:
    """Print what was compared, norms, numbers, and what differs between two cases."""
    for side in "ab":
        it = result[side]
        of = f"mean of {it['mean_of_cycles']} cycles" if it["mean_of_cycles"] > 1 else "one cycle"
        about = f"{it['kind']}, {of} of {it['period_s']:.6g} s from {it['cycle_from_s']:.6g} s"
        _line(page, "; ".join((f"{side.upper()}: {it['name']}, {about}", *it["notes"])))
    _norms(page, result)
    rows = [
        (name, *(_cell(row[key]) for key in ("a", "b", "difference")), _cell(row["difference_percent"], " %"))
        for name, row in result["numbers"]["rows"].items()
    ]
    sides = {"number": "left", "A": "right", "B": "right", "A - B": "right", "over B": "right"}
    print_table(page, "numbers of the valve", sides, rows)
    for side, why in result["numbers"].get("missing", {}).items():
        _line(page, f"missing of {side.upper()}: {why}")
    if "case" in result:
        changes = [(key, _value(pair["a"]), _value(pair["b"])) for key, pair in result["case"].items()]
        print_table(
            page, "keys of the cases that differ (CGS)", {"key": "left", "A": "right", "B": "right"}, changes
        )


def _norms(page: Console, result: dict[str, Any]) -> None:
    """Print the table of norms, and what was done in time and to the flow."""
    shift = f"{result['shift_ms']:+.2f} ms"
    headings = ["L2 [%]", "Linf [%]", "NRMSE [%]", f"L2, {shift}", "Linf", "NRMSE", "repeats A", "repeats B"]
    kinds = ("l2_percent", "linf_percent", "nrmse_percent")
    rows = [
        (
            LABELS[name],
            *(_cell(row[which][kind]) for which in ("as_they_are", "shifted") for kind in kinds),
            *(_cell(row["repeatability_l2_percent"][side]) for side in "ab"),
        )
        for name, row in result["quantities"].items()
    ]
    print_table(page, "A less B over B", {"": "left", **dict.fromkeys(headings, "right")}, rows)
    bound = ", the largest allowed" if result["shift_at_its_bound"] else ""
    way = "earlier" if result["shift_ms"] < 0.0 else "later"
    _line(page, f"shift: all of A is moved {way} by {abs(result['shift_ms']):.2f} ms{bound}")
    for side, offset in result["diastolic_offset_ml_per_s"].items():
        if offset is not None:
            _line(
                page,
                f"offset: flow of {side.upper()} while the valve is shut is {offset:.3g} ml/s on average",
            )


def _line(page: Console, text: str) -> None:
    page.print(text, highlight=False, soft_wrap=True, markup=False)


def _cell(value: float | None, unit: str = "") -> str:
    return "-" if value is None else f"{value:.4g}{unit}"


def _value(value: Scalar) -> str:
    return "-" if value is None else number(value)
