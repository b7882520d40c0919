"""Scenes whose runs have to keep tolerances, with references that do not come from the same discretisation.

A reference is exact where a formula or a quadrature exists; else it is a run in clearly finer spaces with clearly smaller
steps, or by another scheme of high order with a tight tolerance. ``check`` compares at the recorded times of a run.

Run:  cd tests; ../with-dolfinx python3 tolerance_scenes.py [-v] [name ...]        (a table; -v: every attempt)
"""

from __future__ import annotations

import sys
import time as clock
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from chains import chain
from dae_problems import pendulum as point_pendulum
from scipy.integrate import solve_ivp

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.materials import linear_elastic, nearly_incompressible, plane_stress
from fmbd_fenicsx.system.scene.refinement import refined, with_bodies

MESHES = Path(__file__).resolve().parents[1] / "meshes"
VERBOSE = "-v" in sys.argv
LAST: list[str] = []  # attempts of the last check
TIMES = 81  # instants of a comparison
SHORT, AGAIN = 0.2, 4  # s: runs that are timed again, and how often


@dataclass(frozen=True)
class Case:
    """A scene, its sensor, two tolerances (in the sensor's unit), and the reference, at given times (n,) -> (n, size)."""

    scene: Callable[[], fmbd.Scene]
    t_end: float
    sensor: str
    tolerances: tuple[Any, Any]
    reference: Callable[[Case, Any], Any]
    settings: dict[str, Any] = field(default_factory=dict)  # of solve
    also: dict[str, Any] = field(default_factory=dict)  # tolerances of other sensors

    def tol(self, value: Any) -> dict[str, Any]:
        """What a call is given."""
        return {self.sensor: value, **self.also}


def finer(meshes: int, other: Callable[[], fmbd.Scene] | None = None, **settings: Any) -> Callable[[Case, Any], Any]:
    """A reference by a run with finer meshes and the given settings, of the scene or of another one."""

    def run(case: Case, times: Any) -> Any:
        scene = (other or case.scene)()
        for _ in range(meshes):
            scene = refined(scene)
        output = fmbd.Output(times=tuple(times), energy=False, progress=False)
        return fmbd.solve(scene, t_end=case.t_end, output=output, **settings)[case.sensor]

    return run


# -- rigid bodies ---------------------------------------------------------------------------------------------------
def swinging(case: Case, times: Any) -> Any:
    """The point pendulum by its angle."""
    rate = lambda t, y: [y[1], -9.81 * np.sin(y[0])]  # noqa: E731
    angle = solve_ivp(rate, [0, case.t_end], [1.0, 1.0], "DOP853", t_eval=times, rtol=1e-12, atol=1e-13).y[0]
    return np.stack((np.sin(angle), -np.cos(angle)), axis=1)


def mass_on_spring() -> fmbd.Scene:
    """A weight of 2 kg hangs on a spring of 50 N/m, released where the spring is free of force."""
    scene = fmbd.Scene("mass on spring", gravity=(0.0, -9.81))
    body = fmbd.RigidBody("weight", 2.0, 0.1, (0.0, -1.0))
    scene.add(body, fmbd.prismatic("guide", fmbd.ground, body, axis=(0, 1), center=(0, 0)))
    scene.add(fmbd.Spring("spring", fmbd.ground, body, stiffness=50.0, length=1.0))
    scene.sensor("weight", fmbd.position(body))
    return scene


def hanging(case: Case, times: Any) -> Any:
    """Its vibration about the equilibrium."""
    fall = 2.0 * 9.81 / 50.0 * (1 - np.cos(5.0 * times))
    return np.stack((0.0 * times, -1.0 - fall), axis=1)


def geared_chain() -> fmbd.Scene:
    """Three links swing from the horizontal, the third joint turned by a gear on the second."""
    scene, last = chain(3, "geared chain")
    pins = scene.joints
    scene.add(fmbd.gear("gear", fmbd.angle(pins["pin 1"]), fmbd.angle(pins["pin 2"]), ratio=-0.5))
    scene.sensor("end", fmbd.position(last))
    scene.sensor("pin force", fmbd.reaction("pin 0"))
    return scene


def spinning_box() -> fmbd.Scene:
    """A heavy top in space."""
    scene = fmbd.Scene("top", gravity=(0, 0, -9.81))
    spin = (0.5, 1.0, 6.0)
    body = fmbd.RigidBody(
        "top",
        2.0,
        (0.1, 0.2, 0.25),
        (0.3, 0, 0.1),
        angular_velocity=spin,
        velocity=tuple(np.cross(spin, (0.3, 0, 0.1))),
    )
    scene.add(body, fmbd.spherical("tip", body, fmbd.ground, center=(0, 0, 0)))
    scene.sensor("centre", fmbd.position(body))
    return scene


def flying_bar() -> fmbd.Scene:
    """A bar of 1 m and unit wave speed meets a wall after 0.5 s, stays for 2 s and leaves as it came."""
    mesh = fmbd.read_gmsh(MESHES / "block.py", size=(1.0, 0.1), counts=(10, 1), origin=(0.05, 0.0), quads=True)
    bar = fmbd.AbsoluteBody("bar", mesh, degree=1, density=1.0, elastic=linear_elastic(1.0, 0.0), velocity=(-0.1, 0.0))
    wall = fmbd.contact("wall", bar.surface("left"), fmbd.Obstacle("wall", fmbd.HalfSpace((0.0, 0.0), (1.0, 0.0))))
    scene = fmbd.Scene("bar")
    scene.add(bar, wall)
    scene.sensor("left", fmbd.position(bar.surface("left")))
    return scene


def rebound(case: Case, times: Any) -> Any:
    """Free flight, rest on the wall, free flight."""
    x = np.where(times < 0.5, 0.05 - 0.1 * times, np.where(times < 2.5, 0.0, 0.1 * (times - 2.5)))
    return np.stack((x, 0.05 + 0 * x), axis=1)


# -- elastic bodies -------------------------------------------------------------------------------------------------
def rise(T: float) -> Callable[[float], float]:
    """From 0 to 1 within T seconds, two continuous derivatives."""

    def at(t: float) -> float:
        x = min(t / T, 1.0)
        return x**3 * (10 - 15 * x + 6 * x * x)

    return at


def elastic_pendulum(degree: int = 1, modes: int | None = None) -> fmbd.Scene:
    """A soft rod on a pin, its weight switched on smoothly."""
    mesh = fmbd.read_gmsh(MESHES / "rod.py", dim=2, h=0.5, height=0.1)
    body: Any = fmbd.FloatingBody("rod", mesh, degree=degree, density=1000.0, elastic=linear_elastic(1e6, 0.3))
    body = body if modes is None else body.reduced(modes=modes)
    scene = fmbd.Scene("elastic pendulum", gravity=(0.0, -9.81), gravity_ramp=0.4)
    scene.add(body, fmbd.revolute("pin", fmbd.ground, body.surface("pin"), center=(0, 0)))
    scene.sensor("tip", fmbd.position(body.surface("tip")))
    return scene


def spun_up(modes: int | None = None) -> fmbd.Scene:
    """An arm of 10 m by 2 beam elements is brought to 2 rad/s."""
    section = fmbd.Section(EA=2.8e7, EI=1.4e4, rhoA=1.2, rhoI=6e-4, GA=1e7)
    arm = fmbd.Beam("arm", (0.0, 0.0), (10.0, 0.0), section, elements=2, modes=modes, stiffening=True)
    hub = fmbd.RigidBody("hub", mass=1.0, inertia=1.0, position=(0.0, 0.0))
    scene = fmbd.Scene("spin-up")

    def motion(t: float) -> tuple[float, float, float]:
        T, W = 5.0, 2.0
        if t >= T:
            return W * (t - T / 2), W, 0.0
        w, a = 2 * np.pi / T, W / T
        return a * (t * t / 2 + (np.cos(w * t) - 1) / w**2), a * (t - np.sin(w * t) / w), a * (1 - np.cos(w * t))

    scene.add(arm, hub, fmbd.revolute("axle", fmbd.ground, hub, center=(0, 0)))
    scene.add(fmbd.fixed("weld", hub, arm.surface("start")), fmbd.drive_rotation("motor", fmbd.ground, hub, motion))
    scene.sensor("tip", fmbd.position(arm.surface("end")))
    return scene


def clamped_beam() -> fmbd.Scene:
    """A Timoshenko beam, a load at its end that rises within 0.2 s."""
    section = fmbd.Section.rectangle(youngs_modulus=2e9, poisson_ratio=0.3, density=1000.0, width=0.02, height=0.02)
    beam = fmbd.Beam("beam", (0.0, 0.0), (1.0, 0.0), section, elements=1)
    scene, up = fmbd.Scene("clamped beam"), rise(0.2)
    scene.add(beam, fmbd.fixed("clamp", fmbd.ground, beam.surface("start")))
    scene.add(fmbd.force("load", beam.surface("end"), lambda t: (0.0, -2.0 * up(t))))
    scene.sensor("tip", fmbd.position(beam.surface("end")))
    return scene


def clamped_in_millimetres() -> fmbd.Scene:
    """The same kind of beam in millimetres, tonnes, newtons: steel, 100 mm, twice as thick, with two elements."""
    section = fmbd.Section.rectangle(youngs_modulus=2.1e5, poisson_ratio=0.3, density=7.85e-9, width=1.0, height=1.0)
    beam = fmbd.Beam("beam", (0.0, 0.0), (100.0, 0.0), section, elements=2)
    scene, up = fmbd.Scene("beam in mm", gravity=(0.0, 0.0)), rise(0.03)
    scene.add(beam, fmbd.fixed("clamp", fmbd.ground, beam.surface("start")))
    scene.add(fmbd.force("load", beam.surface("end"), lambda t: (0.0, 0.05 * up(t))))
    scene.sensor("tip", fmbd.position(beam.surface("end")))
    return scene


def twisted_bar(degree: int = 1) -> fmbd.Scene:
    """A bar in space is pulled up at its end."""
    mesh = fmbd.read_gmsh(MESHES / "rod.py", dim=3, h=0.25, height=0.25)
    bar = fmbd.FloatingBody("bar", mesh, degree=degree, density=1000.0, elastic=linear_elastic(1e7, 0.3))
    scene, up = fmbd.Scene("bar in space"), rise(0.15)
    scene.add(bar, fmbd.revolute("pin", fmbd.ground, bar.surface("pin"), center=(0, 0, 0), axis=(0, 0, 1)))
    scene.add(fmbd.force("pull", bar.surface("tip"), lambda t: (0.0, 100.0 * up(t), 0.0)))
    scene.sensor("tip", fmbd.position(bar.surface("tip")))
    return scene


def swinging_rod(degree: int = 1) -> fmbd.Scene:
    """A geometrically exact rod swings about a ball, its weight switched on within 0.3 s."""
    section = fmbd.RodSection((1e5, 4e4, 4e4, 20.0, 30.0, 30.0), 1.0, (2e-3, 1e-3, 1e-3))
    rod = fmbd.Rod("rod", [(0, 0, 0), (1, 0, 0)], section, elements=2, degree=degree)
    scene = fmbd.Scene("rod", gravity=(0.0, 0.0, -9.81), gravity_ramp=0.3)
    scene.add(rod, fmbd.revolute("pin", fmbd.ground, rod.surface("start"), center=(0, 0, 0), axis=(0, 1, 0)))
    scene.sensor("tip", fmbd.position(rod.surface("end")))
    return scene


def pushed_line() -> fmbd.Scene:
    """A planar line by its weak form, clamped, a load at its end."""
    from test_line_body import line

    beam, up = line(cells=2, mass_damping=2.0), rise(0.5)
    scene = fmbd.Scene("line")
    scene.add(beam, fmbd.fixed("clamp", fmbd.ground, beam.surface("start")))
    scene.add(fmbd.force("load", beam.surface("end"), lambda t: (0.0, 20.0 * up(t))))
    scene.sensor("tip", fmbd.position(beam.surface("end")))
    return scene


def squeezed_block() -> fmbd.Scene:
    """A nearly incompressible block bonded to the floor, its top pushed down smoothly."""
    mesh = fmbd.read_gmsh(MESHES / "block.py", size=(0.2, 0.1), counts=(2, 1), origin=(0.0, 0.0))
    block = fmbd.AbsoluteBody(
        "block", mesh, density=1100.0, elastic=nearly_incompressible(1e6, 0.4999), stiffness_damping=5e-3
    )
    scene, up = fmbd.Scene("block"), rise(0.1)
    load = fmbd.force("push", block.surface("top"), lambda t: (300.0 * up(t), 0.0))
    scene.add(block, fmbd.fixed("floor", fmbd.ground, block.surface("bottom")), load)
    scene.sensor("top", fmbd.position(block.surface("top")))
    return scene


def tied_bar() -> fmbd.Scene:
    """A bar of two pieces whose meshes do not match, pulled smoothly."""
    law, scene, pieces, up = plane_stress(1e6, 0.3), fmbd.Scene("tied bar"), [], rise(0.1)
    for i, counts in enumerate(((2, 2), (2, 3))):
        mesh = fmbd.read_gmsh(MESHES / "block.py", size=(0.5, 0.2), counts=counts, origin=(0.5 * i, 0.0))
        pieces.append(
            fmbd.AbsoluteBody(f"piece {i}", mesh, degree=1, density=1000.0, elastic=law, stiffness_damping=1e-3)
        )
    left, right = pieces
    scene.add(left, right, fmbd.fixed("wall", fmbd.ground, left.surface("left")))
    scene.add(fmbd.tie_surface("glue", right.surface("left"), left.surface("right")))
    scene.add(fmbd.force("pull", right.surface("right"), lambda t: (0.0, 500.0 * up(t))))
    scene.sensor("end", fmbd.position(right.surface("right")))
    return scene


def fe_crank(modes: int | None = None) -> fmbd.Scene:
    """A slider crank with a rod of finite elements, driven from rest."""
    sys.path.insert(0, str(MESHES.parent / "demos"))
    import crank_fe_model

    body: Any = crank_fe_model.rod(0.03, 0.03)
    return crank_fe_model.scene(body if modes is None else crank_fe_model.reduced(body, modes))


EXACT = fmbd.Radau(5, rtol=1e-11)
EXACT_ROD = finer(2, lambda: swinging_rod(3), scheme=fmbd.Radau(3, rtol=1e-7))  # by 4e-9
CASES = {
    "pendulum": Case(point_pendulum, 2.0, "x", (1e-2, 1e-4), swinging),
    "pendulum, Radau": Case(point_pendulum, 2.0, "x", (1e-3, 1e-7), swinging, {"scheme": fmbd.Radau(3)}),
    "mass on spring": Case(mass_on_spring, 3.0, "weight", (1e-2, 1e-4), hanging),
    "geared chain": Case(geared_chain, 1.0, "end", (1e-2, 1e-3), finer(0, scheme=EXACT)),
    "top": Case(spinning_box, 1.0, "centre", (1e-2, 1e-4), finer(0, scheme=EXACT)),
    "bar before the wall": Case(flying_bar, 0.4, "left", (1e-3, 1e-4), rebound),
    "bar on the wall and back": Case(flying_bar, 4.0, "left", (2e-2, 5e-3), rebound),
    "elastic pendulum": Case(elastic_pendulum, 0.5, "tip", (1e-2, 1e-3), finer(3, lambda: elastic_pendulum(3), dt=1e-3)),
    "reduced pendulum": Case(
        lambda: elastic_pendulum(2, 1), 0.5, "tip", (5e-3, 5e-4), finer(3, lambda: elastic_pendulum(3), dt=1e-3)
    ),
    "spin-up": Case(spun_up, 8.0, "tip", (5e-2, 5e-3), finer(3, dt=2e-3)),
    "clamped beam": Case(clamped_beam, 0.4, "tip", (1e-3, 1e-4), finer(4, dt=2.5e-4)),
    "rod": Case(swinging_rod, 0.6, "tip", (1e-2, 1e-3), EXACT_ROD),
    "geared chain, force": Case(geared_chain, 1.0, "pin force", (3.0, 0.3), finer(0, scheme=EXACT)),
    "beam in millimetres": Case(clamped_in_millimetres, 0.06, "tip", (1e-2, 1e-3), finer(3, dt=5e-5)),
    "rod, Radau": Case(
        lambda: swinging_rod(2), 0.6, "tip", (1e-2, 1e-3), EXACT_ROD, {"scheme": fmbd.Radau(3)}
    ),
    "bar in space": Case(twisted_bar, 0.3, "tip", (3e-3, 3e-4), finer(1, lambda: twisted_bar(2), dt=2.5e-3)),
    "line": Case(pushed_line, 1.0, "tip", (1e-2, 1e-3), finer(3, dt=1e-3)),
    "near-incompressible block": Case(squeezed_block, 0.2, "top", (2e-5, 4e-6), finer(3, dt=1e-3)),
    "tied bar": Case(tied_bar, 0.2, "end", (1e-2, 1e-3), finer(4, dt=5e-4)),
    "crank with FE rod": Case(lambda: fe_crank(2), 0.04, "side", (1e-6, 2e-7), finer(2, fe_crank, dt=1e-5)),
}  # fmt: skip


@dataclass(frozen=True)
class Kept:
    """A run with a tolerance: what it stated, what was true, what it cost against one plain run at the same resolution,
    and the CPU time of that (s).
    """

    name: str
    tol: float
    stated: float
    true: float
    attempts: int
    cost: float
    kinds: tuple[float, float, float]
    why: str
    plain: float

    @property
    def ok(self) -> bool:
        """Whether the tolerance is kept."""
        return not self.why and self.true <= self.tol

    def __str__(self) -> str:
        """A line of a table."""
        errors = f"stated {self.stated:8.1e} true {self.true:8.1e} their ratio {self.stated / self.true:6.2f}"
        parts = "space {:.1e} time {:.1e} modes {:.1e}".format(*self.kinds)
        end = "kept" if not self.why else f"not reached: {self.why}"
        return (
            f"{self.name:<28} {self.tol:8.1e} {errors} ({parts}) attempts {self.attempts} cost {self.cost:5.2f} {end}"
        )


def afresh(body: Any) -> Any:
    """A body that has computed nothing yet: its modes belong to the cost of a run."""
    return replace(body)


def check(name: str, tol: Any, reference: Any | None = None, cases: dict[str, Case] | None = None) -> Kept:
    """Solve a case with a tolerance and compare."""
    case = (cases or CASES)[name]
    times = np.linspace(0.0, case.t_end, TIMES)
    exact = case.reference(case, times) if reference is None else reference
    output = fmbd.Output(times=tuple(times), energy=False, progress=False)
    run = fmbd.solve(case.scene(), t_end=case.t_end, tol=case.tol(tol), output=output, **case.settings)
    true = float(np.abs(run[case.sensor] - exact).max())
    made = run.certificate[case.sensor]
    stated, kinds = made.total, (made.space or 0.0, made.time or 0.0, made.modes or 0.0)
    LAST[:] = [str(a) for a in run.history]
    why = "" if run.history[-1].then == "done" else run.history[-1].then
    cost, plain = costs(case, tol)
    limit = tol.share * float(np.ptp(exact, axis=0).max()) if isinstance(tol, type(fmbd.relative(0.5))) else tol
    return Kept(name, limit, stated, true, len(run.history), cost, kinds, why, plain)


def costs(case: Case, tol: float) -> tuple[float, float]:
    """CPU time of the call over that of one plain run with the steps and spaces at which it ended, and that of the plain run (s);
    the scene is there before. Of short runs the ratio is the median of five pairs, made in turn: the least of either is chance.
    """
    spent, run = _timed(case.scene(), case, tol=case.tol(tol), **case.settings)
    constant = getattr(run.scheme, "rtol", None) is None
    same = {"dt": run.dt if constant else None, "scheme": run.scheme}

    def plain() -> float:
        scene = with_bodies(run.scene, {n: afresh(b) for n, b in run.scene.bodies.items()})
        return _timed(scene, case, **same)[0]

    pairs = [(spent, plain())]
    for _ in range(AGAIN if pairs[0][1] < SHORT else 0):
        pairs.append((_timed(case.scene(), case, tol=case.tol(tol), **case.settings)[0], plain()))
    ratios = [called / alone for called, alone in pairs]
    return float(np.median(ratios)), min(alone for _, alone in pairs)


def _timed(scene: fmbd.Scene, case: Case, **settings: Any) -> tuple[float, fmbd.Run]:
    """CPU time (s) of a run, and the run."""
    begun = clock.process_time()
    run = fmbd.solve(scene, t_end=case.t_end, output=fmbd.Output(progress=False), **settings)
    return clock.process_time() - begun, run


if __name__ == "__main__":
    for name in [x for x in sys.argv[1:] if x != "-v"] or CASES:
        case = CASES[name]
        exact = case.reference(case, np.linspace(0.0, case.t_end, TIMES))
        for tol in case.tolerances:
            print(check(name, tol, exact), flush=True)
            if VERBOSE:
                print(*LAST, sep="\n", flush=True)
