"""The architecture's rules, checked on the syntax tree of the package: layers, fences, sizes."""

from __future__ import annotations

import ast
import re
from pathlib import Path, PurePosixPath

import pytest

from tests.conftest import ONE_RANK

PACKAGE = Path(__file__).parents[1] / "valvefsi"
TESTS = Path(__file__).parent
FILES = sorted(PACKAGE.rglob("*.py"))

# From the bottom to the top; the parts of one layer never import one another.
LAYERS = [
    {"types", "units", "errors"},
    {"verification"},
    {"runtime"},
    {"grid"},
    {"fluid", "solid", "coupling", "circulation", "geometry", "io"},
    {"bodies"},
    {"fsi"},
    {"post"},
    {"run"},
    {"case"},
    {"benchmarks", "fitting"},
    {"studies", "report"},
    {"cli"},
    {"scripting"},
    {"__main__"},
]
LEVEL = {part: level for level, parts in enumerate(LAYERS) for part in parts}

# The same inside packages, of what has its place there.
INSIDE = {
    "solid": [
        {"loads", "newton"},
        {"materials"},
        {"elements", "moving_tether"},
        {"statics"},
        {"structure", "stress", "peaks", "moving_solid"},
        {"dynamics", "shell_stress"},
        {"structure_stress"},
    ],
    "post": [
        {"diagnostics", "valve_record"},
        {"slices"},
        {"valve_times", "plots", "coaptation", "flutter", "leaflet_places"},
        {"valve_numbers"},
        {"valve_phases"},
        {"movies"},
    ],
    "studies": [
        {"members", "stages", "bench_start", "comparison", "polynomial_chaos", "sobol_design", "figure_runs"},
        {"runner", "loop_stages"},
        {"planning", "sweep", "beats", "sample_inputs", "circuit_samples", "figures"},
        {"sweep_picture", "validation", "grid_study"},
        {"dependence"},
        {"grid_numbers", "grid_report", "sampling"},
        {"sample_runs", "sample_report", "static_samples"},
    ],
    "report": [
        {"blocks", "runs", "words"},
        {"geometry", "inputs", "results", "evidence", "writing"},
        {"scenes", "others"},
        {"compared", "live", "members"},
        {"grids", "samples"},
        {"folders", "serving"},
    ],
    "benchmarks": [
        {"options", "references", "results"},
        {"frame"},
        {"running"},
        {"statics", "flows"},
        {"immersed"},
        {"studies"},
    ],
}

KERNELS = (
    "runtime/compiled.py",
    "fluid/stencils.py",
    "fluid/advection.py",
    "fluid/*kernels*.py",
    "coupling/*kernels.py",
    "bodies/*kernels*.py",
    "solid/elements/*kernels*.py",
)
FORMS = (
    "types.py",
    "solid/*",
    "solid/*/*",
    "io/*",
    "geometry/*",
    "benchmarks/flows/fitted.py",
    "runtime/dolfinx_compat.py",
)
BORDER = ("case.py", "case/*", "cli.py", "cli/*")
FENCES = {
    **dict.fromkeys(("ufl", "dolfinx", "basix", "ffcx"), FORMS),
    "petsc4py": (*FORMS, "fluid/*"),
    "dolfinx_solver": ("runtime/dolfinx_compat.py",),
    "numba": KERNELS,
    "gmsh": ("geometry/*",),
    "SALib": ("studies/sobol_design.py",),
    **dict.fromkeys(("jinja2", "plotly"), ("report/*",)),
    **dict.fromkeys(("pydantic", "pint", "typer", "rich"), BORDER),
}
MODULE_LINES, FUNCTION_LINES, KERNEL_LINES, ARGUMENTS = 450, 40, 60, 8


def is_one_of(where: str, patterns: tuple[str, ...]) -> bool:
    """Return whether the file ``where`` (relative to the package) matches a pattern."""
    return any(PurePosixPath(where).match(pattern) for pattern in patterns)


def imported(node: ast.AST, where: str) -> list[str]:
    """Return the full names of the modules that an import statement may load."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if not isinstance(node, ast.ImportFrom):
        return []
    base = ["valvefsi", *PurePosixPath(where).parent.parts] if node.level else []
    base = base[: len(base) - node.level + 1] + (node.module.split(".") if node.module else [])
    return [".".join([*base, alias.name]) for alias in node.names]


def import_faults(node: ast.AST, where: str) -> list[str]:
    """Return what is wrong with an import: upwards, sideways, or over a fence."""
    faults = []
    own = PurePosixPath(where).parts[0].removesuffix(".py")
    for name in imported(node, where):
        root, part = (name.split(".") + [""])[:2]
        if (
            root == "valvefsi"
            and part in LEVEL
            and own in LEVEL
            and part != own
            and LEVEL[part] >= LEVEL[own]
        ):
            faults.append(f"{own} must not import {part}")
        if root in FENCES and not is_one_of(where, FENCES[root]):
            faults.append(f"{root} is allowed only in {', '.join(FENCES[root])}")
    if isinstance(node, ast.ImportFrom) and any(alias.name == "*" for alias in node.names):
        faults.append("import *")
    return faults


def loaded(tree: ast.AST) -> list[ast.AST]:
    """Return the nodes of a module without what is for the type checker alone."""
    nodes = []
    for node in ast.iter_child_nodes(tree):
        if not (isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)):
            nodes += [node, *loaded(node)]
    return nodes


def modules_imported(source: str, where: str, known: set[str]) -> set[str]:
    """Return which of the modules ``known`` a module of the package loads, by their full names."""
    names = {name for node in loaded(ast.parse(source)) for name in imported(node, where)}
    return {name if name in known else name.rpartition(".")[0] for name in names} & known


def inside_faults(names: set[str], where: str) -> list[str]:
    """Return which imports go upwards or sideways inside a package."""
    package, _, rest = where.partition("/")
    level = {part: k for k, parts in enumerate(INSIDE.get(package, [])) for part in parts}
    own, faults = rest.partition("/")[0].removesuffix(".py"), []
    for name in sorted(names):
        root, top, part = (name.split(".") + ["", ""])[:3]
        upward = own in level and part in level and level[part] >= level[own]
        if (root, top) == ("valvefsi", package) and part != own and upward:
            faults.append(f"{where}: {own} must not import {part}")
    return faults


def circles(imports: dict[str, set[str]]) -> list[list[str]]:
    """Return the modules in circles of imports: what is left when those that import nothing left are taken away."""
    left = {name: set(others) - {name} for name, others in imports.items()}
    for _ in range(2):  # first what leads nowhere, then what nothing leads to
        while ends := {name for name, others in left.items() if not others & left.keys()}:
            left = {name: others for name, others in left.items() if name not in ends}
        turned: dict[str, set[str]] = {name: set() for name in left}
        for name, others in left.items():
            for other in others & left.keys():
                turned[other].add(name)
        left = turned
    return [sorted(left)] if left else []


def code_lines(function: ast.FunctionDef | ast.AsyncFunctionDef, lines: list[str]) -> int:
    """Count the lines of a body without docstring, comments and blank lines."""
    body = function.body[1:] if ast.get_docstring(function) is not None else function.body
    if not body:
        return 0
    text = [line.strip() for line in lines[body[0].lineno - 1 : body[-1].end_lineno]]
    return sum(1 for line in text if line and not line.startswith("#"))


def function_faults(node: ast.AST, where: str, lines: list[str]) -> list[str]:
    """Return what is wrong with the size of a function."""
    if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        return []
    kernel, faults, given = is_one_of(where, KERNELS), [], node.args
    limit = KERNEL_LINES if kernel else FUNCTION_LINES
    if (length := code_lines(node, lines)) > limit:
        faults.append(f"{node.name} has {length} lines of code, more than {limit}")
    names = [
        a.arg for a in (*given.posonlyargs, *given.args, *given.kwonlyargs) if a.arg not in ("self", "cls")
    ]
    if len(names) > ARGUMENTS and not kernel:
        faults.append(f"{node.name} takes {len(names)} arguments, more than {ARGUMENTS}")
    return faults


def faults_of(source: str, where: str) -> list[str]:
    """Return everything that breaks a rule in ``source``, the text of the file ``where`` of the package."""
    lines = source.splitlines()
    faults = [f"{where}: {len(lines)} lines, more than {MODULE_LINES}"] if len(lines) > MODULE_LINES else []
    top = PurePosixPath(where).parts[0].removesuffix(".py")
    if top not in {*LEVEL, "__init__"}:
        faults.append(f"{where}: {top} has no place in the layers")
    for node in ast.walk(ast.parse(source)):
        found = import_faults(node, where) + function_faults(node, where, lines)
        if isinstance(node, ast.ExceptHandler) and node.type is None:
            found.append("except: without a type")
        faults += [f"{where}:{getattr(node, 'lineno', 0)}: {fault}" for fault in found]
    return faults


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(PACKAGE).as_posix())
def test_a_module_keeps_to_its_layer_its_fences_and_its_size(path):
    faults = faults_of(path.read_text(encoding="utf-8"), path.relative_to(PACKAGE).as_posix())
    assert not faults, "\n" + "\n".join(faults)


def test_no_modules_import_one_another_in_a_circle_or_upwards_inside_their_package():
    names = {
        ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__"): path
        for path in FILES
    }
    imports, faults = {}, []
    for name, path in names.items():
        where = path.relative_to(PACKAGE).as_posix()
        imports[name] = modules_imported(path.read_text(encoding="utf-8"), where, set(names))
        faults += inside_faults(imports[name], where)
    assert faults == []
    assert circles(imports) == []


KNOWN = {"valvefsi.solid.statics.problem", "valvefsi.solid.structure", "valvefsi.post.movies"}


@pytest.mark.parametrize(
    ("where", "source", "fault"),
    [
        (
            "solid/materials/laws.py",
            "from valvefsi.solid import structure",
            "materials must not import structure",
        ),
        (
            "solid/elements/mass.py",
            "from valvefsi.solid.statics.problem import solve",
            "elements must not import",
        ),
        (
            "post/diagnostics/lines.py",
            "def f():\n    import valvefsi.post.movies",
            "diagnostics must not import movies",
        ),
    ],
)
def test_an_import_upwards_inside_a_package_is_noticed(where, source, fault):
    assert fault in inside_faults(modules_imported(source, where, KNOWN), where)[0]
    hidden = "if TYPE_CHECKING:\n    " + source.replace("\n", "\n    ")
    assert modules_imported(hidden, where, KNOWN) == set()


def test_a_circle_of_imports_is_noticed():
    assert circles({"a": {"b"}, "b": {"c"}, "c": set()}) == []
    assert circles({"a": {"b"}, "b": {"c", "d"}, "c": {"b"}, "d": set()}) == [["b", "c"]]
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"a"}}) == [["a", "b", "c"]]


def test_the_tests_keep_to_the_size_too():
    long = {path.name: len(path.read_text(encoding="utf-8").splitlines()) for path in TESTS.rglob("*.py")}
    assert {name: lines for name, lines in long.items() if lines > MODULE_LINES} == {}


LONG = "def f():\n    '''Say.\n\n    More.\n    '''\n" + "    x = 1\n\n    # why\n"
BAD = [
    ("fluid/boundary.py", "from valvefsi.coupling import kernels", "fluid must not import coupling"),
    ("fluid/boundary.py", "from valvefsi import grid, io", "fluid must not import io"),
    ("solid/loads.py", "def f():\n    from ..fsi import step", "solid must not import fsi"),
    ("fitting/windkessel.py", "from valvefsi import studies", "fitting must not import studies"),
    ("studies/stages.py", "from valvefsi import cli", "studies must not import cli"),
    ("studies/stages.py", "import rich", "rich is allowed only in"),
    ("grid/mac.py", "import valvefsi.post", "grid must not import post"),
    ("io/history.py", "from .. import case", "io must not import case"),
    ("fluid/boundary.py", "import numba as nb", "numba is allowed only in"),
    ("coupling/transfer.py", "from dolfinx.fem import form", "dolfinx is allowed only in"),
    ("solid/structure.py", "import gmsh", "gmsh is allowed only in"),
    ("post/movies.py", "import plotly", "plotly is allowed only in"),
    ("run/simulation.py", "from rich.progress import Progress", "rich is allowed only in"),
    ("grid/mac.py", "from petsc4py import PETSc", "petsc4py is allowed only in"),
    ("solid/loads.py", "from numpy import *", "import *"),
    ("solid/loads.py", "try:\n    x = 1\nexcept:\n    pass", "except: without a type"),
    ("solid/loads.py", LONG + "    x = 1\n" * 40, "f has 41 lines of code, more than 40"),
    ("fluid/stencils.py", LONG + "    x = 1\n" * 60, "f has 61 lines of code, more than 60"),
    ("solid/loads.py", "def f(self, a, b, c, d, e, *, g, h, i, j): ...", "f takes 9 arguments, more than 8"),
    ("solid/loads.py", "x = 1\n" * 451, "451 lines, more than 450"),
    ("helpers/misc.py", "x = 1", "helpers has no place in the layers"),
]
GOOD = [
    (
        "fluid/boundary.py",
        "from petsc4py import PETSc\nfrom valvefsi.grid import MacGrid\nfrom . import stencils",
    ),
    (
        "solid/structure.py",
        "import ufl\nfrom valvefsi.runtime import dolfinx_compat as compat\nfrom .loads import DeadLoad",
    ),
    ("coupling/kernels.py", "import numba\n" + LONG + "    x = 1\n" * 59),
    ("cli.py", "import typer\nfrom valvefsi import __version__, case, run"),
    ("solid/loads.py", LONG + "    x = 1\n" * 39),
]


@pytest.mark.parametrize(("where", "source", "fault"), BAD, ids=[fault for *_, fault in BAD])
def test_a_broken_rule_is_noticed(where, source, fault):
    faults = faults_of(source, where)
    assert len(faults) == 1
    assert fault in faults[0]


@pytest.mark.parametrize(("where", "source"), GOOD, ids=[where for where, _ in GOOD])
def test_what_the_rules_allow_passes(where, source):
    assert faults_of(source, where) == []


def test_what_is_left_out_on_several_ranks_is_there_and_knows_of_none():
    for name in ONE_RANK:
        path = TESTS / name
        assert path.exists(), f"{name} is in the list of conftest.py but not here"
        for file in [path] if path.is_file() else path.rglob("test_*.py"):
            if file.name != Path(__file__).name:
                ranked = re.findall(
                    r"\bcomm\b|shared_tmp|COMM_WORLD|MacGrid", file.read_text(encoding="utf-8")
                )
                assert not ranked, f"{file.name} names {ranked[0]}: it may differ between ranks"


def test_every_folder_of_tests_runs_on_several_ranks_or_is_left_out_by_name():
    makefile = (TESTS.parent / "Makefile").read_text(encoding="utf-8")
    parts = makefile.split("\nPARTS := ")[1].split("\n\n")[0]
    folders = {path.parent.relative_to(TESTS).parts[0] for path in TESTS.glob("*/**/test_*.py")}
    assert folders <= {*re.findall(r"tests/(\w+)", parts), *ONE_RANK}


def test_the_package_is_found():
    assert PACKAGE / "__init__.py" in FILES
