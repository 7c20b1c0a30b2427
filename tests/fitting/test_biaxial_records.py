"""Reading biaxial tests: names, units, measures, several files; whatever is wrong is named by file, row, column."""

from __future__ import annotations

import numpy as np
import pytest
from biaxial_synthetic import records_of as synthetic
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as some

from valvefsi.errors import CaseError, ValvefsiError
from valvefsi.fitting.biaxial import fit_biaxial
from valvefsi.fitting.biaxial_records import Reading, read_biaxial
from valvefsi.fitting.planar import LeeSacks

pytestmark = pytest.mark.serial  # nothing in it runs in parallel

GOOD = "protocol,stretch1,stretch2,P11_kPa,P22_kPa\n1,1,1,0,0\n1,1.1,1.1,4,5\n1,1.2,1.2,9,12\n"


def written(tmp_path, text, name="data.csv"):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("header", "measure", "factor"),
    [
        ("stretch1,stretch2,PK1_1_kPa,PK1_2_kPa", "pk1", 1.0),
        ("lambda1;lambda2;P11 [MPa];P22 [MPa]", "pk1", 1e3),
        ("Stretch_1\tStretch_2\tS11 (Pa)\tS22 (Pa)", "pk2", 1e-3),
        ("lam1,lam2,sigma11_dyn_cm2,sigma22_dyn_cm2", "cauchy", 1e-4),
        ("F11 F22 cauchy1_mmHg cauchy2_mmHg", "cauchy", 0.13332236842105262),
        ("stretch1,stretch2,PK2_1_N/mm^2,PK2_2_N/mm^2", "pk2", 1e3),
        ("stretch1,stretch2,tension1_N_m,tension2_N_m", "pk1", 1 / 0.4),
        ("stretch1,stretch2,T11_dyn_cm,T22_dyn_cm", "pk1", 1e-3 / 0.4),
    ],
)
def test_columns_are_known_by_name_and_unit(tmp_path, header, measure, factor):
    mark = next((m for m in ",;\t" if m in header), " ")
    rows = [["1", "1", "0", "0"], ["1.1", "1.2", "3", "4"], ["1.2", "1.3", "7", "9"]]
    text = "# a remark\n" + header + "\n" + "\n".join(mark.join(row) for row in rows) + "\n"
    data = read_biaxial(written(tmp_path, text), Reading(thickness=0.04))
    assert data.measure == measure
    np.testing.assert_allclose(data.stress, factor * np.array([[0, 0], [3, 4], [7, 9]]), rtol=1e-12)
    np.testing.assert_allclose(data.F[2], np.diag([1.2, 1.3]))
    assert not data.shear


def test_strains_become_stretches_and_a_shear_strain_a_deformation_without_rotation(tmp_path):
    E = np.array([[0.2, 0.05], [0.05, 0.1]])
    text = f"E11,E22,E12,S11_kPa,S22_kPa,S12_kPa\n0,0,0,0,0,0\n{E[0, 0]},{E[1, 1]},{E[0, 1]},5,4,1\n"
    data = read_biaxial(written(tmp_path, text))
    F = data.F[1]
    np.testing.assert_allclose(F.T @ F, np.eye(2) + 2 * E, atol=1e-14)
    np.testing.assert_allclose(F, F.T)
    assert data.components == ("11", "22", "12")
    assert data.shear
    assert any("without rotation" in note for note in data.notes)
    percent = read_biaxial(written(tmp_path, "E11_percent,E22_percent,S11_kPa,S22_kPa\n0,0,0,0\n20,10,5,4\n"))
    np.testing.assert_allclose(percent.F[1], np.diag(np.sqrt([1.4, 1.2])))


def test_engineering_strain_is_the_stretch_less_one_and_engineering_stress_the_first_piola_kirchhoff(
    tmp_path,
):
    text = "nominal_strain1_percent,eng_strain2_percent,eng_stress1_kPa,eng_stress2_kPa\n0,0,0,0\n20,10,5,4\n"
    data = read_biaxial(written(tmp_path, text))
    np.testing.assert_allclose(data.F[1], np.diag([1.2, 1.1]))
    assert (data.measure, data.stress[1].tolist()) == ("pk1", [5.0, 4.0])


def test_a_strain_of_no_kind_is_greens_and_that_is_said(tmp_path):
    data = read_biaxial(written(tmp_path, "strain1,strain2,S11_kPa,S22_kPa\n0,0,0,0\n0.2,0.1,5,4\n"))
    np.testing.assert_allclose(data.F[1], np.diag(np.sqrt([1.4, 1.2])))
    assert any("taken as Green strain" in note for note in data.notes)
    named = read_biaxial(written(tmp_path, "E11,E22,S11_kPa,S22_kPa\n0,0,0,0\n0.2,0.1,5,4\n"))
    assert named.notes == ()


def test_forces_over_the_unloaded_sections_are_first_piola_kirchhoff_stress(tmp_path):
    """1.2 N over 6 mm^2 are 200 kPa, 900 mN over 4.5 mm^2 the same."""
    text = "stretch1,stretch2,force1_N,Load2 [mN]\n1,1,0,0\n1.1,1.2,1.2,900\n"
    data = read_biaxial(written(tmp_path, text), Reading(areas=(0.06, 0.045)))
    np.testing.assert_allclose(data.stress, [[0, 0], [200, 200]])
    assert data.measure == "pk1"
    assert any("force over 6 and 4.5 mm^2" in note for note in data.notes)
    both = read_biaxial(
        written(
            tmp_path,
            GOOD.replace("P22_kPa", "P22_kPa,force1_N")
            .replace("\n", ",1\n")
            .replace("force1_N,1", "force1_N"),
        )
    )
    assert both.notes == ("data.csv: columns not used: force1_N",)
    assert both.stress.max() == 12


def test_decimal_commas_are_read_when_that_is_said_and_named_when_not(tmp_path):
    path = written(tmp_path, GOOD.replace(",", ";").replace(".", ","))
    data = read_biaxial(path, Reading(decimal=","))
    np.testing.assert_array_equal(data.stress, read_biaxial(written(tmp_path, GOOD, "good.csv")).stress)
    np.testing.assert_array_equal(data.F[2], np.diag([1.2, 1.2]))
    with pytest.raises(CaseError, match=r"row 3, column stretch1 = '1,1': .*--decimal comma reads commas"):
        read_biaxial(path)
    with pytest.raises(CaseError, match=r"row 3, column stretch1 = '1\.1': expected a decimal comma"):
        read_biaxial(written(tmp_path, GOOD.replace(",", ";")), Reading(decimal=","))


def test_all_headings_that_are_not_there_are_named_at_once(tmp_path):
    with pytest.raises(CaseError, match="column = 'lx, ly': no such columns"):
        read_biaxial(written(tmp_path, GOOD), Reading(columns={"stretch1": "lx", "stretch2": "ly"}))


def test_the_whole_deformation_gradient_is_read(tmp_path):
    text = "F11,F12,F21,F22,P11_kPa,P22_kPa\n1,0,0,1,0,0\n1.1,0.05,0.02,1.2,3,4\n"
    np.testing.assert_array_equal(read_biaxial(written(tmp_path, text)).F[1], [[1.1, 0.05], [0.02, 1.2]])


@pytest.mark.parametrize(
    ("size", "unit", "factor"), [(80.0, "kPa", 1.0), (0.5, "MPa", 1e3), (8e4, "Pa", 1e-3)]
)
def test_a_unit_that_is_not_given_is_inferred_and_said(tmp_path, size, unit, factor):
    text = f"stretch1,stretch2,P11,P22\n1,1,0,0\n1.1,1.1,{size / 2},{size / 2}\n1.2,1.2,{size},{size}\n"
    path = written(tmp_path, text)
    data = read_biaxial(path)
    assert data.stress.max() == pytest.approx(size * factor)
    assert any(f"{unit} inferred" in note for note in data.notes)
    assert read_biaxial(path, Reading(unit="mmHg")).stress.max() == pytest.approx(0.133322 * size, rel=1e-5)


def test_columns_can_be_mapped_and_others_are_said_to_be_ignored(tmp_path):
    path = written(tmp_path, "lx,ly,fx,fy,when\n1,1,0,0,1\n1.1,1.1,5,6,2\n1.2,1.2,11,13,3\n")
    names = {"stretch1": "lx", "stretch2": "ly", "P11_kPa": "fx", "P22_kPa": "fy"}
    data = read_biaxial(path, Reading(columns=names))
    assert data.stress.max() == 13
    assert data.notes == ("data.csv: columns not used: when",)


def test_a_column_of_standard_deviations_is_passed_over(tmp_path):
    text = GOOD.replace("P22_kPa", "P22_kPa,P11_sd,sd_P22_kPa").replace(",0,0\n", ",0,0,9,9\n")
    text = text.replace(",4,5\n", ",4,5,9,9\n").replace(",9,12\n", ",9,12,9,9\n")
    data = read_biaxial(written(tmp_path, text))
    np.testing.assert_array_equal(data.stress, [[0, 0], [4, 5], [9, 12]])
    assert data.notes == ("data.csv: columns not used: P11_sd, sd_P22_kPa",)


def test_several_files_and_protocols_keep_their_names(tmp_path):
    one, two = written(tmp_path, GOOD, "a.csv"), written(tmp_path, GOOD.replace("\n1,", "\n2,"), "b.csv")
    data = read_biaxial([one, two])
    assert data.names == ("a:1", "b:2")
    assert data.select(["b:2"]).F.shape == (3, 2, 2)
    with pytest.raises(CaseError, match=r"protocols = '7'.*a:1, b:2"):
        data.select(["7"])
    plain = written(tmp_path, GOOD.replace("protocol,", "").replace("\n1,", "\n"), "c.csv")
    assert read_biaxial(plain).names == ("1",)


BAD = [
    ("stretch1,P11_kPa\n1,0\n1.1,1\n", "columns missing: stretch2 and P22"),
    ("stretch1,stretch2,P11_kPa\n1,1,0\n1.1,1.1,1\n", "columns missing: P22"),
    ("stretch1,stretch2\n1,1\n1.1,1.1\n", r"columns missing: the stress \(PK1_1"),
    ("P11_kPa,P22_kPa\n1,1\n1.1,1.1\n", r"columns missing: the deformation \(stretch1"),
    (GOOD.replace("stretch2", "stretch1"), "row 1, column stretch1: two columns have this name"),
    (GOOD.replace("stretch2", "lambda1"), "row 1, column lambda1: the same quantity as column stretch1"),
    (
        GOOD.replace("P22_kPa", "P22_furlong"),
        "row 1, column P22_furlong: unknown unit furlong, expected one of pa",
    ),
    (GOOD.replace("P22_kPa", "S22_kPa"), "one measure of stress, found pk1 and pk2"),
    (GOOD.replace(",12", ",nan"), "row 4, column P22_kPa = 'nan': expected a finite number"),
    (GOOD.replace(",12", ",inf"), "row 4, column P22_kPa = 'inf': expected a finite number"),
    (GOOD.replace(",12", ","), "row 4, column P22_kPa = '': expected a number"),
    (GOOD.replace(",12", ",x"), "row 4, column P22_kPa = 'x': expected a number"),
    (GOOD.replace(",9,12", ",9"), "row 4: expected 5 cells as in the header, found 4"),
    (GOOD + "2,1.1,1.1,4,4\n", "row 5: protocol 2 has one point"),
    (GOOD.replace("1,1.2,1.2", ",1.2,1.2"), "row 4, column protocol: expected the name of a protocol"),
    (GOOD.replace("1.2,1.2", "-1.2,1.2"), "row 4, column stretch1: a stretch must be positive"),
    (GOOD.replace("1.2,1.2", "120,1.2"), "row 4, column stretch1 = 120.0: .*percent"),
    (GOOD.replace("9,12", "1,12"), "row 4, column P11_kPa: stress falls while stretched, protocol 1"),
    (GOOD.replace("1.1,1.1", "0.9,0.9"), "row 3, column P11_kPa: tension while slack, protocol 1"),
    ("stretch1,stretch2,P11_kPa,P22_kPa\n1,1,0,0\n1.1,1.1,0,0\n", "the stress is zero throughout"),
    (
        GOOD.replace("P11_kPa", "tension1").replace("P22_kPa", "tension2"),
        "thickness: tensions need the thickness",
    ),
    (
        GOOD.replace("P11_kPa", "force1_N").replace("P22_kPa", "force2_N"),
        "area: forces need the unloaded sections",
    ),
    (GOOD.replace("P11_kPa", "force1").replace("P22_kPa", "force2"), "unit: forces need a unit"),
    ("eng_strain1,eng_strain2,P11_kPa,P22_kPa\n0,0,0,0\n20,10,5,4\n", "column eng_strain1 = 20.0: .*percent"),
    (
        "eng_strain1,eng_strain2,P11_kPa,P22_kPa\n0,0,0,0\n-1,0.1,5,4\n",
        "an engineering strain must exceed -1",
    ),
    (
        "E11,E22,S11_kPa,S22_kPa\n0,0,0,0\n-0.6,0.1,1,1\n",
        "row 3, column E11: a Green strain must exceed -1/2",
    ),
    ("E11,E22,E12,S11_kPa,S22_kPa\n0,0,0,0,0\n0,0,0.7,1,1\n", "row 3: these strains leave no length"),
    ("F11,F12,F21,F22,P11_kPa,P22_kPa\n1,0,0,1,0,0\n1,1,1,1,5,5\n", "row 3, det F = 0.0: .*no usable area"),
    ("protocol,P11_kPa\n1,1\n1,5\n", r"columns missing: P22 and the deformation \(stretch1"),
    (GOOD.replace("9,12", "9,1e12"), r"row 4, column P22_kPa = 1000000000000.0: no tissue bears this"),
    (GOOD.replace("1.1,1.1", "1,1").replace("1.2,1.2", "1,1"), "the deformation does not change"),
    ("", "expected a header and rows"),
    ("stretch1,stretch2\n", "expected a header and rows"),
    ("a\0b,c\n1,2\n", "not a text file"),
]


@pytest.mark.parametrize(("text", "said"), BAD, ids=[said[:60] for _, said in BAD])
def test_what_is_wrong_is_named_by_file_row_and_column(tmp_path, text, said):
    with pytest.raises(CaseError, match=said) as caught:
        read_biaxial(written(tmp_path, text))
    assert str(caught.value).startswith(str(tmp_path / "data.csv"))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("header", "row", "said"),
    [
        ("eng_strain1,eng_strain2", "8,6", r"row 3, column eng_strain1 = 8\.0: .*eng_strain1 \[%\]"),
        ("E11,E22", "0.2,-5", r"column E22 = -5\.0: .*percent.*'E22_percent=E22'"),
        ("E11,E22,E12", "0.2,0.2,2", r"column E12 = 2\.0: .*E12 \[%\]"),
        ("lambda1,lambda2", "1.2,4", r"column lambda2 = 4\.0: .*stretch2 \[1\]"),
    ],
)
def test_a_strain_too_large_for_a_fraction_needs_a_unit(tmp_path, header, row, said):
    rest = "1,1\n" if header.startswith("lambda") else ",".join("0" * (header.count(",") + 1)) + "\n"
    lines = [
        f"{header},S11_kPa,S22_kPa",
        *(f"{cells},{k},{k}" for k, cells in enumerate((rest.strip(), row))),
    ]
    with pytest.raises(CaseError, match=said) as caught:
        read_biaxial(written(tmp_path, "\n".join(lines) + "\n"))
    assert str(caught.value).startswith(str(tmp_path / "data.csv"))


def test_a_heading_or_an_option_says_what_a_large_strain_is(tmp_path):
    text = "eng_strain1,eng_strain2,P11_kPa,P22_kPa\n0,0,0,0\n2,1.5,5,4\n"
    option = {f"eng_strain{k}_percent": f"eng_strain{k}" for k in (1, 2)}
    percent = read_biaxial(written(tmp_path, text), Reading(columns=option))
    np.testing.assert_allclose(percent.F[1], np.diag([1.02, 1.015]))
    for fraction in ("eng_strain1 [1],eng_strain2 [-]", "eng_strain1_1,eng_strain2_-"):
        headed = text.replace("eng_strain1,eng_strain2", fraction)
        np.testing.assert_allclose(read_biaxial(written(tmp_path, headed)).F[1], np.diag([3.0, 2.5]))


def test_what_looks_wrong_is_only_noted_when_accepted(tmp_path):
    path = written(tmp_path, GOOD.replace("9,12", "1,12"))
    data = read_biaxial(path, Reading(accept_suspect=True))
    assert any("row 4, column P11_kPa: stress falls while stretched" in note for note in data.notes)


def test_files_that_cannot_be_read_are_named(tmp_path):
    with pytest.raises(CaseError, match=r"nothing\.csv: cannot read this file: No such file"):
        read_biaxial(tmp_path / "nothing.csv")
    with pytest.raises(CaseError, match="cannot read this file"):
        read_biaxial(tmp_path)
    (tmp_path / "picture.csv").write_bytes(b"\x89PNG\xff\xfe\x00")
    with pytest.raises(CaseError, match="not a text file"):
        read_biaxial(tmp_path / "picture.csv")
    for encoding, said in (("utf-16", "it is in UTF-16"), ("latin-1", "it may be in another encoding")):
        (tmp_path / "record.csv").write_bytes("µ,stretch1\n1,1\n".encode(encoding))
        with pytest.raises(CaseError, match=f"not a text file in UTF-8; {said}: save it as CSV in UTF-8"):
            read_biaxial(tmp_path / "record.csv")
    with pytest.raises(CaseError, match="no file given"):
        read_biaxial([])


WORDS = some.sampled_from(
    ["stretch1", "stretch2", "E11", "E22", "E12", "F11", "F12", "F22", "P11_kPa", "P22_kPa", "S11", "S22"]
    + [
        "sigma11_Pa",
        "tension1",
        "tension2 [N/m]",
        "P11_[",
        "protocol",
        "x",
        "",
        "stretch3",
        "P22_furlong",
        "é",
    ]
)
CELLS = some.one_of(
    some.floats(-2, 200, allow_nan=False).map(repr),
    some.sampled_from(
        ["", "nan", "-inf", "1e999", "1", "1.0", "1,2", '"', "#", "1;2", "\t", "abc", "1e-320", "٣"]
    ),
)
QUICK = [Phase.explicit, Phase.generate]
FUZZ = settings(
    max_examples=250,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)


@FUZZ
@given(
    header=some.lists(WORDS, min_size=1, max_size=6),
    rows=some.lists(some.lists(CELLS, max_size=6), max_size=6),
)
def test_no_table_of_nonsense_gives_a_traceback(tmp_path, header, rows):
    said = ""
    text = ",".join(header) + "\n" + "\n".join(",".join(row) for row in rows) + "\n"
    try:
        read_biaxial(written(tmp_path, text), Reading(thickness=0.04))
    except CaseError as error:
        said = str(error)  # nothing but a CaseError leaves it
    assert "\n" not in said


@FUZZ
@given(raw=some.binary(max_size=200))
def test_no_file_of_nonsense_gives_a_traceback(tmp_path, raw):
    (tmp_path / "data.csv").write_bytes(raw)
    with pytest.raises(CaseError):
        read_biaxial(tmp_path / "data.csv")


@settings(FUZZ, max_examples=25, phases=QUICK)
@given(
    one=some.lists(some.floats(0.5, 3), min_size=2, max_size=6),
    stress=some.lists(some.floats(-1e3, 1e4), min_size=12, max_size=12),
    model=some.sampled_from(["hgo", "lee_sacks", "fung", "may_newman_yin", "neo_hookean", "mooney_rivlin"]),
)
def test_no_numbers_make_a_fit_fail_without_saying_why(tmp_path, one, stress, model):
    rows = [
        f"{s!r},{1 + 0.5 * (s - 1)!r},{a!r},{b!r}" for s, a, b in zip(one, stress, stress[6:], strict=False)
    ]
    path = written(tmp_path, "stretch1,stretch2,P11_kPa,P22_kPa\n" + "\n".join(rows) + "\n")
    try:
        found = fit_biaxial(path, model, reading=Reading(accept_suspect=True), starts=2)
    except ValvefsiError:
        return
    found.report.as_dict()
    found.summary()


def test_options_that_make_no_sense_are_named(tmp_path):
    data = synthetic(LeeSacks(), [5.0, 3.0, 6.0])
    for options, said in [
        ({"families": "3"}, "families = '3': expected one of 1, 2, 2-kappas, symmetric"),
        ({"weights": "heavy"}, "weights = 'heavy'"),
        ({"loss": "squares"}, "loss = 'squares'"),
        ({"starts": 0}, "starts = 0"),
        ({"fix": {"kappa": 0.1}}, "kappa: no such parameter of lee_sacks, expected one of c0, c1, c2"),
        ({"fix": {"c0": -1.0}}, "fix c0 = -1.0: expected a number that is not negative"),
        ({"bounds": {"c0": (2.0, 1.0)}}, "c0 = .*larger upper bound"),
        ({"protocols": ["9"]}, "protocols = '9': no such protocol"),
        ({"protocols": []}, "name at least one protocol"),
        ({"angle": 3}, "angle: unknown option"),
        ({"fibre_angle": float("nan")}, "fibre_angle = nan"),
    ]:
        with pytest.raises(CaseError, match=said):
            fit_biaxial(data, "lee_sacks", **options)
    with pytest.raises(CaseError, match=r"model = 'ogden'.*expected one of hgo"):
        fit_biaxial(data, "ogden")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (GOOD.replace("1.1,1.1", "1,1").replace("1.2,1.2", "1,1"), "the deformation does not change"),
        (GOOD.replace("9,12", "9,1e12"), r"row 4, column P22_kPa = 1000000000000.0: no tissue bears this"),
    ],
)
def test_what_no_test_of_tissue_gives_is_refused(tmp_path, text, said):
    with pytest.raises(CaseError, match=said):
        read_biaxial(written(tmp_path, text))


def test_columns_of_scatter_are_passed_over_with_a_note(tmp_path):
    lines = GOOD.splitlines()
    text = "\n".join([lines[0] + ",P11_sd,sd_P22_kPa", *(f"{line},1,1" for line in lines[1:])])
    assert any("P11_sd, sd_P22_kPa" in note for note in read_biaxial(written(tmp_path, text)).notes)
