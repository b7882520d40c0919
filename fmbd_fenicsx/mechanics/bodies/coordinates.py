"""Bodies and mechanisms given by their own equations of motion in coordinates of the user's choice.

    M(q) q'' = f(q, q', t) - G^T lambda,     0 = g(q, t)                                                       (1)

Missing Jacobians are taken from complex-step differences, exact to roundoff, when the user's functions accept complex
numbers (NumPy functions do), else from central differences. Functions declared as ``vectorized`` take many configurations in
one call, as in SciPy: arrays get a last axis, q (n, k), t (k,), and so do the results, f (n, k), M and dg/dq (m, n, k).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...checks import array, check_fields, vector
from ...errors import CallbackError, InputError, named, require
from ...rotations import Array
from ..placements import FrameMotion, Part
from .body import EQUATIONS, Body, Placed, Site

_STEP = 1e-30
Vector = Sequence[float] | Array


def derivative(function: Callable[[Any], Any], x: Array) -> Array:
    """d function / d x, (m, n), by complex steps; by central differences of fourth order when complex numbers do not pass."""
    n = len(x)
    try:
        columns = []
        with warnings.catch_warnings():
            warnings.simplefilter("error", np.exceptions.ComplexWarning)  # an imaginary part dropped on the way
            for k in range(n):
                z = x.astype(complex)
                z[k] += 1j * _STEP
                columns.append(np.imag(np.asarray(function(z), dtype=complex)) / _STEP)
        return np.stack(columns, axis=-1) if n else np.zeros((np.size(function(x)), 0))
    except (TypeError, ValueError, np.exceptions.ComplexWarning):
        pass
    return differences(function, x)


def derivative_many(function: Callable[[Any, Any], Any], x: Array, t: Array) -> Array:
    """d function(x, t) / d x of a vectorized function, (k, m, n), at x (k, n), t (k,): all complex steps in one call.

    Raises TypeError or ValueError where complex numbers do not pass.
    """
    k, n = x.shape
    z = np.repeat(x.T.astype(complex)[:, None], n, axis=1)  # (n, directions, k)
    # direction j moves coordinate j
    z[range(n), range(n)] += 1j * _STEP
    # a function that drops the imaginary part would give zeros: an error instead
    with warnings.catch_warnings():
        warnings.simplefilter("error", np.exceptions.ComplexWarning)
        found = np.asarray(function(z.reshape(n, n * k), np.tile(t, (n, *(1,) * (t.ndim - 1)))), dtype=complex)
    return np.imag(found.reshape(-1, n, k)).transpose(2, 0, 1) / _STEP


def differences(function: Callable[[Any], Any], x: Array) -> Array:
    """d function / d x, (m, n), by central differences of fourth order."""
    n = len(x)
    columns = []
    for k in range(n):
        h = 1e-3 * max(1.0, abs(float(x[k])))
        e = np.zeros(n)
        e[k] = h

        def at(s: float, e: Array = e) -> Array:
            return np.asarray(function(x + s * e), dtype=float)

        columns.append((8 * (at(1.0) - at(-1.0)) - (at(2.0) - at(-2.0))) / (12 * h))
    return np.stack(columns, axis=-1) if n else np.zeros((np.size(function(x)), 0))


@dataclass(frozen=True, eq=False)
class PortConstraint:
    """g(p, t) = 0 on the ports p of one part; ``jacobian``, ``gamma`` and ``rate`` from differences unless given.

    function(p, t) -> (m,); jacobian_(p, t) -> (m, n); gamma_(p, p', t) -> (m,), the part of g'' without p''; rate_(p, t) ->
    (m,), dg/dt at fixed p. ``vectorized``: they take many p at once, see the module.
    """

    name: str
    part: int
    function: Callable[[Any, float], Any]
    jacobian_: Callable[[Array, float], Array] | None = None
    gamma_: Callable[[Array, Array, float], Array] | None = None
    rate_: Callable[[Array, float], Array] | None = None
    vectorized: bool = False

    def many(self, what: str, t: Array, *arrays: Array) -> Array:
        """``values``, ``jacobian``, ``rate`` or ``gamma`` of k configurations, arrays (k, n), t (k,): one call where possible."""
        given: Any = {"values": self.function, "jacobian": self.jacobian_, "rate": self.rate_, "gamma": self.gamma_}[
            what
        ]

        # all configurations in one call of the user's function
        if self.vectorized and given is not None:
            found = np.asarray(given(*(x.T for x in arrays), t), dtype=float)
            return (
                np.moveaxis(found, -1, 0)
                if found.shape[-1:] == t.shape
                else np.broadcast_to(found, (len(t), *found.shape))
            )

        # complex steps of all, if complex numbers pass
        if self.vectorized and what in ("jacobian", "rate"):
            try:
                if what == "jacobian":
                    return derivative_many(self.function, arrays[0], t)
                return derivative_many(lambda s, p: self.function(p.T, s[0]), t[:, None], arrays[0])[:, :, 0]
            except (TypeError, ValueError, np.exceptions.ComplexWarning):
                pass
        if self.vectorized and what == "gamma":
            return self._gamma_many(t, *arrays)

        one: Any = getattr(self, what)
        return np.array([one(*(x[i] for x in arrays), float(t[i])) for i in range(len(t))])

    def _gamma_many(self, t: Array, p: Array, pd: Array) -> Array:
        """As :meth:`gamma`, of k configurations."""
        if self.jacobian_ is None:
            try:
                return self._second_rate(t, p, pd)
            except (TypeError, ValueError, np.exceptions.ComplexWarning):
                pass

        def velocity_level(s: float) -> Array:
            at, now = p + s * pd, t + s
            return (self.many("jacobian", now, at) @ pd[..., None])[..., 0] + self.many("rate", now, at)

        # d/ds of G p' + g_t along the motion at constant p', by differences of fourth order
        h = 1e-4 / max(1.0, float(np.abs(pd).max(initial=0.0)))
        first = velocity_level(h) - velocity_level(-h)
        second = velocity_level(2 * h) - velocity_level(-2 * h)
        return np.asarray((8 * first - second) / (12 * h))

    def _second_rate(self, t: Array, p: Array, pd: Array) -> Array:
        """d^2/ds^2 g(p + s p', t + s) at s = 0, (k, m): differences of rates at four s, these by complex steps; one call of a
        vectorized function.

        Raises TypeError or ValueError where complex numbers do not pass.
        """
        k, steps = len(t), np.array([1.0, -1.0, 2.0, -2.0])
        h = 1e-4 / max(1.0, float(np.abs(pd).max(initial=0.0)))
        s = np.repeat(h * steps, k) + 1j * _STEP
        at = np.tile(p, (4, 1)) + s[:, None] * np.tile(pd, (4, 1))
        now = np.tile(t, 4) + s

        with warnings.catch_warnings():
            warnings.simplefilter("error", np.exceptions.ComplexWarning)
            g: Any = self.function
            found = g(at.T, now) if self.vectorized else np.stack([g(*x) for x in zip(at, now, strict=True)], axis=-1)
            rates = np.imag(np.asarray(found, dtype=complex)) / _STEP
        if rates.shape[1:] != s.shape:
            raise ValueError("not one result for each configuration")
        plus, minus, plus2, minus2 = rates.reshape(-1, 4, k).transpose(1, 2, 0)
        return np.asarray((8 * (plus - minus) - (plus2 - minus2)) / (12 * h))

    def values(self, p: Array, t: float) -> Array:
        """g, (m,)."""
        return np.asarray(self.function(p, t), dtype=float)

    def jacobian(self, p: Array, t: float) -> Array:
        """dg/dp, (m, n)."""
        if self.jacobian_ is not None:
            return np.asarray(self.jacobian_(p, t), dtype=float)
        if self.vectorized:
            return np.asarray(self.many("jacobian", np.array([t]), p[None])[0])
        return derivative(lambda z: self.function(z, t), p)

    def rate(self, p: Array, t: float) -> Array:
        """dg/dt at fixed p, (m,)."""
        if self.rate_ is not None:
            return np.asarray(self.rate_(p, t), dtype=float)
        return derivative(lambda s: self.function(p, s[0]), np.array([t]))[:, 0]

    def gamma(self, p: Array, pd: Array, t: float) -> Array:
        """g'' - G p'', (m,)."""
        if self.gamma_ is not None:
            return np.asarray(self.gamma_(p, pd, t), dtype=float)
        return np.asarray(self._gamma_many(np.array([t]), p[None], pd[None])[0])


def own_constraint(body: Any, part: int) -> PortConstraint:
    """The constraint of a body given by its own equations, exceptions of its functions named."""

    def safe(of: str, function: Any) -> Any:
        return None if function is None else named(f"The constraint{of} of body", body.name, function)

    return PortConstraint(
        body.name,
        part,
        safe("", body.constraint),
        safe("'s jacobian", body.jacobian),
        safe("'s gamma", body.gamma),
        safe("'s rate", body.rate),
        body.vectorized,
    )


@dataclass(frozen=True, eq=False)
class CoordinateBody(Body):
    """A body or mechanism given by its own equations: M(q) q'' = f(q, q', t) - G^T lambda, 0 = g(q, t).

    Args:
        name: what messages and sensors call it.
        mass: M, (n, n), or a function q -> M(q).
        force: f(q, v, t) -> (n,).
        start, start_rate: q and q' at the start, (n,).
        constraint: g(q, t) -> (m,), or None.
        jacobian, gamma: dg/dq (q, t) -> (m, n), and the part of g'' without q'' (q, v, t) -> (m,); by complex-step
            differences where missing.
        rate: dg/dt at fixed q, (q, t) -> (m,); by a complex step where missing.
        force_jacobian: (df/dq, df/dq') (q, v, t) -> two (n, n); by complex-step differences where missing.
        potential: q -> J, for the energy balance; None counts as zero.
        outline: q -> lines (n, 2) or (n, 3) in the world (m), a list of arrays: what pictures show of it.
        vectorized: mass, force, constraint, jacobian, gamma and rate also take many configurations in one call, with arrays
            that have one more, last axis: q (n, k), t (k,) -> f (n, k), M (n, n, k), dg/dq (m, n, k). Several times faster.
    """

    framed = by_surface = False
    alone = True
    stage = EQUATIONS

    name: str
    mass: Any
    force: Callable[[Array, Array, float], Any]
    start: Vector
    start_rate: Vector | None = None
    constraint: Callable[[Any, float], Any] | None = None
    jacobian: Callable[[Array, float], Array] | None = None
    gamma: Callable[[Array, Array, float], Array] | None = None
    potential: Callable[[Array], float] | None = None
    rate: Callable[[Array, float], Array] | None = None
    force_jacobian: Callable[[Array, Array, float], tuple[Any, Any]] | None = None
    vectorized: bool = False
    outline: Callable[[Array], Sequence[Array]] | None = None
    dim: int | None = field(init=False, default=None)  # fits scenes of any dimension

    @property
    def may_do_work(self) -> bool:
        """Nobody knows what equations of a user's own do."""
        return True

    @property
    def keeps_energy(self) -> bool:
        """With a potential it is taken to hold all of the forces."""
        return self.potential is not None

    def __post_init__(self) -> None:
        what = f'Body "{self.name}"'
        check_fields(self, what)
        start = vector(f"{what}: start", self.start)
        n = len(start)
        rate = np.zeros(n) if self.start_rate is None else vector(f"{what}: start_rate", self.start_rate, size=n)
        object.__setattr__(self, "start", start)
        object.__setattr__(self, "start_rate", rate)

        mass = named("The mass of body", self.name, self.mass, time=None)(start) if callable(self.mass) else self.mass
        M = array(f"{what}: mass", mass)
        require(M.shape == (n, n), f'Body "{self.name}": mass has shape {M.shape}, expected ({n}, {n}).')
        if np.abs(M - M.T).max(initial=0.0) > 1e-10 * np.abs(M).max(initial=0.0):
            raise InputError(f'Body "{self.name}": the mass matrix is not symmetric.')

        # coordinates without mass are allowed, negative ones are not
        p = np.linalg.eigvalsh(M) if n else np.ones(1)
        if p[0] < -1e-10 * p[-1]:
            raise InputError(f'Body "{self.name}": the mass matrix has the negative eigenvalue {p[0]:g}.')

    def placed(self, site: Site) -> Placed:
        """The equations as a part on the ground."""
        return Placed(CoordinatePart(self, site.ground), np.array(self.start), np.array(self.start_rate))


class CoordinatePart(Part):
    """Equations (1) as a part of a system: the ports are the coordinates themselves."""

    plain = True

    def __init__(self, body: Any, frame: int) -> None:
        self.body, self.name, self.frame = body, body.name, frame
        self.n = self.n_port = len(np.asarray(body.start))
        self.reference = np.zeros(self.n)
        self.port_matrix = np.eye(self.n)
        self._force = named("The force of body", body.name, body.force, to_end=True)
        tangent = body.force_jacobian
        self._tangent = None if tangent is None else named("The force_jacobian of body", body.name, tangent)
        self._mass = named("The mass of body", body.name, body.mass, time=None) if callable(body.mass) else body.mass

    def ports_of(self, w: Array, t: float) -> Array:
        """The coordinates."""
        return w

    def port_force(self, f: Array, t: float) -> Array:
        """Forces on the coordinates."""
        return f

    def mass(self, q: Array) -> Array:
        """M(q), (n, n)."""
        return (
            self._finite("mass(q)", self._mass(q), (self.n, self.n))
            if callable(self._mass)
            else np.asarray(self._mass, float)
        )

    def force(self, motion: FrameMotion, local: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        """M q'' - f."""
        q, v, a = local
        f = self._finite("force(q, v, t)", self._force(q, v, motion.t), (self.n,), motion.t)
        return np.zeros_like(motion.twist), self.mass(q) @ a - f

    def _finite(self, what: str, given: Any, shape: tuple[int, ...], t: float | None = None) -> Array:
        """What a function of the user's returned, as finite numbers of a shape."""
        try:
            found = np.asarray(given, dtype=float)
        except (TypeError, ValueError, OverflowError):
            found = np.full(1, np.nan)
        if found.shape != shape or not np.isfinite(found).all():
            when = "" if t is None else f" at t = {t:g} s"
            wanted = " x ".join(map(str, shape))
            raise CallbackError(
                f'Body "{self.name}": {what} returned {given!r}{when}, expected {wanted} finite numbers.'
            )
        return found

    def force_many(self, t: Array, local: tuple[Array, ...]) -> Array:
        """M q'' - f of k configurations: q, v, a (k, n), t (k,); one call of each function where the body is vectorized."""
        q, v, a = local
        body = self.body
        if not body.vectorized:
            f = np.array([self._force(x, y, float(now)) for x, y, now in zip(q, v, t, strict=True)], dtype=float)
            if callable(self._mass):
                inertia = np.array([self.mass(q[i]) @ a[i] for i in range(len(q))])
            else:
                inertia = a @ self.mass(q[0]).T
        else:
            # a vectorized function takes configurations in its last axis
            f = np.asarray(self._force(q.T, v.T, t), dtype=float).T
            M = np.asarray(self._mass(q.T) if callable(self._mass) else self._mass, dtype=float)
            inertia = a @ M.T if M.ndim == 2 else np.einsum("ijk,kj->ki", M, a)

        if f.shape != q.shape or not np.isfinite(f).all():
            bad = 0 if f.shape != q.shape else int(np.argmin(np.isfinite(f).all(axis=1)))
            raise CallbackError(
                f'Body "{self.name}": force(q, v, t) returned {f[bad] if len(f) > bad else f!r} at t = {t[bad]:g} s, expected '
                f"{self.n} finite numbers."
            )
        return inertia - f

    def given(self, motion: FrameMotion, local: tuple[Array, Array]) -> dict[str, float] | None:
        """None: forces of the user are one sum."""
        return None

    def mass_blocks(self, motion: FrameMotion, u: Array) -> tuple[Array, Array, Array]:
        """M(q)."""
        n = len(motion.twist)
        return np.zeros((n, n)), np.zeros((self.n, n)), self.mass(u)

    def stiffness_blocks(self, motion: FrameMotion, local: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        """-df/dq and -df/dv."""
        q, v, _ = local
        if self._tangent is not None:
            K, C = self._tangent(q, v, motion.t)
            return -np.asarray(K, dtype=float), -np.asarray(C, dtype=float)
        # by complex steps where the force takes complex numbers
        K = -derivative(lambda z: self._force(z, v, motion.t), q)
        return K, -derivative(lambda z: self._force(q, z, motion.t), v)

    def energies(self, motion: FrameMotion, pose: Array, local: tuple[Array, Array]) -> tuple[float, float, float]:
        """Kinetic energy, and the body's potential where it gives one."""
        q, v = local
        potential = self.body.potential
        return 0.5 * float(v @ self.mass(q) @ v), 0.0 if potential is None else float(potential(q)), 0.0

    def momenta(self, motion: FrameMotion, pose: Array, local: tuple[Array, Array]) -> tuple[Array, Array]:
        """Unknown for general coordinates: zero."""
        n = len(motion.twist)
        d = len(motion.gravity)
        return np.zeros(d), np.zeros(n - d)
