"""The error by left-out modes that a run states of itself: it bounds the difference from the full field, and not by far."""

from __future__ import annotations

import signal
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import CraigBampton
from fmbd_fenicsx.materials import linear_elastic, plane_stress
from fmbd_fenicsx.mechanics.elastic import modes
from fmbd_fenicsx.mechanics.reduction import craig_bampton
from fmbd_fenicsx.mechanics.reduction.craig_bampton import FrameModes
from fmbd_fenicsx.run.accuracy.estimates import SATURATION

SILLY = 5.0  # a bound this many times the error says nothing


def rod(mesh: Any, **changes: Any) -> fmbd.FloatingBody:
    form = plane_stress(2e7, 0.3) if mesh.dim == 2 else linear_elastic(2e7, 0.3)
    return fmbd.FloatingBody("rod", mesh, density=1000.0, elastic=form).with_(**changes)


def pendulum(body: Any, *, ramp: float = 0.0) -> fmbd.Scene:
    scene = fmbd.Scene("pendulum", gravity=(0.0, -9.81, 0.0)[: body.dim], gravity_ramp=ramp)
    scene.add(body, fmbd.revolute("pin", body.surface("pin"), fmbd.ground))
    scene.sensor("tip", fmbd.position(body.surface("tip")))
    scene.sensor("force", fmbd.reaction_force("pin"))
    return scene


def solved(scene: fmbd.Scene, t_end: float) -> fmbd.Run:
    return fmbd.solve(scene, t_end=t_end, dt=2e-3, output=fmbd.Output(energy=False, estimate_reduction=True))


def ratios(run: fmbd.Run, exact: fmbd.Run) -> dict[str, float]:
    """Stated over true error of each sensor."""
    assert exact.reduction_error == {}
    return {n: run.reduction_error[n] / float(np.abs(run[n] - exact[n]).max()) for n in run.series}


@pytest.fixture(scope="module")
def whole(rod_mesh: Callable[..., Any]) -> tuple[Any, fmbd.Run]:
    """A soft rod by its whole field, and its run: it hangs from a pin and is let go."""
    full = rod(rod_mesh(h=0.1))
    return full, solved(pendulum(full), 0.4)


@pytest.mark.parametrize("interfaces", [(), ("pin",)])
@pytest.mark.parametrize(("count", "inertia"), [(0, False), (4, False), (16, False), (32, False), (0, True), (8, True)])
def test_the_full_run_lies_within_the_stated_error(
    whole: tuple[Any, fmbd.Run], interfaces: tuple[str, ...], count: int, inertia: bool
) -> None:
    """Free-free modes, Craig-Bampton, with inertia modes; none to 32; position and reaction."""
    if inertia and not interfaces:
        pytest.skip("inertia modes belong to interfaces")
    full, exact = whole
    basis = CraigBampton(interfaces, count, inertia=inertia) if interfaces else FrameModes(count)
    for name, ratio in ratios(solved(pendulum(full.reduced(basis=basis)), 0.4), exact).items():
        assert 1.0 <= ratio < SILLY, name


def test_in_space_with_smooth_gravity(rod_mesh: Callable[..., Any]) -> None:
    """16 modes of a solid rod."""
    full = rod(rod_mesh(dim=3, h=0.25))
    exact, run = (solved(pendulum(b, ramp=0.2), 0.2) for b in (full, full.reduced(modes=16)))
    for name, ratio in ratios(run, exact).items():
        assert 1.0 <= ratio < SILLY, name


def test_spinning_rod_under_a_dead_load_with_a_stress(rod_mesh: Callable[..., Any]) -> None:
    """No joint, a traction that turns in the body's axes, and a sensor of the field: its modes are those of each run."""
    from ufl import grad

    load = fmbd.traction("tip", (0.0, 3e3), time=lambda t: np.sin(10.0 * t) ** 2)
    full = rod(rod_mesh(h=0.1), angular_velocity=6.0, loads=(load,))

    def scene(body: Any) -> fmbd.Scene:
        made = fmbd.Scene("free")
        made.add(body)
        made.sensor("side", fmbd.position(body.surface("side")))
        made.sensor("strain", fmbd.largest(body, lambda u: grad(u)[0, 0], unit="-"))
        return made

    exact, run = (solved(scene(b), 0.1) for b in (full, full.reduced(modes=3)))
    for name, ratio in ratios(run, exact).items():
        assert 1.0 <= ratio < SILLY, name


def driven(body: Any) -> fmbd.Scene:
    """A rod turned about its pin, ten radians in the run, by a drive that counts them."""
    made = fmbd.Scene("driven")
    pin = fmbd.revolute("pin", fmbd.ground, body.surface("pin"), center=(0.0, 0.0))
    made.add(body, pin, fmbd.drive("motor", fmbd.angle(pin), lambda t: 125.0 * t**3))
    made.sensor("tip", fmbd.position(body.surface("tip")))
    return made


def test_driven_beyond_a_turn(rod_mesh: Callable[..., Any]) -> None:
    """Revolutions are counted anew in the runs behind the first, of either estimate."""
    full = rod(rod_mesh(h=0.2), elastic=plane_stress(2e9, 0.3))
    both = fmbd.Output(energy=False, estimate_error=True, estimate_reduction=True)
    exact, run = (fmbd.solve(driven(b), t_end=0.4, dt=4e-3, output=both) for b in (full, full.reduced(modes=4)))
    assert 1.0 <= ratios(run, exact)["tip"] < SILLY
    assert 0.0 < run.error_estimate["tip"] < 1e-2


def test_beams(rod_mesh: Callable[..., Any]) -> None:
    """A beam of four modes against the one of all its elements."""
    section = fmbd.Section.rectangle(youngs_modulus=2e7, poisson_ratio=0.3, density=1e3, width=1.0, height=0.1)

    def scene(beam: Any) -> fmbd.Scene:
        made = fmbd.Scene("beam", gravity=(0.0, -9.81))
        made.add(beam, fmbd.revolute("pin", fmbd.ground, beam.surface("start")))
        made.sensor("end", fmbd.position(beam.surface("end")))
        return made

    few, whole = (fmbd.Beam("rod", (0, 0), (1, 0), section, elements=6, attached=False, modes=m) for m in (4, None))
    runs = [solved(scene(b), 0.3) for b in (few, whole)]
    error = np.abs(runs[0]["end"] - runs[1]["end"]).max()
    assert runs[0].reduction_error["end"] == pytest.approx(SATURATION * error, rel=1e-6)
    assert runs[1].reduction_error["end"] == 0.0


@pytest.mark.mpi
def test_report_states_it_and_nothing_is_paid_unasked(rod_mesh: Callable[..., Any]) -> None:
    few = rod(rod_mesh(h=0.2)).reduced(modes=4)
    unasked = fmbd.solve(pendulum(few), t_end=0.02, dt=2e-3)
    assert "reduction error   not estimated" in unasked.report() and not few._finer and not unasked.reduction_error
    asked = fmbd.solve(pendulum(few), t_end=0.02, dt=2e-3, output=fmbd.Output(estimate_reduction=True))
    assert f'"tip" {asked.reduction_error["tip"]:.2g} m' in " ".join(asked.report().split())
    assert asked.counters == unasked.counters
    np.testing.assert_array_equal(asked["tip"], unasked["tip"])
    first = few.with_refined_basis(("pin", "tip")).constants
    assert few.with_refined_basis(("pin", "tip")).constants is first  # made once


@pytest.mark.mpi
def test_a_finer_basis_takes_what_the_coarser_one_has_found(rod_mesh: Callable[..., Any]) -> None:
    """The modes and moments of the basis that it contains: the same reduction as without them."""
    few = rod(rod_mesh(h=0.2)).reduced(modes=4)
    shared = few.with_refined_basis(("pin", "tip"))
    alone = replace(shared)
    assert shared.coarser is few and alone.coarser is None
    assert shared.reduction.moments["pin"] is few.reduction.moments["pin"] is not alone.reduction.moments["pin"]
    assert len(shared.reduction.omega) == len(alone.reduction.omega) > len(few.reduction.omega)
    np.testing.assert_allclose(shared.reduction.omega, alone.reduction.omega, rtol=1e-7)


def test_stated_with_error_control_at_the_recorded_times(rod_mesh: Callable[..., Any]) -> None:
    """Steps of the two runs differ; their values are compared where the first one recorded."""
    few = rod(rod_mesh(h=0.2)).reduced(modes=4)
    output = fmbd.Output(estimate_reduction=True)
    run = fmbd.solve(pendulum(few, ramp=0.1), t_end=0.05, scheme=fmbd.Radau(3, rtol=1e-6), output=output)
    same = fmbd.solve(pendulum(few, ramp=0.1), t_end=0.05, dt=5e-4, output=output)
    assert 0.7 < run.reduction_error["tip"] / same.reduction_error["tip"] < 1.4


def test_stopped_runs_of_the_estimates_give_none(rod_mesh: Callable[..., Any], caplog: Any) -> None:
    """Ctrl-C in a run behind the first ends the estimate, not the program: the run itself is complete."""
    few, done = rod(rod_mesh(h=0.2)).reduced(modes=4), []

    class Once(fmbd.GeneralizedAlpha):  # not compiled: many compiled steps are one call
        def stepper(self, system: Any, *others: Any) -> Any:
            made = super().stepper(system, *others)
            done.append(system)
            if len(done) > 1:
                made.advance = lambda h, advance=made.advance: (signal.raise_signal(signal.SIGINT), advance(h))[1]
            return made

    both = fmbd.Output(energy=False, estimate_error=True, estimate_reduction=True)
    run = fmbd.solve(pendulum(few), t_end=0.02, dt=1e-3, scheme=Once(compiled=False), output=both)
    assert run.status == "finished" and len(done) == 3
    assert run.error_estimate == {} == run.reduction_error
    assert "stopped at t = 0.002 s" in caplog.text and "more modes did not end: stopped at t = 0.001 s" in caplog.text


def test_a_refined_basis_takes_the_field_and_the_factor_of_its_own(
    rod_mesh: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """One field and one factor of K + s M serve the basis and the one that its error is measured against; static displacements
    are found once, all of them together.
    """
    made: list[str] = []
    counted_too = (modes.ConditionedBody, "solve_static")
    for place, name in ((craig_bampton, "make_field"), (modes, "Factor"), counted_too):
        real = getattr(place, name)

        def counted(*given: Any, real: Any = real, name: str = name) -> Any:
            made.append(name)
            return real(*given)

        monkeypatch.setattr(place, name, counted)
    rod = fmbd.FloatingBody("rod", rod_mesh(dim=2, h=0.5, height=0.1), density=1e3, elastic=linear_elastic(1e6, 0.3))
    body = rod.reduced(modes=2)
    assert body.constants.n_modes == 2
    finer = body.with_refined_basis(("pin", "tip"))
    finest = finer.with_refined_basis(("pin", "tip"))
    assert 2 < finer.constants.n_modes < finest.constants.n_modes
    assert made == ["make_field", "Factor", "solve_static"]

    # the same modes as with a field of their own
    alone = craig_bampton.reduce_body(rod, craig_bampton.RefinedBasis(body.basis, ("pin", "tip")))
    np.testing.assert_allclose(finer.reduction.omega, alone.omega, rtol=1e-6)
