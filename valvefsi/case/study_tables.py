"""The file of a validation study as typed tables: the case of a valve, a measured beat, and what is fitted to it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, PrivateAttr, model_validator

from valvefsi.case.quantities import Angle, Length, Quantity, Time
from valvefsi.case.study_files import read_study
from valvefsi.case.table import Name, Table, problem

Resistance = Annotated[float, Quantity("dyn*s/cm^5")]
Compliance = Annotated[float, Quantity("cm^5/dyn")]
Inertance = Annotated[float, Quantity("g/cm^4")]
Area = Annotated[float, Quantity("cm^2")]
Waveform = Literal["p_lv", "p_ao", "q_ao", "q_ao_without_offset", "pdva"]


class BenchRecord(Table):
    """A measured beat, or several, of a valve in a pulse duplicator."""

    file: str = Field(
        description="Record with p_lv, p_ao and q_ao (pdva, standard deviations), as for compare"
    )
    period: Time | None = Field(
        None, gt=0, description="Length of a cycle; what the record says when left out", examples=["857 ms"]
    )
    start: Time | None = Field(
        None,
        ge=0,
        description="Time in the record at which a run begins; where P_LV rises over P_Ao when left out",
        examples=["80 ms"],
    )
    without_offset: bool = Field(
        False,
        description="Take the mean flow while the valve is shut off the flow that circuits are made from",
    )


class LeafletFit(Table):
    """Biaxial tests that the leaflets' material is fitted to."""

    file: str = Field(description="Record of biaxial tests, as for fit biaxial")
    solid: Name = Field("leaflets", description="Solid of the case that gets the material")
    model: str = Field("hgo", description="Material, as for fit biaxial")
    families: str = Field("1", description="Families of fibres of hgo")
    axis1: Literal["circumferential", "radial"] = Field(
        "circumferential", description="Direction of the leaflet along axis 1 of the test"
    )
    fibre_angle: Angle | None = Field(
        None, description="Angle of the fibres to axis 1; fitted when left out", examples=["0 deg"]
    )
    starts: int = Field(32, ge=1, description="Starts of the fit")


class DownstreamFit(Table):
    """The Windkessel of the outlet; values are held, what is left out is fitted to q_ao and p_ao (S9, S10)."""

    R_c: Resistance | None = Field(
        None, ge=0, description="Characteristic resistance", examples=["0.03 mmHg*s/ml"]
    )
    R_p: Resistance | None = Field(
        None, gt=0, description="Peripheral resistance", examples=["1.2 mmHg*s/ml"]
    )
    C: Compliance | None = Field(None, gt=0, description="Compliance", examples=["1 ml/mmHg"])
    draws: int = Field(50, ge=0, description="Draws of the bootstrap")
    profiles: bool = Field(True, description="Compute profile likelihoods")


class UpstreamCircuit(Table):
    """Pump and impedance adapter (S4, S5); values that are left out are those of the case."""

    R_1: Resistance | None = Field(
        None, gt=0, description="Resistance at the pump", examples=["0.1 mmHg*s/ml"]
    )
    R_2: Resistance | None = Field(
        None, ge=0, description="Resistance at the chamber", examples=["0.04 mmHg*s/ml"]
    )
    C_VIA: Compliance | None = Field(None, ge=0, description="Compliance", examples=["0.3 ml/mmHg"])
    smooth: Time = Field(
        0.02, ge=0, description="Period halved by the smoothing of p_lv and q before P_pump is derived"
    )


class OrificeTable(Table):
    """The orifice that stands in for the valve; what is left out is read off the record's forward flow."""

    area: Area | None = Field(
        None,
        gt=0,
        description="Effective orifice area; by the 51.6 formula when left out",
        examples=["2.4 cm^2"],
    )
    inertance: Inertance | None = Field(
        None,
        gt=0,
        description="Inertance; fitted to the record when left out",
        examples=["0.001 mmHg*s^2/ml"],
    )
    fit_area: bool = Field(
        False, description="Fit the area together with the inertance instead of the formula"
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.fit_area and (self.area is not None or self.inertance is not None):
            raise problem("area and inertance are fitted together; give neither", "fit_area", True)
        return self


class Targets(Table):
    """Largest differences from the record, in per cent, that count as reached."""

    l2: dict[Waveform, float] = Field({}, description="L2, relative, by waveform")
    linf: dict[Waveform, float] = Field({}, description="Linf, relative, by waveform")


class ValidationStudy(Table):
    """A valve in a flow loop against a measured beat."""

    title: str = Field("", description="What this study is")
    case: str = Field(description="Case of the valve between an upstream-porcine and a downstream circuit")
    changes: tuple[str, ...] = Field((), description="Changes of the case, as --set takes them for a run")
    grids: tuple[Length, ...] | None = Field(
        None,
        description="Spacings h of the runs, coarse to fine; the case's own when left out, no run for []",
        examples=[["1 mm", "0.53 mm"]],
    )
    ranks: int = Field(1, ge=1, le=4096, description="MPI ranks of a run")
    max_beats: int = Field(
        4, ge=2, le=100, description="Beats after which a run ends though it is not periodic"
    )
    tolerance: float = Field(
        0.02,
        gt=0,
        lt=1,
        description="Change of P_LV, P_Ao and Q between two beats, in L2, that counts as periodic",
    )
    shift_max: Time = Field(0.007, ge=0, description="Largest common shift in time that is looked for")
    record: BenchRecord = Field(description="Measured beat")
    leaflet: LeafletFit | None = Field(None, description="Fit of the material; the case's own when left out")
    downstream: DownstreamFit = Field(DownstreamFit(), description="Circuit downstream")
    upstream: UpstreamCircuit = Field(UpstreamCircuit(), description="Circuit upstream")
    orifice: OrificeTable = Field(OrificeTable(), description="Orifice in place of the valve")
    targets: Targets = Field(Targets(), description="Targets")
    _file: Path | None = PrivateAttr(None)

    @model_validator(mode="after")
    def _check(self) -> Self:
        grids = self.grids or ()
        if any(h <= 0 for h in grids) or sorted(set(grids), reverse=True) != list(grids):
            raise problem("expected positive spacings from coarse to fine", "grids", list(grids))
        return self

    @property
    def file(self) -> Path | None:
        """The file it was read from."""
        return self._file


def load_study(path: str | Path, overrides: Sequence[str] = ()) -> ValidationStudy:
    """Read a study; the paths of its files become absolute.

    Args:
        path: The TOML file.
        overrides: Texts ``a.b=value`` that replace or add values.

    Raises:
        CaseError: One line with file, key, value and the nearest valid choice.
    """
    files = (("", "case"), ("record", "file"), ("leaflet", "file"))
    study = read_study(Path(path), overrides, ValidationStudy, files)
    study._file = Path(path)
    return study
