"""Random rods, lines, wires, fields, rolling bodies, stops and contacts, with what they must obey.

Sizes of 1e-3 to 1e3 of a metre, a kilogram and a second; stiffness, steps, joints and schemes at random. Runs are judged by
closed solutions (wires, rolling, stops), by the balances of energy and momentum, and, where the steps resolve the slowest
vibration, by a run of another scheme in finer steps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from random_scenes import pick
from scipy.integrate import solve_ivp

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import materials

MESHES = Path(__file__).parents[1] / "meshes"
STEPS = 20
RESOLVED = 0.1  # rad of the slowest vibration in a step
FOLLOWS = 0.03  # of the way
GAIN = 0.01  # of the energy that was turned over
ALPHA = fmbd.GeneralizedAlpha
Rng = np.random.Generator

SMOOTH: tuple[Callable[[], Any], ...] = (
    lambda: ALPHA(0.8),
    lambda: ALPHA(0.9, compiled=False),
    lambda: ALPHA(0.6, form=fmbd.GGL()),
    lambda: ALPHA(0.8, rtol=1e-5),
    lambda: fmbd.Radau(3, rtol=1e-5),
    lambda: fmbd.Radau(2, form=fmbd.GGL(), rtol=None),
    lambda: fmbd.BDF(rtol=1e-5),
)


@dataclass(frozen=True)
class Sizes:
    """Of length, time and mass."""

    L: float
    T: float
    M: float


def sizes(rng: Rng) -> Sizes:
    """Any units."""
    return Sizes(*(10.0 ** rng.uniform(-3, 3) for _ in range(3)))


@dataclass
class Case:
    """A scene, how it is run, and ``wrong``: what an independent look at the run finds, empty when it is right."""

    label: str
    scene: fmbd.Scene
    scheme: Any
    dt: float
    wrong: Callable[[fmbd.Run], str]
    linear: Any = None
    steps: int = STEPS

    def run(self, scheme: Any = None, finer: int = 1) -> fmbd.Run:
        """Twenty steps, or as many as the error control takes for them."""
        scheme = scheme or self.scheme
        chosen = getattr(scheme, "rtol", None) is not None
        dt = None if chosen else self.dt / finer
        linear = self.linear if scheme is self.scheme else None
        return fmbd.solve(self.scene, t_end=self.steps * self.dt, dt=dt, scheme=scheme, linear=linear)


# ------------------------------------------------------------------------------------------------------------- judges


def gains(run: fmbd.Run, weight: float) -> str:
    """Whether energy comes from nothing; ``weight``: that of the model at its length, J."""
    total = run.total_energy
    if not np.isfinite(total).all():
        return "not finite"
    turned = max(np.abs(run.energy["kinetic"]).max(), np.abs(run.energy["elastic"]).max(), weight)
    gain = (total - total[0]).max()
    return f"energy grows by {gain / turned:.1e}" if gain > GAIN * turned else ""


def differs(case: Case, run: fmbd.Run, size: float) -> str:
    """Whether the sensor "tip" leaves that of another scheme in steps of a quarter, which is of second order too."""
    other: Any = ALPHA(0.9)
    if isinstance(case.scheme, ALPHA):
        other = fmbd.BDF(rtol=1e-6) if run.system.fields else fmbd.EnergyMomentum()
    fine = case.run(other, 4)
    way = np.abs(fine["tip"] - fine["tip"][0]).max()
    off = np.abs(run["tip"][-1] - fine["tip"][-1]).max()
    share = 100 * (getattr(case.scheme, "rtol", None) or 0.0)
    allowed = FOLLOWS * way + (share + 1e-12) * size
    return f"the tip is {off / size:.1e} lengths off, {way / size:.1e} travelled" if off > allowed else ""


def flexible(case: Case, size: float, weight: float, slowest: float) -> Callable[[fmbd.Run], str]:
    """Closed joints, no energy from nothing, and the way of another scheme where the steps resolve ``slowest``, rad/s."""

    def wrong(run: fmbd.Run) -> str:
        end = case.steps * case.dt
        if abs(run.times[-1] - end) > 1e-9 * end:
            return f"ends at {run.times[-1]} instead of {end}"
        if run.drift[0] > 1e-5 * size:
            return f"joints are open by {run.drift[0] / size:.1e} of the length"
        found = gains(run, weight)
        return found or (differs(case, run, size) if slowest * case.dt <= RESOLVED else "")

    return wrong


# ------------------------------------------------------------------------------------------------------ rods and lines


def rod(rng: Rng) -> Case:
    """A rod in space, clamped, pinned or free, perhaps with a bob."""
    s = sizes(rng)
    bending = s.M * s.L**3 / s.T**2 * 10.0 ** rng.uniform(-1, 3)
    stretch = bending / s.L**2 * 10.0 ** rng.uniform(2, 5)
    rotary = s.M * s.L * 10.0 ** rng.uniform(-4, -2)
    stiffness = np.r_[stretch, stretch / 3, stretch / 3, bending * rng.uniform(0.5, 2, 3)]
    relaxation = [(0.5, s.T * 10.0 ** rng.uniform(-2, 0))] if rng.random() < 0.2 else ()
    section = fmbd.RodSection(stiffness, s.M / s.L, rotary * np.array([2.0, 1.0, 1.0]), relaxation=relaxation)
    points = s.L * np.array([(0, 0, 0), (0.5, 0.1 * rng.normal(), 0), (1, 0, 0.1 * rng.normal())])
    hold = pick(rng, "clamp", "pin", "free")
    spin = rng.normal(size=3) / s.T if hold == "free" else None
    body = fmbd.Rod(
        "rod", points, section, elements=int(rng.integers(2, 5)), degree=int(rng.integers(1, 4)), angular_velocity=spin,
    )  # fmt: skip
    g = s.L / s.T**2 * pick(rng, 0.0, 1.0)
    scene = fmbd.Scene("random rod", gravity=(0.0, 0.3 * g, -g))
    scene.add(body)
    if hold == "clamp":
        scene.add(fmbd.fixed("hold", fmbd.ground, body.surface("start")))
    if hold == "pin":
        scene.add(fmbd.revolute("hold", fmbd.ground, body.surface("start"), center=(0, 0, 0), axis=(0, 1, 0.2)))
    bob = 0.0
    if rng.random() < 0.5:
        bob = s.M * 10.0 ** rng.uniform(-2, 2)
        extra = fmbd.RigidBody("bob", bob, np.full(3, 0.02 * bob * s.L**2), points[-1] + s.L * np.array([0, 0, -0.2]))
        scene.add(extra, fmbd.spherical("ball", body.surface("end"), extra, center=tuple(points[-1])))
    scene.sensor("tip", fmbd.position(body.surface("end")))
    slowest = max(4 * np.sqrt(bending / (s.M + bob) / s.L**3), 3 / s.T)
    schemes = SMOOTH if relaxation else (*SMOOTH, fmbd.EnergyMomentum)
    case = Case(
        f"rod {hold}", scene, pick(rng, *schemes)(), float(10.0 ** rng.uniform(-3, 0) / slowest), lambda run: ""
    )
    least = 1e-9 * s.M * s.L**2 / s.T**2
    case.wrong = flexible(case, s.L, (s.M + bob) * g * s.L + least, slowest)
    return case


def line(rng: Rng) -> Case:
    """A planar line by its own form, pinned or clamped."""
    from dolfinx import fem
    from ufl import cos, sin

    s = sizes(rng)
    bending = s.M * s.L**3 / s.T**2 * 10.0 ** rng.uniform(-1, 2)
    stretch, rotary = bending / s.L**2 * 10.0 ** rng.uniform(2, 4), s.M * s.L * 10.0 ** rng.uniform(-4, -2)

    def mass(z: Any, w: Any, ds: Any) -> Any:
        rho, J = (fem.Constant(ds.ufl_domain(), x) for x in (s.M / s.L, rotary))
        return (rho * (z[0] * w[0] + z[1] * w[1]) + J * z[2] * w[2]) * ds

    def energy(z: Any, ds: Any) -> Any:
        EA, GA, EI = (fem.Constant(ds.ufl_domain(), x) for x in (stretch, stretch / 3, bending))
        c, si, x, y = cos(z[2]), sin(z[2]), z[0].dx(0), z[1].dx(0)
        return 0.5 * (EA * (x * c + y * si - 1) ** 2 + GA * (y * c - x * si) ** 2 + EI * z[2].dx(0) ** 2) * ds

    body = fmbd.LineBody("line", s.L, mass, energy, lambda x: [x, 0 * x, 0 * x], cells=4)
    g = s.L / s.T**2
    scene = fmbd.Scene("random line", gravity=(0.0, -g))
    hold = pick(rng, fmbd.fixed, fmbd.revolute)
    scene.add(body, hold("hold", fmbd.ground, body.surface("start"), center=(0, 0)))
    scene.sensor("tip", fmbd.position(body.surface("end")))
    slowest = max(4 * np.sqrt(bending / s.M / s.L**3), 2 / s.T)
    scheme = pick(rng, *SMOOTH, fmbd.EnergyMomentum)()
    case = Case("line", scene, scheme, float(10.0 ** rng.uniform(-2, 0) / slowest), lambda run: "")
    case.wrong = flexible(case, s.L, s.M * g * s.L, slowest)
    return case


def wire(rng: Rng) -> Case:
    """A wire that is let go under its weight: each of its waves swings about its static sag."""
    s = sizes(rng)
    tension, bending = s.M * s.L / s.T**2, s.M * s.L**3 / s.T**2 * 10.0 ** rng.uniform(-5, -2)
    g = s.L / s.T**2 * 10.0 ** rng.uniform(-4, -1)
    anchor = 1e5 * tension / s.L
    body = fmbd.Wires("wire", s.L, 30, (fmbd.Wire(s.M / s.L, tension, bending),), anchor=anchor)
    scene = fmbd.Scene("random wire", gravity=(0.0, -g))
    at = s.L * rng.uniform(0.2, 0.8)
    scene.add(body)
    scene.sensor("w", fmbd.wire_height(body, 0, [at]))
    dt = float(s.T * 10.0 ** rng.uniform(-3, -1.7))
    steps = int(rng.integers(10, 60))

    def wrong(run: fmbd.Run) -> str:
        n = np.arange(1, 200, 2)
        k = n * np.pi / s.L
        omega = np.sqrt((tension * k**2 + bending * k**4) / (s.M / s.L))
        parts = 4 * g / (n * np.pi * omega**2) * np.sin(k * at)
        exact = -(parts * (1 - np.cos(omega * run.times[:, None]))).sum(axis=1)
        off = np.abs(run["w"][:, 0] - exact).max() / np.abs(parts).sum()
        return f"the wire is {off:.1e} of its sag off" if off > FOLLOWS else ""

    return Case("wire", scene, pick(rng, ALPHA(0.8), ALPHA(0.9, form=fmbd.GGL())), dt, wrong, steps=steps)


# -------------------------------------------------------------------------------------------------------------- fields


@cache
def mesh(size: float, height: float, count: int, rows: int = 1) -> Any:
    """A strip on a regular grid."""
    return fmbd.read_gmsh(MESHES / "block.py", size=(size, height), counts=(count, rows))


def field(rng: Rng) -> Case:
    """An elastic strip on a pin or a clamp, of any law that bodies of elements have, by schemes of all kinds."""
    size = pick(rng, 1e-3, 1.0, 1e3)
    time = 10.0 ** rng.uniform(-3, 3)
    density = 10.0 ** rng.uniform(-1, 4)
    young = density * size**2 / time**2 * 10.0 ** rng.uniform(2, 4)
    thin = 0.1 * size
    laws: dict[str, tuple[Any, dict[str, Any]]] = {
        "floating": (fmbd.FloatingBody, {"elastic": materials.plane_stress(young, 0.3)}),
        "absolute": (fmbd.AbsoluteBody, {"elastic": materials.plane_strain(young, 0.3)}),
        "large": (fmbd.AbsoluteBody, {"energy": materials.saint_venant_kirchhoff(young, 0.3)}),
        "floating, large": (fmbd.FloatingBody, {"energy": materials.saint_venant_kirchhoff(young, 0.3)}),
        "rubber": (fmbd.AbsoluteBody, {"energy": materials.neo_hookean_mixed(young, 0.4999)}),
        "incompressible": (fmbd.AbsoluteBody, {"energy": materials.neo_hookean_incompressible(young)}),
        "pressure": (fmbd.AbsoluteBody, {"elastic": materials.nearly_incompressible(young, 0.4999)}),
    }
    kind = pick(rng, *laws)
    made, law = laws[kind]
    body = made("strip", mesh(size, thin, 4), density=density, **law)
    hold = pick(rng, fmbd.fixed, fmbd.revolute)
    g = 0.3 * size / time**2
    scene = fmbd.Scene("random strip", gravity=(0.0, -g))
    if hold is fmbd.fixed and rng.random() < 0.3:
        scene.add(body, fmbd.tie_surface("tie", body.surface("left"), fmbd.ground))
    else:
        scene.add(body, hold("hold", fmbd.ground, body.surface("left"), center=(0.0, 0.5 * thin)))
    scene.sensor("tip", fmbd.position(body.surface("right")))
    slowest = max(np.sqrt(young / density) * thin / size**2, 1 / time)  # the first of a cantilever
    scheme = pick(rng, *SMOOTH, *((fmbd.EnergyMomentum,) if kind == "large" else ()))()
    linear = None
    if kind in ("floating", "absolute") and type(scheme) is ALPHA and scheme.rtol is None and rng.random() < 0.5:
        linear = fmbd.solvers.FieldSplit()
    case = Case(
        f"strip {kind}", scene, scheme, float(10.0 ** rng.uniform(-2, 0) / slowest), lambda run: "", linear, steps=8
    )
    case.wrong = flexible(case, size, density * size * thin * g * size, slowest)
    return case


# ------------------------------------------------------------------------------------------- rolling, stops and contacts


def rolling(rng: Rng) -> Case:
    """A ball that rolls on a slope under a spin of its own: x = v t + a t^2 / 2, a = g sin / (1 + J / m r^2)."""
    s = sizes(rng)
    r, inertia = s.L * rng.uniform(0.1, 1), rng.uniform(0.2, 0.6)
    g = s.L / s.T**2 * np.array([rng.uniform(-1, 1), rng.uniform(-1, 1), -1.0])
    v = s.L / s.T * np.array([rng.normal(), rng.normal(), 0.0])
    w = np.array([-v[1] / r, v[0] / r, rng.normal() / s.T])  # v + w x (-r e_z) = 0
    ball = fmbd.RigidBody("ball", s.M, np.full(3, inertia * s.M * r**2), (0, 0, r), velocity=v, angular_velocity=w)
    scene = fmbd.Scene("random ball", gravity=tuple(g))
    scene.add(ball, fmbd.rolling("road", fmbd.ground, ball, shape=fmbd.Ball(r), normal=(0, 0, 1)))
    scene.sensor("x", fmbd.position(ball))
    schemes = (
        ALPHA(0.8), ALPHA(0.9, compiled=False), ALPHA(0.9, form=fmbd.GGL()), ALPHA(0.8, rtol=1e-5), fmbd.EnergyMomentum(),
        fmbd.Radau(2, form=fmbd.Index2(), rtol=1e-6), fmbd.BDF(form=fmbd.Index2(), rtol=1e-6), fmbd.HalfExplicit(1e-6),
    )  # fmt: skip
    dt = float(10.0 ** rng.uniform(-4, -1) * min(s.T, 1 / np.abs(w).max()))

    def wrong(run: fmbd.Run) -> str:
        t = run.times[:, None]
        exact = v[:2] * t + 0.5 * g[:2] / (1 + inertia) * t**2
        way = np.abs(exact).max()
        off = np.abs(run["x"][:, :2] - exact).max()
        return f"the ball is {off / way:.1e} of its way off" if off > 1e-3 * way + 1e-9 * s.L else ""

    return Case("rolling", scene, pick(rng, *schemes), dt, wrong)


def stopped(rng: Rng) -> Case:
    """An arm that falls on the stop of its hinge and bounces up to three times, against an integration with events."""
    s = sizes(rng)
    e, far = rng.uniform(0.3, 0.9), rng.uniform(0.2, 1.5)
    J = s.M * s.L**2 * rng.uniform(0.05, 0.5)
    arm = fmbd.RigidBody("arm", s.M, J, (0.5 * s.L, 0.0))
    pin = fmbd.revolute("pin", fmbd.ground, arm, center=(0, 0))
    g = s.L / s.T**2
    scene = fmbd.Scene("random stop", gravity=(0.0, -g))
    scene.add(arm, pin, fmbd.joint_limit("stop", fmbd.angle(pin), lower=-far, restitution=e))
    scene.sensor("phi", fmbd.angle(pin))
    pull = s.M * g * 0.5 * s.L / (J + 0.25 * s.M * s.L**2)
    fall = np.sqrt(2 * far / pull)
    dt = float(fall * 10.0 ** rng.uniform(-3, -1.5))
    steps = int(rng.uniform(1, 2.2) * fall / dt)

    def wrong(run: fmbd.Run) -> str:
        hits = lambda t, y: y[0] + far
        hits.terminal, hits.direction = True, -1  # type: ignore[attr-defined]
        t, y, late = 0.0, np.zeros(2), 0.0
        for _ in range(4):
            found = solve_ivp(
                lambda t, y: [y[1], -pull * np.cos(y[0])], (t, run.times[-1]), y, events=hits, rtol=1e-10, atol=1e-12
            )
            t, y = found.t[-1], found.y[:, -1]
            if found.status != 1:
                off = abs(run["phi"][-1, 0] - y[0])
                allowed = 3 * dt * pull * fall + 1e-3 * far + late
                return f"the arm is {off:.1e} rad off, {allowed:.1e} allowed" if off > allowed else ""
            y = np.array([-far, -e * y[1]])
            late += 3 * dt * abs(y[1])  # an impact is found in its step
        return ""

    return Case("stop", scene, fmbd.Moreau(), dt, wrong, steps=max(steps, 2))


def plate(rng: Rng) -> Case:
    """A rigid plate thrown on a rough floor: momentum, energy, and its corners above the floor."""
    s = sizes(rng)
    v0 = s.L / s.T * np.array([rng.normal(), -abs(rng.normal())])
    height = s.L * rng.uniform(0.6, 2)
    body = fmbd.RigidBody(
        "plate", s.M, 0.1 * s.M * s.L**2, (0, height), rotation=float(rng.uniform(-1, 1)), velocity=v0,
        angular_velocity=float(rng.normal() / s.T),
    )  # fmt: skip
    feet = fmbd.corners(body, [(x, y) for x in (-0.5 * s.L, 0.5 * s.L) for y in (-0.05 * s.L, 0.05 * s.L)])
    floor = fmbd.Obstacle("floor", fmbd.HalfSpace((0, 0), (0, 1)))
    friction = float(pick(rng, 0.0, 0.3, 1.0))
    pair = fmbd.contact("floor", feet, floor, friction=friction, restitution=float(rng.uniform(0, 0.9)))
    g = s.L / s.T**2
    scene = fmbd.Scene("random plate", gravity=(0.0, -g))
    scene.add(body, pair)
    scene.sensor("impulse", fmbd.contact_impulse(pair))
    dt = float(s.T * 10.0 ** rng.uniform(-3, -1.5))

    def wrong(run: fmbd.Run) -> str:
        p, _ = run.system.at(run.state.t, run.state.q, run.state.v).momenta()
        pushed = p - s.M * v0 + np.array([0.0, s.M * g * run.state.t])
        push, size = run["impulse"][-1], s.M * (np.abs(v0).max() + g * run.state.t)
        if (
            np.abs(np.abs(pushed[::-1]) - np.abs(push[:2])).max() > 1e-6 * size
            and np.abs(pushed - push[:2]).max() > 1e-6 * size
        ):
            return f"momentum {pushed} is not that of the impulses {push}"
        if abs(pushed[0]) > friction * pushed[1] + 1e-9 * size:
            return "friction is above its bound"
        q = run.state.q
        low = q[1] + min(x * np.sin(q[2]) + y * np.cos(q[2]) for x in (-0.5, 0.5) for y in (-0.05, 0.05)) * s.L
        deep = 1e-6 * s.L + 2 * g * dt**2 + dt * dt * s.L * float(np.abs(run.state.v[2])) ** 2
        return f"a corner is {-low / s.L:.1e} lengths in the floor" if low < -deep else gains(run, s.M * g * s.L)

    return Case("plate", scene, fmbd.Moreau(), dt, wrong, steps=int(rng.integers(50, 300)))


def landing(rng: Rng) -> Case:
    """An elastic block that meets a floor obliquely: momentum by the impulses, no energy from nothing."""
    size, time, density = pick(rng, 1e-3, 1.0, 1e3), 10.0 ** rng.uniform(-3, 3), 10.0 ** rng.uniform(-1, 4)
    young = density * size**2 / time**2 * 10.0 ** rng.uniform(0.5, 3)
    v0 = size / time * np.array([rng.uniform(-0.3, 0.3), -rng.uniform(0.02, 0.3)])
    kind = pick(rng, fmbd.AbsoluteBody, fmbd.FloatingBody)
    body = kind(
        "block", mesh(size, 0.5 * size, 6, 3), degree=1, density=density, elastic=materials.plane_strain(young, 0.2), velocity=v0,
    )  # fmt: skip
    friction = float(pick(rng, 0.0, 0.3))
    floor = fmbd.Obstacle("floor", fmbd.HalfSpace((0, -0.01 * size), (0, 1)))
    pair = fmbd.contact("floor", body.surface("bottom"), floor, friction=friction)
    scene = fmbd.Scene("random landing")
    scene.add(body, pair)
    scene.sensor("impulse", fmbd.contact_impulse(pair))
    scene.sensor("force", fmbd.contact_force(pair))
    fastest = np.sqrt(young / density) * 20 / size
    dt = float(10.0 ** rng.uniform(-1, 1) / fastest)
    mass = 0.5 * density * size**2

    def wrong(run: fmbd.Run) -> str:
        p, _ = run.system.at(run.state.t, run.state.q, run.state.v).momenta()
        pushed = p - mass * v0
        allowed = 1e-5 * mass * np.abs(v0).max()
        if isinstance(run.scheme, fmbd.ContactAlpha):  # its weights of forces sum up to one step's more or less
            allowed += 2 * dt * np.abs(run["force"]).max()
        if np.abs(pushed - run["impulse"][-1]).max() > allowed:
            return f"momentum {pushed} is not that of the impulses {run['impulse'][-1]}"
        if abs(pushed[0]) > friction * pushed[1] + allowed:
            return "friction is above its bound"
        return gains(run, 0.0)

    scheme = pick(rng, fmbd.ContactMidpoint(), fmbd.ContactAlpha(0.8))
    return Case("landing", scene, scheme, dt, wrong, steps=40)


KINDS = (rod, rod, line, wire, field, field, rolling, stopped, plate, landing)


def case(seed: int) -> Case:
    """The random scene of a number."""
    rng = np.random.default_rng([seed, 11])
    return pick(rng, *KINDS)(rng)
