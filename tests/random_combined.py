"""Random scenes of all that a user may combine, each in any scheme and form.

Chains of rigid, elastic and reduced bodies, beams and masses on joints, bushings and soft springs, with springs, drives, gears,
stops, friction, motors, controllers, tyres and rods. Nobody knows their motion: two other schemes with tight tolerances judge
where they agree, by where the links end. Runs with steps that are too large have to come nearer with smaller ones.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np
from random_flexible import MESHES, Rng, Sizes, sizes
from random_scenes import pick

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import materials
from fmbd_fenicsx.errors import FmbdError

ALPHA = fmbd.GeneralizedAlpha
STEPS, FINE = 20, 200  # of runs with equal steps, and into how many each is cut in a reference
AGREE = 1e-4  # of the length of the model: by how much references may differ that judge
FOLLOWS = 0.03  # of the way
AMPLIFIED = 300.0  # times rtol, of the way
NEARER = 0.6  # what is left of an error in an eighth of the steps, or with a twentieth of rtol

IMPLICIT: tuple[Callable[[], Any], ...] = (
    lambda: ALPHA(0.8),
    lambda: ALPHA(0.9, form=fmbd.GGL()),
    lambda: ALPHA(0.8, compiled=False),
    lambda: ALPHA(0.8, rtol=1e-4),
    lambda: ALPHA(0.9, rtol=1e-5, form=fmbd.GGL()),
    lambda: fmbd.Radau(3, rtol=1e-5),
    lambda: fmbd.Radau(2, form=fmbd.Index2(), rtol=1e-5),
    lambda: fmbd.Radau(3, form=fmbd.Index3(), rtol=1e-5),
    lambda: fmbd.Radau(2, rtol=None),
    lambda: fmbd.BDF(rtol=1e-5),
    lambda: fmbd.BDF(form=fmbd.Index2(), rtol=1e-5),
    lambda: fmbd.BDF(2, form=fmbd.Index3(), rtol=None),
    lambda: fmbd.BDF(2, rtol=None),
)
OTHERS: tuple[Callable[[], Any], ...] = (
    fmbd.Rattle,
    fmbd.EnergyMomentum,
    lambda: fmbd.HalfExplicit(1e-5),
    lambda: fmbd.ExplicitRungeKutta(1e-6),
)
REFERENCES = fmbd.Radau(3, rtol=1e-7), fmbd.BDF(rtol=1e-7), ALPHA(0.95)


@cache
def strip(size: float, height: float, begin: float) -> Any:
    """The mesh of a strip along x."""
    return fmbd.read_gmsh(MESHES / "block.py", size=(size, height), counts=(4, 1), origin=(begin, -0.5 * height))


@dataclass
class Chain:
    """A chain along x that grows link by link, and what hangs on it; ``every``: between samples of its controllers, s.

    ``ends``: of each link the sides at its beginning and at its end; ``free``: coordinates that nothing prescribes, with a radian
    or a length of each.
    """

    rng: Rng
    s: Sizes
    scene: fmbd.Scene
    every: float
    ends: list[tuple[Any, Any]] = field(default_factory=list)
    free: list[tuple[Any, float]] = field(default_factory=list)
    what: list[str] = field(default_factory=list)

    @property
    def stiffness(self) -> float:
        """That which swings a link in about a unit of time, N/m."""
        return self.s.M / self.s.T**2

    def place(self, k: int) -> tuple[float, float]:
        """Where link k begins."""
        return (k * self.s.L, 0.0)

    def chosen(self, *kinds: str) -> str:
        """One of several kinds, which is noted."""
        kind = str(pick(self.rng, *kinds))
        self.what.append(kind)
        return kind

    # -- bodies ---------------------------------------------------------------------------------------------------------
    def link(self) -> None:
        """One more body of mass M and length L, on a joint at its beginning."""
        k = len(self.ends)
        kind = self.chosen("rigid", "rigid", "rigid", "field", "modes", "interfaces", "beam", *(("mass",) if k else ()))
        body = self.rigid(k) if kind == "rigid" else self.mass(k) if kind == "mass" else self.elastic(k, kind)
        names = {"beam": ("start", "end")}.get(kind, ("left", "right"))
        stiff = kind in ("rigid", "mass")
        sides = (body, body) if stiff else tuple(map(body.surface, names))

        self.scene.add(body)
        self.join(k, self.ends[-1][1] if k else fmbd.ground, sides[0])
        self.ends.append(sides)
        seen = {"point": self.place(k + 1)} if kind == "rigid" else {}
        self.scene.sensor(f"link {k}", fmbd.position(sides[1], **seen))

    def rigid(self, k: int) -> Any:
        """A rigid body with its mass anywhere."""
        s, rng = self.s, self.rng
        inertia = s.M * s.L**2 * 10.0 ** rng.uniform(-2, -0.5)
        return fmbd.RigidBody(f"body {k}", s.M, inertia, ((k + rng.uniform(0.3, 0.7)) * s.L, 0.0))

    def mass(self, k: int) -> Any:
        """A mass at a point, on a string of a length."""
        return fmbd.PointMass(f"body {k}", self.s.M, self.place(k + 1))

    def elastic(self, k: int, kind: str) -> Any:
        """A field, modes of it, or a beam; in a frame of any kind."""
        s, rng, name, width = self.s, self.rng, f"body {k}", 0.1 * self.s.L
        density = s.M / (s.L * width)
        young = density * s.L**2 / s.T**2 * 10.0 ** rng.uniform(2.0, 3.5)
        if kind == "beam":
            section = fmbd.Section(
                EA=young * width, EI=young * width**3 / 12, rhoA=s.M / s.L, rhoI=s.M / s.L * width**2 / 12
            )
            attached = self.chosen("attached", "mean") == "attached"
            return fmbd.Beam(
                name, start=self.place(k), end=self.place(k + 1), section=section, elements=2, attached=attached
            )
        frames: dict[str, Any] = {
            "attached": fmbd.Attached("left"),
            "chord": fmbd.Chord("left", "right"),
            "mean": fmbd.MeanAxis(),
        }
        body = fmbd.FloatingBody(
            name, strip(s.L, width, k * s.L), density=density, elastic=materials.plane_stress(young, 0.3),
            frame=frames[self.chosen(*frames)], stiffness_damping=float(pick(rng, 1e-3, 1e-2)) * s.T,
        )  # fmt: skip
        if kind == "modes":
            return body.reduced(modes=int(rng.integers(2, 6)))
        return body.reduced(basis=fmbd.CraigBampton(("left", "right"), 2)) if kind == "interfaces" else body

    # -- joints ---------------------------------------------------------------------------------------------------------
    def join(self, k: int, a: Any, b: Any) -> None:
        """Two sides at the beginning of link k: by a joint, or by stiffness."""
        rng, s, name, at = self.rng, self.s, f"joint {k}", self.place(k)
        if isinstance(b, fmbd.PointMass):
            self.scene.add(fmbd.distance(name, a, b, point_a=at, point_b=self.place(k + 1), length=s.L))
            return
        if isinstance(a, fmbd.PointMass):  # which has no attitude to read
            self.scene.add(fmbd.revolute(name, a, b, center=at))
            return

        later = ("fixed", "soft") if k else ()
        kind = self.chosen("revolute", "revolute", "revolute", "prismatic", "bushing", *later)
        if kind == "fixed":
            self.scene.add(fmbd.fixed(name, a, b, center=at))
        elif kind == "revolute":
            pin = fmbd.revolute(name, a, b, center=at)
            self.scene.add(pin)
            self.free.append((fmbd.angle(pin), 1.0))
        elif kind == "prismatic":
            rail = fmbd.prismatic(name, a, b, axis=(float(rng.uniform(-0.5, 0.5)), 1.0), center=at)
            slide = fmbd.displacement(rail)
            self.scene.add(rail, fmbd.joint_spring(f"{name} spring", slide, stiffness=10 * self.stiffness))
            self.free.append((slide, s.L))
        else:
            size = self.stiffness * 10.0 ** (rng.uniform(3, 6) if kind == "bushing" else rng.uniform(0.5, 2))
            each = np.array((size, size, size * s.L**2 * pick(rng, 0.0, 0.1)))
            self.scene.add(fmbd.bushing(name, a, b, center=at, stiffness=each, damping=0.01 * s.T * each))

    # -- what acts ------------------------------------------------------------------------------------------------------
    def take(self) -> tuple[Any, float] | None:
        """A coordinate that nothing acts on so far."""
        return self.free.pop(int(self.rng.integers(len(self.free)))) if self.free else None

    def act_on_joint(self, n: int) -> None:
        """A law, a drive, a gear, a stop, friction or a controller."""
        found = self.take()
        if found is None:
            return
        (on, one), rng, T = found, self.rng, self.s.T
        effort = self.stiffness * self.s.L**2 / one**2  # by a radian, or a metre
        kind = self.chosen(
            "spring", "stiff spring", "drive", "gear", "stop", "friction", "stick", "motor", "pid", "sampled pid", "memory",
            "sampled memory", "law",
        )  # fmt: skip
        name, c = f"{kind} {n}", effort * 10.0 ** (rng.uniform(3, 6) if kind == "stiff spring" else rng.uniform(-1, 1))
        every = self.every if kind.startswith("sampled") else None
        size, w = one * rng.uniform(0.1, 1.0), rng.uniform(0.5, 3) / T

        def follows(t: float, y: Any, z: Any) -> Any:
            change = 0.3 * (y["s"] - z) * (1.0 if every else 1.0 / T)
            return -3.0 * effort * z, (z + change if every else change)

        other = self.take() if kind == "gear" else None
        if kind == "gear" and other is None:
            return
        made: dict[str, Callable[[], Any]] = {
            "spring": lambda: fmbd.joint_spring(name, on, stiffness=c, damping=0.01 * c * T),
            "stiff spring": lambda: fmbd.joint_spring(name, on, stiffness=c),
            "drive": lambda: fmbd.drive(name, on, lambda t: size * (1 - np.cos(w * t)) ** 2),
            "gear": lambda: fmbd.gear(name, on, other[0], ratio=float(rng.uniform(0.5, 2)) * other[1] / one),  # type: ignore[index]
            "stop": lambda: fmbd.elastic_stop(
                name, on, upper=0.2 * one, lower=-0.2 * one, stiffness=100 * effort, damping=0.1 * effort * T
            ),
            "friction": lambda: fmbd.joint_friction(name, on, coulomb=0.05 * effort * one, speed=0.05 * one / T),
            "stick": lambda: fmbd.dry_friction(
                name, on, limit=0.05 * effort * one, stick=100 * effort, damping=effort * T
            ),
            "motor": lambda: fmbd.motor(name, on, target=0.3 * one, kp=10 * effort, kd=effort * T),
            "pid": lambda: fmbd.pid(
                name, on, target=0.3 * one, gains=(5 * effort, effort / T, effort * T), every=every
            ),
            "memory": lambda: fmbd.controller(name, reads={"s": on}, acts=on, law=follows, memory=(0.0,), every=every),
            "law": lambda: fmbd.joint_spring(
                name, on, law=lambda x, v, t: effort * (x + 0.5 * x**3 / one**2 + 0.1 * T * v)
            ),
        }
        self.scene.add(made[kind.removeprefix("sampled ")]())

    def act_on_link(self, n: int) -> None:
        """A spring, a damper, a force, a torque, a tyre or a rod to the ground at the end of a link."""
        rng, s = self.rng, self.s
        k = int(rng.integers(len(self.ends)))
        side, at = self.ends[k][1], self.place(k + 1)
        if isinstance(side, fmbd.PointMass):
            return
        kind = self.chosen("spring", "tie", "damper", "force", "follower", "torque", "rod", "tyre")
        name, F, c = f"{kind} at {n}", s.M * s.L / s.T**2, self.stiffness * 10.0 ** rng.uniform(-1, 1)
        far = (at[0] + s.L * float(rng.uniform(-0.5, 0.5)), s.L * float(pick(rng, 1.3, -1.3)))
        ends: dict[str, Any] = {"point_a": far, "point_b": at, "length": float(np.hypot(far[0] - at[0], far[1]))}
        if kind == "tyre" and not isinstance(side, fmbd.RigidBody):
            return
        made: dict[str, Callable[[], Any]] = {
            "spring": lambda: fmbd.Spring(name, fmbd.ground, side, stiffness=c, **ends),
            "tie": lambda: fmbd.Spring(name, fmbd.ground, side, stiffness=c * 1e5, **ends),
            "damper": lambda: fmbd.Spring(name, fmbd.ground, side, damping=10 * c * s.T, **ends),
            "force": lambda: fmbd.force(name, side, lambda t: (0.2 * F * np.sin(3 * t / s.T), 0.3 * F)),
            "follower": lambda: fmbd.force(name, side, lambda t: (0.2 * F * np.sin(3 * t / s.T), 0.3 * F), follower=True),
            "torque": lambda: fmbd.torque(name, side, lambda t: 0.1 * F * s.L * np.sin(2 * t / s.T)),
            "rod": lambda: fmbd.distance(name, fmbd.ground, side, **ends),
            "tyre": lambda: fmbd.Tyre(
                name, side, point_a=at, road=lambda x, t: 0.02 * s.L * np.sin(3 * x[0] / s.L) - 0.28 * s.L, radius=0.3 * s.L,
                stiffness=20 * self.stiffness, damping=self.stiffness * s.T, up=(0.0, 1.0),
            ),
        }  # fmt: skip
        self.scene.add(made[kind]())


@dataclass
class Case:
    """A scene, a scheme, and ``wrong``: what two other schemes say of the end of a run, empty when it is right."""

    label: str
    scene: fmbd.Scene
    scheme: Any
    t_end: float
    size: float

    def run(self, scheme: Any = None, finer: int = 1) -> fmbd.Run:
        """Twenty equal steps or as many times more, or those that the scheme chooses."""
        scheme = scheme or self.scheme
        chosen = getattr(scheme, "rtol", None) is not None
        dt = None if chosen else self.t_end / (STEPS * finer)
        return fmbd.solve(self.scene, t_end=self.t_end, dt=dt, scheme=scheme)

    def references(self) -> list[fmbd.Run]:
        """Two that end, of schemes that are not the one that is judged where that can be; fewer where they do not."""
        made: list[fmbd.Run] = []
        for scheme in REFERENCES:
            try:
                made.append(self.run(scheme, FINE))
            except FmbdError:
                continue
            if len(made) == 2:
                break
        return made

    def wrong(self, run: fmbd.Run) -> str:
        if abs(run.times[-1] - self.t_end) > 1e-9 * self.t_end:
            return f"ends at {run.times[-1]} instead of {self.t_end}"
        known = self.references()
        if len(known) < 2:
            return ""
        exact, doubt = known[0], apart(*known)
        way = max(np.abs(x - x[0]).max() for x in exact.series.values())
        rtol = getattr(self.scheme, "rtol", None)
        allowed = (FOLLOWS if rtol is None else AMPLIFIED * rtol) * way + 3 * doubt + 1e-9 * self.size
        missed = apart(run, exact)
        if doubt > AGREE * self.size or missed <= allowed:
            return ""
        closer = apart(self.run(rtol and replace(self.scheme, rtol=0.05 * rtol), 8), exact)
        if closer <= max(NEARER * missed, allowed):
            return ""
        return (
            f"{missed / way:.1e} of the way off, {closer / way:.1e} when finer; references differ by {doubt / way:.1e}"
        )


def apart(run: fmbd.Run, other: fmbd.Run) -> float:
    """By how much links end in two places, m."""
    return float(max(np.abs(run[n][-1] - other[n][-1]).max() for n in run.series))


def case(seed: int) -> Case:
    """The random chain of a number."""
    rng = np.random.default_rng([seed, 23])
    s = sizes(rng)
    t_end = s.T * float(10.0 ** rng.uniform(-1.5, -0.3))
    scene = fmbd.Scene("random chain", gravity=(0.0, -s.L / s.T**2 * float(pick(rng, 0.0, 1.0, 1.0))))
    chain = Chain(rng, s, scene, t_end / STEPS)
    for _ in range(int(rng.integers(1, 4))):
        chain.link()
    for n in range(int(rng.integers(0, 3))):
        chain.act_on_joint(n)
    for n in range(int(rng.integers(0, 3))):
        chain.act_on_link(n)

    stiff = {"field", "modes", "interfaces", "beam", "bushing", "tie", "stiff spring"} & set(chain.what)
    scheme = pick(rng, *IMPLICIT, *(() if stiff else OTHERS))()
    label = " ".join((type(scheme).__name__, getattr(getattr(scheme, "form", None), "name", ""), *chain.what))
    return Case(label, scene, scheme, t_end, s.L * len(chain.ends))
