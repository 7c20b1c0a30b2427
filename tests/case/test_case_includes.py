"""Tables of a case file that stand in files of their own."""

from __future__ import annotations

import pytest

from valvefsi.case import load_case
from valvefsi.errors import CaseError

CASE = """
[grid]
lower = [0, 0]
upper = [40, 40]
cells = [32, 32]
[time]
dt = 0.01
t_end = 1.0
[[solid]]
name = "block"
mesh = { shape = "rectangle", lower = [10, 15], size = [20, 10], elements = [4, 2] }
material = { include = "material.toml" }
"""


@pytest.fixture
def file(tmp_path):
    (tmp_path / "case.toml").write_text(CASE)
    (tmp_path / "material.toml").write_text('model = "neo_hookean"\nc1 = "8 Pa"\n')
    return tmp_path / "case.toml"


def test_an_included_table_is_read_beside_the_case(file):
    assert load_case(file).solid[0].material.parameters["c1"] == pytest.approx(80.0)


def test_keys_beside_the_include_and_overrides_come_over_it(file):
    file.write_text(CASE.replace('"material.toml" }', '"material.toml", c1 = 50.0 }'))
    assert load_case(file).solid[0].material.parameters["c1"] == 50.0
    assert load_case(file, ["solid.block.material.c1=20"]).solid[0].material.parameters["c1"] == 20.0


def test_includes_may_include(file):
    (file.parent / "material.toml").write_text('include = "deeper.toml"\nc1 = 7.0\n')
    (file.parent / "deeper.toml").write_text('model = "neo_hookean"\nc1 = 1.0\n')
    assert load_case(file).solid[0].material.parameters["c1"] == 7.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            CASE.replace("material.toml", "materiel.toml"),
            r"case.toml: solid.0.material.include = 'materiel.toml': no such file; did you mean 'material.toml'",
        ),
        (CASE.replace('"material.toml"', "3"), "expected the path of a TOML file"),
    ],
)
def test_a_wrong_include_is_one_clear_error(file, text, message):
    file.write_text(text)
    with pytest.raises(CaseError, match=message) as caught:
        load_case(file)
    assert "\n" not in str(caught.value)


def test_broken_and_circular_files_are_named(file):
    (file.parent / "material.toml").write_text("model = ")
    with pytest.raises(CaseError, match=r"material.toml: not TOML"):
        load_case(file)
    (file.parent / "material.toml").write_text('include = "material.toml"')
    with pytest.raises(CaseError, match="in a circle"):
        load_case(file)
