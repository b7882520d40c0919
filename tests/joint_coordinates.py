"""Trees of rigid bodies in joint coordinates: their own equations of motion, integrated by SciPy, to judge runs by.

    M(q) q'' + c(q, q') = Q(q, q', t, z) + G^T lambda,     G q'' = gamma,     z' = g(q, q', t)

Joint coordinates are zero at the start. Jacobians come from the axes of the joints, their rates from differences. Nothing of
the package is used.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

Array = np.ndarray


@dataclass(frozen=True)
class Axis:
    """One elementary motion of a joint: a turn or a shift along a unit vector, through a point; world axes of the start."""

    turns: bool
    along: Array
    center: Array


@dataclass
class Link:
    """A body: what it hangs on (-1: ground) by which joint, its elementary motions, and its mass."""

    parent: int
    kind: str
    axes: list[Axis]
    center: Array
    com: Array
    attitude: Array
    mass: float
    moments: Array
    first: int = 0  # of its coordinates


@dataclass
class Kin:
    """Positions, attitudes, and Jacobians in joint coordinates."""

    shift: list[Array]
    turn: list[Array]  # from the start
    jac: list[Callable[[Array], Array]]  # world point -> (3, n)
    spin: list[Array]  # (3, n)


@dataclass
class Model:
    """A tree, what acts on it, and what else holds it, in joint coordinates q (zero at the start)."""

    links: list[Link]
    gravity: Array
    rates: Array
    efforts: list[Callable[[Kin, Array, Array, float, Array], Array]] = field(default_factory=list)  # -> (n,)
    stored: list[Callable[[Kin, Array], float]] = field(default_factory=list)
    memory: list[Callable[[Array, Array, float], float]] = field(default_factory=list)  # rates of z
    rows: list[Callable[[Kin, Array, Array, float], tuple[Array, float]]] = field(default_factory=list)  # G, gamma
    fed: bool = False  # something may put energy in

    @property
    def n(self) -> int:
        return sum(len(link.axes) for link in self.links)

    def kin(self, q: Array) -> Kin:
        out = Kin([], [], [], [])
        for link in self.links:
            shift = np.zeros(3) if link.parent < 0 else out.shift[link.parent]
            turn = np.eye(3) if link.parent < 0 else out.turn[link.parent]
            before = [] if link.parent < 0 else list(out.jac[link.parent].found)  # type: ignore[attr-defined]
            for j, axis in enumerate(link.axes, start=link.first):
                along, center = turn @ axis.along, turn @ axis.center + shift
                before.append((j, axis.turns, along, center))
                if axis.turns:
                    local = Rotation.from_rotvec(q[j] * axis.along).as_matrix()
                    shift, turn = shift + turn @ (axis.center - local @ axis.center), turn @ local
                else:
                    shift = shift + q[j] * along
            out.shift.append(shift)
            out.turn.append(turn)
            out.jac.append(_jacobian(before, self.n))
            spin = np.zeros((3, self.n))
            for j, turns, along, _ in before:
                spin[:, j] = along if turns else 0.0
            out.spin.append(spin)
        return out

    def place(self, kin: Kin, k: int, point: Array) -> Array:
        """Where a point of body k, given in the world of the start, is; -1: the ground."""
        return point if k < 0 else kin.turn[k] @ point + kin.shift[k]

    def jacobian(self, kin: Kin, k: int, point: Array) -> Array:
        return np.zeros((3, self.n)) if k < 0 else kin.jac[k](self.place(kin, k, point))

    def stacked(self, q: Array) -> list[tuple[Array, Array]]:
        kin = self.kin(q)
        return [(kin.jac[k](self.place(kin, k, link.com)), kin.spin[k]) for k, link in enumerate(self.links)]

    def accelerations(self, q: Array, u: Array, t: float, z: Array) -> Array:
        """Newton and Euler in joint coordinates, with rows by multipliers of least norm."""
        kin, n = self.kin(q), self.n
        M, f = np.zeros((n, n)), np.zeros(n)
        e = 1e-6 / max(np.abs(u).max(initial=0.0), 1e-300)
        plus, minus = self.stacked(q + e * u), self.stacked(q - e * u)
        for k, link in enumerate(self.links):
            Jv, Jw = kin.jac[k](self.place(kin, k, link.com)), kin.spin[k]
            R = kin.turn[k] @ link.attitude
            inertia = R @ np.diag(link.moments) @ R.T
            av, aw = ((p - m) @ u / (2 * e) for p, m in zip(plus[k], minus[k], strict=True))
            w = Jw @ u
            M += link.mass * Jv.T @ Jv + Jw.T @ inertia @ Jw
            f += link.mass * Jv.T @ (self.gravity - av) - Jw.T @ (inertia @ aw + np.cross(w, inertia @ w))
        for effort in self.efforts:
            f += effort(kin, q, u, t, z)
        if not self.rows:
            return np.linalg.solve(M, f)
        G, gamma = (np.array(x) for x in zip(*(row(kin, q, u, t) for row in self.rows), strict=True))
        S = np.linalg.cholesky(M)
        free, H = np.linalg.solve(S.T, np.linalg.solve(S, f)), np.linalg.solve(S, G.T).T
        lam = np.linalg.lstsq(H @ H.T, gamma - G @ free, rcond=1e-12)[0]
        return free + np.linalg.solve(S.T, np.linalg.solve(S, G.T @ lam))

    def energy(self, q: Array, u: Array) -> tuple[float, float]:
        """Kinetic and potential, J."""
        kin, T, V = self.kin(q), 0.0, 0.0
        for k, link in enumerate(self.links):
            x = self.place(kin, k, link.com)
            v, w = kin.jac[k](x) @ u, kin.spin[k] @ u
            R = kin.turn[k] @ link.attitude
            T += 0.5 * link.mass * v @ v + 0.5 * (R.T @ w) ** 2 @ link.moments
            V -= link.mass * self.gravity @ x
        return T, V + sum(s(kin, q) for s in self.stored)

    def follow(self, t_end: float, most: float = np.inf) -> tuple[Array, Array, Array]:
        """Coordinates, rates, and accelerations at the end; steps of at most so much (s), for stops may be passed over else."""
        n, m = self.n, len(self.memory)
        z0 = np.zeros(m)
        a0 = np.abs(self.accelerations(np.zeros(n), self.rates, 0.0, z0))
        speed = np.maximum(np.abs(self.rates), a0 * t_end)
        speed = np.maximum(speed, 1e-3 * speed.max(initial=0.0)) + 1e-300
        atol = np.r_[1e-8 * speed * t_end, 1e-8 * speed, np.full(m, 1e-8 * max(1.0, t_end))]

        def slope(t: float, y: Array) -> Array:
            q, u, z = y[:n], y[n : 2 * n], y[2 * n :]
            return np.r_[u, self.accelerations(q, u, t, z), [g(q, u, t) for g in self.memory]]

        start = np.r_[np.zeros(n), self.rates, z0]
        found = solve_ivp(slope, (0.0, t_end), start, "DOP853", rtol=1e-8, atol=atol, max_step=most)
        q, u, z = found.y[:n, -1], found.y[n : 2 * n, -1], found.y[2 * n :, -1]
        return q, u, self.accelerations(q, u, t_end, z)

    def fastest(self) -> float:
        """Largest eigenvalue of the motion about the start, rad/s."""
        n, z = self.n, np.zeros(len(self.memory))
        if n == 0:
            return 0.0
        scale = max(np.abs(self.rates).max(), 1e-3)
        d = 1e-6
        K = [
            (self.accelerations(d * e, self.rates, 0.0, z) - self.accelerations(-d * e, self.rates, 0.0, z)) / (2 * d)
            for e in np.eye(n)
        ]
        e = 1e-6 * scale
        D = [
            (
                self.accelerations(0 * x, self.rates + e * x, 0.0, z)
                - self.accelerations(0 * x, self.rates - e * x, 0.0, z)
            )
            / (2 * e)
            for x in np.eye(n)
        ]
        A = np.block([[np.zeros((n, n)), np.eye(n)], [np.array(K).T, np.array(D).T]])
        return float(np.abs(np.linalg.eigvals(A)).max())


def _jacobian(axes: list[tuple[int, bool, Array, Array]], n: int) -> Callable[[Array], Array]:
    def jacobian(x: Array) -> Array:
        J = np.zeros((3, n))
        for j, turns, along, center in axes:
            J[:, j] = np.cross(along, x - center) if turns else along
        return J

    jacobian.found = axes  # type: ignore[attr-defined]
    return jacobian
