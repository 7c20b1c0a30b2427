"""A solid with inertia: its forms, its motion, and where its energy is."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from valvefsi.runtime import dolfinx_compat as compat

# isort: split
import ufl
from dolfinx import fem

from valvefsi.errors import CaseError
from valvefsi.solid.loads import Ramp
from valvefsi.solid.statics import evaluate_at
from valvefsi.solid.statics.equilibrium import Body
from valvefsi.solid.statics.formulations import NearlyIncompressible
from valvefsi.solid.statics.supports import Prescribed

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from valvefsi.solid.loads import DeadLoad, Pressure, Tether
    from valvefsi.solid.materials import Material
    from valvefsi.solid.statics.supports import Fixed, Symmetry
    from valvefsi.types import Array, Mesh

HELD = NearlyIncompressible(degree=1, nu_stab=0.4)
"""Linear elements, numerical Poisson ratio 0.4."""

AT_ONCE = Ramp()
"""The whole load from the start."""


class Energies(NamedTuple):
    """Where the energy of a moving solid is [erg]; in two dimensions per cm depth."""

    kinetic: float
    """1/2 v . M v."""
    stored: float
    """Integral of W + U, and that of the springs."""
    work: float
    """Work of the loads since the start."""
    lost: float
    """Taken by the damping since the start."""
    start: float
    """Kinetic and stored energy at the start."""

    @property
    def balance(self) -> float:
        """What is there, less what it started with and was given; 0 for a perfect integrator."""
        return self.kinetic + self.stored + self.lost - self.work - self.start


class MovingSolid:
    """A hyperelastic solid with inertia, its supports and loads, and its motion.

    Args:
        mesh: A ``SolidMesh``; two dimensions are plane strain.
        material: Isochoric energy W.
        density: rho, positive [g/cm^3].
        supports: What is fixed, at rest.
        loads: Dead loads and follower pressures, all with the factor ``ramp(t)``.
        tethers: Springs and dampers; only their springs act here.
        ramp: Load factor over time; the ramps of the loads themselves are ignored.
        formulation: Degree of the elements and volumetric energy.

    Note:
        Collective. `damping` (eta [dyn s/cm^4]) may be set before the first step.
    """

    def __init__(
        self,
        mesh: Mesh,
        material: Material,
        *,
        density: float,
        supports: Sequence[Fixed | Symmetry] = (),
        loads: Sequence[DeadLoad | Pressure] = (),
        tethers: Sequence[Tether] = (),
        ramp: Callable[[float], float] = AT_ONCE,
        formulation: NearlyIncompressible = HELD,
    ) -> None:
        if not 0 < density < math.inf:
            raise CaseError("expected a positive density", key="density", value=density)
        if any(getattr(support, "value", None) is not None for support in supports):
            raise CaseError("supports of a moving solid are at rest", key="supports")
        self.mesh, self.comm, self.dim = mesh, mesh.mesh.comm, mesh.dim
        self.density, self.damping, self.ramp, self.t = float(density), 0.0, ramp, 0.0
        self.material = material
        self.kappa = formulation.energy(material).kappa
        degree = 2 * formulation.degree + 1
        body = partial(Body, mesh=mesh, material=material, quadrature_degree=degree)
        held = body(supports=supports, loads=(), tethers=tethers)
        loaded = body(supports=(), loads=loads, tethers=())
        self.dX, self.size = held.dX, held.size
        self.space = fem.functionspace(mesh.mesh, ("Lagrange", formulation.degree, (self.dim,)))
        self.u, self.v, self.a = (fem.Function(self.space, name=name) for name in "uva")
        self.factor = fem.Constant(mesh.mesh, 0.0)
        test = ufl.TestFunction(self.space)
        stored = formulation.potential(mesh, material, self.u, None) * self.dX + held.potential(
            self.u, self.factor
        )
        self.inner = ufl.derivative(stored, self.u, test)
        self.outer = _work_of_loads(loaded, (self.u, test, self.factor))
        self.prescribed = Prescribed(mesh, self.space, held.fixed())
        self._stored = compat.compile_form(stored)
        self._kinetic = compat.compile_form(self.density / 2 * ufl.inner(self.v, self.v) * self.dX)

    def set_motion(
        self, u: Callable[[Array], Array] | None = None, v: Callable[[Array], Array] | None = None
    ) -> None:
        """Set displacement [cm] and velocity [cm/s] by functions of X ``(3, n)`` -> ``(dim, n)`` (collective)."""
        for function, given in ((self.u, u), (self.v, v)):
            if given is not None:
                function.interpolate(given)
        for function in (self.u, self.v):
            self.hold(function.x.array)

    def hold(self, array: Array) -> None:
        """Set the values of the supports to zero, in place."""
        for condition in self.prescribed.conditions:
            dofs = condition.dof_indices()[0]
            array[dofs] = 0.0

    def kinetic(self) -> float:
        """Return 1/2 v . M v with the consistent mass [erg] (collective)."""
        return self.comm.allreduce(fem.assemble_scalar(self._kinetic))

    def stored(self) -> float:
        """Return the elastic energy, springs included [erg] (collective)."""
        return self.comm.allreduce(fem.assemble_scalar(self._stored))

    def displacement_at(self, X: Sequence[float]) -> Array:
        """Return the displacement at reference positions, on all ranks (collective)."""
        return evaluate_at(self.u, X)


def _work_of_loads(loaded: Body, about: tuple[fem.Function, ufl.Argument, fem.Constant]) -> ufl.Form | None:
    """Return the virtual work of dead loads and follower pressures; None without any (collective)."""
    u, test, factor = about
    follower = loaded.follower(u, test, factor)
    form = None if follower is None else -follower
    if any(hasattr(load, "traction") for load in loaded.loads):
        dead = -ufl.derivative(loaded.potential(u, factor), u, test)
        form = dead if form is None else form + dead
    return form
