"""The energy-momentum scheme: order two, energy and momenta to roundoff whatever the step."""

from __future__ import annotations

import numpy as np
import pytest
from dae_problems import march, observed, spinning_top, state_errors

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.linear import condensation
from fmbd_fenicsx.schemes.onestep.conserving.energy_momentum import EnergyMomentumStepper


def spinner(eps: float) -> fmbd.Scene:
    """A point on a spring of stiffness 1 / eps^2 that turns about a fixed point with omega = 1."""
    scene = fmbd.Scene("spinner")
    body = fmbd.RigidBody("mass", 1.0, 1.0, position=(1.0, 0.0), velocity=(0.0, 1.0))
    spring = fmbd.Spring("spring", body, fmbd.ground, point_a=(1, 0), point_b=(0, 0), stiffness=eps**-2, length=1.0)
    scene.add(body, spring)
    return scene


def changes(scene: fmbd.Scene, states: list) -> tuple[float, float]:
    """Largest relative changes of the energy and of the angular momentum."""
    system = scene.build()[0]
    at = [system.at(s.t, s.q, s.v) for s in states]
    E = np.array([sum(ev.energies().values()) for ev in at])
    L = np.array([np.atleast_1d(ev.momenta()[1])[-1] for ev in at])
    return float(np.abs(E / E[0] - 1).max()), float(np.abs(L / L[0] - 1).max())


@pytest.mark.parametrize(("eps", "h"), [(1e-2, 0.2), (1e-2, 0.5), (1e-3, 0.1), (1e-3, 0.5)])
def test_stiff_spring_at_large_steps(eps: float, h: float) -> None:
    """Steps h up to 500 eps; the trapezoidal rule gains a factor of 68, the midpoint rule blows up."""
    scene = spinner(eps)
    states = march(scene, fmbd.EnergyMomentum(), 20.0, round(20 / h), 1e-12)
    assert max(changes(scene, states)) < 1e-12


def test_order_two() -> None:
    found = observed(fmbd.EnergyMomentum(), (40, 80, 160))
    assert (np.abs(found - 2) < 0.15).all(), found


def test_joint_in_space_keeps_energy_and_the_vertical_angular_momentum() -> None:
    scene = spinning_top()
    reference = march(scene, fmbd.Radau(3, fmbd.StateSpace(), None), 0.5, 80)[-1]
    errors = []
    for n in (40, 80):
        states = march(scene, fmbd.EnergyMomentum(), 0.5, n, 1e-12)
        assert max(changes(scene, states)) < 1e-12
        errors.append(state_errors(scene, states[-1], reference)[:2])
    assert (np.abs(np.log2(errors[0] / errors[1]) - 2) < 0.15).all()


def test_hinges_do_no_work() -> None:
    """A spatial double pendulum of two skew hinges: all joint rows are quadratic."""
    scene = fmbd.Scene("double", gravity=(0, 0, -9.81))
    a = fmbd.RigidBody("a", 1.0, (0.1, 0.12, 0.05), position=(0.5, 0, 0))
    b = fmbd.RigidBody("b", 1.0, (0.1, 0.12, 0.05), position=(1.5, 0, 0))
    scene.add(a, b, fmbd.revolute("h1", fmbd.ground, a, center=(0, 0, 0), axis=(0, 1, 0.2)))
    scene.add(fmbd.revolute("h2", a, b, center=(1, 0, 0), axis=(0.3, 1, 0)))
    states = march(scene, fmbd.EnergyMomentum(), 1.0, 20, 1e-12)
    system = scene.build()[0]
    E = np.array([sum(system.at(s.t, s.q, s.v).energies().values()) for s in states])
    kinetic = max(system.at(s.t, s.q, s.v).energies()["kinetic"] for s in states)
    assert kinetic > 5 and np.ptp(E) < 1e-11 * kinetic
    assert max(np.abs(system.at(s.t, s.q).constraint()).max() for s in states) < 1e-12


def test_elastic_fields_are_refused(rod_mesh: object) -> None:
    scene = fmbd.Scene("rod")
    scene.add(
        fmbd.FloatingBody("rod", rod_mesh(), degree=1, density=1000.0, elastic=fmbd.materials.linear_elastic(1e7, 0.3))
    )
    with pytest.raises(InputError, match='absolute coordinates only, and "rod" is not one'):
        fmbd.solve(scene, t_end=0.1, dt=0.1, scheme=fmbd.EnergyMomentum())


def test_usual_steps_need_no_differences(monkeypatch: pytest.MonkeyPatch) -> None:
    """The tangent of the middle of the step solves them; differences cost an evaluation for each unknown."""
    from fmbd_fenicsx.schemes.onestep.conserving import energy_momentum

    scene, before = fmbd.Scene("links", gravity=(0, -9.81)), fmbd.ground
    for i in range(4):
        link = fmbd.RigidBody(f"{i}", 0.1, 1e-3 / 12, ((i + 0.5) * 0.1, 0.0))
        hinge = fmbd.revolute(f"hinge {i}", before, link, center=(i * 0.1, 0))
        scene.add(link, hinge, fmbd.joint_spring(f"spring {i}", fmbd.angle(hinge), stiffness=1.0, damping=0.01))
        before = link
    scene.sensor("tip", fmbd.position(before))
    exact = fmbd.solve(scene, t_end=0.1, scheme=fmbd.Radau(rtol=1e-9), output=fmbd.Output(times=[0.1]))

    def refused(*_: object) -> None:
        raise AssertionError("differences")

    monkeypatch.setattr(energy_momentum.EnergyMomentumStepper, "_differences", refused)
    run = fmbd.solve(scene, t_end=0.1, dt=1e-3, scheme=fmbd.EnergyMomentum())
    assert run["tip"][-1] == pytest.approx(exact["tip"][-1], abs=1e-5)


@pytest.mark.parametrize(("rate", "lag"), [(40.0, None), (51.0, "2.1 %"), (100.0, "7.3 %")])
def test_large_turns_are_said(rate: float, lag: str | None, caplog: pytest.LogCaptureFixture) -> None:
    """The Cayley map turns by 2 atan(h w / 2): a wheel lags behind, and nothing else in the run would tell."""
    scene = fmbd.Scene("wheel")
    wheel = fmbd.RigidBody("wheel", 1.0, 1.0, angular_velocity=rate)
    pin = fmbd.revolute("pin", fmbd.ground, wheel)
    scene.add(wheel, pin)
    scene.sensor("angle", fmbd.angle(pin))
    run = fmbd.solve(scene, t_end=0.1, dt=0.01, scheme=fmbd.EnergyMomentum())

    said = [x.getMessage() for x in caplog.records if "a step, of which energy-momentum" in x.getMessage()]
    assert len(said) == (lag is not None)
    if lag is not None:
        assert f'"wheel" turns by {0.01 * rate:.2g} rad a step, of which energy-momentum leaves out {lag}' in said[0]
        told = float(said[0].split("Take dt = ")[1].split()[0])  # of two digits: a step as told is not told of
        assert rate * told < 0.5
    assert run["angle"][-1, 0] == pytest.approx(20 * np.arctan(0.005 * rate), rel=1e-9)


def test_two_iterations_a_step_where_the_motion_is_smooth() -> None:
    """Means are foretold by those of the last three steps, and no iteration is made to see that nothing is left."""
    scene = fmbd.Scene("arm", gravity=(0, -9.81))
    links = [fmbd.RigidBody(f"link {i}", 1.0, 1 / 12, position=(i + 0.5, 0.0)) for i in range(2)]
    pin = fmbd.revolute("pin", fmbd.ground, links[0], center=(0, 0))
    knee = fmbd.revolute("knee", *links, center=(1, 0))
    scene.add(*links, pin, knee, fmbd.joint_spring("spring", fmbd.angle(knee), stiffness=100.0))
    steps = [fmbd.solve(scene, t_end=n * 1e-3, dt=1e-3, scheme=fmbd.EnergyMomentum()).counters for n in (10, 30)]
    assert steps[1]["newton_iterations"] - steps[0]["newton_iterations"] <= 2.5 * 20


def test_the_matrix_of_the_middle_before_differences(monkeypatch: pytest.MonkeyPatch) -> None:
    """A beam whose vibrations the steps do not resolve: where the first prediction was far off, the matrix is taken anew."""
    taken: list[int] = []
    of_the_residual = EnergyMomentumStepper._differences
    monkeypatch.setattr(EnergyMomentumStepper, "_differences", lambda *of: (taken.append(1), of_the_residual(*of))[1])
    section = fmbd.Section.rectangle(youngs_modulus=1e8, poisson_ratio=0.3, density=1000.0, width=1.0, height=0.1)
    beam = fmbd.Beam("rod", (0, 0), (1, 0), section, elements=4)
    scene = fmbd.Scene("beam", gravity=(0, -9.81))
    anchor = {"point_a": (1, 0.5), "point_b": (1, 0)}
    spring = fmbd.Spring("spring", fmbd.ground, beam.surface("end"), stiffness=1e4, damping=20.0, **anchor)
    scene.add(beam, fmbd.revolute("pin", fmbd.ground, beam.surface("start"), center=(0, 0)), spring)
    fmbd.solve(scene, t_end=14e-3, dt=1e-3, scheme=fmbd.EnergyMomentum())
    assert len(taken) <= 3


@pytest.mark.parametrize("compiled", [True, False])
def test_a_potential_that_is_large_beside_what_a_step_changes_of_it(
    compiled: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Masses on circles about a far planet: quotients of the potential's roundoff would be increments that never end."""
    if not compiled:
        monkeypatch.setattr(condensation, "driver_solver", lambda *_: None)
    mu, angle, scene = 4e14, 0.3, fmbd.Scene("orbits")
    ahead, across = np.array((np.cos(angle), np.sin(angle))), np.array((-np.sin(angle), np.cos(angle)))
    rates = {}
    for name, radius in (("low", 7e6), ("high", 7e6 + 10.0)):
        rates[name] = np.sqrt(mu / radius**3)
        mass = fmbd.PointMass(name, 50.0, tuple(radius * ahead), velocity=tuple(radius * rates[name] * across))
        well = fmbd.force_element(
            f"well of {name}", fmbd.ground, mass, lambda a, b, t: -50.0 * mu / np.sqrt(b.x @ b.x), points=((0, 0), None)
        )
        scene.add(mass, well)
        scene.sensor(name, fmbd.position(mass))

    run = fmbd.solve(scene, t_end=500.0, dt=5.0, scheme=fmbd.EnergyMomentum())
    for name, rate in rates.items():
        x, y = run[name].T
        assert np.abs(np.arctan2(y, x) - angle - rate * run.times).max() < 1e-5
    assert run.counters["newton_iterations"] <= 2 * run.counters["steps"] + 2


def test_a_step_at_a_singular_position_is_told_as_one() -> None:
    """Three equal cranks under a coupler of almost no mass: accelerations are told with their instant, as of no initial state."""
    ends = np.array([np.cos(0.3), np.sin(0.3)])
    coupler = fmbd.RigidBody("coupler", 1e-9, 1e-10, position=(*(ends + [1.0, 0.0]),))
    scene = fmbd.Scene("cranks", gravity=(0.0, -9.81))
    scene.add(coupler)
    for k in range(3):
        crank = fmbd.RigidBody(f"crank {k}", 1.0, 1 / 12, position=(*(0.5 * ends + [k, 0.0]),))
        scene.add(crank, fmbd.revolute(f"pin {k}", fmbd.ground, crank, center=(k, 0.0)))
        scene.add(fmbd.revolute(f"hinge {k}", crank, coupler, center=(*(ends + [k, 0.0]),)))
    run = fmbd.solve(scene, t_end=0.9, dt=2e-3, scheme=fmbd.EnergyMomentum(), output=fmbd.Output(estimate_error=False))
    told = [text for text in run.warnings if "accelerations" in text]
    assert told and all("accelerations at t = 0.8" in text and "singular" in text for text in told), run.warnings
