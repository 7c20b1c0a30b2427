"""The file of a study of uncertain inputs as typed tables: what is uncertain, how it is sampled, what comes out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, PrivateAttr, model_validator
from pydantic_core import PydanticCustomError

from valvefsi.case.quantities import NUMBER, Quantity
from valvefsi.case.statics_tables import StaticsModel
from valvefsi.case.study_files import read_study
from valvefsi.case.study_tables import Area, Inertance
from valvefsi.case.table import Name, Table, problem

Amount = str | float
"""A number, or one with a unit."""
NEEDED = {"normal": ("mean", "std"), "lognormal": ("mean", "std"), "uniform": ("low", "high")}
"""What each distribution is given by."""


def amount(value: Amount, unit: str | None = None) -> tuple[float, str]:
    """Return a number and its unit, "" for a pure number.

    Args:
        value: The number, or a text of number and unit.
        unit: The unit that is wanted; its own unless given.

    Raises:
        PydanticCustomError: It is no such number, or its unit measures something else.
    """
    match = NUMBER.fullmatch(value) if isinstance(value, str) else None
    own = match[2] if match is not None else ""
    if not own:
        if isinstance(value, str):
            raise PydanticCustomError("quantity", "expected a number, or a number and its unit")
        return float(value), unit or ""
    wanted = own if unit is None else unit
    return Quantity(wanted or "1").parse(value), wanted


class UncertainInput(Table):
    """An input with a distribution, independent of the others."""

    name: Name = Field(description="What it is called in tables and pictures")
    key: str = Field(
        description="Key of the case, as --set names it; orifice.area and orifice.inertance with the circuit alone, "
        "statics.pressure and the like with statics",
        examples=["circuit.aorta.C"],
    )
    distribution: Literal["normal", "lognormal", "uniform"] = Field(description="Its distribution")
    mean: Amount | None = Field(None, description="normal, lognormal: mean", examples=["2.4 ml/mmHg"])
    std: Amount | None = Field(
        None, description="normal, lognormal: standard deviation, not of the logarithm"
    )
    low: Amount | None = Field(None, description="uniform: lower end")
    high: Amount | None = Field(None, description="uniform: upper end")

    @model_validator(mode="after")
    def _check(self) -> Self:
        needed = NEEDED[self.distribution]
        for key in ("mean", "std", "low", "high"):
            if (getattr(self, key) is None) == (key in needed):
                message = f"a {self.distribution} distribution is given by {' and '.join(needed)}"
                raise problem(message, key, getattr(self, key))
        first, second, _ = self.numbers()
        if self.distribution == "uniform" and not first < second:
            raise problem("expected low below high", "high", self.high)
        if self.distribution != "uniform" and not second > 0.0:
            raise problem("expected a number above 0", "std", self.std)
        if self.distribution == "lognormal" and not first > 0.0:
            raise problem("expected a number above 0", "mean", self.mean)
        return self

    def numbers(self) -> tuple[float, float, str]:
        """Return the two numbers of the distribution, in the unit of the first, and that unit."""
        first, second = (getattr(self, key) for key in NEEDED[self.distribution])
        number, unit = amount(first)
        return number, amount(second, unit)[0], unit


class FittedInputs(Table):
    """Inputs from what a fit left: ``fit.json`` of `valvefsi fit`, or a table of samples."""

    name: Name = Field(description="What they are called together")
    file: str = Field(description="fit.json, or a CSV file of samples with a column for each parameter")
    keys: dict[str, str] = Field(
        description="Key of the case for each parameter of the fit", examples=[{"C": "circuit.aorta.C"}]
    )
    take: Literal["covariance", "profile", "samples"] = Field(
        "profile",
        description="profile: medians and 95 % intervals are those of the profile likelihoods, correlation that of the "
        "covariance; covariance: all from the covariance; samples: rows of the table, each as likely",
    )
    units: dict[str, str] = Field({}, description="samples only: unit of each column")
    joint: bool = Field(
        True,
        description="Keep correlations; indices are then those of all together. false takes each alone, and is refused "
        "where two are correlated by more than 0.3",
    )


class Design(Table):
    """Which samples are taken, and what is made of them."""

    method: Literal["sobol", "latin-hypercube"] = Field(
        "latin-hypercube",
        description="sobol: Saltelli's design, size times (groups + 2) runs, indices from the runs themselves; "
        "latin-hypercube: size runs and a polynomial chaos, whose leave-one-out error is said",
    )
    size: int = Field(64, ge=4, le=2**20, description="See method; a power of two for sobol")
    degree: int = Field(
        3, ge=1, le=8, description="latin-hypercube: largest degree of the polynomials that is tried"
    )
    seed: int = Field(0, ge=0, description="Seed of the samples")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.method == "sobol" and self.size & (self.size - 1):
            raise problem(
                "expected a power of two, which a Sobol sequence is balanced for", "size", self.size
            )
        return self


class OrificeModel(Table):
    """The orifice in place of the valve, and how its loop is run to its periodic state."""

    area: Annotated[Area, Field(gt=0, description="Effective orifice area", examples=["2.4 cm^2"])]
    inertance: Annotated[Inertance, Field(gt=0, description="Inertance", examples=["0.001 mmHg*s^2/ml"])]
    steps: int = Field(1000, ge=50, description="Steps of a beat")
    max_beats: int = Field(
        60, ge=2, description="Beats after which a sample that is not periodic counts as failed"
    )
    tolerance: float = Field(
        1e-4,
        gt=0,
        lt=1,
        description="Change of pressures and flow over a beat, over their range, that counts as none",
    )


class SampleStudy(Table):
    """Uncertain inputs, carried through a model to its outputs."""

    title: str = Field("", description="What this study is")
    case: str = Field(
        description="The case; with the circuit alone its two circuits and its density are used"
    )
    changes: tuple[str, ...] = Field((), description="Changes of the case, as --set takes them for a run")
    target: Literal["circuit", "statics", "case"] = Field(
        "case",
        description="case: a run for every sample; circuit: the flow loop with an orifice, all samples at once; "
        "statics: a solid of the case, such as a leaflet, in equilibrium under a pressure",
    )
    outputs: tuple[str, ...] = Field(
        (), description="Names of the outputs, or ends of them; the first few that vary when left out"
    )
    design: Design = Field(Design(), description="Samples")
    input: tuple[UncertainInput, ...] = Field((), description="Inputs with distributions")
    fit: tuple[FittedInputs, ...] = Field((), description="Inputs from fits")
    orifice: OrificeModel | None = Field(None, description="Orifice, needed with the circuit alone")
    statics: StaticsModel | None = Field(None, description="What is in equilibrium, needed with statics")
    _file: Path | None = PrivateAttr(None)

    @model_validator(mode="after")
    def _check(self) -> Self:
        if not self.input and not self.fit:
            raise problem("expected inputs: [[input]] with distributions, [[fit]] from fits", "input", [])
        if (self.orifice is None) == (self.target == "circuit"):
            raise problem(
                f"an orifice is needed with the circuit alone, target is {self.target!r}", "orifice"
            )
        if (self.statics is None) == (self.target == "statics"):
            raise problem(f"this table is needed with statics, target is {self.target!r}", "statics")
        names = [one.name for one in self.input] + [one.name for one in self.fit]
        keys = [one.key for one in self.input] + [key for one in self.fit for key in one.keys.values()]
        for what, found in (("name", names), ("key", keys)):
            twice = next((one for k, one in enumerate(found) if one in found[:k]), None)
            if twice is not None:
                raise problem(f"two inputs have this {what}", what, twice)
        return self

    @property
    def file(self) -> Path | None:
        """The file it was read from."""
        return self._file


def load_samples(path: str | Path, overrides: Sequence[str] = ()) -> SampleStudy:
    """Read a study of uncertain inputs; the paths of its files become absolute.

    Args:
        path: The TOML file.
        overrides: Texts ``a.b=value`` that replace or add values.

    Raises:
        CaseError: One line with file, key, value and the nearest valid choice.
    """
    study = read_study(Path(path), overrides, SampleStudy, (("", "case"), ("fit", "file")))
    study._file = Path(path)
    return study
