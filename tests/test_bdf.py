"""BDF: orders with constant steps, error control, choice of the order."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from chains import chain
from dae_problems import march, observed, pendulum, pendulum_at, spinning_top, state_errors
from profiled import calls_of

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.schemes.consistent import consistent
from fmbd_fenicsx.schemes.multistep.past import slopes_at_first, weights


@pytest.mark.parametrize(
    ("order", "form"),
    [
        (1, fmbd.Index3()),
        (2, fmbd.Index3()),
        (3, fmbd.Index3()),
        (2, fmbd.GGL()),
        (3, fmbd.Index2()),
        (4, fmbd.GGL()),
    ],
    ids=lambda x: getattr(x, "name", None) or str(x),
)
def test_orders_with_constant_steps(order: int, form: fmbd.GGL) -> None:
    steps = (160, 320, 640) if order == 1 else (80, 160, 320) if order < 4 else (60, 120, 240)
    found = observed(fmbd.BDF(order, form, None), steps)
    assert (found > order - 0.15).all() and (found[1:] < order + 0.15).all(), found


@pytest.mark.slow
def test_order_in_space() -> None:
    """Past values in the local coordinates of the step keep the order on SO(3).

    Order 3 approaches its order in the positions slowly: 2.76, 2.89, 2.95, 3.03 between 80, 160, 320, 640, 1280 steps (velocities
    and multipliers: 3.00 and 2.95 from the start).
    """
    scene = spinning_top()
    reference = march(scene, fmbd.Radau(7, fmbd.StateSpace(), None), 0.5, 60, 1e-13)[-1]
    for order, steps in ((2, (80, 160)), (3, (320, 640))):
        errors = np.array(
            [state_errors(scene, march(scene, fmbd.BDF(order, rtol=None), 0.5, n)[-1], reference) for n in steps]
        )
        assert (np.abs(np.log2(errors[0] / errors[1]) - order) < 0.15).all(), errors


@pytest.mark.parametrize("rtol", [1e-3, 1e-6, 1e-9])
@pytest.mark.parametrize("form", [fmbd.GGL(), fmbd.Index1(), fmbd.StateSpace()], ids=lambda f: f.name)
def test_error_follows_the_tolerance(form: fmbd.GGL, rtol: float) -> None:
    run = fmbd.solve(pendulum(), t_end=1.0, scheme=fmbd.BDF(form=form, rtol=rtol))
    x, v, _ = pendulum_at(1.0)
    assert np.abs(run["x"][-1] - x).max() < 30 * rtol
    assert np.abs(run["v"][-1] - v).max() < 200 * rtol


def test_tight_tolerances_reach_order_five() -> None:
    few = fmbd.solve(pendulum(), t_end=1.0, scheme=fmbd.BDF(rtol=1e-8)).counters["steps"]
    low = fmbd.solve(pendulum(), t_end=1.0, scheme=fmbd.BDF(order=2, rtol=1e-8)).counters["steps"]
    assert few < 160 < 3 * few < low


def test_one_residual_an_iteration_and_few_factors() -> None:
    c = fmbd.solve(pendulum(), t_end=1.0, scheme=fmbd.BDF(rtol=1e-6)).counters
    assert c["residuals"] == c["newton_iterations"] == c["solves"]
    assert c["factorisations"] < 0.4 * c["steps"]
    assert c["jacobians"] < 0.2 * c["steps"]


def test_interpolation_weights() -> None:
    nodes = np.array([1.0, 0.7, 0.55, 0.1])
    cubic = nodes**3 - 2 * nodes**2 + 3
    assert weights(nodes, 1.4) @ cubic == pytest.approx(1.4**3 - 2 * 1.4**2 + 3)
    assert slopes_at_first(nodes) @ cubic == pytest.approx(3 - 4)


def test_orders_that_do_not_exist() -> None:
    with pytest.raises(InputError, match="order = 6"):
        fmbd.BDF(order=6)


def test_few_steps_and_all_of_the_accuracy_behind_each_sample() -> None:
    """A cart whose force is held between samples: every one is a new start, which does not climb from order 1 up."""

    def run(scheme: Any) -> fmbd.Run:
        cart = fmbd.RigidBody("cart", 1.0, 0.1)
        rail = fmbd.prismatic("rail", fmbd.ground, cart, center=(0.0, 0.0), axis=(1.0, 0.0))
        scene, x = fmbd.Scene("cart"), fmbd.displacement(rail)
        scene.add(cart, rail, fmbd.joint_spring("spring", x, stiffness=30.0))
        scene.add(fmbd.pid("pid", x, target=0.3, gains=(60.0, 40.0, 8.0), every=0.02))
        scene.sensor("x", x)
        return fmbd.solve(scene, t_end=1.0, scheme=scheme)

    found, exact = run(fmbd.BDF(rtol=1e-6)), run(fmbd.Radau(5, rtol=1e-11))
    assert found.counters["steps"] < 150
    assert abs(found["x"][-1, 0] - exact["x"][-1, 0]) < 1e-7


def test_a_restart_begins_as_a_run_does() -> None:
    """The same steps and orders follow a start and a restart at the same state."""
    system, given, _ = pendulum().build()
    taken = []
    for again in (False, True):
        solver = StepSolver(system)
        start, _ = consistent(system, given, solver)
        stepper = fmbd.BDF(rtol=1e-6).stepper(system, solver, fmbd.Newton(), start)
        if again:
            stepper.restart(start.t)
        taken.append([(stepper.advance(1.0).t, stepper.orders.k) for _ in range(40)])
    assert taken[0] == pytest.approx(taken[1], rel=1e-9) and max(k for _, k in taken[0]) > 2


@pytest.mark.parametrize(
    ("errors", "order"), [((9.0, 1e-4, 0.5, 0.9), 2), ((9.0, 0.5, 0.5, 1e-6), 4), ((1e-4, 9.0, 0.5, 0.9), 3)]
)
def test_the_order_is_that_of_the_longest_step(errors: tuple[float, ...], order: int, monkeypatch: Any) -> None:
    """Of order 3 and its neighbours, by their errors; order 1 is not looked at."""
    system, given, _ = pendulum().build()
    solver = StepSolver(system)
    start, _ = consistent(system, given, solver)
    stepper = fmbd.BDF(rtol=1e-6).stepper(system, solver, fmbd.Newton(), start)
    for _ in range(12):
        stepper.advance(1.0)
    orders = stepper.orders
    orders.k, orders.held = 3, 9
    monkeypatch.setattr(orders.amplification, "permits", lambda *given: True)
    orders.next_size(1e-3, errors[2], lambda k: errors[k - 1], len(stepper.past))
    assert orders.k == order


G = 9.81
STOPS = {
    "stop": lambda s, k: fmbd.elastic_stop("stop", s, lower=-1.0, stiffness=k),
    "law": lambda s, k: fmbd.joint_spring("stop", s, law=lambda x, rate, t: k * np.minimum(x + 1.0, 0.0)),
}


def fallen(t, k):
    """Height of 1 kg that falls by 1 m onto a spring k that only pushes, and comes back, from rest on."""
    w, v = np.sqrt(k), np.sqrt(2 * G)
    sag, flight = G / k, 2 * v / G
    touch = 2 * (np.pi - np.arctan2(v / w, sag)) / w
    since = (t + 0.5 * flight) % (flight + touch)
    x = since - flight
    return np.where(x < 0, v * since - 0.5 * G * since**2, sag * (np.cos(w * x) - 1.0) - v / w * np.sin(w * x))


@pytest.mark.parametrize("stop", STOPS)
@pytest.mark.parametrize(
    ("scheme", "k", "error"),
    [
        (fmbd.BDF(rtol=1e-3), 1e7, 0.15),
        (fmbd.BDF(rtol=1e-4), 1e9, 0.02),
        (fmbd.BDF(rtol=1e-5), 1e9, 3e-3),
        (fmbd.BDF(rtol=1e-6), 1e6, 1e-3),
        (fmbd.Radau(rtol=1e-5), 1e9, 1e-3),
        (fmbd.GeneralizedAlpha(rtol=1e-4), 1e7, 2e-2),
        (fmbd.GeneralizedAlpha(rtol=1e-5, compiled=False), 1e9, 2e-3),
        (fmbd.ExplicitRungeKutta(rtol=1e-3), 1e9, 0.05),
        (fmbd.ExplicitRungeKutta(rtol=1e-6), 1e6, 1e-4),
    ],
    ids=lambda x: f"{x.name}, {x.rtol:g}" if hasattr(x, "rtol") else f"{x:g}",
)
def test_what_bounces_on_a_stiff_stop_follows_the_tolerance(scheme, k, error, stop):
    """A step of 0.1 s ends below the stop. Its error is no small share of what the past foretold, and an increment behind one
    that crossed the stop tells no rate of the iteration: else heights are off by 1 m, and bodies fly away at 4 km/s. Nor do
    velocities within the stop, in steps of microseconds, count by the places that they lead to.
    """
    scene = fmbd.Scene("bounce", gravity=(0.0, -G))
    body = fmbd.RigidBody("ball", 1.0, 0.1, position=(0.0, 0.0))
    rail = fmbd.prismatic("rail", fmbd.ground, body, center=(0, 0), axis=(0, 1))
    scene.add(body, rail, STOPS[stop](fmbd.displacement(rail), k))
    scene.sensor("y", fmbd.position(body))
    run = fmbd.solve(scene, t_end=2.0, scheme=scheme)
    assert np.abs(run["y"][:, 1] + 1.0 - fallen(run.times, k)).max() < error


def test_a_sum_of_many_coordinates_takes_no_call_for_each_pair() -> None:
    """Looks at what vibrates take the tangent of a spring on the sum of 40 angles at once, not for each two of its bodies."""
    scene, _ = chain(40)
    pins = [fmbd.angle(scene.joints[f"pin {k}"]) for k in range(40)]
    scene.add(fmbd.joint_spring("tendon", sum(pins[1:], pins[0]), stiffness=1e4, damping=10.0))
    assert calls_of(lambda: fmbd.solve(scene, t_end=0.02, scheme=fmbd.BDF(rtol=1e-5)), "numpy") < 40_000
