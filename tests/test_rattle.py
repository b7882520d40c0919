"""RATTLE: order two, both constraint levels, bounded energy error."""

from __future__ import annotations

import resource
from typing import Any

import numpy as np
import pytest
from combinations import BODIES, pinned
from dae_problems import march, observed, pendulum, pendulum_at, spinning_top, state_errors

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.linear.blocks.field_blocks import Weights
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.schemes.consistent import consistent
from fmbd_fenicsx.schemes.marching import MarchingStepper
from fmbd_fenicsx.schemes.newton import Newton
from fmbd_fenicsx.schemes.onestep.rattle import RattleStepper
from fmbd_fenicsx.system.compiled.states.explicit import ExplicitStates


def test_order_two_and_half_step_multipliers_of_order_one() -> None:
    found = observed(fmbd.Rattle(), (80, 160, 320))
    assert (np.abs(found - 2) < 0.15).all(), found
    system, given, _ = pendulum().build()
    errors = []
    for n in (80, 160, 320):
        solver = StepSolver(system)
        stepper = fmbd.Rattle().stepper(system, solver, Newton(1e-11, 25), consistent(system, given, solver)[0])
        for _ in range(n):
            stepper.advance(1.0 / n)
        errors.append(abs(abs(stepper.half[0]) - pendulum_at(1.0)[2]))
    assert np.log2(errors[1] / errors[2]) == pytest.approx(1.0, abs=0.15)


def test_order_in_space() -> None:
    scene = spinning_top()
    reference = march(scene, fmbd.Radau(3, fmbd.StateSpace(), None), 0.25, 60)[-1]
    errors = [state_errors(scene, march(scene, fmbd.Rattle(), 0.25, n)[-1], reference) for n in (40, 80)]
    assert (np.abs(np.log2(errors[0] / errors[1]) - 2) < 0.15).all()


def test_going_back_returns_to_the_start() -> None:
    """Symmetric: the step with -h from the end, velocities turned, leads back."""
    there = march(pendulum(), fmbd.Rattle(), 1.0, 50, 1e-13)
    scene = pendulum()
    system, given, _ = scene.build()
    solver = StepSolver(system)
    turned = given.__class__(0.0, there[-1].q, -there[-1].v, there[-1].a, there[-1].lam)
    stepper = fmbd.Rattle().stepper(system, solver, Newton(1e-13, 30), turned)
    for _ in range(50):
        state = stepper.advance(1.0 / 50)
    assert np.abs(state.q - there[0].q).max() < 1e-12
    assert np.abs(state.v + there[0].v).max() < 1e-11


def test_the_end_of_a_step_takes_its_matrix_behind_the_smallest_multipliers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a door on two hinges, where compiled code finds no accelerations: these multipliers are the driver's, and take the
    matrix that it has.
    """
    scene = fmbd.Scene("door", gravity=(0, -9.81, 1.0))
    scene.add(door := fmbd.RigidBody("door", 2.0, (0.1, 0.2, 0.3), (0.4, 0.0, 1.0)))
    for k in (0.0, 2.0):
        scene.add(fmbd.revolute(f"hinge {k:g}", fmbd.ground, door, center=(0, 0, k), axis=(0, 0, 1)))

    ready, refine = [], RattleStepper._refine

    def noted(self: RattleStepper, *given: Any) -> Any:
        driver = self.solver.driver
        ready.append(driver is None or driver.ready)
        return refine(self, *given)

    monkeypatch.setattr(RattleStepper, "_refine", noted)
    monkeypatch.setattr(MarchingStepper, "stride", lambda self, h: 0.0)
    monkeypatch.setattr(MarchingStepper, "_made", lambda *given: 0)
    monkeypatch.setattr(ExplicitStates, "accelerations", lambda *given: None)
    fmbd.solve(scene, t_end=0.005, dt=1e-3, scheme=fmbd.Rattle())
    assert all(ready)
    assert len(ready) == 2 * 5


def test_matrices_that_others_made_are_not_taken_for_its_own() -> None:
    """Someone else uses the solver between two steps, at another place in the same arrays: the next step is the same."""
    ends = []
    for disturbed in (False, True):
        system, given, _ = pendulum(1.0, 0.0, 1.0).build()
        solver = StepSolver(system)
        stepper = fmbd.Rattle().stepper(system, solver, Newton(1e-13, 25), consistent(system, given, solver)[0])
        stepper.advance(0.05)
        s = stepper.state
        if disturbed:
            elsewhere = system.at(s.t, s.q, s.v)
            kept = s.q.copy()
            s.q[:] = system.compose(s.q, np.ones(system.n_v))
            solver.prepare(elsewhere, Weights(2.0, 0.0, 0.1))
            s.q[:] = kept
        assert solver.holds(system.at(s.t, s.q, s.v), Weights(1.0, 0.0, 0.0)) != disturbed
        ends.append(stepper.advance(0.05))
    for name in ("q", "v", "a", "lam"):
        assert np.array_equal(getattr(ends[0], name), getattr(ends[1], name)), name


def long_run(steps: int) -> tuple[np.ndarray, float, float]:
    """|dE| at each step, largest |g| and |G v| of a pendulum from angle 2 with h = 0.01."""
    system, given, _ = pendulum(2.0, 0.0, 1.0).build()
    solver = StepSolver(system)
    stepper = fmbd.Rattle().stepper(system, solver, Newton(1e-10, 25), consistent(system, given, solver)[0])
    energy, gap, slip = np.empty(steps), 0.0, 0.0
    start = given.q[1]
    for n in range(steps):
        s = stepper.advance(0.01)
        energy[n] = abs(0.5 * s.v @ s.v + s.q[1] - start)
        gap, slip = max(gap, abs(0.5 * (s.q @ s.q - 1))), max(slip, abs(s.q @ s.v))
    return energy, gap, slip


def arm(damping: float, *, twice: bool = False) -> fmbd.Scene:
    """Three links in space with motors; ``twice``: on two hinges of one axis, whose rows depend on each other."""
    scene, before = fmbd.Scene("arm", gravity=(0.0, 0.0, -9.81)), fmbd.ground
    for i, axis in enumerate(((0, 0, 1), (0, 1, 0), (0, 1, 0.3))):
        link = fmbd.RigidBody(f"link {i}", 1.0, (0.02, 0.1, 0.1), (0.5 + i, 0.0, 0.0))
        hinge = fmbd.revolute(f"hinge {i}", before, link, center=(float(i), 0.0, 0.0), axis=axis)
        motor = fmbd.joint_spring(f"pd {i}", fmbd.angle(hinge), stiffness=200.0, damping=damping, free=0.3 * i)
        scene.add(link, hinge, motor)
        if twice and i == 0:
            scene.add(fmbd.revolute("second", before, link, center=(0.0, 0.0, 0.4), axis=axis))
        before = link
    return scene


@pytest.mark.parametrize("damping, twice", [(0.0, False), (10.0, False), (1.0, True)])
def test_a_step_is_one_compiled_call(damping: float, twice: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """States agree to the tolerance of Newton's iteration with steps that are made in parts, with as many increments."""
    steps = {"t_end": 0.03, "dt": 1e-3, "scheme": fmbd.Rattle(), "newton": Newton(1e-11)}
    calls = []

    def counted(self: Any, *given: Any) -> int:
        calls.append(made(self, *given))
        return calls[-1]

    made = MarchingStepper._made
    monkeypatch.setattr(MarchingStepper, "_made", counted)
    run = fmbd.solve(arm(damping, twice=twice), **steps)
    assert all(calls) and sum(calls) == 30

    monkeypatch.setattr(MarchingStepper, "_made", lambda *given: 0)
    slow = fmbd.solve(arm(damping, twice=twice), **steps)
    for name in ("q", "v", "a", "lam"):
        fast, wanted = getattr(run.state, name), getattr(slow.state, name)
        assert fast == pytest.approx(wanted, rel=1e-8, abs=1e-8 * np.abs(wanted).max()), name
    if not twice:  # of dependent rows the first solution leaves open what the second one closes
        assert run.counters["newton_iterations"] == slow.counters["newton_iterations"]


def test_an_even_turn_is_compiled_too() -> None:
    """A skew rotor pushes its bearings by a turning couple, and has no accelerations beside roundoff: steps ended in Python."""
    tilt, spin, d = 0.05, 200.0, 0.4
    axis = np.array([np.sin(tilt), 0.0, np.cos(tilt)])
    R = np.array([[axis[2], 0.0, axis[0]], [0.0, 1.0, 0.0], [-axis[0], 0.0, axis[2]]])
    rotor = fmbd.RigidBody(
        "rotor", 5.0, (0.021, 0.021, 0.04), rotation=R, angular_velocity=tuple(R.T @ (0.0, 0.0, spin))
    )
    scene = fmbd.Scene("skew rotor")
    far = fmbd.point_on_line("far", fmbd.ground, rotor, center=(0.0, 0.0, 0.5 * d), axis=(0, 0, 1))
    scene.add(rotor, far, fmbd.spherical("near", fmbd.ground, rotor, center=(0.0, 0.0, -0.5 * d)))
    scene.sensor("force", fmbd.reaction_force(far))
    run = fmbd.solve(scene, t_end=0.05, dt=1e-4, scheme=fmbd.Rattle())

    # the couple on the rotor is (C - A) sin cos spin^2 about the horizontal line across its axis; the ground feels the reverse
    angle = spin * run.times[-1]
    couple = (0.04 - 0.021) * np.sin(tilt) * np.cos(tilt) * spin**2
    assert run["force"][-1] == pytest.approx(-couple / d * np.array([np.cos(angle), np.sin(angle), 0.0]), rel=1e-9)
    assert run.counters["core_factorisations"] < 10  # one in each call of C, two and a half a step in Python


@pytest.mark.parametrize("damping", [0.0, 50.0])
def test_iterations_do_not_grow_with_damping(damping: float) -> None:
    """The matrix knows of it as soon as it slows Newton's iteration: ten increments a step with the masses alone."""
    scene = arm(damping)
    run = fmbd.solve(scene, t_end=0.1, dt=1e-3, scheme=fmbd.Rattle())
    assert run.counters["newton_iterations"] <= 2.5 * run.counters["steps"]

    fine = fmbd.solve(scene, t_end=0.1, dt=2.5e-4, scheme=fmbd.Rattle())
    exact = fmbd.solve(scene, t_end=0.1, scheme=fmbd.Radau(rtol=1e-9))
    off = [np.abs(x.state.q - exact.state.q).max() for x in (run, fine)]
    assert off[0] < 3e-4 and off[1] < 0.08 * off[0]


def test_strong_friction_in_the_hinge_of_an_elastic_body() -> None:
    """Where the masses alone let increments of the first half grow, its matrix learns of damping, and no step is halved."""
    rod = BODIES["floating"]()
    scene = fmbd.Scene("rubbing", gravity=rod.at(0, -9.81))
    scene.add(rod.body)
    scene.add(fmbd.joint_friction("friction", fmbd.angle(pinned(scene, rod)), coulomb=5.0, speed=0.01))
    scene.sensor("tip", fmbd.position(rod.tip))

    run = fmbd.solve(scene, t_end=1e-3, dt=2e-5, scheme=fmbd.Rattle())
    assert run.counters["halved_steps"] == 0
    assert run.counters["newton_iterations"] <= 4 * run.counters["steps"]

    exact = fmbd.solve(scene, t_end=1e-3, dt=5e-6, scheme=fmbd.GeneralizedAlpha(0.9))
    fallen = np.abs(exact["tip"] - exact["tip"][0]).max()
    assert np.abs(run["tip"][-1] - exact["tip"][-1]).max() < 1e-3 * fallen


def test_a_search_for_a_tolerance_whose_matrices_are_all_compiled() -> None:
    """What is known of the rows comes from the run before: NumPy factors nothing."""
    scene = fmbd.Scene("pendulum", gravity=(0.0, -9.81))
    body = fmbd.RigidBody("body", 1.0, 0.1, (0.5, 0.0))
    scene.add(body, fmbd.revolute("hinge", fmbd.ground, body, center=(0, 0)))
    scene.sensor("x", fmbd.position(body))
    run = fmbd.solve(scene, t_end=0.3, tol={"x": 1e-4}, scheme=fmbd.Rattle())
    exact = fmbd.solve(scene, t_end=0.3, scheme=fmbd.Radau(rtol=1e-10))
    assert np.abs(run["x"][-1] - exact["x"][-1]).max() < 1e-4


def test_energy_error_is_bounded() -> None:
    """No growth between 1000 and 10000 steps."""
    energy, gap, slip = long_run(10_000)
    assert gap < 1e-12 and slip < 1e-12
    assert energy.max() < 1.05 * energy[:1000].max() < 1e-4


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_a_million_steps() -> None:
    """The same over 1e6 steps."""
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    energy, gap, slip = long_run(1_000_000)
    assert gap < 1e-12 and slip < 1e-12
    tops = [energy[:n].max() for n in (10_000, 100_000, 1_000_000)]
    assert np.log10(tops[2] / tops[0]) / 2 <= 0.05
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory < 40_000  # kB; 8 MB of them are ``energy``
