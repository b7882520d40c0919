"""Motions in which a scene is described: all that the constraints leave, or those that its first modes need.

Scenes of replicated coordinates (rigid and reduced bodies) take a basis of the null space of G. Those with elastic fields take a
block Krylov space of the shifted operator (K + s M)^-1 M, solved by GMRES with the factors of the step's matrix; gyroscopic
and damping terms add (K + s M)^-1 C, static answers to inputs can be put in. Projected on it, (M, C, K) are small and dense. The
space grows until its modes are those wanted, or to its largest size.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from ...errors import InputError, LinearSolveError, require
from ...linear.blocks.field_blocks import Weights
from ...linear.condensation import StepSolver
from ...log import log
from ...matrices import left_free
from ...mechanics.elastic.modes import waves
from ...rotations import Array
from ...schemes.exact_tangent import exact_increment
from ...schemes.newton import ExactTangent
from ...system.compiled.choice import use_driver
from ...system.speed_rows import speed_rows
from .perturbation import Perturbation
from .small_memory import SmallMemory, small_memory

BLOCK, MORE = 3, 24  # start vectors, and vectors beyond those asked for
LARGEST = 3  # times as many where modes do not settle: those of thin bodies are slow beside the inertia that holds them
NEW = 1e-5  # share of a vector that must be new: below it stands the noise of GMRES
HELD = 1e-8  # violation of the constraints by a vector of unit length from which on it is taken out
LEFT = 0.5  # share that is left of a vector without its violation: what has less was made of it
BEYOND = 1e-6  # share of damping forces beside those of mass and stiffness that is no noise
DENSE_LIMIT = 600  # replicated coordinates up to which all of them are taken
FREE = 1e3 * float(np.finfo(float).eps)  # of the largest stiffness, what roundoff leaves of none
TRIES, LARGER = 8, 9.0  # shifts beyond the one given, and each over the one before
EXACT = ExactTangent(rtol=1e-7, max_iterations=60)

Made = TypeVar("Made")


@dataclass(frozen=True, eq=False)
class ProjectedSystem:
    """M, C, K on a basis: ``vectors`` (k, n_v), each satisfying the constraints; ``speeds``: G_s and P of rows on velocities;
    ``memory``: what moves with them in elements that remember.
    """

    vectors: Array
    M: Array
    C: Array
    K: Array
    speeds: tuple[Array, Array]
    memory: SmallMemory | None = None

    def on(self, Q: Array) -> ProjectedSystem:
        """The system on combinations Q (k, n) of the basis."""
        G, P = self.speeds
        memory = None if self.memory is None else self.memory.on(Q)
        return ProjectedSystem(
            Q.T @ self.vectors, Q.T @ self.M @ Q, Q.T @ self.C @ Q, Q.T @ self.K @ Q, (G @ Q, P @ Q), memory
        )


def projected(
    about: Perturbation,
    solver: StepSolver,
    count: int,
    *,
    shift: float,
    inputs: Sequence[Array] = (),
    enough: Callable[[ProjectedSystem], bool] | None = None,
) -> ProjectedSystem:
    """The small matrices for the first ``count`` modes, and for static answers to ``inputs`` (forces like v); collective.

    ``enough`` tells from the matrices whether the space of elastic fields need not grow any more.
    """
    system = about.system
    use_driver(system)
    if not system.fields and system.n_core <= DENSE_LIMIT:
        V = free_motions(about)
        require(len(V) > 0, "The scene has no modes: its joints and drives leave no motion free, see scene.check().")
        M, C, K = (V @ image.T for image in about.images(V))
        made = ProjectedSystem(V, M, C, K, _speeds(about, V))
    else:
        for inertia in (shift, LARGER**2 * shift):
            made, settled = _with_enough_inertia(
                about, solver, inertia, lambda inverse: _krylov(_Space(about), inverse, count, inputs, enough)
            )
            # what moves freely answers most to little inertia, and its noise hides what vibrates
            if settled or not _moves_freely(made.K):
                break
        if not settled:
            log.warning(
                "The first %d modes did not settle among %d motions: their frequencies are uncertain, as those of very thin "
                "solids; take beams, rods, or thicker cells", count, len(made.M),
            )  # fmt: skip
    return replace(made, memory=small_memory(about, made.vectors))


def reactions(about: Perturbation, solver: StepSolver, shift: float, left: Sequence[Array]) -> list[Array]:
    """The reactions (row_count,) to each of some forces, like v, that motions leave unbalanced; collective.

    Beside motions that are left out these are internal forces as well: all that is slow against them carries these to the joints.
    """
    return _with_enough_inertia(about, solver, shift, lambda inverse: [inverse.both(b)[1] for b in left])


def _with_enough_inertia(
    about: Perturbation, solver: StepSolver, shift: float, make: Callable[[_Shifted], Made]
) -> Made:
    """What ``make`` finds by the inverse (K + s M)^-1 with the least s, from the given one on, that roundoff of K does not hide.

    A thin body by itself is held by its inertia alone, and its first frequency is low against its largest.
    """
    for _ in range(TRIES):
        try:
            return make(_Shifted(about, solver, shift))
        except LinearSolveError:
            shift *= LARGER
    return make(_Shifted(about, solver, shift))


@dataclass(eq=False)
class _Space:
    """Vectors of a basis with the products of M, C and K, which grow together."""

    about: Perturbation
    vectors: list[Array] = field(default_factory=list)
    images: list[tuple[Array, Array, Array]] = field(default_factory=list)
    small: Array = field(default_factory=lambda: np.zeros((3, 0, 0)))

    def add(self, v: Array) -> None:
        """One more vector; collective."""
        about = self.about
        dot = about.system.dot
        images = about.mass(v), about.damping(v), about.stiffness(v)
        n = len(self.vectors)
        made = np.zeros((3, n + 1, n + 1))
        made[:, :n, :n] = self.small

        self.vectors.append(v)
        self.images.append(images)
        vectors = np.array(self.vectors)
        for i, image in enumerate(images):
            made[i, :, n] = dot(vectors, image)
        made[:, n] = dot(np.array(self.images), v).T
        self.small = made

    def without(self, b: Array, count: int) -> Array:
        """A force less that by which inertia answers in the first ``count`` vectors; collective.

        Of its answer what is slow would leave nothing else to be seen: beside a pendulum the waves of its rod are small, by the
        square of the ratio of the frequencies.
        """
        n = min(count, len(self.vectors))
        if not n:
            return b
        share = np.linalg.lstsq(
            self.small[0][:n, :n], self.about.system.dot(np.array(self.vectors[:n]), b), rcond=None
        )[0]
        return b - np.sum([c * image[0] for c, image in zip(share, self.images, strict=False)], axis=0)

    def projected(self) -> ProjectedSystem:
        """The matrices so far, without rows on velocities."""
        n = len(self.vectors)
        M, C, K = self.small
        return ProjectedSystem(
            np.array(self.vectors).reshape(n, self.about.system.n_v), M, C, K, (np.zeros((0, n)), np.zeros((0, n)))
        )


def _speeds(about: Perturbation, V: Array) -> tuple[Array, Array]:
    """G_s and P of the rows on velocities on a basis, (rows, k) each; rows scaled to one."""
    rows = speed_rows(about.system)
    if not len(rows):
        return np.zeros((0, len(V))), np.zeros((0, len(V)))
    G = np.array([about.rows(v)[rows] for v in V]).reshape(len(V), len(rows)).T
    P = np.array([about.slip(v) for v in V]).reshape(len(V), len(rows)).T
    size = np.maximum(np.linalg.norm(G, axis=1), 1e-300)[:, None]
    return G / size, P / size


def free_motions(about: Perturbation) -> Array:
    """Basis (k, n_v) of all motions that the constraints leave (those on velocities aside); replicated coordinates only."""
    system = about.system
    held = np.setdiff1d(np.arange(about.row_count), speed_rows(system))
    if not len(held):
        return np.diag(1.0 / system.units)
    G = np.array([about.rows(e)[held] for e in np.diag(1.0 / system.units)]).T
    return np.asarray(left_free(G) / system.units)


def _moves_freely(K: Array) -> bool:
    """Whether nothing but roundoff holds some combination of motions of unit length, by their stiffness (k, k)."""
    held = np.abs(np.linalg.eigvalsh(0.5 * (K + K.T)))
    return bool(held.min() <= FREE * held.max())


def _krylov(
    space: _Space,
    inverse: _Shifted,
    count: int,
    inputs: Sequence[Array],
    enough: Callable[[ProjectedSystem], bool] | None,
) -> tuple[ProjectedSystem, bool]:
    """The matrices on an orthonormal basis of a block Krylov space, and whether they are ``enough``; where it ends early others
    go on beside it.

    Gyroscopic forces of what answers to such forces are left to later answers to inertia: all words of both, twice as many with
    each answer, would fill the space at a depth of a few.
    """
    about, basis, freedom = space.about, space.vectors, _freedom(space.about)
    limit = min((3 * count + MORE) * (1 if enough is None else LARGEST), freedom)
    gyroscopic: list[bool] = []  # of the vectors, which answer to forces of that kind
    started = known = done = 0  # random starts; vectors whose own answers are left out; those that were answered

    def starts() -> list[Array]:
        numbers = range(started, started + BLOCK)
        return [inverse.solve(space.without(about.mass(random_motion(about, i)), known)) for i in numbers]

    waiting = [(x, False) for x in [inverse.solve(b) for b in inputs] + starts()]
    turning = _turning(about, waiting[-1][0])
    while len(basis) < limit:
        # the space has ended: other motions, which it cannot hold, begin beside it
        if not waiting and done == len(basis):
            if known == done:
                break
            known, started = done, started + BLOCK
            waiting = [(x, False) for x in starts()]
        elif not waiting:
            if enough is not None and done % BLOCK == 0 and done >= count and enough(space.projected()):
                break
            # the next answers: (K + s M)^-1 M v, and C v where velocities make forces
            mass, damping, stiffness = space.images[done]
            again = gyroscopic[done]
            done += 1
            waiting.append((inverse.solve(space.without(mass, known)), False))
            if turning and not again and (beyond := _beyond(about, damping, (mass, stiffness))) is not None:
                waiting.append((inverse.solve(space.without(beyond, known)), _skew(space.small[1])))

        x, by_gyroscopic = waiting.pop(0)
        made = new_part(about, basis, x, inverse.inverse)
        if made is not None:
            space.add(made)
            gyroscopic.append(by_gyroscopic)
    return space.projected(), enough is None or len(basis) < limit or limit == freedom


def new_part(
    about: Perturbation, basis: list[Array], x: Array, solve: Callable[[Array, Array], tuple[Array, Array]]
) -> Array | None:
    """What of x is new beside the basis, of unit length and without violation of the constraints; None where it is noise.

    ``solve`` answers (force, gaps) by a motion that closes the gaps. Collective.
    """
    size = _norm(about, x)
    x = _beside(about, basis, x)
    left = _norm(about, x)
    if not left > NEW * size > 0.0:
        return None
    x = x / left
    if np.abs(about.rows(x)).max(initial=0.0) <= HELD:
        return x
    # what violates the constraints was enlarged with the rest, or is all there is
    x = _beside(about, basis, x + solve(np.zeros_like(x), -about.rows(x))[0])
    left = _norm(about, x)
    return x / left if left > LEFT else None


def _beside(about: Perturbation, basis: list[Array], x: Array) -> Array:
    """x without its parts along the basis."""
    if not basis:
        return x
    system, vectors = about.system, np.array(basis)
    # twice: the second pass takes the roundoff of the first
    for _ in range(2):
        x = x - system.dot(vectors, system.units**2 * x) @ vectors
    return x


def _beyond(about: Perturbation, damping: Array, others: tuple[Array, ...]) -> Array | None:
    """Damping forces C v without their part along M v and K v; None where that is all, as by Rayleigh's damping.

    The answer to K v is v less that to s M v: the space holds both.
    """
    dot, units = about.system.dot, about.system.units
    size = np.sqrt(dot(damping / units, damping / units))
    # without the one, then without what is left of the other
    left = damping / units
    known: list[Array] = []
    for other in others:
        x = other / units
        for e in known:
            x = x - dot(e, x) * e
        known.append(x / max(float(np.sqrt(dot(x, x))), 1e-300))
        left = left - dot(known[-1], left) * known[-1]
    return units * left if np.sqrt(dot(left, left)) > BEYOND * size else None


def _norm(about: Perturbation, x: Array) -> float:
    units = about.system.units
    return float(np.sqrt(about.system.dot(units * x, units * x)))


def _skew(C: Array) -> bool:
    """Whether forces of velocities do no work on any, but for noise."""
    return bool(np.abs(C + C.T).max() <= BEYOND * np.abs(C).max())


def _turning(about: Perturbation, x: Array) -> bool:
    """Whether there are velocity-dependent forces."""
    return _norm(about, about.damping(x)) > 1e-12 * _norm(about, about.stiffness(x))


def _freedom(about: Perturbation) -> int:
    system = about.system
    fields = sum(p.field.n_global for _, p in system.fields)
    return max(int(system.n_core + fields - about.row_count), 1)


def random_motion(about: Perturbation, k: int) -> Array:
    """A random array like v, the same for any number of ranks: fields get waves of random lengths and phases."""
    system = about.system
    draw = np.random.default_rng(k)
    out = np.zeros(system.n_v)
    out[: system.n_core] = draw.standard_normal(system.n_core)
    for i, part in system.fields:
        out[system.slices[1][i]] = waves(part.field, draw)
    return out / system.units


class _Shifted:
    """(K + s M)^-1 with the constraints, exact up to GMRES's tolerance."""

    def __init__(self, about: Perturbation, solver: StepSolver, shift: float) -> None:
        self.about, self.shift = about, shift
        s = about.state
        ev = about.system.at(s.t, s.q, s.v)
        # tangents are those of this state
        ev.forces = s.a, s.lam
        ev.take_tangents()
        solver.prepare(ev, Weights(shift, 0.0, 1.0))
        self.inverse = solver.solve if about.closed is None else about.closed.held(solver)

    def solve(self, b: Array) -> Array:
        """x of :meth:`both`."""
        return self.both(b)[0]

    def both(self, b: Array) -> tuple[Array, Array]:
        """x and mu with (K + s M) x + G^T mu = b, G x = 0."""
        about, system = self.about, self.about.system
        none = np.zeros(about.row_count)

        def moved(d: Array) -> tuple[Array, Array]:
            return about.stiffness(d) + self.shift * about.mass(d) - b, about.rows(d)

        x, mu, _ = exact_increment(EXACT, system, self.inverse, moved, (b, none))
        if not np.isfinite(system.max_abs(x)):
            raise InputError("The linearised scene is singular at this state: a body without mass is not held.")
        return x, mu
