"""From the tables of a case to the circuits at the open sides of its box."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from pydantic_core import PydanticCustomError

from valvefsi.case.circuit_tables import UNITS, CircuitTable
from valvefsi.case.expressions import TimeTable, read_table
from valvefsi.case.fluid_tables import SIDES
from valvefsi.case.models import Case
from valvefsi.case.overrides import nearest
from valvefsi.case.quantities import Quantity
from valvefsi.circulation.loop import FLOWS, Connection, FlowLoop, NoCirculation
from valvefsi.errors import CaseError
from valvefsi.units import PLAUSIBLE


def connected(case: Case) -> dict[str, str]:
    """Return the circuit of each side that has one, by the side's name.

    Raises:
        CaseError: A side names a circuit that the case does not have, or one that another side has.
    """
    names = [circuit.name for circuit in case.circuit]
    found: dict[str, str] = {}
    for side in SIDES:
        name = getattr(case.fluid.sides, side).circuit
        if not name:
            continue
        key = f"fluid.sides.{side}.circuit"
        if name not in names:
            raise CaseError(
                f"the case has no such circuit{nearest(name, names)}", file=case.file, key=key, value=name
            )
        if name in found.values():
            raise CaseError("another side has this circuit", file=case.file, key=key, value=name)
        found[side] = name
    return found


def build_circulation(case: Case) -> FlowLoop | NoCirculation:
    """Build the circuits that sides are connected to, if any.

    Raises:
        CaseError: A circuit cannot be at a side, or its pump's record cannot be used.
    """
    circuits = {circuit.name: circuit for circuit in case.circuit}
    connections = []
    for side, name in connected(case).items():
        built = circuits[name].build()
        drive = _drive(case, circuits[name], built.circuit.system().inputs)
        try:
            connections.append(
                Connection(side=side, system=built.circuit.system(), start=built.start, drive=drive)
            )
        except ValueError as error:
            raise CaseError(str(error), file=case.file, key=f"circuit.{name}.pump.file") from None
    return FlowLoop(connections) if connections else NoCirculation()


def _drive(case: Case, circuit: CircuitTable, inputs: tuple[str, ...]) -> Callable[[float], dict[str, float]]:
    """What the inputs of a circuit other than its flow are at a time, in CGS."""
    wanted = [name for name in inputs if name not in FLOWS]
    if not wanted or circuit.pump.file is None:
        return lambda t: {}
    path = Path(circuit.pump.file)
    path = path if path.is_absolute() or case.file is None else case.file.parent / path
    table = read_table(path)
    columns = {name: _scaled(name, _column(table, name, path), circuit.pump.amplitude) for name in wanted}
    period, phase, length = circuit.pump.period, circuit.pump.phase, table.t[-1] - table.t[0]
    own = circuit.pump.record_period or period
    rate = 1.0 if own is None or period is None else own / period
    key, value = ("period", own) if own is not None else ("phase", phase)
    key = "record_period" if circuit.pump.record_period else key
    if value > length * (1 + 1e-6):
        raise CaseError(
            f"the record of {path.name} is shorter, {length:.6g} s",
            file=case.file,
            key=f"circuit.{circuit.name}.pump.{key}",
            value=value,
        )

    def drive(t: float) -> dict[str, float]:
        at = rate * t + phase
        at = at if own is None else table.t[0] + (at - table.t[0]) % own
        return {name: float(np.interp(at, table.t, values)) for name, values in columns.items()}

    return drive


def _scaled(name: str, values: np.ndarray, amplitude: float) -> np.ndarray:
    """Return a column of a pump's record times its amplitude; a pressure above its smallest value, the atrium's not."""
    if amplitude == 1.0 or name == "p_la":
        return values
    rest = values.min() if name.startswith("p") else 0.0
    scaled: np.ndarray = rest + amplitude * (values - rest)
    return scaled


def _column(table: TimeTable, name: str, path: Path) -> np.ndarray:
    """The column of an input in CGS; its heading ends with its unit, as in ``p_pump_mmHg`` or ``q_pump_ml_s``."""
    for heading, values in table.columns.items():
        if heading.startswith(f"{name}_"):
            unit = heading[len(name) + 1 :].replace("_", "/")
            try:
                values = values * Quantity(UNITS[name[0]]).parse(f"1 {unit}")
            except PydanticCustomError as error:
                raise CaseError(error.message(), file=path, key=heading) from None
            if np.abs(values).max() > PLAUSIBLE[name[0]]:
                message = f"at most {PLAUSIBLE[name[0]]:g} {UNITS[name[0]]} is plausible"
                raise CaseError(message, file=path, key=heading, value=float(np.abs(values).max()))
            return values
    raise CaseError(f"expected a column such as {name}_{'mmHg' if name[0] == 'p' else 'ml_s'}", file=path)
