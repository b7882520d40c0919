"""Bodies with geometric stiffening in compiled steps: the digits, the iterations and the factors of NumPy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from test_compiled import pair
from test_kernel import agree, floating

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import ConvergenceError
from fmbd_fenicsx.materials import plane_stress
from fmbd_fenicsx.system.compiled.tables.bodies.fields import CondensedColumns, FieldTable

pytestmark = pytest.mark.compiled
SUDDEN = 1.000002, -4.55229e-4  # m, tip of a pressed rod, by 500 equal steps of generalized-alpha
FRAMES = {"mean axis": fmbd.MeanAxis(), "attached": fmbd.Attached("pin"), "chord": fmbd.Chord("pin", "tip")}


def no_more_work(fast: fmbd.Run, slow: fmbd.Run) -> None:
    """As many factors, and energies as close as the states."""
    assert fast.counters["factorisations"] == slow.counters["factorisations"]
    for name, series in fast.energy.items():
        assert np.allclose(series, slow.energy[name], rtol=1e-8, atol=1e-8), name


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("form", [fmbd.Index3(), fmbd.GGL()], ids=str)
def test_same_digits_as_numpy(rod_mesh: Callable[..., Any], dim: int, frame: str, form: Any) -> None:
    """A stiffened rod with others on its bent end: ports of second order, and new tangents within the march."""
    make = lambda: floating(rod_mesh(dim=dim, h=0.25), FRAMES[frame], stiffness_damping=1e-4, stiffening="pin")
    fast, slow = pair(make, form, t_end=0.015, dt=5e-4)
    assert fast.counters["compiled_steps"] >= 27
    agree(fast, slow)
    no_more_work(fast, slow)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("frame", FRAMES)
def test_same_digits_under_loads(
    rod_mesh: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, dim: int, frame: str
) -> None:
    """Dead loads, loads that turn with the body, and pressures, whose stress stiffens it: Python told all forces then."""
    told: list[int] = []
    monkeypatch.setattr(FieldTable, "forces", lambda self, t: told.append(self.number))
    wave = lambda t: 0.5 + np.sin(20.0 * t)
    along, across = (2e3, 1e3, 500.0)[:dim], (50.0, -10.0, 20.0)[:dim]
    loads = (
        fmbd.pressure("side", 1e3, time=wave),
        fmbd.loads.traction("tip", along, time=wave),
        fmbd.loads.traction("tip", along, follower=True),
        fmbd.body_force(across, time=wave),
    )
    make = lambda: floating(rod_mesh(dim=dim, h=0.25), FRAMES[frame], stiffening="pin", loads=loads)
    fast, slow = pair(make, t_end=0.005, dt=5e-4)
    assert fast.counters["compiled_steps"] >= 8
    assert not told
    agree(fast, slow, rates=1e-8)  # the motion has just begun
    no_more_work(fast, slow)


def test_above_the_first_frequency(rod_mesh: Callable[..., Any]) -> None:
    """A soft blade that is spun up, with a spring and a load on its end, whose stress stiffens it: no step is given back."""
    mesh = rod_mesh(dim=2, h=0.5, height=0.1)

    def make(load: bool) -> fmbd.Scene:
        loads = (fmbd.loads.traction("tip", (0.0, 100.0)),) if load else ()
        law = {"elastic": plane_stress(1e7, 0.3), "frame": fmbd.Attached("pin"), "loads": loads}
        blade = fmbd.FloatingBody("blade", mesh, density=1000.0, stiffening=True, angular_velocity=30.0, **law)
        blade = blade.with_(velocity=(0.0, 15.0))
        scene = fmbd.Scene("spin")
        pin = fmbd.revolute("pin", fmbd.ground, blade.surface("pin"), center=(0, 0))
        scene.add(blade, pin, fmbd.drive("motor", fmbd.angle(pin), lambda t: (30.0 * t + 50.0 * t**2,)))
        anchor = {"point_a": (1, 0.5), "point_b": (1, 0)}
        scene.add(fmbd.Spring("spring", blade.surface("tip"), fmbd.ground, stiffness=20.0, damping=0.1, **anchor))
        scene.sensor("tip", fmbd.position(blade.surface("tip")))
        return scene

    for load in (False, True):
        fast, slow = pair(lambda load=load: make(load), t_end=0.04, dt=1e-3)
        assert fast.counters["compiled_steps"] == 40
        assert np.abs(fast["tip"] - slow["tip"]).max() < 1e-9
        no_more_work(fast, slow)


@pytest.mark.parametrize("order", [3, 7])
def test_steps_of_many_sizes_under_a_sudden_pressure(
    rod_mesh: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, order: int
) -> None:
    """A start whose nodes fly apart where they are foretold: tangents are those of the body; tables go on with new ones."""
    made: list[int] = []
    begun = FieldTable.__init__
    monkeypatch.setattr(FieldTable, "__init__", lambda self, *given: (made.append(1), begun(self, *given))[1])
    law: dict[str, Any] = {"elastic": plane_stress(1e8, 0.3), "stiffening": "pin"}
    rod = fmbd.FloatingBody("rod", rod_mesh(), density=1000.0, loads=(fmbd.pressure("side", 1e3),), **law)
    scene = fmbd.Scene("pressed", gravity=(0.0, -9.81))
    scene.add(rod, fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0, 0)))
    scene.sensor("tip", fmbd.position(rod.surface("tip")))
    output = fmbd.Output(times=(0.0, 0.01), energy=False)
    run = fmbd.solve(scene, t_end=0.01, scheme=fmbd.Radau(order, rtol=1e-5), output=output)
    assert len(made) <= 6
    assert run.counters["factorisations"] < 30
    np.testing.assert_allclose(run["tip"][-1], SUDDEN, atol=2e-7)


def test_functions_of_loads_are_asked_once_a_step(rod_mesh: Callable[..., Any]) -> None:
    """For the force, its moment and its stress together."""

    def asked(steps: int) -> int:
        times: list[float] = []
        wave = lambda t: times.append(t) or np.sin(20.0 * t)  # type: ignore[func-returns-value]
        loads = (fmbd.pressure("side", 1e3, time=wave),)
        scene = floating(rod_mesh(h=0.25), FRAMES["attached"], stiffening="pin", loads=loads)
        fmbd.solve(scene, t_end=steps * 1e-3, dt=1e-3, output=fmbd.Output(times=(0.0, steps * 1e-3), energy=False))
        return len(times)

    assert asked(30) - asked(10) <= 24


def test_columns_that_give_way() -> None:
    """Of a body that is pressed beyond buckling compliances are negative; S is their inverse. Without numbers: refused."""
    rng = np.random.default_rng(0)
    Q, at = np.linalg.qr(rng.normal(size=(7, 7)))[0], np.array([0])
    W = (Q * [40.0, -80.0, 3.0, 0.2, -0.05, 0.04, 1.0]) @ Q.T
    assert W[1:3, 1:3].diagonal().min() < 0
    made = CondensedColumns(W, at, 3)
    compliance = W - np.outer(W[:, 0], W[0]) / W[0, 0]
    assert np.allclose(compliance @ made.S @ compliance, compliance, atol=1e-9) and made.indefinite

    W[4, 4] = np.nan
    with pytest.raises(ConvergenceError, match="not finite"):
        CondensedColumns(W, at, 3)
