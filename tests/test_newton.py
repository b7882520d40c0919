"""Newton's guard: stops when increments stop falling, goes on after a single bad one; rows follow a bad prediction."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from combinations import BODIES, floor

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.schemes.newton import Newton, above_roundoff, known_gaps
from fmbd_fenicsx.system.scene.build import Builder


def run(sizes, renew=lambda: False, **settings):
    """Feed a list of increments; returns (converged, how many were taken)."""
    feed = iter(sizes)
    newton = Newton(**settings)
    converged, history = newton.solve(lambda: next(feed), renew)
    return converged, len(history)


def test_fast_convergence_stops_as_soon_as_the_error_left_is_below_the_tolerance():
    assert run([1e3, 1e2, 1.0, 1e-3]) == (True, 3)


def test_the_first_increment_counts_when_it_is_tiny():
    assert run([1e-4]) == (True, 1)


def test_one_bad_increment_is_forgiven():
    assert run([8e9, 1e4, 3e2, 4e2, 2e1, 1e-1, 1e-3]) == (True, 6)


def test_growth_over_two_increments_is_divergence():
    assert run([1e3, 1e2, 2e2, 4e2, 8e2]) == (False, 4)


def test_not_finite_ends_at_once_and_too_many_iterations_too():
    assert run([1e3, float("nan")]) == (False, 2)
    assert run([10.0 * 0.8**k for k in range(99)], max_iterations=5) == (False, 5)


def test_a_new_tangent_is_asked_for_when_the_rate_is_poor():
    asked = []
    run([1e6, 5e5, 1e2, 1e-3], renew=lambda: not asked.append(1))
    assert asked == [1]


def test_a_new_tangent_waits_until_increments_have_paid_for_it():
    """Steps of seven increments, three would do: 4 are lost in each, and 8 times the patience of 4 are the price; where steps
    take seven with the new one, too, it is kept.
    """
    newton, asked = Newton(), []
    for k in range(40):
        feed = iter([1e6 * 0.1**i for i in range(9)])
        assert newton.solve(lambda feed=feed: next(feed), lambda k=k: not asked.append(k), cost=8.0)[0]
    assert asked == [8]


def test_a_new_tangent_does_not_wait_where_the_step_would_not_end():
    asked = []
    feed = iter([1e6, 5e5, 1e2, 1e-3])
    assert Newton().solve(lambda: next(feed), lambda: not asked.append(1), cost=8.0)[0] and asked == [1]


def test_rows_follow_a_prediction_that_was_far_off(rod_mesh: Callable[..., Any]) -> None:
    """Two stiff rods on a crank, loaded at once: rows of the predicted configuration would not let the iteration converge."""
    mesh, steel = rod_mesh(dim=2, h=0.1, height=0.04), fmbd.materials.plane_stress(2e9, 0.3)
    angle = float(np.arctan2(0.8, 0.6))
    a = fmbd.FloatingBody("a", mesh.placed((0, 0), angle), density=60.0, elastic=steel)
    b = fmbd.FloatingBody("b", mesh.placed((1.2, 0), np.pi - angle), density=60.0, elastic=steel)
    crank, ground = fmbd.RigidBody("crank", 1.0, 1e-2, position=(1.3, 0)), fmbd.ground
    scene = fmbd.Scene("sudden load")
    scene.add(a, b, crank)
    scene.add(fmbd.revolute("left", ground, a.surface("pin"), center=(0, 0)))
    scene.add(fmbd.revolute("right", crank, b.surface("pin"), center=(1.2, 0)))
    scene.add(fmbd.revolute("top", a.surface("tip"), b.surface("tip"), center=(0.6, 0.8)))
    scene.add(fmbd.revolute("motor", ground, crank, center=(1.4, 0)))
    scene.add(fmbd.drive_rotation("turn", ground, crank, lambda t: (20 * t**3, 60 * t**2, 120 * t)))
    scene.add(fmbd.force("load", a.surface("tip"), lambda t: np.array([5e3, 5e3])))
    run = fmbd.solve(scene, t_end=0.02, dt=2e-3, scheme=fmbd.GeneralizedAlpha(0.8))
    assert run.counters["newton_iterations"] <= 4 * 10


def test_what_counts_of_a_balance_at_roundoff() -> None:
    """A light shaft between heavy forces: its residual of 1e-17 N m is roundoff of moments of 1 N m, 1e-10 N m is not."""
    scene = fmbd.Scene("shaft", gravity=(0, 0, -9.81))
    shaft = fmbd.RigidBody("shaft", 1e-9, (1e-12, 1e-12, 1e-14), position=(0, 0, 0.5))
    scene.add(shaft, fmbd.spherical("pin", fmbd.ground, shaft, center=(0, 0, 0)))
    system, state, _ = Builder(scene).build()
    ev = system.at(0.0, state.q, state.v)
    lam, r = np.full(3, 10.0), np.array([0.0, 0.0, 0.0, 1e-17, 1e-10, 0.0])
    assert above_roundoff(ev, lam, r, np.zeros(3)).tolist() == [0, 0, 0, 0, 1, 0]
    assert above_roundoff(ev, lam, r, np.full(3, 1e-6)).all()  # open constraints: everything counts


def test_gaps_of_roundoff_are_not_known() -> None:
    """Those above it stay; a scene without joints has none."""
    body = fmbd.RigidBody("a", 1.0, 1.0, position=(1.0, 0.0))
    scene = fmbd.Scene("one")
    scene.add(body)
    system, state, _ = scene.build()
    assert known_gaps(system.at(state.t, state.q), np.zeros(0)).shape == (0,)

    scene.add(fmbd.revolute("pin", fmbd.ground, body, center=(0.0, 0.0)))
    system, state, _ = scene.build()
    np.testing.assert_array_equal(known_gaps(system.at(state.t, state.q), np.array([1e-15, 1e-12])), [0.0, 1e-12])


@pytest.mark.parametrize("scheme", [fmbd.ContactMidpoint(), fmbd.ContactAlpha()], ids=lambda s: s.name)
def test_friction_that_turns_over_gets_new_tangents_beside_contact(scheme: Any) -> None:
    """A linear body has none of its own, but the friction in its hinge does: steps of a hundred times its speed are whole."""
    rod = BODIES["absolute"]()
    scene = fmbd.Scene("hinge", gravity=(0.0, -9.81))
    hinge = fmbd.revolute("hinge", fmbd.ground, rod.left, center=(0, 0))
    scene.add(rod.body, hinge, fmbd.joint_friction("friction", fmbd.angle(hinge), coulomb=5.0, speed=0.01))
    floor(scene, rod, below=1.0)
    run = fmbd.solve(scene, t_end=0.02, dt=1e-3, scheme=scheme, output=fmbd.Output(progress=False))
    assert run.counters["halved_steps"] == 0
    assert run.counters["newton_iterations"] <= 4 * 20


@pytest.mark.parametrize("compiled", [True, False])
def test_stiff_vibrations_leave_joints_closed(rod_mesh: Callable[..., Any], compiled: bool) -> None:
    """A clamped steel bar that starts with a velocity of its own: accelerations of 1e4 m/s^2 ask for no closed clamp."""
    steel = fmbd.materials.linear_elastic(2e11, 0.3)
    rod = fmbd.FloatingBody(
        "rod", rod_mesh(), density=1e3, elastic=steel, velocity=(0.0, 1.0), angular_velocity=1.0
    ).reduced(modes=6)
    scene = fmbd.Scene("bar")
    scene.add(rod, fmbd.fixed("clamp", fmbd.ground, rod.surface("pin")))

    run = fmbd.solve(scene, t_end=0.1, dt=0.01, scheme=fmbd.GeneralizedAlpha(compiled=compiled))
    assert run.drift[0] <= 5e-8 and not run.counters["halved_steps"]
