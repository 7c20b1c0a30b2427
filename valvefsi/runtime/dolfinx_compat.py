"""The differences between DOLFINx releases 0.9, 0.10 and 0.11, and the one place that knows of them.

Import this module before ``dolfinx`` or ``petsc4py``: where the ``dolfinx-solver-real`` wheel is installed it
loads MPI ahead of the compiled modules.
"""

from __future__ import annotations

import contextlib
import functools
import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

with contextlib.suppress(ImportError):  # a DOLFINx from apt, conda or source needs no such help
    import dolfinx_solver  # noqa: F401

import dolfinx
import dolfinx.jit
import numpy as np
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc
from ufl.algorithms.analysis import extract_coefficients, extract_constants
from ufl.classes import Label

try:
    from ufl.corealg.dag_traverser import DAGTraverser
except ImportError:  # an older UFL has none
    DAGTraverser = None

if TYPE_CHECKING:
    from collections.abc import Sequence

    import ufl
    from numpy.typing import NDArray
    from ufl.core.expr import Expr

    from valvefsi.types import Array, Gmsh


RELEASE: str = dolfinx.__version__
"""The DOLFINx release in use, for records."""

VERSION: tuple[int, ...] = tuple(int(part) for part in RELEASE.split(".")[:2])
"""Major and minor number of the DOLFINx release in use."""

if VERSION < (0, 9):
    raise ImportError(f"DOLFINx {RELEASE} is too old: valvefsi needs 0.9, 0.10 or 0.11")
if np.dtype(PETSc.ScalarType).kind == "c":
    raise ImportError(
        "this PETSc works with complex numbers: valvefsi needs a real build of DOLFINx and PETSc"
    )

JIT_OPTIONS: dict[str, object] = {"cffi_extra_compile_args": ["-O2", "-g0"], "timeout": 300}
"""Options of the C compiler for the forms; the timeout [s] is of the wait for another process' compilation.

Measured on nodal forces of 512 Q1 cells: -O3, -march=native and -fno-math-errno gain nothing (120 to 125 us).
The cached object files may be read on another machine, hence no -march; an inverted cell must become NaN,
hence no -ffast-math.
"""


def _forget_dispatched() -> None:
    """Let UFL's derivatives go when nobody holds them.

    Before 3.13.2, Python 3.13 keeps every object whose dispatched method was called, and with UFL's rules of
    differentiation the functions, meshes and MPI communicators of every form.
    """
    kinds = [] if DAGTraverser is None else list(DAGTraverser.__subclasses__())
    for kind in kinds:
        kinds += kind.__subclasses__()
        for method in vars(kind).values():
            if isinstance(method, functools.singledispatchmethod) and hasattr(method, "_method_cache"):
                method._method_cache = None


_forget_dispatched()


@functools.cache
def forget_interrupted_compilations(cache_dir: Path | None = None, age: float = 120.0) -> int:
    """Remove what a killed compilation has left in the cache of forms; FFCx would wait for it to end and give up.

    Args:
        cache_dir: Folder of the cache; by default that of DOLFINx.
        age: Sources without a result are left alone until they are so old [s].

    Returns:
        Number of forms forgotten.
    """
    folder = Path(cache_dir or dolfinx.jit.get_options()["cache_dir"])
    names = set(os.listdir(folder)) if folder.is_dir() else set()
    forgotten = 0
    for name in names:
        if not name.endswith(".c") or f"{name}.cached" in names:
            continue
        source = folder / name
        with contextlib.suppress(OSError):  # another process may be faster
            if not source.with_suffix(".c.cached").exists() and time.time() - source.stat().st_mtime > age:
                source.unlink()
                forgotten += 1
    return forgotten


def compile_form(form: ufl.Form) -> fem.Form:
    """Compile a UFL form (collective)."""
    forget_interrupted_compilations()
    return fem.form(form, jit_options=JIT_OPTIONS)


def _with_numbered_labels(expression: Expr, done: dict[Expr, Expr]) -> Expr:
    """Number the labels of an expression's variables from 0, in the order in which they appear.

    UFL counts them through the life of a process and does so itself for forms alone: an expression would have another
    name, and be compiled anew, each time.
    """
    if expression not in done:
        if isinstance(expression, Label):
            done[expression] = Label(sum(isinstance(one, Label) for one in done))
        else:
            old = expression.ufl_operands
            new = [_with_numbered_labels(one, done) for one in old]
            same = all(a is b for a, b in zip(old, new, strict=True))
            done[expression] = expression if same else expression._ufl_expr_reconstruct_(*new)
    return done[expression]


def compile_expression(expression: Expr, points: Array, comm: MPI.Comm) -> fem.Expression:
    """Compile a UFL expression for ``points (num_points, tdim)`` of the reference cell (collective)."""
    forget_interrupted_compilations()
    expression = _with_numbered_labels(expression, {})
    return fem.Expression(expression, points, comm=comm, jit_options=JIT_OPTIONS)


class PointFunction(NamedTuple):
    """A compiled expression of coefficients and constants as a C function of one point, f(out, inputs, constants).

    Attributes:
        address: Address of the function; it adds to its first argument.
        inputs: The coefficients in the order of their values in the inputs.
        constants: Values of the constants, ``(n,)``.
        module: What keeps the function in memory.
    """

    address: int
    inputs: list[ufl.Coefficient]
    constants: Array
    module: object


def compile_at_point(expression: Expr) -> PointFunction:
    """Compile a UFL expression that is the same function everywhere: of coefficients constant in a cell."""
    forget_interrupted_compilations()
    points = np.zeros((1, 3))
    expression = _with_numbered_labels(expression, {})
    made, module, _ = dolfinx.jit.ffcx_jit(MPI.COMM_SELF, (expression, points), jit_options=JIT_OPTIONS)
    coefficients, constants = extract_coefficients(expression), extract_constants(expression)
    return PointFunction(
        address=int(module.ffi.cast("uintptr_t", made.tabulate_tensor_float64)),
        inputs=[coefficients[made.original_coefficient_positions[k]] for k in range(made.num_coefficients)],
        constants=np.concatenate([np.zeros(0), *(np.ravel(constant.value) for constant in constants)]),
        module=module,
    )


def interpolation_points(space: fem.FunctionSpace) -> Array:
    """Return the points ``(num_points, tdim)`` at which the element of ``space`` wants values."""
    points = space.element.interpolation_points
    return points() if callable(points) else points  # a method in 0.9, a property since 0.10


def model_to_mesh(
    model: Gmsh, comm: MPI.Comm, gdim: int
) -> tuple[dolfinx.mesh.Mesh, dolfinx.mesh.MeshTags | None, dolfinx.mesh.MeshTags | None]:
    """Distribute the gmsh model of rank 0 (``model`` is None elsewhere), without ghost cells.

    Returns:
        Mesh, cell tags, facet tags.

    Note:
        Collective.
    """
    if VERSION < (0, 10):
        from dolfinx.io import gmshio

        return gmshio.model_to_mesh(model, comm, 0, gdim=gdim)
    from dolfinx.io import gmsh as reader

    data = reader.model_to_mesh(model, comm, 0, gdim=gdim)
    return data.mesh, data.cell_tags, data.facet_tags


def geometry_nodes(mesh: dolfinx.mesh.Mesh) -> NDArray[np.int32]:
    """Return the rows of ``mesh.geometry.x`` of each of this rank's own cells, ``(num_cells, k)``."""
    geometry = mesh.geometry
    table = geometry.dofmaps[0] if VERSION >= (0, 11) else geometry.dofmap
    return table[: mesh.topology.index_map(mesh.topology.dim).size_local]


def edges(mesh: dolfinx.mesh.Mesh) -> list[list[int]]:
    """Return the pairs of a cell's vertices that edges join, in the order of `geometry_nodes`."""
    import basix

    element = mesh.ufl_domain().ufl_coordinate_element().basix_element
    return basix.topology(element.cell_type)[1]


def create_vector(space: fem.FunctionSpace) -> PETSc.Vec:
    """Create a PETSc vector with the ghosts of ``space``.

    ``fem.petsc.create_vector`` takes a form in 0.9 and a space since 0.10; petsc4py alone is enough.
    """
    index_map, block = space.dofmap.index_map, space.dofmap.index_map_bs
    sizes = (index_map.size_local * block, index_map.size_global * block)
    ghosts = index_map.ghosts.astype(PETSc.IntType)
    return PETSc.Vec().createGhost(ghosts, sizes, bsize=block, comm=space.mesh.comm)


def vtk_cells(space: fem.FunctionSpace) -> tuple[int, NDArray[np.int32]]:
    """Return VTK's cell type, and the local nodes ``(num_cells, k)`` of owned cells in VTK's order."""
    mesh = space.mesh
    if mesh.topology.index_map(mesh.topology.dim).size_local == 0:
        return 0, np.zeros((0, space.dofmap.dof_layout.num_dofs), dtype=np.int32)
    from dolfinx.plot import vtk_mesh

    topology, types, _ = vtk_mesh(space)
    return int(types[0]), np.asarray(topology).reshape(len(types), -1)[:, 1:]


def evaluate(
    expression: fem.Expression, mesh: dolfinx.mesh.Mesh, cells: Sequence[int] | NDArray[np.integer]
) -> Array:
    """Evaluate a compiled expression in ``cells``; ``(num_cells, num_points * value_size)``."""
    numbers = np.asarray(cells, dtype=np.int32)
    values = np.asarray(expression.eval(mesh, numbers))
    width = int(np.prod(values.shape[1:]))  # reshape cannot work it out where there are no cells
    return values.reshape(len(numbers), width)


def pack_constants(form: fem.Form) -> Array:
    """Return the values of a form's constants (a function of ``fem`` since 0.10)."""
    return (
        fem.pack_constants(form) if VERSION >= (0, 10) else dolfinx.cpp.fem.pack_constants(form._cpp_object)
    )


def pack_coefficients(form: fem.Form) -> dict[tuple[Any, int], Array]:
    """Return the values of a form's coefficients (a function of ``fem`` since 0.10)."""
    if VERSION >= (0, 10):
        return fem.pack_coefficients(form)
    return dolfinx.cpp.fem.pack_coefficients(form._cpp_object)
