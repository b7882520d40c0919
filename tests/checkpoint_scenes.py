"""Scenes whose runs are taken up from checkpoints, each with everything that a scheme or a body may remember.

Run:  ./with-dolfinx mpirun -n 2 python3 tests/checkpoint_scenes.py FOLDER [from]
      writes a checkpoint of each scene's run into FOLDER half-way, or takes it up "from" there; prints one line of JSON
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.materials import (
    linear_elastic,
    neo_hookean_incompressible,
    plane_stress,
    sheet_saint_venant_kirchhoff,
)

ROOT = Path(__file__).resolve().parents[1]
Case = tuple[fmbd.Scene, dict[str, Any]]
COMM: Any = None  # of all meshes, COMM_WORLD by default


def mesh(name: str, **sizes: Any) -> Any:
    """A mesh of the folder meshes/."""
    return fmbd.read_gmsh(ROOT / f"meshes/{name}.py", comm=COMM, **sizes)


def rod(dim: int = 2, h: float = 0.2, height: float = 0.1) -> Any:
    """The rod of meshes/rod.py, 1 m long."""
    return mesh("rod", dim=dim, h=h, height=height)


def links() -> Case:
    """Two rods in space, joints only: what the compiled step takes."""
    scene = fmbd.Scene("links", gravity=(0, -9.81, 0))
    a = fmbd.RigidBody("a", 1.0, (0.01, 0.08, 0.08), position=(0.5, 0.0, 0.0))
    b = fmbd.RigidBody("b", 2.0, (0.02, 0.09, 0.09), position=(1.5, 0.0, 0.0))
    scene.add(a, b, fmbd.revolute("pin", fmbd.ground, a, center=(0, 0, 0), axis=(0, 0, 1)))
    scene.add(fmbd.spherical("ball", a, b, center=(1, 0, 0)))
    scene.sensor("tip", fmbd.position(b))
    scene.sensor("force", fmbd.reaction("ball"))
    return scene, {"t_end": 0.08, "dt": 0.01}


def wheel() -> Case:
    """The links and a fast wheel on a coil spring: its revolutions are counted."""
    scene, arguments = links()
    disk = fmbd.RigidBody("disk", 1.0, (0.1, 0.1, 0.2), position=(0, 2, 0), angular_velocity=(0, 0, 150.0))
    axle = fmbd.revolute("axle", fmbd.ground, disk, center=(0, 2, 0), axis=(0, 0, 1))
    scene.add(disk, axle, fmbd.joint_spring("coil", fmbd.angle(axle), stiffness=3.0, damping=0.01))
    scene.sensor("turn", fmbd.angle(axle))
    return scene, arguments


def floating() -> Case:
    """A floating rod on a pin with a rigid body at its tip."""
    body = fmbd.FloatingBody("rod", rod(), density=1000.0, elastic=linear_elastic(5e6, 0.3))
    bob = fmbd.RigidBody("bob", 20.0, 0.5, position=(1.2, 0.0))
    scene = fmbd.Scene("floating", gravity=(0, -9.81))
    scene.add(body, bob, fmbd.revolute("pin", body.surface("pin"), fmbd.ground, center=(0, 0)))
    scene.add(fmbd.fixed("weld", body.surface("tip"), bob, center=(1, 0)))
    scene.sensor("tip", fmbd.position(body.surface("tip")))
    return scene, {"t_end": 0.04, "dt": 0.005}


def past() -> Case:
    """The same by BDF, which remembers states of the field."""
    scene, arguments = floating()
    return scene, {**arguments, "scheme": fmbd.BDF(2, rtol=None)}


def space() -> Case:
    """A floating rod in space, of degree 3 with its two nodes on each edge."""
    body = fmbd.FloatingBody("rod", rod(3, 0.5, 0.4), degree=3, density=1000.0, elastic=linear_elastic(5e6, 0.3))
    scene = fmbd.Scene("space", gravity=(0, -9.81, 3.0))
    scene.add(body, fmbd.spherical("ball", body.surface("pin"), fmbd.ground, center=(0, 0, 0)))
    scene.sensor("tip", fmbd.position(body.surface("tip")))
    return scene, {"t_end": 0.02, "dt": 0.005}


def blade(*, modes: int = 0) -> Case:
    """A blade in fast rotation, stiffened by its inertia forces: new tangents with loads; by its ``modes`` with the stress of the
    last evaluation.
    """
    body: Any = fmbd.FloatingBody(
        "blade", rod(h=0.1, height=0.04), density=1000.0, elastic=plane_stress(1e8, 0.3), frame=fmbd.Attached("pin"),
        stiffening=True,
    )  # fmt: skip
    body = body.reduced(modes=modes) if modes else body
    scene = fmbd.Scene("blade", gravity=(0, -9.81))
    scene.add(body, fmbd.revolute("pin", body.surface("pin"), fmbd.ground, center=(0, 0)))
    scene.sensor("tip", fmbd.position(body.surface("tip")))
    return scene, {"t_end": 0.08, "dt": 0.01}


def soft() -> Case:
    """A soft rod that falls about a pin: tangents frozen on the way."""
    body = fmbd.AbsoluteBody("rod", rod(), density=1000.0, energy=sheet_saint_venant_kirchhoff(1e5, 0.3))
    scene = fmbd.Scene("soft", gravity=(0, -9.81))
    scene.add(body, fmbd.fixed("wall", body.surface("pin"), fmbd.ground))
    scene.sensor("tip", fmbd.position(body.surface("tip")))
    return scene, {"t_end": 0.12, "dt": 0.015, "scheme": fmbd.GeneralizedAlpha(0.6)}


def rubber() -> Case:
    """An incompressible rod: its pressure is an unknown."""
    body = fmbd.AbsoluteBody("rod", rod(), density=1000.0, energy=neo_hookean_incompressible(1e5))
    scene = fmbd.Scene("rubber", gravity=(0, -9.81))
    scene.add(body, fmbd.revolute("pin", body.surface("pin"), fmbd.ground))
    scene.sensor("tip", fmbd.position(body.surface("tip")))
    return scene, {"t_end": 0.2, "dt": 0.025, "scheme": fmbd.GeneralizedAlpha(0.6)}


def glued() -> Case:
    """Two blocks with meshes that do not match, a multiplier field between them and one on the floor."""
    low, high = (
        fmbd.AbsoluteBody(
            name,
            mesh("block", size=(1.0, 1.0), cells=n, origin=(0.0, y)),
            density=1.0,
            elastic=linear_elastic(1e4, 0.3),
        )
        for name, n, y in (("low", 2, 0.0), ("high", 3, 1.0))
    )
    scene = fmbd.Scene("glued", gravity=(1.0, -9.81))
    scene.add(low, high, fmbd.tie_surface("glue", high.surface("bottom"), low.surface("top")))
    scene.add(fmbd.tie_surface("floor", low.surface("bottom"), fmbd.ground))
    scene.sensor("top", fmbd.position(high.surface("top")))
    scene.sensor("traction", fmbd.reaction("glue"))
    return scene, {"t_end": 0.04, "dt": 0.005}


def conserving() -> Case:
    """A rubber-like rod by the energy-momentum scheme."""
    body = fmbd.AbsoluteBody(
        "rod", rod(), density=1000.0, energy=sheet_saint_venant_kirchhoff(1e5, 0.3), angular_velocity=2.0
    )
    scene = fmbd.Scene("conserving", gravity=(0, -9.81))
    scene.add(body, fmbd.revolute("pin", fmbd.ground, body.surface("pin"), center=(0, 0)))
    scene.sensor("tip", fmbd.position(body.surface("tip")))
    return scene, {"t_end": 0.012, "dt": 0.002, "scheme": fmbd.EnergyMomentum()}


def impact(scheme: Any) -> Case:
    """A block that hits the floor obliquely, with friction."""
    body = fmbd.AbsoluteBody(
        "block", mesh("block", size=(1.0, 0.5), cells=4), degree=1, density=2.0, elastic=linear_elastic(50.0, 0.2),
        velocity=(0.3, -0.5),
    )  # fmt: skip
    floor = fmbd.Obstacle("floor", fmbd.HalfSpace((0, -0.02), (0, 1)))
    pair = fmbd.contact("floor", body.surface("bottom"), floor, friction=0.2)
    scene = fmbd.Scene("impact", gravity=(0, -1.0))
    scene.add(body, pair)
    scene.sensor("force", fmbd.contact_force(pair))
    scene.sensor("pressure", fmbd.contact_pressure(pair))
    scene.sensor("work", fmbd.contact_work())
    return scene, {"t_end": 0.16, "dt": 0.02, "scheme": scheme}


def blocks() -> Case:
    """Two elastic blocks pressed together, mortar contact."""
    low, high = (
        fmbd.AbsoluteBody(
            name, mesh("block", size=(1.0, 0.5), cells=n, origin=(0.0, y)), degree=1, density=1.0,
            elastic=linear_elastic(1000.0, 0.3),
        )
        for name, n, y in (("low", 3, 0.0), ("high", 4, 0.5))
    )  # fmt: skip
    pair = fmbd.contact("pair", high.surface("bottom"), low.surface("top"))
    scene = fmbd.Scene("blocks")
    scene.add(low, high, pair, fmbd.force("press", high.surface("top"), lambda t: (0.0, -10.0)))
    scene.add(fmbd.fixed("base", fmbd.ground, low.surface("bottom")))
    scene.add(fmbd.prismatic("guide", fmbd.ground, high.surface("top"), axis=(0, 1)))
    scene.sensor("force", fmbd.contact_force(pair))
    return scene, {"t_end": 0.08, "dt": 0.01}


def bouncing() -> Case:
    """A rigid plate that falls on its corners, with restitution and friction."""
    body = fmbd.RigidBody("plate", 1.0, 0.0842, position=(0, 0.1), velocity=(0.5, -1.0), angular_velocity=0.3)
    feet = fmbd.corners(body, [(x, -0.05) for x in (-0.5, 0.5)])
    floor = fmbd.Obstacle("floor", fmbd.HalfSpace((0, 0), (0, 1)))
    pair = fmbd.contact("floor", feet, floor, friction=0.3, restitution=0.4)
    scene = fmbd.Scene("bouncing", gravity=(0, -9.81))
    scene.add(body, pair)
    scene.sensor("force", fmbd.contact_force(pair))
    scene.sensor("impulse", fmbd.contact_impulse(pair))
    return scene, {"t_end": 0.2, "dt": 0.02, "scheme": fmbd.Moreau()}


def sliding() -> Case:
    """A pan head that leaves a wire and returns."""
    wires = fmbd.Wires("w", 20.0, 40, (fmbd.Wire(1.0, 1e4),))
    pan = fmbd.CoordinateBody(
        "pan", np.diag([2.0, 1.0]), lambda q, v, t: np.array([50.0 - 4000.0 * (0.01 < t < 0.02), 0.0]), np.zeros(2)
    )
    scene = fmbd.Scene("sliding", settle=True)
    scene.add(wires, pan, fmbd.SlidingContact("c", wires, pan, start=10.0, idle=1))
    scene.sensor("force", fmbd.reaction("c"))
    scene.sensor("y", fmbd.coordinates(pan))
    return scene, {"t_end": 0.08, "dt": 0.005, "scheme": fmbd.Unilateral(fmbd.GeneralizedAlpha(0.6))}


SCENES: dict[str, Callable[[], Case]] = {
    "links": links,
    "wheel": wheel,
    "floating": floating,
    "past": past,
    "space": space,
    "blade": blade,
    "modes": lambda: blade(modes=3),
    "soft": soft,
    "rubber": rubber,
    "glued": glued,
    "conserving": conserving,
    "impact, midpoint": lambda: impact(fmbd.ContactMidpoint()),
    "impact, alpha": lambda: impact(fmbd.ContactAlpha(0.8)),
    "blocks": blocks,
    "bouncing": bouncing,
    "sliding": sliding,
}


def figures(folder: Path, taken_up: bool) -> dict[str, dict[str, Any]]:
    """Series and energies of all scenes, whole or taken up half-way; collective."""
    out = {}
    for name, make in SCENES.items():
        scene, arguments = make()
        steps = round(arguments["t_end"] / arguments["dt"])
        here = folder / name
        if taken_up:
            half = next(here.glob(f"*_step{steps // 2}"))
            run = fmbd.solve(scene, **arguments, restart=half)
        else:
            plan = fmbd.Checkpoint(here, every=max(steps // 2, 1))
            run = fmbd.solve(scene, **arguments, checkpoint=plan)
        out[name] = {s: run[s].tolist() for s in scene.sensors if s != "pressure"}  # in the order of the candidates
        out[name]["kinetic energy"] = run.energy["kinetic"].tolist()
    return out


if __name__ == "__main__":
    found = figures(Path(sys.argv[1]), len(sys.argv) > 2)
    fmbd.say(json.dumps(found))
