"""Rules that follow from the table of the kernel study: at which ratios of mesh to grid a kernel can be used."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from valvefsi.benchmarks.frame import Record


@dataclass(frozen=True, kw_only=True)
class Rule:
    """What the table says about one kernel, coupling and stabilisation.

    Attributes:
        kernel: Name of the kernel.
        coupling: "nodal", "elemental" or "lumped".
        stabilised: Whether there is a volumetric energy.
        ratios: Ratios at which every problem is sound and its error within the factor of the best.
        fits: The same for each problem alone.
        best: Ratio whose largest error, in multiples of the best on each problem, is smallest; None where
            no ratio is sound on every problem.
        multiple: That largest error, in multiples of the best.
        errors: Magnitude of the error at that ratio by problem [%].
        change: Largest change of area of the loaded bodies at that ratio [%].
        why: Where no ratio is sound, what went wrong.
    """

    kernel: str
    coupling: str
    stabilised: bool
    ratios: tuple[float, ...]
    fits: Mapping[str, tuple[float, ...]]
    best: float | None
    multiple: float | None
    errors: Mapping[str, float]
    change: float | None
    why: str = ""

    @property
    def name(self) -> str:
        """Kernel, coupling and stabilisation."""
        return f"{self.kernel}, {self.coupling}, {'stabilised' if self.stabilised else 'not stabilised'}"

    @property
    def span(self) -> str:
        """The ratios in words."""
        return ", ".join(f"{ratio:g}" for ratio in self.ratios)

    @property
    def text(self) -> str:
        """The best ratio and the errors there, or why there is none."""
        if self.best is None:
            return self.why
        errors = ", ".join(f"{problem} {error:.2g} %" for problem, error in self.errors.items())
        return f"best {self.best:g}: {errors}"


def sound(line: Record) -> bool:
    """Whether a run neither broke down nor leaks."""
    return line["failed"] is None and not line["leaks"]


def rules(
    lines: Sequence[Record], *, floors: Mapping[str, float], factor: float, free: Collection[str] = ()
) -> list[Rule]:
    """Return the rule of each kernel, coupling and stabilisation, the best choice first.

    The error of a run counts in multiples of the smallest one of all sound runs of its problem, or of the floor where
    that is larger.

    Args:
        lines: The lines of the table.
        floors: Error by problem below which runs count as equally good [%].
        factor: Largest multiple that a recommended ratio may have on any problem.
        free: Problems that no stabilisation acts on; they count for both kinds.
    """
    best = _best(lines, floors)
    names = dict.fromkeys((line["kernel"], line["coupling"]) for line in lines)
    kinds = sorted({line["stabilised"] for line in lines if line["problem"] not in free}, reverse=True)

    def meant(line: Record, kernel: str, coupling: str, kind: bool) -> bool:
        same = (line["kernel"], line["coupling"]) == (kernel, coupling)
        return same and (line["stabilised"] == kind or line["problem"] in free)

    table = [
        _rule(kernel, coupling, kind, [r for r in lines if meant(r, kernel, coupling, kind)], best, factor)
        for kernel, coupling in names
        for kind in kinds or [False]
    ]
    return sorted(table, key=lambda rule: (rule.multiple is None, rule.multiple))


def _best(lines: Sequence[Record], floors: Mapping[str, float]) -> dict[str, float]:
    best = {}
    for problem, floor in floors.items():
        errors = [abs(r["error_percent"]) for r in lines if r["problem"] == problem and sound(r)]
        best[problem] = max(floor, min(errors, default=floor))
    return best


def _rule(
    kernel: str,
    coupling: str,
    kind: bool,
    lines: Sequence[Record],
    best: Mapping[str, float],
    factor: float,
) -> Rule:
    multiples, fits = {}, {line["problem"]: () for line in lines}
    for ratio in dict.fromkeys(line["ratio"] for line in lines):
        here = [line for line in lines if line["ratio"] == ratio]
        errors = {r["problem"]: abs(r["error_percent"]) / best[r["problem"]] for r in here if sound(r)}
        if len(errors) == len(here):
            multiples[ratio] = max(errors.values())
        fits |= {name: (*fits[name], ratio) for name, multiple in errors.items() if multiple <= factor}
    top = min(multiples, key=lambda ratio: multiples[ratio], default=None)
    here = [line for line in lines if line["ratio"] == top]
    return Rule(
        kernel=kernel,
        coupling=coupling,
        stabilised=kind,
        ratios=tuple(ratio for ratio, multiple in multiples.items() if multiple <= factor),
        fits=fits,
        best=top,
        multiple=multiples.get(top),
        errors={line["problem"]: abs(line["error_percent"]) for line in here},
        change=max((line["change_percent"] for line in here), default=None),
        why="" if multiples else _why(lines),
    )


def _why(lines: Sequence[Record]) -> str:
    broken = sorted({line["problem"] for line in lines if line["failed"] is not None})
    leaking = sorted({line["problem"] for line in lines if line["leaks"]})
    parts = [f"{word} {', '.join(names)}" for word, names in (("breaks down:", broken), ("leaks:", leaking))]
    return "; ".join(part for part, names in zip(parts, (broken, leaking), strict=True) if names)
