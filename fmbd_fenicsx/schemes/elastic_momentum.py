"""The energy-momentum scheme of elastic bodies in absolute coordinates.

    u_1 - u_0 = h (v_0 + v_1) / 2,      M (v_1 - v_0) / h - M g + f_dg(u_0, u_1) = 0                            (1)
    f_dg . w = int F_m S : grad w,      F_m = (F_0 + F_1) / 2,     C_m = (C_0 + C_1) / 2,     dC = C_1 - C_0
    S = 2 W'(C_m) + 2 (W(C_1) - W(C_0) - W'(C_m) : dC) / (dC : dC) dC                                          (2)

S : dC / 2 = W(C_1) - W(C_0) in every quadrature point, so energy is conserved for any step, and F_m S with symmetric S keeps
the momenta. W must be given as a function of C = F^T F (:class:`~fmbd_fenicsx.energies.StoredEnergy`). The tangent is exact
and taken anew in every iteration: the scheme is for steps that turn the body far.

Source: Gonzalez, doi:10.1016/S0045-7825(00)00189-4; Simo and Tarnow, doi:10.1007/BF00913408.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..energies import StoredEnergy
from ..errors import ConvergenceError, InputError
from ..rotations import Array
from ..system.system import State, System
from .newton import Newton

TINY = 1e-11  # dC : dC below which the correction in (2), of the third order in dC, is lost in roundoff


class _Body:
    """Forms, matrix and vectors of one body."""

    def __init__(self, part: Any) -> None:
        import dolfinx.fem.petsc as fp
        import ufl
        from dolfinx import fem
        from petsc4py import PETSc

        from .. import dolfinx_compat as compat

        self.field = field = part.field
        stored = field.forms.energy
        if not isinstance(stored, StoredEnergy):
            raise InputError(
                f'Body "{field.name}": EnergyMomentum needs a StoredEnergy W(C), such as saint_venant_kirchhoff(...).'
            )
        space, v, du = field.space, ufl.TestFunction(field.space), ufl.TrialFunction(field.space)
        self.u0, self.u1 = fem.Function(space), fem.Function(space)
        eye = ufl.Identity(field.dim)
        F0, F1 = eye + ufl.grad(self.u0), eye + ufl.grad(self.u1)
        C0, C1 = F0.T * F0, F1.T * F1
        Cm, dC = ufl.variable(0.5 * (C0 + C1)), C1 - C0
        W = stored.density(field.mesh.dolfinx)
        slope = ufl.diff(W(Cm), Cm)
        slope = 0.5 * (slope + slope.T)
        square = ufl.inner(dC, dC)
        rest = (W(C1) - W(C0) - ufl.inner(slope, dC)) / ufl.max_value(square, TINY)
        rest = ufl.conditional(ufl.gt(square, TINY), rest, 0.0)
        S = 2 * (slope + rest * dC)
        force = ufl.inner(0.5 * (F0 + F1) * S, ufl.grad(v)) * field.elastic_measure
        self.h2 = fem.Constant(field.mesh.dolfinx, 1.0)
        rho = float(field.forms.density)
        inertia = 2 * rho / self.h2 * ufl.inner(du, v) * ufl.Measure("dx", domain=field.mesh.dolfinx)
        self._force = compat.form(force)
        self._tangent = compat.form(inertia + ufl.derivative(force, self.u1, du))
        self.J = fp.create_matrix(self._tangent)
        self._assemble = fp.assemble_matrix
        self.ksp = PETSc.KSP().create(field.comm)
        self.ksp.setOperators(self.J)
        self.ksp.setType("preonly")
        self.ksp.getPC().setType("lu")
        self.ksp.getPC().setFactorSolverType("mumps")
        self.x, self.b = self.J.createVecs()

    def place(self, function: Any, U: Array) -> None:
        """Nodal values with ghosts."""
        function.x.array[: len(U)] = U
        function.x.scatter_forward()

    def force(self, U: Array) -> Array:
        """f_dg(u_0, U)."""
        from dolfinx import fem, la

        self.place(self.u1, U)
        b = fem.assemble_vector(self._force)
        b.scatter_reverse(la.InsertMode.add)
        return np.array(b.array[: len(U)])

    def solve(self, r: Array) -> Array:
        """(2 M / h^2 + df_dg)^-1 r at the configuration of the last force."""
        self.J.zeroEntries()
        self._assemble(self.J, self._tangent)
        self.J.assemble()
        self.b.array[:] = r
        self.ksp.solve(self.b, self.x)
        return np.array(self.x.array)

    def destroy(self) -> None:
        for obj in (self.ksp, self.J, self.x, self.b):
            obj.destroy()


class FieldStepper:
    """Advances absolute bodies without joints and forces; one solve for each body and iteration."""

    local_error = 0.0

    def __init__(self, system: System, newton: Newton, state: State) -> None:
        alone = not (system.n_frames or system.n_lam or system.forces or len(system.fields) != len(system.parts))
        if not alone or any(getattr(p, "inertia_columns", np.zeros((0, 1))).shape[1] for _, p in system.fields):
            raise InputError(
                "EnergyMomentum takes either rigid bodies with springs and joints, or absolute bodies that move freely."
            )
        self.system, self.newton, self.state = system, newton, state
        self.bodies = [_Body(p) for _, p in system.fields]

    def advance(self, h: float) -> State:
        """One step of size h (s); collective. Raises ConvergenceError when Newton's iteration fails."""
        s, system = self.state, self.system
        q, v, a = s.q.copy(), s.v.copy(), s.a.copy()
        for body, (k, _) in zip(self.bodies, system.fields, strict=True):
            in_q, in_v = system.slices[0][k], system.slices[1][k]
            q[in_q], v[in_v] = self._step(body, s.q[in_q], s.v[in_v], h)
            a[in_v] = 2.0 * (v[in_v] - s.v[in_v]) / h - s.a[in_v]
        self.state = State(s.t + h, q, v, a, s.lam)
        return self.state

    def _step(self, body: _Body, U0: Array, V0: Array, h: float) -> tuple[Array, Array]:
        f, d = body.field, body.field.dim
        body.h2.value = h * h
        body.place(body.u0, U0)
        gravity = f.mass(np.tile(self.system.gravity(self.state.t + 0.5 * h), (f.n, 1))).ravel()
        U, history = self._predict(f, U0, V0, h), []
        for _ in range(40):
            inertia = 2.0 / h**2 * f.mass((U - U0 - h * V0).reshape(-1, d)).ravel()
            dU = -body.solve(inertia - gravity + body.force(U))
            U = U + dU
            self.newton.iterations += 1
            moved, size = f.total(np.array([dU @ dU, f.n * f.size**2]))
            history.append(float(np.sqrt(moved / size)))
            if not np.isfinite(history[-1]):
                break
            if history[-1] < 1e-14 or (history[-1] < 1e-11 and len(history) > 1 and history[-1] > 0.1 * history[-2]):
                return U, 2.0 / h * (U - U0) - V0
        raise ConvergenceError(
            f'Body "{f.name}": Newton\'s iteration failed at t = {self.state.t + h:.6g} s (h = {h:.3g} s): increments over size '
            + " -> ".join(f"{x:.1e}" for x in history[-6:])
            + ". Take a smaller dt."
        )

    def _predict(self, f: Any, U0: Array, V0: Array, h: float) -> Array:
        """The body moved on rigidly: with its mean velocity, and turned by its mean angular velocity."""
        d, m = f.dim, f.motions
        x = f.points(U0)
        mass_x, V = f.mass(x), V0.reshape(-1, d)
        first, speed, spin = f.total(mass_x.sum(0)), f.total(f.mass(V).sum(0)), f.total(m.moment(x, f.mass(V)).sum(0))
        center, mean = first / f.mass_total, speed / f.mass_total
        arm = x - center
        inertia = np.empty((m.n_rot, m.n_rot))
        for k in range(m.n_rot):
            inertia[:, k] = m.moment(arm, f.mass(m.spin(np.eye(m.n_rot)[k : k + 1], arm))).sum(0)
        w = np.linalg.solve(f.total(inertia), spin - m.moment(center, speed))
        turn = m.matrix(m.compose(m.identity[None], np.concatenate((np.zeros(d), h * w))[None]))[0]
        return np.asarray(U0 + (arm @ turn.T - arm + h * mean).ravel())

    def destroy(self) -> None:
        """Free the solvers; collective."""
        for body in self.bodies:
            body.destroy()
