"""From a case to TOML: the resolved case of a run, and the commented case with every key."""

from __future__ import annotations

import json
from typing import Any, get_args

from pydantic.fields import FieldInfo

from valvefsi.case.circuit_tables import UNITS, CircuitTable
from valvefsi.case.fluid_tables import SIDES
from valvefsi.case.material_tables import Material
from valvefsi.case.models import Case
from valvefsi.case.quantities import Quantity
from valvefsi.case.table import Table
from valvefsi.types import Unchecked

EXAMPLE: dict[str, Any] = {
    "title": "compressed block in a box of fluid",
    "grid": {"lower": ["0 cm", "0 cm"], "upper": ["40 cm", "40 cm"], "cells": [64, 64]},
    "fluid": {"sides": {name: {"velocity": [0, 0]} for name in SIDES[:4]}},
    "time": {"dt_per_h": "0.001 s/cm", "t_end": "30 s"},
    "output": {
        "section": [{"name": "middle", "axis": "x", "position": "20 cm"}],
        "force": [{"name": "on_block", "body": ["block"]}],
        "line": [{"name": "across", "start": ["20 cm", "0 cm"], "end": ["20 cm", "40 cm"]}],
    },
    "circuit": [
        {
            "name": "outlet",
            "model": "downstream",
            "R_c": "0.0576 mmHg*s/ml",
            "R_p": "0.887 mmHg*s/ml",
            "C": "2.43 ml/mmHg",
            "start": {"p_wk": "80 mmHg"},
        }
    ],
    "solid": [
        {
            "name": "block",
            "damping": "4 dyn*s/cm^4",
            "mesh": {
                "shape": "compressed_block",
                "lower": ["10 cm", "15 cm"],
                "size": ["20 cm", "10 cm"],
                "elements": [32, 16],
                "cell": "quadrilateral",
                "load_width": "10 cm",
            },
            "material": {"model": "neo_hookean", "c1": "80.194 dyn/cm^2"},
            "fibre": [{"name": "along_x", "rule": "constant", "direction": [1, 0]}],
            "tether": [{"on": ["bottom"], "components": ["y"], "stiffness": "1e5 dyn/cm^3"}],
            "load": [{"on": ["top_loaded"], "traction": [0, "-200 dyn/cm^2"], "ramp": "12 s"}],
            "probe": [{"name": "top_centre", "at": ["20 cm", "25 cm"]}],
        }
    ],
}
"""The case that `case_defaults` prints; what it leaves out has its default."""


def to_dict(case: Case) -> dict[str, Any]:
    """Return a case as plain tables of CGS numbers, without keys that hold nothing."""
    return _prune(case.model_dump(mode="json"))


def to_toml(case: Case) -> str:
    """Return a case as TOML that reads back as the same case, every number with its unit."""
    return "\n".join(_table(case, (), comments=False)).strip() + "\n"


def case_defaults() -> str:
    """Return a whole case as commented TOML: every key with its description, unit and default."""
    head = [
        "# A case of valvefsi. Numbers may carry any unit of the right dimension; plain numbers are CGS.",
        "# Keys that are commented out are alternatives or have a value worked out from others.",
        "",
    ]
    return "\n".join([*head, *_table(Case.model_validate(EXAMPLE), (), comments=True)]).strip() + "\n"


def _prune(value: Any) -> Any:
    """Leave out None, except that nu_stab = None is "off"."""
    if isinstance(value, dict):
        named = {k: "off" if k == "nu_stab" and v is None else v for k, v in value.items()}
        return {k: _prune(v) for k, v in named.items() if v is not None}
    return [_prune(item) for item in value] if isinstance(value, list) else value


def _table(table: Table, path: tuple[str, ...], *, comments: bool) -> list[str]:
    """Return the lines of a table: its values first, then the tables in it."""
    lines, inner = [], []
    for key, field in type(table).model_fields.items():
        value = getattr(table, key)
        if isinstance(value, Table):
            if key not in SIDES or key in table.model_fields_set:
                inner += _section(value, (*path, key), "[{}]", comments)
        elif isinstance(value, tuple) and value and isinstance(value[0], Table):
            for item in value:
                inner += _section(item, (*path, key), "[[{}]]", comments)
        elif comments and value is None and (kind := _table_of(field)) is not None:
            default = kind()
            inner += [_commented(line) for line in _section(default, (*path, key), "[{}]", comments)]
        elif comments or value not in (None, (), {}) or key == "nu_stab":
            lines += [_comment(table, key, field)] if comments else []
            lines.append(_line(table, key, field, value))
    if isinstance(table, Material | CircuitTable):
        for key, value in table.parameters.items():
            unit = f" [{table.unit(key)}]" if table.unit(key) else ""
            lines += [f"# Parameter of {table.model}{unit}"] if comments else []
            lines.append(f"{key} = {_text(value, table.unit(key))}")
    return lines + inner


def _table_of(field: FieldInfo) -> type[Table] | None:
    """Return the kind of table that an optional field holds, None where it holds no table."""
    kinds = [k for k in get_args(field.annotation) if isinstance(k, type) and issubclass(k, Table)]
    return kinds[0] if kinds else None


def _commented(line: str) -> str:
    return line if not line or line.startswith("#") else f"# {line}"


def _section(table: Table, path: tuple[str, ...], heading: str, comments: bool) -> list[str]:
    """Return the lines of a table with its heading."""
    about = [f"# {(type(table).__doc__ or '').splitlines()[0]}"] if comments else []
    return ["", *about, heading.format(".".join(path)), *_table(table, path, comments=comments)]


def _line(table: Table, key: str, field: FieldInfo, value: Unchecked) -> str:
    if value is None and key == "nu_stab":
        return 'nu_stab = "off"'
    if value is None:
        return f"# {key} = {_text((field.examples or [''])[0], None)}"
    if isinstance(table, CircuitTable) and key == "start":
        value = {name: Quantity(UNITS[name[0]]).text(x) for name, x in table.start.items()}
    return f"{key} = {_text(value, table.unit(key))}"


def _comment(table: Table, key: str, field: FieldInfo) -> str:
    unit = table.unit(key)
    default = "required" if field.is_required() else f"default {_text(field.default, unit)}"
    unit = f" [{unit}]" if unit and "[" not in str(field.description) else ""
    return (
        f"# {field.description}{unit}; {default}"
        if field.default is not None
        else f"# {field.description}{unit}"
    )


def _text(value: Unchecked, unit: str | None) -> str:
    """Return a value as TOML, a quantity with its unit."""
    if isinstance(value, dict):
        return f"{{{', '.join(f'{json.dumps(k)} = {_text(v, unit)}' for k, v in value.items())}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(_text(item, unit) for item in value)}]"
    if unit is not None and isinstance(value, float):
        return json.dumps(Quantity(unit).text(value))
    return json.dumps(value)
