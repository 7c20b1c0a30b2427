"""The table of a case file that says what a side of the box is connected to: a circuit of the flow loop."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Literal, Self, get_args

import numpy as np
from numpy.typing import ArrayLike
from pydantic import ConfigDict, Field, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from valvefsi.case.includes import read_toml
from valvefsi.case.overrides import nearest
from valvefsi.case.quantities import Quantity, Stress, Time
from valvefsi.case.table import Name, Table, problem
from valvefsi.circulation.linear import Circuit, CircuitState
from valvefsi.circulation.pump import UpstreamBovine, UpstreamPorcine
from valvefsi.circulation.windkessel import Downstream, FourElement, TwoElement
from valvefsi.errors import CaseError
from valvefsi.types import Unchecked

Model = Literal["downstream", "two-element", "four-element", "upstream-porcine", "upstream-bovine"]
KINDS: dict[str, type] = dict(
    zip(get_args(Model), (Downstream, TwoElement, FourElement, UpstreamPorcine, UpstreamBovine), strict=True)
)
UNITS = {"R": "dyn*s/cm^5", "C": "cm^5/dyn", "L": "dyn*s^2/cm^5", "p": "dyn/cm^2", "q": "cm^3/s"}
"""Unit of a parameter or a state, by the first letter of its name."""


class Pump(Table):
    """What drives an upstream circuit, as measured or derived."""

    file: str | None = Field(
        None,
        description="Record of p_pump, or of q_pump and p_la, over time; relative to the file it stands in",
        examples=["pump.csv"],
    )
    period: Time | None = Field(
        None,
        gt=0,
        description="Time after which the record is repeated; held at its end without",
        examples=["0.857 s"],
    )
    record_period: Time | None = Field(
        None,
        gt=0,
        description="Length of a beat in the record where that is another than period: its times are stretched by "
        "period / record_period",
        examples=["0.857 s"],
    )
    amplitude: float = Field(
        1.0,
        gt=0,
        le=1000,
        description="Factor on the record: on q_pump, and on what p_pump is above its smallest value",
    )
    phase: Time = Field(
        0.0,
        ge=0,
        description="Place in the record at which the run starts: at time t the record is read at phase + t, in its "
        "own time",
        examples=["300 ms"],
    )
    cycles_from: Time | None = Field(
        None,
        ge=0,
        description="Start of the first cycle of a valve's numbers; when left out, the first time at which the "
        "valve is closed",
        examples=["1.2 s"],
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.record_period is not None and self.period is None:
            raise problem("there is no period to stretch the record to", "record_period", self.record_period)
        own = self.record_period or self.period
        if own is not None and self.phase >= own:
            raise problem(f"expected less than the period, {own:g} s", "phase", self.phase)
        if self.phase and self.file is None:
            raise problem("there is no record (file) to start within", "phase", self.phase)
        return self


class CircuitTable(Table):
    """A circuit of the flow loop; its parameters stand beside its name, as `valvefsi fit windkessel` writes them."""

    model_config = ConfigDict(extra="allow", frozen=True)
    name: Name = Field(description="Name, for sides and messages")
    model: Model = Field(description="Circuit: " + ", ".join(get_args(Model)) + "; its parameters follow")
    start: dict[str, float] = Field(
        {}, description="Initial states by name, 0 where nothing is said [dyn/cm^2, cm^3/s]"
    )
    provenance: dict[str, str | float] = Field({}, description="Where the parameters are from")
    pump: Pump = Field(Pump(), description="What drives an upstream circuit")
    target_pressure: Stress | None = Field(
        None,
        gt=0,
        description="Mean pressure of a cycle at its side that a valve's report compares with",
        examples=["100 mmHg"],
    )

    @model_validator(mode="before")
    @classmethod
    def _read(cls, data: Unchecked) -> Unchecked:
        if not isinstance(data, Mapping):
            return data
        kind = KINDS.get(data["model"]) if isinstance(data.get("model"), str) else None
        if kind is None:
            choices = ", ".join(KINDS)
            raise problem(
                f"expected one of {choices}{nearest(data.get('model'), list(KINDS))}",
                "model",
                data.get("model"),
            )
        names = [field.name for field in fields(kind)]
        read = {key: value for key, value in data.items() if key in cls.model_fields}
        for key, value in data.items():
            if key not in (*names, *cls.model_fields):
                raise problem(f"unknown parameter of {data['model']}{nearest(key, names)}", key, value)
        for name in names:
            if name not in data:
                what = f"this parameter of {data['model']} is required, a quantity in {UNITS[name[0]]}"
                raise problem(what, name)
            read[name] = _quantity(name, data[name], name)
        try:
            states = kind(**{name: read[name] for name in names}).system().states
        except ValueError as error:
            key, _, reason = str(error).partition(": ")
            name = key.partition(" ")[0]
            raise problem(reason, name, data.get(name)) from None
        if "start" in data:
            read["start"] = _start(data["start"], states)
        return read

    @property
    def parameters(self) -> dict[str, object]:
        """Parameters by name, in CGS."""
        return dict(self.model_extra or {})

    def unit(self, key: str) -> str | None:
        """Return the unit of a parameter."""
        return super().unit(key) if key in type(self).model_fields else UNITS[key[0]]

    def build(self) -> BuiltCircuit:
        """Return the circuit as a simulation steps it."""
        return BuiltCircuit(
            name=self.name,
            model=self.model,
            circuit=KINDS[self.model](**self.parameters),
            start=self.start,
            pump=None if self.pump.file is None else Path(self.pump.file),
            provenance=self.provenance,
        )


@dataclass(frozen=True, kw_only=True)
class BuiltCircuit:
    """A circuit and where it starts.

    Attributes:
        name: Its name in the case.
        model: Which circuit it is.
        circuit: The circuit, CGS.
        start: Initial states by name, CGS.
        pump: Record of what drives it, None without one.
        provenance: Where it is from.
    """

    name: str
    model: str
    circuit: Circuit
    start: Mapping[str, float]
    pump: Path | None
    provenance: Mapping[str, object]

    def begin(self, u: ArrayLike, t: float = 0.0) -> CircuitState:
        """Return the state at the start, under the inputs ``u``."""
        system = self.circuit.system()
        return system.start(np.array([self.start.get(name, 0.0) for name in system.states]), u, t)


def read_circuit(path: str | Path) -> BuiltCircuit:
    """Read ``circuit.toml`` by itself.

    Raises:
        CaseError: A key is missing, not known or holds what cannot be used.
    """
    path = Path(path)
    raw = read_toml(path)
    pump = raw.get("pump")
    if isinstance(pump, dict) and isinstance(pump.get("file"), str):
        pump["file"] = str(path.parent / pump["file"])
    try:
        return CircuitTable.model_validate({"name": "circuit", **raw}).build()
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        context = first.get("ctx") or {}
        key = ".".join(map(str, (*first["loc"], *filter(None, [context.get("key")]))))
        raise CaseError(first["msg"], file=path, key=key or None, value=context.get("value")) from None


def say_unconnected(circuits: tuple[CircuitTable, ...], rank: int, connected: tuple[str, ...] = ()) -> None:
    """Warn on rank 0 of circuits that no side of the box is connected to: a run does not use them."""
    for circuit in circuits:
        if rank == 0 and circuit.name not in connected:
            warnings.warn(
                f"circuit.{circuit.name}: no side of the box is connected to it; the run does not use it",
                stacklevel=2,
            )


def circuit_schemas() -> list[dict[str, object]]:
    """Return the JSON schema of each circuit."""
    shared = CircuitTable.model_json_schema()["properties"]
    quantity = [{"type": "number"}, {"type": "string"}]
    schemas = []
    for model, kind in KINDS.items():
        names = [field.name for field in fields(kind)]
        own = {
            name: {"anyOf": quantity, "description": f"{name} of {model} [{UNITS[name[0]]}]"}
            for name in names
        }
        start = {"type": "object", "additionalProperties": {"anyOf": quantity}}
        places = {
            **shared,
            "model": {"const": model},
            "start": {**start, "description": shared["start"]["description"]},
            **own,
        }
        schemas.append(
            {
                "type": "object",
                "properties": places,
                "required": ["name", "model", *names],
                "additionalProperties": False,
            }
        )
    return schemas


def _quantity(name: str, value: Unchecked, key: str) -> float:
    try:
        return Quantity(UNITS[name[0]]).parse(value)
    except PydanticCustomError as error:
        raise problem(error.message(), key, value) from None


def _start(given: Unchecked, states: tuple[str, ...]) -> dict[str, float]:
    """Return the initial states in CGS."""
    if not isinstance(given, Mapping):
        raise problem("expected a table of initial states", "start", given)
    for key in given:
        if key not in states:
            raise problem(
                f"no such state, expected {', '.join(states) or 'none'}", f"start.{key}", given[key]
            )
    return {key: _quantity(key, value, f"start.{key}") for key, value in given.items()}
