"""Picture of plates thinner than the kernel: what they yield, and frequency and damping of their waves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from valvefsi.post.plots.immersed import Line, Panel, panels


def thin_plate(
    path: Path, records: Sequence[Mapping[str, Any]], *, title: str = "", caption: str = ""
) -> Path:
    """Draw the deflection over time, and deflection, frequency and damping over the thickness.

    Args:
        path: The picture.
        records: Those of the runs, with "kind" and "thickness".
        title: Heading.
        caption: Line under the heading.

    Returns:
        The path.
    """
    by_kind = {kind: [r for r in records if r["kind"] == kind] for kind in ("static", "wave")}
    shown: list[Panel] = []
    if by_kind["static"]:
        shown += _static(by_kind["static"])
    if by_kind["wave"]:
        shown += _waves(by_kind["wave"])
    return panels(path, shown, title=title, caption=caption, columns=2)


def _over(records: Sequence[Mapping[str, Any]], key: str, label: str, colour: int, style: str) -> Line:
    chosen = sorted((r for r in records if key in r), key=lambda r: r["thickness"])
    return Line(
        label=label,
        x=[r["thickness"] for r in chosen],
        y=[r[key] for r in chosen],
        colour=colour,
        style=style,
    )


def _static(records: Sequence[Mapping[str, Any]]) -> list[Panel]:
    time = [
        Line(label=f"{r['thickness']:g} h", x=r["history"]["t"], y=r["history"]["w"], colour=k)
        for k, r in enumerate(records)
    ]
    ratios = [
        _over(records, "over_incompressible", "over incompressible elements", 0, "o-"),
        _over(records, "over_own", "over its own elements, no fluid", 1, "s--"),
    ]
    return [
        Panel(lines=time, xlabel="time / run", ylabel="deflection / incompressible", reference=1.0),
        Panel(
            lines=ratios, xlabel="thickness / h", ylabel="deflection at rest, ratio", reference=1.0, log="x"
        ),
    ]


def _waves(records: Sequence[Mapping[str, Any]]) -> list[Panel]:
    frequency = [
        _over(records, "frequency_ratio", "computed", 0, "o-"),
        _over(records, "kernel_ratio", "theory of the kernel", 2, "^:"),
    ]
    damping = [
        _over(records, "damping", "computed", 0, "o-"),
        _over(records, "kernel_damping", "theory of the kernel", 2, "^:"),
        _over(records, "exact_damping", "exact", 3, "s--"),
    ]
    return [
        Panel(lines=frequency, xlabel="thickness / h", ylabel="frequency / exact", reference=1.0, log="x"),
        Panel(lines=damping, xlabel="thickness / h", ylabel="damping ratio of the wave", log="x"),
    ]
