"""What a planned run would take on other numbers of ranks: the fluid by the cost model, the solids in equal shares."""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI

from valvefsi.benchmarks.options import defaults
from valvefsi.benchmarks.studies import cost_model
from valvefsi.benchmarks.studies.speed import PARAMETERS, machine_here
from valvefsi.bodies.body import Entry

RANKS = (2, 64, 512)
"""Numbers of ranks that a plan is made for."""


def on_more_ranks(
    plan: Sequence[Entry], comm: MPI.Comm, *, advection: str, viscous: str, ranks: Sequence[int] = RANKS
) -> list[Entry]:
    """Return the expected time of a planned run on other numbers of ranks, none where the grid is too small.

    The fluid's part of a step grows or shrinks as the cost model says for a cube of as many cells; the network between
    machines is assumed there. The solids' part is divided by the number of ranks, and so is the memory of the fields.

    Args:
        plan: The plan on the ranks of ``comm``, of a case in three dimensions.
        comm: Communicator of the plan.
        advection: Advection scheme.
        viscous: "implicit" or "explicit".
        ranks: Numbers of ranks.

    Note:
        Collective.
    """
    value = {entry.quantity: float(entry.value) for entry in plan if not isinstance(entry.value, str)}
    step, share = value["time of a step"] * 1e-3, value["fluid's part of a step"] / 100.0
    n, steps = round(value["cells"] ** (1.0 / 3.0)), value["steps"]
    parameters = defaults(PARAMETERS) | {"advection": advection, "viscous": viscous}
    machine, network = machine_here(parameters, comm), cost_model.Network()
    solves = 4 if viscous == "implicit" else 1

    def fluid(count: int) -> float:
        work = cost_model.work(n, count, solves=solves, advection=advection)
        return cost_model.predict(work, machine, network)["step"]

    entries, here = [], fluid(comm.size)
    for count in ranks:
        try:
            each = step * (share * fluid(count) / here + (1.0 - share) * comm.size / count)
        except ValueError:  # too many ranks for the grid
            continue
        note = f"{1e3 * each:.3g} ms a step" + ("" if count == comm.size else ", predicted")
        entries.append(
            Entry(quantity=f"on {count} ranks", value=each * steps, unit="s", note=note, wall=True)
        )
    return entries
