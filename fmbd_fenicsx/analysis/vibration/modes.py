"""Vibration of a whole scene about an equilibrium, a steady spin or a state: frequencies, damping ratios, shapes.

    (l^2 M + l C + K) y + G^T mu = 0,    G y = 0                                                              (1)

with all terms of :mod:`..small_motions.perturbation`. Without velocity-dependent and circulatory terms the problem is symmetric
and solved as such; otherwise as the eigenvalues of its companion matrix.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np

from ...agreement import OneAnswer
from ...checks import typed
from ...errors import InputError, LinearSolveError, require
from ...linear.condensation import StepSolver
from ...log import log
from ...mechanics.elastic.modes import squares_of_frequencies
from ...ranks import rank_sum
from ...rotations import Array
from ...schemes.consistent import consistent, take_pressures
from ...system.layout import State
from ...system.mobility import tell_of_modes
from ...system.own_state import refuse_other_state
from ...system.scene.alike import alike
from ...system.scene.scene import Scene
from ...system.speed_rows import speed_rows
from ...system.system import System
from ...uncopied import Uncopied
from ..small_motions.basis import EXACT, ProjectedSystem, projected
from ..small_motions.first_order import first_order, slowest
from ..small_motions.perturbation import Perturbation
from ..small_motions.small_memory import refuse_moving_memory, relaxes
from ..small_motions.steady import BodySpin, Spin
from ..statics.equilibrium import Equilibrium
from ..statics.search import static_newton
from ..statics.static_newton import StaticNewton, StaticPoint
from .rotors import changes, check_round
from .symmetry import is_symmetric

PLANE = 1e-6  # share of circling motion below which a mode is plane
FAR = 1e-3  # accelerations of a state "in equilibrium", over weights
STAYS = 1e-10  # relative change of squared eigenvalues that are those wanted
RIGID = 1e-3  # share of the largest that is added: what rigid motions have is roundoff of it
ROUGH = 5e-6  # relative change by roundoff of the stiffness that they may have
KNOWN = 1e-4  # share to which eigenvalues are known, above which that is told
ROUNDOFF = 1e2 * np.finfo(float).eps  # of products with the stiffness, which are differences of forces, over its size
UNSTEADY = 1e-2  # way by which accelerations would move a scene in a long time, over the model's length; changes of small motions
NOTHING = 1e-6  # motion in a long time that counts as rest, over the model's length


@runtime_checkable
class AtState(Protocol):
    """What stands for a state: a run that is over for its last one, an equilibrium."""

    state: State


@dataclass(frozen=True, eq=False)
class Modes(Uncopied):
    """Modes of a scene, the slowest first; conjugate pairs once.

    Attributes:
        eigenvalues: (n,) complex, 1/s; motions are Re(shape exp(eigenvalue t)).
        shapes: (n, n_v) complex increments of the configuration, largest displacement 1 m (this rank's nodes).
        about: the state they are about. ``markers``: of the scene's sensors.
    """

    instead: ClassVar[str] = "Keep what you need of them, modes.eigenvalues, modes.shapes and modes.about."

    scene: Scene
    system: System
    about: State
    eigenvalues: Array
    shapes: Array
    markers: dict[str, int]

    @property
    def omega(self) -> Array:
        """Angular frequencies |Im l| (rad/s), (n,)."""
        return np.abs(self.eigenvalues.imag)

    @property
    def frequencies(self) -> Array:
        """Frequencies in Hz, (n,)."""
        return self.omega / (2.0 * np.pi)

    @property
    def damping(self) -> Array:
        """Damping ratios -Re l / |l|, (n,); 0 for l = 0."""
        size = np.abs(self.eigenvalues)
        return np.where(size > 0, -self.eigenvalues.real / np.where(size > 0, size, 1.0), 0.0) + 0.0  # and no -0

    @property
    def growth(self) -> Array:
        """Rates Re l (1/s) at which amplitudes grow, (n,); negative where they decay. All there is of real eigenvalues."""
        return np.asarray(self.eigenvalues.real)

    def whirl(self, axis: Sequence[float] = (0.0, 0.0, 1.0)) -> Array:
        """Sense in which each mode circles about an axis, (n,): 1 with it, -1 against it, 0 for motions in a plane; collective.

        A point moves by a cos(w t) - b sin(w t), with a + i b its part of the shape, and goes round with -a x b.
        """
        s = self.system
        d = s.motions.dim
        n = s.motions.n_twist
        held = s.n_frames * n
        out = np.zeros(len(self.shapes))
        for k in range(len(out)):
            y: Array = self.shapes[k]
            twists = y[:held].reshape(-1, n)
            # in space an axis that tilts circles as well: an antisymmetric mode leaves the middle of a shaft at rest
            moves = [twists[:, :d], s.length * twists[:, d:]] if d == 3 else [twists[:, :d]]
            local = [s.local_v(y, i).reshape(-1, d) for i, p in s.fields if p.frame == s.n_frames]
            sums = _circling(moves, axis)
            if s.comm is not None:
                sums = sums + rank_sum(s.comm, _circling(local, axis))
            out[k] = np.sign(sums[0]) if abs(sums[0]) > PLANE * sums[1] else 0.0
        return out

    def displaced(self, k: int, amplitude: float, phase: float = 0.0) -> State:
        """The state with mode k at an amplitude (m) and phase (rad): for pictures and movies."""
        require(0 <= k < len(self.eigenvalues), f"Mode {k} does not exist: there are {len(self.eigenvalues)}, from 0.")
        y = amplitude * np.real(self.shapes[k] * np.exp(1j * phase))
        return replace(self.about, q=self.system.compose(self.about.q, y))

    def __str__(self) -> str:
        table = zip(self.frequencies, self.omega, self.damping, self.growth, strict=True)
        rows = [f"  {k:>3} {f:14.6g} {w:14.6g} {z:10.2e} {g:14.6g}" for k, (f, w, z, g) in enumerate(table)]
        head = f"  {'':3} {'Hz':>14} {'rad/s':>14} {'damping':>10} {'growth 1/s':>14}"
        return "\n".join([f'modes of scene "{self.scene.name}"', head, *rows])


def _circling(moves: Sequence[Array], axis: Sequence[float]) -> Array:
    """Sums over points of the area rate about an axis and of the squared motion."""
    area = total = 0.0
    for x in moves:
        a, b = x.real, x.imag
        turn = np.cross(a, b) if x.shape[1] == 3 else a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
        area -= 2.0 * float((turn @ np.asarray(axis, dtype=float) if x.shape[1] == 3 else turn).sum())
        total += float((a * a + b * b).sum())
    return np.array([area, total])


@dataclass(frozen=True, eq=False)
class Linearised:
    """A scene about a state, ready for projections as long as :func:`prepared` lasts."""

    scene: Scene
    about: Perturbation
    solver: StepSolver
    markers: dict[str, int]
    shift: float


@alike
@typed
def modes(scene: Scene, n: int, *, at: Any = None, linear: Any = None) -> Modes:
    """The first n modes of a scene; collective.

    Args:
        at: an :class:`.Equilibrium` (rest or spin), a run (its last state), a State, or None for the placement as given.
        linear: how elastic bodies are solved, as for :func:`~fmbd_fenicsx.solve`.

    Raises:
        InputError: more modes than the scene has; a state that is not in equilibrium, with how far.
    """
    return modes_of(scene, n, at=at, linear=linear)


def modes_of(scene: Scene, n: int, *, at: Any, linear: Any = None, held: bool = False) -> Modes:
    """:func:`modes`; ``held``: without motions that nothing holds, of eigenvalue zero."""
    require(isinstance(n, int) and n >= 1, f"modes: n must be a whole number of at least 1, found {n!r}.")
    with prepared(scene, at, linear) as made:
        small = projected(made.about, made.solver, n, shift=made.shift, enough=Settled(n, made.about))
        values, vectors = eigenpairs(small, n, made.about, relaxing=relaxes(made.about.system), held=held)
    system = made.about.system
    if not system.fields:
        _tell_roundoff(small, values, vectors)
    shapes = vectors.T @ small.vectors
    sizes = [max(system.max_abs(x.real), system.max_abs(x.imag), 1e-300) for x in shapes]
    scaled = np.array([x / s for x, s in zip(shapes, sizes, strict=True)])
    found = Modes(scene, system, made.about.state, values, scaled, made.markers)
    if system.parts:
        from ...system.axial_forces import tell_axial_forces

        tell_axial_forces(made.about.here, found.about.lam, list(zip(found.frequencies, scaled, strict=True)))
    return found


@contextmanager
def prepared(scene: Scene, at: Any, linear: Any) -> Iterator[Linearised]:
    """A scene linearised about a start, an equilibrium, a run's last state or a state, as a context; collective."""
    system, given, markers = scene.build()
    with OneAnswer(system.comm):
        made = _linearised(scene, at, linear, (system, given, markers))
        try:
            tell_of_modes(made.about.here)
            yield made
        finally:
            made.solver.destroy()


def readable(scene: Scene) -> dict[str, Any]:
    """The sensors that small motions can be read with, by name."""
    if not scene.unilateral:
        return scene.sensors

    from .contact import without_contact

    return without_contact(scene.sensors)


def _linearised(scene: Scene, at: Any, linear: Any, built: tuple[System, State, dict[str, int]]) -> Linearised:
    """See :func:`prepared`."""
    system, given, markers = built
    solver = StepSolver(system, linear=linear, prefix=scene.name.replace(" ", "_") + "_")
    try:
        about = _about(scene, at, (system, given), solver)
        _refuse_rolling_fields(system, about.state)
        newton = static_newton(system, solver, about.state, about.spin, balanced=True)
        about = replace(about, time=newton.tau)
        if not isinstance(at, Equilibrium) or at.spin is None:
            _refuse_moving(about, newton)
    except BaseException:
        solver.destroy()
        raise
    return Linearised(scene, about, solver, markers, newton.weights.cm)


def _about(scene: Scene, at: Any, built: tuple[System, State], solver: StepSolver) -> Perturbation:
    """The operators at the state that ``at`` stands for."""
    system, given = built
    state = at.state if isinstance(at, AtState) else at
    if state is not None and not isinstance(state, State):
        raise InputError(f"at must be an equilibrium, a run or a state of the same scene, found {at!r}.")
    if state is not None:
        refuse_other_state(system, state, scene.name)

    closed = None
    if scene.unilateral:
        from .contact import closed_contacts, without_forces

        closed = closed_contacts(at, system, solver)
    if system.keepers:
        from ..statics.memories import remember

        remember(system, given if state is None else state, at, relaxed=isinstance(at, Equilibrium))
    if state is None:
        state, _ = consistent(system, given, solver)
    else:
        take_pressures(system, state, solver)
    if closed is not None:
        state = without_forces(state)
    spin = at.spin if isinstance(at, Equilibrium) else None
    about = Perturbation(system, state, spin if isinstance(spin, Spin) else None, closed)
    if isinstance(spin, BodySpin):
        check_round(about, spin)
    return about


def _refuse_rolling_fields(system: System, state: State) -> None:
    """Elastic fields that roll: the basis of their motions takes rows on velocities for rows on positions, right at rest only."""
    if speed_rows(system).size and system.fields and system.max_abs(state.v) > 0.0:
        raise InputError(
            "Modes about a rolling motion are offered for rigid and reduced bodies: reduce the elastic bodies by "
            "body.reduced(...), or take the modes at rest."
        )


def _refuse_moving(about: Perturbation, newton: StaticNewton) -> None:
    """A state at rest that accelerates is no equilibrium: frequencies about it would mean nothing. Of one in motion it is told.

    The time step of ``newton`` is long against all vibrations; what moves nothing in it, or until it is balanced, is roundoff.
    """
    system, state = about.system, about.state
    shift = newton.weights.cm
    speed, accel = system.max_abs(state.v), system.max_abs(state.a)
    # what gravity would do is the scale of accelerations
    pull = float(np.abs(system.gravity(state.t)).max(initial=0.0))

    if speed == 0.0 and system.keepers:
        refuse_moving_memory(about, shift)
    resting = accel <= max(FAR * pull, NOTHING * system.length * shift)
    if resting and speed == 0.0:
        return

    # where would a long step bring it? In motion, by the forces that accelerate it
    def step() -> tuple[float, float]:
        r = newton.take(StaticPoint(state.q, state.lam), state.t)
        pushed = (-r[0], -r[1]) if speed == 0.0 else (about.mass(state.a), 0.0 * r[1])
        away = 0.0 if resting else system.max_abs(newton.solver.solve(*pushed)[0])
        return away, 0.0 if speed == 0.0 else changes(about, newton)

    try:
        away, changed = newton.solvable(step)
    except LinearSolveError:
        if not resting:
            raise
        return  # nothing can be told
    if speed != 0.0:
        if max(away / system.length, changed) > UNSTEADY:
            log.warning(
                "modes: the motion at this state is not steady: bodies move with %.3g m/s and accelerate with %.3g m/s^2%s. "
                "Modes and linear models hold about equilibria and steady motions: at=fmbd.equilibrium(scene), of what turns as "
                "a whole with spin=fmbd.Spin(...)", speed, accel,
                "" if changed <= UNSTEADY else ", and what holds them or their inertia turns with them",
            )  # fmt: skip
        return
    if away > NOTHING * system.length:
        raise InputError(
            f"The scene is not in equilibrium at this state: bodies accelerate with {accel:.3g} m/s^2 at rest and are "
            f"{f'some {away:.2g} m' if away < system.length else 'far'} away. Give at=fmbd.equilibrium(scene)."
        )


def eigenpairs(
    small: ProjectedSystem, n: int, about: Perturbation, *, relaxing: bool = False, held: bool = False
) -> tuple[Array, Array]:
    """The n slowest eigenvalues (n,) of (1) on a basis and their vectors (k, n), one of each conjugate pair; collective.

    ``about``: the operators; ``relaxing``: as for :func:`.slowest`; ``held``: without zeros, but for roundoff.
    """
    M, K = small.M, small.K
    if len(small.speeds[0]) or small.memory is not None:
        values, vectors = _double_zeros(small, *slowest(first_order(small), relaxing=relaxing))
    else:
        # real squares omega^2 of a symmetric pencil
        squares, Y = squares_of_frequencies(0.5 * (K + K.T), 0.5 * (M + M.T))
        order = np.argsort(np.abs(squares))
        squares, Y = squares[order], Y[:, order]
        if is_symmetric(small, squares, Y, about):
            rates = np.sqrt(np.abs(squares))
            values, vectors = np.where(squares >= 0, 1j * rates, rates), Y.astype(complex)
        else:
            # in their coordinates, where roundoff of a fast one stays with it
            values, combined = slowest(first_order(small.on(Y)), relaxing=relaxing)
            values, vectors = _double_zeros(small, values, Y @ combined)

    if held:
        kept = np.logical_not(_zeros(small, values, vectors))
        values, vectors = values[kept], vectors[:, kept]
    _enough(len(values), n)
    return values[:n], vectors[:, :n]


def _zeros(small: ProjectedSystem, values: Array, vectors: Array) -> Array:
    """Which eigenvalues l are zero but for roundoff, (m,): y* (l^2 M + l C) y, so y* K y too, is nothing beside the size of K.

    Powers, not forces: what turns freely about the axis of a spin has a double zero, which roundoff of size e parts by its root,
    and the Coriolis force of l y, of that size, widens the body.
    """

    def power(A: Array) -> Array:
        return np.abs(np.sum(vectors.conj() * (A @ vectors), axis=0))

    rate, size = np.abs(values), np.linalg.norm(small.K, 2) * np.sum(np.abs(vectors) ** 2, axis=0)
    left = rate * rate * power(small.M) + rate * power(small.C)
    return np.asarray(left <= 1e3 * np.finfo(float).eps * size)


def _double_zeros(small: ProjectedSystem, values: Array, vectors: Array) -> tuple[Array, Array]:
    """Both of each pair of zeros, which roundoff parts into real ones or into a conjugate pair, of which one is listed."""
    parted = _zeros(small, values, vectors) & (values.imag != 0.0)
    each = np.repeat(np.arange(len(values)), 1 + parted)
    return np.where(parted, 0.0, values)[each], vectors[:, each]


@dataclass(eq=False)
class Settled:
    """Whether the first n eigenvalues stay as a space of motions grows: called with each larger one."""

    n: int
    about: Perturbation
    last: Array | None = None
    stays: int = 0

    def __call__(self, small: ProjectedSystem) -> bool:
        """Twice in a row they do."""
        if len(small.M) <= 2 * self.n:
            return False
        last = self.last
        values, vectors = eigenpairs(small, self.n, self.about)
        self.last = _together(values**2)
        if last is None:
            return False
        size, rough = np.abs(self.last), _roundoff(small, vectors)
        rigid = size <= rough
        borne = np.where(rigid | (rough <= ROUGH * size), rough, 0.0)
        # left and right vectors differ: what solves leave counts by itself, else by its square
        followed = np.abs(small.K - small.K.T).max() > STAYS * np.abs(small.K).max()
        stays = EXACT.rtol if followed else STAYS
        same = np.abs(self.last - last) <= stays * (size + RIGID * size.max()) + borne
        self.stays = self.stays + 1 if same.all() else 0
        return self.stays == 2


def _together(squares: Array) -> Array:
    """Values, with the mean of those that lie as near as errors of ``STAYS`` part a double root: that keeps to them, the roots
    stray by their square root.

    What flies straight on turns back in turning axes: a double root at the rate of the spin, which has one motion only,
    (l + i w)^2 = e w^2, whose squares are 4 w^2 sqrt(e) apart.
    """
    apart = np.abs(squares[:, None] - squares)
    near = apart <= 4.0 * np.sqrt(STAYS) * np.maximum(np.abs(squares)[:, None], np.abs(squares))
    return np.asarray((near @ squares) / near.sum(axis=1))


def _roundoff(small: ProjectedSystem, vectors: Array) -> Array:
    """What roundoff of the stiffness is in the squares of eigenvalues, (m,): that of |K| |y|^2 / (y* M y)."""
    mass = np.abs(np.sum(vectors.conj() * (small.M @ vectors), axis=0))
    squares = np.sum(np.abs(vectors) ** 2, axis=0)
    return np.asarray(ROUNDOFF * np.linalg.norm(small.K, 2) * squares / np.maximum(mass, 1e-300))


def _tell_roundoff(small: ProjectedSystem, values: Array, vectors: Array) -> None:
    """Say which eigenvalues l roundoff hides: that of K changes them by e |y|^T |K| |y| / |y* (2 l M + C) y|, that of M by |l|^2
    as much.
    """

    def power(A: Array) -> Array:
        return np.asarray(np.sum(vectors.conj() * (A @ vectors), axis=0))

    size, rate = np.abs(vectors), np.abs(values)
    slope = np.maximum(np.abs(2.0 * values * power(small.M) + power(small.C)), 1e-150)
    by_K, by_M = (np.finfo(float).eps * np.sum(size * (np.abs(A) @ size), axis=0) / slope for A in (small.K, small.M))
    by_K = np.where(by_K < rate, by_K, 0.0)  # nothing but roundoff holds the others
    share = np.minimum(np.maximum(by_K / np.maximum(rate, 1e-300), by_M * rate), 1.0)
    k = int(np.argmax(share))
    if share[k] > KNOWN:
        log.warning(
            "modes: mode %d (%.3g 1/s) is known to about %.0e of itself: stiffnesses or masses of others are as much larger. "
            "Take joints in place of what is so stiff, and leave out bodies that are so light", k, rate[k], share[k],
        )  # fmt: skip


def _enough(count: int, n: int) -> None:
    require(n <= count, f"The scene has {count} modes, {n} were asked for.")
