"""What a beat in three dimensions says of the pump that was chosen for a target, and what to change."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from valvefsi.case.models import Case
from valvefsi.case.target import Chosen, at_target, flow_at
from valvefsi.case.valve_runs import read_beats
from valvefsi.errors import CaseError
from valvefsi.post.valve_beat import Beat


@dataclass(frozen=True, kw_only=True)
class Correction:
    """A beat of a run beside the loop with an orifice, and the case corrected by it.

    Attributes:
        case: The case with the response of the valve, and what was chosen with it.
        chosen: What was chosen.
        beats: Whole beats of the run; the last one counts.
        cardiac_output: Mean flow of that beat [cm^3/s].
        mean_aortic_pressure: Mean pressure downstream in it [dyn/cm^2].
        loop_output: Mean flow of the loop under the same pump against the same mean pressure [cm^3/s].
    """

    case: Case
    chosen: Chosen
    beats: int
    cardiac_output: float
    mean_aortic_pressure: float
    loop_output: float

    @property
    def response(self) -> float:
        """Flow through the valve over that through the orifice."""
        return self.cardiac_output / self.loop_output


def correct_target(folder: Path, *, trust: bool = False) -> Correction:
    """Return the case of a run, its pump corrected by the run's last whole beat.

    The loop is run under the pump that the run had, against the beat's mean pressure, so that a beat which is not
    periodic yet is compared with what the orifice lets through against the same pressure.

    Args:
        folder: Folder of the run.
        trust: Whether Python files of materials may be run.

    Raises:
        CaseError: There is no run with a target and a whole beat, its flow is backward, or the target is not reached.
    """
    case, beats = read_beats(folder, trust=trust)
    if case.target is None:
        raise CaseError("the run has no target", file=Path(folder) / "case.toml", key="target")
    last = beats[-1]
    q, p = (_mean(last, name) for name in ("q_ao", "p_ao"))
    loop = flow_at(case, p, q) if q > 0.0 else 0.0
    if q <= 0.0 or loop <= 0.0:
        where = f"in the beat from t = {last.start:.4g} s on"
        reason = f"{where} the mean flow is {q:.4g} ml/s, in the loop {loop:.4g} ml/s; expected forward flow"
        raise CaseError(reason, file=Path(folder) / "history.csv")
    target = case.target.model_copy(update={"response": q / loop})
    new, chosen = at_target(case.model_copy(update={"target": target}))
    assert chosen is not None  # it has a target
    return Correction(
        case=new,
        chosen=chosen,
        beats=len(beats),
        cardiac_output=q,
        mean_aortic_pressure=p,
        loop_output=loop,
    )


def _mean(beat: Beat, name: str) -> float:
    return float(np.trapezoid(beat.at(name, beat.grid), beat.grid) / beat.period)
