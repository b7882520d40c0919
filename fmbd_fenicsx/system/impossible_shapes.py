"""Shapes of bodies with an energy that balance forces and that no motion leads to: cells turned inside out, or crushed.

Bodies stay on their way: what a step stores in one was in it before, moved, or was brought by its forces.

    V_1 - V_0  <=  |V_0| + 2 T_0 + |(f_0 + f_1) . (u_1 - u_0)|                                                  (1)

with V the elastic energy of a body, u its displacements, f = dV/du, and T the kinetic energy of the scene where the step begins.
Forces at both ends, times the way between them, are the work of a step twice (trapezoidal rule). Equations of a step that lets a
body snap through have solutions besides, with single cells crushed or turned inside out: a barrier lies before these, which no
force has taken the body over.
"""

from __future__ import annotations

from ..fem.cell_volumes import least_volume
from ..rotations import Array
from .layout import State
from .system import System


def over_barrier(system: System, before: State, q: Array) -> str:
    """The name of a body that stores more than (1) allows where a step from a state has led, "" without any; collective."""
    for k, part in system.fields:
        field = part.field
        if not field.nonlinear:
            continue
        U0, U1 = system.local_q(before.q, k), system.local_q(q, k)
        V0, V1 = field.energy(U0), field.energy(U1)
        brought = abs(float(field.total((field.internal(U0) + field.internal(U1)) @ (U1 - U0))))
        if V1 - V0 <= abs(V0) + brought:
            continue
        moved = system.at(before.t, before.q, before.v).energies()["kinetic"]
        if V1 - V0 > abs(V0) + brought + 2.0 * moved:
            return str(part.name)
    return ""


def inside_out(system: System, q: Array) -> str:
    """The name of a body with a cell that is turned inside out in a configuration, "" where there is none; collective."""
    for k, part in system.fields:
        if part.field.nonlinear and least_volume(part.field, system.local_q(q, k)) <= 0.0:
            return str(part.name)
    return ""
