"""Generalized-alpha: order two in positions, velocities and multipliers from the first step on, energy,
damping, refusals.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import dae_problems
import numpy as np
import pytest
from motion import elastic_rod
from scipy.integrate import solve_ivp

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import ConvergenceError, InputError

RHOS = [0.9, 0.8, 0.5, 0.0]
TIGHT = fmbd.Newton(tolerance=1e-9)


def swinging(dim: int) -> fmbd.Scene:
    """A rigid pendulum that starts with speed, so that its reactions change from the first step on."""
    if dim == 2:
        angle, w = 1.0, 1.0
        c = np.array([np.sin(angle), -np.cos(angle)])
        turn: Any = angle
        body = fmbd.RigidBody("bob", 1.0, 0.1, c, turn, w * np.array([-c[1], c[0]]), w)
        joint = fmbd.revolute("pin", body, fmbd.ground, center=(0, 0))
    else:
        c, omega = np.array([0.3, 0.2, -0.9]), np.array([1.0, -2.0, 3.0])
        body = fmbd.RigidBody("bob", 1.0, (0.1, 0.2, 0.25), c, None, np.cross(omega, c), omega)
        joint = fmbd.spherical("pin", body, fmbd.ground, center=(0, 0, 0))
    scene = fmbd.Scene("swing", gravity=(0, -9.81) if dim == 2 else (0, 0, -9.81))
    scene.add(body, joint)
    scene.sensor("x", fmbd.position(body))
    scene.sensor("v", fmbd.velocity(body))
    scene.sensor("lambda", fmbd.reaction("pin"))
    return scene


def elastic(mesh: Any, frame: Any = fmbd.MeanAxis()) -> fmbd.Scene:  # noqa: B008
    """An elastic pendulum from rest; gravity comes on smoothly over the whole run."""
    d = mesh.dim
    rod = elastic_rod(mesh, degree=1, elastic=fmbd.materials.linear_elastic(1e7, 0.3), frame=frame)
    scene = fmbd.Scene("soft", gravity=(0, -9.81, 3.0)[:d], gravity_ramp=0.4)
    joint = fmbd.revolute if d == 2 else fmbd.spherical
    scene.add(rod, joint("pin", rod.surface("pin"), fmbd.ground, center=(0, 0, 0)[:d]))
    scene.sensor("x", fmbd.position(rod.surface("tip")))
    scene.sensor("v", fmbd.velocity(rod.surface("tip")))
    scene.sensor("lambda", fmbd.reaction("pin"))
    return scene


def march(scene: fmbd.Scene, h: float, t_end: float, rho: float) -> fmbd.Run:
    """One run with tight Newton."""
    return fmbd.solve(scene, t_end=t_end, dt=h, scheme=fmbd.GeneralizedAlpha(rho), newton=TIGHT)


def orders(runs: list[fmbd.Run], reference: fmbd.Run, sensor: str) -> tuple[np.ndarray, np.ndarray]:
    """Largest errors over the whole interval, and the orders between successive runs."""
    errors = []
    for run in runs:
        stride = round(run.dt / reference.dt)
        errors.append(float(np.abs(run[sensor] - reference[sensor][::stride]).max()))
    e = np.array(errors)
    return e, np.log2(e[:-1] / e[1:])


@pytest.fixture(scope="module")
def references() -> dict[int, fmbd.Run]:
    """Fine runs of the rigid pendulums."""
    return {d: march(swinging(d), 0.02 / 64, 0.48, 0.6) for d in (2, 3)}


@pytest.mark.parametrize("rho", RHOS)
@pytest.mark.parametrize("dim", [2, 3])
def test_second_order_of_a_rigid_pendulum(dim: int, rho: float, references: dict[int, fmbd.Run]) -> None:
    runs = [march(swinging(dim), 0.02 / 2**k, 0.48, rho) for k in range(4)]
    for sensor in ("x", "v", "lambda"):
        errors, order = orders(runs, references[dim], sensor)
        assert order[-1] > 1.9, f"{sensor}: errors {errors}, orders {order}"
        assert order.min() > 1.65, f"{sensor}: errors {errors}, orders {order}"


@pytest.mark.parametrize("rho", RHOS)
def test_energy_error_is_of_second_order(rho: float) -> None:
    """No load, no damping: what is lost or gained comes from the scheme."""
    errors = []
    for k in range(3):
        E = sum(march(swinging(2), 0.02 / 2**k, 0.48, rho).energy.values())
        errors.append(float(np.abs(E - E[0]).max()))
    assert np.log2(errors[-2] / errors[-1]) > 1.9, errors


FRAMES = {"mean axis": fmbd.MeanAxis(), "attached": fmbd.Attached("pin")}


@pytest.fixture(scope="module")
def soft(rod_mesh: Callable[..., Any]) -> dict[str, tuple[fmbd.Scene, fmbd.Run]]:
    """Elastic pendulums with a fine run each."""
    scenes = {n: elastic(rod_mesh(dim=2, h=0.25, height=0.2), f) for n, f in FRAMES.items()}
    return {n: (s, march(s, 0.005 / 32, 0.4, 0.6)) for n, s in scenes.items()}


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("rho", RHOS)
def test_second_order_of_an_elastic_pendulum(rho: float, frame: str, soft: dict[str, Any]) -> None:
    scene, reference = soft[frame]
    runs = [march(scene, 0.005 / 2**k, 0.4, rho) for k in range(3)]
    for sensor in ("x", "v", "lambda"):
        errors, order = orders(runs, reference, sensor)
        assert order[-1] > 1.9, f"{sensor}: errors {errors}, orders {order}"
    final = [sum(e[-1] for e in r.energy.values()) for r in (*runs, reference)]
    error = np.abs(np.array(final[:3]) - final[3])
    assert np.log2(error[1] / error[2]) > 1.9


@pytest.mark.slow
@pytest.mark.parametrize("rho", [0.8, 0.0])
def test_second_order_of_an_elastic_pendulum_in_space(rho: float, rod_mesh: Callable[..., Any]) -> None:
    scene = elastic(rod_mesh(dim=3, h=0.5, height=0.3))
    runs = [march(scene, 0.005 / 2**k, 0.4, rho) for k in range(3)]
    reference = march(scene, 0.005 / 32, 0.4, 0.6)
    for sensor in ("x", "v", "lambda"):
        errors, order = orders(runs, reference, sensor)
        assert order[-1] > 1.9, f"{sensor}: errors {errors}, orders {order}"


@pytest.mark.parametrize("rho", [1.0, 1.2, -0.1, np.nan, np.inf])
def test_unusable_rho_is_refused(rho: float) -> None:
    with pytest.raises(InputError, match=r"\[0, 1\)|finite number"):
        fmbd.GeneralizedAlpha(rho)


def test_refusal_of_no_damping_says_why() -> None:
    with pytest.raises(InputError, match="multipliers.*unstable"):
        fmbd.GeneralizedAlpha(rho_inf=1.0)


def test_failed_newton_names_scene_step_and_time() -> None:
    """Too few iterations: the error tells where, and the history of the iteration."""
    with pytest.raises(ConvergenceError, match=r'"swing", step 1 of 10: Newton stopped at t = 0.01 .*dt'):
        fmbd.solve(swinging(2), t_end=0.1, dt=0.01, newton=fmbd.Newton(tolerance=1e-12, max_iterations=1))


def test_increments_are_turned_into_local_coordinates() -> None:
    """With T^-1 a pinned body that turns half a radian a step takes 6.6 iterations, without it 7.8."""
    body = fmbd.RigidBody("top", 1.0, (0.1, 0.1, 0.1), angular_velocity=(20.0, -15.0, 10.0))
    scene = fmbd.Scene("top", gravity=(0, 0, -9.81))
    scene.add(body, fmbd.spherical("tip", body, fmbd.ground, center=(0, 0, 0.5)))
    run = fmbd.solve(scene, t_end=0.4, dt=0.02, newton=fmbd.Newton(1e-10, 60))
    assert run.counters["newton_iterations"] / run.counters["steps"] < 7.2


def test_newton_count_does_not_depend_on_the_step() -> None:
    """A step of 1e-8 takes no more iterations than h = 1e-2."""
    counts = []
    for h in (1e-2, 1e-4, 1e-6, 1e-8):
        run = fmbd.solve(swinging(3), t_end=5 * h, dt=h)
        counts.append(run.counters["newton_iterations"])
    assert max(counts) <= counts[0]


@pytest.mark.parametrize("rho", [1.0, 0.8, 0.0])
def test_stabilised_form_is_second_order_from_the_first_step(rho: float) -> None:
    """Of q, v and lambda over the whole interval, the first step included."""
    scheme = fmbd.GeneralizedAlpha(rho, form=fmbd.GGL())
    errors = []
    for n in (40, 80, 160):
        states = dae_problems.march(dae_problems.pendulum(), scheme, 1.0, n)[1:]
        exact = [dae_problems.pendulum_at(round(s.t, 12)) for s in states]
        errors.append([
            max(np.abs(s.q - e[0]).max() for s, e in zip(states, exact, strict=True)),
            max(np.abs(s.v - e[1]).max() for s, e in zip(states, exact, strict=True)),
            max(abs(abs(s.lam[0]) - e[2]) for s, e in zip(states, exact, strict=True)),
        ])  # fmt: skip
    e = np.array(errors)
    assert (np.log2(e[-2] / e[-1]) > 1.85).all(), e


def test_stabilised_form_holds_both_levels_and_permits_no_damping() -> None:
    """rho_inf = 1 blows up under the index-3 form; with both levels the energy stays."""
    scheme = fmbd.GeneralizedAlpha(1.0, form=fmbd.GGL())
    states = dae_problems.march(dae_problems.pendulum(2.0, 0.0, 1.0), scheme, 15.0, 1500, 1e-9)
    energy = np.array([0.5 * s.v @ s.v + s.q[1] for s in states])
    assert max(abs(s.q @ s.q - 1) for s in states) < 1e-11
    assert max(abs(s.q @ s.v) for s in states) < 1e-9
    assert np.abs(energy - energy[0]).max() < 5e-4
    with pytest.raises(InputError, match="permits 1"):
        fmbd.GeneralizedAlpha(1.0)
    with pytest.raises(InputError, match=r"takes form=Index3\(\) or GGL\(\)"):
        fmbd.GeneralizedAlpha(0.8, form=fmbd.Index1())


@pytest.mark.parametrize(("loops", "dt"), [(20, 2.5e-4), (9, 5e-5)])
def test_many_loops_through_the_flat_position(loops: int, dt: float, caplog: Any) -> None:
    """Parallel legs under bars lie flat at 0.09 s, where every loop could fold: they go on together, in whole steps of any size.

    All turn alike: theta'' = -g (legs / 2 + bars) cos(theta) / (legs / 3 + bars), for legs and bars of 1 kg and 1 m.
    """
    start, rate, end, g = 0.3, -3.0, 0.15, 9.81
    along, across = np.array([np.cos(start), np.sin(start)]), rate * np.array([-np.sin(start), np.cos(start)])
    scene = fmbd.Scene("four-bars", gravity=(0.0, -g))
    legs = [
        fmbd.RigidBody(
            f"leg {i}", 1.0, 1 / 12, 0.5 * along + (i, 0), start, velocity=0.5 * across, angular_velocity=rate
        )
        for i in range(loops + 1)
    ]
    bars = [fmbd.RigidBody(f"bar {i}", 1.0, 1 / 12, along + (i + 0.5, 0), velocity=across) for i in range(loops)]
    scene.add(*legs, *bars)
    scene.add(*(fmbd.revolute(f"A{i}", fmbd.ground, leg, center=(i, 0.0)) for i, leg in enumerate(legs)))
    for i, bar in enumerate(bars):
        scene.add(fmbd.revolute(f"B{i}", legs[i], bar, center=along + (i, 0)))
        scene.add(fmbd.revolute(f"C{i}", bar, legs[i + 1], center=along + (i + 1, 0)))
    scene.sensor("top", fmbd.position(legs[0], point=along))

    with caplog.at_level("WARNING", logger="fmbd_fenicsx"):
        run = fmbd.solve(scene, t_end=end, dt=dt)
    pull = g * ((loops + 1) / 2 + loops) / ((loops + 1) / 3 + loops)
    turn = solve_ivp(lambda t, y: (y[1], -pull * np.cos(y[0])), (0.0, end), (start, rate), rtol=1e-10, atol=1e-12)
    exact = np.array([np.cos(turn.y[0, -1]), np.sin(turn.y[0, -1])])
    assert np.abs(run["top"][-1] - exact).max() < 20 * dt**2
    assert not run.counters.get("halved_steps", 0)

    lines = [r.getMessage() for r in caplog.records]
    assert len(lines) == 1 and "near-singular" in lines[0] and 'joint "' in lines[0]


@pytest.mark.parametrize("compiled", [True, False], ids=["compiled", "NumPy"])
@pytest.mark.parametrize("form", [fmbd.Index3(), fmbd.GGL()])
@pytest.mark.parametrize("dim", [2, 3])
def test_heavy_loads_on_light_links(form: Any, dim: int, compiled: bool) -> None:
    """A load of 1e3 kg on links of 1e-6 to 1 kg swings; tangents without what it pulls across made 62 halves a step."""
    masses, axis = (1e-6, 1e-4, 1e-2, 1e-1, 1.0), np.array([np.sin(0.3), -np.cos(0.3), 0.0])[:dim]
    scene, before = fmbd.Scene("hoist", gravity=-9.81 * np.eye(dim)[1]), fmbd.ground
    for i, mass in enumerate((*masses, 1e3)):
        inertia = mass * 1e-2 if dim == 2 else mass * 1e-2 * np.eye(3)
        link = fmbd.RigidBody(f"link {i}", mass, inertia, tuple((i + 1.0) * axis))
        scene.add(link, fmbd.revolute(f"pin {i}", before, link, center=tuple(i * axis)))
        before = link
    scene.sensor("load", fmbd.position(before))
    alpha, other = (
        fmbd.solve(scene, t_end=0.5 if compiled else 0.1, dt=1e-3, scheme=scheme)
        for scheme in (fmbd.GeneralizedAlpha(0.8, form=form, compiled=compiled), fmbd.EnergyMomentum())
    )
    assert alpha.counters["halved_steps"] == 0
    assert alpha.counters["newton_iterations"] <= 3 * alpha.counters["steps"]
    np.testing.assert_allclose(alpha["load"][-1], other["load"][-1], atol=1e-4)
