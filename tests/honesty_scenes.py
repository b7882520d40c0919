"""Stated errors against true ones, each kind alone and all together, on scenes with exact or converged values.

True errors are largest differences over the run, at the ends of its steps: of time, to the same scene with an eighth of the
step; of space, to meshes finer by two levels or more with the same step; of modes, to the bodies before their reduction; of all,
to an exact solution or to all of this at once.

Run:  cd tests; ../with-dolfinx python3 honesty_scenes.py [name ...]        (the table of docs/accuracy.md)
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from tolerance_scenes import (
    MESHES,
    clamped_beam,
    elastic_pendulum,
    fe_crank,
    pushed_line,
    rise,
    spun_up,
    squeezed_block,
    swinging_rod,
    tied_bar,
)

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.materials import linear_elastic, neo_hookean, plane_stress
from fmbd_fenicsx.system.scene.refinement import meshed_bodies, modal_bodies, refined

LEAST, MOST = 0.5, 3.0
NEGLIGIBLE = 0.02  # share of the largest kind below which a kind is not judged: it is not seen beside the others


@dataclass(frozen=True)
class Honest:
    """A scene with its step; ``exact``: times -> values of the sensor, where they are known; ``whole``: without reduction."""

    scene: Callable[[], fmbd.Scene]
    t_end: float
    dt: float
    sensor: str
    exact: Callable[[Any], Any] | None = None
    whole: Callable[[], fmbd.Scene] | None = None
    meshes: int = 2  # levels that the references are finer by
    scheme: Any = None


# -- scenes ---------------------------------------------------------------------------------------------------------
def flying_wave() -> fmbd.Scene:
    """A bar of 1 m and unit wave speed in its first free vibration flies towards a wall, which it has not met yet."""
    mesh = fmbd.read_gmsh(MESHES / "block.py", size=(1.0, 0.1), counts=(8, 1), origin=(0.5, 0.0), quads=True)
    bar = fmbd.AbsoluteBody(
        "bar", mesh, degree=1, density=1.0, elastic=linear_elastic(1.0, 0.0), velocity=(-0.1, 0.0),
        displacement=lambda x: np.stack((0.01 * np.cos(np.pi * (x[0] - 0.5)), 0 * x[0])),
    )  # fmt: skip
    scene = fmbd.Scene("flying bar")
    scene.add(bar)
    scene.sensor("left", fmbd.position(bar.surface("left")))
    return scene


def flying_exact(t: Any) -> Any:
    """Flight and vibration."""
    return np.stack((0.5 - 0.1 * t + 0.01 * np.cos(np.pi * t), 0.05 + 0 * t), axis=1)


def bushed() -> fmbd.Scene:
    """A block of two tied pieces on a bushing, pushed smoothly at its end."""
    law, scene, pieces, up = plane_stress(1e6, 0.3), fmbd.Scene("bushed bar"), [], rise(0.2)
    for i, counts in enumerate(((3, 2), (3, 3))):
        mesh = fmbd.read_gmsh(MESHES / "block.py", size=(0.5, 0.2), counts=counts, origin=(0.5 * i, 0.0))
        pieces.append(
            fmbd.AbsoluteBody(f"piece {i}", mesh, degree=1, density=1000.0, elastic=law, stiffness_damping=2e-3)
        )
    left, right = pieces
    scene.add(left, right, fmbd.tie_surface("glue", right.surface("left"), left.surface("right")))
    bush = fmbd.forces.bushing(
        "bush", fmbd.ground, left.surface("left"), stiffness=[1e5, 1e5, 1e3], damping=[1e3, 1e3, 10.0]
    )
    scene.add(bush, fmbd.force("push", right.surface("right"), lambda t: (0.0, 50.0 * up(t))))
    scene.sensor("end", fmbd.position(right.surface("right")))
    return scene


def rotating_cantilever() -> fmbd.Scene:
    """A stiffened arm on a hub that turns steadily with 4 rad/s, its tip pushed across it."""
    section = fmbd.Section(EA=2.8e6, EI=1.4e3, rhoA=1.2, rhoI=6e-4, GA=1e6)
    arm = fmbd.Beam("arm", (0.0, 0.0), (4.0, 0.0), section, elements=2, stiffening=True)
    hub = fmbd.RigidBody("hub", mass=1.0, inertia=1.0, position=(0.0, 0.0))
    scene, up = fmbd.Scene("rotating cantilever"), rise(0.5)

    def motion(t: float) -> tuple[float, float, float]:
        # the speed rises within 1 s like the step that rise() makes, smoothly
        x = min(t, 1.0)
        turned = x**4 * (2.5 - 3.0 * x + x * x)
        rate, slope = x**3 * (10 - 15 * x + 6 * x * x), 30 * x * x * (1 - x) ** 2
        return 4.0 * (turned + max(t - 1.0, 0.0)), 4.0 * rate, 4.0 * slope

    scene.add(arm, hub, fmbd.revolute("axle", fmbd.ground, hub, center=(0, 0)))
    scene.add(fmbd.fixed("weld", hub, arm.surface("start")), fmbd.drive_rotation("motor", fmbd.ground, hub, motion))
    scene.add(fmbd.torque("twist", arm.surface("end"), lambda t: 20.0 * up(t)))
    scene.sensor("tip", fmbd.position(arm.surface("end")))
    return scene


def swinging_beam(
    sensor: Callable[[Any], Any], *, elements: int = 2, ramp: float = 0.3, EI: float = 20.0
) -> fmbd.Scene:
    """A beam on a pin falls from the horizontal, its weight switched on within ``ramp`` (s), or at once."""
    section = fmbd.Section(EA=1e5, EI=EI, rhoA=1.0, rhoI=1e-3, GA=4e4)
    beam = fmbd.Beam("beam", (0.0, 0.0), (1.0, 0.0), section, elements=elements)
    scene = fmbd.Scene("swinging beam", gravity=(0.0, -9.81), **({"gravity_ramp": ramp} if ramp else {}))
    scene.add(beam, fmbd.revolute("pin", fmbd.ground, beam.surface("start"), center=(0, 0)))
    scene.sensor("seen", sensor(beam.surface("end")))
    return scene


def pin_force(_end: Any) -> Any:
    """Sensor of the force in the joint "pin"."""
    return fmbd.reaction_force("pin")


def bent_block(load: Callable[[float], float], degree: int = 2) -> fmbd.Scene:
    """A rubber block on a wall, its free end pushed across."""
    mesh = fmbd.read_gmsh(MESHES / "block.py", size=(0.4, 0.1), counts=(4, 1), origin=(0.0, 0.0))
    block = fmbd.AbsoluteBody("block", mesh, degree=degree, density=1000.0, energy=neo_hookean(1e6, 0.3))
    scene, end = fmbd.Scene("bent block"), block.surface("right")
    scene.add(block, fmbd.fixed("wall", fmbd.ground, block.surface("left")))
    scene.add(fmbd.force("push", end, lambda t: (0.0, -20.0 * load(t))))
    scene.sensor("wall force", fmbd.reaction_force("wall"))
    scene.sensor("acceleration", fmbd.acceleration(end))
    return scene


def swinging_rod_shakes() -> fmbd.Scene:
    """The acceleration of the tip of the swinging rod."""
    scene = swinging_rod(2)
    scene.sensor("acceleration", fmbd.acceleration(scene.bodies["rod"].surface("end")))
    return scene


def strained(modes: int | None = None) -> fmbd.Scene:
    """The strain near the middle of the elastic pendulum."""
    scene = elastic_pendulum(2, modes)
    scene.sensor("strain", fmbd.sensors.strain(scene.bodies["rod"], point=(0.52, 0.02)))
    return scene


def falling_ball() -> fmbd.Scene:
    """A ball on a spring falls towards a floor, which it has not met yet: a scheme for impacts."""
    scene, ball = (
        fmbd.Scene("ball", gravity=(0.0, -9.81)),
        fmbd.RigidBody("ball", 1.0, 0.01, (0.0, 1.0), velocity=(1.0, 0.0)),
    )
    floor = fmbd.Obstacle("floor", fmbd.HalfSpace((0.0, 0.0), (0.0, 1.0)))
    spring = fmbd.Spring("spring", fmbd.ground, ball, (0, 2), stiffness=20.0, length=0.5)
    scene.add(ball, spring, fmbd.contact("touch", fmbd.ball(ball, 0.1), floor, restitution=0.5))
    scene.sensor("tension", fmbd.tension(spring))
    return scene


HONEST = {
    "flying bar": Honest(flying_wave, 1.5, 0.025, "left", flying_exact),
    "elastic pendulum": Honest(lambda: elastic_pendulum(2), 0.4, 0.4 / 80, "tip"),
    "reduced pendulum": Honest(lambda: elastic_pendulum(2, 1), 0.4, 0.4 / 80, "tip", whole=lambda: elastic_pendulum(2)),
    "spin-up": Honest(spun_up, 8.0, 0.08, "tip", meshes=3),
    "rotating cantilever": Honest(rotating_cantilever, 1.5, 0.015, "tip"),
    "clamped beam": Honest(clamped_beam, 0.4, 4e-3, "tip", meshes=3),
    "rod": Honest(lambda: swinging_rod(2), 0.6, 6e-3, "tip"),
    "line": Honest(pushed_line, 1.0, 0.01, "tip"),
    "tied bar": Honest(tied_bar, 0.2, 2e-3, "end"),
    "bushing and tie": Honest(bushed, 0.4, 4e-3, "end"),
    "near-incompressible block": Honest(squeezed_block, 0.2, 2e-3, "top"),
    "crank with FE rod": Honest(lambda: fe_crank(2), 0.04, 1e-4, "side", whole=fe_crank),
    "pin force of one beam element": Honest(lambda: swinging_beam(pin_force, elements=1), 0.8, 8e-3, "seen", meshes=3),
    "speed of a stiff beam, let go": Honest(
        lambda: swinging_beam(fmbd.velocity, ramp=0.0, EI=2e3), 0.8, 8e-3, "seen", meshes=3
    ),
    "tip of a soft beam, let go": Honest(lambda: swinging_beam(fmbd.position, ramp=0.0), 0.8, 8e-3, "seen", meshes=3),
    "acceleration of a rod": Honest(swinging_rod_shakes, 0.6, 6e-3, "acceleration"),
    "strain, reduced pendulum": Honest(lambda: strained(1), 0.4, 0.4 / 80, "strain", whole=strained),
    "wall force of a rubber block": Honest(lambda: bent_block(rise(0.1)), 0.2, 2e-3, "wall force"),
    "the same, a load with a kink": Honest(
        lambda: bent_block(lambda t: min(10.0 * t, 1.0)), 0.2, 2e-3, "wall force"
    ),
    "spring above the floor, Moreau": Honest(falling_ball, 0.3, 3e-3, "tension", scheme=fmbd.Moreau(), meshes=0),
}  # fmt: skip


# -- statements and truth -------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Found:
    """Stated and true errors of a scene by kind: space, time, modes, and "together"."""

    name: str
    stated: dict[str, float]
    true: dict[str, float]

    @property
    def ratios(self) -> dict[str, float]:
        """Stated over true, of the kinds that can be seen."""
        largest = max(self.true.values())
        return {k: self.stated[k] / x for k, x in self.true.items() if x > NEGLIGIBLE * largest}

    @property
    def ok(self) -> bool:
        """Whether every statement is honest."""
        return all(LEAST <= r <= MOST for r in self.ratios.values())

    def row(self) -> list[str]:
        """A line of the table."""
        cells = []
        for kind in ("space", "time", "modes", "together"):
            ratio = self.ratios.get(kind)
            seen = "" if kind not in self.true else "below the others" if ratio is None else f"{ratio:.2f}"
            cells.append(f"{seen} ({self.true[kind]:.1e})" if ratio is not None else seen)
        return [self.name, *cells]


def judge(name: str) -> Found:
    """Run a scene with all estimates, and its references."""
    case = HONEST[name]
    schemes = {} if case.scheme is None else {"scheme": case.scheme}

    def values(scene: fmbd.Scene, parts: int) -> Any:
        output = fmbd.Output(every=parts, energy=False, progress=False)
        return fmbd.solve(scene, t_end=case.t_end, dt=case.dt / parts, output=output, **schemes)[case.sensor]

    def finer(scene: fmbd.Scene) -> fmbd.Scene:
        for _ in range(case.meshes):
            scene = refined(scene)
        return scene

    scene = case.scene()
    asked = fmbd.Output(energy=False, progress=False, estimate_error=True, estimate_space=True, estimate_reduction=True)
    run = fmbd.solve(scene, t_end=case.t_end, dt=case.dt, output=asked, **schemes)
    made, x = run.certificate[case.sensor], run[case.sensor]
    stated, true = {"time": made.time or 0.0, "together": made.total}, {"time": values(case.scene(), 8)}
    if meshed_bodies(scene):
        stated["space"], true["space"] = made.space or 0.0, values(finer(case.scene()), 1)
    if modal_bodies(scene) and case.whole is not None:
        stated["modes"], true["modes"] = made.modes or 0.0, values(case.whole(), 1)
    whole = case.whole or case.scene
    true["together"] = values(finer(whole()), 8) if case.exact is None else case.exact(run.times)
    return Found(name, stated, {k: float(np.abs(x - y).max()) for k, y in true.items()})


if __name__ == "__main__":
    print("| scene | space | time | modes | together |")
    print("|---|---|---|---|---|")
    for name in sys.argv[1:] or HONEST:
        print("| " + " | ".join(judge(name).row()) + " |", flush=True)
