"""Which numbers may be asked for an order, and the error of beats that repeat against the series they are of."""

from __future__ import annotations

import pytest

from valvefsi.verification.answers import (
    EVENT,
    EXTREME,
    FLUTTER,
    METHOD,
    REPEAT,
    repeating_error,
    why_no_order,
)


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("valve.leaflets.leaflet_1.von_mises_p99_kPa.t_s", EVENT),
        ("valve.cycles.0.opening_start_ms", EVENT),
        ("valve.cycles.0.forward_end_s", EVENT),
        ("valve.flutter.leaflet_1.frequency_hz", FLUTTER),
        ("last.leaflets_J_min", EXTREME),
        ("block_J_max", EXTREME),
        ("valve.leaflets.leaflet_1.von_mises_max_kPa.value", EXTREME),
        ("valve.leaflets.leaflet_1.green_strain_max.value", EXTREME),
        ("last.courant", METHOD),
        ("courant", METHOD),
        ("valve.change_between_cycles.p_lv", REPEAT),
        ("valve.cycles.1.peak_flow_ml_per_s", ""),
        ("q_z_upper_ml_s", ""),
        ("last.u_x_tip_cm", ""),
        ("valve.cycles.0.mean_pressure_difference_mmHg", ""),
        ("valve.leaflets.leaflet_1.von_mises_p99_kPa.value", ""),
        ("valve.cycles.0.cardiac_output_l_per_min", ""),
        ("last.v_x_cm_per_s", ""),
    ],
)
def test_times_extremes_and_flutter_have_no_order_flows_and_pressures_have(name, why):
    assert why_no_order(name) == why


@pytest.mark.parametrize("q", [0.2, 0.5, -0.6, 0.9])
def test_the_error_of_beats_that_approach_by_one_ratio_is_what_is_left(q):
    values = [90.0 + 7.0 * q**n for n in range(5)]
    assert repeating_error(values) >= 7.0 * abs(q) ** 4 * (1 - 1e-12)
    if q > 0.0:
        assert repeating_error(values) == pytest.approx(7.0 * q**4)


def test_beats_that_do_not_settle_leave_their_last_change():
    assert repeating_error([1.0, 2.0, 4.0]) == 2.0
    assert repeating_error([1.0, 3.0]) == 2.0
    assert repeating_error([1.0, 1.0, 1.0]) == 0.0
    assert repeating_error([1.0]) is None
