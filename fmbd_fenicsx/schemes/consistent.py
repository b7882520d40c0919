"""Consistent start: project positions, then velocities, in the mass metric; then solve for accelerations and multipliers.

    min |dq|_M  s.t.  g(q o dq) = 0;     min |dv|_M  s.t.  G v + g_t = 0;     [M G^T; G 0] (a, lambda) = (-h, -gamma)      (1)

Inconsistent data cost an index-3 scheme errors of size delta / h^2 in the multipliers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..errors import ConstraintError, ConvergenceError, LinearSolveError
from ..linear.blocks.field_blocks import Weights
from ..linear.blocks.incompressibility import VolumeMass, kept_volumes, take_law_pressures
from ..linear.condensation import StepSolver
from ..linear.redundancy import least
from ..linear.residual import NOTHING
from ..rotations import Array
from ..system.evaluation import Evaluation
from ..system.layout import Layout, State
from ..system.lengths import FITS, SHUT
from ..system.system import System
from .newton import known_gaps

MASS = Weights(1.0, 0.0, 0.0)
CLOSED = 1e-9  # of the model's length: what is open by less is open by roundoff
SHORTER = (1.0, 1e-2, 1e-4, 1e-6, 1e-8)  # steps, over that of a metric
ALMOST = 1e-8  # of the same: a correction whose square is roundoff


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
    metric = MASS if metric is None else metric
    state = keep_volumes(system, state)
    ev, moved, iterations = _closed(state, solver, metric)
    solver.prepare(ev, metric)
    v, slip = _velocities(ev, solver, h)
    made = replace(state, q=ev.q, v=v)
    correction = Correction(moved, slip, iterations)
    return (accelerations(system, made, solver) if accelerated else made), correction


def _closed(state: State, solver: StepSolver, metric: Weights) -> tuple[Evaluation, float, int]:
    """The system with positions on the constraints, by how much they moved (m), and the iterations; the first of (1)."""
    system, q, moved = solver.system, state.q, 0.0
    zero = np.zeros(system.n_v)
    ev = system.at(state.t, q, state.v)
    g = first = ev.constraint()
    for iterations in range(25):  # noqa: B007, counted
        if _largest(system, g) <= 1e-14 * system.length:
            break

        solver.prepare(ev, metric)
        dq, _ = solver.solve(zero, -g)

        step = system.max_abs(dq)
        moved += step
        # joints that far apart are a mistake, not a tolerance
        if moved > FITS * system.length:
            raise _does_not_fit(system, state.t, first)

        q = system.compose(q, dq)
        ev = system.at(state.t, q, state.v)
        g = ev.constraint()
        if step <= 1e-15 * system.length:
            break

    _refuse_open(ev, g, solver)
    return ev, moved, iterations


def _velocities(ev: Evaluation, solver: StepSolver, h: float) -> tuple[Array, float]:
    """Velocities on the constraints, and by how much they changed (m/s), with the matrix of the metric; the second of (1)."""
    system, v = ev.system, ev.v
    assert v is not None
    if not system.n_lam:
        return v, 0.0
    rate = ev.constraint_rate()
    dv, _ = solver.solve(np.zeros(system.n_v), -(ev.jacobian.times(v) + rate))
    v = v + dv

    left = ev.jacobian.times(v) + rate
    fastest = system.max_abs(v) + float(np.abs(rate).max())
    nothing = 1e-12 * system.length / h if h > 0 else 0.0
    known = SHUT if solver.core.redundant else 1e-8  # rows count as the same up to there
    if np.abs(left).max() > known * fastest + nothing:
        raise ConstraintError(
            f"Velocities contradict each other at t = {ev.t:g} s: {worst_block(system, left)} and a joint that it depends "
            f"on ask for rates that differ by {np.abs(left).max():.3g} m/s. Check the drives; see scene.check()."
        )
    return v, system.max_abs(dv)


def _largest(system: System, g: Array) -> float:
    """The largest gap; raises where it is no number."""
    size = float(np.abs(g).max(initial=0.0))
    if not np.isfinite(size):
        names = ", ".join(f'"{b.name}"' for b in system.blocks if not np.isfinite(g[b.rows]).all())
        raise ConstraintError(f"The constraints of {names} are not finite at the start: check positions and axes.")
    return size


def _does_not_fit(system: System, t: float, g: Array) -> ConstraintError:
    """The error of bodies too far from where their joints want them, with the constraints g as given."""
    worst = worst_block(system, g)
    driven = worst.endswith(("(drive)", "(coupling)"))

    found = (
        f"motion of {worst} begins {np.abs(g).max():.3g} m or rad away from its coordinate"
        if driven
        else f"{worst} is open by {np.abs(g).max():.3g} m"
    )

    remedy = (
        "A joint coordinate is zero where the bodies were defined, that of a segment its length: let the motion begin there"
        if driven
        else "Check the positions of the bodies and the center of the joint"
    )

    return ConstraintError(
        f"The bodies do not fit together at t = {t:g} s: {found}, and closing it would move bodies by more than {FITS:g} "
        f"of the model's length ({system.length:.3g} m). {remedy}."
    )


def accelerations(system: System, state: State, solver: StepSolver) -> State:
    """Accelerations and multipliers of a consistent (q, v), the third of (1); collective."""
    kept = [k for k, part in system.fields if part.field.keeps_volume]  # whose pressures belong to the accelerations
    driver = None if kept else solver.driver
    found = None if driver is None else driver.accelerations(state.t, state.q, state.v)
    if found is not None:
        return State(state.t, state.q, state.v, *found)

    ev = system.at(state.t, state.q, state.v)
    h = ev.balance(np.zeros(system.n_v))
    ev.take_tangents(kept)
    solver.prepare_once(ev, MASS)  # of velocities on the constraints, which moved no body
    held = kept_volumes(solver)

    start = _volume_accelerations(system, state, solver)
    gamma = ev.gamma()
    if start is None:
        a, lam = solver.solve(-h, -gamma)
    else:
        a, lam = solver.solve(-ev.balance(start), -gamma - ev.jacobian.times(start))
        a = a + start

    # inertia at the deformed configuration is not exactly the solver's matrix
    a, lam = _refined(ev, (a, lam), gamma, solver, forces=_size_of_forces(ev, h, held))
    ev.take_tangents(kept)  # with the pressures found
    return replace(state, a=a, lam=least(solver, ev.t, ev.q, lam))


def corrected(system: System, state: State, solver: StepSolver, metric: Weights) -> State:
    """A state with accelerations and multipliers nearer to the third of (1), by one increment in a metric M'; collective.

        [M' G^T; G 0] (da, dlambda) = -(M a + f + G^T lambda, G a + gamma)

    With M' = M + h D + h^2 K it leaves out what is too stiff for steps of h: errors of places times a stiffness are no forces.
    """
    ev = system.at(state.t, state.q, state.v)
    _prepare(solver, ev, metric)
    gap = ev.gamma() + ev.jacobian.times(state.a)
    da, dlam = solver.solve(-ev.balance(state.a, state.lam), -gap)
    return replace(state, a=state.a + da, lam=state.lam + dlam)


def _prepare(solver: StepSolver, ev: Evaluation, metric: Weights) -> None:
    """The matrix of a metric, that of shorter steps where masses are roundoff beside their stiffness; collective."""
    for shorter in SHORTER:
        try:
            solver.prepare(ev, Weights(metric.cm, shorter * metric.cd, shorter * shorter * metric.ck))
            return
        except LinearSolveError:
            if shorter == SHORTER[-1] or not metric.ck:
                raise


def _size_of_forces(ev: Evaluation, h: Array, held: list[Any]) -> float:
    """The largest force: those that cancel in an equilibrium leave their roundoff in the balance; collective."""
    system = ev.system
    wrench = float(np.abs(ev.wrenches()).max(initial=0.0)) if system.forces else 0.0
    return max([system.max_abs(h), wrench, *(part.field.pressure_force() for _, part, _ in held)])


def _refined(
    ev: Evaluation, found: tuple[Array, Array], gamma: Array, solver: StepSolver, *, forces: float
) -> tuple[Array, Array]:
    """Accelerations and multipliers by iterations with the solver's matrix, down to roundoff; ``forces``: their size."""
    system, v, (a, lam) = solver.system, ev.v, found
    assert v is not None
    speed = system.max_abs(v)
    typical = max(
        system.max_abs(a), speed * speed / system.length
    )  # of zero in equilibrium; v^2 of a float may not overflow
    last, noise = np.inf, -1.0

    for k in range(40):
        if k == 8:  # slow: take the inertia of the deformed bodies
            if last > typical:  # what has grown is nobody's stress
                a, lam = found
                ev.balance(np.zeros_like(a))
            solver.refresh(ev)
        if k < 2:  # the rest is roundoff of the pressure
            _renew_pressures(ev, a, lam, solver)
        r = ev.balance(a, lam)
        da, dl = solver.solve(-r, -(ev.jacobian.times(a) + gamma))
        a, lam = a + da, lam + dl

        size = system.max_abs(da)
        slow = size > 0.5 * last
        if slow and noise < 0.0:
            noise = _roundoff(system, ev, (a, lam), solver)
        at_rest = system.max_abs(r) <= max(1e-13 * forces, NOTHING)
        stalled = slow and last <= max(1e-8 * typical, noise)  # roundoff is reached
        if at_rest or stalled or size <= 1e-11 * system.max_abs(a):
            return a, lam
        last = size
    raise ConvergenceError(
        f"The accelerations at t = {ev.t:.6g} s did not converge, corrections are still {last / typical:.1e} of them: a "
        "deformation is too large, or the position is close to a singular one."
    )


def _renew_pressures(ev: Evaluation, a: Array, lam: Array, solver: StepSolver) -> None:
    """Pressures of bodies that keep their volume, from what the balance lacks; collective."""
    held = kept_volumes(solver)
    r = ev.balance(a, lam) if held else np.zeros(0)
    for at, part, volume in held:
        field: Any = part.field
        field.pressure_values = field.pressure_values - volume.both(r[at], np.zeros(field.n_pressure))[1]


def take_pressures(system: System, state: State, solver: StepSolver) -> None:
    """Give bodies whose pressure is an unknown the one that belongs to a state's accelerations and multipliers, or, below
    nu = 1/2, that of their law; collective.
    """
    take_law_pressures(system, state.q)
    kept = [k for k, part in system.fields if part.field.keeps_volume]
    if not kept:
        return
    ev = system.at(state.t, state.q, state.v)
    ev.take_tangents(kept)
    solver.prepare(ev, MASS)
    for _ in range(2):  # once more for its roundoff
        _renew_pressures(ev, state.a, state.lam, solver)


def _roundoff(system: System, ev: Any, solved: tuple[Array, Array], solver: StepSolver) -> float:
    """What positions that are wrong by roundoff change in accelerations, as a length over s^2: forces that cancel in an
    elastic body at rest leave no less, however small the accelerations are; collective.
    """
    a, lam = solved
    sides = np.where(np.arange(system.n_v) % 2, 1.0, -1.0)
    moved = system.compose(ev.q, sides * np.finfo(float).eps * system.length / system.units)
    change = system.at(ev.t, moved, ev.v).balance(a, lam) - ev.balance(a, lam)
    return system.max_abs(solver.solve(-change, np.zeros(system.n_lam))[0])


def keep_volumes(system: System, state: State) -> State:
    """Bodies whose pressure is an unknown at a start: J = 1, then B v = 0, by the smallest change in the mass metric, or, below
    nu = 1/2, the pressure of their law; collective.

    Raises ConstraintError where the initial displacements are far from keeping the volume.
    """
    q, v = state.q.copy(), state.v.copy()
    for k, part in system.fields:
        field: Any = part.field
        if field.keeps_volume:
            _keep_volume(system, k, State(state.t, q, v, state.a, state.lam), state)
    take_law_pressures(system, q)
    return replace(state, q=q, v=v)


def _keep_volume(system: System, k: int, made: State, given: State) -> None:
    """Change displacements and velocities of part k in ``made``, which began as ``given``, until its volume stays; collective."""
    part: Any = system.parts[k]
    field = part.field
    U, V = system.local_q(made.q, k), system.local_v(made.v, k)  # views
    zero = np.zeros(part.n)

    def mean(x: Array) -> float:
        return float(np.sqrt(field.total(np.array(x @ x / field.n))))

    for _ in range(8):
        system.at(made.t, made.q, made.v).take_tangents([k])
        mass = VolumeMass(field, 1.0)
        dU = mass.both(zero, -field.volume_gap(U))[0]
        dV = mass.both(zero, -field.volume_rate(V))[0]
        mass.destroy()

        size = mean(dU)
        total = mean(U - system.local_q(given.q, k) + dU)
        if total > FITS * field.size:
            raise ConstraintError(
                f'Body "{part.name}" keeps its volume, but its initial displacements change it: points would have to move by '
                f"{total:.3g} m. Give displacements with det(1 + grad u) = 1, or none."
            )
        if size <= 1e-14 * field.size:
            V += dV
            return
        U += dU


def _volume_accelerations(system: System, state: State, solver: StepSolver) -> Array | None:
    """Accelerations that fulfil the hidden constraint of the volumes, like v; None without such bodies."""
    held = kept_volumes(solver)
    out = np.zeros(system.n_v)
    for at, part, mass in held:
        field: Any = part.field
        k = system.slices[1].index(at)
        bias = field.volume_bias(system.local_q(state.q, k), state.v[at])
        out[at] = mass.both(np.zeros(part.n), -bias)[0]
    return out if held else None


def _refuse_open(ev: Evaluation, g: np.ndarray, solver: StepSolver) -> None:
    """Constraints that stay open however the bodies are placed, by more than roundoff of places."""
    system, t, gap = ev.system, ev.t, float(np.abs(g).max(initial=0.0))
    if gap > CLOSED * system.length and known_gaps(ev, g).any():
        hint = "; its rows depend on those of other joints (inconsistent redundancy)" if solver.core.redundant else ""
        raise ConstraintError(
            f"The joints contradict each other at t = {t:g} s: {worst_block(system, g)} stays open by {gap:.3g} m wherever the "
            f"bodies are placed{hint}. See scene.check()."
        )


def worst_block(system: Layout, g: np.ndarray) -> str:
    """The joint or frame with the largest entry of a constraint vector."""
    return system.block_of(int(np.argmax(np.abs(g)))).told


def widest(system: System, g: np.ndarray) -> str:
    """The joint or frame that is open most, as the rest of a message; nothing where all are closed but for roundoff."""
    gap = float(np.abs(g * system.row_units).max(initial=0.0))
    closed = gap <= CLOSED * system.length
    return "" if closed else f"; the largest open constraint is {worst_block(system, g * system.row_units)}"


def behind_a_jump(system: System, state: State, solver: StepSolver, *, h: float = 0.0) -> State:
    """:func:`consistent` where forces have jumped at the end of a step: in one call, unless what drives prescribe has, too, or
    rows may contradict each other. ``h``: the next step, s; collective.
    """
    driver = solver.driver if system.n_lam and not solver.core.redundant else None
    if driver is not None:
        driver.states.anew = True  # inputs may have been set since this time was asked for
    found = None if driver is None else driver.arrived(state.t, state.q, state.v, places=True)
    if found is not None and np.abs(found.q - state.q).max() <= FITS * system.length:
        return found
    return consistent(system, state, solver, h=h)[0]


def arrived(system: System, state: State, solver: StepSolver, *, places: bool = True) -> State:
    """The end of a step: the state moved on the constraints by :func:`project`, its velocities alone where not ``places``, with a
    and lambda there; collective.
    """
    driver = solver.driver if system.n_lam else None
    found = None if driver is None else driver.arrived(state.t, state.q, state.v, places=places)
    if found is not None:
        return found
    closed = project(system, state, solver) if places else replace(state, v=_closed_velocities(system, state, solver))
    return accelerations(system, closed, solver)


def project(system: System, state: State, solver: StepSolver, metric: Weights = MASS) -> State:
    """The state with q, then v, moved on the constraints in a metric, the first two of (1); a and lambda kept; collective."""
    if not system.n_lam:
        return state
    driver = solver.driver
    found = None if driver is None else driver.closed(state.t, state.q, state.v, metric)
    if found is not None:
        return State(state.t, *found, state.a, state.lam)

    zero = np.zeros(system.n_v)
    q = state.q
    for _ in range(10):
        ev = system.at(state.t, q)
        _prepare(solver, ev, metric)
        dq, _ = solver.solve(zero, -ev.constraint())
        q = system.compose(q, dq)
        if system.max_abs(dq) <= ALMOST * system.length:  # with the matrix there the next one is as its square
            break

    return replace(state, q=q, v=_closed_velocities(system, replace(state, q=q), solver, metric))


def _closed_velocities(system: System, state: State, solver: StepSolver, metric: Weights = MASS) -> Array:
    """The nearest ones that constraints allow; collective."""
    if not system.n_lam:
        return state.v
    ev = system.at(state.t, state.q, state.v)
    _prepare(solver, ev, metric)
    return state.v + solver.solve(np.zeros(system.n_v), -ev.opening())[0]
