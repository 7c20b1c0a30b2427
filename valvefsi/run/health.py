"""What is looked at during a run and warned of once: fluid that leaks between points that have moved too far apart."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping
from typing import Any

from valvefsi.bodies.elastic_plan import LONGEST_GAP
from valvefsi.fsi import Model, State


class Health:
    """Looks at the bodies of a run, and warns once of each.

    Args:
        model: The model.

    Attributes:
        warned: What was warned of: solid, time of the first warning, largest gap over h since, text.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        self.warned: dict[str, dict[str, Any]] = {}

    def look(self, state: State) -> None:
        """Warn on rank 0 of each body whose points are too far apart, the first time that they are.

        Note:
            Collective. Every elastic body costs one pass over its edges.
        """
        grid = self.model.grid
        h = float(min(grid.spacing[: grid.dim]))
        for body, q in zip(self.model.bodies, state.bodies, strict=True):
            ratio = body.gap(q) / h
            old = self.warned.get(body.name)
            if old is not None:
                old["largest_gap_per_h"] = max(old["largest_gap_per_h"], ratio)
            elif ratio > LONGEST_GAP:
                text = (
                    f"fluid may leak through {body.name}: neighbouring points are {ratio:.3f} h apart at t = "
                    f"{state.t:.4g} s, at most {LONGEST_GAP:g} h is safe; {body.remedy}"
                )
                self.warned[body.name] = {"t_s": state.t, "largest_gap_per_h": ratio, "text": text}
                if grid.comm.rank == 0:
                    warnings.warn(text, stacklevel=2)

    def report(self) -> list[dict[str, object]]:
        """Return what was warned of, for ``summary.json``."""
        return [{"solid": name} | warning for name, warning in self.warned.items()]

    def restore(self, report: Iterable[Mapping[str, Any]]) -> None:
        """Go on from what `report` was, so that nothing is warned of twice."""
        self.warned = {one["solid"]: {k: v for k, v in one.items() if k != "solid"} for one in report}
