"""The largest step of an explicit scheme: it must resolve the fastest vibration, which decides nothing else.

With the motions that the joints allow, G x = 0, the fastest vibration about a state is

    omega^2 = max  x^T K x / x^T M x,        c = x^T D x / x^T M x  of the same x                                     (1)

found by Lanczos' iteration: products K x are differences of the balance of forces, M^-1 is the matrix that the scheme solves
with anyway. A scheme is stable when it lets x'' + c x' + omega^2 x = 0 not grow. Beyond that an elastic body whose stiffness
depends on its motion does not even end in infinity: it shakes with large vibrations that look like a motion.

The quotient (1) is taken anew with displacements a hundred times as large: the stiffness of a law that jumps falls with them, and
is none.

Source: Golub and Van Loan, Matrix computations, chapter 10, doi:10.56021/9781421407944.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from math import hypot, sqrt
from typing import ClassVar

import numpy as np

from ...errors import ConvergenceError, StabilityError
from ...linear.blocks.field_blocks import Weights
from ...linear.condensation import StepSolver
from ...log import log
from ...rotations import Array
from ...system.layout import State
from ...system.serialisation import Remembering, plain
from ...system.system import System

MASS = Weights(1.0, 0.0, 0.0)
SMALL = 1e-7  # displacements, of the model's length
ITERATIONS = 24
SETTLED = 1e-4  # relative change of omega^2 that ends the iteration
EVERY = 50  # steps between two looks: stiffness changes along a motion
AT_MOST = 8.0  # times as many where steps could be so much longer: stiffness would have to grow by the square of that
FASTER = 4.0  # so much, and it is looked at once more
EVERY_OWN = 200  # steps of own choice between two looks
HELD = 0.9  # their size over that of the largest stable one
MANY = 5000  # of such steps, which a user wants to be told of
GROWTH = 1.0 + 1e-6  # in a step, that counts as none


@dataclass(frozen=True)
class FastestVibration:
    """The fastest vibration: ``omega`` (rad/s) and ``damping`` c (1/s) of (1), and the name of what moves most in it."""

    omega: float
    damping: float
    body: str


class _Operator:
    """K and D of (1) about a state, as products; each (n_v,) -> (n_v,) and collective."""

    def __init__(self, system: System, state: State, solver: StepSolver) -> None:
        self.system, self.state, self.solver = system, state, solver

    def _push(self, q: Array, v: Array) -> Array:
        s = self.state
        return self.system.at(s.t, q, v).balance(s.a, s.lam)

    def stiffness(self, x: Array, size: float = SMALL) -> Array:
        """K x by displacements of at most ``size`` times the model's length."""
        s = self.state
        step = size * self.system.length / max(self.system.max_abs(x), 1e-300)
        # central differences of the balance
        there, back = (self._push(self.system.compose(s.q, sign * step * x), s.v) for sign in (1.0, -1.0))
        return (there - back) / (2.0 * step)

    def damping(self, x: Array, omega: float) -> Array:
        """D x by the velocities of a vibration of the size of a hundredth of the model's length."""
        s = self.state
        step = 1e-2 * omega * self.system.length / max(self.system.max_abs(x), 1e-300)
        there, back = (self._push(s.q, s.v + sign * step * x) for sign in (1.0, -1.0))
        return (there - back) / (2.0 * step)

    def moved(self, force: Array) -> Array:
        """M^-1 of a force, in the motions that the joints allow."""
        return self.solver.solve(force, np.zeros(self.system.n_lam))[0]


def fastest_vibration(system: System, state: State, solver: StepSolver) -> FastestVibration | None:
    """(1) about a consistent state; None where nothing vibrates. Collective.

    The solver is left prepared for the mass matrix in this state.
    """
    ev = system.at(state.t, state.q, state.v)
    solver.prepare_once(ev, MASS)
    found = _lanczos(_Operator(system, state, solver))
    system.at(state.t, state.q, state.v).balance(state.a, state.lam)  # bodies remember what they were asked last
    return found


def _lanczos(operator: _Operator) -> FastestVibration | None:
    system = operator.system
    force = _rough(system)
    x = operator.moved(force)
    size = np.sqrt(max(system.dot(x, force), 0.0))
    if not size > 0:
        return None
    x, force = x / size, force / size

    # x are orthonormal in the mass metric; ``forces`` are M x, up to reactions of joints, which do no work on any x
    xs, forces, last = [x], [force], 0.0
    alphas: list[float] = []
    betas: list[float] = []
    for _ in range(ITERATIONS):
        rest = operator.stiffness(xs[-1])
        alphas.append(system.dot(xs[-1], rest))

        values, vectors = np.linalg.eigh(np.diag(alphas) + np.diag(betas, 1) + np.diag(betas, -1))
        if abs(values[-1] - last) <= SETTLED * abs(values[-1]):
            break
        last = values[-1]
        # all earlier ones, not two: roundoff would bring them back
        for y, m in zip(xs, forces, strict=True):
            rest = rest - system.dot(y, rest) * m
        x = operator.moved(rest)
        size = np.sqrt(max(system.dot(x, rest), 0.0))
        if size <= 1e-12 * abs(last):
            break
        betas.append(size)
        xs.append(x / size)
        forces.append(rest / size)

    # the fastest shape; its Rayleigh quotient over a longer way must agree, or laws are not smooth here
    shape = np.asarray(vectors[:, -1])
    x = np.sum([s * y for s, y in zip(shape, xs, strict=False)], axis=0)
    m = np.sum([s * y for s, y in zip(shape, forces, strict=False)], axis=0)
    square = system.dot(x, operator.stiffness(x, 100 * SMALL))
    if not square > 0.5 * values[-1] > 0:
        return None

    omega = float(np.sqrt(square))
    damping = max(system.dot(x, operator.damping(x, omega)), 0.0)
    return FastestVibration(omega, float(damping), _moving_most(system, x * m))


def _rough(system: System) -> Array:
    """Forces that push every vibration, the same on any number of ranks in the core, (n_v,)."""
    core = np.random.default_rng(7).standard_normal(system.n_core)
    rank = 0 if system.comm is None else system.comm.rank
    own = np.random.default_rng(8 + rank).standard_normal(system.n_v - system.n_core)
    units = np.where(system.units > 0, system.units, 1.0)
    return np.concatenate((core, own)) * units


def _moving_most(system: System, energy: Array) -> str:
    """The body with the largest share of twice the kinetic energy, (n_v,); collective."""
    n, shares = system.motions.n_twist, {}
    for k, name in enumerate(system.frame_names):
        shares[name] = float(energy[k * n : (k + 1) * n].sum())
    # with the frames' own shares of the energy
    for k, part in enumerate(system.parts):
        own = np.zeros_like(energy)
        own[system.slices[1][k]] = energy[system.slices[1][k]]
        shares[part.name] = shares.get(part.name, 0.0) + system.dot(own, np.ones_like(energy))
    return max(shares, key=lambda name: shares[name])


def spectral_radius(A: Array) -> float:
    """The largest size of an eigenvalue of a matrix (2, 2)."""
    a, b, c, d = map(float, A.ravel())
    middle = 0.5 * (a + d)
    square = 0.25 * (a - d) ** 2 + b * c  # of half the distance of both
    return abs(middle) + sqrt(square) if square >= 0.0 else hypot(middle, sqrt(-square))


def largest_step(
    vibration: FastestVibration, matrix: Callable[[float, float], Array], *, enough: float = np.inf
) -> float:
    """The largest stable step (s), with ``matrix(h omega, h c)`` of one step of the scheme for (x, h x'), (2, 2).

    ``enough``: a size (s) beyond which nobody looks; the step found may be smaller than the largest then, but not than this.
    """
    omega = vibration.omega
    return _largest_way(matrix, vibration.damping / omega, enough * omega) / omega


@lru_cache
def _largest_way(matrix: Callable[[float, float], Array], ratio: float, enough: float) -> float:
    """The largest h omega that is stable with the damping ``ratio`` c / omega, looked for up to ``enough``."""

    def grows(z: float) -> bool:
        return spectral_radius(matrix(z, z * ratio)) > GROWTH

    z = 0.02
    # up to the first growth, then halving
    while not grows(z) and z < 100.0:
        if z >= enough:
            return z
        z *= 1.05
    low, high = z / 1.05, z
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if grows(middle) else (middle, high)
    return low


class StepLimit(Remembering):
    """Looks from time to time whether the steps of a run are stable; those of own choice are no longer than ``held`` (s)."""

    keeps: ClassVar = dict.fromkeys(("left", "held", "told"), plain())

    def __init__(
        self, scheme: str, system: System, solver: StepSolver, matrix: Callable[[float, float], Array]
    ) -> None:
        self.scheme, self.system, self.solver, self.matrix = scheme, system, solver, matrix
        self.left, self.looked, self.speed = 0, 0.0, 0.0
        self.held, self.told = np.inf, False

    def free(self, state: State, h: float) -> tuple[int, float]:
        """How many steps of size h (s) may be made from a state on, and up to which speed (m/s); collective.

        Raises:
            StabilityError: it is longer than the scheme can take, with the largest that it can.
        """
        speed = self.system.max_abs(state.v)
        # looked at every so many steps, and where bodies have become faster or steps longer
        if self.left > 0 and abs(h) <= self.looked and speed <= FASTER * self.speed:
            return self.left, FASTER * self.speed
        self.left, self.looked = 0, abs(h)
        self.speed = max(speed, SMALL * self.system.length / abs(h))
        self.left = 1 + int(EVERY * self.refuse(state, h))
        return self.left, FASTER * self.speed

    def count(self, steps: int) -> None:
        """So many steps were tried."""
        self.left -= steps

    def refuse(self, state: State, h: float) -> float:
        """Raise StabilityError where a step of size h (s) is not stable; how much longer it could be, AT_MOST; collective."""
        found = fastest_vibration(self.system, state, self.solver)
        if found is None:
            return 1.0
        limit = largest_step(found, self.matrix, enough=1.1 * AT_MOST * abs(h))
        if abs(h) <= limit:
            return min(limit / abs(h), AT_MOST)
        raise StabilityError(
            f"{self.scheme} is explicit and cannot take steps of {abs(h):.3g} s at t = {state.t:.6g} s: the fastest vibration, "
            f'of body "{found.body}" ({found.omega:.3g} rad/s), grows in steps above {limit:.3g} s. Take dt <= {0.9 * limit:.2g} '
            "or an implicit scheme, such as fmbd.GeneralizedAlpha(), fmbd.Radau() or fmbd.EnergyMomentum()."
        )

    def hold(self, state: State, h: float, span: float) -> float:
        """Hold steps of the scheme's own choice, of which one of h (s) is proposed, at a share of the largest that is stable, and
        say how many may be made until that is looked at anew; collective.

        In longer ones the fastest vibration grows, until the error control sees it: to the tolerance, and velocities and stresses
        to that times its frequency. It is said where it makes more than :data:`MANY` steps of ``span`` (s).
        """
        if not (self.system.parts or self.system.forces):  # joints alone do not vibrate
            return np.inf
        if self.left > 0:
            return self.left

        found = fastest_vibration(self.system, state, self.solver)
        self.held = np.inf if found is None else HELD * largest_step(found, self.matrix)
        self.left = 1 + int(EVERY_OWN * min(max(self.held / h, 1.0), AT_MOST))

        if found is not None and h >= self.held and span > MANY * self.held and not self.told:
            self.told = True
            log.warning(
                '%s is explicit: its steps are no longer than %.2g s at t = %g s, for the fastest vibration, of body "%s" (%.3g '
                "rad/s), grows in longer ones, and %g s take %.0e of them. Take an implicit scheme, such as "
                "fmbd.GeneralizedAlpha(rtol=...) or fmbd.Radau()",
                self.scheme, self.held, state.t, found.body, found.omega, span, span / self.held,
            )  # fmt: skip
        return self.left

    def blame(self, state: State, h: float, error: Exception) -> ConvergenceError:
        """What to raise after a step from a state that ended in no finite forces; collective."""
        self.refuse(state, h)
        return ConvergenceError(
            f"{self.scheme} diverged in the step of {abs(h):.3g} s after t = {state.t:.6g} s: forces are not finite any more. "
            f"Take a smaller dt or an implicit scheme. ({error})"
        )
