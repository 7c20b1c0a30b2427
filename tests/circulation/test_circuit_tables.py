"""The circuit table of a case file: what a fit writes is included as it is, checked, and built."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest

from valvefsi.case import case_defaults, case_schema, load_case, parse_case, to_toml
from valvefsi.case.circuit_tables import KINDS, UNITS, say_unconnected
from valvefsi.circulation.windkessel import Downstream
from valvefsi.errors import CaseError
from valvefsi.fitting.windkessel import circuit_text
from valvefsi.fitting.windkessel_models import CIRCUITS
from valvefsi.units import MMHG

VALUES = {"R_c": 0.0576, "R_p": 0.887, "C": 2.43}
CASE = """
[grid]
lower = [0, 0]
upper = [1, 1]
cells = [8, 8]
[time]
dt = 0.01
t_end = 1.0
"""
INCLUDE = '[[circuit]]\nname = "outlet"\ninclude = "fit/circuit.toml"\n'


@pytest.fixture
def case_file(tmp_path):
    (tmp_path / "fit").mkdir()
    text = circuit_text("downstream", VALUES, {"p_wk": 80.0}, {"data": "bench.csv", "relative_l2": 0.017})
    (tmp_path / "fit" / "circuit.toml").write_text(text)
    path = tmp_path / "case.toml"
    path.write_text(CASE + INCLUDE)
    return path


def test_the_circuits_of_cases_are_those_of_the_fits():
    assert {name: model.kind for name, model in CIRCUITS.items()} == KINDS
    for model in CIRCUITS.values():
        assert all(name[0] in UNITS for name in (*model.parameters, *model.inputs))


def test_a_case_file_includes_a_fitted_circuit_as_it_is_and_builds_it(case_file):
    (table,) = load_case(case_file).circuit
    built = table.build()
    assert (built.name, built.model, built.provenance["data"]) == ("outlet", "downstream", "bench.csv")
    assert isinstance(built.circuit, Downstream)
    assert built.circuit.R_p == pytest.approx(0.887 * MMHG, rel=1e-14)
    assert pytest.approx(2.43 / MMHG, rel=1e-14) == built.circuit.C
    state, system = built.begin([100.0]), built.circuit.system()
    assert system.observe(state) == pytest.approx((80 + 5.76) * MMHG, rel=1e-12)
    later = system.advance(state, [0.0], 1e9)
    assert abs(later.x[0]) < 1e-6 * MMHG  # the flow goes to zero, so it empties


def test_a_case_with_circuits_reads_back_from_its_own_toml(case_file, tmp_path):
    case = load_case(case_file)
    again = parse_case(tomllib.loads(to_toml(case)))
    assert again.circuit == case.circuit
    with_default = parse_case(tomllib.loads(case_defaults()))
    assert with_default.circuit[0].model == "downstream"


def test_a_key_of_the_case_goes_before_the_included_one(case_file):
    case = load_case(case_file, ["circuit.outlet.R_p=1 mmHg*s/ml"])
    assert case.circuit[0].build().circuit.R_p == pytest.approx(MMHG)


def test_the_pump_is_looked_for_beside_the_file_that_names_it(case_file):
    values = {"R_1": 0.1, "R_2": 0.04, "C_VIA": 0.3}
    folder = case_file.parent / "fit"
    (folder / "circuit.toml").write_text(
        circuit_text("upstream-porcine", values, {}, {}) + '[pump]\nfile = "pump.csv"\n'
    )
    with pytest.raises(CaseError, match=r"circuit.outlet.pump.file.*no such file"):
        load_case(case_file)
    (folder / "pump.csv").write_text("t_s,p_pump_mmHg\n")
    assert load_case(case_file).circuit[0].build().pump == folder / "pump.csv"


def test_a_circuit_that_nothing_is_connected_to_is_said():
    raw = tomllib.loads(CASE) | {"circuit": [{"name": "outlet", "model": "downstream", **VALUES}]}
    case = parse_case(raw)
    with pytest.warns(UserWarning, match=r"circuit.outlet: no side of the box is connected to it"):
        say_unconnected(case.circuit, 0)
    say_unconnected(case.circuit, 1)
    say_unconnected(case.circuit, 0, ("outlet",))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"R_d": 1.0}, "circuit.outlet.R_d = 1.0: unknown parameter of downstream; did you mean"),
        ({"R_p": "1 mmHg"}, "circuit.outlet.R_p = '1 mmHg': expected a quantity in dyn"),
        ({"R_p": -1}, "circuit.outlet.R_p = -1: expected a finite number above zero"),
        ({"R_p": None}, "circuit.outlet.R_p: this parameter of downstream is required"),
        ({"model": "downstraem"}, "circuit.outlet.model = 'downstraem': expected one of downstream"),
        ({"start": {"p": 3}}, "circuit.outlet.start.p = 3: no such state, expected p_wk"),
        ({"start": 3}, "circuit.outlet.start = 3: expected a table"),
        ({"pump": {"fil": "a"}}, "circuit.outlet.pump.fil = 'a': unknown key; did you mean"),
        ({"name": "out let"}, "circuit.out let.name = 'out let': expected a letter"),
    ],
)
def test_what_is_wrong_with_a_circuit_is_one_line(change, said):
    table = {"name": "outlet", "model": "downstream", **VALUES} | change
    raw = tomllib.loads(CASE) | {"circuit": [{k: v for k, v in table.items() if v is not None}]}
    with pytest.raises(CaseError) as caught:
        parse_case(raw)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_two_circuits_of_one_name_are_refused():
    table = {"name": "outlet", "model": "downstream", **VALUES}
    with pytest.raises(CaseError, match=r"circuit.outlet.name = 'outlet': two circuits"):
        parse_case(tomllib.loads(CASE) | {"circuit": [table, table]})


def test_the_schema_describes_every_circuit():
    schema = case_schema()["$defs"]["CircuitTable"]
    named = {entry["properties"]["model"]["const"]: entry for entry in schema["oneOf"]}
    assert set(named) == set(KINDS)
    assert "R_MV" in named["upstream-bovine"]["required"]
    assert np.all(["name" in entry["required"] for entry in named.values()])
