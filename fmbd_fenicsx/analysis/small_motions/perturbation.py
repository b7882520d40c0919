"""Small motions about a steady state: the exact matrices M, C, K of a whole scene as operators.

Axes in which the motion is steady turn with W: that of a steady spin, zero for all other states. With y small increments of the
configuration, translations along these axes, rotations about axes of each body that turn with W alone,

    v = v_0 + y' + B y,      a = a_0 + y'' + B_1 y' + B_2 y                                                   (1)

    translations   B = W~,  B_1 = 2 W~,           B_2 = W~ W~
    rotations      B = W~,  B_1 = (2 W - w)~,     B_2 = (W - w)~ W~       W, w in body axes, w the body's own velocity

and none of them for coordinates in body axes. Coefficients are constant where a body that turns against the axes is round about
its w: wheels, rotors. The residual r of the balance, linear in a, then gives

    M y'' + C y' + K y + G^T lambda = f,     G y = 0                                                          (2)

by central differences of fourth order along y: stress, reactions, weights, spins and springs stiffen as in the equations, and
pressures that bodies carry follow their volumes. Rows on velocities (rolling) are G_s y' + P y = 0 instead. Contacts that are
closed are further rows of G, see :mod:`.closed_contacts`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ...linear.blocks.incompressibility import take_law_pressures
from ...rotations import Array
from ...system.evaluation import Evaluation
from ...system.layout import State
from ...system.speed_rows import gaps, speed_rows
from ...system.system import System
from .steady import Spin

if TYPE_CHECKING:
    from .closed_contacts import ClosedContacts

SHIFT = 1e-4  # of a difference, over the model's length
TURN = 1e-4  # of a difference, rad: by which it may turn surfaces
FAST = 2.0**100  # m/s^2: inertia forces of it are far above all others, in any units; a power of two rounds nothing
SIDES = ((1.0, 8.0), (-1.0, -8.0), (2.0, -1.0), (-2.0, 1.0))  # weights over 12 h


@dataclass(frozen=True, eq=False)
class Perturbation:
    """The operators of (2) at a state; products are collective.

    ``time`` (s): a slow time of the scene, in which differences of velocities move it as far as those of places are; stiffness
    and mass ask for none. ``way``: of differences, over the usual one.
    """

    system: System
    state: State
    spin: Spin | None = None
    closed: ClosedContacts | None = None
    time: float = 1.0
    way: float = 1.0

    @property
    def row_count(self) -> int:
        """Rows of G: those of the joints, then those of closed contacts."""
        return self.system.n_lam + (0 if self.closed is None else self.closed.count)

    def stiffness(self, y: Array) -> Array:
        """K y, like v."""
        zero = np.zeros_like(y)
        out = self._difference(y, (y, self.velocity(y, zero), self.acceleration(y, zero, zero)))
        for at, field in self._kept_volumes:
            out[at] += field.volume_push(field.volume_rate(y[at]))
        return out

    def images(self, motions: Array) -> tuple[Array, Array, Array]:
        """M, C and K times each of some motions (m, n_v), as :meth:`mass` and the others; replicated coordinates only. All states
        of one are evaluated together.
        """
        s, zero, v = self.state, np.zeros_like(motions), motions / self.time
        sizes = np.array([self._step(y) for y in motions])
        moved = motions, self.velocity(motions, zero), self.acceleration(motions, zero, zero)
        turned = self._differences(sizes, moved)
        damped = self._differences(sizes, (None, v, self.acceleration(zero, v, zero)))

        q, v, lam = (np.broadcast_to(x, (len(motions), len(x))) for x in (s.q, s.v, s.lam))
        pushed = self.system.batch(np.full(len(motions), s.t), q, v).balance(s.a + FAST * motions, lam)
        return (pushed - self._balance) / FAST, self.time * damped, turned

    def stiffness_matrix(self, columns: Array) -> Array:
        """K Y for columns Y (n_v, m); as :meth:`images`."""
        y, zero = columns.T, np.zeros_like(columns.T)
        sizes = np.array([self._step(x) for x in y])
        return self._differences(sizes, (y, self.velocity(y, zero), self.acceleration(y, zero, zero))).T

    def damping(self, rate: Array) -> Array:
        """C y', like v: dampers, gyroscopic terms."""
        zero, v = np.zeros_like(rate), rate / self.time
        return self.time * self._difference(rate, (None, v, self.acceleration(zero, v, zero)))

    def mass(self, accel: Array) -> Array:
        """M y'', like v; of accelerations so large that other forces, which may cancel each other, leave no roundoff in it."""
        found: Array = self.here.balance(self.state.a + FAST * accel, self.state.lam) - self._balance
        return found / FAST

    def rows(self, y: Array) -> Array:
        """G y, (row_count,)."""
        joints = self.here.jacobian.times(y)
        return joints if self.closed is None else np.append(joints, self.closed.times(y))

    @cached_property
    def here(self) -> Evaluation:
        """The system in the state."""
        s = self.state
        return self.system.at(s.t, s.q, s.v)

    @cached_property
    def _balance(self) -> Array:
        return self.here.balance(self.state.a, self.state.lam)

    @cached_property
    def _kept_volumes(self) -> list[tuple[slice, Any]]:
        """Places of bodies at nu = 1/2, and their fields with the volumes of the state. Motions that open these, as noise of
        solves does, would be soft: they feel the stiffness that stands for the condition in the step's matrix. Collective.
        """
        system = self.system
        kept = {k: part.field for k, part in system.fields if part.field.keeps_volume}
        self.here.take_tangents(list(kept))
        return [(system.slices[1][k], field) for k, field in kept.items()]

    def _pushed(self, q: Array) -> Array | float:
        """Forces of closed contacts, which stay as they are and turn with their surfaces; like v."""
        return 0.0 if self.closed is None else self.closed.pushed(q)

    # -- differences ------------------------------------------------------------------------------------------------
    def _step(self, along: Array) -> float:
        """Of differences along an array like v: no body moves far by it, and no surface turns far.

        A mode that displaces little turns the end of a thin body much, and angles between surfaces are not linear in it.
        """
        system, s = self.system, self.state
        twists = system.at(s.t, s.q, along).kin.twist
        turn = 0.0 if twists is None else float(np.abs(twists[:, system.motions.dim :]).max(initial=0.0))
        return self.way / max(system.max_abs(along) / (SHIFT * system.length), turn / TURN, 1e-300)

    def _difference(self, along: Array, moved: tuple[Array | None, Array, Array]) -> Array:
        """Derivative of the balance for increments (q, v, a)."""
        if self.system.max_abs(along) == 0.0:
            return np.zeros_like(along)
        h, s, (y, v, a) = self._step(along), self.state, moved
        total: Array = np.zeros_like(along)
        for side, weight in SIDES:
            # closed contacts push as before, turned with their surfaces
            e = side * h
            q = s.q if y is None else self.system.compose(s.q, e * y)
            take_law_pressures(self.system, q)
            ev = self.system.at(s.t, q, s.v + e * v)
            total += weight * (ev.balance(s.a + e * a, s.lam) - (self._pushed(q) if y is not None else 0.0))
        take_law_pressures(self.system, s.q)
        return total / (12.0 * h)

    def _differences(self, sizes: Array, moved: tuple[Array | None, Array, Array]) -> Array:
        """The same for many increments (m, n_v) by differences of sizes (m,), all states in one call."""
        s, (y, v, a) = self.state, moved
        sides, weights = (np.array(x) for x in zip(*SIDES, strict=True))

        # each at all of its places
        steps, which = np.outer(sides, sizes).reshape(-1, 1), np.tile(np.arange(len(sizes)), len(sides))
        count = len(which)
        still, lam = (np.broadcast_to(x, (count, len(x))) for x in (s.q, s.lam))
        q = still if y is None else self.system.compose(s.q, steps * y[which])
        moved_on = self.system.batch(np.full(count, s.t), q, s.v + steps * v[which])
        forces = moved_on.balance(s.a + steps * a[which], lam)
        if y is not None and self.closed is not None:
            forces = forces - np.array([self._pushed(x) for x in q])
        summed = np.einsum("i,ijk->jk", weights, forces.reshape(len(sides), len(sizes), -1))
        return np.asarray(summed / (12.0 * sizes)[:, None])

    def slip(self, y: Array) -> Array:
        """P y for the rows on velocities."""
        rows = speed_rows(self.system)
        v = self.velocity(y, np.zeros_like(y))

        def speeds(e: float) -> Array:
            s = self.state
            return gaps(self.system.at(s.t, self.system.compose(s.q, e * y), s.v + e * v), 1.0)[rows]

        h = self._step(y)
        return sum((weight * speeds(side * h) for side, weight in SIDES), np.zeros(len(rows))) / (12.0 * h)

    # -- a small motion in the axes of the balance, (1) -------------------------------------------------------------
    def velocity(self, y: Array, rate: Array) -> Array:
        """y' + B y, like v."""
        return rate + self._along(y, lambda x, W, w: W(x), self._turn)

    def acceleration(self, y: Array, rate: Array, accel: Array) -> Array:
        """y'' + B_1 y' + B_2 y, like v."""
        first = self._along(rate, lambda x, W, w: 2.0 * W(x) - w(x), lambda x: 2.0 * self._turn(x))
        second = self._along(y, lambda x, W, w: W(W(x)) - w(W(x)), lambda x: self._turn(self._turn(x)))
        return accel + first + second

    def _turn(self, x: Array) -> Array:
        """W x x for vectors (.., d) in space."""
        return np.zeros_like(x) if self.spin is None else x @ self.spin.matrix(self.system.motions.dim).T

    def _along(self, y: Array, rotations: Callable[..., Array], translations: Callable[[Array], Array]) -> Array:
        """Arrays (.., n_v) like v from translations and rotations of others; ``rotations`` gets W x and w x (body axes)."""
        s = self.system
        d, n = s.motions.dim, s.motions.n_twist
        out = np.zeros_like(y)
        k = s.n_frames * n
        twists = y[..., :k].reshape(*y.shape[:-1], -1, n)
        made = np.zeros_like(twists)
        made[..., :d] = translations(twists[..., :d])

        # rotations stand in body axes: W and w too
        if d == 3:
            own = self.state.v[:k].reshape(-1, n)[:, 3:]
            carried = self._carried
            made[..., 3:] = rotations(twists[..., 3:], lambda x: np.cross(carried, x), lambda x: np.cross(own, x))
        out[..., :k] = made.reshape(*y.shape[:-1], k)

        for i, p in s.fields:
            if p.frame == s.n_frames:
                out[s.slices[1][i]] = translations(s.local_v(y, i).reshape(-1, d)).ravel()
        return out

    @cached_property
    def _carried(self) -> Array:
        """W in the axes of each body, (n_frames, 3)."""
        s = self.system
        if self.spin is None:
            return np.zeros((s.n_frames, 3))
        axis = self.spin.rate * np.asarray(self.spin.axis, dtype=float)
        return np.asarray(np.swapaxes(s.motions.matrix(s.poses(self.state.q))[:-1], 1, 2) @ axis)
