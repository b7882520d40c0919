"""The mass matrix of a body that keeps its volume: accelerations and corrections with no rate of volume, and their pressure.

    [ cm M   B^T ] [ x ]   [ b ]
    [ B      0   ] [ p ] = [ c ]         B = d/du int q (J - 1), where the field is linearised                            (1)

With c = 0 the map b -> x is the inverse of M on the motions that keep the volume: it stands for M^-1 wherever bodies whose
pressure is an unknown start or are projected, so that joints and volume hold together. The hidden constraints of J = 1 are
B v = 0 and B a + d/dt(B) v = 0; p is the pressure that belongs to them.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...fem.factors.factor import by_mumps
from ...rotations import Array, rotate_nodal
from ...system.evaluation import Evaluation
from ..residual import Judge
from .spd import FieldFactor


class VolumeMass(FieldFactor):
    """(1) of a field, factored (LDL^T by MUMPS). Collective."""

    def __init__(self, field: Any, cm: float) -> None:
        from petsc4py import PETSc

        self.field, self.cm = field, cm
        self.judge = Judge(f'the mass matrix of body "{field.name}" at constant volume')
        M, B = field.mass_matrix().copy(), field.coupling_matrix()
        M.scale(cm)
        # rows of volumes as large as those of masses: pivots of one size
        self.scale = float(M.norm(PETSc.NormType.INFINITY) / B.norm(PETSc.NormType.INFINITY))
        B.scale(self.scale)
        BT = B.transpose(PETSc.Mat())
        # PETSc factors no missing diagonal: zeros stand there
        none = field.compliance_matrix()
        none.scale(0.0)
        nest = PETSc.Mat().createNest([[M, BT], [B, none]], comm=field.comm)
        self.E = nest.convert("aij", PETSc.Mat())
        for x in (nest, M, B, BT, none):
            x.destroy()
        self.E.setOption(PETSc.Mat.Option.SYMMETRIC, True)

        self.ksp = PETSc.KSP().create(field.comm)
        self.ksp.setOperators(self.E)
        by_mumps(self.ksp)
        self.ksp.setUp()

        self.x, self.b = self.E.createVecs()
        self.r = self.b.duplicate()
        self.n = field.n * field.dim

    def both(self, b: Array, c: Array) -> tuple[Array, Array]:
        """x (n d,) and p (n_pressure,) of (1), judged by the true residual; collective.

        Raises LinearSolveError.
        """
        right = np.concatenate((b, self.scale * c))
        found = np.zeros_like(right)
        for _ in range(2):  # once more for its own residual: zero pivots cost digits
            self.x.array[:] = found
            self.E.mult(self.x, self.r)
            self.b.array[:] = right - self.r.array
            self.ksp.solve(self.b, self.x)
            found = found + self.x.array
        self.x.array[:] = found
        self.E.mult(self.x, self.r)
        # judged by the true residual
        left = self.r.array - right
        sums = self.field.total(np.array([left @ left, right @ right]))
        self.judge.check(float(np.sqrt(sums[0])), float(np.sqrt(sums[1])))
        return found[: self.n], self.scale * found[self.n :]

    def solve(self, b: Array) -> Array:
        """x for c = 0."""
        return self.both(b, np.zeros(self.field.n_pressure))[0]

    def destroy(self) -> None:
        """Free the factor; collective."""
        for obj in (self.ksp, self.E, self.x, self.b, self.r):
            obj.destroy()


def kept_volumes(solver: Any) -> list[tuple[slice, Any, VolumeMass]]:
    """Bodies that keep their volume: places in v, parts, and matrices (1) of the configuration that a solver has prepared."""
    s = solver.system
    pairs = zip(s.fields, solver.blocks, strict=True) if s.fields else ()
    return [(s.slices[1][k], f, b.factor) for (k, f), b in pairs if isinstance(b.factor, VolumeMass)]


def volume_push(solver: Any, rates: dict[int, Array]) -> Array:
    """Right-hand side, like v, that makes a step's matrix change volumes by ``rates`` of parts; collective."""
    s = solver.system
    out = np.zeros(s.n_v)
    for i, (k, f) in enumerate(s.fields):
        if k in rates:
            out[s.slices[1][k]] = solver.weights.ck * rotate_nodal(f.field.volume_push(rates[k]), solver.corotations[i])

    return out


def volume_gaps(ev: Evaluation) -> dict[int, Array]:
    """How far volumes are open in a state, of parts with a carried pressure (n_pressure,); collective."""
    carried: list[tuple[int, Any]] = [(k, f.field) for k, f in ev.system.fields if f.field.carried]
    return {k: field.volume_gap(ev.local(k)[0]) for k, field in carried}


def volume_rates(solver: Any, dq: Array) -> dict[int, Array]:
    """How an increment ``dq``, like v, changes the volumes of parts with a carried pressure (n_pressure,); collective."""
    s = solver.system
    fields = [(k, f.field, solver.corotations[i]) for i, (k, f) in enumerate(s.fields) if f.field.carried]
    return {k: field.volume_rate(rotate_nodal(s.local_v(dq, k), turn, back=True)) for k, field, turn in fields}


def move_pressures(solver: Any, dq: Array, gaps: dict[int, Array]) -> None:
    """Move carried pressures along with Newton's increment ``dq``, like v, where volumes are open by ``gaps``; collective."""
    s = solver.system
    for i, (k, f) in enumerate(s.fields):
        if k in gaps:
            f.field.move_pressure(rotate_nodal(s.local_v(dq, k), solver.corotations[i], back=True), gaps[k])


def take_law_pressures(system: Any, q: Array) -> None:
    """Give bodies that carry a pressure below nu = 1/2 that of their law at q; those at 1/2 keep theirs. Collective."""
    for k, part in system.fields:
        field = part.field
        if field.carried and not field.keeps_volume:
            field.pressure_values = field.constitutive_pressure(system.local_q(q, k))
