"""Newton's method in two blocks, displacement and pressure: FGMRES with a Schur complement, multigrid inside."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from valvefsi.runtime import dolfinx_compat as compat

# isort: split
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI
from petsc4py import PETSc

from valvefsi.solid.newton import weak

NUMBERS = itertools.count()
"""Numbers of the solvers made so far, the same on all ranks."""


class BlockNewton:
    """Solve F_u(u, p) = 0, F_p(u, p) = 0 with prescribed values of u.

    The tangent [[K, B], [B^T, D]] is preconditioned from the right by the upper triangle of its block
    factorisation: one V-cycle of algebraic multigrid (GAMG, rigid body modes) for K, and incomplete Cholesky
    factors of a given matrix for the Schur complement D - B^T K^-1 B.

    Args:
        state: u (vector) and p (scalar); start values in, solution out.
        residuals: F_u and F_p, UFL linear forms.
        conditions: Prescribed values of u.
        schur: UFL bilinear form close to the Schur complement.
        relative_tolerance: Of each linear solve.

    Note:
        Collective. A failed solve leaves ``state`` as it was.
    """

    def __init__(
        self,
        state: Sequence[fem.Function],
        residuals: Sequence[ufl.Form],
        conditions: Sequence[fem.DirichletBC],
        schur: ufl.Form,
        *,
        relative_tolerance: float = 1e-4,
    ) -> None:
        self._state, self._conditions = tuple(state), list(conditions)
        self._residuals = [compat.compile_form(form) for form in residuals]
        trials = [ufl.TrialFunction(f.function_space) for f in state]
        test = ufl.TestFunction(state[1].function_space)
        zero = fem.Constant(state[0].function_space.mesh, 0.0) * trials[1] * test * ufl.dx(degree=2)
        self._tangents = [
            [
                compat.compile_form(ufl.derivative(form, f, trial) + (zero if i == j == 1 else 0))
                for j, (f, trial) in enumerate(zip(state, trials, strict=True))
            ]
            for i, form in enumerate(residuals)
        ]
        self._schur = compat.compile_form(schur)
        self._blocks = [[fem_petsc.create_matrix(form) for form in row] for row in self._tangents]
        self._S = fem_petsc.create_matrix(self._schur)
        self._blocks[0][0].setNearNullSpace(rigid_motions(state[0].function_space))
        comm = state[0].function_space.mesh.comm
        self._A = PETSc.Mat().createNest(self._blocks, comm=comm)
        self._x = PETSc.Vec().createNest([compat.create_vector(f.function_space) for f in state], comm=comm)
        self._b = PETSc.Vec().createNest([compat.create_vector(f.function_space) for f in state], comm=comm)
        self.linear_iterations: list[int] = []
        self._make_solver(comm, relative_tolerance)

    def _make_solver(self, comm: MPI.Comm, relative_tolerance: float) -> None:
        """Set up SNES, FGMRES and the block preconditioner."""
        prefix = f"valvefsi_fieldsplit_{next(NUMBERS)}_"
        self._snes = PETSc.SNES().create(comm)
        self._snes.setOptionsPrefix(prefix)  # before getKSP, which takes it over
        self._snes.setFunction(weak(self._assemble_residual), self._b)
        self._snes.setJacobian(weak(self._assemble_tangent), self._A)
        self._snes.setType("newtonls")
        ksp = self._snes.getKSP()
        ksp.setType("fgmres")
        ksp.setGMRESRestart(100)
        ksp.setTolerances(rtol=relative_tolerance, max_it=600)
        ksp.setOperators(self._A)
        pc = ksp.getPC()
        pc.setType("fieldsplit")
        rows, _ = self._A.getNestISs()
        pc.setFieldSplitIS(("u", rows[0]), ("p", rows[1]))
        pc.setFieldSplitType(PETSc.PC.CompositeType.SCHUR)
        pc.setFieldSplitSchurFactType(PETSc.PC.SchurFactType.UPPER)
        pc.setFieldSplitSchurPreType(PETSc.PC.SchurPreType.USER, self._S)
        options = PETSc.Options()
        chosen = {
            "fieldsplit_u_ksp_type": "preonly",
            "fieldsplit_u_pc_type": "gamg",
            "fieldsplit_u_pc_gamg_threshold": 0.01,
            "fieldsplit_u_mg_levels_ksp_type": "chebyshev",
            "fieldsplit_u_mg_levels_ksp_max_it": 3,
            "fieldsplit_u_mg_levels_pc_type": "jacobi",
            "fieldsplit_p_ksp_type": "preonly",
            "fieldsplit_p_pc_type": "bjacobi",
        }
        for key, value in chosen.items():
            options.setValue(prefix + key, value)
        self._snes.setFromOptions()

    def set_tolerances(self, relative: float, absolute: float, max_iterations: int) -> None:
        """Set tolerances of the residual's 2-norm and the limit of iterations."""
        self._snes.setTolerances(rtol=relative, atol=absolute, stol=0.0, max_it=max_iterations)

    def solve(self) -> tuple[bool, int]:
        """Run Newton's method from ``state``; return whether it converged and its iterations (collective)."""
        start = [f.x.array.copy() for f in self._state]
        for part, values in zip(self._x.getNestSubVecs(), start, strict=True):
            with part.localForm() as local:
                local.array[:] = values
        try:
            self._snes.solve(None, self._x)
            converged = self._snes.getConvergedReason() > 0
        except PETSc.Error:  # error_if_not_converged, set from outside
            converged = False
        if converged:
            self._load(self._x)
        else:
            for f, values in zip(self._state, start, strict=True):
                f.x.array[:] = values
        self.linear_iterations.append(self._snes.getLinearSolveIterations())
        return converged, self._snes.getIterationNumber()

    def destroy(self) -> None:
        """Free what PETSc holds (collective); petsc4py leaves it to the end of the program on several ranks."""
        for thing in (
            self._snes,
            self._A,
            self._S,
            *(m for row in self._blocks for m in row),
            self._b,
            self._x,
        ):
            thing.destroy()

    def _load(self, x: PETSc.Vec) -> None:
        """Copy ``x`` with its ghosts into the state."""
        for f, part in zip(self._state, x.getNestSubVecs(), strict=True):
            part.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)
            with part.localForm() as local:
                f.x.array[:] = local.array_r

    def _assemble_residual(self, _snes: PETSc.SNES, x: PETSc.Vec, b: PETSc.Vec) -> None:
        """Assemble F(x), with x - prescribed value in the rows of the conditions."""
        self._load(x)
        x_u = x.getNestSubVecs()[0]
        for i, (part, form) in enumerate(zip(b.getNestSubVecs(), self._residuals, strict=True)):
            with part.localForm() as local:
                local.set(0.0)
            fem_petsc.assemble_vector(part, form)
            fem_petsc.apply_lifting(part, [self._tangents[i][0]], [self._conditions], [x_u], -1.0)
            part.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        fem_petsc.set_bc(b.getNestSubVecs()[0], self._conditions, x_u, -1.0)

    def _assemble_tangent(self, _snes: PETSc.SNES, x: PETSc.Vec, A: PETSc.Mat, _P: PETSc.Mat) -> None:
        """Assemble the blocks of the tangent and the matrix for the Schur complement."""
        self._load(x)
        forms = [form for row in self._tangents for form in row]
        matrices = [matrix for row in self._blocks for matrix in row]
        for matrix, form in zip((*matrices, self._S), (*forms, self._schur), strict=True):
            matrix.zeroEntries()
            fem_petsc.assemble_matrix(matrix, form, self._conditions)
            matrix.assemble()
        A.assemble()


def rigid_motions(space: fem.FunctionSpace) -> PETSc.NullSpace:
    """Return the rigid motions of a vector space, orthonormal: 3 in two dimensions, 6 in three (collective)."""
    dim = space.dofmap.index_map_bs
    n = space.dofmap.index_map.size_local
    X = space.tabulate_dof_coordinates()[:n]
    modes = [np.broadcast_to(np.eye(3)[i], (n, 3)) for i in range(dim)]
    turns = [np.cross(np.eye(3)[axis], X) for axis in ((2,) if dim == 2 else (0, 1, 2))]
    vectors: list[PETSc.Vec] = []
    for mode in (*modes, *turns):
        vector = compat.create_vector(space)
        vector.array[:] = mode[:, :dim].ravel()
        for other in vectors:
            vector.axpy(-vector.dot(other), other)
        vector.normalize()
        vectors.append(vector)
    return PETSc.NullSpace().create(vectors=vectors, comm=space.mesh.comm)
