"""Viscoelastic sections of rods: Maxwell arms beside the elastic law."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.mechanics.rods.relaxation import Arms

STIFFNESS, TAU, SHARE, MASS = 200.0, 0.05, 1.5, 2.0
SECTION = fmbd.RodSection(
    (STIFFNESS, 80.0, 80.0, 5.0, 4.0, 4.0),
    MASS,
    (0.02, 0.01, 0.01),
    relaxation=[(SHARE, TAU), ((0, 0, 0, 1, 0, 0), 0.5)],
)


def test_arms_follow_strains_that_are_linear_in_time():
    """One step or many: the same, and the solution of the equation of the dashpot."""
    rng = np.random.default_rng(2)
    C = rng.standard_normal((2, 1, 1, 6, 6))
    arms, slope = Arms(C @ np.swapaxes(C, -1, -2), np.array([0.3, 2.0])), rng.standard_normal((1, 1, 6))
    start = arms.relaxed().followed_by(0.0, 0 * slope, np.zeros((2, 1, 1, 6)))

    kept = start
    for t in (0.1, 0.15, 0.7):
        kept = kept.followed_by(t, t * slope, arms.inner(kept, t, t * slope))
    tau = arms.tau[:, None, None, None]
    exact = (0.7 - tau * (1 - np.exp(-0.7 / tau))) * slope
    np.testing.assert_allclose(kept.inner, exact, rtol=1e-13)
    np.testing.assert_allclose(arms.inner(start, 0.7, 0.7 * slope), exact, rtol=1e-13)

    # a time between the last two steps belongs to the earlier memory
    between = (0.4 - tau * (1 - np.exp(-0.4 / tau))) * slope
    np.testing.assert_allclose(arms.inner(kept, 0.4, 0.4 * slope), between, rtol=1e-13)


def bar(section=SECTION, **more):
    """One element of degree 1, clamped, pulled by its weight along itself: one freedom moves."""
    rod = fmbd.Rod("rod", [(0, 0, 0), (1, 0, 0)], section, elements=1, degree=1)
    scene = fmbd.Scene("bar", gravity=(9.81, 0, 0))
    scene.add(rod, fmbd.fixed("clamp", fmbd.ground, rod.surface("start")))
    scene.sensor("end", fmbd.sensors.position(rod.surface("end")))
    scene.sensor("force", fmbd.sensors.section_forces(rod.surface("end")))
    return scene


def exact(t):
    """Stretch and section force of the bar, independently."""

    def rate(_, y):
        u, v, a = y
        force = STIFFNESS * u + SHARE * STIFFNESS * (u - a)
        return v, 9.81 - force / (MASS / 2), (u - a) / TAU

    u, _, a = solve_ivp(rate, (0, t), (0, 0, 0), rtol=1e-12, atol=1e-14, method="DOP853").y[:, -1]
    return u, STIFFNESS * u + SHARE * STIFFNESS * (u - a)


@pytest.mark.parametrize(
    "scheme",
    [fmbd.GeneralizedAlpha(0.8), fmbd.Radau(), fmbd.BDF(rtol=1e-6), fmbd.EnergyMomentum(), fmbd.Rattle()],
    ids=str,
)
def test_a_bar_with_an_arm_in_every_scheme(scheme):
    run = fmbd.solve(bar(), t_end=0.2, dt=2e-3, scheme=scheme)
    u, force = exact(0.2)
    assert u > 0.03
    assert run["end"][-1][0] - 1 == pytest.approx(u, rel=2e-3)
    assert run["force"][-1][0] == pytest.approx(force, rel=6e-3)


def hardening(gamma, kappa, s):
    """A section's own energy."""
    stretch = 0.5 * STIFFNESS * gamma[0] ** 2 + 20.0 * gamma[0] ** 4
    return stretch + 40.0 * (gamma[1] ** 2 + gamma[2] ** 2) + sum(2.0 * k**2 for k in kappa)


def curved(section, damping):
    """Three elements that bend under their weight."""
    rod = fmbd.Rod("rod", [(0, 0, 0), (0.5, 0.1, 0), (1, 0, 0.1)], section, elements=3, degree=2, damping=damping)
    scene = fmbd.Scene("curved", gravity=(1.0, 0, -9.81))
    scene.add(rod, fmbd.revolute("pin", fmbd.ground, rod.surface("start"), center=(0, 0, 0), axis=(0, 1, 0)))
    scene.sensor("end", fmbd.sensors.position(rod.surface("end")))
    return scene


OWN = fmbd.RodSection(energy=hardening, mass=MASS, inertia=(0.02, 0.01, 0.01), relaxation=[((9.0,) * 6, 0.1)])


@pytest.mark.parametrize(("section", "damping"), [(SECTION, 0.0), (SECTION, 1e-2), (OWN, 1e-2)])
def test_compiled_steps_are_those_of_numpy(section, damping):
    """All steps in C, whose memories, energies and tangents are those of Python."""
    quick, plain = (
        fmbd.solve(curved(section, damping), t_end=0.1, dt=2e-3, scheme=fmbd.GeneralizedAlpha(0.8, compiled=compiled))
        for compiled in (True, False)
    )
    assert quick.counters["compiled_steps"] == 50
    assert abs(quick.counters["newton_iterations"] - plain.counters["newton_iterations"]) < 5
    np.testing.assert_allclose(quick["end"], plain["end"], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(quick.total_energy, plain.total_energy, rtol=1e-9)


def test_steps_one_by_one_keep_the_memory():
    whole = fmbd.solve(bar(), t_end=0.04, dt=2e-3)
    with fmbd.stepper(bar(), dt=2e-3) as one:
        for _ in range(20):
            one.step()
        np.testing.assert_array_equal(one["end"], whole["end"][-1])


def test_order_two_in_the_step():
    error = []
    for h in (4e-3, 2e-3):
        run = fmbd.solve(bar(), t_end=0.2, dt=h, scheme=fmbd.GeneralizedAlpha(0.8))
        error.append(np.abs((run["end"][-1][0] - 1 - exact(0.2)[0], run["force"][-1][0] - exact(0.2)[1])))
    np.testing.assert_allclose(np.log2(error[0] / error[1]), 2.0, atol=0.15)


def test_limits_of_the_time_of_relaxation():
    """An arm that relaxes at once is not there; one that never does is a spring."""
    fast, slow = (bar(replace(SECTION, relaxation=[(SHARE, tau)])) for tau in (1e-9, 1e9))
    soft, stiff = (bar(replace(SECTION, relaxation=(), stiffness=(k, 80.0, 80.0, 5.0, 4.0, 4.0)))
                   for k in (STIFFNESS, (1 + SHARE) * STIFFNESS))  # fmt: skip
    for one, other in ((fast, soft), (slow, stiff)):
        a, b = (fmbd.solve(x, t_end=0.1, dt=2e-3)["end"][-1][0] for x in (one, other))
        assert a - 1 == pytest.approx(b - 1, rel=1e-6)


def test_equilibria_are_relaxed():
    found = fmbd.equilibrium(bar())
    assert found["end"][0] - 1 == pytest.approx(9.81 * MASS / 2 / STIFFNESS, rel=1e-9)


def test_a_settled_start_is_relaxed():
    scene = bar()
    scene.settle = True
    run = fmbd.solve(scene, t_end=0.2, dt=0.01)
    np.testing.assert_allclose(run["end"][:, 0] - 1, 9.81 * MASS / 2 / STIFFNESS, rtol=1e-9)


def test_stiffness_is_the_derivative_of_the_forces():
    rod = fmbd.Rod("rod", [(0, 0, 0), (0.5, 0.1, 0), (1, 0, 0)], SECTION, elements=2, degree=2)
    scene = fmbd.Scene("free")
    scene.add(rod)
    system, state, _ = scene.build()
    elements, rng = system.elements[0], np.random.default_rng(1)
    elements.kept = elements.first(system.at(0.0, state.q), state)
    q = system.compose(state.q, 0.05 * rng.standard_normal(system.n_v))
    pose = system.at(0.02, q).pose
    K = elements.tangents(0.02, pose, None, (0.0, 1.0))[0][1]

    step = 1e-6 * rng.standard_normal(system.n_v)
    rows = [elements.forces(0.02, system.at(0.02, system.compose(q, s * step)).pose, None)[0][1] for s in (1, -1)]
    change = (rows[0] - rows[1]) / 2
    expected = K @ step.reshape(-1, 6)[elements.frames].reshape(len(K), -1, 1)
    np.testing.assert_allclose(change.reshape(len(K), -1), expected[..., 0], rtol=1e-6, atol=1e-12)


def test_the_ledger_knows_what_relaxes():
    run = fmbd.solve(bar(), t_end=0.2, dt=1e-3, scheme=fmbd.GeneralizedAlpha(0.95), output=fmbd.Output(ledger=True))
    lost = run.ledger.work["rod, relaxation"][-1]
    assert lost < -0.05
    assert run.total_energy[-1] - run.total_energy[0] == pytest.approx(lost, rel=1e-2)


def test_a_checkpoint_keeps_the_memory(tmp_path):
    settings = {"t_end": 0.05, "dt": 0.005, "scheme": fmbd.GeneralizedAlpha(0.8)}
    whole = fmbd.solve(bar(), **settings, checkpoint=fmbd.Checkpoint(tmp_path, every=1, keep=100))
    again = fmbd.solve(bar(), **settings, restart=next(tmp_path.glob("*_step5")))
    for name in ("end", "force"):
        np.testing.assert_array_equal(whole[name], again[name])


@pytest.mark.parametrize(
    ("relaxation", "message"),
    [
        ([(0.5, 0.0)], "time of the relaxation"),
        ([(-0.5, 1.0)], "share of the stiffness"),
        ([0.5], "must be a pair"),
        ([((1, 1, 1, 1, 1, -1), 1.0)], "negative eigenvalue"),
        ([(np.triu(np.ones((6, 6))), 1.0)], "not symmetric"),
    ],
)
def test_bad_input_is_one_clear_error(relaxation, message):
    with pytest.raises(fmbd.errors.InputError, match=message):
        replace(SECTION, relaxation=relaxation)
