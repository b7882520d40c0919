"""The search for an equilibrium: Newton's method by load steps, else downhill to a stable one; and why there is none."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...errors import ConvergenceError, LinearSolveError
from ...fem.fields import Field
from ...linear.condensation import StepSolver
from ...log import log
from ...mechanics.elastic.modes import bound_by_soft_parts
from ...mechanics.reduction.reduced import ReducedPart
from ...rotations import Array
from ...schemes.consistent import worst_block
from ...system.layout import State
from ...system.mobility import stiffnesses
from ...system.system import System
from ..small_motions.perturbation import Perturbation
from ..small_motions.steady import BodySpin, Residual, Spin, steady_rates
from .descent import descend, descends
from .relaxation import relax
from .stability import falling, grows
from .static_newton import NoEquilibriumError, StaticNewton, StaticPoint, by_load_steps

FAR = 0.1  # displacement, over the model's length, from which on another equilibrium may be as near
ASIDE = 0.1  # displacement along a motion that may be free, over the model's length
SAME = 1e-3  # relative change of the force along a free motion there
PENDULUM = 10.0  # of the step, over sqrt(L / g)
PERIODS = 300.0  # of the step, over a bound of elastic periods
ROUNDOFF = 1e-14  # of the forces of springs at the model's length
NOTHING = 10.0  # s, where nothing moves a scene


def static_newton(
    system: System, solver: StepSolver, start: State, spin: Spin | BodySpin | None, *, balanced: bool = False
) -> StaticNewton:
    """Newton's method near a state, its preconditioner a step that is long against all periods; ``balanced``: whether the state
    is thought to be an equilibrium. Collective.
    """
    tau = long_step(system, start, spin, balanced=balanced)
    if system.contacts is None:
        return StaticNewton(Residual(system, spin), solver, tau)

    from .static_contact import ContactNewton, check_closed_contacts

    check_closed_contacts(system)
    # what slides and rolls freely moves by roundoff as the square of the step: one unit of a pendulum's time, not ten
    return ContactNewton(Residual(system, spin), solver, 0.1 * tau)


def state_of(system: System, point: StaticPoint, t: float, spin: Spin | BodySpin | None) -> State:
    """A point as a state with its steady velocities, and contact forces where there are contacts."""
    v, a = steady_rates(system, point.q, spin)
    state = State(t, point.q, v, a, point.lam)
    if system.contacts is None:
        return state

    from .static_contact import state_with_contact

    return state_with_contact(system, state, point.force)


def find(newton: StaticNewton, start: StaticPoint, t: float) -> StaticPoint:
    """:func:`by_load_steps` with shorter preconditioning steps where elastic blocks are singular; errors say what moves."""
    return newton.solvable(lambda: _found(newton, start, t))


def _found(newton: StaticNewton, start: StaticPoint, t: float) -> StaticPoint:
    """The same with the preconditioning step as it is."""
    try:
        return _stable(newton, start, by_load_steps(newton, start, t), t)
    # too far away: from the rest of a motion with much damping it may be near
    except NoEquilibriumError as error:
        try:
            return _downhill(newton, start, t)
        except (ConvergenceError, LinearSolveError):
            raise ConvergenceError(_why(newton, start, t, error)) from None


def _downhill(newton: StaticNewton, start: StaticPoint, t: float) -> StaticPoint:
    """The equilibrium by descent, else from where a motion comes to rest; with contact, whose increments descend anyway, from the
    same start with a shorter step.
    """
    slow = _slow(newton, t)
    if descends(newton):
        try:
            return descend(newton, start, t)
        except ConvergenceError:  # many kinks close to each other, as of a net whose ropes only pull
            pass
    if newton.residual.system.contacts is None:
        return by_load_steps(newton, relax(newton, start, t, slow), t)
    newton.last_at_most(slow)
    return by_load_steps(newton, start, t)


def _stable(newton: StaticNewton, start: StaticPoint, found: StaticPoint, t: float) -> StaticPoint:
    """The equilibrium found, or a stable one by descent where Newton went far to an unstable one; what stays is told."""
    system = newton.residual.system
    motion = falls(newton, found, t)
    if motion is None:
        return found
    if system.max_abs(system.difference(start.q, found.q)) > FAR * system.length:
        try:
            there = _downhill(newton, start, t)
            newton.take(there, t)
            if falls(newton, there, t) is None:
                return there
        except (ConvergenceError, LinearSolveError):
            pass
    tell_unstable(newton, found, t, motion, "Another start may lead to a stable one")
    return found


def tell_unstable(newton: StaticNewton, point: StaticPoint, t: float, motion: Array | None, remedy: str) -> None:
    """A warning of the motion by which an equilibrium is left; gyroscopic forces may hold what spins."""
    if motion is None or (newton.residual.spin is not None and not grows(_about(newton, point, t), newton, motion)):
        return
    moved = _shares(newton.residual.system, motion)
    name = max(moved, key=lambda name: moved[name])
    log.warning('equilibrium: it is unstable: body "%s" moves away from it by itself. %s', name, remedy)


def falls(newton: StaticNewton, point: StaticPoint, t: float) -> Array | None:
    """The motion by which forces drive an equilibrium without contact away, see :func:`.falling`."""
    return None if newton.residual.system.contacts is not None else falling(_about(newton, point, t), newton)


def _about(newton: StaticNewton, point: StaticPoint, t: float) -> Perturbation:
    """Small motions about a point."""
    system, spin = newton.residual.system, newton.residual.spin
    return Perturbation(system, state_of(system, point, t, spin), spin if isinstance(spin, Spin) else None)


def _slow(newton: StaticNewton, t: float) -> float:
    """Half the time unit of a pendulum of the model's length, s; without weight that of what moves the scene."""
    system = newton.residual.system
    pull = float(np.abs(system.gravity(t)).max(initial=0.0))
    return 0.5 * (float(np.sqrt(system.length / pull)) if pull else newton.tau / PENDULUM)


def _why(newton: StaticNewton, start: StaticPoint, t: float, error: NoEquilibriumError) -> str:
    """What a missing equilibrium means: a body that moves freely, or a load above the limit."""
    system = newton.residual.system
    here = _softest(newton, start, t, np.ones(system.n_v))
    free, moved = here.grown > 1.0 - 1e-6, _shares(system, here.motion)
    if free and system.contacts is None:
        ways = [replace(start, q=system.compose(start.q, way * system.length * here.motion)) for way in (ASIDE, -ASIDE)]
        aside = [_softest(newton, there, t, here.motion) for there in ways]
        # beside a body that moves freely the push is the same; beside a lever that its weight cannot hold it is not
        pushes = [here.push, *(there.push for there in aside)]
        free = float(np.ptp(pushes)) <= SAME * float(np.abs(pushes).max())
        # of bodies that move together, those that forces move by as much there
        for there in aside:
            other = _shares(system, there.image - here.motion)
            moved = {name: size for name, size in moved.items() if other[name] <= SAME * size} or moved

    if free:
        name = max(moved, key=lambda name: moved[name])
        return f'No static equilibrium: body "{name}" can move freely ({error}). Hold it by a joint or a spring.'
    g = newton.residual.values(newton.residual.at(start.q, t), start.lam)[1]
    gap = float(np.abs(g).max(initial=0.0))
    if gap > 0.1 * system.length:
        return (
            f"No static equilibrium was found from the given placement, in which {worst_block(system, g)} is open by "
            f"{gap:.3g} m: {error}. Check the positions of the bodies and the points of the joint."
        )

    narrow = [block.told for block in system.blocks if block.narrow]
    if narrow:
        return (
            f"No static equilibrium was found from the given placement: {error}. There a body turns as on a hinge of little "
            f"stiffness: {narrow[0]}. Hold a larger surface."
        )

    return (
        f"No static equilibrium was found from the given placement: {error}. The load may be above its limit: "
        "follow the equilibria with path=fmbd.ArcLength(...); loads that turn with bodies want to grow by themselves, from small "
        "ones on: path=fmbd.LoadSteps(...). Or give a start nearer to the solution."
    )


@dataclass(frozen=True)
class Softest:
    """The motion (largest displacement 1 m) that forces move farthest about a point.

    Attributes:
        motion: like v.
        grown: how far; inertia forces of a motion without any stiffness move it by as much: 1.
        push: the force along it, N.
        image: what inertia forces of the motion that the search began with move there.
    """

    motion: Array
    grown: float
    push: float
    image: Array


def _softest(newton: StaticNewton, start: StaticPoint, t: float, motion: Array) -> Softest:
    """By inverse iteration from a motion."""
    system = newton.residual.system
    q, answer = newton.respond(start, t)
    images: list[Array] = []
    for _ in range(6):
        motion = motion / max(system.max_abs(motion), 1e-300)
        motion = answer(_inertia(newton, q, t, motion))
        images.append(motion)
    grown = system.max_abs(motion)
    motion = motion / max(grown, 1e-300)
    push = system.dot(motion, newton.residual.at(q, t).balance(np.zeros(system.n_v)))
    return Softest(motion, grown, push, images[0])


def _inertia(newton: StaticNewton, q: Array, t: float, motion: Array) -> Array:
    """Inertia forces of a motion, as the preconditioner weighs them."""
    ev = newton.residual.at(q, t)
    forces: Array = newton.solver.weights.cm * (ev.balance(motion) - ev.balance(np.zeros(newton.residual.system.n_v)))
    return forces


def _shares(system: System, motion: Array) -> dict[str, float]:
    """The largest displacement (m) of each body in a motion; collective."""
    n, sizes = system.motions.n_twist, {}
    weighted = np.abs(system.units * motion)
    for i, name in enumerate(system.frame_names):
        sizes[name] = float(weighted[i * n : (i + 1) * n].max())
    for k, p in enumerate(system.parts):
        part = float(np.abs(weighted[system.slices[1][k]]).max(initial=0.0))
        sizes[p.name] = max(
            sizes.get(p.name, 0.0), part if not p.distributed else float(np.max(p.comm.allgather(part)))
        )
    return sizes


def long_step(system: System, start: State, spin: Spin | BodySpin | None, *, balanced: bool) -> float:
    """Such a step (s) near a state; ``balanced``: whether that is thought to be an equilibrium. Collective."""
    pull = float(np.abs(system.gravity(start.t)).max(initial=0.0))
    # long against a pendulum's period, and against the first vibrations of elastic bodies
    taus = [PENDULUM * float(np.sqrt(system.length / pull))] if pull else []
    taus += [
        # less than nothing where prestress makes the body buckle: so it does as fast
        PERIODS / float(np.sqrt(abs(bound_by_soft_parts(p.field))))
        for _, p in system.fields
        if isinstance(p.field, Field)
    ]
    # without either, what reduced bodies tell of the scene's unit of time, or what moves rigid ones
    reduced = [PERIODS / p.first_frequency for _, p in system.core_parts if isinstance(p, ReducedPart) and p.n]
    if taus or reduced:
        return min(taus or reduced)

    # that of a pendulum on which this force acts as weights do
    force = _force(system, start, spin, balanced=balanced)
    mass = system.mass / max(len(system.frame_names), 1)
    return PENDULUM * float(np.sqrt(mass * system.length / force)) if force > 0.0 and mass > 0.0 else NOTHING


def _force(system: System, start: State, spin: Spin | BodySpin | None, *, balanced: bool) -> float:
    """The largest force at the start, N, or that of the softest spring at the model's length; 0 where there is neither.

    On the way to an equilibrium what is out of balance comes first: a step after which it has moved bodies far sees all of it. In
    an equilibrium springs do, and then reactions: what is left is roundoff.
    """
    residual, springs = Residual(system, spin), system.length * stiffnesses(system)
    soft = float(springs.min()) if springs.size else 0.0
    if balanced and soft:
        return soft

    ev = residual.at(start.q, start.t)
    left = residual.values(ev, np.zeros(system.n_lam))[0]
    if balanced:
        left = left - residual.values(ev, start.lam)[0]
    force = system.max_abs(left / system.units**2)
    return force if force > ROUNDOFF * springs.max(initial=0.0) else soft
