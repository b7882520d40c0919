"""Rates of accelerations and multipliers along the motion, with which first steps begin."""

from __future__ import annotations

from typing import Any

import numpy as np

from ....linear.blocks.field_blocks import Weights
from ....linear.blocks.incompressibility import volume_push
from ....linear.condensation import StepSolver
from ....rotations import Array, cross3
from ....system.evaluation import Evaluation
from ....system.layout import State
from ....system.system import System

Defects = tuple[Array, Array, list[Array]]  # of the balance, of the constraints on accelerations, of volumes


def jerk(
    ev: Evaluation, state: State, solver: StepSolver, weights: Weights, h: float
) -> tuple[Array, Array, dict[int, Array]]:
    """Rates a' and lambda' of accelerations and multipliers along the motion of a consistent state, evaluated as ``ev``, and
    the third rates of volume B a' of the parts that keep theirs; collective.

    M a' + G^T lambda' = -d/dt (M a + h + G^T lambda) at fixed a, lambda;   G a' = -d/dt (G a + gamma) at fixed a      (1)

    The right-hand sides are one-sided differences of second order over h/50. With the matrix of a time step as ``weights``
    vibrations that the step h does not resolve are left out of a'. All rates are zero where those over h/100 are others: along
    the parabola of the differences a stiff spring that turns by w s is longer by l (w s)^2 / 2, and pulls across itself.
    """
    system, d = ev.system, 0.02 * h
    kept = [k for k, part in system.fields if part.field.keeps_volume]

    def rates(points: list[tuple[Array, Array, list[Array]]], d: float) -> tuple[Array, Array, dict[int, Array]]:
        def slope(x: Array, y: Array, z: Array) -> Array:
            return (3 * x - 4 * y + z) / (2 * d)  # less the derivative

        forces, constraints, volumes = zip(*points, strict=True)
        third = {k: slope(*values) for k, *values in zip(kept, *volumes, strict=True)}
        a, lam = solver.solve(slope(*forces) + volume_push(solver, third), slope(*constraints))
        return a, lam, third

    turning = any(loads.stiff for loads in system.forces)
    ahead = np.array((d, 2 * d, 0.5 * d) if turning else (d, 2 * d))
    begin, middle, end, *early = _defects(solver.system, ev, state, kept, ahead)
    solver.prepare(ev, weights)
    found = rates([begin, middle, end], d)
    if not turning:
        return found

    # smooth motions differ by a thousandth here
    nearer = rates([begin, *early, middle], 0.5 * d)
    apart, size = (system.max_abs(x) for x in (nearer[0] - found[0], found[0]))
    if apart <= max(0.1 * size, 1e-6 * system.max_abs(state.a) / h):
        return found
    return np.zeros_like(found[0]), np.zeros_like(found[1]), {k: np.zeros_like(x) for k, x in found[2].items()}


def _defects(system: System, ev: Evaluation, state: State, kept: list[int], ahead: Array) -> list[Defects]:
    """What is left of the balance, G a + gamma, and the third rates of the volumes of the parts ``kept``: of a state, evaluated
    as ``ev``, and at times ``ahead`` (k,) of it, s, along its parabola with its accelerations and multipliers; collective.
    """
    s, (a, lam) = ahead[:, None], (state.a, state.lam)
    q, v = system.compose(state.q, s * state.v + 0.5 * s * s * a), state.v + s * a

    # all that lie ahead in one call
    every = system.batch(state.t + ahead, q, v)
    pushes, multipliers = [np.array([x] * len(ahead)) for x in (a, lam)]
    forces = [ev.balance(a, lam), *every.balance(pushes, multipliers)]
    constraints = [ev.jacobian.times(a) + ev.gamma(), *(every.jacobian.times(pushes) + every.gamma())]

    places = [(state.q, state.v), *[(q[i], v[i]) for i in range(len(ahead))]]
    volumes = [[_second_rate(system, State(state.t, there, fast, a, lam), k) for k in kept] for there, fast in places]
    return list(zip(forces, constraints, volumes, strict=True))


def _second_rate(system: System, state: State, k: int) -> Array:
    """B a + d/dt(B) v of part k."""
    field: Any = system.parts[k].field  # type: ignore[attr-defined]
    return np.asarray(
        field.volume_bias(system.local_q(state.q, k), system.local_v(state.v, k), system.local_v(state.a, k))
    )


def spin_of_acceleration(system: System, v: Array, a: Array) -> Array:
    """v x a in the rotations of space, zero elsewhere: what a third derivative of local coordinates has beyond v''."""
    out = np.zeros_like(v)
    if system.motions.dim == 3:
        k, lead = system.n_frames * system.motions.n_twist, v.shape[:-1]
        turning, pushed = (x[..., :k].reshape(*lead, -1, 6)[..., 3:] for x in (v, a))
        spins = cross3(turning, pushed)
        out[..., :k] = np.concatenate((np.zeros_like(spins), spins), axis=-1).reshape(*lead, k)
    return out
