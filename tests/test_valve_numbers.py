"""Numbers of a valve from closed-form waveforms and leaflets, and pictures of them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from matplotlib.image import imread

from tests.ordering import assert_order
from valvefsi.diagnostics.projected_area import end_view, open_image, projected_area
from valvefsi.diagnostics.valve_numbers import (
    NUMBERS,
    cycle_change,
    cycle_numbers,
    effective_orifice_area,
    valve_numbers,
)
from valvefsi.diagnostics.valve_record import ValveRecord, ValveTest
from valvefsi.io.valve_waveform_plots import valve_end_views, valve_waveforms
from valvefsi.units import MMHG

PERIOD, OPEN, EJECTION, PEAK = 60 / 70, 0.10, 0.30, 400.0
"""Cycle [s], start and length of forward flow [s], peak flow [cm^3/s]; the flow is half a sine."""
CLOSING, BACKFLOW, LEAKAGE = 0.03, 60.0, 3.0
"""Length of closing [s], its peak [cm^3/s], also half a sine, and a constant leakage [cm^3/s]."""
QUADRATIC, INERTIAL = 12 * MMHG, 6 * MMHG
"""Pressure difference in forward flow, QUADRATIC sin^2 s + INERTIAL cos s with s = pi (t - OPEN)/EJECTION."""
LARGEST_AREA = 3.5
SALINE = ValveTest(rho=1.0, mu=0.01, diameter=2.5)


def step(x):
    """From 0 to 1, with level ends."""
    x = np.clip(x, 0, 1)
    return x**2 * (3 - 2 * x)


def waves(t, leakage=LEAKAGE, backflow=BACKFLOW):
    """Closed-form waveforms of a periodic cycle."""
    t = np.mod(t + 1e-12, PERIOD) - 1e-12
    end, since = OPEN + EJECTION, t - OPEN
    s = np.pi * since / EJECTION
    forward = (since >= 0) & (since <= EJECTION)
    closing = np.where((t > end) & (t < end + CLOSING), np.sin(np.pi * (t - end) / CLOSING), 0.0)
    q = np.where(forward, PEAK * np.sin(s), -leakage - backflow * closing)
    omega = 2 * np.pi / PERIOD
    p_ao = MMHG * (100 + 16 * np.sin(omega * (t - 0.14)) + 4 * np.sin(2 * omega * (t - 0.12)))
    dp = QUADRATIC * np.sin(s) ** 2 + INERTIAL * np.cos(s)
    rising = 8 * MMHG + (p_ao + INERTIAL - 8 * MMHG) * step(t / OPEN)
    falling = 8 * MMHG + (p_ao - INERTIAL - 8 * MMHG) * step(1 - (t - end) / 0.09)
    p_lv = np.where(since < 0, rising, np.where(forward, p_ao + dp, falling))
    pdva = LARGEST_AREA * np.interp(t, [OPEN, OPEN + 0.04, end - 0.05, end + CLOSING], [0, 1, 1, 0])
    return {"p_lv": p_lv, "p_ao": p_ao, "q": q, "pdva": pdva}


def record(cycles=1.0, samples=4000, **change):
    t = np.arange(round(cycles * samples) + 1) * PERIOD / samples
    return ValveRecord(t=t, period=PERIOD, **(waves(t) | change))


def closed_forms():
    """The numbers of the waveforms above."""
    ratio = INERTIAL / (2 * QUADRATIC)
    s = np.arccos(ratio - np.hypot(ratio, 1))
    squares = s / 2 - np.sin(2 * s) / 4
    rms, mean = PEAK * np.sqrt(squares / s), (QUADRATIC * squares + INERTIAL * np.sin(s)) / s
    forward, closing = 2 * PEAK * EJECTION / np.pi, 2 * BACKFLOW * CLOSING / np.pi
    leakage = LEAKAGE * (PERIOD - EJECTION)
    return {
        "forward_volume": forward,
        "net_volume": forward - closing - leakage,
        "cardiac_output": (forward - closing - leakage) / PERIOD,
        "peak_flow": PEAK,
        "rms_forward_flow": PEAK / np.sqrt(2),
        "rms_flow": rms,
        "forward_start": OPEN,
        "forward_end": OPEN + EJECTION,
        "forward_duration": EJECTION,
        "pressure_start": OPEN,
        "pressure_end": OPEN + EJECTION * s / np.pi,
        "mean_pressure_difference": mean,
        "peak_pressure_difference": QUADRATIC + INERTIAL**2 / (4 * QUADRATIC),
        "effective_orifice_area": rms / (51.6 * np.sqrt(mean / MMHG / SALINE.rho)),
        "regurgitant_volume": closing + leakage,
        "regurgitant_fraction": (closing + leakage) / forward,
        "closing_volume": closing + LEAKAGE * CLOSING,
        "leakage_volume": leakage - LEAKAGE * CLOSING,
        "opening_start": OPEN + 0.004,
        "opening_end": OPEN + 0.036,
        "closing_start": OPEN + EJECTION - 0.042,
        "closing_end": OPEN + EJECTION + CLOSING - 0.008,
        "opening_duration": 0.032,
        "open_duration": EJECTION - 0.078,
        "closing_duration": 0.064,
        "peak_pdva": LARGEST_AREA,
        "peak_reynolds": 4 * PEAK / (np.pi * 2.5 * 0.01),
        "mean_aortic_pressure": 100 * MMHG,
    }


def test_every_number_of_a_closed_form_cycle():
    got = cycle_numbers(record(), SALINE)
    assert got.reasons == {}
    for name, value in closed_forms().items():
        # Backflow below the floor, 2 % of the peak flow, is leakage: 0.4 % of the closing volume.
        slack = 1e-2 if name in ("closing_volume", "leakage_volume") else 2e-3
        assert getattr(got, name) == pytest.approx(value, rel=slack), name
    assert set(NUMBERS) - set(closed_forms()) == {"peak_to_peak_difference", "times_from"}
    assert got.times_from == "pdva"


def test_forward_flow_is_net_closing_and_leakage():
    got = cycle_numbers(record(), SALINE)
    assert got.forward_volume == pytest.approx(
        got.net_volume + got.closing_volume + got.leakage_volume, rel=1e-13
    )
    assert got.cardiac_output * PERIOD == pytest.approx(got.net_volume, rel=1e-13)


def test_the_numbers_converge_with_the_samples():
    expected = closed_forms()["effective_orifice_area"]

    def error(samples):
        return abs(cycle_numbers(record(samples=samples), SALINE).effective_orifice_area - expected)

    assert_order(error, (300, 600, 1200, 2400), order=1.5, below=2e-5)


def test_the_area_of_an_orifice_comes_back_from_its_own_law():
    q, area, rho = 250.0, 2.1, 1.06
    got = effective_orifice_area(q, 0.5 * rho * (q / area) ** 2, rho)
    assert got == pytest.approx(area * np.sqrt(2 * MMHG) / 51.6, rel=1e-13)
    assert got == pytest.approx(area, rel=8e-4)
    with pytest.raises(ValueError, match="mean_difference: expected a positive pressure"):
        effective_orifice_area(q, 0.0, rho)


def test_a_valve_that_is_an_orifice_gives_its_area_whatever_the_flow():
    one = record()
    q = np.maximum(one.q, 0)
    dp = 0.5 * (q / 1.8) ** 2
    got = cycle_numbers(dataclasses.replace(one, q=q, p_lv=one.p_ao + dp), SALINE)
    assert got.effective_orifice_area == pytest.approx(1.8, rel=1e-3)
    assert (got.pressure_start, got.pressure_end) == pytest.approx((OPEN, OPEN + EJECTION), abs=3e-4)
    assert got.regurgitant_volume == pytest.approx(0, abs=1e-12)
    assert got.closing_volume == 0


@pytest.mark.parametrize("seed", range(6))
def test_noise_moves_no_number_far(seed):
    rng, clean = np.random.default_rng(seed), record(samples=1500)
    noise = rng.standard_normal((3, len(clean.t)))
    noisy = dataclasses.replace(
        clean, p_lv=clean.p_lv + MMHG * noise[0], p_ao=clean.p_ao + MMHG * noise[1], q=clean.q + 4 * noise[2]
    )
    got, expected = cycle_numbers(noisy, SALINE), cycle_numbers(clean, SALINE)
    assert got.reasons == {}
    for name, slack in {"forward_volume": 0.01, "net_volume": 0.01, "effective_orifice_area": 0.02}.items():
        assert getattr(got, name) == pytest.approx(getattr(expected, name), rel=slack), name
    assert got.mean_pressure_difference == pytest.approx(expected.mean_pressure_difference, rel=0.05)
    assert got.pressure_end == pytest.approx(expected.pressure_end, abs=0.02)
    assert got.forward_duration == pytest.approx(EJECTION, abs=0.01)
    assert got.closing_volume == pytest.approx(expected.closing_volume, abs=0.2)
    assert got.regurgitant_volume == pytest.approx(expected.regurgitant_volume, abs=0.5)


def test_a_late_spike_of_backflow_is_leakage_not_closing():
    one = record()
    late = one.q - 80 * np.exp(-(((one.t - 0.7) / 0.01) ** 2))
    got, plain = cycle_numbers(dataclasses.replace(one, q=late), SALINE), cycle_numbers(one, SALINE)
    assert got.closing_volume == pytest.approx(plain.closing_volume, rel=1e-12)
    assert got.leakage_volume - plain.leakage_volume == pytest.approx(0.8 * np.sqrt(np.pi), rel=1e-6)


def test_a_dip_of_the_pressure_difference_does_not_cut_its_interval():
    one = record()
    dip = 14 * MMHG * np.exp(-(((one.t - 0.2) / 0.004) ** 2))
    got, plain = (cycle_numbers(dataclasses.replace(one, p_lv=one.p_lv - d), SALINE) for d in (dip, 0 * dip))
    assert ((one.p_lv - dip - one.p_ao)[(one.t > 0.15) & (one.t < 0.25)]).min() < 0
    assert (got.pressure_start, got.pressure_end) == (plain.pressure_start, plain.pressure_end)


def test_without_the_area_the_times_come_from_the_flow():
    got = cycle_numbers(dataclasses.replace(record(), pdva=None), SALINE)
    assert got.times_from == "flow"
    assert got.opening_start == got.forward_start
    rise = EJECTION * np.arcsin(0.9) / np.pi
    assert got.opening_duration == pytest.approx(rise, rel=1e-3)
    assert got.closing_start == pytest.approx(OPEN + EJECTION - rise, rel=1e-3)
    tail = CLOSING * np.arcsin(0.02 * PEAK / BACKFLOW) / np.pi
    assert got.closing_end == pytest.approx(OPEN + EJECTION + CLOSING - tail, abs=2e-4)
    assert got.peak_pdva is None
    assert set(got.reasons) == {"peak_pdva"}


def test_two_equal_cycles_give_equal_numbers_and_no_change():
    two = record(2)
    first, second = valve_numbers(two, SALINE)
    assert (first.cycle, second.cycle) == (0, 1)
    assert second.times_from == first.times_from
    for name in set(NUMBERS) - {"times_from"}:
        assert getattr(second, name) == pytest.approx(getattr(first, name), rel=1e-9), name
    change, reasons = cycle_change(two)
    assert reasons == {}
    assert max(change.values()) < 1e-6


def test_the_change_between_cycles_is_the_relative_norm():
    two = record(2)
    scale = np.where(two.t < PERIOD, 0.97, 1.0)
    change, _ = cycle_change(dataclasses.replace(two, q=scale * two.q, p_ao=scale * two.p_ao))
    assert change["q"] == pytest.approx(0.03, rel=1e-3)
    # The jump at the cycle's edge lies in one step.
    assert change["p_ao"] == pytest.approx(0.03, rel=1e-3)
    assert change["p_lv"] < 1e-9
    change, reasons = cycle_change(record(1.5))
    assert set(change.values()) == {None}
    assert "two complete cycles in a row are needed, the record has 1 complete" in reasons["q"]


def test_the_start_of_the_cycles_may_be_moved_in_the_closed_phase():
    three = record(3)
    moved = dataclasses.replace(three, start=0.6)
    assert moved.num_cycles == 3
    got, expected = cycle_numbers(moved, SALINE, 0), cycle_numbers(three, SALINE, 0)
    assert got.effective_orifice_area == pytest.approx(expected.effective_orifice_area, rel=1e-4)
    assert got.regurgitant_volume == pytest.approx(expected.regurgitant_volume, rel=1e-3)
    assert got.forward_start == pytest.approx(OPEN + PERIOD - 0.6, abs=PERIOD / 4000)


def test_an_incomplete_cycle_has_reasons_in_place_of_numbers():
    first, second = valve_numbers(record(1.6), SALINE)
    assert first.reasons == {}
    assert all(getattr(second, name) is None for name in NUMBERS)
    assert set(second.reasons) == set(NUMBERS)
    assert "the record ends 0.3429 s before the cycle does" in second.reasons["peak_flow"]
    assert second.start == pytest.approx(PERIOD)


def test_a_record_that_stops_a_sample_short_is_complete():
    one = record()
    short = ValveRecord(period=PERIOD, **{n: getattr(one, n)[:-1] for n in ("t", *one.signals)})
    assert cycle_numbers(short, SALINE).net_volume == pytest.approx(
        cycle_numbers(record(), SALINE).net_volume
    )


def test_what_cannot_be_given_says_why():
    one = record()
    broken = one.q.copy()
    broken[1000] = np.nan
    got = cycle_numbers(dataclasses.replace(one, q=broken), SALINE)
    assert got.effective_orifice_area is None
    assert "q is not finite at t = 0.2142" in got.reasons["effective_orifice_area"]
    shut = cycle_numbers(dataclasses.replace(one, q=0 * one.q - 1), SALINE)
    assert shut.forward_volume is None
    assert shut.reasons["forward_volume"] == "no forward flow"
    assert shut.net_volume == pytest.approx(-PERIOD)
    weak = cycle_numbers(dataclasses.replace(one, p_lv=one.p_ao - 1), SALINE)
    assert weak.reasons["effective_orifice_area"] == "p_lv never exceeds p_ao during forward flow"
    assert weak.forward_volume is not None
    gone = (one.t > 0.2) & (one.t < 0.3)
    holed = ValveRecord(period=PERIOD, **{n: getattr(one, n)[~gone] for n in ("t", *one.signals)})
    assert "two samples are 0.1" in cycle_numbers(holed, SALINE).reasons["peak_flow"]


def test_a_cycle_that_starts_with_the_valve_open_is_told_so():
    got = cycle_numbers(dataclasses.replace(record(3), start=0.25), SALINE, 0)
    for name in ("forward_volume", "effective_orifice_area", "closing_volume", "opening_start"):
        assert getattr(got, name) is None
        assert "start the cycle in the closed phase" in got.reasons[name]
    assert got.net_volume == pytest.approx(closed_forms()["net_volume"], rel=2e-3)


def test_none_of_the_numbers_is_nan_and_none_is_missing_silently():
    one = record(2)
    for start in np.linspace(0, PERIOD, 23):
        for area in (one.pdva, None):
            for got in valve_numbers(dataclasses.replace(one, start=start, pdva=area), SALINE):
                for name in NUMBERS:
                    value = getattr(got, name)
                    assert (value is None) == (name in got.reasons), (start, name)
                    assert isinstance(value, str | None) or np.isfinite(value)


def test_the_laboratory_reads_its_own_units():
    got = cycle_numbers(record(), SALINE)
    lab = got.in_lab_units()
    assert lab["cardiac_output_l_per_min"] == pytest.approx(got.cardiac_output * 0.06)
    assert lab["mean_pressure_difference_mmHg"] == pytest.approx(got.mean_pressure_difference / MMHG)
    assert lab["regurgitant_fraction_percent"] == pytest.approx(100 * got.regurgitant_fraction)
    assert lab["forward_duration_ms"] == pytest.approx(300, abs=0.5)
    assert lab["forward_volume_ml"] == got.forward_volume
    assert lab["rms_flow_ml_per_s"] == got.rms_flow
    assert lab["effective_orifice_area_cm2"] == got.effective_orifice_area
    assert len(lab) == len(got.as_dict()) - 1
    assert got.as_dict()["peak_flow"] == got.peak_flow


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"q": np.zeros(3)}, "q: expected the shape"),
        ({"t": np.zeros(4001)}, "t: expected two or more finite times"),
        ({"period": 0.0}, "period: expected a positive time, found 0.0"),
        ({"start": -1.0}, "start: expected 0.0 or later"),
    ],
)
def test_a_record_is_checked_at_birth(change, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(record(), **change)


def test_a_test_is_checked_at_birth_and_a_missing_cycle_is_told():
    with pytest.raises(ValueError, match="mu: expected a positive number, found 0"):
        ValveTest(rho=1, mu=0, diameter=2.5)
    with pytest.raises(ValueError, match="levels: expected 0 < lower < upper < 1"):
        ValveTest(rho=1, mu=0.01, diameter=2.5, levels=(0.9, 0.1))
    with pytest.raises(IndexError, match="cycle 3: the record begins 2"):
        cycle_numbers(record(2), SALINE, 3)


# Open area ------------------------------------------------------------------------------------------------

UP = {"axis": (0, 0, 1), "centre": (0, 0, 0)}


def rectangle(x0, x1, y0, y1, z=0.0):
    points = np.array([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]], dtype=float)
    return points, np.array([[0, 1, 2], [0, 2, 3]])


def together(*meshes):
    shift = np.cumsum([0, *(len(points) for points, _ in meshes)])
    return (
        np.concatenate([points for points, _ in meshes]),
        np.concatenate([triangles + k for (_, triangles), k in zip(meshes, shift, strict=False)]),
    )


def ring(inner, outer, corners=120):
    """A flat ring (a disc where ``inner`` is 0) and the area of its polygon."""
    angle = 2 * np.pi * np.arange(corners) / corners
    unit = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    a, b = np.arange(corners), (np.arange(corners) + 1) % corners
    outside, next_outside = a + corners, b + corners
    triangles = np.concatenate(
        [np.stack([a, outside, next_outside], axis=1), np.stack([a, next_outside, b], axis=1)]
    )
    area = 0.5 * corners * np.sin(2 * np.pi / corners) * (outer**2 - inner**2)
    return np.concatenate([inner * unit, outer * unit]), triangles, area


def turn(axis, angle):
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def leaflets(opening, radius=1.25, along=24, across=10):
    """Three leaflets between closed, their free edges a Y, and open, 90 % of the radius.

    Returns:
        Nodes, triangles, leaflet of each triangle, pieces of the free edges, and the open area.
    """
    part, fall = np.linspace(-1, 1, along + 1), np.linspace(0, 1, across + 1)
    meshes, owners, edges = [], [], []
    for k in range(3):
        angle = 2 * np.pi * k / 3 + np.pi / 3 * part
        ends = np.array([[np.cos(angle[i]), np.sin(angle[i])] for i in (0, -1)])
        wide = 0.9 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        shut = 0.9 * np.where(part[:, None] < 0, -part[:, None] * ends[0], part[:, None] * ends[1])
        wall = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        free = (1 - opening) * shut + opening * wide
        flat = radius * ((1 - fall)[:, None, None] * wall + fall[:, None, None] * free)
        z = np.broadcast_to((0.9 * np.sin(np.pi / 2 * fall))[:, None, None], (*flat.shape[:2], 1))
        node = np.arange(flat.shape[0] * flat.shape[1]).reshape(flat.shape[:2])
        a, b, c, d = (x.ravel() for x in (node[:-1, :-1], node[:-1, 1:], node[1:, 1:], node[1:, :-1]))
        triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
        edges.append(np.stack([node[-1, :-1], node[-1, 1:]], axis=1) + k * node.size)
        meshes.append((np.concatenate([flat, z], axis=2).reshape(-1, 3), triangles))
        owners.append(np.full(len(triangles), k))
    points, triangles = together(*meshes)
    edges = np.concatenate(edges)
    p, r = points[edges[:, 0]], points[edges[:, 1]]
    # Between the wall's polygon and the circle slivers are open.
    area = 0.5 * np.sum(p[:, 0] * r[:, 1] - p[:, 1] * r[:, 0])
    area += radius**2 * (np.pi - 1.5 * along * np.sin(2 * np.pi / (3 * along)))
    return points, triangles, np.concatenate(owners), edges, area


def test_without_leaflets_the_whole_orifice_is_open():
    got = projected_area(np.zeros((0, 3)), np.zeros((0, 3), dtype=int), radius=1.25, **UP)
    assert got.open_area == pytest.approx(np.pi * 1.25**2, rel=1e-14)
    assert (got.fraction, got.error) == (1.0, 0.0)


def test_a_sheet_over_the_orifice_leaves_nothing_open():
    got = projected_area(*rectangle(-3, 3, -3, 3), radius=1.25, **UP)
    assert got.open_area == pytest.approx(0, abs=1e-13)
    assert got.error < 1e-13


def test_half_a_sheet_leaves_half_open():
    got = projected_area(*rectangle(-3, 3, 0, 3), radius=1.25, **UP)
    assert got.fraction == pytest.approx(0.5, abs=1e-4)
    off = projected_area(*rectangle(-3, 3, 0.4, 3), radius=1.25, **UP)
    cap = 1.25**2 * np.arccos(0.4 / 1.25) - 0.4 * np.sqrt(1.25**2 - 0.4**2)
    assert off.covered_area == pytest.approx(cap, abs=5e-4)


def test_what_lies_twice_over_a_place_counts_once():
    one = rectangle(-1, 0.5, -0.5, 0.5)
    single, double = (
        projected_area(*mesh, radius=2, **UP)
        for mesh in (one, together(one, rectangle(-1, 0.5, -0.5, 0.5, 0.3)))
    )
    assert double.covered_area == pytest.approx(single.covered_area, rel=1e-13)
    crossed = projected_area(*together(one, rectangle(-0.5, 1, -0.3, 0.3, 0.2)), radius=2, **UP)
    assert crossed.covered_area == pytest.approx(1.5 + 0.5 * 0.6, abs=1e-3)


def test_a_ring_covers_its_own_area_only():
    points, triangles, area = ring(0.6, 1.0)
    got = projected_area(points, triangles, radius=1.25, **UP)
    assert got.covered_area == pytest.approx(area, rel=2e-4)
    wide, triangles, _ = ring(0.6, 3.0)
    got = projected_area(wide, triangles, radius=1.25, **UP)
    assert got.open_area == pytest.approx(
        0.36 * np.pi * 120 / (2 * np.pi) * np.sin(2 * np.pi / 120), rel=3e-4
    )


@pytest.mark.parametrize("angle", [0.3, 1.0, 1.5])
def test_a_tilted_disc_covers_its_cosine(angle):
    points, triangles, area = ring(0.0, 1.0)
    tilted = points @ turn((1, 2, 0), angle).T + (0, 0, 4)
    got = projected_area(tilted, triangles, radius=1.25, **UP)
    assert got.covered_area == pytest.approx(area * np.cos(angle), abs=4e-4)


def test_a_sheet_seen_from_its_edge_covers_nothing():
    points, triangles, _ = ring(0.0, 1.0)
    got = projected_area(points @ turn((1, 0, 0), np.pi / 2).T, triangles, radius=1.25, **UP)
    assert got.covered_area == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("angle", [0.2, 0.9, 2.2])
def test_a_turn_about_the_axis_changes_nothing(angle):
    points, triangles, *_, area = leaflets(0.7)
    around = turn((0, 0, 1), angle)
    got = projected_area(points @ around.T, triangles, radius=1.25, **UP)
    assert got.open_area == pytest.approx(area, abs=4e-4)


def test_a_turn_and_a_shift_of_everything_change_nothing():
    points, triangles, *_, area = leaflets(0.4)
    whole, shift = turn((1, -2, 0.5), 1.1), np.array([3.0, -1.0, 7.0])
    got = projected_area(
        points @ whole.T + shift, triangles, axis=5 * whole[:, 2], centre=shift + whole[:, 2], radius=1.25
    )
    assert got.open_area == pytest.approx(area, abs=4e-4)


@pytest.mark.parametrize("opening", [0.05, 0.3, 0.6, 0.95])
def test_the_error_is_no_less_than_what_is_found(opening):
    points, triangles, *_, area = leaflets(opening)
    got = projected_area(points, triangles, radius=1.25, **UP)
    assert abs(got.open_area - area) <= got.error + 1e-12
    assert got.error < 4e-4 * got.orifice_area


def test_the_area_converges_with_the_lines():
    points, triangles, area = ring(0.45, 1.0, corners=12)

    def error(rows):
        spread = [
            projected_area(
                points @ turn((0, 0, 1), a).T, triangles, radius=1.25, rows=rows, **UP
            ).covered_area
            for a in np.linspace(0.01, 0.52, 30)
        ]
        return float(np.sqrt(np.mean((np.array(spread) - area) ** 2)))

    assert_order(error, (64, 1024), order=1.4, below=8e-5)


def test_the_image_shows_the_area():
    points, triangles, *_ = leaflets(0.6)
    got = projected_area(points, triangles, radius=1.25, **UP)
    image = open_image(points, triangles, radius=1.25, pixels=500, **UP)
    assert image.sum() * (2.5 / 500) ** 2 == pytest.approx(got.open_area, rel=5e-3)
    assert open_image(*rectangle(-3, 3, -3, 3), radius=1.25, pixels=101, **UP).sum() == 0
    upper = open_image(*rectangle(-3, 3, -3, 0), radius=1.25, pixels=100, **UP)
    assert upper[50:].any()
    assert not upper[:50].any()


def test_the_view_is_right_handed_and_from_downstream():
    points = np.array([[1.0, 2.0, 3.0]])
    np.testing.assert_allclose(end_view(points, (0, 0, 2), (0, 0, 1)), [[1, 2, 2]])
    frame = end_view(np.eye(3), (1, 2, -0.5), (0, 0, 0))
    np.testing.assert_allclose(frame.T @ frame, np.eye(3), atol=1e-14)
    assert np.linalg.det(frame) == pytest.approx(1)
    np.testing.assert_allclose(end_view([[1, 2, -0.5]], (1, 2, -0.5), (0, 0, 0))[0, :2], 0, atol=1e-14)


def test_wrong_surfaces_are_refused():
    points, triangles = rectangle(-1, 1, -1, 1)
    with pytest.raises(ValueError, match="triangles: expected points 0 to 3, found 1 to 4"):
        projected_area(points, triangles + 1, radius=1, **UP)
    with pytest.raises(ValueError, match="radius: expected a positive length"):
        projected_area(points, triangles, radius=0, **UP)
    with pytest.raises(ValueError, match="axis: expected a direction"):
        projected_area(points, triangles, radius=1, axis=(0, 0, 0), centre=(0, 0, 0))
    with pytest.raises(ValueError, match="points: expected finite positions"):
        projected_area(points * np.nan, triangles, radius=1, **UP)


# Pictures -------------------------------------------------------------------------------------------------


def test_the_waveforms_are_drawn(tmp_path):
    two = record(2, samples=600)
    numbers = valve_numbers(two, SALINE)
    drawn = {name: getattr(two, name) for name in ("t", *two.signals)}
    for name, prefix in (("forward", "forward"), ("positive", "pressure")):
        drawn[name] = np.array(
            [
                [n.start + getattr(n, f"{prefix}_start"), n.start + getattr(n, f"{prefix}_end")]
                for n in numbers
            ]
        )
    rng = np.random.default_rng(0)
    drawn |= {"t_data": two.t[::6], "q_data": two.q[::6] + 5 * rng.standard_normal(len(two.t[::6]))}
    path = valve_waveforms(tmp_path / "waves.png", drawn, title="Pulse duplicator", caption="closed form")
    assert np.ptp(imread(path)[..., :3]) > 0.5
    bare = {name: drawn[name] for name in ("t", "p_lv", "p_ao", "q")}
    assert valve_waveforms(tmp_path / "bare.pdf", bare).stat().st_size > 5000


def test_the_leaflets_are_drawn_end_on(tmp_path):
    views = []
    for k, opening in enumerate((0.02, 0.25, 0.6, 1.0)):
        points, triangles, owner, edges, _ = leaflets(opening)
        area = projected_area(points, triangles, radius=1.25, rows=128, **UP).open_area
        xyz = end_view(points, UP["axis"], UP["centre"])
        views.append(
            {"xyz": xyz, "triangles": triangles, "owner": owner, "free_edges": edges}
            | {"open_area": area, "t": 0.1 + 0.02 * k}
        )
    path = valve_end_views(tmp_path / "views.png", views, radius=1.25, title="Opening", caption="end on")
    assert np.ptp(imread(path)[..., :3]) > 0.5
    assert valve_end_views(tmp_path / "one.png", views[:1], radius=1.25).exists()
