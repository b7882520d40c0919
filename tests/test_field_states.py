"""States of systems with elastic fields by the driver: what NumPy says of them, for balance and constraints."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from test_driver import compiled

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.materials import linear_elastic, saint_venant_kirchhoff
from fmbd_fenicsx.system.compiled.choice import driver_states


def swinging(mesh: Any, frame: Any, load: bool = False) -> fmbd.Scene:
    """A damped rod on a driven pin, a bob and a spring at its other end, gravity that is switched on."""
    rod = fmbd.FloatingBody(
        "rod", mesh, density=1000.0, elastic=linear_elastic(5e6, 0.3), frame=frame, stiffness_damping=1e-3
    )
    d = rod.dim
    if load:
        rod.loads.append(fmbd.loads.Traction("tip", lambda t: (10.0 * t, 1.0, 0.0)[:d]))
    bob = fmbd.RigidBody("bob", 2.0, 0.1 if d == 2 else (0.1, 0.2, 0.3), (1.0, 0.1, 0.0)[:d])
    scene = fmbd.Scene("swinging", gravity=(0.0, -9.81, 0.0)[:d], gravity_ramp=1.0)
    axis = {} if d == 2 else {"axis": (0, 0, 1)}
    pin = fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0, 0, 0)[:d], **axis)
    scene.add(rod, bob, pin, fmbd.drive("drive", fmbd.angle(pin), lambda t: (t**3, 3 * t**2, 6 * t)))
    scene.add(fmbd.spherical("knee", rod.surface("tip"), bob, center=(1.0, 0.05, 0.0)[:d]))
    scene.add(fmbd.Spring("spring", fmbd.ground, rod.surface("tip"), (1, 1, 0)[:d], (1, 0, 0)[:d], stiffness=50.0))
    return scene


@compiled
@pytest.mark.parametrize("frame", [fmbd.MeanAxis(), fmbd.Attached("pin"), fmbd.Chord("pin", "tip")], ids=str)
@pytest.mark.parametrize("dim", [2, 3])
def test_equal_to_numpy(rod_mesh: Callable[..., Any], dim: int, frame: Any) -> None:
    system, start, _ = swinging(rod_mesh(dim=dim, h=0.5, height=0.2), frame).build()
    states = driver_states(system)
    assert states is not None and not states.solves

    rng = np.random.default_rng(3)
    q = system.compose(start.q, 1e-3 * rng.normal(size=system.n_v))
    v, a = rng.normal(size=(2, system.n_v))
    lam = rng.normal(size=system.n_lam)
    expected, told = system.at(0.3, q, v), states.at(0.3, q, v)
    for name in ("constraint", "opening", "constraint_rate", "gamma"):
        assert getattr(told, name)() == pytest.approx(getattr(expected, name)(), rel=1e-11, abs=1e-12), name
    for given in ((a, lam), (a, None)):
        wanted = expected.balance(*given)
        assert told.balance(*given) == pytest.approx(wanted, rel=1e-11, abs=1e-12 * np.abs(wanted).max())
    assert told.energies() == pytest.approx(expected.energies(), rel=1e-11)
    assert told.jacobian.times(v) == pytest.approx(expected.jacobian.times(v), rel=1e-12)


def test_left_to_numpy(rod_mesh: Callable[..., Any]) -> None:
    """Fields whose columns change with their tangent."""
    bent = fmbd.FloatingBody("rod", rod_mesh(h=0.5), density=1000.0, energy=saint_venant_kirchhoff(5e6, 0.3))
    scene = fmbd.Scene("alone")
    scene.add(bent)
    assert driver_states(scene.build()[0]) is None
