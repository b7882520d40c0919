"""The report says what a run did: counts, estimate, ledger, plan; short, and the same numbers as the run."""

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.post.report import conservative


def pendulum(n=1, **changes):
    scene = fmbd.Scene("swing", gravity=(0, -9.81), **changes)
    for k in range(n):
        bob = fmbd.RigidBody(f"bob{k}", 1.0, 0.1, position=(1.0, float(k)))
        scene.add(bob, fmbd.revolute(f"pin{k}", fmbd.ground, bob, center=(0, k)))
        scene.sensor(f"position{k}", fmbd.position(bob))
    return scene


def test_report_of_a_rigid_run_has_the_runs_numbers():
    run = fmbd.solve(pendulum(), t_end=0.6, dt=0.01, output=fmbd.Output(estimate_error=True))
    text = run.report()
    assert "finished at t = 0.6 s" in text and "60 steps" in text
    assert f"{run.counters['newton_iterations']:.0f} iterations" in text
    assert f'"position0" {run.error_estimate["position0"]:.2g} m' in text
    total = sum(run.energy.values())
    assert f"{total[0] - total[-1]:.3g} J" in text
    assert "elastic fields (no mesh library, no PETSc, no MPI)" in text.replace("\n" + " " * 20, " ")
    assert len(text.splitlines()) <= 30 and max(map(len, text.splitlines())) <= 112


def test_report_without_estimate_says_so():
    assert "not estimated" in fmbd.solve(pendulum(), t_end=0.1, dt=0.01).report()


def test_report_of_many_bodies_stays_short():
    run = fmbd.solve(pendulum(30), t_end=0.1, dt=0.01, output=fmbd.Output(estimate_error=True))
    text = run.report()
    assert len(text.splitlines()) <= 30
    text = " ".join(text.split())
    assert "26 sensors with less" in text and "more blocks" in text


def test_loss_is_only_called_numerical_where_it_is():
    assert conservative(pendulum())
    assert not conservative(pendulum(gravity_ramp=0.1))
    spring, damped, driven = pendulum(), pendulum(), pendulum()
    ends = (spring.bodies["bob0"], fmbd.ground)
    spring.add(fmbd.Spring("s", *ends, point_b=(0, 3), stiffness=10.0))
    damped.add(fmbd.Spring("s", *ends, point_b=(0, 3), damping=1.0))
    driven.add(fmbd.drive_rotation("turn", fmbd.ground, driven.bodies["bob0"], lambda t: (t, 1.0, 0.0)))
    assert conservative(spring) and not conservative(damped) and not conservative(driven)
    run = fmbd.solve(pendulum(gravity_ramp=0.05), t_end=0.1, dt=0.01)
    assert "not separable" in run.report()


@pytest.mark.smoke
@pytest.mark.mpi
def test_report_of_an_elastic_run_names_factorisations_and_the_field(rod_mesh):
    rod = fmbd.FloatingBody("rod", rod_mesh(), degree=1, density=1e3, elastic=fmbd.materials.linear_elastic(5e6, 0.3))
    scene = fmbd.Scene("elastic", gravity=(0, -9.81))
    scene.add(rod, fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0, 0)))
    run = fmbd.solve(scene, t_end=0.02, dt=0.005)
    text = run.report()
    assert "1 elastic factorisation," in text and f"{run.counters['back_solves']:.0f} back-solves" in text
    assert "rod.u" in text and "elastic " in text
    assert np.isfinite(run.memory) and run.memory > 1e6
    assert 'elastic bodies    "rod" 1 m, ' in text


@pytest.mark.mpi
def test_report_says_how_large_and_heavy_elastic_bodies_are(rod_mesh):
    """A mesh in mm under a density in kg/m^3 shows: one sees it, no threshold decides."""
    steel = fmbd.materials.linear_elastic(2e11, 0.3)
    scene = fmbd.Scene("bodies")
    for k, mesh in enumerate(
        (rod_mesh(dim=3, h=0.5, height=0.5), rod_mesh(dim=3, h=500.0, height=500.0, length=1000.0))
    ):
        body = fmbd.FloatingBody(f"rod {k}", mesh, degree=1, density=8000.0, elastic=steel)
        scene.add(body, body.with_(name=f"few {k}").reduced(modes=2))
    text = " ".join(fmbd.solve(scene, t_end=0.01, dt=0.01).report().split())
    assert '"rod 0" 1.22 m, 2e+03 kg, "rod 1" 1.22e+03 m, 2e+12 kg, "few 0" 1.22 m, 2e+03 kg' in text


@pytest.mark.parametrize(
    "scheme",
    [fmbd.GeneralizedAlpha(rtol=1e-4), fmbd.Radau(rtol=1e-4), fmbd.BDF(rtol=1e-4), fmbd.HalfExplicit(rtol=1e-4)],
    ids=lambda x: type(x).__name__,
)
def test_reports_of_steps_of_the_schemes_own_choice(scheme):
    run = fmbd.solve(pendulum(), t_end=0.1, scheme=scheme)
    assert f"rtol = 0.0001, {run.counters['steps']:.0f} steps" in run.report()
