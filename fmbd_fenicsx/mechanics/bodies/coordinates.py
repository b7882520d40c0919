"""Bodies and mechanisms given by their own equations of motion in coordinates of the user's choice.

    M(q) q'' = f(q, q', t) - G^T lambda,     0 = g(q, t)                                                       (1)

Missing derivatives are exact to roundoff when the user's functions are made of arithmetic and NumPy's functions, else by
differences (:mod:`.own_derivatives`), in any units. Functions declared as ``vectorized`` take many configurations in
one call, as in SciPy: arrays get a last axis, q (n, k), t (k,), and so do the results, f (n, k), M and dg/dq (m, n, k).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import isfinite
from typing import Any

import numpy as np

from ...checks import array, check_fields, vector
from ...errors import CallbackError, InputError, floats, named, require
from ...rotations import Array, Vector
from ..body import EQUATIONS, Body, Placed, Site
from ..placements import FrameMotion, Part
from .own_checks import check_constraint, check_force
from .own_derivatives import UNUSABLE, Slopes, derivative_many, slopes_of
from .port_constraint import PortConstraint, of_place_and_time


def own_constraint(body: Any, part: int) -> PortConstraint:
    """The constraint of a body given by its own equations, exceptions of its functions named."""

    def safe(of: str, function: Any) -> Any:
        return None if function is None else named(f"The constraint{of} of body", body.name, function)

    function = safe("", body.constraint)
    law = PortConstraint(
        body.name,
        part,
        function,
        safe("'s jacobian", body.jacobian),
        safe("'s gamma", body.gamma),
        safe("'s rate", body.rate),
        body.vectorized,
        body.constraint,
        slopes_of(of_place_and_time(function), np.append(np.asarray(body.start, dtype=float), 0.0)),
    )
    check_constraint(law, body)
    return law


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
            differences where missing. What is given is compared with the constraint at the start.
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
        for name in () if self.constraint else ("jacobian", "gamma", "rate"):
            require(getattr(self, name) is None, f"{what}: {name} belongs to a constraint, and none is given.")
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
        part = CoordinatePart(self, site.ground)
        part.check()
        return Placed(part, np.array(self.start), np.array(self.start_rate))


class CoordinatePart(Part):
    """Equations (1) as a part of a system: the ports are the coordinates themselves."""

    together = True

    def __init__(self, body: Any, frame: int) -> None:
        self.body, self.name, self.frame = body, body.name, frame
        self.n = self.n_port = len(np.asarray(body.start))
        self.reference = np.zeros(self.n)
        self.port_matrix = np.eye(self.n)
        self._force = named("The force of body", body.name, body.force, to_end=True)
        tangent = body.force_jacobian
        self._tangent = None if tangent is None else named("The force_jacobian of body", body.name, tangent)
        self._mass: Any = named("The mass of body", body.name, body.mass, time=None) if callable(body.mass) else None
        self.constant_mass = None if callable(body.mass) else np.asarray(body.mass, float)

    @cached_property
    def _slopes(self) -> Slopes:
        """The derivative of the force by all its numbers: coordinates, rates, time."""
        n, body = self.n, self.body
        start = np.concatenate((np.ravel(body.start), np.ravel(body.start_rate), [0.0]))
        return slopes_of(lambda z: self._force(z[:n], z[n:-1], z[-1]), start)

    def check(self) -> None:
        """Compare the tangent that was given with the force."""
        if self._tangent is not None:
            check_force(self.body, self._slopes, self._tangent)

    def mass(self, q: Array) -> Array:
        """M(q), (n, n)."""
        return (
            self._finite("mass(q)", self._mass(q), (self.n, self.n))
            if self.constant_mass is None
            else self.constant_mass
        )

    def force(self, motion: FrameMotion, local: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        """M q'' - f."""
        q, v, a = local
        f = self._forces(q[None], v[None], [motion.t])[0]
        M = self.mass(q) if self.constant_mass is None else self.constant_mass
        return np.zeros(len(motion.twist)), M @ a - f

    def _finite(self, what: str, given: Any, shape: tuple[int, ...], t: float | None = None) -> Array:
        """What a function of the user's returned, as finite numbers of a shape."""
        # the usual answer passes at once: this is called at every iterate
        if type(given) is np.ndarray and given.dtype == np.float64 and given.shape == shape:
            flat = given.ravel()
            if isfinite(flat.dot(flat)):
                return given

        try:
            found: Array = floats(given)
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
            f = self._forces(q, v, [float(now) for now in t])
            if self.constant_mass is None:
                inertia = np.array([self.mass(q[i]) @ a[i] for i in range(len(q))])
            else:
                inertia = a @ self.constant_mass.T
        else:
            # a vectorized function takes configurations in its last axis
            f = np.asarray(self._force(q.T, v.T, t), dtype=float).T
            M = self.constant_mass if self.constant_mass is not None else np.asarray(self._mass(q.T), dtype=float)
            inertia = a @ M.T if M.ndim == 2 else np.einsum("ijk,kj->ki", M, a)

        if f.shape != q.shape or not np.isfinite(f).all():
            bad = 0 if f.shape != q.shape else int(np.argmin(np.isfinite(f).all(axis=1)))
            raise CallbackError(
                f'Body "{self.name}": force(q, v, t) returned {f[bad] if len(f) > bad else f!r} at t = {t[bad]:g} s, expected '
                f"{self.n} finite numbers."
            )
        return inertia - f

    def _forces(self, q: Array, v: Array, t: list[float]) -> Array:
        """f of k configurations, one after another."""
        what, shape = "force(q, v, t)", (self.n,)
        told = [(self._force(x.copy(), y.copy(), now), now) for x, y, now in zip(q, v, t, strict=True)]
        return np.array([self._finite(what, f, shape, now) for f, now in told])

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
        slopes = -self._slopes_at(np.concatenate((q, v)), motion.t)
        return slopes[:, : self.n], slopes[:, self.n :]

    def _slopes_at(self, motion: Array, t: float) -> Array:
        """The derivative of the force by coordinates and rates, (n, 2 n); by one call where it takes many places."""
        if self.body.vectorized and self._slopes.by_complex:
            n = self.n
            try:
                return derivative_many(lambda z, at: self._force(z[:n], z[n:], at), motion[None], np.array([t]))[0]
            except UNUSABLE:
                pass
        return self._slopes(np.append(motion, t))[:, :-1]

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
