"""Consistent start: project positions, then velocities, in the mass metric; then solve for accelerations and multipliers.

    min |dq|_M  s.t.  g(q o dq) = 0;     min |dv|_M  s.t.  G v + g_t = 0;     [M G^T; G 0] (a, lambda) = (-h, -gamma)      (1)

Inconsistent data cost an index-3 scheme errors of size delta / h^2 in the multipliers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..errors import ConstraintError, ConvergenceError
from ..linear.blocks.incompressibility import VolumeMass, kept_volumes, volume_push
from ..linear.condensation import StepSolver, Weights
from ..linear.redundancy import least
from ..rotations import Array, cross3
from ..system.evaluation import Evaluation
from ..system.system import State, System

REFUSED = 1e-3  # a position correction above this share of the model's length is wrong input, not roundoff


@dataclass(frozen=True)
class Correction:
    """What the start changed: largest position correction (m) and velocity correction (m/s), Newton iterations."""

    position: float
    velocity: float
    iterations: int


def consistent(
    system: System,
    state: State,
    solver: StepSolver,
    *,
    metric: Weights | None = None,
    accelerated: bool = True,
    h: float = 0.0,
) -> tuple[State, Correction]:
    """The consistent state nearest to ``state``; equations (1). Collective.

    ``metric`` replaces the mass matrix; without ``accelerated`` the accelerations and multipliers stay as they are.
    ``h``: the first step (s), where it is known; velocities that move nothing in it count as zero.

    Raises:
        ConstraintError: the bodies do not fit together (correction above 1e-3 of the model's length), naming the joint.
    """
    mass = Weights(1.0, 0.0, 0.0) if metric is None else metric
    state = keep_volumes(system, state, solver)
    q, moved, n_it = state.q, 0.0, 0
    zero = np.zeros(system.n_v)
    ev = solver.at(state.t, q, state.v)
    g = first = ev.constraint()
    for n_it in range(25):  # noqa: B007, counted
        size = float(np.abs(g).max(initial=0.0))
        if not np.isfinite(size):
            names = ", ".join(f'"{b.name}"' for b in system.blocks if not np.isfinite(g[b.rows]).all())
            raise ConstraintError(f"The constraints of {names} are not finite at the start: check positions and axes.")
        if size <= 1e-14 * system.length:
            break
        solver.prepare(ev, mass)
        dq, _ = solver.solve(zero, -g)
        step = system.max_abs(dq)
        moved += step
        if moved > REFUSED * system.length:
            block = worst_block(system, first)
            raise ConstraintError(
                f"The bodies do not fit together at t = {state.t:g} s: {block} is open by "
                f"{np.abs(first).max():.3g} m, and closing "
                f"it would move bodies by more than {REFUSED:g} of the model's length ({system.length:.3g} m). "
                "Check the positions of the bodies and the center of the joint."
            )
        q = system.compose(q, dq)
        ev = solver.at(state.t, q, state.v)
        g = ev.constraint()
        if step <= 1e-15 * system.length:
            break
    _refuse_open(system, state.t, g, solver)
    solver.prepare(ev, mass)
    v = state.v
    slip = 0.0
    if system.n_lam:
        rate = ev.constraint_rate()
        dv, _ = solver.solve(zero, -(ev.jacobian.times(v) + rate))
        slip = system.max_abs(dv)
        v = v + dv
        left = ev.jacobian.times(v) + rate
        fastest = system.max_abs(v) + float(np.abs(rate).max())
        nothing = 1e-12 * system.length / h if h > 0 else 0.0
        if np.abs(left).max() > 1e-8 * fastest + nothing:
            raise ConstraintError(
                f"Velocities contradict each other at t = {state.t:g} s: {worst_block(system, left)} and a joint that it depends "
                f"on ask for rates that differ by {np.abs(left).max():.3g} m/s. Check the drives; see scene.check()."
            )
    made = replace(state, q=q, v=v)
    if not accelerated:
        return made, Correction(moved, slip, n_it)
    return accelerations(system, made, solver), Correction(moved, slip, n_it)


def accelerations(system: System, state: State, solver: StepSolver) -> State:
    """Accelerations and multipliers of a consistent (q, v), the third of (1); collective."""
    ev = solver.at(state.t, state.q, state.v)
    h = ev.balance(np.zeros(system.n_v))
    for _, part in system.fields:
        if part.field.keeps_volume:
            part.relinearise()
    solver.prepare(ev, Weights(1.0, 0.0, 0.0))
    volume_a = _volume_accelerations(system, state, solver)
    if volume_a is None:
        a, lam = solver.solve(-h, -ev.gamma())
    else:
        a, lam = solver.solve(-ev.balance(volume_a), -ev.gamma() - ev.jacobian.times(volume_a))
        a = a + volume_a
    # refinement: inertia at the deformed configuration is not exactly the solver's matrix
    typical = max(system.max_abs(a), system.max_abs(state.v) ** 2 / system.length)  # of zero in equilibrium
    # forces that cancel in an equilibrium leave their roundoff in the balance
    forces = max(system.max_abs(h), float(np.abs(ev.wrenches()).max(initial=0.0)) if system.forces else 0.0)
    forces = max([forces, *(part.field.pressure_force() for _, part, _ in kept_volumes(solver))])
    last, noise = np.inf, -1.0
    for k in range(40):
        if k == 8:  # slow: take the inertia of the deformed bodies
            solver.refresh()
        r = ev.balance(a, lam)
        if volume_a is not None and k < 2:  # the rest is roundoff of the pressure
            for at, part, volume in kept_volumes(solver):
                field: Any = part.field
                field.pressure_values = field.pressure_values - volume.both(r[at], np.zeros(field.n_pressure))[1]
            r = ev.balance(a, lam)
        c = ev.jacobian.times(a) + ev.gamma()
        da, dl = solver.solve(-r, -c)
        a, lam = a + da, lam + dl
        size = system.max_abs(da)
        at_rest = system.max_abs(r) <= 1e-13 * forces
        slow = size > 0.5 * last
        if slow and noise < 0.0:
            noise = _roundoff(system, ev, (a, lam), solver)
        stalled = slow and last <= max(1e-8 * typical, noise)  # roundoff is reached
        if at_rest or stalled or size <= 1e-11 * system.max_abs(a):
            break
        last = size
    else:
        raise ConvergenceError("The accelerations at the start did not converge: the initial deformation is too large.")
    for _, part, _ in kept_volumes(solver):
        part.relinearise()  # with the pressure found
    return replace(state, a=a, lam=least(solver, ev, lam))


def _roundoff(system: System, ev: Any, solved: tuple[Array, Array], solver: StepSolver) -> float:
    """What positions that are wrong by roundoff change in accelerations, as a length over s^2: forces that cancel in an
    elastic body at rest leave no less, however small the accelerations are; collective.
    """
    a, lam = solved
    sides = np.where(np.arange(system.n_v) % 2, 1.0, -1.0)
    moved = system.compose(ev.q, sides * np.finfo(float).eps * system.length / system.units)
    change = system.at(ev.t, moved, ev.v).balance(a, lam) - ev.balance(a, lam)
    system.move(ev.t)
    return system.max_abs(solver.solve(-change, np.zeros(system.n_lam))[0])


def keep_volumes(system: System, state: State, solver: StepSolver) -> State:
    """Bodies whose pressure is an unknown at a start: J = 1, then B v = 0, by the smallest change in the mass metric, or, below
    nu = 1/2, the pressure of their law; collective.

    Raises ConstraintError where the initial displacements are far from keeping the volume.
    """
    q, v = state.q.copy(), state.v.copy()
    for k, part in system.fields:
        field: Any = part.field
        in_q, in_v = system.slices[0][k], system.slices[1][k]
        if field.carried and not field.keeps_volume:
            field.pressure_values = field.constitutive_pressure(q[in_q])
        if not field.keeps_volume:
            continue
        for _ in range(8):
            system.at(state.t, q, v).balance(np.zeros(system.n_v))
            part.relinearise()
            mass = VolumeMass(field, 1.0)
            dU = mass.both(np.zeros(part.n), -field.volume_gap())[0]
            dV = mass.both(np.zeros(part.n), -field.volume_rate(v[in_v]))[0]
            mass.destroy()
            size, total = (
                float(np.sqrt(field.total(np.array(x @ x / field.n)))) for x in (dU, q[in_q] - state.q[in_q] + dU)
            )
            if total > REFUSED * field.size:
                raise ConstraintError(
                    f'Body "{part.name}" keeps its volume, but its initial displacements change it: points would have to move by '
                    f"{total:.3g} m. Give displacements with det(1 + grad u) = 1, or none."
                )
            if size <= 1e-14 * field.size:
                v[in_v] += dV
                break
            q[in_q] += dU
    return replace(state, q=q, v=v)


def _second_rate(system: System, state: State, k: int) -> Array:
    """B a + d/dt(B) v of part k."""
    field: Any = system.parts[k].field  # type: ignore[attr-defined]
    return np.asarray(
        field.volume_bias(system.local_q(state.q, k), system.local_v(state.v, k), system.local_v(state.a, k))
    )


def _volume_accelerations(system: System, state: State, solver: StepSolver) -> Array | None:
    """Accelerations that fulfil the hidden constraint of the volumes, like v; None without such bodies."""
    held, out = kept_volumes(solver), np.zeros(system.n_v)
    for at, part, mass in held:
        field: Any = part.field
        k = system.slices[1].index(at)
        bias = field.volume_bias(system.local_q(state.q, k), state.v[at])
        out[at] = mass.both(np.zeros(part.n), -bias)[0]
    return out if held else None


def _refuse_open(system: System, t: float, g: np.ndarray, solver: StepSolver) -> None:
    """Constraints that stay open however the bodies are placed."""
    gap = float(np.abs(g).max(initial=0.0))
    if gap > 1e-9 * system.length:
        hint = "; its rows depend on those of other joints (inconsistent redundancy)" if solver.core.redundant else ""
        raise ConstraintError(
            f"The joints contradict each other at t = {t:g} s: {worst_block(system, g)} stays open by {gap:.3g} m wherever the "
            f"bodies are placed{hint}. See scene.check()."
        )


def worst_block(system: System, g: np.ndarray) -> str:
    """The joint or frame with the largest entry of a constraint vector."""
    row = int(np.argmax(np.abs(g)))
    for block in system.blocks:
        if block.rows.start <= row < block.rows.stop:
            return block.name if block.kind == "frame" else f'joint "{block.name}" ({block.kind})'
    return "a constraint"


def jerk(
    ev: Evaluation, state: State, solver: StepSolver, weights: Weights, h: float
) -> tuple[Array, Array, dict[int, Array]]:
    """Rates a' and lambda' of accelerations and multipliers along the motion of a consistent state, evaluated as ``ev``, and
    the third rates of volume B a' of the parts that keep theirs; collective.

    M a' + G^T lambda' = -d/dt (M a + h + G^T lambda) at fixed a, lambda;   G a' = -d/dt (G a + gamma) at fixed a      (2)

    The right-hand sides are one-sided differences of second order over h/50. With the matrix of a time step as ``weights``
    vibrations that the step h does not resolve are left out of a'.
    """
    system, d = ev.system, 0.02 * h

    kept = [k for k, part in system.fields if part.field.keeps_volume]

    def defects(s: float) -> tuple[Array, Array, list[Array]]:
        q, v = system.compose(state.q, s * state.v + 0.5 * s * s * state.a), state.v + s * state.a
        at = ev if s == 0.0 else solver.at(state.t + s, q, v)
        volume = [
            _second_rate(system, State(state.t + s, at.q, state.v + s * state.a, state.a, state.lam), k) for k in kept
        ]
        return at.balance(state.a, state.lam), at.jacobian.times(state.a) + at.gamma(), volume

    (r0, c0, w0), (r1, c1, w1), (r2, c2, w2) = defects(0.0), defects(d), defects(2 * d)
    solver.prepare(ev, weights)
    rates = {k: (3 * x - 4 * y + z) / (2 * d) for k, x, y, z in zip(kept, w0, w1, w2, strict=True)}
    a, lam = solver.solve(
        (3 * r0 - 4 * r1 + r2) / (2 * d) + volume_push(solver, rates), (3 * c0 - 4 * c1 + c2) / (2 * d)
    )
    return a, lam, rates


def spin_of_acceleration(system: System, v: Array, a: Array) -> Array:
    """v x a in the rotations of space, zero elsewhere: what a third derivative of local coordinates has beyond v''."""
    out = np.zeros_like(v)
    if system.motions.dim == 3:
        k = system.n_frames * system.motions.n_twist
        out[:k].reshape(-1, 6)[:, 3:] = cross3(v[:k].reshape(-1, 6)[:, 3:], a[:k].reshape(-1, 6)[:, 3:])
    return out


def project(system: System, state: State, solver: StepSolver) -> State:
    """The state with q, then v, moved on the constraints in the mass metric, the first two of (1); a and lambda kept;
    collective.
    """
    if not system.n_lam:
        return state
    mass, zero, q = Weights(1.0, 0.0, 0.0), np.zeros(system.n_v), state.q
    for _ in range(10):
        ev = system.at(state.t, q)
        solver.prepare(ev, mass)
        dq, _ = solver.solve(zero, -ev.constraint())
        q = system.compose(q, dq)
        if system.max_abs(dq) <= 1e-13 * system.length:
            break
    ev = system.at(state.t, q, state.v)
    solver.prepare(ev, mass)
    dv, _ = solver.solve(zero, -ev.opening())
    return replace(state, q=q, v=state.v + dv)
