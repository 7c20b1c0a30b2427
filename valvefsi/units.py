"""Units: CGS inside (cm, g, s, dyn/cm^2); mmHg, ml and kPa at the borders only.

A value in one of these units times its constant is the value in CGS.
"""

from __future__ import annotations

MMHG = 1333.2236842105262
"""Millimetre of mercury (torr, 101325/760 Pa) [dyn/cm^2]."""

PASCAL = 10.0
"""Pascal [dyn/cm^2]."""

KILOPASCAL = 1.0e4
"""Kilopascal [dyn/cm^2]."""

MILLILITRE = 1.0
"""Millilitre [cm^3]."""

LITRE_PER_MINUTE = 1000.0 / 60.0
"""Litre per minute [cm^3/s]."""

CENTIPOISE = 0.01
"""Centipoise, a millipascal second [dyn s/cm^2]."""

PLAUSIBLE = {"t": 1e7, "p": 1e9, "q": 1e7, "v": 1e7, "a": 1e6}
"""Largest size of a time, pressure, flow, volume and area that a record may hold [s, dyn/cm^2, cm^3/s, cm^3, cm^2]."""


def format_time(seconds: float | None) -> str:
    """Return a duration as people say it."""
    if seconds is None:
        return "unknown time"
    if seconds < 10:
        return f"{seconds:.1f} s"
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes, seconds = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {seconds:02d} s"
    return f"{minutes // 60} h {minutes % 60:02d} min"
