"""The case file: TOML with units on one side, typed models in CGS on the other."""

from valvefsi.case.checks import check_against_mesh
from valvefsi.case.models import Case
from valvefsi.case.overrides import apply_overrides, split_override
from valvefsi.case.reading import case_schema, load_case, parse_case
from valvefsi.case.writing import case_defaults, to_dict, to_toml

__all__ = [
    "Case",
    "apply_overrides",
    "case_defaults",
    "case_schema",
    "check_against_mesh",
    "load_case",
    "parse_case",
    "split_override",
    "to_dict",
    "to_toml",
]
