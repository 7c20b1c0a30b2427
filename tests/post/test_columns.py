"""What columns of a history are called, and the units they are shown in."""

from __future__ import annotations

import pytest

from valvefsi.post.columns import Units, name_of, units_of_run
from valvefsi.run.pictures import usual_panels
from valvefsi.units import MMHG

pytestmark = pytest.mark.serial


@pytest.mark.parametrize(
    ("column", "label", "factor"),
    [
        ("u_y_tip_cm", "$u_y$ tip [mm]", 10.0),
        ("kinetic_energy_erg", "kinetic energy [mJ]", 1e-4),
        ("pressure_upstream_dyn_per_cm2", "pressure upstream [mmHg]", 1 / MMHG),
        ("leaflets_post_1_inward_mm", "leaflets post 1 inward [mm]", 1.0),
        ("peak_pdva_cm2", "peak PDVA [cm^2]", 1.0),
        ("force_x_body_dyn_per_cm", "force x body [mN/m]", 1.0),
        ("block_J_min", "block J, smallest at a point [-]", 1.0),
        ("courant", "Courant number [-]", 1.0),
        ("largest_principal_stress_p99_kPa", "largest principal stress, 99th percentile [kPa]", 1.0),
        ("leaflet_1_von_mises_p99_kPa", "leaflet 1 von Mises stress, 99th percentile [kPa]", 1.0),
        ("largest_principal_strain_p99", "largest principal strain, 99th percentile [-]", 1.0),
        ("frequency_Hz", "frequency [Hz]", 1.0),
    ],
)
def test_quantities_have_units_that_people_use(column, label, factor):
    shown = Units().of(column)
    assert (shown.label, shown.factor) == (label, pytest.approx(factor))


@pytest.mark.parametrize(
    ("path", "name"),
    [
        ("last.u_x_tip_cm", "u_x_tip_cm"),
        ("valve.leaflets.leaflet_1.von_mises_p99_kPa.value", "leaflet_1_von_mises_p99_kPa"),
        ("mean_pressure_difference_mmHg", "mean_pressure_difference_mmHg"),
    ],
)
def test_a_number_is_called_by_what_of_its_path_says_what_it_is(path, name):
    assert name_of(path) == name


@pytest.mark.parametrize(
    ("column", "system", "unit"),
    [
        ("flow_middle_cm3_per_s", "lab", "ml/s per cm"),
        ("flow_middle_cm3_per_s", "cgs", "cm^3/s per cm"),
        ("kinetic_energy_erg", "lab", "mJ per cm"),
        ("pressure_middle_dyn_per_cm2", "lab", "mmHg"),
        ("u_x_tip_cm", "cgs", "cm"),
    ],
)
def test_in_the_plane_what_is_of_a_depth_says_so(column, system, unit):
    assert Units(system=system, dim=2).of(column).unit == unit


def test_a_run_says_its_units_in_its_case(tmp_path):
    assert units_of_run(tmp_path) == Units()
    (tmp_path / "case.toml").write_text('[grid]\nlower = ["0 cm", "0 cm"]\n[output]\nunits = "cgs"\n')
    assert units_of_run(tmp_path) == Units(system="cgs", dim=2)


def test_what_a_case_asks_for_is_drawn_first_and_all_of_it():
    asked = ["pressure_in_dyn_per_cm2", "flow_in_cm3_per_s", "flow_out_cm3_per_s", "pdva_cm2", "u_x_tip_cm"]
    asked += [f"leaflets_post_{k}_inward_mm" for k in range(1, 9)] + ["q_z_lower_ml_s", "p_z_lower_mmHg"]
    history = {name: [0.0, 2.0] for name in ("t_s", "courant", "kinetic_energy_erg", *asked)}
    panels = usual_panels(history, Units())
    labels = [panel.label for panel in panels]
    assert labels[:3] == ["flow [ml/s]", "pressure in [mmHg]", "PDVA [cm\u00b2]"]
    assert labels[-2:] == ["kinetic energy [mJ]", "Courant number [-]"]
    assert sum(len(panel.lines) for panel in panels) == len(asked) + 2
    posts = [list(panel.lines) for panel in panels if panel.label == "posts [mm]"]
    said = [f"leaflets post {k} inward" for k in range(1, 9)]
    assert posts == [said[:6], said[6:]]  # a panel has six colours
    assert list(panels[0].lines) == ["in", "out"]


def test_a_panel_shows_values_and_reference_in_its_unit():
    history = {"t_s": [0.0, 1.0], "u_x_tip_cm": [0.0, 0.25]}
    (panel,) = usual_panels(history, Units(), {"u_x_tip_cm": ("theory", 0.3)})
    assert list(panel.lines["u x tip"]) == [0.0, 2.5]
    assert panel.reference == pytest.approx(3.0)
