"""The energy-momentum scheme of elastic bodies in absolute coordinates.

    u_1 - u_0 = h (v_0 + v_1) / 2,      M (v_1 - v_0) / h - M g + f_dg(u_0, u_1) + H G_dg^T lambda = 0               (1)
    f_dg . w = int F_m S : grad w,      F_m = (F_0 + F_1) / 2,     C_m = (C_0 + C_1) / 2,     dC = C_1 - C_0
    S = 2 W'(C_m) + 2 (W(C_1) - W(C_0) - W'(C_m) : dC) / (dC : dC) dC                                          (2)

S : dC / 2 = W(C_1) - W(C_0) in every quadrature point, so energy is conserved for any step, and F_m S with symmetric S keeps
the momenta. Joints to the ground and between such bodies act on the surfaces' moments p = H^T u,

    h G_dg v_m = g_1 - g_0:     G_dg = G(p_m) + (g_1 - g_0 - G(p_m) dp) dp^T / (dp . dp),     g(p_1) = 0,                (3)

so their forces H G_dg^T lambda do no work; pins at the middle of a surface are linear, G_dg = G. W must be given as a function of
C = F^T F (:class:`~fmbd_fenicsx.energies.StoredEnergy`). The tangent is exact and taken anew in every iteration: the scheme is
for steps that turn the body far.

Source: Gonzalez, doi:10.1016/S0045-7825(00)00189-4, doi:10.1016/S0045-7825(98)00204-8; Simo and Tarnow, doi:10.1007/BF00913408.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..energies import StoredEnergy
from ..errors import ConvergenceError, InputError
from ..rotations import Array
from ..system.memory import Memory
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

    def solve_columns(self, B: Array) -> Array:
        """The same for columns (n d, k), with the matrix of the last :meth:`solve`."""
        out = np.empty_like(B)
        for k in range(B.shape[1]):
            self.b.array[:] = B[:, k]
            self.ksp.solve(self.b, self.x)
            out[:, k] = self.x.array
        return out

    def destroy(self) -> None:
        for obj in (self.ksp, self.J, self.x, self.b):
            obj.destroy()


Spans = list[tuple[_Body, slice, slice]]  # bodies with their places in q and v


class _Joints:
    """Constraints of a step as functions of the surfaces' moments p (ports), linear in the displacements; (3)."""

    def __init__(self, system: System, state: State, h: float) -> None:
        self.system, self.q0, self.middle, self.end = system, state.q, state.t + 0.5 * h, state.t + h
        old = system.at(self.middle, state.q)
        self.p0, self.g0 = old.port.copy(), old.constraint().copy()
        used = np.flatnonzero(np.abs(old.jacobian.port).max(axis=0) > 0)
        whole = (used // system.motions.dim)[:, None] * system.motions.dim + np.arange(system.motions.dim)
        self.used = np.unique(whole)
        self.columns = []
        for k, part in system.fields:
            first = system.port_slice(k).start
            own = self.used[(self.used >= first) & (self.used < system.port_slice(k).stop)] - first
            self.columns.append((own + first, part.port_columns(own)))

    def evaluate(self, q: Array) -> None:
        """Constraint, its Jacobian at the end and the discrete gradient for a configuration q."""
        system = self.system
        new, mean = system.at(self.end, q), system.at(self.middle, 0.5 * (self.q0 + q))
        g1 = system.at(self.middle, q).constraint()
        self.g, self.G = new.constraint(), new.jacobian.port
        dp = new.port - self.p0
        G, square = mean.jacobian.port, float(dp @ dp)
        rest = g1 - self.g0 - G @ dp
        self.G_dg = G + np.outer(rest, dp) / square if square > 1e-24 * float(self.p0 @ self.p0) else G

    def solve(self, bodies: list[_Body], residuals: list[Array]) -> tuple[list[Array], Array]:
        """Newton's increments of the bodies and the new multipliers, by the Schur complement of the constraints."""
        m = len(self.g)
        S, c, solved = np.zeros((m, m)), self.g.copy(), []
        for body, r, (at, H) in zip(bodies, residuals, self.columns, strict=True):
            z, Y = body.solve(r), body.solve_columns(H)
            W, Hz = body.field.total(H.T @ Y), body.field.total(H.T @ z)
            S += self.G[:, at] @ W @ self.G_dg[:, at].T
            c -= self.G[:, at] @ Hz
            solved.append((z, Y, at))
        lam = np.linalg.lstsq(S, c, rcond=1e-12)[0]
        return [-z - Y @ (self.G_dg[:, at].T @ lam) for z, Y, at in solved], lam


class FieldStepper:
    """Advances absolute bodies, free or held by joints; back-solves for each body and iteration."""

    local_error = 0.0

    def __init__(self, system: System, newton: Newton, state: State) -> None:
        alone = not (system.n_frames or system.forces or len(system.fields) != len(system.parts))
        if not alone or any(getattr(p, "inertia_columns", np.zeros((0, 1))).shape[1] for _, p in system.fields):
            raise InputError(
                "EnergyMomentum takes either rigid bodies with springs and joints, or absolute bodies, free or with joints to "
                "each other and to the ground."
            )
        self.system, self.newton, self.state = system, newton, state
        self.bodies = [_Body(p) for _, p in system.fields]

    def remember(self, m: Memory) -> None:
        """The state."""
        self.state = m.state("state", self.state)

    def advance(self, h: float) -> State:
        """One step of size h (s); collective. Raises ConvergenceError when Newton's iteration fails."""
        s, system = self.state, self.system
        in_q, in_v = system.slices[0], system.slices[1]
        spans: Spans = [(b, in_q[k], in_v[k]) for b, (k, _) in zip(self.bodies, system.fields, strict=True)]
        joints = _Joints(system, s, h) if system.n_lam else None
        q, lam = s.q.copy(), s.lam
        for body, at, rate in spans:
            body.h2.value = h * h
            body.place(body.u0, s.q[at])
            q[at] = self._predict(body.field, s.q[at], s.v[rate], h)
        history: list[float] = []
        for _ in range(40):
            residuals = self._residuals(spans, q, h)
            if joints is None:
                steps = [-body.solve(r) for body, r in zip(self.bodies, residuals, strict=True)]
            else:
                joints.evaluate(q)
                steps, lam = joints.solve(self.bodies, residuals)
            q = q.copy()
            for (_, at, _), step in zip(spans, steps, strict=True):
                q[at] += step
            self.newton.iterations += 1
            history.append(self._size(steps))
            if not np.isfinite(history[-1]):
                break
            if history[-1] < 1e-14 or (history[-1] < 1e-11 and len(history) > 1 and history[-1] > 0.1 * history[-2]):
                return self._take(q, lam, h, spans)
        raise ConvergenceError(
            f"Newton's iteration failed at t = {s.t + h:.6g} s (h = {h:.3g} s): increments over size "
            + " -> ".join(f"{x:.1e}" for x in history[-6:])
            + ". Take a smaller dt."
        )

    def _residuals(self, spans: Spans, q: Array, h: float) -> list[Array]:
        """The second of (1) without joints, for each body."""
        s, g, out = self.state, self.system.gravity(self.state.t + 0.5 * h), []
        for body, at, rate in spans:
            f = body.field
            inertia = f.mass((2.0 / h**2 * (q[at] - s.q[at] - h * s.v[rate])).reshape(-1, f.dim) - g).ravel()
            out.append(inertia + body.force(q[at]))
        return out

    def _size(self, steps: list[Array]) -> float:
        """Largest mean increment of a body over its size."""
        found = []
        for body, dU in zip(self.bodies, steps, strict=True):
            moved, size = body.field.total(np.array([dU @ dU, body.field.n * body.field.size**2]))
            found.append(float(np.sqrt(moved / size)))
        return max(found)

    def _take(self, q: Array, lam: Array, h: float, spans: Spans) -> State:
        """The state at the end of the step, by the first of (1)."""
        s = self.state
        v, a = s.v.copy(), s.a.copy()
        for _, at, rate in spans:
            v[rate] = 2.0 / h * (q[at] - s.q[at]) - s.v[rate]
            a[rate] = 2.0 * (v[rate] - s.v[rate]) / h - s.a[rate]
        self.state = State(s.t + h, q, v, a, lam)
        return self.state

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
