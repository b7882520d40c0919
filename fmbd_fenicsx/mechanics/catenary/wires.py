"""Parallel tensioned wires with bending stiffness, hung from each other by droppers: catenaries, cable nets in a plane.

Transverse displacements w_i(x, t) of wires i over the interval (0, L), one weak form in UFL,

    sum_i int mu_i w_i'' v_i + T_i w_i,x v_i,x + EI_i w_i,xx v_i,xx dx  + point springs  =  sum_i int mu_i g v_i dx            (1)

with cubic Hermite elements (C^1: a load that travels over an element border sees no kink; Basix's "Hermite" on a uniform
interval). Droppers pull, N = k max(e, 0), and never push. Mass and stiffness are constant and factored once; only the slack of
droppers is nonlinear. Wires are small against the rest of a scene, so every rank holds all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np

from ...checks import check_fields, number, whole
from ...errors import InputError, require
from ...rotations import Array, motions
from ..body import WIRES, Body, Placed, Site
from ..elastic.field_part import FieldPart
from ..placements import Approach, FrameMotion
from .line_field import LineField


@dataclass(frozen=True)
class Wire:
    """One wire: mass per length (kg/m), tension (N), bending stiffness (N m^2)."""

    mass: float
    tension: float
    bending: float = 0.0

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True)
class PointSupport:
    """A spring (N/m) between wire number ``wire`` at x (m) and the ground, free of force at w = 0."""

    wire: int
    x: float
    stiffness: float

    def __post_init__(self) -> None:
        check_fields(self)
        number("PointSupport: stiffness", self.stiffness, least=0.0, unit="N/m")


@dataclass(frozen=True)
class Dropper:
    """Hangs ``lower`` from ``upper`` (numbers of wires) at x (m): N = stiffness max(w_upper - w_lower + offset, 0), N.

    ``offset`` (m) is how much shorter than the distance of the undisplaced wires it is; see :meth:`Wires.hung`.
    """

    upper: int
    lower: int
    x: float
    stiffness: float
    offset: float = 0.0
    one_sided: bool = True

    def __post_init__(self) -> None:
        check_fields(self)
        number("Dropper: stiffness", self.stiffness, least=0.0, unit="N/m")
        require(self.upper != self.lower, f"Dropper: upper and lower are both wire {self.upper}; they must be two.")


@dataclass(frozen=True, eq=False)
class Wires(Body):
    """Parallel wires over (0, length), ends held by stiff anchors; transverse to x, positive against gravity.

    Args:
        name: what messages and sensors call it.
        length: m. ``cells``: number of Hermite elements of one length.
        wires, supports, droppers: what it is made of.
        mass_damping, stiffness_damping: Rayleigh coefficients alpha (1/s) and beta (s) of wires and supports.
        anchor: stiffness (N/m) with which both ends of every wire are held.
    """

    nodal = interpolated = True
    framed = by_surface = False
    stage = WIRES

    name: str
    length: float
    cells: int
    wires: tuple[Wire, ...]
    supports: tuple[PointSupport, ...] = ()
    droppers: tuple[Dropper, ...] = ()
    mass_damping: float = 0.0
    stiffness_damping: float = 0.0
    anchor: float = 1e7
    dim: int = field(init=False, default=2)

    @property
    def may_do_work(self) -> bool:
        """A contact that slides along them is moved by who drives it."""
        return True

    def placed(self, site: Site) -> Placed:
        """The wires at rest, with a moving port for every contact that slides along them."""
        part = WiresPart(self, site.ground, site.slides)
        return Placed(part, np.zeros(part.n), np.zeros(part.n))

    def __post_init__(self) -> None:
        what = f'Wires "{self.name}"'
        check_fields(self, what)
        number(f"{what}: length", self.length, above=0.0, unit="m")
        whole(f"{what}: cells", self.cells, least=1)
        number(f"{what}: mass_damping", self.mass_damping, least=0.0)
        number(f"{what}: stiffness_damping", self.stiffness_damping, least=0.0)
        number(f"{what}: anchor", self.anchor, above=0.0)

        places = [(s, (s.wire,)) for s in self.supports] + [(d, (d.upper, d.lower)) for d in self.droppers]
        for part, numbers in places:
            for wire in numbers:
                require(
                    0 <= wire < len(self.wires),
                    f"{what}: {part} names wire {wire}; there are {len(self.wires)}, from 0.",
                )

        for w in self.wires:
            require(w.mass > 0 and w.tension >= 0 and w.bending >= 0, f'Wires "{self.name}": unusable data {w}.')
        for x in (*(s.x for s in self.supports), *(d.x for d in self.droppers)):
            if not 0 <= x <= self.length:
                raise InputError(
                    f'Wires "{self.name}": a support or dropper at x = {x:g} m lies outside (0, {self.length:g}) m.'
                )

    def with_finer_space(self, *, higher: bool) -> Wires:
        """The same wires with twice the elements."""
        return replace(self, cells=2 * self.cells)

    def hung(self, sag: Any = 0.0, *, gravity: float = 9.81) -> Wires:
        """Form finding: the same wires with droppers so long that the lower wire hangs at ``sag`` (m, or a function of x) at
        each.

        With f the weights, the lower wire held at the droppers gives their tensions N, the upper wire under N its shape, and
        offset = N / k - (w_upper - w_lower). Raises InputError where a dropper would have to push.
        """
        import scipy.sparse as sp
        import scipy.sparse.linalg as sl

        free = replace(self, droppers=())
        field = LineField(free)
        K = field.csr()
        f = -gravity * field.weight
        x = np.array([d.x for d in self.droppers])
        low = sp.vstack([field.row(d.lower, d.x) for d in self.droppers]).tocsr()
        high = sp.vstack([field.row(d.upper, d.x) for d in self.droppers]).tocsr()
        target = -np.array([sag(xi) if callable(sag) else sag for xi in x], dtype=float)

        # the lower wire held at the droppers: what holds it are their tensions
        held = sp.bmat([[K, low.T], [low, None]]).tocsc()
        solution = sl.spsolve(held, np.concatenate((f, target)))
        N = -solution[field.n :]
        if N.min() < 0:
            raise InputError(
                f'Wires "{self.name}": the dropper at x = {x[N.argmin()]:g} m would have to push for this sag.'
            )
        # the shape of both wires under these tensions
        w = sl.spsolve(K.tocsc(), f - (high - low).T @ N)
        gap = (high - low) @ w
        field.destroy()
        hung = [replace(d, offset=float(n / d.stiffness - g)) for d, n, g in zip(self.droppers, N, gap, strict=True)]
        return replace(self, droppers=tuple(hung))


def slider_tables(
    body: Wires, field: LineField, sliders: Sequence[tuple[int, Any]], t: float
) -> list[tuple[np.ndarray, Array, tuple[float, ...]]]:
    """What points that slide see of the wires at time t (s): unknowns, and w, w_x, w_xx of them; x' and x'', m and s."""
    tables = []
    for wire, motion in sliders:
        x, *rates = motion(t)
        if not 0 <= x <= body.length:
            raise InputError(f'A point that slides on wires "{body.name}" leaves them: x = {x:g} m at t = {t:g} s.')
        tables.append((*field.shape(wire, x, 2), tuple(rates)))
    return tables


class WiresPart(FieldPart):
    """Wires as a part of a system. Ports: w, w_x, w_xx at each point that slides along a wire, and a zero.

    ``sliders``: (wire, function t -> x, x', x''). The ports move with time.
    """

    PORTS = 4
    moves_ports = True
    stiffening = None
    weights: Array
    slack: np.ndarray  # numbers of the droppers that the tangent leaves out

    def __init__(self, body: Wires, frame: int, sliders: Sequence[tuple[int, Any]]) -> None:
        self.field: Any = LineField(body)
        self.body, self.name, self.frame, self.comm = body, body.name, frame, self.field.comm
        self.motions = motions(2)
        self.sliders = tuple(sliders)
        self.n, self.n_port = self.field.n, self.PORTS * len(self.sliders)
        self.n_frame_rows, self.surfaces = 0, []

        self.inertia_columns = np.zeros((self.n, 0))
        self.reference = np.zeros(self.n_port)

        self.mass_total, self.size = self.field.mass_total, self.field.size
        self.weights = np.stack((np.zeros(self.n), self.field.weight))
        self.moment, self.inertia = np.zeros(2), np.zeros((1, 1))  # the frame rests

        # what the tangent was taken at
        self.slack = np.zeros(0, dtype=int)
        self._chosen = False  # whether Newton has just asked for the present set
        self._tangents = 0
        self.statuses: list[Any] = []  # of the contacts at the sliding ports
        self._tables = lru_cache(maxsize=4)(partial(slider_tables, body, self.field, self.sliders))

    def column_version(self, t: float) -> Any:
        """Where the ports are and which of them are in use."""
        return t, self.in_use

    @property
    def in_use(self) -> tuple[bool, ...]:
        """Which contacts are closed."""
        return tuple(s.closed for s in self.statuses)

    # -- tangent ------------------------------------------------------------------------------------------------
    def corotation(self, u: Array) -> None:
        """No rotation; a step starts with the slack droppers of its first configuration."""
        if not self._chosen:
            self._see(u)
        self._chosen = False

    def _see(self, u: Array) -> bool:
        N, full = self.field.tension(u)
        # a dropper is slack where it would have to push
        slack = np.flatnonzero(full != N)
        if np.array_equal(slack, self.slack):
            return False
        self.slack = slack
        self._tangents += 1
        return True

    @property
    def tangent_version(self) -> int:
        """Number of slack sets taken so far."""
        return self._tangents

    @property
    def renewable(self) -> bool:
        """Whether droppers may go slack."""
        return len(self.field.stiff) > 0

    def relinearise(
        self, motion: FrameMotion, local: tuple[Array, Array, Array], increment: Approach | None = None
    ) -> bool:
        """Take the slack droppers at displacements; False when they are the same."""
        self._chosen = self._see(local[0])
        return self._chosen

    def free_factors(self) -> None:
        """Those for several sets of slack droppers."""
        self.field.free_factors()

    # -- mechanics ----------------------------------------------------------------------------------------------
    def port_shares(self, w: Array, t: float) -> Array:
        """w, w_x, w_xx, 0 at each sliding point."""
        return np.concatenate([np.zeros(0), *(np.append(table @ w[dofs], 0.0) for dofs, table, _ in self._tables(t))])

    def port_force(self, f: Array, t: float) -> Array:
        """Its transpose."""
        out = np.zeros(self.n)
        for (dofs, table, _), fi in zip(self._tables(t), f.reshape(-1, self.PORTS), strict=True):
            out[dofs] += table.T @ fi[:3]
        return out

    def port_columns(self, used: np.ndarray, t: float) -> Array:
        """Columns (n, count) of :meth:`port_force` for the port numbers ``used``."""
        columns = [self.port_force(one, t) for one in np.eye(self.n_port)[used]]
        return np.reshape(columns, (len(used), self.n)).T

    def port_entries(self, ports: np.ndarray, t: float) -> tuple[np.ndarray, Array, Array, Array]:
        """Entries (k, 4) of columns of :meth:`port_force` for values w among the ports: unknowns, values, and two rates of these
        as the ports move, 1/s and 1/s^2.
        """
        tables = self._tables(t)
        seen = [tables[p // self.PORTS] for p in ports]
        on, values, rates, curves = np.zeros((4, len(ports), 4))
        for i, (dofs, (N, N_x, N_xx), (speed, change)) in enumerate(seen):
            on[i], values[i], rates[i], curves[i] = dofs, N, speed * N_x, speed**2 * N_xx + change * N_x
        return on.astype(int), values, rates, curves

    def port_gram(self, t: float) -> Array:
        """P P^T of the ports; every rank holds all wires."""
        columns = self.port_columns(np.arange(self.n_port), t)
        return columns.T @ columns

    def force(self, motion: FrameMotion, local: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        """Rows of (1)."""
        u, v, a = local
        f, forms = self.field, self.field.forms
        inertia = a + forms.mass_damping * v if forms.mass_damping else a

        rows = f.mass(inertia[:, None])[:, 0] - motion.gravity @ self.weights + f.internal(u)
        if forms.stiffness_damping:
            rows += forms.stiffness_damping * (f.tangent(v) - f.B.T @ (f.stiff * (f.B @ v)))
        return np.zeros(self.motions.n_twist), rows

    def energies(self, motion: FrameMotion, pose: Array, local: tuple[Array, Array]) -> tuple[float, float, float]:
        """Kinetic, elastic and weight energy, J."""
        u, v = local
        kinetic = 0.5 * float(v @ self.field.mass(v[:, None])[:, 0])
        return kinetic, self.field.energy(u), -float(motion.gravity[1] * (self.field.weight @ u))

    def momenta(self, motion: FrameMotion, pose: Array, local: tuple[Array, Array]) -> tuple[Array, Array]:
        """Transverse momentum; angular momentum is not kept."""
        return np.array([0.0, float(self.field.weight @ local[1])]), np.zeros(1)
