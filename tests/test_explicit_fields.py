"""RATTLE and explicit Runge-Kutta methods on elastic fields: many steps in a call, by the masses of one component."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.materials import linear_elastic, nearly_incompressible, saint_venant_kirchhoff
from fmbd_fenicsx.schemes.marching import MarchingStepper
from fmbd_fenicsx.system.compiled import choice
from fmbd_fenicsx.system.compiled.march import March
from fmbd_fenicsx.system.compiled.tables.bodies.fields import FieldTable

CONSTANT = (fmbd.Rattle(), fmbd.HalfExplicit(rtol=None), fmbd.ExplicitRungeKutta(rtol=None))
OWN = (fmbd.HalfExplicit(rtol=1e-4), fmbd.ExplicitRungeKutta(rtol=1e-5))
YOUNG = 1e5
BODIES: dict[str, Callable[[Any], Any]] = {
    "floating": lambda mesh: fmbd.FloatingBody(
        "rod", mesh, density=1000.0, elastic=linear_elastic(YOUNG, 0.3), stiffness_damping=1e-4
    ),
    "absolute": lambda mesh: fmbd.AbsoluteBody("rod", mesh, density=1000.0, elastic=linear_elastic(YOUNG, 0.3)),
    "large strain": lambda mesh: fmbd.AbsoluteBody(
        "rod", mesh, density=1000.0, energy=saint_venant_kirchhoff(YOUNG, 0.3), quadrature=4
    ),
    "pressure": lambda mesh: fmbd.FloatingBody(
        "rod", mesh, density=1000.0, elastic=nearly_incompressible(YOUNG, 0.45), mass_damping=2.0
    ),
}


def hung(mesh: Any, body: str, *, hinges: int = 1) -> fmbd.Scene:
    """A soft rod in a hinge, or several in one place, with a bob at its tip."""
    rod = BODIES[body](mesh)
    dim = rod.dim
    scene = fmbd.Scene(body, gravity=(1.0, -9.81, 0.5)[:dim])
    axis = {} if dim == 2 else {"axis": (0, 0, 1)}
    bob = fmbd.RigidBody("bob", 2.0, 0.1 if dim == 2 else (0.1, 0.2, 0.3), (1.0, 0.1, 0.0)[:dim])
    scene.add(rod, bob, fmbd.spherical("knee", rod.surface("tip"), bob, center=(1.0, 0.0, 0.0)[:dim]))
    for number in range(hinges):
        scene.add(fmbd.revolute(f"pin {number}", fmbd.ground, rod.surface("pin"), center=(0, 0, 0)[:dim], **axis))
    scene.sensor("tip", fmbd.position(rod.surface("tip")))
    return scene


CASES = [
    *[("floating", 2, scheme) for scheme in (*CONSTANT, *OWN)],
    *[("floating", 3, scheme) for scheme in CONSTANT],
    *[("large strain", 2, scheme) for scheme in (*CONSTANT, OWN[0])],
    ("absolute", 3, CONSTANT[0]),
    ("absolute", 2, OWN[1]),
    ("pressure", 2, CONSTANT[1]),
]


@pytest.mark.compiled
@pytest.mark.parametrize(("body", "dim", "scheme"), CASES, ids=lambda x: getattr(x, "name", str(x)))
def test_steps_are_calls_of_compiled_code(
    rod_mesh: Callable[..., Any], body: str, dim: int, scheme: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """None is made by Python but the first of own choice, which solves for no field; their states are those of NumPy, of the same
    sizes.
    """
    scene = hung(rod_mesh(dim=dim, h=0.5, height=0.2), body)
    sizes: dict[str, Any] = {"t_end": 0.05} if getattr(scheme, "rtol", None) else {"t_end": 0.005, "dt": 2e-4}
    made: list[int] = []
    solved: list[Any] = []
    monkeypatch.setattr(FieldTable, "solve", solved.append)
    steps = March.steps
    monkeypatch.setattr(March, "steps", lambda *x, **y: (found := steps(*x, **y), made.append(found[0]))[0])

    def run() -> fmbd.Run:
        output = fmbd.Output(times=np.linspace(0.0, sizes["t_end"], 7), progress=False)
        return fmbd.solve(scene, scheme=scheme, output=output, newton=fmbd.Newton(1e-11), **sizes)

    fast = run()
    assert sum(made) >= fast.counters["steps"] - 1 and not solved
    monkeypatch.setattr(choice, "driver_library", lambda *_: None)
    made.clear()
    slow = run()
    assert not made and fast.counters["steps"] == slow.counters["steps"]
    assert fast["tip"] == pytest.approx(slow["tip"], rel=0, abs=1e-9)
    for name, share in {"q": 1e-9, "v": 1e-8, "a": 1e-7, "lam": 1e-7}.items():
        wanted = getattr(slow.state, name)
        assert getattr(fast.state, name) == pytest.approx(wanted, rel=0, abs=share * np.abs(wanted).max()), name


@pytest.mark.compiled
@pytest.mark.parametrize("scheme", CONSTANT, ids=lambda scheme: scheme.name)
def test_rows_that_depend_on_bodies_whose_weight_is_on_nodes(
    rod_mesh: Callable[..., Any], scheme: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether they contradict each other is judged beside what acts on the nodes, of bodies that have no frame."""
    refused: list[float] = []
    monkeypatch.setattr(MarchingStepper, "_refuse", lambda self, h: refused.append(h))
    rod = BODIES["absolute"](rod_mesh(h=0.5, height=0.2))
    scene = fmbd.Scene("alone", gravity=(0.0, -9.81), gravity_ramp=0.1)
    scene.add(rod, *(fmbd.revolute(f"pin {i}", fmbd.ground, rod.surface("pin"), center=(0, 0)) for i in range(2)))
    run = fmbd.solve(scene, t_end=0.005, dt=1e-4, scheme=scheme)
    assert not refused and run.counters["steps"] == 50
