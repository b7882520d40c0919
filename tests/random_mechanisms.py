"""Random mechanisms of rigid bodies in the plane and in space, with an integration of their own in joint coordinates.

Trees on all kinds of joints, gears, screws, loops, repeated joints, drives; springs, dampers, friction, stops, motors, PID,
tyres, forces and torques; every scheme and form; run plainly, taken up from a checkpoint, or with a tolerance.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from joint_coordinates import Array, Axis, Kin, Link, Model
from random_scenes import pick
from scipy.spatial.transform import Rotation

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import FmbdError

RESOLVED = 0.15  # rad of the fastest vibration in a step: below, a run must follow
FOLLOWS = 0.03  # of what is travelled
SPACE_ONLY = ("cylindrical", "spherical", "universal", "planar", "revolute", "prismatic", "fixed")
SCHEMES: tuple[Callable[[], Any], ...] = (
    lambda: fmbd.GeneralizedAlpha(0.8),
    lambda: fmbd.GeneralizedAlpha(0.9, compiled=False),
    lambda: fmbd.GeneralizedAlpha(0.6, form=fmbd.GGL()),
    lambda: fmbd.GeneralizedAlpha(0.8, rtol=1e-5),
    lambda: fmbd.Rattle(),
    lambda: fmbd.EnergyMomentum(),
    lambda: fmbd.HalfExplicit(1e-6),
    lambda: fmbd.HalfExplicit(None),
    lambda: fmbd.ExplicitRungeKutta(1e-7),
    lambda: fmbd.Radau(3, rtol=1e-5),
    lambda: fmbd.Radau(2, form=fmbd.Index2(), rtol=1e-5),
    lambda: fmbd.Radau(3, form=fmbd.Index1(), rtol=1e-6),
    lambda: fmbd.Radau(2, form=fmbd.GGL(), rtol=None),
    lambda: fmbd.BDF(rtol=1e-5),
    lambda: fmbd.BDF(3, form=fmbd.Index2(), rtol=1e-5),
    lambda: fmbd.BDF(2, form=fmbd.Index1(), rtol=None),
)


def unit(rng: np.random.Generator) -> Array:
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


@dataclass
class Sizes:
    """Of length, time and mass."""

    L: float
    T: float
    M: float


class Made:
    """The scene and the model, built together."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng, self.dim = rng, int(pick(rng, 2, 3, 3))
        self.s = Sizes(10 ** rng.uniform(-3, 3), 10 ** rng.uniform(-3, 2), 10 ** rng.uniform(-6, 6))
        L, T = self.s.L, self.s.T
        g = L / T**2 * pick(rng, 0.0, 1.0, 1.0) * (np.array([0.0, -1.0, 0.0]) if self.dim == 2 else unit(rng))
        self.what: list[str] = [f"{self.dim}D"]
        self.model = Model([], g, np.zeros(0))
        self.scene = fmbd.Scene("random mechanism", gravity=self.vector(g) if g.any() else None)
        self.bodies: list[Any] = []
        self.joints: list[Any] = []
        self.coordinates: list[tuple[Any, int, bool]] = []  # package's, ours, whether an angle
        self.taken: set[int] = set()
        self.number = 0

    def vector(self, x: Array) -> tuple[float, ...]:
        return tuple(float(c) for c in x[: self.dim])

    def name(self, what: str) -> str:
        self.number += 1
        self.what.append(what)
        return f"{what} {self.number}"

    def body(self, k: int) -> Any:
        return fmbd.ground if k < 0 else self.bodies[k]

    # -- the tree
    def tree(self) -> None:
        rng, L = self.rng, self.s.L
        count = int(rng.integers(1, 5))
        kinds = []
        spread = pick(rng, 0.0, 0.5, 2.0)
        for k in range(count):
            parent = int(rng.integers(-1, k)) if k else -1
            kinds.append(
                pick(rng, "revolute", "revolute", "prismatic", "fixed")
                if self.dim == 2
                else pick(rng, *SPACE_ONLY, "revolute", "revolute")
            )
            at = np.zeros(3) if parent < 0 else self.model.links[parent].com
            center = at + L * rng.uniform(-1, 1, 3)
            com = center + L * rng.uniform(-1, 1, 3)
            attitude = Rotation.from_rotvec(rng.uniform(-2, 2, 3)).as_matrix()
            axes = self.axes_of(kinds[-1], center)
            if self.dim == 2:
                center[2] = com[2] = 0.0
                attitude = Rotation.from_rotvec([0, 0, rng.uniform(-3, 3)]).as_matrix()
            mass = self.s.M * 10 ** rng.uniform(-spread, spread)
            sides = rng.uniform(0.1, 1, 3) ** 2
            moments = mass * L**2 / 12 * np.array([sides[1] + sides[2], sides[0] + sides[2], sides[0] + sides[1]])
            first = self.model.n
            self.model.links.append(Link(parent, kinds[-1], axes, center, com, attitude, mass, moments, first))
        n = self.model.n
        moving = pick(rng, 0.0, 1.0, 3.0)
        rates = np.array(
            [
                rng.uniform(-1, 1) * moving / self.s.T * (1.0 if a.turns else L)
                for link in self.model.links
                for a in link.axes
            ]
        ).reshape(n)
        self.model.rates = rates
        self.what += kinds

    def axes_of(self, kind: str, center: Array) -> list[Axis]:
        rng, z = self.rng, np.array([0.0, 0.0, 1.0])
        along = z if self.dim == 2 else unit(rng)
        if self.dim == 2 and kind == "prismatic":
            phi = rng.uniform(0, 6)
            along = np.array([np.cos(phi), np.sin(phi), 0.0])
        if self.dim == 2:
            center[2] = 0.0
        across = np.linalg.qr(np.column_stack([along, rng.normal(size=(3, 2))]))[0][:, 1:].T
        turn, shift = (lambda e: Axis(True, e, center)), (lambda e: Axis(False, e, center))
        return {
            "revolute": lambda: [turn(along)],
            "prismatic": lambda: [shift(along)],
            "fixed": lambda: [],
            "cylindrical": lambda: [shift(along), turn(along)],
            "universal": lambda: [turn(along), turn(across[0])],
            "spherical": lambda: [turn(e) for e in np.eye(3)],
            "planar": lambda: [shift(across[0]), shift(across[1]), turn(along)],
        }[kind]()

    def starts(self) -> None:
        """Bodies and joints of the package, with the velocities of the start."""
        kin, u = self.model.kin(np.zeros(self.model.n)), self.model.rates
        for k, link in enumerate(self.model.links):
            v, w = kin.jac[k](link.com) @ u, kin.spin[k] @ u
            R = link.attitude
            if self.dim == 2:
                angle = float(np.arctan2(R[1, 0], R[0, 0]))
                body = fmbd.RigidBody(
                    f"b{k}",
                    link.mass,
                    float(link.moments[2]),
                    self.vector(link.com),
                    angle,
                    self.vector(v),
                    float(w[2]),
                )
            else:
                body = fmbd.RigidBody(
                    f"b{k}", link.mass, link.moments, self.vector(link.com), R, self.vector(v), tuple(R.T @ w)
                )
            self.bodies.append(body)
            self.scene.add(body)
        for k in range(len(self.bodies)):
            joint = self.joint_of(k, f"j{k}")
            self.joints.append(joint)
            self.scene.add(joint)
            link = self.model.links[k]
            if link.kind in ("revolute", "cylindrical"):
                self.coordinates.append((fmbd.angle(joint), link.first + len(link.axes) - 1, True))
            if link.kind in ("prismatic", "cylindrical"):
                self.coordinates.append((fmbd.displacement(joint), link.first, False))

    def joint_of(self, k: int, name: str) -> Any:
        link = self.model.links[k]
        a, b, at = self.body(link.parent), self.bodies[k], {"center": self.vector(link.center)}
        if link.kind == "revolute":
            axis = {} if self.dim == 2 else {"axis": self.vector(link.axes[0].along)}
            return fmbd.revolute(name, a, b, **at, **axis)
        if link.kind in ("prismatic", "cylindrical"):
            return getattr(fmbd, link.kind)(name, a, b, axis=self.vector(link.axes[0].along), **at)
        if link.kind == "universal":
            e, f = (self.vector(x.along) for x in link.axes)
            return fmbd.universal(name, a, b, axis_a=e, axis_b=f, **at)
        if link.kind == "planar":
            return fmbd.planar(name, a, b, normal=self.vector(link.axes[2].along), **at)
        return getattr(fmbd, link.kind)(name, a, b, **at)

    # -- what acts
    def stiffness(self, turns: bool) -> float:
        s = self.s
        return s.M / s.T**2 * (s.L**2 if turns else 1.0) * 10 ** float(self.rng.uniform(-2, pick(self.rng, 2, 2, 12)))

    def coordinate(self) -> tuple[Any, int, bool] | None:
        return pick(self.rng, *self.coordinates) if self.coordinates else None

    def effort(self, j: int, law: Callable[[float, float, float], float]) -> None:
        """A restoring effort on one coordinate."""

        def force(kin: Kin, q: Array, u: Array, t: float, z: Array) -> Array:
            out = np.zeros(self.model.n)
            out[j] = -law(q[j], u[j], t)
            return out

        self.model.efforts.append(force)

    def on_coordinate(self) -> None:
        found = self.coordinate()
        if found is None:
            return
        on, j, turns = found
        rng, s = self.rng, self.s
        k = self.stiffness(turns)
        one = 1.0 if turns else s.L
        d, unit_effort = s.M * s.L * (s.L if turns else 1.0), s.M * s.L / s.T**2 * (s.L if turns else 1.0)
        c = d / s.T / one * (1.0 if turns else 1.0) * float(rng.uniform(0, 2))
        kind = pick(rng, "spring", "law", "effort", "motor", "friction", "pid", "stop")
        name = self.name(kind)
        if kind == "spring":
            free = float(rng.uniform(-1, 1)) * one
            self.scene.add(fmbd.joint_spring(name, on, stiffness=k, damping=c, free=free))
            self.effort(j, lambda x, r, t: k * (x - free) + c * r)
            self.model.stored.append(lambda kin, q: 0.5 * k * (q[j] - free) ** 2)
        elif kind == "law":
            law = lambda x, r, t: unit_effort * (np.sin(x / one) + (x / one) ** 3) + c * r
            self.scene.add(fmbd.joint_spring(name, on, law=law))
            self.effort(j, law)
            self.model.stored.append(
                lambda kin, q: unit_effort * one * (1 - np.cos(q[j] / one) + (q[j] / one) ** 4 / 4)
            )
        elif kind == "effort":
            w = float(rng.uniform(0, 5)) / s.T
            self.scene.add(fmbd.effort(name, on, lambda t: unit_effort * np.cos(w * t)))
            self.effort(j, lambda x, r, t: -unit_effort * np.cos(w * t))
            self.model.fed = True
        elif kind in ("motor", "pid"):
            w, kp, kd = float(rng.uniform(0, 3)) / s.T, unit_effort / one * float(rng.uniform(0, 9)), c
            ki = float(rng.uniform(0.1, 3)) * unit_effort / one / s.T
            target, rate = (lambda t: one * np.sin(w * t)), (lambda t: one * w * np.cos(w * t))
            self.model.fed = True
            if kind == "motor":
                self.scene.add(fmbd.forces.motor(name, on, target=target, kp=kp, kd=kd))
                self.effort(j, lambda x, r, t: kp * (x - target(t)) + kd * (r - rate(t)))
                return
            self.scene.add(fmbd.pid(name, on, target=target, gains=(kp, ki, kd)))
            m = len(self.model.memory)
            self.model.memory.append(lambda q, u, t: (target(t) - q[j]) / one)

            def force(kin: Kin, q: Array, u: Array, t: float, z: Array) -> Array:
                out = np.zeros(self.model.n)
                out[j] = kp * (target(t) - q[j]) + kd * (rate(t) - u[j]) + ki * z[m] * one
                return out

            self.model.efforts.append(force)
        elif kind == "friction":
            Fc, v0 = unit_effort * float(rng.uniform(0.1, 1)), one / s.T * float(rng.uniform(0.1, 1))
            Fs, vs = Fc * float(rng.uniform(1, 1.5)), v0 * float(rng.uniform(1, 5))
            self.scene.add(
                fmbd.forces.joint_friction(name, on, coulomb=Fc, speed=v0, static=Fs, stribeck=vs, viscous=c)
            )
            self.effort(j, lambda x, r, t: (Fc + (Fs - Fc) * np.exp(-((r / vs) ** 2))) * np.tanh(r / v0) + c * r)
        else:
            far = float(rng.uniform(0.01, 1)) * one
            self.scene.add(
                fmbd.forces.elastic_stop(name, on, lower=-far, upper=far, stiffness=k, damping=0.0, width=0.1 * one)
            )
            depth = lambda x: max(x - far, 0.0) + min(x + far, 0.0)
            self.effort(j, lambda x, r, t: k * depth(x))
            self.model.stored.append(lambda kin, q: 0.5 * k * depth(q[j]) ** 2)

    def point_force(self) -> None:
        rng, s, m = self.rng, self.s, self.model
        k = int(rng.integers(len(self.bodies)))
        point = m.links[k].com + s.L * rng.uniform(-0.5, 0.5, 3)
        if self.dim == 2:
            point[2] = 0.0
        kind = pick(rng, "force", "follower", "torque", "body torque", "line spring", "line spring", "tyre")
        name = self.name(kind)
        F0 = s.M * s.L / s.T**2 * (rng.uniform(-1, 1, 3) * (1, 1, self.dim == 3))
        w = float(rng.uniform(0, 4)) / s.T
        if kind in ("force", "follower"):
            law = lambda t: self.vector(F0 * np.cos(w * t))
            self.scene.add(fmbd.force(name, self.bodies[k], law, point=self.vector(point), follower=kind == "follower"))
            m.efforts.append(
                lambda kin, q, u, t, z: (
                    m.jacobian(kin, k, point).T @ ((kin.turn[k] @ F0 if kind == "follower" else F0) * np.cos(w * t))
                )
            )
            m.fed = True
        elif kind in ("torque", "body torque"):
            T0 = s.L * F0 if self.dim == 3 else np.array([0.0, 0.0, s.L * F0[0]])
            mine = kind == "body torque"
            law = (lambda t: float(T0[2] * np.cos(w * t))) if self.dim == 2 else (lambda t: T0 * np.cos(w * t))
            self.scene.add(fmbd.torque(name, self.bodies[k], law, follower=mine))
            m.efforts.append(
                lambda kin, q, u, t, z: kin.spin[k].T @ ((kin.turn[k] @ T0 if mine else T0) * np.cos(w * t))
            )
            m.fed = True
        elif kind == "line spring":
            i = int(rng.integers(-1, k)) if k else -1
            other = point + s.L * (np.array([1.0, 0.7, 0.0]) if self.dim == 2 else 1.3 * unit(rng))
            stiff, c = self.stiffness(False), s.M / s.T * float(rng.uniform(0, 1))
            free = float(np.linalg.norm(other - point)) * float(rng.uniform(0.7, 1.2))
            self.scene.add(
                fmbd.Spring(name, self.body(i), self.bodies[k], self.vector(other), self.vector(point), stiff, c, free)
            )

            def pull(kin: Kin, q: Array, u: Array, t: float, z: Array) -> Array:
                Jd = m.jacobian(kin, k, point) - m.jacobian(kin, i, other)
                way = m.place(kin, k, point) - m.place(kin, i, other)
                size = np.linalg.norm(way)
                e = way / size
                return -Jd.T @ e * (stiff * (size - free) + c * (e @ Jd @ u))

            m.efforts.append(pull)
            m.stored.append(
                lambda kin, q: (
                    0.5 * stiff * (np.linalg.norm(m.place(kin, k, point) - m.place(kin, i, other)) - free) ** 2
                )
            )
        else:
            up = np.array([0.0, 1.0, 0.0])
            radius, stiff, c = 0.3 * s.L, self.stiffness(False), 0.0
            base = float(point[1] - 0.3 * s.L + 0.05 * s.L)
            road = lambda x, t: base + 0.02 * s.L * np.sin(3 * x[0] / s.L + w * t)
            self.scene.add(
                fmbd.Tyre(
                    name,
                    self.bodies[k],
                    point_a=self.vector(point),
                    road=road,
                    radius=radius,
                    stiffness=stiff,
                    damping=c,
                    up=self.vector(up),
                )
            )

            def push(kin: Kin, q: Array, u: Array, t: float, z: Array) -> Array:
                x, J = m.place(kin, k, point), m.jacobian(kin, k, point)
                return J.T @ up * max(stiff * (radius + road(x, t) - x[1]), 0.0)

            m.efforts.append(push)
            m.fed = True

    # -- what holds
    def hold(self) -> None:
        rng, m, s = self.rng, self.model, self.s
        kind = pick(rng, "drive", "gear", "screw", "again", "rod")
        if kind == "again":
            k = int(rng.integers(len(self.bodies)))
            self.scene.add(self.joint_of(k, self.name("again")))
            return
        if kind == "rod":
            k = int(rng.integers(len(self.bodies)))
            point = m.links[k].com + 0.2 * s.L * (rng.uniform(-1, 1, 3) * (1, 1, self.dim == 3))
            anchor = point + s.L * 3 * (np.array([0.3, 1.0, 0.0]) if self.dim == 2 else unit(rng))
            far = float(np.linalg.norm(point - anchor))
            row0 = (point - anchor) @ m.jacobian(m.kin(np.zeros(m.n)), k, point) / far
            if np.linalg.norm(row0 * self.scales()) < 0.1 * s.L or not self.compatible(row0):
                return
            self.scene.add(
                fmbd.distance(
                    self.name("rod"),
                    fmbd.ground,
                    self.bodies[k],
                    point_a=self.vector(anchor),
                    point_b=self.vector(point),
                    length=far,
                )
            )

            def row(kin: Kin, q: Array, u: Array, t: float) -> tuple[Array, float]:
                J, way = m.jacobian(kin, k, point), m.place(kin, k, point) - anchor
                e = 1e-6 / max(np.abs(u).max(initial=0.0), 1e-300)
                plus, minus = (m.jacobian(m.kin(q + x * u), k, point) for x in (e, -e))
                v = J @ u
                return way @ J / far, -(v @ v + way @ (plus - minus) @ u / (2 * e)) / far

            m.rows.append(row)
            return
        free = [c for c in self.coordinates if c[1] not in self.taken]
        if kind == "screw":
            for k, link in enumerate(m.links):
                a, b = link.first + 1, link.first
                if link.kind == "cylindrical" and not {a, b} & self.taken:
                    lead = float(rng.uniform(0.2, 2)) * s.L
                    row0 = np.zeros(m.n)
                    row0[b], row0[a] = 1.0, -lead / (2 * np.pi)
                    if self.compatible(row0):
                        self.scene.add(fmbd.screw(self.name("screw"), self.joints[k], lead=lead))
                        m.rows.append(lambda kin, q, u, t, row0=row0: (row0, 0.0))
                        self.taken |= {a, b}
                    return
            return
        if kind == "gear" and len(free) >= 2:
            (a, i, turns_a), (b, j, turns_b) = (free[x] for x in rng.permutation(len(free))[:2])
            ratio = (
                float(rng.uniform(0.3, 3) * pick(rng, 1, -1)) * (1.0 if turns_b else s.L) / (1.0 if turns_a else s.L)
            )
            row0 = np.zeros(m.n)
            row0[j], row0[i] = 1.0, -ratio
            if self.compatible(row0):
                self.scene.add(fmbd.gear(self.name("gear"), a, b, ratio=ratio))
                m.rows.append(lambda kin, q, u, t: (row0, 0.0))
                self.taken |= {i, j}
        if kind == "drive" and free:
            a, j, turns = pick(rng, *free)
            one = 1.0 if turns else s.L
            w = float(rng.uniform(0.1, 3)) / s.T
            rate, size = float(m.rates[j]), one * float(rng.uniform(0, 1))
            motion = lambda t: rate * t + size * (1 - np.cos(w * t))
            self.scene.add(fmbd.drive(self.name("drive"), a, motion))
            row0 = np.eye(m.n)[j]
            m.rows.append(lambda kin, q, u, t: (row0, size * w**2 * np.cos(w * t)))
            m.fed = True
            self.taken.add(j)

    def scales(self) -> Array:
        return np.array([self.s.L if not a.turns else 1.0 for link in self.model.links for a in link.axes])

    def compatible(self, row: Array) -> bool:
        """Rates of the start are moved so that the row holds; False where what is taken already forbids it."""
        m, D = self.model, self.scales()
        kin = m.kin(np.zeros(m.n))
        held = [r(kin, np.zeros(m.n), m.rates, 0.0)[0] for r in m.rows]
        G = np.array([*held, row]) * D
        G /= np.linalg.norm(G, axis=1)[:, None] + 1e-300
        if np.linalg.svd(G, compute_uv=False)[-1] < 0.05 or len(G) > m.n - 1:
            return False
        target = np.r_[np.zeros(len(held)), -G[-1] @ (m.rates / D)]
        m.rates = m.rates + D * np.linalg.lstsq(G, target, rcond=None)[0]
        return True


@dataclass
class Case:
    """A scene, how it is run, and what an independent look finds."""

    made: Made
    scheme: Any
    dt: float
    steps: int
    manner: str

    @property
    def label(self) -> str:
        return " ".join([type(self.scheme).__name__, self.manner, *self.made.what])

    @property
    def scene(self) -> fmbd.Scene:
        return self.made.scene

    def options(self) -> dict[str, Any]:
        adaptive = getattr(self.scheme, "rtol", None) is not None
        return {"t_end": self.steps * self.dt, "dt": None if adaptive else self.dt, "scheme": self.scheme}

    def run(self) -> fmbd.Run:
        if self.manner == "again":
            return self.taken_up()
        if self.manner == "tol":
            tol = {f"x{k}": 1e-4 * self.made.s.L for k in range(len(self.made.bodies))}
            options = self.options() | {"dt": None, "tol": tol}
            return fmbd.solve(self.scene, **options)
        return fmbd.solve(self.scene, **self.options())

    def taken_up(self) -> fmbd.Run:
        """Stopped in mid run and taken up with another output: must be the run that nothing stopped."""
        with tempfile.TemporaryDirectory() as folder:
            plan = fmbd.Checkpoint(folder, every=3)
            whole = fmbd.solve(self.scene, **self.options())
            stop = max(whole.counters["steps"] // 2, 1)

            def halt(moment: Any) -> None:
                if moment.step == stop:
                    raise Halt

            try:
                fmbd.solve(self.scene, **self.options(), checkpoint=plan, output=fmbd.Output(on_step=halt))
            except Halt:
                pass
            except FmbdError as error:
                if "Halt" not in str(error):
                    raise
            output = fmbd.Output(snapshots=3)
            run = fmbd.solve(self.scene, **self.options(), checkpoint=plan, restart=plan.newest, output=output)
            for name in ("q", "v"):
                if not np.array_equal(getattr(run.state, name), getattr(whole.state, name)):
                    off = np.abs(getattr(run.state, name) - getattr(whole.state, name)).max()
                    raise AssertionError(f"taken up: {name} differs by {off:.1e}")
        return run

    def wrong(self, run: fmbd.Run) -> str:
        made, model, s = self.made, self.made.model, self.made.s
        if not np.isfinite(run.state.q).all() or not np.isfinite(run.state.v).all():
            return "not finite"
        share = max(1e-5, 20 * (getattr(self.scheme, "rtol", None) or 0.0))
        t = float(run.state.t)
        if abs(t - self.steps * self.dt) > 1e-9 * t:
            return f"ends at {t} instead of {self.steps * self.dt}"
        if run.drift[0] > 1e-2 * len(model.links) * s.L:
            return f"joints are open by {run.drift[0] / s.L:.1e} of the length"
        fast = max(model.fastest(), np.abs(model.rates / made.scales()).max(initial=0.0))
        resolved = fast * self.dt <= RESOLVED and self.manner != "tol"
        if not (resolved or self.manner == "tol"):
            return self.gains(run)
        q, u, a = model.follow(t, t / 500 if self.manner == "tol" else np.inf)
        kin = model.kin(q)
        fast = max(fast, np.abs(u / made.scales()).max(initial=0.0))
        moved = (
            max(np.abs(u / made.scales()).max(initial=0.0), np.abs(model.rates / made.scales()).max(initial=0.0)) * t
        )
        resolved = fast * self.dt <= RESOLVED and self.manner != "tol"
        allowed = (FOLLOWS * moved + share) if resolved else 2e-4 if self.manner == "tol" else np.inf
        roundoff = 1e-9 + 1e-13 * fast * t * self.steps
        worst = ""
        for k, link in enumerate(model.links):
            x = model.place(kin, k, link.com)
            off = np.abs(run[f"x{k}"][-1] - x[: made.dim]).max() / s.L
            if off > allowed + roundoff:
                worst = f"b{k} is {off:.1e} lengths off, {moved:.1e} travelled, fast*dt {fast * self.dt:.1e}"
        for name, (_, j, turns) in zip((f"s{i}" for i in range(99)), made.coordinates, strict=False):
            one = 1.0 if turns else s.L
            off = abs(float(np.ravel(run[name][-1])[0]) - q[j]) / one
            if off > (allowed if self.manner != "tol" else 0.1) + 10 * roundoff and not worst:
                worst = f"{name} is {off:.1e} off, {moved:.1e} travelled, fast*dt {fast * self.dt:.1e}"
        return worst or self.gains(run)

    def gains(self, run: fmbd.Run) -> str:
        if self.made.model.fed:
            return ""
        total = run.total_energy
        first = sum(self.made.model.energy(np.zeros(self.made.model.n), self.made.model.rates))
        s = self.made.s
        turned = np.abs(run.energy["kinetic"]).max() + s.M * s.L * np.linalg.norm(self.made.model.gravity)
        scale = turned + 1e-9 * abs(first) + 1e-12 * s.M * (s.L / s.T) ** 2
        gain = (total - total[0]).max()
        if gain > 0.01 * scale:
            return f"energy grows by {gain / scale:.1e}"
        return ""


class Halt(Exception):  # noqa: N818
    """Raised in mid run."""


def case(seed: int) -> Case:
    """The random mechanism of a number."""
    rng = np.random.default_rng([seed, 7])
    made = Made(rng)
    made.tree()
    return finished(made, rng)


def finished(made: Made, rng: np.random.Generator) -> Case:
    # holds change the rates of the start, so bodies come after them: coordinates need joints, which need bodies; make twice
    state = rng.bit_generator.state
    made.starts()
    for _ in range(int(rng.integers(0, 3))):
        made.hold()
    rates, what = made.model.rates, made.what
    rng.bit_generator.state = state
    fresh = made.scene
    made.scene = fmbd.Scene("random mechanism", gravity=fresh.gravity)
    made.bodies, made.joints, made.coordinates, made.taken, made.number = [], [], [], set(), 0
    made.what = what[: 1 + len(made.model.links)]
    made.model.rows = []
    made.starts()
    for _ in range(int(rng.integers(0, 3))):
        made.hold()
    made.model.rates = rates
    for _ in range(int(rng.integers(0, 3))):
        made.on_coordinate()
    for _ in range(int(rng.integers(0, 3))):
        made.point_force()
    for i, (on, _, _) in enumerate(made.coordinates):
        made.scene.sensor(f"s{i}", on)
    for k, body in enumerate(made.bodies):
        made.scene.sensor(f"x{k}", fmbd.position(body))
    scheme = pick(rng, *SCHEMES)()
    model = made.model
    fast = max(model.fastest(), np.abs(model.rates / made.scales()).max(initial=0.0), 1 / made.s.T)
    dt = float(10 ** rng.uniform(-4, 0) / fast)
    manner = pick(rng, "plain", "plain", "plain", "plain", "again", "tol")
    steps = int(pick(rng, 10, 20, 50))
    if manner == "tol":  # it takes as many steps as it needs: a few periods of the fastest vibration
        dt = min(dt, 5.0 / (steps * fast))
    return Case(made, scheme, dt, steps, manner)
