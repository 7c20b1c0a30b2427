"""Many runs of one case: members, their processes, what they leave."""

from valvefsi.studies.members import Member, Outcome, read_cases
from valvefsi.studies.runner import Tally, run_members

__all__ = ["Member", "Outcome", "Tally", "read_cases", "run_members"]
