"""Springs, dampers and controls on surfaces of elastic bodies: Newton's iteration sees all of their stiffness."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.mechanics.forces import own_loads

STEPS = 5
ROOT = Path(__file__).resolve().parents[1]


def plane_rod(mesh: Any, kind: str) -> Any:
    """A rod of 1 m in the plane, 5e8 Pa."""
    how = {"density": 1000.0, "elastic": fmbd.materials.plane_stress(5e8, 0.3)}
    if kind == "absolute":
        energy = fmbd.materials.saint_venant_kirchhoff(5e8, 0.3)
        return fmbd.AbsoluteBody("rod", mesh, density=1000.0, energy=energy)
    rod = fmbd.FloatingBody("rod", mesh, **how)
    return rod.reduced(modes=8) if kind == "reduced" else rod


def moved(rod: Any, element: Callable[[Any, Any], Any], dt: float, **how: Any) -> Any:
    """A few steps of the rod on a pin with a force element."""
    scene = fmbd.Scene("rod", gravity=(0.0, -9.81))
    pin = fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0.0, 0.0))
    scene.add(rod, pin, element(rod, pin))
    scene.sensor("tip", fmbd.position(rod.surface("tip")))
    return fmbd.solve(scene, t_end=STEPS * dt, dt=dt, **how)


def tip_spring(rod: Any, k: float, c: float = 0.0) -> Any:
    """A spring from the ground, oblique to the rod's tip."""
    return fmbd.Spring(
        "element",
        fmbd.ground,
        rod.surface("tip"),
        point_a=(0.7, -1.0),
        length=math.hypot(1.0, 0.3),
        stiffness=k,
        damping=c,
    )


ELEMENTS = {
    "spring": lambda k: lambda rod, pin: tip_spring(rod, k),
    "damper": lambda k: lambda rod, pin: tip_spring(rod, 0.0, 1e-3 * k),
    "control": lambda k: lambda rod, pin: fmbd.joint_spring("element", fmbd.angle(pin), stiffness=k, damping=0.05 * k),
    "law": lambda k: (
        lambda rod, pin: fmbd.joint_spring("element", fmbd.angle(pin), law=lambda s, rate, t: k * s + k * s**3)
    ),
}


@pytest.mark.mpi
@pytest.mark.parametrize("kind", ["floating", "reduced", "absolute"])
@pytest.mark.parametrize("element", list(ELEMENTS))
def test_iterations_do_not_grow_with_stiffness(rod_mesh: Any, kind: str, element: str) -> None:
    """At most four iterations a step from 1e-3 to 1e12, and no step in parts."""
    for stiffness in (1e-3, 1e6, 1e9, 1e12):
        run = moved(plane_rod(rod_mesh(), kind), ELEMENTS[element](stiffness), 1e-3)
        each = run.counters["newton_iterations"] / run.counters["steps"]
        assert each <= 4.0, (stiffness, each)
        assert not run.counters.get("halved_steps", 0)


@pytest.mark.parametrize("modes", [0, 6], ids=["floating", "reduced"])
def test_springs_between_two_surfaces_of_one_body(modes: int) -> None:
    """Both ends move with the same rates: a stiff tie along a block keeps the iterations."""
    mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", size=(1.0, 0.1), origin=(0.0, -0.05), counts=(10, 2))
    block = fmbd.FloatingBody("block", mesh, degree=2, density=1e3, elastic=fmbd.materials.plane_stress(1e8, 0.3))
    rod = block.reduced(modes=modes) if modes else block
    left, right = rod.surface("left"), rod.surface("right")
    scene = fmbd.Scene("tied", gravity=(0.0, -9.81))
    scene.add(rod, fmbd.revolute("pin", fmbd.ground, left, center=(0.0, 0.0)))
    scene.add(fmbd.Spring("tie", left, right, length=1.0, stiffness=1e10))
    run = fmbd.solve(scene, t_end=0.02, dt=1e-3)
    assert run.counters["newton_iterations"] <= 4 * run.counters["steps"]


@pytest.mark.parametrize("kind", ["floating", "absolute"])
def test_spring_beyond_all_others_holds_as_a_link(rod_mesh: Any, kind: str) -> None:
    """A spring of 1e18 N/m lets the tip move on a circle, as a rigid link of its length."""
    run = moved(plane_rod(rod_mesh(), kind), lambda rod, pin: tip_spring(rod, 1e18), 1e-3)
    assert run.counters["newton_iterations"] <= 6 * STEPS
    assert not run.counters.get("halved_steps", 0)

    tip = run["tip"] - np.array([0.7, -1.0])
    assert np.abs(np.hypot(*tip.T) - math.hypot(1.0, 0.3)).max() < 1e-13
    assert np.abs(run["tip"][-1] - run["tip"][0]).max() > 1e-7


def test_tangent_of_a_law_without_symmetry(rod_mesh: Any) -> None:
    """A force across the displacement of a tip (a circulatory law) keeps the iterations of a symmetric one."""

    def across(t: float, tip: Any) -> tuple[Any, Any]:
        x, y = tip.x - np.array([1.0, 0.0])
        return np.array([-1e7 * y, 1e7 * x]) - 1e7 * np.array([x, y]), np.zeros(1)

    run = moved(
        plane_rod(rod_mesh(), "floating"),
        lambda rod, pin: fmbd.own_force("element", rod.surface("tip"), None, across),
        1e-3,
    )
    assert run.counters["newton_iterations"] <= 4 * STEPS


def test_own_laws_that_write_the_same_are_differentiated_once(monkeypatch: Any) -> None:
    """Of five, two of other numbers or markers: their tangents are those of each law alone, by three formulas."""

    def pulled(stiffness: float) -> Any:
        return lambda t, a, b: (stiffness * (a.x - b.x) * (1.0 + 0.1 * np.sin(a.x[0] * b.v[1])), -0.3 * b.w)

    def held(t: float, a: Any) -> Any:
        return -3.0 * a.x - a.v, 0.0

    made: list[int] = []
    program = own_loads.Program
    monkeypatch.setattr(own_loads, "Program", lambda *rows, **how: made.append(1) or program(*rows, **how))

    def slopes(laws: list[Any]) -> list[Any]:
        scene = fmbd.Scene("five")
        for k, law in enumerate(laws):
            body = fmbd.RigidBody(f"b{k}", 1.0, 0.1, position=(1.0 + k, 0.5), velocity=(0.2, 0.3 + k))
            scene.add(body)
            if law is not None:
                scene.add(fmbd.own_force(f"f{k}", *((body, None) if law is held else (fmbd.ground, body)), law=law))
        system, state, _ = scene.build()
        loads = next(x for x in system.forces if isinstance(x, own_loads.OwnLoads))
        found = loads.tangent(system.at(0.0, state.q, state.v).kin, 0.0)
        return list(zip(found.K, found.D, strict=True))

    laws = [pulled(10.0), pulled(10.0), held, pulled(7.0), pulled(10.0)]
    together = slopes(laws)
    assert len(made) == 3
    for k, found in enumerate(together):
        (alone,) = slopes([law if i == k else None for i, law in enumerate(laws)])
        assert all((x == y).all() for x, y in zip(found, alone, strict=True))


@pytest.mark.mpi
def test_two_bodies_in_space_under_one_spring(rod_mesh: Any) -> None:
    """A stiff spring between surfaces of two fields, and a tyre on one of them, direct and by iterations on multipliers."""
    ends = []
    for linear in (None, fmbd.Schur()):
        scene = fmbd.Scene("pair", gravity=(0.0, 0.0, -9.81))
        rods = []
        for name in ("a", "b"):
            elastic = fmbd.materials.linear_elastic(5e8, 0.3)
            rod = fmbd.FloatingBody(name, rod_mesh(dim=3, h=0.1), density=1000.0, elastic=elastic)
            scene.add(rod, fmbd.fixed(f"clamp {name}", fmbd.ground, rod.surface("pin")))
            rods.append(rod)
        tip_a, tip_b = rods[0].surface("tip"), rods[1].surface("tip")
        scene.add(fmbd.Spring("spring", tip_a, tip_b, point_b=(1.0, 0.3, 0.4), length=0.5, stiffness=1e8))
        constants = {"radius": 0.3, "stiffness": 1e7, "damping": 1e3, "up": (0.0, 0.0, 1.0)}
        scene.add(fmbd.Tyre("tyre", tip_a, road=lambda x, t: -0.5 + 0.2 * x[0], **constants))
        scene.sensor("tip", fmbd.position(rods[0].surface("tip")))
        run = fmbd.solve(scene, t_end=STEPS * 1e-3, dt=1e-3, linear=linear, newton=fmbd.Newton(tolerance=1e-9))
        assert run.counters["newton_iterations"] <= 5 * STEPS
        ends.append(run["tip"])
    assert np.abs(ends[0] - ends[1]).max() < 1e-12


def test_around_a_solver_of_the_whole_matrix(rod_mesh: Any) -> None:
    """A stiff spring under FieldSplit, which knows nothing of it: the same motion."""
    ends = []
    for linear in (None, fmbd.FieldSplit(method="fgmres")):
        run = moved(plane_rod(rod_mesh(), "floating"), lambda rod, pin: tip_spring(rod, 1e7), 1e-3, linear=linear)
        assert run.counters["newton_iterations"] <= 5 * STEPS
        ends.append(run["tip"])
    assert np.abs(ends[0] - ends[1]).max() < 1e-9
