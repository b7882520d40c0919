"""Energy-momentum steps with elastic fields in compiled code: NumPy's residuals and steps, and what they cost."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from test_mixed_momentum import free

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.materials import kelvin_voigt, linear_elastic, neo_hookean, saint_venant_kirchhoff
from fmbd_fenicsx.schemes.onestep.conserving.energy_momentum import WORTH, EnergyMomentumStepper
from fmbd_fenicsx.schemes.tangent_account import TangentAccount
from fmbd_fenicsx.system.compiled.choice import use_driver
from fmbd_fenicsx.system.compiled.tables.bodies.fields import FieldTable
from fmbd_fenicsx.system.layout import State
from fmbd_fenicsx.system.system import System

pytestmark = pytest.mark.compiled


def stepper_of(system: System, state: State) -> Any:
    """A worker of the scheme."""
    return fmbd.EnergyMomentum().stepper(system, StepSolver(system), fmbd.Newton(), state)


def plane(mesh: Callable[..., Any], **of_rod: Any) -> fmbd.Scene:
    """An elastic rod between two rigid bodies, on a hinge with a lever and a spring with levers."""
    scene = free(mesh(dim=2, h=0.5, height=0.2), 1e4, damping=2.0)
    if of_rod:
        rod = scene.bodies["rod"].with_(**of_rod)
        changed = fmbd.Scene("free", gravity=(0.0, -1.0))
        spring, near = scene.forces["spring"], scene.bodies["near"]
        changed.add(rod, near, scene.bodies["far"], fmbd.revolute("hinge", near, rod.surface("pin"), center=(0, 0)))
        changed.add(replace(spring, a=rod.surface("tip")))
        return changed
    return scene


def space(mesh: Callable[..., Any]) -> fmbd.Scene:
    """The same in space, with a skew hinge: it holds rotations of an elastic surface."""
    return free(mesh(dim=3, h=0.5, height=0.2), 1e4, damping=2.0, axis=(0, 0.6, 0.8))


def loaded(mesh: Callable[..., Any]) -> fmbd.Scene:
    """Material damping, a traction and a pressure."""
    loads = [fmbd.traction("tip", (3.0, 5.0)), fmbd.pressure("pin", 40.0)]
    return plane(mesh, energy=neo_hookean(1e4, 0.3), viscous=kelvin_voigt(20.0), loads=loads, mass_damping=0.3)


def linear(mesh: Callable[..., Any]) -> fmbd.Scene:
    """A linear form with damping by the stiffness: its forces are C's."""
    return plane(mesh, energy=None, elastic=linear_elastic(1e4, 0.3), stiffness_damping=1e-3)


SCENES = {"plane": plane, "space": space, "loaded": loaded, "linear": linear}


@pytest.mark.parametrize("name", SCENES)
def test_residuals_are_those_of_numpy(rod_mesh: Callable[..., Any], name: str) -> None:
    """Of accelerations and multipliers that nothing balances, over a step that turns the bodies by a tenth of a radian."""
    system, state, _ = SCENES[name](rod_mesh).build()
    rng, h = np.random.default_rng(3), 0.1
    (k, part), n = system.fields[0], system.n_core
    lam = rng.normal(size=system.n_lam)
    a = rng.normal(size=system.n_v) / (h * system.units)
    system.local_v(a, k)[:] *= 0.1  # no element is to turn inside out
    plain = stepper_of(system, state)
    plain._use_fields()
    plain.fields.begin(state, h)
    body = plain.fields.bodies[0]
    body.U = body.U0 + h * (body.V0 + 0.5 * h * system.local_v(a, k))
    core, port, gap = plain._residual(h, np.concatenate((a[:n], plain._port_values(), lam)))
    nodes = body.residual() + part.port_columns(plain.ports - system.port_slice(k).start, 0.0) @ port

    use_driver(system)
    driver = StepSolver(system).driver
    assert driver is not None
    means = driver.means(state, h)
    assert means is not None
    found = means.residual((state.t, state.q, state.v), h, a, lam)
    assert found is not None
    both = np.concatenate((core, nodes))
    assert found[0] == pytest.approx(both, rel=1e-9, abs=1e-11 * np.abs(both).max())
    assert found[1] == pytest.approx(0.5 * h * h * gap, rel=1e-9, abs=1e-13)


@pytest.mark.parametrize("name", SCENES)
def test_steps_are_those_of_numpy(rod_mesh: Callable[..., Any], name: str) -> None:
    """By two matrices that have nothing to do with each other."""
    found = []
    for driven in (False, True):
        system, state, _ = SCENES[name](rod_mesh).build()
        if driven:
            use_driver(system)
        stepper = stepper_of(system, state)
        found.append([stepper.advance(2e-3) for _ in range(6)][-1])
        assert (stepper.fields is None) == driven
    for what in ("q", "v", "a", "lam"):
        one, other = (getattr(s, what) for s in found)
        assert other == pytest.approx(one, rel=1e-7, abs=1e-8 * np.abs(one).max()), what


def swinging(mesh: Callable[..., Any], **law: Any) -> fmbd.Scene:
    """A soft bar that falls about a pin, on a spring."""
    rod = fmbd.AbsoluteBody("bar", mesh(dim=2, h=0.5, height=0.2), density=1000.0, quadrature=4, **law)
    scene = fmbd.Scene("swinging", gravity=(0.0, -9.81))
    scene.add(rod, fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0, 0)))
    anchor = {"point_a": (1.0, 0.5), "point_b": (1.0, 0.0)}
    scene.add(fmbd.Spring("spring", fmbd.ground, rod.surface("tip"), stiffness=1e3, **anchor))
    return scene


@pytest.mark.parametrize("material", [saint_venant_kirchhoff, neo_hookean])
def test_a_tangent_serves_many_steps(
    rod_mesh: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, material: Any
) -> None:
    """Every step is one call, which asks Python for forces once in a run; tangents are taken again as soon as the increments that
    old ones cost have paid for it.
    """
    asked, mean_forces = [], FieldTable.mean_forces

    def refused(*_: object, **__: object) -> None:
        raise AssertionError("a step in parts")

    def noted(self: FieldTable, t: float) -> None:
        asked.append(t)
        mean_forces(self, t)

    monkeypatch.setattr(FieldTable, "mean_forces", noted)
    monkeypatch.setattr(EnergyMomentumStepper, "_in_parts", refused)
    scene = swinging(rod_mesh, energy=material(1e6, 0.3))
    run = fmbd.solve(scene, t_end=0.2, dt=2e-3, scheme=fmbd.EnergyMomentum())
    energy = sum(run.energy.values())
    assert len(asked) == 1
    assert np.abs(energy - energy[0]).max() < 1e-11 * run.energy["kinetic"].max()
    assert run.energy["elastic"].max() > 0.1 * run.energy["kinetic"].max()
    assert run.counters["newton_iterations"] <= 7 * 100
    assert 2 <= run.counters["factorisations"] <= 25


def test_a_linear_body_has_one_tangent(rod_mesh: Callable[..., Any]) -> None:
    """Its matrix is exact: three increments, and one factor for all steps."""
    scene = swinging(rod_mesh, elastic=linear_elastic(1e7, 0.3))
    run = fmbd.solve(scene, t_end=0.04, dt=1e-3, scheme=fmbd.EnergyMomentum())
    assert run.counters["factorisations"] == 1 and run.counters["newton_iterations"] <= 4 * 40


def test_tangents_are_old_when_they_have_cost_what_new_ones_do() -> None:
    """Increments beyond the fewest count; tangents that do not serve at all are tried after 1, 3, 7 .. further steps."""
    account = TangentAccount()
    for made in (3, 5, 5, 5):
        account.take(made, renewed=False)
        assert account.wasted_by(0) < WORTH
    account.take(6, renewed=False)
    assert account.wasted_by(0) >= WORTH
    account.take(6, renewed=True)  # which cannot be better
    account.take(6, renewed=False)
    assert account.wasted_by(0) < WORTH

    tried = []
    for step in range(20):
        if not account.otherwise:
            tried.append(step)
            account.failed()
        account.pass_by()
    assert tried == [0, 2, 6, 14]
