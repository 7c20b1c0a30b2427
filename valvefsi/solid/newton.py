"""Newton's method, full steps first, then with a line search: PETSc's SNES, linear systems by MUMPS."""

from __future__ import annotations

import weakref
from typing import TYPE_CHECKING, Any, Self

from valvefsi.runtime import dolfinx_compat as compat

# isort: split
import ufl
from dolfinx.fem import petsc as fem_petsc
from petsc4py import PETSc

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from types import TracebackType

    from dolfinx import fem

    from valvefsi.types import Array


def weak(method: Callable[..., None]) -> Callable[..., None]:
    """Return a callback that does not keep the method's object alive.

    PETSc holds its callbacks where Python's garbage collection cannot see them: a solver that calls back its own
    owner would live for ever, and with it the mesh and its MPI communicators.
    """
    reference = weakref.WeakMethod(method)

    def call(*arguments: Any) -> None:
        alive = reference()
        assert alive is not None  # the owner outlives its solver's calls
        alive(*arguments)

    return call


class Newton:
    """Solve F(w) = 0 for a finite element function with prescribed values.

    Full steps first: a thin body that bends turns its elements, which a linear step lengthens, and its membrane or bulk
    modulus makes of that a residual that no line search on the residual's size lets pass, though the next step removes
    it. Where full steps do not converge the solve starts again with backtracking.

    Args:
        state: The unknown w; start value in, solution out.
        residual: UFL linear form F(w; v).
        conditions: Prescribed values.
        forces: Dead forces on owned degrees of freedom, which F loses times ``factor``; None for none.

    Attributes:
        factor: Of the forces.

    Note:
        Collective. A failed solve leaves ``state`` as it was.
    """

    def __init__(
        self,
        state: fem.Function,
        residual: ufl.Form,
        conditions: Sequence[fem.DirichletBC],
        forces: Array | None = None,
    ) -> None:
        self.factor, self._forces = 1.0, forces
        self._state, self._conditions = state, list(conditions)
        self._residual = compat.compile_form(residual)
        self._tangent = compat.compile_form(ufl.derivative(residual, state))
        self._x = compat.create_vector(state.function_space)
        self._b = self._x.duplicate()
        self._A = fem_petsc.create_matrix(self._tangent)
        self._snes = PETSc.SNES().create(state.function_space.mesh.comm)
        self._snes.setFunction(weak(self._assemble_residual), self._b)
        self._snes.setJacobian(weak(self._assemble_tangent), self._A)
        self._snes.setType("newtonls")
        self._snes.setDivergenceTolerance(
            1e300
        )  # the default, 1e4, is less than a full step of a thin body makes
        ksp = self._snes.getKSP()
        ksp.setType("preonly")
        ksp.setOperators(self._A)
        pc = ksp.getPC()
        pc.setType("lu")
        pc.setFactorSolverType("mumps")
        pc.setFactorSetUpSolverType()
        pc.getFactorMatrix().setMumpsIcntl(14, 100)  # room for delayed pivots [%]

    def set_tolerances(self, relative: float, absolute: float, max_iterations: int) -> None:
        """Set tolerances of the residual's 2-norm and the limit of iterations."""
        self._snes.setTolerances(rtol=relative, atol=absolute, stol=0.0, max_it=max_iterations)

    def solve(self) -> tuple[bool, int]:
        """Run Newton's method from ``state``; return whether it converged and its iterations (collective)."""
        start, iterations = self._state.x.array.copy(), 0
        for search in ("basic", "bt"):
            self._snes.getLineSearch().setType(search)
            with self._x.localForm() as local:
                local.array[:] = start
            converged = self._search()
            iterations += self._snes.getIterationNumber()
            if converged:
                self._load(self._x)
                return True, iterations
        self._state.x.array[:] = start
        return False, iterations

    def _search(self) -> bool:
        """Run Newton's method from the vector of unknowns; return whether it converged (collective)."""
        try:
            self._snes.solve(None, self._x)
        except PETSc.Error:  # error_if_not_converged, set from outside
            return False
        return self._snes.getConvergedReason() > 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: BaseException | type[BaseException] | TracebackType | None) -> None:
        self.destroy()

    def destroy(self) -> None:
        """Free what PETSc holds (collective); petsc4py leaves it to the end of the program on several ranks."""
        for thing in (self._snes, self._A, self._b, self._x):
            thing.destroy()

    def _load(self, x: PETSc.Vec) -> None:
        """Copy ``x`` with its ghosts into the state."""
        x.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)
        with x.localForm() as local:
            self._state.x.array[:] = local.array_r

    def _assemble_residual(self, _snes: PETSc.SNES, x: PETSc.Vec, b: PETSc.Vec) -> None:
        """Assemble F(x), with x - prescribed value in the rows of the conditions."""
        self._load(x)
        with b.localForm() as local:
            local.set(0.0)
        fem_petsc.assemble_vector(b, self._residual)
        fem_petsc.apply_lifting(b, [self._tangent], [self._conditions], [x], -1.0)
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        if self._forces is not None:
            b.array[:] -= self.factor * self._forces
        fem_petsc.set_bc(b, self._conditions, x, -1.0)

    def _assemble_tangent(self, _snes: PETSc.SNES, x: PETSc.Vec, A: PETSc.Mat, _P: PETSc.Mat) -> None:
        """Assemble dF/dw at the state that the residual was assembled for."""
        self._load(x)
        A.zeroEntries()
        fem_petsc.assemble_matrix(A, self._tangent, self._conditions)
        A.assemble()
