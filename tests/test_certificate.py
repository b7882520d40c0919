"""Errors that runs state, against true ones; runs that keep a tolerance; given times; scenes made again with finer bodies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from dae_problems import pendulum as point_pendulum
from dae_problems import pendulum_at
from test_field_stages import pendulum

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError, MeshError
from fmbd_fenicsx.materials import neo_hookean
from fmbd_fenicsx.run.accuracy.certificate import KINDS
from fmbd_fenicsx.run.accuracy.orders import order_seen
from fmbd_fenicsx.system.scene.refinement import finer_space, more_modes, refined, refined_by_finer_space, with_bodies

ALL = fmbd.Output(estimate_error=True, estimate_space=True, estimate_reduction=True)
ESTIMATED = fmbd.Output(estimate_error=True)


def loaded(mesh: Any, degree: int = 2, modes: int | None = None) -> fmbd.Scene:
    """A soft rod on a pin whose load grows smoothly: no waves, so that orders are those of the schemes."""
    scene = pendulum(mesh, E=1e6, ramp=0.4)
    rod = scene.bodies["rod"].with_(degree=degree)
    return with_bodies(scene, {"rod": rod if modes is None else rod.reduced(modes=modes)})


def largest(a: fmbd.Run, b: fmbd.Run, every: int = 1) -> float:
    """Largest distance of the tips."""
    return float(np.abs(a["tip"] - b["tip"][::every]).max())


# -- statements against true errors ---------------------------------------------------------------------------------
@pytest.mark.parametrize("degree", [1, 2])
def test_stated_error_in_space(rod_mesh: Callable[..., Any], degree: int) -> None:
    mesh, fine = (rod_mesh(dim=2, h=h, height=0.1) for h in (0.1, 0.05))
    settings: dict[str, Any] = {"t_end": 0.3, "dt": 5e-3}
    run = fmbd.solve(loaded(mesh, degree), output=fmbd.Output(estimate_space=True), **settings)
    true = largest(run, fmbd.solve(loaded(fine, 3), **settings))
    assert 0.5 <= run.certificate["tip"].space / true <= 3.0
    assert "time" in run.certificate.unstated and "space" not in run.certificate.unstated


def test_stated_error_of_time_and_its_sum_with_space(rod_mesh: Callable[..., Any]) -> None:
    mesh = rod_mesh(dim=2, h=0.2, height=0.1)
    run = fmbd.solve(loaded(mesh), t_end=0.3, dt=0.3 / 32, output=ALL)
    same = fmbd.solve(loaded(mesh), t_end=0.3, dt=0.3 / 512)
    exact = fmbd.solve(loaded(rod_mesh(dim=2, h=0.05, height=0.1), 3), t_end=0.3, dt=0.3 / 256)
    s = run.certificate["tip"]
    assert 0.5 <= s.time / largest(run, same, 16) <= 3.0
    assert 0.5 <= s.total / largest(run, exact, 8) <= 3.0
    assert s.sum == pytest.approx(sum(getattr(s, k) for k in KINDS))
    assert s.sum / 3 <= s.total <= s.sum * (1.0 + 1e-12)


@pytest.mark.parametrize("form", [fmbd.Index3(), fmbd.Index1()], ids=lambda f: f.name)
def test_stated_error_of_an_error_controlled_run(form: Any) -> None:
    scheme = fmbd.Radau(3, form, 1e-5)
    times = tuple(np.linspace(0.0, 2.0, 41))
    run = fmbd.solve(point_pendulum(), t_end=2.0, scheme=scheme, output=fmbd.Output(estimate_error=True, times=times))
    exact = fmbd.solve(point_pendulum(), t_end=2.0, scheme=fmbd.Radau(5, rtol=1e-11), output=fmbd.Output(times=times))
    true = float(np.abs(run["x"] - exact["x"]).max())
    assert 0.5 <= run.certificate["x"].time / true <= 3.0


def test_values_between_steps_are_not_taken_for_the_error_of_their_ends() -> None:
    """At the ends of Radau's steps the order is nine, between them five: 20 times the true error was stated."""
    run = fmbd.solve(point_pendulum(), t_end=1.0, scheme=fmbd.Radau(5, rtol=1e-6), output=ESTIMATED)
    exact = np.array([pendulum_at(t)[1] for t in run.times])
    assert 0.5 <= run.certificate["v"].time / float(np.abs(run["v"] - exact).max()) <= 3.0


def test_memories_that_steps_are_not_chosen_by_are_of_their_own_order() -> None:
    """A motor's integral goes by the trapezoidal rule under a scheme of order eight: a tenth of its tolerance leaves half."""
    scene, arm = fmbd.Scene("motor", gravity=(0.0, -9.81)), fmbd.RigidBody("arm", 1.0, 0.05, (0.4, 0.0))
    pin = fmbd.revolute("pin", fmbd.ground, arm, center=(0, 0))
    motor = fmbd.pid("motor", fmbd.angle(pin), target=lambda t: np.sin(2.0 * t), gains=(30.0, 40.0, 3.0))
    scene.add(arm, pin, motor)
    scene.sensor("tip", fmbd.position(arm))
    run = fmbd.solve(scene, t_end=1.0, scheme=fmbd.schemes.ExplicitRungeKutta(1e-7), output=ESTIMATED)
    fine = fmbd.solve(scene, t_end=1.0, dt=1e-3, output=fmbd.Output(times=tuple(run.times)))
    assert 0.8 <= run.certificate["tip"].time / float(np.abs(run["tip"] - fine["tip"]).max()) <= 3.0


def test_statements_in_files(rod_mesh: Callable[..., Any], tmp_path: Any) -> None:
    """The table beside the histories holds the certificate; the figure has a band only where all was stated."""
    run = fmbd.solve(loaded(rod_mesh(dim=2, h=0.5, height=0.1)), t_end=0.1, dt=0.01, output=ALL)
    run.save(tmp_path / "run.csv")
    head, row = (tmp_path / "run.errors.csv").read_text().splitlines()
    found = dict(zip(head.split(","), row.split(","), strict=True))
    assert float(found["space"]) == pytest.approx(run.certificate["tip"].space, rel=1e-5)
    assert float(found["total"]) == pytest.approx(run.certificate["tip"].total, rel=1e-5)

    from matplotlib.figure import Figure

    from fmbd_fenicsx.post.plot import draw_history

    bands = []
    for deviations in (run.deviations, {}):
        axes = Figure().add_subplot()
        draw_history(axes, replace(run, deviations=deviations), "tip")
        bands.append(len(axes.collections))
    assert bands == [2, 0]


# -- given times ----------------------------------------------------------------------------------------------------
def test_values_at_given_times() -> None:
    """Between the ends of steps a value is as good as the scheme: Radau to its tolerance, generalized-alpha of order 2."""
    times = tuple(np.sort(np.random.default_rng(0).uniform(0.0, 1.0, 60)))
    output = fmbd.Output(times=times)
    exact = fmbd.solve(point_pendulum(), t_end=1.0, scheme=fmbd.Radau(5, rtol=1e-11), output=output)

    def errors(**settings: Any) -> np.ndarray:
        run = fmbd.solve(point_pendulum(), t_end=1.0, output=output, **settings)
        assert run.times == pytest.approx(times)
        return np.array([np.abs(run[name] - exact[name]).max() for name in ("x", "v")])

    assert (errors(scheme=fmbd.Radau(3, rtol=1e-8)) < [1e-7, 1e-5]).all()
    ratio = errors(dt=4e-3) / errors(dt=2e-3)
    assert (ratio > 3.5).all() and (ratio < 4.5).all(), ratio


def test_times_that_are_none_are_refused() -> None:
    for times in ((), (0.2, 0.1), (-1.0, 0.5), (np.nan,)):
        with pytest.raises(InputError, match="times .*must be"):
            fmbd.Output(times=times)


# -- tolerance ------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("tol", [1e-2, 1e-3])
def test_a_run_keeps_its_tolerance(rod_mesh: Callable[..., Any], tol: float) -> None:
    run = fmbd.solve(loaded(rod_mesh(dim=2, h=0.5, height=0.1), 1), t_end=0.3, dt=0.03, tol={"tip": tol})
    exact = fmbd.solve(loaded(rod_mesh(dim=2, h=0.05, height=0.1), 3), t_end=0.3, dt=1e-3)
    assert np.abs(run["tip"][-1] - exact["tip"][-1]).max() <= tol
    assert run.certificate["tip"].total <= tol
    assert len(run.history) > (tol < 1e-2) and run.history[-1].then == "done"
    assert f"attempt {len(run.history)}" in run.report() and "certificate" in run.report()


def test_tolerance_of_a_reduced_body_and_of_a_scheme_with_error_control(rod_mesh: Callable[..., Any]) -> None:
    scene = loaded(rod_mesh(dim=2, h=0.25, height=0.1), 2, modes=2)
    run = fmbd.solve(scene, t_end=0.3, dt=0.01, tol={"tip": fmbd.relative(1e-2)})
    assert run.certificate["tip"].share <= 1e-2
    assert run.history[-1].modes > 0

    controlled = fmbd.solve(point_pendulum(), t_end=1.0, scheme=fmbd.Radau(3), tol={"x": 1e-7})
    exact = fmbd.solve(point_pendulum(), t_end=1.0, scheme=fmbd.Radau(5, rtol=1e-12))
    assert np.abs(controlled["x"][-1] - exact["x"][-1]).max() <= 1e-7


def test_a_tolerance_that_cannot_be_kept_gives_the_best_run(rod_mesh: Callable[..., Any], caplog: Any) -> None:
    scene = loaded(rod_mesh(dim=2, h=0.5, height=0.1), 3)
    body = scene.bodies["rod"]
    fixed = with_bodies(scene, {"rod": body.with_(mesh=replace(body.mesh, recipe=None), degree=2)})
    run = fmbd.solve(fixed, t_end=0.1, dt=0.01, tol={"tip": 1e-9})
    assert run.certificate["tip"].total > 1e-9 and run.history
    assert "was not reached" in caplog.text


def test_an_error_in_space_that_is_not_known_is_no_singular_corner(rod_mesh: Callable[..., Any], caplog: Any) -> None:
    """At the highest degree, of a mesh that cannot be refined, it was said that the sensor sees one."""
    scene = loaded(rod_mesh(dim=2, h=0.25, height=0.1), 2)
    body = scene.bodies["rod"]
    fixed = with_bodies(scene, {"rod": body.with_(mesh=replace(body.mesh, recipe=None))})
    run = fmbd.solve(fixed, t_end=0.1, dt=1e-3, tol={"tip": 1e-7})
    assert run.history[-1].meshes == 1
    assert "not known once the meshes were refined: no finer space" in caplog.text and "corner" not in caplog.text


def test_a_form_that_holds_the_coarse_mesh_is_told_when_that_is_refined(rod_mesh: Callable[..., Any]) -> None:
    """It was "KeyError: Mesh(...)"."""
    import ufl

    scene = loaded(rod_mesh(dim=2, h=0.25, height=0.1), 2)
    body = scene.bodies["rod"]
    mesh, law = body.mesh, body.elastic

    def graded(u: Any, v: Any, dx: Any) -> Any:
        stiffer = 1.0 + ufl.SpatialCoordinate(mesh.dolfinx)[0]
        return law(stiffer * u, v, dx) + law(u, stiffer * v, dx)

    held = with_bodies(scene, {"rod": body.with_(elastic=graded)})
    with pytest.raises(InputError, match="coordinates or functions of another mesh.*SpatialCoordinate"):
        refined(held).build()


@pytest.mark.parametrize(
    ("tol", "message"),
    [
        ({"tipp": 1e-3}, 'no sensor "tipp"'),
        ({"x y": 1e-3}, 'no sensor "x y". A tolerance holds for all components of a sensor: tol={"x": 0.001}'),
        ({"x": 0.0}, "positive number in"),
        ({"x": -1.0}, "positive number"),
        ({"x": "fine"}, "positive number"),
        ({"x": 1e-16}, "below what roundoff allows"),
        ({}, "must name a sensor"),
    ],
)
def test_tolerances_that_are_none(tol: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        fmbd.solve(point_pendulum(), t_end=0.1, dt=0.01, tol=tol)


def test_a_sensor_without_unit_takes_a_share_of_its_range() -> None:
    section = fmbd.Section.rectangle(youngs_modulus=2e9, poisson_ratio=0.3, density=1e3, width=0.02, height=0.02)
    beam = fmbd.Beam("beam", (0.0, 0.0), (1.0, 0.0), section, elements=2)
    scene = fmbd.Scene("beam", gravity=(0.0, -9.81), gravity_ramp=0.05)
    scene.add(beam, fmbd.fixed("clamp", fmbd.ground, beam.surface("start")))
    scene.sensor("modes", fmbd.sensors.coordinates(beam))
    with pytest.raises(InputError, match='"modes".*has no unit.*relative'):
        fmbd.solve(scene, t_end=0.1, dt=1e-3, tol={"modes": 1e-6})


# -- scenes made again ----------------------------------------------------------------------------------------------
def test_a_scene_with_finer_bodies_shares_nothing_with_the_old_one_but_what_is_equal(
    rod_mesh: Callable[..., Any],
) -> None:
    scene = loaded(rod_mesh(dim=2, h=0.25, height=0.1), 2)
    finer, without = finer_space(scene)
    assert scene.bodies["rod"].degree == 2 and finer.bodies["rod"].degree == 3 and not without
    assert finer.joints["pin"].b.body is finer.bodies["rod"] and scene.joints["pin"].b.body is scene.bodies["rod"]
    halved = refined(scene).bodies["rod"].mesh
    assert halved.recipe.parameters["h"] == 0.125 and halved.dolfinx is not scene.bodies["rod"].mesh.dolfinx

    reduced = loaded(rod_mesh(dim=2, h=0.25, height=0.1), 2, modes=3)
    more = more_modes(reduced, reduced.build()[0]).bodies["rod"]
    assert more.constants.n_modes > 6 and more.source is reduced.bodies["rod"].source
    assert finer_space(reduced)[0].bodies["rod"].source.degree == 3
    with pytest.raises(InputError, match="no reduced body"):
        more_modes(scene, scene.build()[0])
    with pytest.raises(MeshError, match="it was not read by read_gmsh or read_mesh"):
        replace(scene.bodies["rod"].mesh, recipe=None).refined()


def test_spaces_of_nonlinear_energies_are_told_by_smaller_elements_which_serve_again(
    rod_mesh: Callable[..., Any],
) -> None:
    """Cubic ones take three times as long in space, and no attempt is made with them. Linear ones become quadratic."""
    mesh = rod_mesh(dim=3, h=0.3, height=0.2)
    for degree in (1, 2):
        scene = fmbd.Scene("soft")
        scene.add(fmbd.AbsoluteBody("rod", mesh, degree=degree, density=1e3, energy=neo_hookean(1e5, 0.3)))
        finer, without = finer_space(scene)
        body, same = finer.bodies["rod"], refined(scene).bodies["rod"]
        assert refined_by_finer_space(scene) and not without and body.degree == same.degree == 2
        assert body.mesh.recipe.parameters == same.mesh.recipe.parameters


def test_orders_of_nothing_that_falls_are_found() -> None:
    """Steps in any ratio: (1) of ``order_seen`` has no order where differences do not fall, and no division where they vanish."""
    for steps in ((10, 20, 40), (10, 30, 50), (3, 1000, 1_000_000)):
        a, b, c = (float(n) ** -2.0 for n in steps)
        assert order_seen(*steps, (a - b) / (b - c)) == pytest.approx(2.0, rel=1e-6)
    assert order_seen(3, 1000, 1_000_000, 1e300) > 50.0
    assert order_seen(10, 30, 50, 1e-9) < 1e-6


@pytest.mark.parametrize(("shift", "told"), [(0.0, True), (0.5, False)])
@pytest.mark.parametrize("compiled", [True, False])
def test_records_that_impacts_are_too_near_to_are_named(
    shift: float, told: bool, compiled: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A slider on a spring hits its stop at 2 pi / 3 s within what the steps leave of a record: nothing told that its velocity
    there was that of the other side.
    """
    run = at_a_stop(fmbd.Moreau(), 100.0 + shift, compiled, monkeypatch)
    assert set(run.certificate.uncertain) == ({"v"} if told else set())
    if told:
        assert "may be from the other side" in run.certificate.uncertain["v"]
        assert run.struck["v"] == pytest.approx((2.0 * np.pi / 3.0, 1.7 * 0.2 * np.sqrt(0.75)), rel=0.02)


@pytest.mark.parametrize("compiled", [True, False])
def test_records_beside_impacts_within_steps_are_named(compiled: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Impacts that steps take in their middle are known to half a step: others agreed, and were off by the jump too."""
    run = at_a_stop(fmbd.Moreau(impacts=0), 100.85, compiled, monkeypatch)
    row = run.times.searchsorted(2.0 * np.pi / 3.0)
    assert run["v"][row, 0] < 0.0  # it has been hit
    assert run.struck["v"] == pytest.approx((run.times[row], 1.7 * 0.2 * np.sqrt(0.75)), rel=0.02)
    assert "may be from the other side" in run.certificate.uncertain["v"]


def at_a_stop(scheme: Any, steps: float, compiled: bool, monkeypatch: pytest.MonkeyPatch) -> fmbd.Run:
    """A slider on a spring, by so many steps up to where it hits its stop, and a fifth more."""
    if not compiled:
        monkeypatch.setattr("fmbd_fenicsx.schemes.impacts.compiled.driver.contact_driver", lambda *_, **__: None)
    body = fmbd.RigidBody("slider", 1.0, 1.0, (0.2, 0.0))
    rail = fmbd.prismatic("rail", fmbd.ground, body, axis=(1, 0), center=(0.2, 0))
    s = fmbd.displacement(rail) + 0.2
    scene = fmbd.Scene("at a stop")
    scene.add(body, rail, fmbd.joint_spring("spring", s, stiffness=1.0))
    scene.add(fmbd.joint_limit("stop", fmbd.displacement(rail), lower=-0.3, restitution=0.7))
    scene.sensor("s", s)
    scene.sensor("v", fmbd.joint_rate(s))
    dt = 2.0 * np.pi / 3.0 / steps
    output = fmbd.Output(progress=False, energy=False, estimate_error=True)
    return fmbd.solve(scene, t_end=120 * dt, dt=dt, scheme=scheme, output=output)


def test_jumps_on_the_way_get_steps_that_end_there() -> None:
    """A mass on a spring, pulled from 0.5 s on: with equal steps the error depends on where the jump falls in a step."""
    scene = fmbd.Scene("step", breakpoints=(0.5,))
    body = fmbd.RigidBody("mass", 1.0, 0.1, (1.0, 0.0))
    scene.add(body, fmbd.prismatic("guide", fmbd.ground, body, axis=(1, 0), center=(0, 0)))
    scene.add(fmbd.Spring("spring", fmbd.ground, body, stiffness=100.0, length=1.0))
    scene.add(fmbd.force("pull", body, lambda t: (10.0 * (t >= 0.5), 0.0)))
    scene.sensor("mass", fmbd.position(body))
    run = fmbd.solve(scene, t_end=0.8, tol={"mass": 2e-5})
    exact = 1 + np.where(run.times > 0.5, 0.1 * (1 - np.cos(10 * (run.times - 0.5))), 0.0)
    true = np.abs(run["mass"][:, 0] - exact).max()
    assert run.scheme.rtol is not None and run.history[-1].then == "done"
    assert true < 2e-5 and 0.5 < run.certificate["mass"].total / true < 3.0


def test_forces_without_a_value_in_larger_steps_leave_no_estimate(caplog: pytest.LogCaptureFixture) -> None:
    """A law that has no value as soon as the run has come to its end and another one begins: the run itself stands."""
    scene = fmbd.Scene("once only")
    body = fmbd.RigidBody("body", 1.0, 1.0, (1.0, 0.0))
    scene.add(body, fmbd.prismatic("guide", fmbd.ground, body, axis=(1, 0), center=(0, 0)))
    latest = 0.0

    def push(t: float) -> tuple[float, float]:
        nonlocal latest
        if latest > 0.099 and t < 0.05:
            raise fmbd.errors.InputError("two points coincide")
        latest = max(t, latest)
        return 1.0, 0.0

    scene.add(fmbd.force("push", body, push))
    scene.sensor("x", fmbd.position(body))
    run = fmbd.solve(scene, t_end=0.1, dt=0.01, output=fmbd.Output(estimate_error=True))
    assert run.status == "finished"
    assert not run.error_estimate
    assert "the run with twice the step did not end: " in caplog.text
    assert "two points coincide" in caplog.text


def test_a_run_in_parts_is_told_by_one_in_parts() -> None:
    """Few increments are allowed for friction of 1 mm/s, far less than speeds change by in a step: with 2 h, h and h / 2 some are
    halved.
    """
    scene = fmbd.Scene("sliding")
    block = fmbd.RigidBody("block", 2.0, 0.1, (0.0, 0.0))
    rail = fmbd.prismatic("rail", fmbd.ground, block, axis=(1, 0), center=(0, 0))
    scene.add(block, rail, fmbd.Spring("spring", fmbd.ground, block, (-1, 0), stiffness=80.0, length=0.5))
    scene.add(fmbd.forces.joint_friction("friction", fmbd.displacement(rail), coulomb=6.0, speed=1e-3))
    scene.sensor("x", fmbd.position(block))

    times = tuple(np.linspace(0.0, 2.0, 101))
    exact = fmbd.solve(scene, t_end=2.0, scheme=fmbd.Radau(3, rtol=1e-8), output=fmbd.Output(times=times))["x"]
    newton, output = fmbd.Newton(max_iterations=3), fmbd.Output(estimate_error=True, progress=False)
    run = fmbd.solve(scene, t_end=2.0, dt=0.02, newton=newton, output=output)
    assert run.counters["halved_steps"]
    true = np.abs(run["x"] - exact).max()
    assert 0.5 * true < run.error_estimate["x"] < 3.0 * true
    # no order is seen: what lasts less than a step is passed by in both
    assert "one run with half of it tells the error" in run.certificate.uncertain["x"]


def test_two_tolerances_that_share_a_size_of_steps_tell_no_error() -> None:
    """Steps of a fast top are of one size throughout, for tolerances over more than a decade: a twentieth was stated."""
    spin = (1.0, 0.5, 60.0)
    scene, velocity = fmbd.Scene("fast top", gravity=(0, 0, -9.81)), tuple(np.cross(spin, (0.05, 0.0, 0.3)))
    top = fmbd.RigidBody("top", 1.0, (0.02, 0.02, 0.015), (0.05, 0.0, 0.3), angular_velocity=spin, velocity=velocity)
    scene.add(top, fmbd.spherical("tip", top, fmbd.ground, center=(0, 0, 0)))
    scene.sensor("c", fmbd.position(top))

    times = tuple(np.linspace(0.0, 0.5, 51))
    exact = fmbd.solve(scene, t_end=0.5, scheme=fmbd.Radau(5, rtol=1e-9), output=fmbd.Output(times=times))["c"]
    output, scheme = fmbd.Output(times=times, estimate_error=True), fmbd.GeneralizedAlpha(rtol=1e-3)
    run = fmbd.solve(scene, t_end=0.5, scheme=scheme, output=output)
    assert 0.5 <= run.certificate["c"].time / np.abs(run["c"] - exact).max() <= 3.0

    kept = fmbd.solve(scene, t_end=0.5, scheme=scheme, tol={"c": 1e-3}, output=fmbd.Output(times=times))
    assert kept.history[-1].then == "done" and np.abs(kept["c"] - exact).max() < 1e-3


def test_steps_that_take_samples_late_tell_no_error() -> None:
    """Two steps of a run in each period, half a one of those of four times the size, which follow another motion."""
    scene, arm = fmbd.Scene("sampled", gravity=(0.0, -9.81)), fmbd.RigidBody("arm", 1.0, 1 / 12, (0.5, 0.0))
    pin = fmbd.revolute("pin", fmbd.ground, arm, center=(0, 0))
    scene.add(arm, pin, fmbd.pid("servo", fmbd.angle(pin), target=0.5, gains=(60.0, 20.0, 6.0), every=0.02))
    scene.sensor("speed", fmbd.velocity(arm))
    run = fmbd.solve(scene, t_end=0.4, dt=0.01, output=ESTIMATED)
    fine = fmbd.solve(scene, t_end=0.4, dt=0.01 / 16)
    assert 0.5 <= run.certificate["speed"].time / np.abs(run["speed"] - fine["speed"][::16]).max() <= 3.0
