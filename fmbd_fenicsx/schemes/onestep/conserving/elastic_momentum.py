"""Absolute bodies in the energy-momentum scheme: forces as difference quotients of their energies.

    u_1 - u_0 = h (v_0 + v_1) / 2,      M ((v_1 - v_0) / h - g) + f_dg(u_0, u_1) + H P = b                        (1)

f_dg are those of :mod:`fmbd_fenicsx.fem.mean_forces`. Dead loads b do the work b . (u_1 - u_0). P are the forces of joints
and springs on the ports, see :mod:`.energy_momentum`. The tangent is exact; it is taken anew while Newton's iteration is
slow, and turns with the body in between: for steps that turn bodies far, and on several ranks. Usual steps are compiled.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ....fem.factors.factor import by_mumps
from ....linear.blocks.field_blocks import FieldBlocks
from ....mechanics.elastic.absolute import AbsoluteField
from ....rotations import Array, rotate_nodal
from ....system.evaluation import Evaluation
from ....system.layout import State
from ....system.serialisation import Memory
from ....system.system import System


@dataclass(frozen=True)
class Taken:
    """The step whose tangent was taken: its start (s), size (s), displacements at both ends (n d,), the body's mean rotation."""

    t: float
    h: float
    U0: Array
    U1: Array
    turn: Array


class _Body:
    """Forms, matrix and vectors of one body."""

    def __init__(self, part: AbsoluteField) -> None:
        import dolfinx.fem.petsc as fp
        from petsc4py import PETSc

        self.part, self.field = part, part.field
        field = part.field

        # tangent of (1): J_f = 2 M / h^2 + d f_dg / d u_1
        self.forces = part.mean_forces
        self._tangent = self.forces.tangent()
        self.J = fp.create_matrix(self._tangent)
        self._assemble = fp.assemble_matrix

        self.ksp = PETSc.KSP().create(field.comm)
        self.ksp.setOperators(self.J)
        by_mumps(self.ksp, "lu")

        self.x, self.b = self.J.createVecs()
        self.taken: Taken | None = None  # where J_f was
        self.turn: Array | None = None  # of the body since, where that matters

    @property
    def constant(self) -> bool:
        """Whether the tangent depends on the size of the step only."""
        return not (self.field.nonlinear or self.field.loads.moving or self.field.viscous.law is not None)

    def begin(self, state: tuple[float, Array, Array], h: float, gravity: Array) -> None:
        """A step of size h (s) from t, u_0, v_0, and a first u_1; collective."""
        self.t, U, V = state
        t, f = self.t, self.field
        self.h = h

        outer, inner = f.loads.constant(t + 0.5 * h, np.eye(f.dim)) if f.loads.loads else (0.0, 0.0)
        # what of (1) does not depend on u_1
        drift = 2.0 / h * (U / h + V).reshape(-1, f.dim) + gravity
        self._known = (f.mass(drift) + outer + inner).ravel()

        self.U, self.U0, self.V0 = self.part.moved_rigidly(U, V, h), U, V
        self.turn = None
        if self.taken is not None and not self.constant:
            self.turn = self._mean_turn() @ self.taken.turn.T

    def _mean_turn(self) -> Array:
        """Mean rotation of the body in the middle of the step, (d, d); collective."""
        return self.part.mean_rotation(0.5 * (self.U0 + self.U))

    def residual(self) -> Array:
        """(1) without P at u_1, (n d,); collective."""
        self.forces.place(self.t, (self.U0, self.U), self.h)
        inertia = self.field.mass((2.0 / self.h**2 * self.U).reshape(-1, self.field.dim)).ravel()
        return np.array(inertia + self.forces.force() - self._known)

    def linearise(self) -> bool:
        """J_f at u_1, factored at the next solve; False where the one that is there would be the same. Collective."""
        if self.constant and self.taken is not None and self.taken.h == self.h:
            return False
        self._take(Taken(self.t, self.h, self.U0, self.U, self._mean_turn()))
        return True

    def _take(self, at: Taken) -> None:
        """J_f of a step; collective."""
        self.taken, self.turn = at, None
        self.forces.place(at.t, (at.U0, at.U1), at.h)
        self.J.zeroEntries()
        self._assemble(self.J, self._tangent)
        self.J.assemble()

    def remember(self, m: Memory) -> None:
        """Take the tangent again where it was taken; collective."""
        at, order = self.taken, self.field.numbering
        if not m("taken", at is not None):
            self.taken = None
            return
        t, h, turn = (m(name, at and getattr(at, name)) for name in ("t", "h", "turn"))
        U0, U1 = (m.nodal(name, at and getattr(at, name), order) for name in ("U0", "U1"))
        if m.reading:
            self._take(Taken(t, h, U0, U1, turn))

    def solve(self, r: Array) -> Array:
        """J_f^-1 r, for the body as it has turned since J_f was taken; collective."""
        self.b.array[:] = rotate_nodal(r, self.turn, back=True)
        self.ksp.solve(self.b, self.x)
        return rotate_nodal(np.array(self.x.array), self.turn)

    def solve_columns(self, B: Array) -> Array:
        """J_f^-1 B for columns B (n d, k)."""
        return np.stack([self.solve(B[:, k]) for k in range(B.shape[1])], axis=1) if B.shape[1] else B.copy()


def ports_in_use(ev: Evaluation) -> np.ndarray:
    """Ports of fields that constraints and forces may act on."""
    system, m = ev.system, ev.system.markers
    on = np.zeros(len(m.frame), dtype=bool)
    for loads in system.forces:
        for marker in loads.markers:
            on[marker] = True
    for batch, _ in system.batches:
        for _, marker, _ in batch.sides(ev.kin, ev.t):
            on[marker] = True

    used, inside = np.zeros((2, system.n_port), dtype=bool)
    used[m.port[on[m.surface]].ravel()] = True
    # ties take their own ports, at the end of those of a part
    for k, part in system.fields:
        ports, ties = system.port_slice(k), sum(B.shape[0] for B in part.traces)  # type: ignore[attr-defined]
        inside[ports] = True
        used[ports.stop - ties : ports.stop] = True
    return np.flatnonzero(used & inside)


class Fields:
    """All absolute bodies of a system in a step, as the small system of :mod:`.energy_momentum` sees them: through the ports
    ``used`` (numbers of the system's ports). ``blocks`` count factors and back-solves.
    """

    def __init__(self, system: System, used: np.ndarray, blocks: FieldBlocks) -> None:
        parts: list[tuple[int, Any]] = list(system.fields)
        self.system, self.used, self._blocks = system, used, blocks

        self.bodies: list[_Body] = []
        self._at: list[tuple[np.ndarray, np.ndarray]] = []
        self._H: list[Array] = []
        self._reference: Array = np.zeros(len(used))

        # of each body: which of its ports are in use, and their columns
        for k, part in parts:
            ports = system.port_slice(k)
            at = np.flatnonzero((used >= ports.start) & (used < ports.stop))
            own = used[at] - ports.start
            self.bodies.append(_Body(part))
            self._at.append((at, own))
            self._reference[at] = part.reference[own]
            self._H.append(part.port_columns(own, 0.0))

        self._Y: list[Array] = [np.zeros_like(H) for H in self._H]
        self._own_W: list[Array] = [np.zeros((H.shape[1], H.shape[1])) for H in self._H]
        self.W: Array = np.zeros((len(used), len(used)))

    def begin(self, s: State, h: float) -> None:
        """A step of size h from a state; collective."""
        in_q, in_v, _ = self.system.slices
        g = self.system.gravity(s.t + 0.5 * h)
        for body, (k, _) in zip(self.bodies, self.system.fields, strict=True):
            body.begin((s.t, s.q[in_q[k]], s.v[in_v[k]]), h, g)
        self._turn_compliance()

    def _turn_compliance(self) -> None:
        """W for the bodies as they have turned: ports are vectors."""
        for body, (at, _), W in zip(self.bodies, self._at, self._own_W, strict=True):
            if body.turn is not None and len(at):
                T = np.kron(np.eye(len(at) // len(body.turn)), body.turn)
                W = T @ W @ T.T
            self.W[np.ix_(at, at)] = W

    def port_values(self) -> Array:
        """The ports in use at u_1; collective."""
        out = self._reference.copy()
        for body, (at, own) in zip(self.bodies, self._at, strict=True):
            if len(at):
                out[at] += body.part.ports_of(body.U, body.t)[own]
        return out

    def linearise(self) -> None:
        """Tangents at u_1 and W = H^T J_f^-1 H; collective."""
        for k, body in enumerate(self.bodies):
            if body.linearise():
                self._solve_columns(k)
                self._blocks.factorisations += 1
                self._blocks.other_solves += self._H[k].shape[1]
        self._turn_compliance()

    def _solve_columns(self, k: int) -> None:
        """J_f^-1 H and W of one body."""
        self._Y[k] = self.bodies[k].solve_columns(self._H[k])
        self._own_W[k] = self.bodies[k].field.total(self._H[k].T @ self._Y[k])

    def remember(self, m: Memory) -> None:
        """Where tangents were taken, which are taken there again; collective."""
        for k, body in enumerate(self.bodies):
            body.remember(m.inside(str(k)))
            if m.reading and body.taken is not None:
                self._solve_columns(k)

    def back(self, port: Array) -> Array:
        """H^T z, z = J_f^-1 r_f with the forces ``port`` on the ports; collective."""
        out = np.zeros(len(self.used))
        self._z = []
        for body, (at, _), H in zip(self.bodies, self._at, self._H, strict=True):
            self._z.append(body.solve(body.residual() + H @ port[at]))
            out[at] = body.field.total(H.T @ self._z[-1])
        self._blocks.other_solves += len(self.bodies)
        return out

    def move(self, dP: Array) -> float:
        """u_1 moved by du = -z - J_f^-1 H dP; the largest mean increment of a body over its size; collective."""
        found = []
        for body, (at, _), Y, z in zip(self.bodies, self._at, self._Y, self._z, strict=True):
            dU = -z - rotate_nodal(Y @ rotate_nodal(dP[at], body.turn, back=True), body.turn)
            body.U = body.U + dU

            f = body.field
            moved, count = f.total(np.array([dU @ dU, float(f.n)]))
            found.append(float(np.sqrt(moved / count)) / f.size)
        return max(found)

    def end(self, q: Array, v: Array) -> None:
        """Write displacements and velocities at the end of the step into q and v, by the first of (1)."""
        in_q, in_v, _ = self.system.slices
        for body, (k, _) in zip(self.bodies, self.system.fields, strict=True):
            q[in_q[k]] = body.U
            v[in_v[k]] = 2.0 / body.h * (body.U - body.U0) - body.V0
