"""Controllers: against SciPy, sampled ones against the formula, memory over checkpoints and rejected steps."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from motion import Motion, first
from profiled import calls_of
from scipy.integrate import solve_ivp
from test_compiled_evaluation import pair_of
from test_stage_systems import equations, with_arrays, with_dense_matrices

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import CallbackError, InputError, LawError
from fmbd_fenicsx.linear.blocks.field_blocks import Weights
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.rotations import Array
from fmbd_fenicsx.system.compiled.choice import driver_states
from fmbd_fenicsx.system.control.control_memory import ControllerMemory, StepMemory
from fmbd_fenicsx.system.tangents.force_tangent import force_tangent

GAINS, G = ((60.0, 80.0, 9.0), (25.0, 40.0, 3.0)), 9.81
GOAL = (0.7, -1.1)


def arm(every: float | None = None) -> fmbd.Scene:
    """Two rods of 1 m and 1 kg under weight, a PID controller in each hinge."""
    one = fmbd.RigidBody("one", 1.0, 1 / 12, position=(0.5, 0))
    two = fmbd.RigidBody("two", 1.0, 1 / 12, position=(1.5, 0))
    scene = fmbd.Scene("arm", gravity=(0, -G))
    hinges = (
        fmbd.revolute("shoulder", fmbd.ground, one, center=(0, 0)),
        fmbd.revolute("elbow", one, two, center=(1, 0)),
    )
    scene.add(one, two, *hinges)
    for hinge, goal, gains in zip(hinges, GOAL, GAINS, strict=True):
        motor = fmbd.pid(f"{hinge.name} motor", fmbd.angle(hinge), target=goal, gains=gains, every=every)
        scene.add(motor)
        scene.sensor(hinge.name, fmbd.angle(hinge))
        scene.sensor(f"{hinge.name} torque", fmbd.element_effort(motor))
    return scene


def by_scipy(times: Array) -> Array:
    """The same arm by Lagrange's equations and DOP853, (n, 2) angles."""

    def rate(t: float, x: Array) -> Array:
        q, v, z = x[:2], x[2:4], x[4:]
        c, s = np.cos(q[1]), np.sin(q[1])
        J = 1 / 12
        M = np.array([[2 * J + 1.5 + c, J + 0.25 + 0.5 * c], [J + 0.25 + 0.5 * c, J + 0.25]])
        h = 0.5 * s * np.array([-v[1] * (2 * v[0] + v[1]), v[0] ** 2])
        outer = 0.5 * G * np.cos(q.sum())
        weight = np.array([1.5 * G * np.cos(q[0]) + outer, outer])
        error = GOAL - q
        gains = np.array(GAINS)
        u = gains[:, 0] * error + gains[:, 1] * z - gains[:, 2] * v
        return np.concatenate((v, np.linalg.solve(M, u - h - weight), error))

    done = solve_ivp(rate, (0, times[-1]), np.zeros(6), method="DOP853", t_eval=times, rtol=1e-11, atol=1e-12)
    return np.asarray(done.y[:2].T)


def test_continuous_pid_against_scipy() -> None:
    """Second order in the step, and 1e-6 rad after one extrapolation."""
    runs = [fmbd.solve(arm(), t_end=1.0, dt=dt) for dt in (1e-2, 5e-3)]
    exact = by_scipy(runs[0].times)
    found = [np.concatenate((r["shoulder"], r["elbow"]), axis=1)[::step] for r, step in zip(runs, (1, 2), strict=True)]
    errors = [np.abs(x - exact).max() for x in found]
    assert errors[1] < 2e-3
    assert 1.8 < np.log2(errors[0] / errors[1]) < 2.3


@pytest.mark.parametrize(
    "scheme", [fmbd.Radau(rtol=1e-7), fmbd.EnergyMomentum(), fmbd.GeneralizedAlpha(form=fmbd.GGL())]
)
def test_other_schemes_agree(scheme: Any) -> None:
    run = fmbd.solve(arm(), t_end=0.3, dt=5e-3, scheme=scheme)
    exact = by_scipy(run.times)
    assert np.abs(run["elbow"][:, 0] - exact[:, 1]).max() < 1e-3


@pytest.mark.parametrize("scheme", [fmbd.Radau(rtol=1e-6), fmbd.BDF(rtol=1e-5)], ids=["Radau", "BDF"])
def test_pid_between_its_limits_is_a_linear_law(scheme: Any) -> None:
    """Its slopes, which a tangent has, tell all that its effort changes by, however small it is: no step is taken anew."""
    scene = fmbd.Scene("arm", gravity=(0, -9.81))
    before: Any = fmbd.ground
    for i in range(12):
        link = fmbd.RigidBody(f"link {i}", 1.0, 0.1, position=(i + 0.5, 0.0))
        hinge = fmbd.revolute(f"hinge {i}", before, link, center=(i, 0))
        scene.add(link, hinge, fmbd.pid(f"motor {i}", fmbd.angle(hinge), target=0.0, gains=(1e4, 10.0, 10.0)))
        before = link
    run = fmbd.solve(scene, t_end=0.3, scheme=scheme)
    assert run.counters["jacobians"] < 0.15 * run.counters["steps"]


def test_sampled_pid_holds_its_effort() -> None:
    """Each effort is the formula of the sample, kept for one period of four steps."""
    run = fmbd.solve(arm(every=0.02), t_end=0.4, dt=5e-3)
    u, s = run["shoulder torque"][:, 0], run["shoulder"][:, 0]
    assert np.array_equal(u[:-1].reshape(-1, 4), np.repeat(u[:-1:4, None], 4, axis=1))
    error = GOAL[0] - s[::4]
    integral = 0.02 * np.concatenate(([0.0], np.cumsum(error)[:-1]))
    rate = (GAINS[0][0] * error + GAINS[0][1] * integral - u[::4]) / GAINS[0][2]
    seen = np.gradient(s, run.times)[::4]
    assert np.abs(rate - seen)[1:-1].max() < 0.1 * np.abs(seen).max()
    assert abs(u[0] - GAINS[0][0] * GOAL[0]) < 1e-12


def test_samples_of_schemes_with_error_control_are_hit() -> None:
    run = fmbd.solve(arm(every=0.02), t_end=0.2, scheme=fmbd.Radau(rtol=1e-6))
    fine = fmbd.solve(arm(every=0.02), t_end=0.2, dt=1e-3)
    assert abs(run["elbow"][-1, 0] - fine["elbow"][-1, 0]) < 1e-5
    assert len(np.unique(run["elbow torque"][:, 0].round(9))) >= 10


def test_samples_between_steps_are_taken_at_the_next_end_and_told_of() -> None:
    times: list[float] = []
    scene = arm()
    turn = fmbd.angle(scene.joints["elbow"])
    scene.add(
        fmbd.controller(
            "c", reads={"s": turn}, acts=turn, law=lambda t, y, z: times.append(t) or -y["s"][0], every=0.02
        )
    )
    for dt, said in ((5e-3, False), (6e-3, True), (0.03, True)):
        times.clear()
        run = fmbd.solve(scene, t_end=0.12, dt=dt)
        assert any("samples are taken late" in line for line in run.warnings) == said
        ends = np.unique(dt * np.ceil(np.arange(0.0, 0.1201, 0.02) / dt - 1e-6))
        assert np.unique(times) == pytest.approx(ends, abs=1e-12)


def closer(calls: list[float]) -> fmbd.Scene:
    """A door whose closer drags by Bouc and Wen's law, a memory that is slow against the step."""
    scene = fmbd.Scene("door")
    door = fmbd.RigidBody("door", 30.0, 8.0, position=(0.45, 0))
    hinge = fmbd.revolute("hinge", fmbd.ground, door, center=(0, 0))
    turn = fmbd.angle(hinge)

    def law(t: float, y: Any, z: Array) -> Any:
        calls.append(t)
        x, v = y["s"][0], y["rate"][0]
        return -10 * (x + 0.5) - 2 * v - 8 * z[0], (20 * v - 10 * abs(v) * z[0] - 5 * v * abs(z[0]),)

    reads = {"s": turn, "rate": fmbd.joint_rate(turn)}
    scene.add(door, hinge, fmbd.controller("closer", reads=reads, acts=turn, law=law, memory=(0.0,)))
    return scene


def test_a_law_with_memory_is_not_asked_twice_for_the_same() -> None:
    """Of a step of one iteration: the effort (3 calls), its slopes (3), and once more at its end, from the memory found (2)."""
    counts = []
    for n in (20, 40):
        calls: list[float] = []
        fmbd.solve(closer(calls), t_end=n * 1e-3, dt=1e-3)
        counts.append(len(calls))
    assert counts[1] - counts[0] <= 8 * 20


def test_many_readings_take_one_call_each_in_a_step() -> None:
    """Six arms under one law of their angles and rates: its value, and a call for each of the twelve readings."""
    scene, calls, reads, acts = fmbd.Scene("arms", gravity=(0, -9.81)), [], {}, []
    for i in range(6):
        arm = fmbd.RigidBody(f"arm {i}", 1.0, 0.1, position=(2.0 * i + 0.5, 0.0))
        hinge = fmbd.revolute(f"hinge {i}", fmbd.ground, arm, center=(2.0 * i, 0.0))
        scene.add(arm, hinge)
        acts.append(fmbd.angle(hinge))
        reads |= {f"s{i}": acts[i], f"v{i}": fmbd.joint_rate(acts[i])}

    def law(t: float, y: Any, z: Any) -> Any:
        calls.append(t)
        return [20 * (0.3 * np.sin(t) - y[f"s{i}"][0]) - 2 * y[f"v{i}"][0] for i in range(6)]

    scene.add(fmbd.controller("all", reads=reads, acts=acts, law=law))
    counts = []
    for n in (20, 40):
        calls.clear()
        assert fmbd.solve(scene, t_end=n * 5e-3, dt=5e-3).counters["compiled_steps"] == n
        counts.append(len(calls))
    assert counts[1] - counts[0] <= 15 * 20


def wheels_in_a_satellite(law: Any) -> fmbd.Scene:
    """Three wheels that a law of the body's angular velocity turns."""
    scene, hinges, spin = fmbd.Scene("satellite"), [], (0.1, -0.05, 0.08)
    body = fmbd.RigidBody("body", 100.0, (10.0, 12.0, 8.0), angular_velocity=spin)
    scene.add(body)
    for k, axis in enumerate(np.eye(3)):
        wheel = fmbd.RigidBody(f"wheel {k}", 1.0, (0.02, 0.02, 0.02), 0.3 * axis, angular_velocity=spin)
        hinges.append(fmbd.revolute(f"hinge {k}", body, wheel, center=0.3 * axis, axis=axis))
        scene.add(wheel, hinges[-1])
    acts = [fmbd.angle(hinge) for hinge in hinges]
    scene.add(fmbd.controller("damper", reads={"w": fmbd.angular_velocity(body)}, acts=acts, law=law))
    scene.sensor("w", fmbd.angular_velocity(body))
    return scene


def test_motions_are_read_once_for_all_that_a_law_acts_on() -> None:
    """Each effort asked for the motions anew, with some sixty calls of NumPy's: 740 calls of Python a step."""
    counts = []
    for n in (20, 40):
        scene = wheels_in_a_satellite(lambda t, y, z: 2.0 * y["w"])
        counts.append(calls_of(lambda n=n, scene=scene: fmbd.solve(scene, t_end=n * 0.02, dt=0.02)))  # type: ignore[misc]
    assert counts[1] - counts[0] <= 300 * 20


def test_a_law_may_write_on_what_it_reads() -> None:
    def scaling(t: float, y: Any, z: Any) -> Any:
        y["w"] *= 2.0
        return y["w"]

    ends = [
        fmbd.solve(wheels_in_a_satellite(law), t_end=0.2, dt=0.02)["w"][-1]
        for law in (scaling, lambda t, y, z: 2.0 * y["w"])
    ]
    assert np.array_equal(*ends)


@pytest.mark.parametrize("every", [None, 0.02])
def test_memory_survives_checkpoints_and_steps_taken_back(every: float | None, tmp_path: Any) -> None:
    n, dt = 60, 5e-3
    whole = fmbd.solve(arm(every), t_end=n * dt, dt=dt)
    fmbd.solve(arm(every), t_end=n * dt, dt=dt, checkpoint=fmbd.Checkpoint(tmp_path, every=31, keep=9))
    middle = next(p for p in tmp_path.iterdir() if p.name.endswith("step31"))
    again = fmbd.solve(arm(every), t_end=n * dt, dt=dt, restart=middle)
    assert np.array_equal(again["elbow"], whole["elbow"])
    with fmbd.stepper(arm(every), dt=n * dt / n) as s:
        for k in range(n):
            if k % 7 == 3:
                kept = s.save()
                for _ in range(5):
                    s.step()
                s.restore(kept)
            s.step()
            # read in NumPy, not in C
            assert s["elbow torque"] == pytest.approx(whole["elbow torque"][k + 1], rel=1e-13)


def crossed() -> fmbd.Scene:
    """A law of the user's own: reads one hinge, the tip and its velocity, acts on both hinges, filters with a memory."""
    scene = arm()
    for name in ("shoulder motor", "elbow motor"):
        del scene.forces[name]  # and the sensor of its torque
    hinges = [scene.joints[n] for n in ("shoulder", "elbow")]

    def law(t: float, y: dict[str, Array], z: Array) -> tuple[Any, Any]:
        u = (30 * (0.3 - y["phi"][0]) + 5 * z[0], -4 * y["tip"][1] - 2 * y["fast"][0] - 3 * y["rate"][0])
        return u, (y["tip"][0] - 3 * z[0],)

    tip = scene.bodies["two"]
    reads = {
        "phi": fmbd.angle(hinges[0]),
        "rate": fmbd.joint_rate(fmbd.angle(hinges[0])),
        "tip": fmbd.position(tip, point=(2, 0)),
        "fast": fmbd.velocity(tip),
    }
    acts = [fmbd.angle(h) for h in hinges]
    scene.add(fmbd.controller("crossed", reads=reads, acts=acts, law=law, memory=(0.1,)))
    return scene


def test_newton_sees_the_exact_tangent() -> None:
    """Damping part against differences in all velocities, across joints and markers."""
    motion = Motion(crossed(), size=0.2)
    s, dv = motion.system, motion.direction()
    ev = s.at(motion.t, motion.q, motion.v)
    force = lambda v: -ev.spread(s.at(motion.t, motion.q, v).wrenches())  # noqa: E731
    D = np.asarray(force_tangent(ev, 1.0, 0.0).core)
    rate = first(lambda e: force(motion.v + e * dv))
    assert np.abs(rate).max() > 0.3
    assert np.abs(D @ dv - rate).max() < 1e-6 * np.abs(rate).max()


def test_a_tangent_of_state_feedback_makes_its_blocks_together() -> None:
    """Of 12 torques by 24 readings: one product for each pair of markers was 2446 calls of NumPy."""
    N, bodies = 12, [fmbd.ground]
    scene = fmbd.Scene("tower", gravity=(0, -G))
    for i in range(N):
        bodies.append(fmbd.RigidBody(f"link {i}", 1.0, 0.1, position=(0, i + 0.5)))
        scene.add(bodies[-1], fmbd.revolute(f"hinge {i}", *bodies[-2:], center=(0, i)))
    acts = [fmbd.angle(hinge) for hinge in scene.joints.values()]
    reads = {f"angle {i}": a for i, a in enumerate(acts)} | {
        f"rate {i}": fmbd.joint_rate(a) for i, a in enumerate(acts)
    }
    gains = np.sin(np.arange(2.0 * N * N)).reshape(N, 2 * N)
    law = lambda t, y, z: gains @ np.concatenate([y[name] for name in reads])
    scene.add(fmbd.controller("feedback", reads=reads, acts=acts, law=law))
    motion = Motion(scene, size=0.2)
    ev = motion.system.at(motion.t, motion.q, motion.v)
    assert calls_of(lambda: ev.system.forces[0].tangent(ev.kin, 0.0), "numpy") < 500
    hinged = np.kron(np.eye(N) - np.eye(N, k=-1), [0.0, 0.0, 1.0])  # angles by turns of links
    D = np.asarray(force_tangent(ev, 1.0, 0.0).core)
    assert np.abs(D + hinged.T @ gains[:, N:] @ hinged).max() < 1e-7


def test_slopes_of_efforts_have_the_memory_going_along() -> None:
    """By few calls of the law, which is solved with its memory once: against differences of what is solved for each reading."""
    calls = 0

    def law(t: float, y: Any, z: Any) -> Any:
        nonlocal calls
        calls += 1
        s, v = y["s"][0], y["v"][0]
        return 3 * z[0] * s - v * z[1], (np.sin(s) - z[0], v - z[1] ** 3)

    link = fmbd.RigidBody("link", 1.0, 0.1, position=(0.5, 0), angular_velocity=0.7)
    hinge = fmbd.revolute("hinge", fmbd.ground, link, center=(0, 0))
    reads = {"s": fmbd.angle(hinge), "v": fmbd.joint_rate(fmbd.angle(hinge))}
    scene = fmbd.Scene("link")
    scene.add(link, hinge, fmbd.controller("own", reads=reads, acts=fmbd.angle(hinge), law=law, memory=(0.3, 0.4)))
    loads: Any = scene.build()[0].forces[0]
    loads.kept = replace(loads.kept, t=0.0, rate=np.array([0.1, -0.2]))
    y = np.array([0.4, 0.7])
    calls = 0
    found = loads.law.slopes(0.01, y, loads.spans)
    assert calls < 18
    for unit, slope in zip(np.eye(2), found[0], strict=True):
        expected = first(lambda e, unit=unit: loads.law.with_memory(0.01, y + e * unit)[0])
        assert abs(slope - expected[0]) < 1e-7 * abs(slope)


def three_links(dim: int, law: Any, rod: Any = None) -> fmbd.Scene:
    """Three links, the first is ``rod`` where given; the law acts on the outer hinges and reads both and the tip."""
    scene, hinges = fmbd.Scene("links", gravity=(0.0, -G, 0.0)[:dim]), []
    before: Any = fmbd.ground
    for i in range(3):
        link: Any = fmbd.RigidBody(f"link {i}", 1.0, 0.1 if dim == 2 else (0.02, 0.1, 0.11), (i + 0.5, 0.0, 0.0)[:dim])
        sides: Any = before, link
        if rod is not None and i == 0:
            link, sides = rod, (before, rod.surface("pin"))
        elif rod is not None and i == 1:
            sides = rod.surface("tip"), link
        axis: Any = {} if dim == 2 else {"axis": (0.1, 0.2 * (-1) ** i, 1.0)}
        hinges.append(fmbd.revolute(f"hinge {i}", *sides, center=(float(i), 0.0, 0.0)[:dim], **axis))
        scene.add(link, hinges[-1])
        before = link
    one, last = fmbd.angle(hinges[0]), fmbd.angle(hinges[2])
    reads: Any = {"a": one, "b": last, "a'": fmbd.joint_rate(one), "b'": fmbd.joint_rate(last)}
    reads |= {"tip": fmbd.position(before), "v": fmbd.velocity(before), "w": fmbd.angular_velocity(before)}
    reads["turn"] = fmbd.sensors.rotation(before)
    scene.add(fmbd.controller("across", reads=reads, acts=(one, last), law=law))
    scene.sensor("tip", fmbd.position(before))
    return scene


def across(k: float, c: float) -> Any:
    """A spring and a damper between two coordinates."""

    def law(t: float, y: dict[str, Array], z: Array) -> tuple[float, float]:
        force = float(k * (y["a"][0] - y["b"][0]) + c * (y["a'"][0] - y["b'"][0]))
        return -force, force

    return law


def lifted(k: float, c: float) -> Any:
    """Efforts by the place, the velocity and the turning of the tip, which are no coordinate of theirs."""
    return lambda t, y, z: (
        -k * y["tip"][1] - c * y["v"][1],
        -c * y["w"][-1] - 0.1 * k * y["turn"][min(3, len(y["turn"]) - 1)],
    )


@pytest.mark.parametrize("where", ["plane", "space", "reduced"])
def test_newton_sees_what_efforts_answer_to_beside_their_coordinates(where: str, rod_mesh: Any) -> None:
    """Stiffness and damping between hinges, or of a marker: few iterations, no halves, one factor a step, the motion of NumPy."""
    rod = reduced_rod(rod_mesh) if where == "reduced" else None
    dim, n, dt = 3 if where == "space" else 2, 5, 1e-3
    for law in (
        across(1e3, 1.0),
        across(1e6, 1e2),
        across(1e9, 0.0),
        across(0.0, 1e6),
        lifted(1e6, 1e3),
    ):
        both = [
            fmbd.solve(three_links(dim, law, rod), t_end=n * dt, dt=dt, scheme=fmbd.GeneralizedAlpha(compiled=how))
            for how in (True, False)
        ]
        for run in both:
            assert run.counters["newton_iterations"] <= 3 * n
            assert run.counters.get("halved_steps", 0) == 0
        assert both[0].counters["compiled_steps"] == n
        assert both[0].counters["core_factorisations"] <= n + 4
        np.testing.assert_allclose(both[0]["tip"], both[1]["tip"], atol=1e-9)


@pytest.mark.parametrize("scheme", [fmbd.Radau(rtol=1e-4), fmbd.BDF(rtol=1e-4)], ids=["radau", "bdf"])
def test_schemes_with_error_control_see_it_too(scheme: Any) -> None:
    run = fmbd.solve(three_links(2, across(1e7, 1e3)), t_end=0.02, scheme=scheme)
    assert run.counters["newton_iterations"] <= 4 * run.counters["steps"]


def all_of_it(t: float, y: dict[str, Array], z: Array) -> tuple[float, float]:
    """Efforts that answer to every number that is read, bent ones too."""
    numbers = np.concatenate(list(y.values()))
    return float(np.sin(numbers) @ (1.0 + np.arange(len(numbers)))), float(numbers @ numbers)


def reduced_rod(rod_mesh: Any) -> Any:
    elastic = fmbd.materials.plane_stress(5e8, 0.3)
    return fmbd.FloatingBody("rod", rod_mesh(2, 0.1), density=1000.0, elastic=elastic).reduced(modes=4)


@pytest.mark.compiled
@pytest.mark.parametrize("where", ["plane", "space", "reduced"])
def test_stages_see_how_efforts_answer_to_all_that_is_read(where: str, rod_mesh: Any) -> None:
    """Sparse tangents with the slopes of a law, asked for once, beside dense ones by differences of the law."""
    rod, dim = reduced_rod(rod_mesh) if where == "reduced" else None, 3 if where == "space" else 2
    _, system, at = pair_of(lambda: three_links(dim, all_of_it, rod))
    eq, state, mult = equations(system, fmbd.GGL(), at)
    found: Any = eq.tangents
    made = with_arrays(found, eq.refresh(state, mult))
    eq.tangents = with_dense_matrices(eq)
    wanted = eq.refresh(state, mult)
    for name in ("by_q", "by_v"):
        exact = getattr(wanted, name)
        assert np.abs(getattr(made, name) - exact).max() < 1e-5 * np.abs(exact).max(), name


@pytest.mark.compiled
@pytest.mark.parametrize("dim", [2, 3])
def test_complex_matrices_have_what_efforts_answer_to(dim: int, rod_mesh: Any) -> None:
    """As stages of bodies with fields ask for them: motions are those of NumPy, whose efforts do not turn."""
    elastic = fmbd.materials.linear_elastic(5e8, 0.3) if dim == 3 else fmbd.materials.plane_stress(5e8, 0.3)
    rod = fmbd.FloatingBody("rod", rod_mesh(dim, 0.5), density=1000.0, elastic=elastic)
    law = lambda t, y, z: tuple(1e6 * x for x in all_of_it(t, y, z))  # noqa: E731
    system, start, _ = three_links(dim, law, rod).build()
    rng, s, found = np.random.default_rng(3), 300.0 + 400.0j, []
    v, b = rng.normal(size=system.n_v), rng.normal(size=(2, system.n_v))
    for states in (None, driver_states(system)):
        if states is not None:
            system.evaluate_by(states)
        solver = StepSolver(system)
        solver.prepare(system.at(0.3, start.q, v), Weights(1.0, 1.0 / s, 1.0 / s**2))
        assert (solver.driver is not None and solver.driver.ready) == (states is not None)
        found.append(solver.solve(b[0] + 1j * b[1], np.zeros(system.n_lam, complex))[0])
    assert found[1] == pytest.approx(found[0], rel=0, abs=1e-6 * np.abs(found[0]).max())


@pytest.mark.compiled
def test_a_law_is_entered_once_for_each_stage_and_each_reading() -> None:
    """Three stages of some two iterations each, and at times the slopes, for two efforts that answer to other bodies."""
    most = {fmbd.Radau(rtol=None): 15, fmbd.BDF(rtol=None): 8, fmbd.EnergyMomentum(): 15, fmbd.Rattle(): 12}
    for scheme, calls in most.items():
        entered, counts = 0, []

        def law(t: float, y: Any, z: Any) -> tuple[float, float]:
            nonlocal entered
            entered += 1
            return across(1e2, 1.0)(t, y, z)

        for n in (10, 20):
            scene, entered = three_links(2, law), 0
            python = calls_of(lambda s=scene, n=n, how=scheme: fmbd.solve(s, t_end=n * 2e-3, dt=2e-3, scheme=how))  # type: ignore[misc]
            counts.append((entered, python))
        (few, less), (many, more) = counts
        assert many - few <= 10 * calls, scheme.name
        assert more - less <= 10 * 16 * calls, scheme.name


def braked_chain(count: int, effort: Any, *, controlled: bool) -> fmbd.Scene:
    """Links whose hinges have efforts N(s, s', t) against the motion, by laws or by controllers."""
    scene, before = fmbd.Scene("chain", gravity=(0, -G)), fmbd.ground
    for i in range(count):
        link: Any = fmbd.RigidBody(f"link {i}", 0.1, 0.001, position=(0.1 * i + 0.05, 0.0))
        hinge = fmbd.revolute(f"hinge {i}", before, link, center=(0.1 * i, 0.0))
        on, before = fmbd.angle(hinge), link
        scene.add(link, hinge)
        if controlled:
            law = lambda t, y, z: -effort(y["s"][0], y["v"][0], t)  # noqa: E731
            reads = {"s": on, "v": fmbd.joint_rate(on)}
            scene.add(fmbd.controller(f"brake {i}", reads=reads, acts=on, law=law))
        else:
            scene.add(fmbd.joint_spring(f"brake {i}", on, law=effort))
    return scene


@pytest.mark.compiled
@pytest.mark.parametrize("controlled", [False, True], ids=["laws", "controllers"])
def test_steep_laws_are_crossed_by_stages(controlled: bool) -> None:
    """Brakes that stick within 1e-6 rad/s, and a motor of 1e6 N m/rad between its limits, 4e-7 rad apart."""

    def brake(s: float, v: float, t: float) -> float:
        return 0.02 * float(np.tanh(v / 1e-6))

    def motor(s: float, v: float, t: float) -> float:
        return float(np.clip(1e6 * (s - 0.3 * (1.0 - np.cos(9.0 * t))) + 2e4 * v, -0.2, 0.2))

    for count, effort, stages, t_end, most in ((4, brake, 2, 0.4, 3.5), (1, motor, 3, 0.2, 2.5)):
        scene = braked_chain(count, effort, controlled=controlled)
        done = fmbd.solve(scene, t_end=t_end, dt=t_end / 100, scheme=fmbd.Radau(stages=stages, rtol=None)).counters
        assert done["newton_iterations"] <= most * 100
        assert done["halved_steps"] == 0


def test_controller_of_the_users_own_runs() -> None:
    coarse, fine = (fmbd.solve(crossed(), t_end=0.4, dt=dt) for dt in (5e-3, 2.5e-3))
    assert np.abs(coarse["elbow"] - fine["elbow"][::2]).max() < 2e-3
    assert coarse.counters["newton_iterations"] < 4 * coarse.counters["steps"]


def test_a_law_of_the_users_own_is_asked_by_compiled_steps() -> None:
    """Coordinates, rates, places and velocities, two efforts, a memory: the same motion, and steps that are taken back."""
    runs = [
        fmbd.solve(crossed(), t_end=0.2, dt=2e-3, scheme=fmbd.GeneralizedAlpha(compiled=how)) for how in (True, False)
    ]
    assert runs[0].counters["compiled_steps"] == 100
    np.testing.assert_allclose(runs[0]["elbow"], runs[1]["elbow"], atol=1e-6 * np.abs(runs[1]["elbow"]).max())
    with fmbd.stepper(crossed(), dt=2e-3) as s:
        for _ in range(20):
            s.step()
        kept, found = s.save(), []
        for _ in range(2):
            s.restore(kept)
            for _ in range(30):
                s.step()
            found.append(s["elbow"][0])
    assert found[0] == found[1]
    assert abs(found[0] - runs[0]["elbow"][50, 0]) < 1e-7


def test_a_stiff_memory_is_solved_for() -> None:
    """z' = 3e3 (y - z) in steps of 2 ms, which inserting z in its own rule does not find."""
    scene = arm()
    for name in ("shoulder motor", "elbow motor"):
        del scene.forces[name]  # and the sensor of its torque
    phi = fmbd.angle(scene.joints["elbow"])
    law = lambda t, y, z: (-z[0], (3e3 * (5 * y["phi"][0] - z[0]),))  # noqa: E731
    scene.add(fmbd.controller("late", reads={"phi": phi}, acts=phi, law=law, memory=(0.0,)))
    run = fmbd.solve(scene, t_end=0.2, dt=2e-3)
    exact = fmbd.solve(scene, t_end=0.2, scheme=fmbd.Radau(rtol=1e-7), output=fmbd.Output(times=(0.1, 0.2)))
    assert np.abs(run["elbow"][[50, 100]] - exact["elbow"][-2:]).max() < 1e-3 * np.abs(exact["elbow"]).max()
    assert run.counters["compiled_steps"] == 100


def test_a_limit_binds_and_the_integral_does_not_wind_up() -> None:
    wheel = fmbd.RigidBody("wheel", 1.0, 0.5)
    hinge = fmbd.revolute("hinge", fmbd.ground, wheel, center=(0, 0))
    found = {}
    for limit in (0.5, np.inf):
        scene = fmbd.Scene("wheel")
        motor = fmbd.pid("motor", fmbd.angle(hinge), target=1.0, gains=(4.0, 3.0, 2.5), limit=limit)
        scene.add(wheel, hinge, motor)
        scene.sensor("phi", fmbd.angle(hinge))
        scene.sensor("effort", fmbd.element_effort(motor))
        found[limit] = fmbd.solve(scene, t_end=8.0, dt=2e-2)
    assert found[0.5]["effort"].max() <= 0.5
    assert found[np.inf]["effort"].max() > 3.0
    assert abs(found[0.5]["phi"][-1, 0] - 1.0) < 0.1
    assert found[0.5]["phi"].max() < 1.5


def test_a_reading_has_no_rate_behind_its_value() -> None:
    scene = arm()
    elbow = fmbd.angle(scene.joints["elbow"])
    scene.add(fmbd.controller("hold", reads={"x": elbow}, acts=elbow, law=lambda t, y, z: -y["x"][0] - y["x"][1]))
    with pytest.raises(LawError, match=r'"hold" failed.*IndexError.*"x" 1; a memory, 0\. The rate .* fmbd\.joint_rate'):
        fmbd.solve(scene, t_end=0.01, dt=1e-3)


def test_bad_input_is_named() -> None:
    scene = arm()
    shoulder = fmbd.angle(scene.joints["shoulder"])
    for options, what in (
        ({"reads": {"phi": 3}, "acts": shoulder, "law": lambda *x: 0}, "expected a sensor"),
        ({"reads": {}, "acts": (), "law": lambda *x: 0}, "acts must hold"),
        ({"reads": {}, "acts": shoulder, "law": 3.0}, "law .* must be a function"),
        ({"reads": {}, "acts": shoulder, "law": lambda *x: 0, "every": 0.0}, "must be > 0"),
        ({"reads": {"f": fmbd.reaction("elbow")}, "acts": shoulder, "law": lambda *x: 0}, "Sample it"),
    ):
        with pytest.raises(InputError, match=what):
            fmbd.controller("c", **options)
    stranger = fmbd.revolute("elbo", fmbd.ground, scene.bodies["one"], center=(0, 0))
    scene.add(fmbd.pid("c", fmbd.angle(stranger), target=0.0, gains=(1, 0, 0)))
    with pytest.raises(
        InputError, match='Controller "c" uses joint "elbo", which is not in the scene. Did you mean "elbow"'
    ):
        scene.build()


@pytest.mark.parametrize(
    ("law", "memory", "what"),
    [
        (lambda t, y, z: (1.0, 2.0), (), "expected 1 finite efforts"),
        (lambda t, y, z: 1.0, (0.0,), r"must return \(efforts, rate of the memory\)"),
        (lambda t, y, z: (1.0, (1.0, 2.0)), (0.0,), "expected 1 finite numbers of the memory"),
        (lambda t, y, z: np.nan, (), "finite efforts"),
        (lambda t, y, z: "much", (), "expected 1 efforts"),
    ],
)
def test_a_law_of_wrong_shape_is_named(law: Any, memory: tuple[float, ...], what: str) -> None:
    scene = arm()
    acts = fmbd.angle(scene.joints["shoulder"])
    scene.add(fmbd.controller("wrong", reads={"phi": acts}, acts=acts, law=law, memory=memory))
    with pytest.raises(CallbackError, match=what) as error:
        fmbd.solve(scene, t_end=0.01, dt=0.01)
    assert 'Controller "wrong"' in str(error.value)


@pytest.mark.parametrize("every", [None, 0.02])
def test_a_law_may_return_its_empty_memory(every: float | None) -> None:
    """With and without (): the same motion."""
    ends = []
    for back in (lambda u: u, lambda u: (u, ())):
        arm = fmbd.RigidBody("arm", 1.0, 0.1, position=(0.5, 0.0))
        pin = fmbd.revolute("pin", fmbd.ground, arm, center=(0, 0))
        scene = fmbd.Scene("arm", gravity=(0, -9.81))
        given = {"reads": {"phi": fmbd.angle(pin)}, "acts": fmbd.angle(pin), "every": every}
        scene.add(arm, pin, fmbd.controller("c", law=lambda t, y, z, back=back: back(3.0 - 5 * y["phi"][0]), **given))
        scene.sensor("phi", fmbd.angle(pin))
        ends.append(fmbd.solve(scene, t_end=0.2, dt=0.01)["phi"][-1, 0])
    assert ends[0] == ends[1] != 0.0


def test_slopes_of_a_memory_serve_the_step() -> None:
    """Two numbers that answer to each other, asked at three instants of a step: their slopes are looked for once."""
    A, asked = np.array([[-3.0, 40.0], [-40.0, -5.0]]), []

    def law(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        asked.append(z)
        return z[:1], A @ z + 1.0

    kept = ControllerMemory(0.0, np.array([0.1, -0.2]), A @ [0.1, -0.2] + 1.0, np.zeros(1), 0)
    within = StepMemory("law", kept)
    counts = []
    for t in (0.01, 0.02, 0.03):
        _, z, _ = within.at(t, law, None)
        assert z == pytest.approx(np.linalg.solve(np.eye(2) - t / 2 * A, kept.z + t / 2 * (kept.rate + 1.0)), rel=1e-13)
        counts.append(len(asked))
        asked.clear()
    assert max(counts[1:]) <= 4
    assert counts[0] <= 8


def test_bearing_friction_that_follows_its_reaction() -> None:
    """mu r |F| of a pendulum's pin, sampled, against its equation: of first order in the period, see docs/howto.md."""
    m, out, J, moment, slow = 2.0, 0.5, 0.1, 0.3 * 0.05, 0.01

    def swing(t: float, y: Array) -> list[float]:
        angle, w = y
        along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        drive, bent = -m * G * out * np.cos(angle), moment * np.tanh(w / slow)
        alpha = drive / (J + m * out**2)
        for _ in range(60):  # friction and reaction answer to each other
            force = m * (out * (alpha * across - w * w * along) + np.array([0.0, G]))
            alpha = (drive - bent * np.linalg.norm(force)) / (J + m * out**2)
        return [w, alpha]

    def off(period: float) -> float:
        scene = fmbd.Scene("bearing", gravity=(0, -G))
        arm = fmbd.RigidBody("arm", m, J, position=(out, 0))
        pin = fmbd.revolute("pin", fmbd.ground, arm, center=(0, 0))
        law = lambda t, y, z: (-moment * np.linalg.norm(y["force"]) * np.tanh(y["rate"][0] / slow), ())
        turn = fmbd.angle(pin)
        reads = {"force": fmbd.reaction_force(pin), "rate": fmbd.joint_rate(turn)}
        scene.add(arm, pin, fmbd.controller("friction", reads=reads, acts=turn, law=law, every=period))
        scene.sensor("turn", turn)
        run = fmbd.solve(scene, t_end=0.5, dt=period)
        return float(np.abs(run["turn"][:, 0] - exact.sol(run.times)[0]).max())

    exact = solve_ivp(swing, (0.0, 0.5), (0.0, 0.0), method="LSODA", rtol=1e-9, atol=1e-10, dense_output=True)
    coarse, fine = off(2e-3), off(1e-3)
    assert fine < 1.5e-4 and 1.6 < coarse / fine < 2.2, (coarse, fine)
