"""Random scenes with what they must obey, found without the package: an own integration, own energies, own joint gaps.

Masses of 1e-8 to 1e8 kg, lengths of 1e-3 to 1e3 m, stiffness of 1e-3 to 1e18 N/m, steps of 1e-6 to 1 of the fastest period.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

import fmbd_fenicsx as fmbd

MESHES = Path(__file__).parents[1] / "meshes"
STEPS = 20
RESOLVED = 0.1  # rad of the fastest vibration in a step: below, a run must follow an independent one
FOLLOWS = 0.02  # of the distance travelled
GAIN = 5e-3  # of the energy that was turned over
SCHEMES = (
    fmbd.GeneralizedAlpha(0.8),
    fmbd.GeneralizedAlpha(0.5, form=fmbd.GGL()),
    fmbd.Rattle(),
    fmbd.EnergyMomentum(),
    fmbd.Radau(3, rtol=1e-5),
    fmbd.BDF(rtol=1e-4),
    fmbd.HalfExplicit(1e-6),
)
Array = np.ndarray


@dataclass(frozen=True)
class Case:
    """A scene, how to run it, and ``wrong``: what an independent look at the run finds, empty when it is right."""

    scene: fmbd.Scene
    scheme: Any
    dt: float
    wrong: Callable[[fmbd.Run], str]

    def run(self) -> fmbd.Run:
        """Twenty steps, or as many as the error control takes for them."""
        adaptive = getattr(self.scheme, "rtol", None) is not None
        return fmbd.solve(self.scene, t_end=STEPS * self.dt, dt=None if adaptive else self.dt, scheme=self.scheme)


def pick(rng: np.random.Generator, *items: Any) -> Any:
    """One of some objects."""
    return items[int(rng.integers(len(items)))]


# ------------------------------------------------------------------------------------------------ chains of rigid links


@dataclass(frozen=True)
class Chain:
    """Links of one length (m) on hinges, the first at the origin, in their angles: mass matrix, forces, energy by hand."""

    size: float
    masses: Array
    gravity: float
    torsion: float = 0.0  # N m/rad, in the last hinge
    spring: tuple[float, Array, float] | None = None  # N/m, its fixed end, its free length
    drive: float | None = None  # rad/s of the first link
    start: Array | None = None

    def arms(self, phi: Array, share: float = 0.5) -> Array:
        """Derivatives of the links' middles (share 1: ends) by the angles are these times (-sin, cos), (n, n)."""
        n = len(phi)
        return self.size * (np.tril(np.ones((n, n)), -1) + share * np.eye(n))

    def middles(self, phi: Array) -> Array:
        return self.arms(phi) @ np.stack([np.cos(phi), np.sin(phi)], axis=1)

    def end(self, phi: Array) -> Array:
        return self.size * np.array([np.cos(phi).sum(), np.sin(phi).sum()])

    def twist(self, turned: Array) -> float:
        """Of the last hinge when the links have ``turned`` since the start, rad."""
        return float(turned[-1] - (0.0, *turned)[-2])

    def inertia(self, phi: Array) -> tuple[Array, Array]:
        """M, and the matrix whose product with squares of rates is the centrifugal torque."""
        A = self.arms(phi)
        weighted, apart = A.T @ (self.masses[:, None] * A), phi[:, None] - phi[None, :]
        return weighted * np.cos(apart) + np.diag(self.masses * self.size**2 / 12), weighted * np.sin(apart)

    def accelerations(self, turned: Array, rate: Array) -> Array:
        """Of the angles, rad/s^2, from what the links have turned since the start: in angles themselves a stiff torsion
        spring feels nothing but roundoff.
        """
        phi = self.start + turned
        c, s, A = np.cos(phi), np.sin(phi), self.arms(phi)
        M, centrifugal = self.inertia(phi)
        f = -centrifugal @ rate**2 - self.gravity * c * (A.T @ self.masses)
        if self.torsion:
            torque = -self.torsion * self.twist(turned)
            f[-1] += torque
            if len(phi) > 1:
                f[-2] -= torque
        if self.spring is not None:
            k, anchor, free = self.spring
            way = anchor - self.end(phi)
            pull = k * (1 - free / np.linalg.norm(way)) * way
            f += self.size * (-s * pull[0] + c * pull[1])
        if self.drive is None:
            return np.linalg.solve(M, f)
        out = np.zeros_like(phi)
        if len(phi) > 1:
            out[1:] = np.linalg.solve(M[1:, 1:], f[1:])
        return out

    def energy(self, phi: Array, rate: Array) -> tuple[float, float]:
        """Kinetic and potential, J."""
        v = self.arms(phi) @ (rate[:, None] * np.stack([-np.sin(phi), np.cos(phi)], axis=1))
        T = 0.5 * float(self.masses @ ((v**2).sum(1) + self.size**2 / 12 * rate**2))
        V = (
            self.gravity * float(self.masses @ self.middles(phi)[:, 1])
            + 0.5 * self.torsion * self.twist(phi - self.start) ** 2
        )
        if self.spring is not None:
            k, anchor, free = self.spring
            V += 0.5 * k * (float(np.linalg.norm(anchor - self.end(phi))) - free) ** 2
        return T, V

    def rates(self) -> Array:
        """Angular velocities at the start: those that the drive's impulse leaves a chain at rest with."""
        out = np.zeros(len(self.masses))
        if self.drive is not None:
            out[0] = self.drive
            M = self.inertia(self.start)[0]
            if len(out) > 1:
                out[1:] = -np.linalg.solve(M[1:, 1:], M[1:, 0] * self.drive)
        return out

    def fastest(self) -> float:
        """Largest frequency about the start, rad/s, from differences."""
        n, d = len(self.start), 1e-7
        rest = np.zeros(n)
        ends = [(self.accelerations(d * e, rest), self.accelerations(-d * e, rest)) for e in np.eye(n)]
        K = np.array([minus - plus for plus, minus in ends]).T / (2 * d)
        return float(np.sqrt(np.abs(np.linalg.eigvals(K)).max()))

    def follow(self, t_end: float) -> tuple[Array, Array]:
        """Angles and rates at the end, by Radau's method of SciPy."""
        n = len(self.start)
        speeds = max(
            np.abs(self.rates()).max(), np.abs(self.accelerations(np.zeros(n), self.rates())).max() * t_end, 1e-300
        )
        floor = np.r_[np.full(n, 1e-6 * speeds * t_end + 1e-15), np.full(n, 1e-6 * speeds)]
        found = solve_ivp(
            lambda t, y: np.r_[y[n:], self.accelerations(y[:n], y[n:])], (0.0, t_end), np.r_[np.zeros(n), self.rates()],
            "Radau", rtol=1e-7, atol=floor,
        )  # fmt: skip
        return self.start + found.y[:n, -1], found.y[n:, -1]


def rigid(rng: np.random.Generator) -> Case:
    """A chain with a spring, a torsion spring, a drive, or the first hinge twice."""
    size, count = 10.0 ** rng.uniform(-3, 3), int(rng.integers(1, 4))
    masses = 10.0 ** rng.uniform(-8, 8) * 10.0 ** rng.uniform(-1, 1, count) ** int(rng.integers(1, 8))
    gravity = size * (10.0 ** rng.uniform(-2, 2) if rng.random() < 0.8 else 0.0)
    start = rng.uniform(-3, 3) + np.cumsum(np.r_[0.0, rng.uniform(-2, 2, count - 1)])
    model = Chain(size, masses, gravity, start=start)
    kind = int(rng.integers(0, 5))
    time = np.sqrt(size / gravity) if gravity else 10.0
    if kind == 1:
        model = Chain(size, masses, gravity, torsion=10.0 ** rng.uniform(-3, 18), start=start)
    elif kind == 2:
        anchor = model.end(start) + size * np.array([1.0, 0.3])
        model = Chain(size, masses, gravity, spring=(10.0 ** rng.uniform(-3, 18), anchor, 1.04 * size), start=start)
    elif kind == 3:
        model = Chain(size, masses, gravity, drive=rng.uniform(-10, 10) / time, start=start)
    scene = links(model)
    if kind == 4:
        scene.add(fmbd.revolute("again", fmbd.ground, scene.bodies["b0"], center=(0.0, 0.0)))
    dt = float(10.0 ** rng.uniform(-6, 0) * min(time, 2 * np.pi / max(model.fastest(), 1e-300)))
    scheme = pick(rng, *SCHEMES)
    finer = Case(scene, scheme, dt / 4, lambda run: "")
    return Case(
        scene, scheme, dt, lambda run: wrong_chain(model, run, dt) and wrong_beyond_order(model, run, dt, finer)
    )


def links(model: Chain) -> fmbd.Scene:
    """The chain in the words of the package."""
    scene = fmbd.Scene("random chain", gravity=(0.0, -model.gravity))
    at, before, size, last = np.zeros(2), fmbd.ground, model.size, None
    for i, (m, phi) in enumerate(zip(model.masses, model.start, strict=True)):
        along = size * np.array([np.cos(phi), np.sin(phi)])
        body = fmbd.RigidBody(
            f"b{i}", float(m), float(m) * size**2 / 12, position=at + 0.5 * along, rotation=float(phi)
        )
        last = fmbd.revolute(f"j{i}", before, body, center=at)
        scene.add(body, last)
        at, before = at + along, body
    if model.torsion:
        scene.add(fmbd.joint_spring("torsion", fmbd.angle(last), stiffness=model.torsion))
    if model.spring is not None:
        k, anchor, free = model.spring
        scene.add(fmbd.Spring("spring", fmbd.ground, before, anchor, at, stiffness=k, length=free))
    if model.drive is not None:
        scene.add(fmbd.drive("drive", fmbd.angle(scene.joints["j0"]), lambda t: model.drive * t))
    return scene


def wrong_chain(model: Chain, run: fmbd.Run, dt: float) -> str:
    """Open hinges, energy from nothing, another motion than that of the independent integration."""
    s, n, L = run.state, len(model.masses), model.size
    if not all(np.isfinite(x).all() for x in (s.q, s.v, s.a, s.lam)):
        return "not finite"
    pose, phi, rate = s.q[: 3 * n].reshape(n, 3), s.q[2 : 3 * n : 3], s.v[2 : 3 * n : 3]
    share = max(2e-6, 20 * (getattr(run.scheme, "rtol", None) or 0.0))
    gap = np.abs(pose[:, :2] - model.middles(phi)).max()
    if gap > share * n * L:
        return f"joints are open by {gap / L:.1e} of the length"

    # energy: that of the bodies' own velocities, which miss those of the hinges by the error of the steps
    _, potential = model.energy(phi, rate)
    speeds = s.v[: 3 * n].reshape(n, 3)
    kinetic = 0.5 * float(model.masses @ ((speeds[:, :2] ** 2).sum(axis=1) + L**2 / 12 * rate**2))
    first = sum(model.energy(model.start, model.rates()))
    scale = kinetic + model.gravity * model.masses.sum() * n * L + abs(first)
    roundoff = max(model.torsion, 0.0 if model.spring is None else model.spring[0] * L**2) * 1e-13
    roundoff += model.masses.sum() * (1e-11 * n * L / dt) ** 2
    if model.drive is None and kinetic + potential - first > max(GAIN, 50 * share) * scale + roundoff:
        return f"energy grows by {(kinetic + potential - first) / scale:.1e}"

    # motion, where the steps resolve it
    fast = max(model.fastest(), np.abs(model.rates()).max(), np.abs(rate).max())
    if fast * dt > RESOLVED:
        return ""
    exact, exact_rate = model.follow(s.t)
    travelled = max(np.abs(exact_rate).max(), np.abs(model.rates()).max()) * s.t
    off = np.abs(phi - exact).max()
    roundoff = 1e-13 * n * fast * s.t * STEPS + 1e-12
    if off > FOLLOWS * travelled + share + roundoff:
        return f"angles differ by {off:.1e} of {travelled:.1e} rad travelled"
    return ""


def wrong_beyond_order(model: Chain, run: fmbd.Run, dt: float, finer: Case) -> str:
    """What :func:`wrong_chain` says, unless it is below 0.1 rad and a quarter of the step takes it away, as an error of second
    order: a chain that unfolds is faster on its way than it was at the start.
    """
    found = wrong_chain(model, run, dt)
    if not found.startswith("angles") or getattr(run.scheme, "rtol", None) is not None:
        return found
    n, t = len(model.masses), run.state.t
    again = fmbd.solve(finer.scene, t_end=t, dt=finer.dt, scheme=finer.scheme)
    exact, _ = model.follow(t)
    off, less = (np.abs(r.state.q[2 : 3 * n : 3] - exact).max() for r in (run, again))
    return "" if less < off / 10 and off < 0.1 else found


# --------------------------------------------------------------------------------------------------- elastic, in contact


@cache
def rod(size: float) -> Any:
    """A rod of so many metres, one tenth as high."""
    return fmbd.read_gmsh(MESHES / "rod.py", dim=2, length=size, height=0.1 * size, h=0.25 * size)


def elastic(rng: np.random.Generator) -> Case:
    """A rod on a pin or clamped, in its own mesh or in modes, perhaps with a weight at its tip and a spring there."""
    size = pick(rng, 1e-3, 1.0, 1e3)
    modulus, density = 10.0 ** rng.uniform(3, 12), 10.0 ** rng.uniform(0, 4)
    made = pick(rng, fmbd.FloatingBody, fmbd.AbsoluteBody)
    body: Any = made("rod", rod(size), density=density, elastic=fmbd.materials.plane_stress(modulus, 0.3))
    if made is fmbd.FloatingBody and rng.random() < 0.5:
        body = body.reduced(modes=3)
    mass = 0.1 * size**2 * density
    hold = pick(rng, fmbd.revolute, fmbd.fixed)
    gravity = size * 10.0 ** rng.uniform(-1, 1)
    scene = fmbd.Scene("random rod", gravity=(0.0, -gravity))
    scene.add(body, hold("hold", fmbd.ground, body.surface("pin"), center=(0.0, 0.0)))
    if rng.random() < 0.5:
        m = mass * 10.0 ** rng.uniform(-2, 2)
        bob = fmbd.RigidBody("bob", m, 0.01 * m * size**2, position=(1.1 * size, 0.0))
        scene.add(bob, fmbd.fixed("weld", body.surface("tip"), bob, center=(size, 0.0)))
        mass += m
    if rng.random() < 0.5:
        ends = {"point_a": (size, -size), "length": size}
        k = 10.0 ** rng.uniform(-3, 12)
        scene.add(fmbd.Spring("spring", fmbd.ground, body.surface("tip"), stiffness=k, **ends))
    scene.sensor("tip", fmbd.position(body.surface("tip")))
    period = min(np.sqrt(size / gravity), 60 * size * np.sqrt(density / modulus))
    dt = float(period * 10.0 ** rng.uniform(-5, 0))
    return Case(scene, fmbd.GeneralizedAlpha(0.8), dt, lambda run: wrong_rod(run, size, mass * gravity * size))


def wrong_rod(run: fmbd.Run, size: float, weight: float) -> str:
    """What the recorded energies and joints say: the sum does not grow, the hold is closed, nothing is lost in the numbers."""
    total = run.total_energy
    if not (np.isfinite(total).all() and np.isfinite(run["tip"]).all()):
        return "not finite"
    if run.drift[0] > 1e-6 * size:
        return f"joints are open by {run.drift[0] / size:.1e} of the length"
    turned = max(np.abs(run.energy["kinetic"]).max(), np.abs(run.energy["elastic"]).max(), weight)
    if (total - total[0]).max() > 2 * GAIN * turned:
        return f"energy grows by {(total - total[0]).max() / turned:.1e}"
    return ""


def bouncing(rng: np.random.Generator) -> Case:
    """A ball that falls on a floor and bounces: flights are parabolas, impacts lose their share."""
    size, e = 10.0 ** rng.uniform(-3, 3), rng.uniform(0.0, 1.0)
    height, g, mass = size * 10.0 ** rng.uniform(-2, 1), size * 10.0 ** rng.uniform(-2, 2), 10.0 ** rng.uniform(-8, 8)
    body = fmbd.RigidBody("ball", mass, 0.4 * mass * size**2, position=(0.0, size + height))
    floor = fmbd.Obstacle("floor", fmbd.HalfSpace((0.0, 0.0), (0.0, 1.0)))
    scene = fmbd.Scene("random ball", gravity=(0.0, -g))
    scene.add(body, fmbd.contact("floor", fmbd.ball(body, size), floor, restitution=e))
    scene.sensor("x", fmbd.position(body))
    fall = np.sqrt(2 * height / g)
    dt = float(fall * 10.0 ** rng.uniform(-3, -0.5))
    return Case(scene, fmbd.Moreau(), dt, lambda run: wrong_ball(run, (size, height, g, e)))


def wrong_ball(run: fmbd.Run, given: tuple[float, float, float, float]) -> str:
    """Against the parabolas of the first two flights; at rest a step may leave what it falls in a step."""
    size, height, g, e = given
    fall = np.sqrt(2 * height / g)
    t, y = run.times, run["x"][:, 1] - size
    exact, known = height - 0.5 * g * t**2, t < fall * (1 + 2 * e)
    second = t > fall
    exact[second] = e * g * fall * (t[second] - fall) - 0.5 * g * (t[second] - fall) ** 2
    off = np.abs(y - exact)[known].max(initial=0.0) / height
    sunk = -y.min() / (1e-6 * size + 0.5 * g * run.dt**2)
    if not off < 1e-5 * max(1.0, size / height) or not sunk < 1.0:
        return f"the ball is {off:.1e} of its height off, and {sunk:.1e} of what it may be in the floor"
    return ""


KINDS = (rigid, rigid, rigid, rigid, elastic, bouncing)


def case(seed: int) -> Case:
    """The random scene of a number."""
    rng = np.random.default_rng(seed)
    return pick(rng, *KINDS)(rng)
