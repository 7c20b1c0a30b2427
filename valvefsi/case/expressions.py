"""Expressions in case files: numbers, x, y, z, t, columns of a table, and the usual functions; nothing else.

An expression is parsed by Python's own parser and walked; what is not arithmetic is refused, so that a case file
cannot run code.
"""

from __future__ import annotations

import ast
import operator
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np

from valvefsi.case.overrides import nearest
from valvefsi.errors import CaseError

Array = np.ndarray

OPERATORS: dict[type, Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
    ast.Mod: operator.mod,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}
COMPARISONS: dict[type, Callable[..., Any]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}
FUNCTIONS: dict[str, Callable[..., Any]] = {
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "exp": np.exp,
    "log": np.log,
    "sqrt": np.sqrt,
    "abs": np.abs,
    "tanh": np.tanh,
    "min": np.minimum,
    "max": np.maximum,
    "where": np.where,
}
VALUES = {"min": 2, "max": 2, "where": 3}
"""How many values a function takes, if not one."""
CONSTANTS: dict[str, Array | float] = {"pi": np.pi}
LONGEST, DEEPEST, LARGEST, SHOWN = 2000, 100, 1e300, 40
"""Characters, nested operations, the size of a number that an expression may have; characters shown of it."""
COORDINATES = ("x", "y", "z", "t")


@dataclass(frozen=True)
class Expression:
    """A function of x, y, z [cm] and t [s], and of columns of a table at t.

    Args:
        text: The expression, in CGS numbers.
        names: Names it may use besides x, y, z, t and pi.

    Raises:
        ValueError: It is not an expression, or uses something that is not known.
    """

    text: str
    names: tuple[str, ...] = ()
    _tree: ast.AST = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Check every part of it."""
        if len(self.text) > LONGEST:
            raise ValueError(f"an expression has at most {LONGEST} characters")
        try:
            tree = ast.parse(text := self.text.strip(), mode="eval")
        except SyntaxError as error:
            unit = re.search(r"\d\s*[A-Za-z%]", self.text)
            hint = "; a number in it has no unit, it is in CGS" if unit else ""
            raise ValueError(f"not an expression: {error.msg}{hint}") from None
        except (ValueError, RecursionError, MemoryError):  # what Python's parser makes of zeros and of depth
            raise ValueError("not an expression") from None
        known = (*COORDINATES, *CONSTANTS, *self.names)
        _check(tree.body, known, text)
        object.__setattr__(self, "_tree", tree.body)

    def __call__(self, values: Mapping[str, Array | float]) -> Array | float:
        """Return its value.

        Args:
            values: Value of every name.
        """
        known = {name: np.asarray(value, dtype=float) for name, value in {**CONSTANTS, **values}.items()}
        with np.errstate(all="ignore"):  # who asks looks at the value
            return _value(self._tree, known)


def _check(node: ast.AST, known: Collection[str], text: str, depth: int = 0) -> None:
    if depth > DEEPEST:
        raise ValueError("nested too deeply")
    if (
        isinstance(node, ast.Constant)
        and isinstance(node.value, int | float)
        and not isinstance(node.value, bool)
    ):
        if not abs(node.value) < LARGEST:
            raise ValueError("a number is not finite")
        return
    if isinstance(node, ast.Name):
        if node.id in FUNCTIONS:
            raise ValueError(f"{node.id} is a function, write what of in parentheses: {_example(node.id)}")
        if node.id not in known:
            raise ValueError(f"unknown name {node.id!r}{nearest(node.id, [*known, *FUNCTIONS])}")
        return
    if isinstance(node, ast.BinOp | ast.UnaryOp) and type(node.op) in OPERATORS:
        parts = [node.left, node.right] if isinstance(node, ast.BinOp) else [node.operand]
    elif isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in COMPARISONS:
        parts = [node.left, *node.comparators]
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        if node.func.id not in FUNCTIONS:
            raise ValueError(f"unknown function {node.func.id!r}{nearest(node.func.id, list(FUNCTIONS))}")
        parts = node.args
        wanted = VALUES.get(node.func.id, 1)
        if len(parts) != wanted:
            raise ValueError(f"{node.func.id} takes {wanted} value{'s' * (wanted > 1)}, found {len(parts)}")
    else:
        raise ValueError(f"{_shown(node, text)} is not arithmetic")
    for part in parts:
        _check(part, known, text, depth + 1)


def _example(function: str) -> str:
    return f"{function}({', '.join('xyz'[: VALUES.get(function, 1)])})"


def _shown(node: ast.AST, text: str) -> str:
    """Return a part of an expression as it is written, with what it is."""
    text = ast.get_source_segment(text, node) or text
    kind = "a text in quotes" if isinstance(node, ast.Constant) and isinstance(node.value, str) else ""
    return f"{text if len(text) <= SHOWN else f'{text[:SHOWN]} ...'}{f', {kind},' if kind else ''}"


def _value(node: ast.AST, values: Mapping[str, Array | float]) -> Any:
    match node:
        case ast.Constant():
            return np.float64(cast(float, node.value))  # not Python's: that one raises, or turns complex
        case ast.Name():
            return values[node.id]
        case ast.BinOp():
            return OPERATORS[type(node.op)](_value(node.left, values), _value(node.right, values))
        case ast.UnaryOp():
            return OPERATORS[type(node.op)](_value(node.operand, values))
        case ast.Compare():
            compare = COMPARISONS[type(node.ops[0])]
            return compare(_value(node.left, values), _value(node.comparators[0], values))
        case ast.Call(func=ast.Name(id=name)):
            return FUNCTIONS[name](*[_value(part, values) for part in node.args])
    raise TypeError(f"{type(node).__name__} was not checked")


@dataclass(frozen=True)
class TimeTable:
    """Columns over time from a CSV file, linear between its rows and constant beyond.

    Attributes:
        t: Times, ``(n,)`` [s].
        columns: Values by the name of the column, ``(n,)`` each.
    """

    t: Array
    columns: dict[str, Array]

    def at(self, t: float) -> dict[str, float]:
        """Return every column at a time."""
        return {name: float(np.interp(t, self.t, values)) for name, values in self.columns.items()}


def read_table(path: Path) -> TimeTable:
    """Read a table whose first column is ``t_s``.

    Raises:
        CaseError: The file is missing, has no ``t_s`` first, an entry is no finite number, or times do not increase.
    """
    try:
        lines = [line for line in path.read_text().splitlines() if line.strip() and not line.startswith("#")]
    except (OSError, UnicodeDecodeError) as error:
        raise CaseError(f"cannot be read: {error.__class__.__name__}", file=path) from None
    names = [name.strip() for name in lines[0].split(",")] if lines else []
    if len(names) < 2 or names[0] != "t_s":
        raise CaseError("expected a header that begins with t_s and names one more column", file=path)
    rows = []
    for number, line in enumerate(lines[1:], start=2):
        try:
            row = [float(entry) for entry in line.split(",")]
        except ValueError:
            row = []
        if len(row) != len(names) or not np.all(np.isfinite(row)):
            raise CaseError(f"row {number}: expected {len(names)} finite numbers", file=path, value=line)
        rows.append(row)
    if len(rows) < 2:
        raise CaseError("expected at least two rows", file=path)
    table = np.array(rows)
    if not np.all(np.diff(table[:, 0]) > 0.0):
        at = int(np.argmax(np.diff(table[:, 0]) <= 0.0)) + 1
        raise CaseError(f"row {at + 2}: times must increase", file=path, key="t_s", value=table[at, 0])
    return TimeTable(table[:, 0], {name: table[:, k] for k, name in enumerate(names) if k > 0})
