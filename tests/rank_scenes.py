"""Scenes whose figures must not depend on the number of ranks.

Run:  ./with-dolfinx mpirun -n 3 python3 tests/rank_scenes.py          prints one line of JSON (scene -> quantity -> numbers)
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import fmbd_fenicsx as fmbd

ROOT = Path(__file__).resolve().parents[1]
LAW = fmbd.materials.linear_elastic(1e4, 0.3)


def block(name: str, kind: Any, dim: int, *, cells: int = 3, degree: int = 1, low: float = 0.0) -> Any:
    """A block of edge 1 whose floor is at y = low."""
    mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", size=(1.0,) * dim, cells=cells, origin=(0.0, low, 0.0)[:dim])
    return kind(name, mesh, degree=degree, density=1.0, elastic=LAW)


def clamp() -> tuple[fmbd.Scene, list[str]]:
    """Weak Dirichlet data on a P2 block in space, shaken."""
    a = block("a", fmbd.AbsoluteBody, 3, cells=2, degree=2)
    scene = fmbd.Scene("clamp", gravity=(0, -9.81, 0))
    lift = lambda x: np.stack([0 * x[0], 1 + 0 * x[0], 0.2 * x[0]])  # noqa: E731
    scene.add(a, fmbd.tie_surface("floor", a.surface("bottom"), fmbd.ground, shape=lift, motion=lambda t: 0.1 * t**4))
    scene.sensor("top", fmbd.position(a.surface("top")))
    return scene, ["floor"]


def mortar() -> tuple[fmbd.Scene, list[str]]:
    """Two blocks in space with meshes that do not match, the lower one held at its floor."""
    a = block("a", fmbd.AbsoluteBody, 3, cells=3, low=1.0)
    b = block("b", fmbd.AbsoluteBody, 3, cells=2)
    scene = fmbd.Scene("mortar", gravity=(1.0, -9.81, 0))
    scene.add(a, b, fmbd.tie_surface("glue", a.surface("bottom"), b.surface("top")))
    scene.add(fmbd.tie_surface("floor", b.surface("bottom"), fmbd.ground))
    scene.sensor("top", fmbd.position(a.surface("top")))
    return scene, ["glue", "floor"]


def rigid_joint() -> tuple[fmbd.Scene, list[str]]:
    """A floating rod on a pin with a rigid body welded to its tip."""
    mesh = fmbd.read_gmsh(ROOT / "meshes/rod.py", dim=3, h=0.15, height=0.3)
    rod = fmbd.FloatingBody("rod", mesh, density=1000.0, elastic=fmbd.materials.linear_elastic(5e6, 0.3))
    bob = fmbd.RigidBody("bob", 20.0, (0.5, 0.4, 0.3), position=(1.2, 0.0, 0.0))
    scene = fmbd.Scene("rigid joint", gravity=(0, -9.81, 1.0), gravity_ramp=0.1)
    scene.add(rod, bob, fmbd.revolute("pin", rod.surface("pin"), fmbd.ground, center=(0, 0, 0)))
    scene.add(fmbd.fixed("weld", rod.surface("tip"), bob, center=(1, 0, 0)))
    scene.sensor("tip", fmbd.position(rod.surface("tip")))
    return scene, ["pin", "weld"]


def floating_and_absolute() -> tuple[fmbd.Scene, list[str]]:
    """A floating block glued on an absolute one, and a rigid plate glued on top: all kinds of sides in one scene."""
    a = block("a", fmbd.FloatingBody, 2, cells=4, degree=2, low=1.0)
    b = block("b", fmbd.AbsoluteBody, 2, cells=3, degree=2)
    plate = fmbd.RigidBody("plate", 0.5, 0.1, position=(0.5, 2.1))
    scene = fmbd.Scene("floating and absolute", gravity=(2.0, -9.81))
    scene.add(a, b, plate, fmbd.tie_surface("glue", a.surface("bottom"), b.surface("top")))
    scene.add(fmbd.tie_surface("lid", a.surface("top"), plate))
    scene.add(fmbd.revolute("pin", b.surface("bottom"), fmbd.ground, center=(0.5, 0.0)))
    scene.add(fmbd.Spring("stay", fmbd.ground, plate, stiffness=50.0, point_a=(1.5, 2.5), point_b=(0.5, 2.1)))
    scene.sensor("plate", fmbd.position(plate))
    return scene, ["glue", "lid", "pin"]


def few_cells() -> tuple[fmbd.Scene, list[str]]:
    """A block of two cells under one of 32: most ranks hold nothing of the lower one."""
    a = block("a", fmbd.AbsoluteBody, 2, cells=4, low=1.0)
    b = block("b", fmbd.AbsoluteBody, 2, cells=1, degree=2)
    scene = fmbd.Scene("few cells", gravity=(1.0, -9.81))
    scene.add(a, b, fmbd.tie_surface("glue", a.surface("bottom"), b.surface("top")))
    scene.add(fmbd.tie_surface("floor", b.surface("bottom"), fmbd.ground))
    scene.sensor("top", fmbd.position(a.surface("top")))
    return scene, ["glue", "floor"]


SCENES: dict[str, Callable[[], tuple[fmbd.Scene, list[str]]]] = {
    "clamp": clamp,
    "mortar": mortar,
    "rigid joint": rigid_joint,
    "floating and absolute": floating_and_absolute,
    "few cells": few_cells,
}


def figures() -> dict[str, dict[str, Any]]:
    """Series of the sensor and of the multipliers of every joint, energies, of all scenes; collective."""
    out = {}
    for name, make in SCENES.items():
        scene, joints = make()
        for joint in joints:
            scene.sensor(f"forces {joint}", fmbd.reaction(joint))
        run = fmbd.solve(scene, t_end=0.1, dt=5e-3, newton=fmbd.Newton(1e-10))
        series = {s: run[s] for s in scene.sensors}
        out[name] = {s: np.asarray(x).tolist() for s, x in {**series, "energy": run.energy["kinetic"]}.items()}
    return out


def largest_difference(a: dict[str, Any], b: dict[str, Any]) -> float:
    """Over the quantities of a scene, each relative to its largest value."""
    return max(float(np.abs(np.subtract(a[k], b[k])).max() / np.abs(a[k]).max()) for k in a)


if __name__ == "__main__":
    found = figures()
    if fmbd.log.world_rank() == 0:
        print(json.dumps(found))
    sys.stdout.flush()
