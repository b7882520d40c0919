"""Static equilibrium and steady rotation of a scene.

fmbd.equilibrium(scene)                      at rest under the loads of t = 0
fmbd.equilibrium(scene, t=2.0)               under those of t = 2 s, drives where they are then
fmbd.equilibrium(scene, spin=Spin(30.0))     in rotation with 30 rad/s
fmbd.equilibrium(scene, path=ArcLength(1.0)) along the loads of t = 0 ... 1 s, past limit points
fmbd.equilibrium(scene, path=LoadSteps((0.5, 1.0))) under the loads of t = 0.5 s, then of t = 1 s
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from ...agreement import OneAnswer
from ...checks import typed
from ...errors import InputError, near, require
from ...linear.condensation import StepSolver
from ...log import log
from ...mechanics.forces.effort_laws import Friction
from ...mechanics.forces.forces import CoordinateForce
from ...rotations import Array
from ...system.axial_forces import AxialForces
from ...system.bends import Bends
from ...system.compiled.choice import use_driver
from ...system.layout import State
from ...system.mobility import tell_of_modes
from ...system.scene.alike import alike
from ...system.scene.scene import Scene
from ...system.small_turns import HalfTurns, SmallTurns
from ...system.speed_rows import speed_rows
from ...system.spins import Spins
from ...system.system import System
from ...uncopied import Uncopied
from ..small_motions.steady import MOUNTS, BodySpin, Residual, Spin, body_spin
from .arc_length import ArcLength, Path
from .load_steps import LoadSteps
from .search import falls, find, state_of, static_newton, tell_unstable
from .static_newton import StaticNewton, StaticPoint

TOLD = 1e-5  # of the largest displacement, roundoff that is told
ANGLES = (1.0, 2.5)  # by which bodies are turned, rad
CHANGED = 1e-6  # increment, over the model's length, and speed, over that of the rotation, which are none


@dataclass(frozen=True, eq=False, repr=False)
class Equilibrium(Uncopied):
    """A scene in equilibrium; sensors are read with ``equilibrium["name"]``.

    Attributes:
        state: configuration, steady velocities and accelerations, multipliers, at time ``state.t``.
        path: the points of a path of equilibria, None for a single one.
        counters: Newton iterations, iterations on the exact tangent, factorisations.
    """

    instead: ClassVar[str] = (
        'Keep what you need of it, equilibrium.state and values of sensors, equilibrium["name"], or find it again in its place.'
    )

    scene: Scene
    system: System
    state: State
    markers: dict[str, int]
    spin: Spin | BodySpin | None = None
    path: Path | None = None
    counters: dict[str, int] = field(default_factory=dict)

    def __repr__(self) -> str:
        along = "" if self.path is None else f", {len(self.path.points)} points of a path"
        return (
            f'<Equilibrium of "{self.scene.name}": t = {self.state.t:g} s{along}, {self.counters["newton_iterations"]} Newton '
            f"iterations; sensors {', '.join(self.scene.sensors) or 'none'}>"
        )

    def __getitem__(self, sensor: str) -> Array:
        """Value of a sensor, (size,); collective."""
        if sensor not in self.scene.sensors:
            raise InputError(f'No sensor "{sensor}". {near(sensor, self.scene.sensors)}')
        return read(self, sensor, self.state)


def read(where: Any, sensor: str, state: State) -> Array:
    """Value of a sensor of ``where`` (scene, system, markers) in a state; collective."""
    ev = where.system.at(state.t, state.q, state.v)
    value = where.scene.sensors[sensor].read(ev, state, where.markers.get(sensor, -1))
    return np.atleast_1d(np.asarray(value, dtype=float))


@alike
@typed
def equilibrium(
    scene: Scene,
    *,
    t: float = 0.0,
    spin: Spin | None = None,
    path: ArcLength | LoadSteps | None = None,
    linear: Any = None,
) -> Equilibrium:
    """The equilibrium of a scene near its given placement, under the loads of time t (s); collective.

    Args:
        spin: steady rotation instead of rest, of the whole scene or of some of its bodies.
        path: follow equilibria along the scene's time as load parameter, from t on.
        linear: how elastic bodies are solved, as for :func:`~fmbd_fenicsx.solve`.

    Raises:
        ConvergenceError: there is none nearby: which body can move freely, or the load factor that was reached.
    """
    require(spin is None or isinstance(spin, Spin), f"equilibrium: spin must be fmbd.Spin(rate, ...), found {spin!r}.")
    require(
        path is None or isinstance(path, ArcLength | LoadSteps),
        f"equilibrium: path must be fmbd.ArcLength(...) or fmbd.LoadSteps(...), found {path!r}.",
    )
    require(
        not (scene.unilateral and isinstance(path, ArcLength)),
        "equilibrium: path=fmbd.ArcLength(...) does not take contact or joint limits, where the path has corners. "
        "Take fmbd.LoadSteps(...).",
    )
    system, given, markers = scene.build()
    use_driver(system)
    solver = StepSolver(system, linear=linear, prefix=scene.name.replace(" ", "_") + "_")

    with OneAnswer(system.comm):
        try:
            # a spin of some bodies turns them in their own frames
            turning = spin if spin is None or not spin.bodies else body_spin(system, given.q, spin)
            newton = static_newton(system, solver, replace(given, t=t), turning)
            _check_weight(newton.residual, t)
            _check_drives(newton.residual, given.q, t)
            point = _with_controllers(newton, StaticPoint(given.q, np.zeros(system.n_lam)), t, path)
            made = None if path is None else path.trace(newton, point, t)
            _check_given_speeds(newton, point.q, t)
            if made is not None:
                point, t = made.points[-1], made.parameter[-1]

            check_steady(newton, point, t)
            newton.solvable(lambda: _tell_roundoff(newton, point, t, given))
            if made is not None:
                newton.solvable(lambda: newton.take(point, t))
                tell_unstable(newton, point, t, falls(newton, point, t), "Shorter steps may lead elsewhere")
        finally:
            solver.destroy()

        _tell_smooth_friction(system)
        counters = {
            "newton_iterations": newton.iterations,
            "tangent_iterations": newton.tangent_iterations,
            "factorisations": solver.elastic.factorisations,
        }

        found = Equilibrium(scene, system, state_of(system, point, t, turning), markers, turning, made, counters)
        for watch in (Spins, SmallTurns, HalfTurns, Bends, AxialForces):
            watch(system).look(found.state)
        tell_of_modes(system.at(t, found.state.q))
        if made is not None:
            _read_along(found, made)
    return found


def settled(system: System, given: State, solver: StepSolver) -> State:
    """The state at rest in equilibrium near a given one, with memories as a run begins with there: the start of
    ``Scene(settle=True)``; collective.
    """
    newton = static_newton(system, solver, given, None)
    point = _with_controllers(newton, StaticPoint(given.q, np.zeros(system.n_lam)), given.t, None)
    state = state_of(system, point, given.t, None)
    for elements in system.elements:  # relaxed at the start of the run
        elements.kept = elements.first(system.at(state.t, state.q, state.v), state)
    return state


def _tell_smooth_friction(system: System) -> None:
    """Smooth friction creeps under any load: an equilibrium is what is left when it has crept as far as it can."""
    every = [f for loads in system.forces for f in loads.forces]
    names = [f.name for f in every if isinstance(f, CoordinateForce) and isinstance(f.law, Friction)]
    if names:
        log.warning(
            'friction "%s" is smooth through rest and holds nothing in an equilibrium; dry_friction does',
            '", "'.join(names),
        )


def _tell_roundoff(newton: StaticNewton, point: StaticPoint, t: float, given: State) -> None:
    """Say how far displacements of elastic bodies are known, where forces of stiff parts have lost the digits of soft ones."""
    system = newton.residual.system
    if not system.fields or system.contacts is not None:
        return

    displaced = system.difference(given.q, point.q)
    for k, _ in system.fields:
        own = system.slices[1][k]
        displaced[own] = np.maximum(np.abs(displaced[own]), np.abs(system.local_q(point.q, k)))
    size = system.max_abs(displaced)
    if not size > newton.tolerance * system.length:  # nothing displaces them
        return

    lost = newton.roundoff(point, t, size)
    if lost > max(TOLD * size, newton.tolerance * system.length):
        log.warning(
            "equilibrium: roundoff of forces moves bodies by %.1e m, %.0e of the largest displacement: stiffnesses lie far "
            "apart; take fmbd.FloatingBody in mean axes, bodies of one stiffness each, or rigid ones for what hardly deforms",
            lost, lost / size,
        )  # fmt: skip


def _check_weight(residual: Residual, t: float) -> None:
    """Refuse gravity across the axis of a rotation of the whole scene: in axes that turn it goes round."""
    spin, system = residual.spin, residual.system
    if not isinstance(spin, Spin) or spin.rate == 0.0:
        return
    pull = np.asarray(system.gravity(t), dtype=float)
    across = spin.matrix(system.motions.dim) @ pull / spin.rate
    if np.linalg.norm(across) > CHANGED * np.linalg.norm(pull):
        raise InputError(
            f"Gravity {tuple(map(float, pull))} acts across the axis {tuple(spin.axis)} of the rotation: in axes that turn it "
            "goes round, and no motion is steady. Leave it out, let it act along the axis, or name the bodies that spin while "
            "the others rest, fmbd.Spin(rate, axis, bodies=(...))."
        )


def _check_drives(residual: Residual, q: Array, t: float) -> None:
    """Refuse drives that move in another way than the steady rotation does."""
    ev = residual.at(q, t)
    if not isinstance(residual.spin, Spin) or not residual.system.n_lam:
        return
    assert ev.v is not None
    # where a drive moves, the steady rotation must move the joint likewise
    rate = ev.constraint_rate()
    missed = np.where(rate != 0.0, ev.jacobian.times(ev.v) + rate, 0.0)
    row = int(np.abs(missed).argmax())
    if np.abs(missed[row]) > 1e-6 * np.abs(rate[row]):
        name = residual.system.block_of(row).name
        raise InputError(
            f'"{name}" moves with {-rate[row]:.6g} (rad/s, m/s) at t = {t:g} s; in the rotation with {residual.spin.rate:g} '
            f"rad/s it would with {missed[row] - rate[row]:.6g}: no steady motion has both. Let the drive stand, as the ground "
            "turns, or give both one rate."
        )


def _check_given_speeds(newton: StaticNewton, q: Array, t: float) -> None:
    """Refuse constraints that give a speed to bodies at rest: rows on velocities take no part in an equilibrium."""
    system = newton.residual.system
    rows = speed_rows(system)
    if not rows.size or isinstance(newton.residual.spin, Spin):
        return
    given = np.abs(system.at(t, q, np.zeros(system.n_v)).constraint_rate()[rows])
    if given.max() > 1e-9 * system.length / newton.tau:
        row = rows[int(given.argmax())]
        name = system.block_of(row).name
        raise InputError(
            f'Joint "{name}" gives a speed of {given.max():.6g} m/s to bodies at rest: there is no equilibrium.'
        )


def _with_controllers(
    newton: StaticNewton, start: StaticPoint, t: float, path: ArcLength | LoadSteps | None
) -> StaticPoint:
    """:func:`find`, with memories of controllers at rest as well; collective."""
    system = newton.residual.system
    if not system.keepers:
        return find(newton, start, t)

    from .memories import begin_memories, check_sampled, remembering, steady

    check_sampled(system)
    begin_memories(system, State(t, start.q, np.zeros(system.n_v), np.zeros(system.n_v), start.lam))
    point = find(newton, start, t)
    # only memories that change efforts have to come to rest
    keeping = remembering(system, point.q, t)
    if not keeping:
        return point
    require(
        path is None,
        f'Controller "{keeping[0].controller.name}" has a memory, which no path of equilibria follows. Leave path out.',
    )
    return steady(newton, point, t, keeping)


def _read_along(found: Equilibrium, path: Path) -> None:
    """All sensors at all points of a path; collective."""
    states = [state_of(found.system, p, s, found.spin) for p, s in zip(path.points, path.parameter, strict=True)]
    for name in found.scene.sensors:
        path.series[name] = np.array([read(found, name, s) for s in states])


def check_steady(newton: StaticNewton, point: StaticPoint, t: float) -> None:
    """Refuse what holds the bodies that spin among others at rest, and equilibria that change as they turn; collective.

    They are turned by some angles, and must be in equilibrium as well. See :mod:`..small_motions.steady`.
    """
    system, spin = newton.residual.system, newton.residual.spin
    if not isinstance(spin, BodySpin) or spin.rate == 0.0:
        return

    _check_held(system, newton.residual.at(point.q, t), spin)

    # what turns must leave forces and gaps as they are
    lam = point.lam
    for angle in ANGLES:
        q = spin.turned(system, point.q, angle)
        newton.take(replace(point, q=q), t)

        there, later = (newton.residual.at(q, x) for x in (t, t + angle / spin.rate))
        balance = newton.residual.values(there, lam)[0]
        gaps = later.constraint()

        moved = system.max_abs(newton.solver.solve(-balance, -gaps)[0])
        if moved > CHANGED * system.length:
            raise InputError(
                f"The rotation of {spin.listed} is not steady: turned by {angle:g} rad, the scene moves by {moved:.3g} m. "
                "Bodies that spin among others at rest must be round about their axes, with the mass centre on it and loads that "
                "do not turn with them. " + MOUNTS
            )


def _check_held(system: System, ev: Any, spin: BodySpin) -> None:
    """Refuse joints and drives that the rotation violates."""
    if not system.n_lam:
        return
    missed = np.abs(ev.opening())
    row = int(missed.argmax())
    if missed[row] > CHANGED * abs(spin.rate) * max(system.length, 1.0):
        raise InputError(
            f'"{system.block_of(row).name}" does not let {spin.listed} spin with {spin.rate:g} rad/s: it would open with '
            f"{missed[row]:.3g} (rad/s, m/s). Name all bodies that turn, and give drives the same rate."
        )
