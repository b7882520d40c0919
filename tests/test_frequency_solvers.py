"""Factors of complex frequencies: what they solve, when they are made, and what they spare the stages of Radau."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from test_field_stages import pendulum
from test_wave_through_tie import tied_bar
from tolerance_scenes import fe_crank

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import LinearSolveError
from fmbd_fenicsx.linear import frequency_solvers
from fmbd_fenicsx.linear.blocks.complex_factor import ComplexFactor
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.linear.frequency_solvers import DECADE, KEPT, LARGE_KEPT, SETTLED, FrequencySolvers
from fmbd_fenicsx.linear.residual import Judge
from fmbd_fenicsx.materials import linear_elastic
from fmbd_fenicsx.schemes.implicit.field_stages import ROUNDED_UP, FieldEquations

S = 300.0 + 400.0j  # 1/s


def damped(mesh: Any) -> fmbd.Scene:
    """A damped rod on a pin with a spring and a damper between its tip and the ground."""
    law = linear_elastic(5e6, 0.3)
    rod = fmbd.FloatingBody("rod", mesh, density=1000.0, elastic=law, mass_damping=2.0, stiffness_damping=1e-4)
    ends = {"point_a": (1.0, 1.0), "point_b": (1.0, 0.0)}
    scene = fmbd.Scene("damped")
    scene.add(rod, fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0, 0)))
    scene.add(fmbd.Spring("spring", fmbd.ground, rod.surface("tip"), **ends, stiffness=3e3, damping=5.0, length=1.0))
    return scene


@pytest.mark.mpi
def test_a_complex_factor_solves_with_the_matrix_of_the_field(rod_mesh: Callable[..., Any]) -> None:
    field = damped(rod_mesh(h=0.5)).build()[0].fields[0][1].field
    factor = ComplexFactor(field, 1.0 + 2.0 / S, 1.0 / S**2 + 1e-4 / S, 0.0)
    B = np.random.default_rng(1).normal(size=(field.n * field.dim, 2))

    def times(x: np.ndarray) -> np.ndarray:
        inertia = (1.0 + 2.0 / S) * field.mass(x.reshape(-1, field.dim)).ravel()
        return np.asarray(inertia + (1.0 / S**2 + 1e-4 / S) * field.tangent(x))

    x = factor.solve(B[:, 0])
    assert times(x.real) + 1j * times(x.imag) == pytest.approx(B[:, 0], abs=1e-9)
    assert factor.solve_columns(B)[:, 0] == pytest.approx(x)

    # an iterate that flies apart is judged by its size, whose square is no number
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        assert factor.solve(1e200 * B) == pytest.approx(1e200 * factor.solve(B))


def test_a_singular_complex_matrix_is_refused(rod_mesh: Callable[..., Any]) -> None:
    field = damped(rod_mesh(h=0.5)).build()[0].fields[0][1].field
    with pytest.raises(LinearSolveError, match='body "rod" for motions of complex frequency could not be factored'):
        ComplexFactor(field, 0.0, 0.0)


@pytest.mark.parametrize("name", ["damped", "absolute", "tied"])
def test_exact_factors_leave_nothing_where_nothing_turns(rod_mesh: Callable[..., Any], name: str) -> None:
    """Near rest the matrix of a frequency is that of its stage: what a Krylov method would find, without an iteration."""
    mesh = rod_mesh(dim=2, h=0.5, height=0.2)
    scenes = {
        "damped": lambda: damped(mesh),
        "absolute": lambda: pendulum(mesh, "absolute"),
        "tied": lambda: tied_bar(2, 1)[0],
    }
    system, start, _ = scenes[name]().build()
    equations = FieldEquations(system, fmbd.GGL(), StepSolver(system))
    equations.keep_sizes(equal=False)
    state = replace(start, v=np.zeros(system.n_v), a=np.zeros(system.n_v), lam=np.zeros(system.n_lam))
    equations.begin(state)
    tangent = equations.refresh(state, np.zeros(equations.n_mult))

    frequencies, judge = np.array([350.0, S]), Judge("a test")
    for _ in range(SETTLED + 1):
        stages = equations.pencil(tangent, frequencies, judge, 3)
    assert [by.exact for by in stages.by] == [True, True]

    rng = np.random.default_rng(2)
    low = rng.normal(size=(2, system.n_v + 2 * system.n_lam)) * (1.0 + 0.5j)
    kin = 1e-3 * rng.normal(size=(2, system.n_v)) * (1.0 - 2.0j)
    direct = stages.solve(kin, low)
    assert equations.krylov == 0

    equations.trusted = False
    iterated = equations.pencil(tangent, frequencies, judge, 3).solve(kin, low)
    assert equations.krylov <= 4
    for x, y in zip(direct, iterated, strict=True):  # each frequency by itself: one has smaller answers
        assert (np.abs(x - y).max(axis=1) < 2e-2 * np.abs(y).max(axis=1)).all()


@pytest.mark.mpi
def test_frequencies_get_factors_when_they_come_back(rod_mesh: Callable[..., Any]) -> None:
    """The first one is that of the grid; others have its next one until they have been asked for a few times."""
    system = pendulum(rod_mesh(dim=2, h=0.5, height=0.2)).build()[0]
    solvers = FrequencySolvers(system, StepSolver(system))
    assert solvers.of(500.0 + 0.0j).exact
    # of a scheme whose steps have any size
    assert not any(solvers.of(600.0 + 0.0j).exact for _ in range(SETTLED + 2))

    solvers.settles = True
    assert solvers.of(500.0 * 10.0 ** (1 / DECADE) + 0.0j).exact
    found = [solvers.of(S * (1.0 + 1e-12 * k)) for k in range(SETTLED + 2)]
    assert [by.exact for by in found] == SETTLED * [False] + 2 * [True]
    assert found[-1].weights == found[-2].weights
    assert found[-1].weights.ck == pytest.approx(S**-2)
    assert found[0].weights.ck == pytest.approx(500.0**-2)


def test_large_bodies_have_no_complex_factors(rod_mesh: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Their memory has a bound: real factors and an iteration serve every frequency, with the same motion."""
    scene = pendulum(rod_mesh(dim=2, h=0.5, height=0.2))
    system = scene.build()[0]
    entries = system.fields[0][1].field.K.getInfo()["nz_used"]
    runs = []
    for most in (entries, entries - 1):
        monkeypatch.setattr(frequency_solvers, "ENTRIES", most)
        solvers = FrequencySolvers(system, StepSolver(system))
        solvers.settles = True
        found = [solvers.of(S) for _ in range(SETTLED + 3)]
        assert found[-1].exact == (most == entries)
        assert solvers.real.elastic.kept == (KEPT if most == entries else LARGE_KEPT)
        runs.append(fmbd.solve(scene, t_end=0.1, dt=0.01, scheme=fmbd.Radau(3, rtol=None)))

    few, many = (run.counters["stage_iterations"] for run in runs)
    assert many > 2 * few
    np.testing.assert_allclose(runs[1]["tip"], runs[0]["tip"], atol=1e-8)


def test_steps_keep_to_a_grid(rod_mesh: Callable[..., Any]) -> None:
    system = pendulum(rod_mesh(dim=2, h=0.5, height=0.2)).build()[0]
    equations = FieldEquations(system, fmbd.GGL(), StepSolver(system))
    proposed = 1e-4 * 10.0 ** np.linspace(0.0, 2.0, 60)
    taken = np.array([equations.step_size(h) for h in proposed])
    assert (taken <= ROUNDED_UP * proposed).all()
    assert (taken > proposed / 10.0 ** (1 / DECADE)).all()
    assert len(np.unique(taken)) <= 2 * DECADE + 1


def test_back_solves_of_radau_on_the_crank() -> None:
    """One a frequency and increment, complex ones too, and a few for the start and the error of a step."""
    run = fmbd.solve(fe_crank(), t_end=0.1, scheme=fmbd.Radau(3, rtol=1e-5))
    steps = run.counters["steps"]
    assert run.counters["stage_iterations"] < 3.0 * steps
    assert run.counters["back_solves"] < 15.0 * steps
    settled = fmbd.solve(fe_crank(), t_end=0.05, dt=5e-4, scheme=fmbd.Radau(3, rtol=None))
    assert settled.counters["stage_iterations"] < 0.5 * settled.counters["steps"]
