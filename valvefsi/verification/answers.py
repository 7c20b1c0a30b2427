"""Which numbers of a run may be asked for an order of accuracy, and what beats that repeat leave of the first ones.

An order is that of an error that falls with a power of the spacing. A displacement, a flow or a pressure has one. The
time at which a curve is largest jumps from row to row of a history; a maximum over all points of a solid follows one
element, and has no limit where a corner makes stress unbounded; flutter is an instability.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

EVENT = "a time of an event, read off rows of a history or frames: it jumps between them"
FLUTTER = "flutter, an instability: a spectrum over a few periods"
EXTREME = "an extreme over all points: it follows one element, and may have no limit"
METHOD = "a number of the method, not of the flow"
REPEAT = "how far beats repeat, an iteration and no answer"
_WHY = (
    (re.compile(r"(^|.*\.)flutter(\..*)?"), FLUTTER),
    (re.compile(r".*change_between_cycles.*"), REPEAT),
    (re.compile(r"(^|.*[._])courant"), METHOD),
    (re.compile(r".*[._](?<!_ml_)(?<!_per_)m?s"), EVENT),
    (re.compile(r".*(_J_(min|max)|_max(_[A-Za-z]+)?(\.value)?)"), EXTREME),
)


def why_no_order(name: str) -> str:
    """Return why a number of a summary or a column of a history has no order of accuracy, "" where it may have one.

    Args:
        name: Its path or its column, the unit at the end.
    """
    return next((why for pattern, why in _WHY if pattern.fullmatch(name)), "")


def repeating_error(values: Sequence[float]) -> float | None:
    """Return the error of the last of some values that an iteration makes, from the changes d of the last ones.

        |v_limit - v_n| = |d_n| q / (1 - q),    q = |d_n / d_(n-1)|       (Ferziger and Peric 1996)

    Exact where the changes shrink by one ratio, which they do where beat follows beat in a linear circuit. Where they
    do not shrink, or there are two values, it is no less than the last change.

    Args:
        values: The same number of successive beats.

    Returns:
        The error in the unit of the values; None of one value.
    """
    if len(values) < 2:
        return None
    last = abs(values[-1] - values[-2])
    before = abs(values[-2] - values[-3]) if len(values) > 2 else 0.0
    q = last / before if before > 0.0 else 1.0
    return last * q / (1.0 - q) if q < 1.0 else last
