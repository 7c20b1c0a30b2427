"""What every benchmark leaves behind: ``result.json``, rows of its table, and the environment it was made in."""

from __future__ import annotations

import json
import resource
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from valvefsi.io.folder import write_text
from valvefsi.verification.convergence import observed_order

Row = dict[str, Any]
"""A line of a table: ``quantity``, ``computed``, ``reference``, ``difference_percent``, ``unit``, ``source``."""


@dataclass(frozen=True, kw_only=True)
class Reference:
    """A value to compare with.

    Attributes:
        value: The value; None where only a band is known.
        source: Where it is from.
        band: Smallest and largest published value.
        exact: Whether errors against it measure the order.
    """

    value: float | None = None
    source: str = ""
    band: tuple[float, float] | None = None
    exact: bool = False


def write_result(out: Path, result: Mapping[str, Any], comm: MPI.Comm) -> Path:
    """Write ``result.json`` on rank 0; numbers keep all their digits.

    Args:
        out: Folder of the result, made if need be.
        result: What to write.
        comm: Communicator of the run.
    """
    path = Path(out) / "result.json"
    if comm.rank == 0:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, json.dumps(result, indent=2, default=plain) + "\n")
    comm.barrier()
    return path


def plain(value: Any) -> Any:
    """Return what JSON can hold: arrays as lists, dataclasses as tables, what is neither as its text."""
    if is_dataclass(value) and not isinstance(value, type):
        return asdict(value)
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    return str(value)


def peak_memory(comm: MPI.Comm) -> float:
    """Return the largest resident size of all processes together so far [GiB] (collective)."""
    return float(comm.allreduce(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss) / 2**20)


def row(
    quantity: str,
    computed: float | str,
    reference: float | str | None = None,
    source: str = "",
    *,
    unit: str = "",
    relative: bool = True,
) -> Row:
    """One line of a benchmark's table: what was computed, what it is compared with, where that comes from."""
    difference = None
    if isinstance(computed, float) and isinstance(reference, float) and reference and relative:
        difference = 100.0 * (computed - reference) / abs(reference)
    return {
        "quantity": quantity,
        "computed": computed,
        "reference": reference,
        "difference_percent": difference,
        "unit": unit,
        "source": source,
    }


def compared(label: str, value: float, reference: Reference, unit: str = "") -> Row:
    """Return the line that compares a value with a reference, or says whether it lies in its band."""
    if reference.band is None:
        return row(label, value, reference.value, reference.source, unit=unit)
    low, high = reference.band
    inside = "inside" if low <= value <= high else "OUTSIDE"
    line = row(label, value, f"{low:g} ... {high:g}", f"{inside}: {reference.source}", unit=unit)
    return {**line, "inside": low <= value <= high}


def order_row(
    label: str,
    values: Sequence[float],
    ratios: Sequence[float] | float = 2.0,
    *,
    exact: float | None = None,
    expected: float | None = None,
    source: str = "",
) -> list[Row]:
    """Return the line of an observed order, see `observed_order`; none where the values give no order."""
    order = observed_order(values, ratios, exact=exact)
    return [] if order is None else [row(label, order, expected, source)]
