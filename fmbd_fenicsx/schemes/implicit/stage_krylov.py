"""Stage systems of elastic fields: by a factor of their frequency, or a Krylov method with a real one as its preconditioner.

The equations are (1) and (2) of :mod:`.field_stages`, for frequencies s. A frequency that comes back has the matrix
M + C / s + K / s^2 with the constraints factored (:mod:`...linear.frequency_solvers`). It leaves out gyroscopic terms, turning
and bending only, which Newton's iteration sees in its next residual: one solution serves, until an increment is not much smaller
than the one before.

Other frequencies, of steps that are taken a few times, and those whose solutions do not serve, have J itself: divided by s^2, (2)
is solved with the matrix of a real step as preconditioner,

    P = [ M + C / |s| + K / |s|^2    G^T ]          eigenvalues of P^-1 J: on the segment from 1 to |s|^2 / s^2    (1)
        [ G                            0 ]

whatever the stiffness, so the residual falls by tan(arg(s^2) / 4) an iteration: 0.32 with two stages, 0.45 with three. All
stages and the filter of the error estimate share one elastic factor. |s| is taken from a geometric grid of three values
for a decade, whose factors are kept: the step itself may have any size.

J stays as it is for all iterations of Newton in a step. Directions and their images are therefore kept: later right-hand sides,
small and much like the first, take their part in the known directions without an evaluation (generalized conjugate residuals with
recycling).

Sources: Eisenstat, Elman and Schultz, doi:10.1137/0720023; recycling: Parks et al., doi:10.1137/040607277; real preconditioners
of complex symmetric systems: Axelsson and Kucherov, doi:10.1002/1099-1506(200005)7:4<197::AID-NLA194>3.0.CO;2-S.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import LinearSolveError
from ...linear.frequency_solvers import FrequencySolver
from ...linear.residual import Judge
from ...ranks import rank_sum
from ...rotations import Array
from ...system.system import System

if TYPE_CHECKING:
    from .field_stages import FieldEquations
    from .field_tangent import FieldTangent

ACCURATE = 1e-2  # share of the residual that an inner iteration leaves
LIMIT = 40  # inner iterations
SLOW = 0.3  # an increment, over the one before, above which the solutions of exact factors are iterated on
FEW = 2  # iterations up to which they are trusted again
SMALL = 0.005  # share of an increment that known parts may have without being seen: they come back as the next one
WEAK = 1e-6  # share of the residual that a direction takes, below which the next one is its image

Images = tuple[Array, Array, Array]  # motion (n_v,) and multipliers (n_lam,) of P^-1 J d, further rows of J d
Dot = Callable[[Array, Array], Array]


class Directions:
    """Directions d (n_v,) of one frequency whose images P^-1 J d are orthonormal, with what else is known of them."""

    def __init__(self, dot: Dot, what: str) -> None:
        self.dot, self.what = dot, what
        self.iterations = self.count = 0
        self._rows: list[Array] = []  # d, then its images: a row for each direction, and room for more

    @property
    def known(self) -> list[Array]:
        """The directions (count, n_v) and their images: motions, multipliers and further rows."""
        return [x[: self.count] for x in self._rows]

    def solve(self, first: Images, image: Callable[[Array], Images]) -> tuple[Array, Array, Array, Array]:
        """dxi with P^-1 J dxi = x, but for a share of the residual; y less the multipliers that go with dxi, z plus its further
        rows, and that share; ``first``: x, y, z. Collective.

        Raises LinearSolveError where the residual does not fall.
        """
        residual, y, z = first
        dxi = np.zeros_like(residual)
        enough = ACCURATE * self.norm(residual)
        if self.count > LIMIT:
            self.count = 0

        # the part of the residual that all known directions take
        if self.count and enough > 0.0:
            d, w, reaction, row = self.known
            shares = self.dot(w, residual)
            dxi, residual = shares @ d, residual - shares @ w
            y, z = y - shares @ reaction, z + shares @ row

        used, share, left = 0, 1.0, self.norm(residual)
        while left > enough:
            if used == LIMIT:
                raise LinearSolveError(
                    f"{self.what}: {LIMIT} iterations of the stages left {left / enough * ACCURATE:.1e} of the residual."
                )
            stuck = used > 0 and abs(share) <= WEAK * left
            self._add(self.known[1][-1] if stuck else residual / left, image)

            # and one more
            d, w, reaction, row = (x[-1] for x in self.known)
            share = self.dot(w[None], residual)[0]
            dxi, residual = dxi + share * d, residual - share * w
            y, z = y - share * reaction, z + share * row
            used, left = used + 1, self.norm(residual)
        return dxi, y, z, residual

    def _add(self, d: Array, image: Callable[[Array], Images]) -> None:
        """One more direction, with an image of unit size across the others."""
        self.iterations += 1
        new = [d, *image(d)]
        for _ in range(2 if self.count else 0):  # twice is enough
            shares = self.dot(self.known[1], new[1])
            new = [x - shares @ others for x, others in zip(new, self.known, strict=True)]

        size = self.norm(new[1])
        if not 0.0 < size < np.inf:
            raise LinearSolveError(f"{self.what}: an iteration of the stages is not finite, or stands still.")
        if not self._rows or self.count == len(self._rows[0]):
            self._make_room(new)
        for rows, x in zip(self._rows, new, strict=True):
            rows[self.count] = x / size
        self.count += 1

    def _make_room(self, like: list[Array]) -> None:
        """For twice as many."""
        room = max(4, 2 * self.count)
        before = self.known if self._rows else [x[None][:0] for x in like]
        self._rows = [np.concatenate((x, np.empty((room - len(x), x.shape[1]), x.dtype))) for x in before]

    def norm(self, x: Array) -> float:
        """Size of a motion; collective."""
        return float(self.dot(x[None], x)[0].real) ** 0.5


class FieldStages:
    """The stage systems of frequencies s, (p,) real or complex; what :class:`.Pencil` is for small systems."""

    def __init__(
        self,
        equations: FieldEquations,
        tangent: FieldTangent,
        s: Array,
        solvers: list[FrequencySolver],
        judge: Judge,
        points: int = 1,
    ) -> None:
        """``solvers``: who solves for each of them; ``points``: how many stages there are."""
        self.eq, self.t, self.judge, self.points = equations, tangent, judge, points
        self.s = [x.real if x.imag == 0 else x for x in s]
        self.by = solvers
        closing = equations.closing
        closing.metric = next((by.weights for by in solvers if by.weights.real), closing.metric)
        self.square = shares(equations.system) ** 2
        self.known = [Directions(self._dot, judge.what) for _ in self.s]
        self.before: Array = np.zeros(len(s))  # sizes of the last increments
        self.frequency, self.square_of_s = np.abs(s), np.array(self.s)[:, None] ** 2
        self.wide = [np.iscomplexobj(x) for x in self.s]
        # a complex frequency stands for two stages; one more than these, the first of all, filters errors only
        self.first = int(len(self.s) + sum(self.wide) > points)

    def solve(self, kin: Array, low: Array) -> tuple[Array, Array]:
        """Increments dxi, dv side by side (p, 2 n_v) and multipliers (p, levels n_lam), for residuals r_kin (p, n_v) and r_low
        (p, n_v + levels n_lam); behind it the share that pressures have in the balance, where bodies carry some.
        """
        eq, n, m, L = self.eq, self.eq.system.n_v, self.eq.system.n_lam, self.eq.levels
        s, kin, low = np.array(self.s)[:, None], np.asarray(kin), np.asarray(low)
        if not any(self.wide):
            kin, low = kin.real, low.real
        low, volumes = low[:, : n + L * m], low[:, n + L * m :]
        at = [low[:, n + level * m : n + (level + 1) * m] for level in range(L)]

        # slips that follow from the rows alone: their motion acts on the balance
        rate: Array = kin
        slip: Array = np.zeros(0)
        pull: Array = np.zeros(0)
        if L > 1:
            slip = s * at[0] - at[1]
            slip = slip - self._rows(kin) if self._sizes(kin).any() else slip
            rate = kin + eq.closing.times(slip)
        push = s * rate
        if L > 2:
            pull = s * at[1] - at[2]
            push = push + eq.closing.times(pull)

        closing = self._closing_volumes(volumes)
        if closing is not None:
            low = low + self.t.along(closing, self._lift(s, closing), s * self._lift(s, closing))
        dxi, dlam, left = self._motions(rate, push, low)
        dxi = dxi if closing is None else dxi + closing
        dv = self._lift(s, dxi) + rate
        mult = [dlam] if L else []
        if L > 1:  # what the motion itself adds
            mult.append(slip + left[:, :m])
            dv = dv + eq.closing.times(left[:, :m]) if left.any() else dv
        if L > 2:
            mult.append(pull + left[:, m:] - s * left[:, :m])
        return np.concatenate((dxi, dv), axis=1), np.concatenate(mult, axis=1) if L else np.zeros((len(s), 0))

    def _closing_volumes(self, volumes: Array) -> Array | None:
        """Motions (p, n_v) of the frequencies whose matrices are not exact, None without any, that close what ``volumes``, shares
        of pressures in the balance, say is open.

        Rows of volumes are the same for all frequencies: a solution with any matrix closes them, by what is open times the weight
        that the stiffness has in it. Iterations go on from there, in motions that keep the volume; on the whole residual
        they would leave a share of what is open, to which pressures answer with the bulk modulus.
        """
        system = self.eq.system
        if not self.eq.pressures.fields or all(by.exact for by in self.by):
            return None
        made = np.zeros((len(self.s), system.n_v), complex if any(self.wide) else float)
        pushes = volumes if volumes.size else made  # filters of errors have none
        for i, by in enumerate(self.by):
            if i >= self.first and not by.exact:
                by.prepare(self.t.ev)
                push = pushes[i] if self.wide[i] else pushes[i].real
                made[i] = by.solver.solve(-by.weights.ck * push, np.zeros(system.n_lam))[0]
        return made

    def _rows(self, x: Array) -> Array:
        """G x (p, n_lam) at the tangent's motion."""
        times = self.t.ev.jacobian.times
        return np.array([times(y.real) + 1j * times(y.imag) if np.iscomplexobj(y) else times(y) for y in x])

    def _motions(self, rate: Array, push: Array, low: Array) -> tuple[Array, Array, Array]:
        """dxi and dlambda of each frequency for known parts of dv and da, and what the further rows leave open."""
        further, p, trusted = self.eq.system.n_v + self.eq.system.n_lam, len(self.s), self._trusted
        of_rate, of_push = self._sizes(np.concatenate((rate, push))).reshape(2, p)
        acts = (of_rate + of_push / self.frequency) / self.frequency

        # known parts of any size; those that are small against the increment before, or where it is the first against itself
        seen = acts > SMALL * self.before * trusted
        first = seen & trusted & (self.before == 0.0)
        low = self._with_known(low, rate, push, seen & ~first)
        x, y = self._solutions(low, range(p))
        sizes = self._sizes(x)
        seen = first & (acts > SMALL * sizes)
        if seen.any():
            low = self._with_known(low, rate, push, seen)
            x[seen], y[seen] = self._solutions(low, np.flatnonzero(seen))
            sizes = self._sizes(x)
        if not (sizes < np.inf).all():
            raise LinearSolveError(f"{self.judge.what}: the first increment is not finite.")

        slow = (self.before > 0.0) & (SLOW * self.before < sizes)
        self.before = sizes
        left = np.zeros((p, low.shape[1] - further), x.dtype)
        self.eq.left_motions = np.zeros_like(x)
        for i in np.flatnonzero(slow | ~trusted):
            x[i], y[i], left[i] = self._iterated(i, (x[i], y[i], low[i, further:]))
        return x, self.square_of_s * y, left

    def _solutions(self, low: Array, which: Iterable[int]) -> tuple[Array, Array]:
        """P^-1 of (1) for residuals of the balance and the first rows, of some of the frequencies."""
        found = [self._solution(i, -low[i] if self.wide[i] else -low[i].real) for i in which]
        kind = complex if any(self.wide) else float
        return np.array([x for x, _ in found], kind), np.array([y for _, y in found], kind)

    def _solution(self, i: int, r: Array) -> tuple[Array, Array]:
        """The same of one frequency; none where no stage has a share in it."""
        if i >= self.first:
            return self._precondition(i, r)
        return np.zeros(self.eq.system.n_v), np.zeros(self.eq.system.n_lam)

    def _with_known(self, low: Array, rate: Array, push: Array, seen: np.ndarray) -> Array:
        """Residuals with what known parts of dv and da add to them, of the frequencies where that is seen."""
        if not seen.any():
            return low
        low = low.copy()
        low[seen] += self.t.along(np.zeros_like(rate[seen]), rate[seen], push[seen])
        return low

    def _iterated(self, i: int, first: Images) -> tuple[Array, Array, Array]:
        """dxi and dlambda / s^2 of one frequency from a first solution, and what the further rows leave open."""
        directions = self.known[i]
        if not self.wide[i]:
            x, y, z = first
            first = x.real, y.real, z.real
        before = directions.iterations
        dxi, dlam, rows, residual = directions.solve(first, lambda d: self._image(i, d))
        used = directions.iterations - before
        self.eq.krylov += used
        self.eq.left_motions[i] = self.square_of_s[i] * self.by[i].weights.ck * residual
        if self.by[i].exact:
            self.eq.trusted = used <= FEW
        return dxi, dlam, -rows

    @property
    def _trusted(self) -> np.ndarray:
        """Whether solutions with the matrix of a frequency need no iteration: nothing but turning and bending is missing."""
        return np.array([by.exact and self.eq.trusted for by in self.by])

    def _parts(self, s: Any, r: Array) -> tuple[Array, Array]:
        """The balance and the first rows, as P sees them."""
        n, m = self.eq.system.n_v, self.eq.system.n_lam
        return r[:n] / s**2, r[n : n + m] / self.eq.form.rows_scale(s) if self.eq.levels else np.zeros(0)

    def _lift(self, s: Any, d: Array) -> Array:
        """D d."""
        return np.asarray(s * d - self.t.turning(d))

    def _image(self, i: int, d: Array) -> Images:
        """P^-1 J d, motion and multipliers, and the further rows of J d."""
        s = self.s[i]
        dv = self._lift(s, d)
        r = self.t.along(d, dv, s * dv)
        motion, multipliers = self._precondition(i, r)

        return motion, multipliers, r[self.eq.system.n_v + self.eq.system.n_lam :]

    def _precondition(self, i: int, r: Array) -> tuple[Array, Array]:
        """P^-1 of (1) for the balance and the first rows, with the matrix of a frequency."""
        self.judge.solves += 1
        self.by[i].prepare(self.t.ev)
        return self.by[i].solver.solve(*self._parts(self.s[i], r))

    def _sizes(self, x: Array) -> Array:
        """Sizes of motions (k, n_v), (k,); collective."""
        system, n = self.eq.system, self.eq.system.n_core
        squares = x.real**2 + x.imag**2
        if system.comm.size == 1:
            return np.sqrt(squares @ self.square)
        fields = rank_sum(system.comm, squares[:, n:] @ self.square[n:])
        return np.sqrt(squares[:, :n] @ self.square[:n] + fields)

    def _dot(self, V: Array, w: Array) -> Array:
        """Inner products of vectors (k, n_v) with one: mean squares of each field, sums of the core; collective."""
        system, n = self.eq.system, self.eq.system.n_core
        w = (self.square * w).conj()
        if system.comm.size == 1:
            return (V @ w).conj()
        core = V[:, :n] @ w[:n]
        return np.asarray((core + rank_sum(system.comm, V[:, n:] @ w[n:])).conj())


def shares(system: System) -> Array:
    """Weights like v that turn increments into lengths, those of a field into its root mean square."""
    if "shares" not in system.cache:
        share = system.units.copy()
        for k, part in system.fields:
            count = rank_sum(system.comm, np.array(float(part.n)))
            share[system.slices[1][k]] /= np.sqrt(max(float(count), 1.0))
        system.cache["shares"] = share
    found: Array = system.cache["shares"]
    return found
