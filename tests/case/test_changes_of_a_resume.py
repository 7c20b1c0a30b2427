"""What a resume says of a case that has changed in several places."""

from __future__ import annotations

import pytest
from mpi4py import MPI

from tests.case.test_resuming import broken_off, case_with
from valvefsi.case.build import run_case
from valvefsi.errors import CaseError

pytestmark = pytest.mark.serial
SELF = MPI.COMM_SELF


def test_every_change_is_named_before_it_is_allowed(tmp_path):
    out = broken_off(tmp_path / "run")
    changed = case_with("time.dt='1 ms'", "fluid.viscosity='20 cP'")
    both = "fluid.viscosity: .* was 10 cP, it is 20 cP; time.dt was 2 ms, it is 1 ms; --allow-change"
    other = "time.dt: .* was 2 ms, it is 1 ms; fluid.viscosity was 10 cP, it is 20 cP; --allow-change"
    with pytest.raises(CaseError, match=f"{both}|{other}"):
        run_case(changed, out=out, resume=True, comm=SELF)
