"""Reading records of a flow loop: headings with units, and every way a file can be wrong."""

from __future__ import annotations

import numpy as np
import pytest

from valvefsi.errors import CaseError
from valvefsi.fitting.waveforms import parse_heading, read_waveforms, write_waveforms
from valvefsi.units import KILOPASCAL, LITRE_PER_MINUTE, MMHG

pytestmark = pytest.mark.serial  # nothing in it runs in parallel
GOOD = ["t_s,p_ao_mmHg,q_ao_ml_s", *(f"{0.01 * k:.2f},{80 + k},{3 * k}" for k in range(12))]


def table(folder, lines, name="record.csv"):
    path = folder / name
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def changed(row, line):
    return [*GOOD[:row], line, *GOOD[row + 1 :]]


@pytest.mark.parametrize(
    ("heading", "quantity", "unit"),
    [
        ("t_s", "t", "s"),
        ("time_ms", "t", "ms"),
        ("Time [s]", "t", "s"),
        ("p_ao_mmHg", "p_ao", "mmHg"),
        ("P_LV (kPa)", "p_lv", "kPa"),
        ("p_la_cmH2O", "p_la", "cmH2O"),
        ("Q_Ao [L/min]", "q_ao", "L_min"),
        ("q_lv_ml_s", "q_lv", "ml_s"),
        ("q_pump_ml/min", "q_pump", "ml_min"),
        ("q_pump_m3_s", "q_pump", "m3_s"),
        ("v_lv_ml", "v_lv", "ml"),
    ],
)
def test_a_heading_is_a_quantity_and_a_unit(heading, quantity, unit):
    assert parse_heading(heading) == (quantity, unit)


@pytest.mark.parametrize(
    "heading", ["protocol", "p_ao", "p_mmHg", "q_s", "temperature_C", "", "t", "p_ao_furlong"]
)
def test_other_headings_are_not(heading):
    assert parse_heading(heading) is None


def test_numbers_come_in_cgs(tmp_path):
    lines = ["Time [ms];P_Ao [kPa];Q_Ao [L/min];note", *(f"{10 * k};{10 + k};{k};x" for k in range(6))]
    waves = read_waveforms(table(tmp_path, ["# a remark", *lines]))
    assert np.allclose(waves.t, 0.01 * np.arange(6))
    assert np.allclose(waves["p_ao"], (10 + np.arange(6)) * KILOPASCAL)
    assert np.allclose(waves["q_ao"], np.arange(6) * LITRE_PER_MINUTE)
    assert waves.rows[0] == 3
    assert len(waves.origin["sha256"]) == 64
    assert waves.notes == ("record.csv: columns not used: note",)


def test_columns_can_be_pointed_out(tmp_path):
    lines = ["T,Pressure,flow (ml/s)", *(f"{0.01 * k},{10 + k},{k}" for k in range(6))]
    path = table(tmp_path, lines)
    columns = {"t": "T:s", "p_ao": "Pressure:kPa", "q_ao": "flow (ml/s):ml/s"}
    waves = read_waveforms(path, columns=columns)
    assert waves["p_ao"][0] == pytest.approx(10 * KILOPASCAL)
    with pytest.raises(CaseError, match="did you mean Pressure"):
        read_waveforms(path, columns={**columns, "p_ao": "Presure:kPa"})
    with pytest.raises(CaseError, match="no unit of pressure"):
        read_waveforms(path, columns={**columns, "p_ao": "Pressure"})
    with pytest.raises(CaseError, match="unknown unit 'stone'"):
        read_waveforms(path, columns={**columns, "p_ao": "Pressure:stone"})


def test_what_is_written_reads_back(tmp_path):
    waves = read_waveforms(table(tmp_path, GOOD))
    again = read_waveforms(write_waveforms(waves, tmp_path / "again.csv", ["origin: a test"]))
    assert np.allclose(again.t, waves.t)
    assert all(np.allclose(again[name], waves[name], rtol=1e-9) for name in waves.values)


@pytest.mark.parametrize(
    ("lines", "place", "reason"),
    [
        ([], "", "expected a header and rows"),
        (GOOD[:1], "", "expected a header and rows"),
        (GOOD[:2], "", "1 samples"),
        (["a,b", "1,2"], "", "no column of times, such as t_s; no pressure or flow"),
        (
            changed(5, "0.04,1e12,12"),
            "row 6, column p_ao_mmHg",
            "no flow loop has this pressure, at most 7.5e+05 mmHg",
        ),
        ([line.split(",")[0] for line in GOOD], "", "no pressure or flow"),
        (changed(0, "t_s,p_ao_mmHg,p_ao_kPa"), "column p_ao", "is there twice"),
        (changed(0, "t_s,p_ao_mmHg,q_ao_gallons"), "column q_ao_gallons", "unknown unit 'gallons'"),
        (changed(0, "t_s,p_ao,q_ao_ml_s"), "column p_ao", "no unit"),
        (changed(0, "t_h,p_ao_mmHg,q_ao_ml_s"), "column t_h", "unknown unit"),
        (changed(5, "0.04,,12"), "row 6, column p_ao_mmHg", "= '': expected a number"),
        (changed(5, "0.04,nan,12"), "row 6, column p_ao_mmHg", "= 'nan': expected a finite number"),
        (changed(5, "0.04,84,twelve"), "row 6, column q_ao_ml_s", "= 'twelve': expected a number"),
        (changed(5, "0.04,84,inf"), "row 6, column q_ao_ml_s", "= 'inf': expected a finite number"),
        (changed(5, "0.04,84"), "row 6", "expected 3 cells"),
        (changed(5, "0.02,84,12"), "row 6, column t_s", "does not increase"),
        (changed(5, "0.03,84,12"), "row 6, column t_s", "does not increase"),
        ([*GOOD, "0.5,90,30"], "row 14, column t_s", "gap of 0.39 s"),
        (changed(5, '0.04,"84,12'), "row 6", "cannot split this row"),
    ],
)
def test_a_bad_file_is_refused_by_row_and_column(tmp_path, lines, place, reason):
    with pytest.raises(CaseError) as caught:
        read_waveforms(table(tmp_path, lines))
    message = str(caught.value)
    assert "record.csv" in message
    assert place in message
    assert reason in message
    assert "\n" not in message


@pytest.mark.parametrize(
    "name", ["p_ao_sd", "sd_p_ao", "p_ao_sd_mmHg", "SD P_Ao (mmHg)", "p_ao_std", "q_ao_err", "SEM"]
)
def test_a_column_of_standard_deviations_is_passed_over_with_a_note(tmp_path, name):
    lines = [f"{GOOD[0]},{name}", *(f"{line},0.5" for line in GOOD[1:])]
    waves = read_waveforms(table(tmp_path, lines))
    assert set(waves.values) == {"p_ao", "q_ao"}
    assert waves.notes == (f"record.csv: columns not used: {name}",)


def test_a_gap_can_be_accepted(tmp_path):
    assert len(read_waveforms(table(tmp_path, [*GOOD, "0.5,90,30"]), gaps=True).t) == 13


def test_a_file_that_is_not_there_or_not_text_is_refused(tmp_path):
    with pytest.raises(CaseError, match="cannot read this file"):
        read_waveforms(tmp_path / "none.csv")
    path = tmp_path / "picture.csv"
    path.write_bytes(bytes(range(128, 256)))
    with pytest.raises(CaseError, match="not a text file"):
        read_waveforms(path)


def test_what_is_missing_is_said_with_an_example(tmp_path):
    waves = read_waveforms(table(tmp_path, GOOD))
    with pytest.raises(
        CaseError, match=r"missing is q_lv \(flow, a column such as q_lv_ml_s\).*p_ao_mmHg, q_ao_ml_s"
    ):
        waves.require(["q_lv", "p_ao"], "this circuit")


def test_a_flow_can_be_turned_round_and_a_pressure_not(tmp_path):
    waves = read_waveforms(table(tmp_path, GOOD))
    assert np.array_equal(waves.flipped(["q_ao"])["q_ao"], -waves["q_ao"])
    with pytest.raises(CaseError, match="expected a flow"):
        waves.flipped(["p_ao"])


def test_pressure_units_agree_with_one_another(tmp_path):
    sizes = {"mmHg": 1.0, "Pa": MMHG / 10, "kPa": MMHG / 1e4, "dyn_cm2": MMHG, "cmH2O": MMHG / 980.665}
    for unit, size in sizes.items():
        lines = [f"t_s,p_ao_{unit}", *(f"{k},{100 * size!r}" for k in range(5))]
        assert read_waveforms(table(tmp_path, lines))["p_ao"][0] == pytest.approx(100 * MMHG, rel=1e-12)


@pytest.mark.parametrize(
    ("name", "sizes"),
    [
        (
            "q_ao",
            {
                "ml_s": 100.0,
                "cm3_s": 100.0,
                "ml_min": 6000.0,
                "L_min": 6.0,
                "lpm": 6.0,
                "l_s": 0.1,
                "m3_s": 1e-4,
            },
        ),
        ("v_lv", {"ml": 100.0, "cm3": 100.0, "l": 0.1, "m3": 1e-4}),
        ("p_ao", {"torr": 100 / MMHG, "mbar": 0.1, "bar": 1e-4, "Pa": 10.0}),
    ],
)
def test_units_of_a_kind_agree_with_one_another(tmp_path, name, sizes):
    for unit, size in sizes.items():
        lines = [f"t_min,{name}_{unit}", *(f"{k},{size!r}" for k in range(5))]
        waves = read_waveforms(table(tmp_path, lines))
        assert waves[name][0] == pytest.approx(100.0, rel=1e-12)
        assert waves.t[1] == 60.0


def test_damaged_files_never_end_in_a_traceback(tmp_path):
    hypothesis = pytest.importorskip("hypothesis")
    st = hypothesis.strategies
    text = "\n".join(GOOD)
    pieces = ["", ",", ";", "\n", "nan", "-", "1e999", '"', "#", "\t", "é", "q_ao_ml_s", "0.03", "\x00"]

    cuts = st.lists(
        st.tuples(st.integers(0, len(text)), st.integers(0, 9), st.sampled_from(pieces)),
        min_size=1,
        max_size=4,
    )

    @hypothesis.settings(max_examples=300, deadline=None, database=None, derandomize=True)
    @hypothesis.given(cuts)
    def damage(cuts):
        damaged = text
        for at, length, put in cuts:
            damaged = damaged[:at] + put + damaged[at + length :]
        path = tmp_path / "damaged.csv"
        path.write_text(damaged, encoding="utf-8")
        said = ""
        try:
            waves = read_waveforms(path)
        except CaseError as error:
            said = str(error)
        if said:
            assert "damaged.csv" in said
            assert "\n" not in said
        else:
            assert all(np.isfinite(array).all() for array in waves.values.values())
            assert (np.diff(waves.t) > 0).all()

    damage()


def test_values_that_nothing_reaches_are_refused(tmp_path):
    for line, column in (
        ("0.05,1e12,15", "p_ao_mmHg"),
        ("0.05,85,-1e12", "q_ao_ml_s"),
        ("1e12,85,15", "t_s"),
    ):
        with pytest.raises(CaseError, match=f"row 7, column {column}.* (plausible|gap|increase)"):
            read_waveforms(table(tmp_path, changed(6, line)))


def test_decimal_commas_are_read_when_that_is_said(tmp_path):
    lines = [line.replace(",", ";").replace(".", ",") for line in GOOD]
    waves, plain = read_waveforms(table(tmp_path, lines), decimal=","), read_waveforms(table(tmp_path, GOOD))
    np.testing.assert_array_equal(waves.t, plain.t)
    np.testing.assert_array_equal(waves["p_ao"], plain["p_ao"])
    with pytest.raises(CaseError, match="--decimal comma reads commas"):
        read_waveforms(table(tmp_path, lines))


def test_all_headings_that_are_not_there_are_named_at_once(tmp_path):
    path = table(tmp_path, GOOD)
    with pytest.raises(CaseError, match="column P1, Q1: no such column"):
        read_waveforms(path, columns={"p_lv": "P1:kPa", "q_lv": "Q1:ml_s"})
