"""The members of a study of grids: a case on several grids, and one of them with one thing changed at a time.

The base on other numbers of ranks is one of these changes.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from valvefsi.case.models import Case
from valvefsi.errors import CaseError
from valvefsi.studies.members import Member, read_cases
from valvefsi.studies.sweep import make_sweep

RECOMMENDED = 1.3
"""Refinement between two grids from which an order can be told from noise (Celik et al. 2008)."""
AND = " & "
"""Between the keys of one change."""
IMMERSED, FLUID = 1.0, 2.0
"""Expected order with bodies in the flow, where a regularised delta function spreads their surface, and without."""


@dataclass(frozen=True, kw_only=True)
class GridStudy:
    """What is run.

    Attributes:
        grids: The member of each grid, coarse to fine.
        spacings: Their spacings h [cm].
        base: The member that the following change.
        steps: Members of smaller time steps by their factor, largest first.
        changes: Members of other changes by what they change; another number of ranks is ``ranks=N``.
        cases: The case of every member by its name.
        expected: Expected order of accuracy.
    """

    grids: tuple[Member, ...]
    spacings: tuple[float, ...]
    base: Member
    steps: Mapping[float, Member]
    changes: Mapping[str, Member]
    cases: Mapping[str, Case]
    expected: float

    @property
    def members(self) -> tuple[Member, ...]:
        """All members, the cheapest grids first."""
        return (*self.grids, *self.steps.values(), *self.changes.values())

    def notes(self) -> list[str]:
        """Return what a reader must know of the members."""
        few = too_few(len(self.grids), self.expected)
        steps = [self.cases[member.name].dt for member in self.grids]
        same = max(steps) - min(steps) <= 1e-9 * max(steps)
        said = [
            f"the time step is {steps[0]:.4g} s on all grids: orders are of the spacing alone"
            if same
            else f"the time step goes from {steps[0]:.4g} to {steps[-1]:.4g} s with the spacing: orders are of both"
        ]
        ratios = [a / b for a, b in itertools.pairwise(self.spacings)]
        if ratios and min(ratios) < RECOMMENDED:
            said.append(
                f"grids are refined by {min(ratios):.3g} only; {RECOMMENDED:g} or more is recommended (Celik et al. "
                "2008): small differences carry other errors, and orders scatter"
            )
        bodies = "bodies are in the flow" if self.expected == IMMERSED else "order of the method"
        said.append(f"expected order {self.expected:g} ({bodies}; --order says another)")
        return [*few, *said]


def too_few(grids: int, expected: float) -> list[str]:
    """Return what so few grids cannot say, nothing where there are three or more.

    Args:
        grids: How many there are.
        expected: Expected order of accuracy.
    """
    if grids >= 3:
        return []
    if grids == 2:
        return [
            "TWO GRIDS: no observed order, no Richardson value and no grid convergence index can be had, which take "
            f"three; uncertainties suppose order {expected:g} and have a factor of 3 (Roache 1994)"
        ]
    return ["ONE GRID: nothing is said of the spacing, which takes three grids"]


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """What a study of grids is asked for.

    Attributes:
        grids: Spacings, as ``1mm,0.8mm,0.625mm``, coarse to fine.
        along: Texts ``key=value,value,...``, a value for each grid.
        steps: Factors of the time step, below one; 1 may be among them.
        also: Texts ``key=value,...``: changes of the base, each alone; ``a=1 & b=2`` is one change of two keys.
        ranks: Numbers of ranks that the base is run on again.
        base: The grid of the changes and of the smaller steps, as it stands in ``grids``; the finest unless given.
        overrides: Texts ``key=value`` that all members take.
        order: Expected order; from whether bodies are in the flow unless given.
    """

    grids: str
    along: Sequence[str] = ()
    steps: Sequence[float] = ()
    also: Sequence[str] = ()
    ranks: Sequence[int] = ()
    base: str | None = None
    overrides: Sequence[str] = ()
    order: float | None = None


def make_grid_study(case: Path, wanted: Wanted, *, trust: bool = False) -> GridStudy:
    """Return the study of a case on several grids.

    Args:
        case: The case file.
        wanted: What is asked for.
        trust: Whether Python files of materials may be run.

    Raises:
        CaseError: A text cannot be read, or a member's case is wrong: says which.
    """
    spaced = make_sweep([f"grid.h={wanted.grids}"], wanted.overrides)
    members = _with(spaced.members, wanted.along)
    cases = read_cases(case, members, trust=trust)
    spacings = tuple(cases[member.name].grid.spacing for member in members)
    if any(a <= b for a, b in itertools.pairwise(spacings)):
        shown = ", ".join(f"{10 * h:.4g} mm" for h in spacings)
        raise CaseError(
            f"expected spacings from coarse to fine, found {shown}", key="--grids", value=wanted.grids
        )
    names = [value.replace(" ", "") for value in spaced.parameters[0].values]
    base = names[-1] if wanted.base is None else wanted.base.replace(" ", "")
    if base not in names:
        raise CaseError(f"expected one of the grids {', '.join(names)}", key="--base", value=wanted.base)
    chosen = members[names.index(base)]
    smaller = {factor: _step(chosen, cases[chosen.name], factor) for factor in _factors(wanted.steps)}
    changes = {
        AND.join(change.overrides): Member(
            f"{chosen.name},{change.name}", (*chosen.overrides, *change.overrides)
        )
        for text in wanted.also
        for change in make_sweep(text.split(AND)).members
    } | {
        f"ranks={ranks}": Member(f"{chosen.name},ranks={ranks}", chosen.overrides, ranks)
        for ranks in _ranks(wanted.ranks)
    }
    found = cases[chosen.name]
    immersed = bool(found.solid) or found.housing is not None
    return GridStudy(
        grids=members,
        spacings=spacings,
        base=chosen,
        steps=smaller,
        changes=changes,
        cases=cases | read_cases(case, [*smaller.values(), *changes.values()], trust=trust),
        expected=wanted.order if wanted.order is not None else IMMERSED if immersed else FLUID,
    )


def _with(members: Sequence[Member], along: Sequence[str]) -> tuple[Member, ...]:
    """Return the members of the grids with what changes along with them."""
    for text in along:
        (parameter,) = make_sweep([text]).parameters
        if len(parameter.values) != len(members):
            raise CaseError(
                f"expected a value for each of {len(members)} grids, found {len(parameter.values)}",
                file="--along",
                key=parameter.key,
            )
        members = [
            Member(member.name, (*member.overrides, f"{parameter.key}={value}"))
            for member, value in zip(members, parameter.values, strict=True)
        ]
    return tuple(members)


def _factors(steps: Sequence[float]) -> list[float]:
    """Return the factors of smaller steps, largest first."""
    wrong = [factor for factor in steps if not 0.0 < factor <= 1.0]
    if wrong:
        raise CaseError("expected factors above 0, 1 at most", key="--steps", value=wrong[0])
    return sorted({factor for factor in steps if factor < 1.0}, reverse=True)


def _ranks(ranks: Sequence[int]) -> list[int]:
    """Return the numbers of ranks beside the base's one."""
    wrong = [number for number in ranks if number < 1]
    if wrong:
        raise CaseError("expected whole numbers above 0", key="--ranks", value=wrong[0])
    return sorted({number for number in ranks if number > 1})


def _step(base: Member, case: Case, factor: float) -> Member:
    """Return the base with a smaller step; adaptive steps keep to a smaller Courant number, too."""
    changes = [f"time.dt={case.dt * factor!r} s"]
    if case.time.control == "adaptive":
        changes.append(f"time.cfl={case.time.cfl * factor!r}")
    return Member(f"{base.name},dt={factor:g}x", (*base.overrides, *changes))
