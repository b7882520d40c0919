"""Linear models of a scene: state space from named inputs to named outputs, and its frequency response.

With y = V z on the basis of :mod:`..small_motions.basis` and u the inputs,

    x = (z, z'),    x' = A x + B u,    o = C x + D u                                                         (1)

    A = [0 1; -M^-1 K  -M^-1 C],    B = [0; M^-1 V^T F]

with rows on velocities x = (z, what these leave of z'), with memories (integrals of controllers, dashpots) these as well, see
:mod:`..small_motions.first_order`; minimal for rigid and reduced bodies: constraints are gone, whatever form a scheme would use.
Outputs are the scene's sensors, differentiated by positions, velocities, accelerations, reactions and memories.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg as sl

from ...checks import array, typed
from ...errors import InputError, near, require
from ...mechanics.forces.force_elements import Loads, ScalarLoads, TimeLoads
from ...rotations import Array
from ...system.evaluation import Evaluation
from ...system.layout import State
from ...system.scene.alike import alike
from ...system.scene.scene import Scene
from ..small_motions.basis import ProjectedSystem, projected, random_motion, reactions
from ..small_motions.first_order import first_order
from ..small_motions.perturbation import FAST, SIDES, Perturbation
from ..small_motions.small_memory import changed, memory_size, pushed_by
from .modes import Linearised, eigenpairs, prepared, readable

STEP = 1e-4
AXES = ("x", "y", "z")
REACTION = 3  # place of multipliers behind places, velocities and accelerations
Motion = tuple[Array, Array, Array]  # y, y', y''
NEAREST = 1e-9  # relative distance of a frequency to an undamped one that is refused


@dataclass(frozen=True, eq=False)
class LinearModel:
    """Matrices of (1), with the names of inputs and outputs ("force y", "tip x")."""

    A: Array
    B: Array
    C: Array
    D: Array
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    @property
    def state_space(self) -> Any:
        """As a ``scipy.signal.StateSpace``."""
        from scipy.signal import StateSpace

        return StateSpace(self.A, self.B, self.C, self.D)

    def frequency_response(self, omega: Sequence[float] | Array) -> Array:
        """H(i omega) = C (i omega - A)^-1 B + D for angular frequencies (rad/s), (n, outputs, inputs) complex.

        Raises InputError at an undamped resonance.
        """
        omega = np.atleast_1d(array("frequency_response: omega", omega, shape="finite numbers (rad/s)"))
        values = np.linalg.eigvals(self.A) if len(self.A) else np.zeros(0)
        out = np.empty((len(omega), len(self.C), self.B.shape[1]), dtype=complex)
        for k, w in enumerate(omega):
            # at an eigenvalue the matrix is singular, and its solution roundoff
            gap = np.abs(1j * w - values)
            if len(gap) and gap.min() <= NEAREST * max(abs(float(w)), float(np.abs(values).max()) * 1e-6):
                raise InputError(
                    f"Undamped resonance at {w:.9g} rad/s: the response is unbounded. Add damping, or leave that frequency out."
                )
            out[k] = self.C @ np.linalg.solve(1j * w * np.eye(len(self.A)) - self.A, self.B) + self.D
        return out


@alike
@typed
def linearise(
    scene: Scene, inputs: Sequence[str] = (), outputs: Sequence[str] = (), *, at: Any = None, modes: int | None = None
) -> LinearModel:
    """The linear model of a scene about a state; collective.

    Args:
        inputs: names of forces, torques, efforts or springs, whole ("push") or one component ("push y"); an input adds to the
            force that is there, for a spring or an effort along its coordinate.
        outputs: names of sensors, whole or one component ("tip y").
        at: as for :func:`.modes`.
        modes: keep the first so many modes only; scenes with elastic fields take 20 and static answers where None.

    Raises:
        InputError: an unknown input or output, or a state that is not in equilibrium.
    """
    with prepared(scene, at, None) as made:
        forces = _inputs(made, inputs)
        small = projected(made.about, made.solver, modes or 20, shift=made.shift, inputs=[f for _, f in forces])
        if modes is not None:
            small = _first_modes(small, modes, made.about)
        return _model(made, small, forces, _outputs(made, outputs))


@typed
def frequency_response(
    scene: Scene, inputs: Sequence[str], outputs: Sequence[str], omega: Sequence[float] | Array, *, at: Any = None
) -> Array:
    """H(i omega), (n, outputs, inputs) complex, of :func:`linearise`; collective."""
    for what, names in (("inputs", inputs), ("outputs", outputs)):
        require(len(names) > 0, f"frequency_response: {what} = {names!r} names nothing. Give the names of some.")
    return linearise(scene, inputs, outputs, at=at).frequency_response(omega)


def _first_modes(small: ProjectedSystem, n: int, about: Perturbation) -> ProjectedSystem:
    """The model on real and imaginary parts of its first modes."""
    _, Y = eigenpairs(small, n, about)
    Q = sl.orth(np.concatenate((Y.real, Y.imag), axis=1), rcond=1e-9)
    return small.on(Q)


def _inputs(made: Linearised, names: Sequence[str]) -> list[tuple[str, Array]]:
    """Labels and generalised forces of unit inputs, like v."""
    system, state = made.about.system, made.about.state
    ev = system.at(state.t, state.q, state.v)
    known = {
        label: ev.spread(wrench)
        for loads in system.forces
        for i in range(len(loads.forces))
        for label, wrench in _unit_wrenches(ev, loads, i)
    }
    for name in names:
        require(
            name in known or name not in made.scene.joints,
            f'Input "{name}" is a joint or a drive, and inputs are forces. Let an effort move a body that is heavy beside all '
            "others, and divide by its motion.",
        )
    return [(label, known[label]) for name in names for label in _chosen(name, known, "input")]


def _unit_wrenches(ev: Evaluation, loads: Loads, i: int) -> Iterator[tuple[str, Array]]:
    """Labels and wrenches on all markers, (n_markers, d + n_rot), of an effort of 1, or of each component of a force of time."""
    f, m = loads.forces[i], ev.system.motions
    wrench = np.zeros((len(ev.kin.x), m.dim + m.n_rot))
    if isinstance(loads, ScalarLoads):
        for marker, row in zip(loads.markers, loads.relative.rows(ev.kin), strict=True):
            wrench[marker[i]] += row[i]
        yield f.name, wrench
    elif isinstance(loads, TimeLoads):
        # in the axes that the force has
        first, n = (m.dim, m.n_rot) if f.turns else (0, m.dim)
        axes = ev.kin.R[loads.a[i]].T if f.follower and n == m.dim else np.eye(n)
        for c, axis in enumerate(axes):
            wrench[loads.a[i]] = 0.0
            wrench[loads.a[i], first : first + n] = axis
            yield f.name if n == 1 else f"{f.name} {AXES[c]}", wrench


def _chosen(name: str, known: Any, what: str) -> list[str]:
    """The labels that a name stands for."""
    found = [label for label in known if label == name or label.rsplit(" ", 1)[0] == name]
    if not found:
        raise InputError(f'Unknown {what} "{name}". {near(name, list(known))}')
    return found


def _outputs(made: Linearised, names: Sequence[str]) -> list[tuple[str, str, int]]:
    """Label, sensor and component of each output."""
    known = {}
    for name, sensor in readable(made.scene).items():
        size = len(_values(made, made.about.state, [name])[0])
        labels = list(sensor.labels)[:size] or range(size)  # in the plane vectors have two components
        for c, label in enumerate(labels):
            known[name if len(labels) == 1 else f"{name} {label}"] = (name, c)
    return [(label, *known[label]) for name in names for label in _chosen(name, known, "output")]


def _values(made: Linearised, state: State, names: Sequence[str]) -> list[Array]:
    """Values of sensors in a state."""
    ev = made.about.system.at(state.t, state.q, state.v)
    ev.balance(state.a, state.lam)
    sensors = made.scene.sensors
    return [np.atleast_1d(sensors[name].read(ev, state, made.markers.get(name, -1))) for name in names]


def _model(
    made: Linearised, small: ProjectedSystem, forces: list[tuple[str, Array]], outputs: list[tuple[str, str, int]]
) -> LinearModel:
    """(1) from the projected matrices and the derivatives of the sensors."""
    system = made.about.system
    V = small.vectors
    k = len(small.M)
    F = np.array([system.dot(V, f) for _, f in forces]).reshape(len(forces), k).T

    form = first_order(small)
    n_x = len(form.A)
    speeds = slice(k, k + len(form.push))

    B = np.zeros((n_x, len(forces)))
    B[k : k + len(form.push)] = form.push @ F

    motions: list[Motion] = []
    causes: list[tuple[Array, Array]] = []
    for j in range(n_x + len(forces)):
        # the outputs of each unit state, then of each unit force
        x = np.zeros(n_x)
        if j < n_x:
            x[j] = 1.0
        rate = form.A[speeds, j] if j < n_x else B[speeds, j - n_x]
        force = forces[j - n_x][1] if j >= n_x else np.zeros(system.n_v)

        z, z_rate, z_accel = form.motion(x, rate)
        change = np.zeros(memory_size(system))
        if small.memory is not None:
            change[small.memory.which] = x[speeds.stop :]
        motions.append((z @ V, z_rate @ V, z_accel @ V))
        causes.append((force, change))

    counts = _what_counts(made, outputs)
    held = _reactions(made, motions, causes) if counts[REACTION] else [np.zeros(system.n_lam)] * len(motions)
    most = _largest_multiplier(made, motions, held)
    answers = zip(motions, held, causes, strict=True)
    CD = np.array(
        [_answer(made, motion, (reaction, change), most, outputs, counts) for motion, reaction, (_, change) in answers]
    )
    CD = CD.reshape(n_x + len(forces), len(outputs)).T
    return LinearModel(
        form.A, B, CD[:, :n_x], CD[:, n_x:], tuple(name for name, _ in forces), tuple(label for label, _, _ in outputs)
    )


def _reactions(made: Linearised, motions: Sequence[Motion], causes: Sequence[tuple[Array, Array]]) -> list[Array]:
    """Multipliers (n_lam,) that hold each motion under its causes, a force and a change of the memory: of what it leaves."""
    about, n = made.about, made.about.system.n_lam
    if not about.row_count:
        return [np.zeros(n) for _ in motions]
    left = [
        force - about.stiffness(y) - about.damping(rate) - about.mass(accel) - pushed_by(about, change)
        for (y, rate, accel), (force, change) in zip(motions, causes, strict=True)
    ]
    return [x[:n] for x in reactions(about, made.solver, made.shift, left)]


def _read(made: Linearised, outputs: list[tuple[str, str, int]], cause: int, moved: Array) -> Array:
    """Values of the outputs where one of places, velocities, accelerations, multipliers and memories is moved; collective."""
    system, s = made.about.system, made.about.state
    still = *(np.zeros(system.n_v) for _ in range(REACTION)), np.zeros(system.n_lam), np.zeros(memory_size(system))
    y, v, a, reaction, change = (moved if i == cause else x for i, x in enumerate(still))
    state = State(s.t, system.compose(s.q, y), s.v + v, s.a + a, s.lam + reaction)
    with changed(system, s.t, change):
        values = _values(made, state, [name for _, name, _ in outputs])
    return np.array([x[c] for x, (_, _, c) in zip(values, outputs, strict=True)], dtype=float)


def _what_counts(made: Linearised, outputs: list[tuple[str, str, int]]) -> list[bool]:
    """Whether outputs hang on places, velocities, accelerations, multipliers, memories; collective. Places and memories may."""
    about, system = made.about, made.about.system
    forces = np.random.default_rng(0).standard_normal(system.n_lam) * FAST
    moved = random_motion(about, 1) / about.time, random_motion(about, 2) / about.time**2, forces
    here = _read(made, outputs, 0, np.zeros(system.n_v))
    found = [bool((_read(made, outputs, i + 1, x) != here).any()) for i, x in enumerate(moved)]
    return [True, *found, True]


def _largest_multiplier(made: Linearised, motions: Sequence[Motion], held: Sequence[Array]) -> float:
    """Of the state; where these are roundoff, that of reactions to motions through the model's length."""
    lengths = [max(_lengths(made.about, motion)) for motion in motions]
    most = max(
        (np.abs(x).max(initial=0.0) / length for x, length in zip(held, lengths, strict=True) if length), default=0.0
    )
    return max(float(np.abs(made.about.state.lam).max(initial=0.0)), float(np.finfo(float).eps * most)) or 1.0


def _lengths(about: Perturbation, motion: Sequence[Array]) -> list[float]:
    """Largest way over the model's length by each of y, y' and y'' in the slow time of the scene."""
    return [about.time**i * about.system.max_abs(x) / about.system.length for i, x in enumerate(motion)]


def _answer(
    made: Linearised,
    motion: Motion,
    held: tuple[Array, Array],
    most: float,
    outputs: list[tuple[str, str, int]],
    counts: list[bool],
) -> Array:
    """Derivatives of the outputs for a motion, its reactions (n_lam,) and a change of the memory, where they hang on them.

    ``most``: the largest multiplier that counts, N.
    """
    about, (y, rate, accel) = made.about, motion
    reaction, change = held
    parts = (y, about.velocity(y, rate), about.acceleration(y, rate, accel), reaction, change)

    # each cause by itself, in differences of fourth order: in steps for fast accelerations places are lost in roundoff
    moved = _lengths(about, parts[:REACTION])
    sizes = [*moved, np.abs(reaction).max(initial=0.0) / most, np.abs(change).max(initial=0.0)]
    total = np.zeros(len(outputs))
    for cause, size in enumerate(sizes):
        if counts[cause] and size > 0.0:
            h = STEP / size
            # in pairs: what does not move leaves nothing, however small the step
            for side, weight in SIDES[::2]:
                after, before = (_read(made, outputs, cause, way * h * parts[cause]) for way in (side, -side))
                total += weight * (after - before) / (12.0 * h)
    return total
