"""What is looked at during a run and warned of once: fluid that leaks between points that have moved too far apart."""

from __future__ import annotations

import warnings

from valvefsi.fsi import Model, State

LONGEST_GAP = 1.25
"""Largest distance of neighbouring nodes over h that is held to be tight.

At 1, 1.2, 1.5 and 2.4 h a plug two cells thick in a channel passes 0.20, 0.72, 2.6 and 15 times what slots of width h
would (piecewise_linear; bspline3: 0.10, 0.68, 1.6, 9.8; ib4: 0.27, 0.31, 0.52, 2.8). Quadratic elements leak as linear
ones with nodes at the same places, within some per cent. The leak follows the pressure difference: a body that is
merely carried along keeps its volume with nodes further apart, as a soft disk in a cavity does.
"""


def widest_gap(solid: object, coupling: object, chi: object) -> float:
    """Return the largest distance between neighbouring points of a solid at chi [cm] (collective).

    The points are the nodes, or for elemental coupling those that are refined until no gap is larger than allowed.
    """
    gap = solid.longest_gap(chi)
    return gap if coupling.nodal else min(gap, coupling.gap)


def remedy(coupling: object) -> str:
    """What to do against points too far apart."""
    return 'refine the mesh or take coupling = "elemental"' if coupling.nodal else "lower point_gap"


class Health:
    """Looks at the solids of a run, and warns once of each.

    Args:
        model: The model.

    Attributes:
        found: What was warned of: solid, time of the first warning, largest gap over h since, text.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        self.found: dict[str, dict[str, object]] = {}

    def look(self, state: State) -> None:
        """Warn on rank 0 of each solid whose points are too far apart, the first time that they are.

        Note:
            Collective. Every solid costs one pass over its edges.
        """
        grid = self.model.grid
        h = float(min(grid.spacing[: grid.dim]))
        for solid, coupling, chi in zip(self.model.solids, self.model.couplings, state.chi, strict=True):
            ratio = widest_gap(solid, coupling, chi) / h
            known = self.found.get(solid.name)
            if known is not None:
                known["largest_gap_per_h"] = max(known["largest_gap_per_h"], ratio)
            elif ratio > LONGEST_GAP:
                text = (
                    f"fluid may leak through {solid.name}: neighbouring points are {ratio:.3f} h apart at t = "
                    f"{state.t:.4g} s, at most {LONGEST_GAP:g} h is safe; {remedy(coupling)}"
                )
                self.found[solid.name] = {"t_s": state.t, "largest_gap_per_h": ratio, "text": text}
                if grid.comm.rank == 0:
                    warnings.warn(text, stacklevel=2)

    def report(self) -> list[dict[str, object]]:
        """Return what was warned of, for ``summary.json``."""
        return [{"solid": name} | found for name, found in self.found.items()]
