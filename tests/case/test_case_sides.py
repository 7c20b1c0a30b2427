"""Sides, expressions, tables and graded axes in case files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from valvefsi.case import load_case
from valvefsi.case.build import build, run_case
from valvefsi.case.expressions import Expression
from valvefsi.errors import CaseError
from valvefsi.fluid.boundary import FreeSlip, Mixed, Open, Wall
from valvefsi.fluid.krylov import CoupledNavierStokes
from valvefsi.fluid.navier_stokes import ExplicitViscosity, NavierStokes

CHANNEL = """
title = "channel"
[grid]
lower = ["0 cm", "0 cm"]
upper = ["2 cm", "1 cm"]
cells = [16, 8]
[fluid]
viscosity = "0.5 P"
[fluid.sides.x_lower]
{inlet}
[fluid.sides.x_upper]
type = "open"
pressure = "0 mmHg"
[time]
dt = "{dt}"
t_end = "{t_end}"
[output]
frames = 0
"""
INLET = 'velocity_expression = ["6 * y * (1 - y) * rate", "0"]\ntable = "rate.csv"'


@pytest.fixture
def case(shared_tmp):
    """Return a function that writes a channel and reads it back."""
    if MPI.COMM_WORLD.rank == 0:
        (shared_tmp / "rate.csv").write_text("# flow\nt_s,rate\n0,0\n1,2\n2,2\n")

    def write(inlet=INLET, dt="0.01 s", t_end="0.05 s", overrides=(), **more):
        text = CHANNEL.format(inlet=inlet, dt=dt, t_end=t_end)
        for old, new in more.get("replace", {}).items():
            assert old in text
            text = text.replace(old, new)
        path = shared_tmp / "case.toml"
        MPI.COMM_WORLD.barrier()  # nobody reads the one before
        if MPI.COMM_WORLD.rank == 0:
            path.write_text(text)
        MPI.COMM_WORLD.barrier()
        return load_case(path, list(overrides))

    return write


def test_a_velocity_is_an_expression_of_place_and_of_a_table_over_time(case):
    wall = build(case(), Path()).model.fluid.boundary.place("x_lower").side
    assert isinstance(wall, Wall)
    y = np.array([0.25, 0.5])
    np.testing.assert_allclose(wall.velocity(0.0, y, 0.0, 0.75)[0], 6 * y * (1 - y) * 1.5)
    np.testing.assert_allclose(wall.velocity(0.0, y, 0.0, 9.0)[0], 6 * y * (1 - y) * 2.0)


@pytest.mark.serial
def test_what_flows_in_flows_out_of_a_channel_from_a_case_file(case, shared_tmp):
    loaded = case(t_end="1 s", overrides=["time.control=adaptive"])
    run_case(loaded, out=shared_tmp / "out")
    simulation = build(loaded, shared_tmp / "out")
    state = simulation._first_state(resume=True)
    fluid = simulation.model.fluid
    assert fluid.boundary.outflow(state.u, "x_upper") == pytest.approx(2.0, rel=0.02)
    assert fluid.boundary.outflow(state.u, "x_upper") == pytest.approx(
        -fluid.boundary.outflow(state.u, "x_lower"), rel=1e-10
    )


def test_a_case_that_a_run_has_kept_finds_its_table(case, shared_tmp):
    loaded = case()
    assert Path(loaded.fluid.sides.x_lower.table) == (shared_tmp / "rate.csv").resolve()


def test_every_type_of_side_is_built(case):
    inlet = 'type = "mixed"\ncentre = [0, "0.5 cm"]\nradius = "2 mm"\npressure_expression = "1e3 * sin(2*pi*t) + y"'
    loaded = case(inlet, overrides=["fluid.sides.y_upper.type=free_slip"])
    places = {place.name: place.side for place in build(loaded, Path()).model.fluid.boundary.places}
    assert isinstance(places["x_lower"], Mixed)
    assert places["x_lower"].open.pressure(0.0, 0.25, 0.0, 0.25) == pytest.approx(1000.25)
    assert isinstance(places["x_upper"], Open)
    assert not places["x_upper"].mean_pressure
    assert isinstance(places["y_lower"], Wall)
    assert isinstance(places["y_upper"], FreeSlip)


def test_an_open_side_takes_its_pressure_in_the_mean(case):
    loaded = case('type = "open"\nbackflow = 0.5\nmean_pressure = true')
    side = build(loaded, Path()).model.fluid.boundary.place("x_lower").side
    assert side.mean_pressure
    assert side.backflow == 0.5


def test_the_viscous_scheme_follows_the_step(case):
    limit = (1 / 8) ** 2 / (8 * 0.5)
    for dt, kind in ((0.49 * limit, ExplicitViscosity), (0.6 * limit, NavierStokes)):
        fluid = build(case(dt=f"{dt!r} s"), Path()).model.fluid
        assert type(fluid) is kind
    assert type(build(case(overrides=["fluid.viscous=coupled"]), Path()).model.fluid) is CoupledNavierStokes
    with pytest.raises(CaseError, match=r"fluid.viscous = 'explicit': explicit viscosity is stable up to"):
        build(case(dt=f"{2 * limit!r} s", overrides=["fluid.viscous=explicit"]), Path())


GRADED = """[grid]
x = [["-3 cm", "4 mm"], ["-1 cm", "2 mm"], ["1 cm", "2 mm"], ["3 cm", "4 mm"]]
y = [["-1 cm", "2 mm"], ["1 cm", "2 mm"]]
"""


def test_a_graded_grid_comes_from_spacings(case):
    text = '[grid]\nlower = ["0 cm", "0 cm"]\nupper = ["2 cm", "1 cm"]\ncells = [16, 8]\n'
    loaded = case(replace={text: GRADED})
    grid = build(loaded, Path()).model.grid
    assert grid.uniform == (False, True, True)
    assert loaded.grid.spacing == pytest.approx(0.2)
    np.testing.assert_allclose([b for pair in loaded.grid.bounds for b in pair], [-3, 3, -1, 1])
    np.testing.assert_allclose(loaded.grid.fine[0], [-1, 1], atol=1e-9)


WRONG = {
    'type = "open"\nbackflow = 0\nmean_pressure = true': "mean_pressure = True: nothing is lost to give back",
    'type = "open"\nvelocity = [1, 0]': "velocity = (1.0, 0.0): a side of type 'open' has no such key",
    'type = "mixed"\ncentre = [0, 0]': "needs centre and radius",
    'type = "mixed"\ncentre = [0]\nradius = 1': "fluid.sides.x_lower.centre = [0.0]: expected 2 entries",
    'type = "mixed"\ncentre = [0, 9]\nradius = 1': "no face of side x_lower is open",
    'velocity_expression = ["sin(q)", "0"]': "unknown name 'q'",
    'velocity_expression = ["sinn(t)", "0"]': "unknown function 'sinn', did you mean 'sin'?",
    "velocity_expression = [\"__import__('os').system('ls')\", \"0\"]": "is not arithmetic",
    'velocity_expression = ["y.real", "0"]': "is not arithmetic",
    'velocity_expression = ["1 +", "0"]': "not an expression",
    'velocity_expression = ["sin", "0"]': "sin is a function, write what of in parentheses: sin(x)",
    'velocity_expression = ["2*max", "0"]': "max is a function, write what of in parentheses: max(x, y)",
    'velocity_expression = ["\'sin\'", "0"]': "'sin', a text in quotes, is not arithmetic",
    'velocity_expression = ["x.real.imag", "0"]': "x.real.imag is not arithmetic",
    'velocity_expression = ["3 cm/s", "0"]': "a number in it has no unit, it is in CGS",
    'velocity_expression = ["max(1)", "0"]': "max takes 2 values, found 1",
    'velocity_expression = ["1 / (t * y)", "0"]': "not finite",
    'velocity_expression = ["rates", "0"]\ntable = "rate.csv"': "unknown name 'rates'; did you mean 'rate'?",
    'velocity_expression = ["1", "0"]\ntable = "none.csv"': "table = 'none.csv': no such file; did you mean 'rate.csv'",
    'velocity = [1, 0]\nvelocity_expression = ["1", "0"]': "give velocity or velocity_expression, not both",
    'type = "open"\nbackflow = 2': "backflow",
}


@pytest.mark.parametrize("inlet", WRONG)
def test_a_side_that_cannot_be_is_told_in_one_line(inlet, case):
    with pytest.raises(CaseError) as caught:
        build(case(inlet), Path())
    assert WRONG[inlet].replace(", did", "; did") in str(caught.value).replace(", did", "; did")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,rate\n0,1\n1,2\n", "begins with t_s"),
        ("t_s,rate\n0,1\n0,2\n", r"row 3: times must increase"),
        ("t_s,rate\n0,1\n1,nan\n", r"row 3: expected 2 finite numbers"),
        ("t_s,rate\n0,1\n1\n", r"row 3: expected 2 finite numbers"),
        ("t_s,rate\n0,1\n", r"at least two rows"),
        ("", "begins with t_s"),
    ],
)
@pytest.mark.serial
def test_a_table_that_is_wrong_is_refused(text, message, case, shared_tmp):
    loaded = case()
    (shared_tmp / "rate.csv").write_text(text)
    with pytest.raises(CaseError, match=message):
        build(loaded, Path())


def test_an_expression_knows_the_usual_functions():
    expression = Expression("where(x < 1, max(x, 0.5), -x**2) + abs(-y) % 3 - sqrt(z) * exp(0) + cos(pi)", ())
    x = np.array([0.2, 2.0])
    np.testing.assert_allclose(
        expression({"x": x, "y": 4.0, "z": 9.0, "t": 0.0}), [0.5 + 1 - 3 - 1, -4 + 1 - 3 - 1]
    )
