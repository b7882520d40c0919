"""Stage systems of Radau and BDF by sparse patterns: numbers of dense ones, and work that grows with the length of a chain."""

from __future__ import annotations

import ctypes
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
import pytest
from chains import chain
from profiled import calls_of
from test_compiled_evaluation import MAKERS, pair_of
from test_redundancy import null_space

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import LinearSolveError
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.linear.residual import Judge
from fmbd_fenicsx.schemes.control import FALLEN, ROUNDOFF, STAGNATION
from fmbd_fenicsx.schemes.implicit.convergence import Rates, judge_increment
from fmbd_fenicsx.schemes.implicit.step_equations import StepEquations
from fmbd_fenicsx.schemes.implicit.step_tangents import DenseTangents, SparseTangents
from fmbd_fenicsx.schemes.multistep import corrector as bdf
from fmbd_fenicsx.schemes.onestep import stage_newton as radau
from fmbd_fenicsx.schemes.onestep.collocation import tableau
from fmbd_fenicsx.system.compiled.choice import use_driver
from fmbd_fenicsx.system.compiled.states.convergence import CONVERGED, DIVERGED, GOES_ON, TOO_SLOW, Convergence
from fmbd_fenicsx.system.layout import State
from fmbd_fenicsx.system.system import System
from fmbd_fenicsx.system.tangents.step_tangent import StepTangent

FORMS = [
    fmbd.GGL(),
    fmbd.Index3(),
    fmbd.Index2(),
    fmbd.Index1(),
    fmbd.Baumgarte(3.0, 4.0),
    fmbd.Overdetermined(),
    fmbd.StateSpace(),
]
H = 1e-4


def tied(dim: int) -> fmbd.Scene:
    """Two bodies on a pin, which springs of 1e10 N/m hold, with dampers: their efforts are unknowns."""
    scene = fmbd.Scene("tied", gravity=(0.0, -9.81, 0.0)[:dim])
    inertia = 0.1 if dim == 2 else (0.1, 0.2, 0.3)
    at = [np.array(x)[:dim] for x in ((0.0, 0.0, 0.0), (1.0, -0.5, 0.2), (2.0, 0.5, 0.0), (0.5, 1.0, 0.3))]
    one, other = (fmbd.RigidBody(f"body {k}", 1.0, inertia, position=at[k]) for k in (1, 2))
    pin = fmbd.revolute("pin", one, other, center=at[2], **({} if dim == 2 else {"axis": (0.0, 0.0, 1.0)}))
    scene.add(one, other, pin)
    for k, body in enumerate((one, other)):
        stiff = {"stiffness": 1e10, "damping": 1e4, "length": 1.1}
        scene.add(fmbd.Spring(f"tie {k}", fmbd.ground, body, at[0], at[3], **stiff))
    scene.add(fmbd.Spring("between", one, other, at[3], at[1], stiffness=2e10, length=0.9))
    return scene


def hub(arms: int, dim: int = 2, pins: int = 1) -> fmbd.Scene:
    """A body on the ground that bears so many others, with springs at their hinges; of two pins each half of the rows depend."""
    scene = fmbd.Scene("hub", gravity=(0.0, -9.81, 0.0)[:dim])
    middle = fmbd.RigidBody("middle", 10.0, 1.0 if dim == 2 else (1.0, 1.0, 2.0))
    axis = {} if dim == 2 else {"axis": (0.0, 0.0, 1.0)}
    scene.add(middle, fmbd.revolute("axle", fmbd.ground, middle, center=(0.0, 0.0, 0.0)[:dim], **axis))
    for k, angle in enumerate(np.linspace(0.0, 6.0, arms)):
        out = np.array([np.cos(angle), np.sin(angle), 0.0])[:dim]
        arm = fmbd.RigidBody(f"arm {k}", 1.0, 0.1 if dim == 2 else (0.1, 0.2, 0.3), position=1.5 * out)
        hinges = [fmbd.revolute(f"hinge {k} {i}", middle, arm, center=out, **axis) for i in range(pins)]
        scene.add(arm, *hinges, fmbd.joint_spring(f"spring {k}", fmbd.angle(hinges[0]), stiffness=50.0, damping=1.0))
    return scene


SCENES = MAKERS | {f"tied {dim}D": partial(tied, dim) for dim in (2, 3)}
SCENES |= {f"hub {dim}D, {pins}": partial(hub, 5, dim, pins) for dim in (2, 3) for pins in (1, 2)}
JUDGE = Judge("a test", tolerance=1e-6)


def equations(system: Any, form: Any, at: tuple[Any, ...]) -> tuple[StepEquations, State, np.ndarray]:
    """The equations of a step from the first of some configurations, and multipliers of all levels."""
    t, q, v, a, lam = (x[0] for x in at)
    state = State(float(t), q, v, a, lam)
    eq = StepEquations(system, form, StepSolver(system))
    eq.solver.look_for_dependent_rows(system.at(state.t, q, v))
    eq.weigh(state)
    eq.begin(state)
    of_levels = np.concatenate([lam, 1e-2 * lam, 2e-2 * lam])[: eq.levels * system.n_lam]
    mult = np.concatenate((of_levels, np.linspace(3.0, 4.0, len(eq.stiff))))
    return eq, state, mult


@lru_cache(maxsize=1)
def driven(name: str) -> tuple[System, tuple[Any, ...]]:
    """A system, and some configurations: once for all forms."""
    return pair_of(SCENES[name])[1:]


def case(name: str, form: Any) -> tuple[System, StepEquations, State, np.ndarray]:
    """A system, and the equations of a step from the first of its configurations."""
    system, at = driven(name)
    return system, *equations(system, form, at)


def with_dense_matrices(eq: StepEquations) -> DenseTangents:
    """Dense tangents of the same system, evaluated by the same code."""
    made = DenseTangents(eq.system, eq.form, eq.stiff)
    if eq.form.frozen:
        made.U = eq.tangents.directions()
    return made


def with_arrays(tangents: Any, made: StepTangent) -> StepTangent:
    """One of these tangents with arrays in place of data of patterns."""
    return StepTangent(
        **{name: tangents.structure.patterns[name].matrix(data).toarray() for name, data in vars(made).items()}
    )


def right_hand_sides(eq: StepEquations, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Complex residuals for so many frequencies."""
    rng, n = np.random.default_rng(4), eq.system.n_v
    kin, low = rng.normal(size=(2, count, n)), rng.normal(size=(2, count, n + eq.n_mult))
    return kin[0] + 1j * kin[1], low[0] + 1j * low[1]


def without_contradictions(pencil: Any, kin: np.ndarray, any_numbers: np.ndarray) -> np.ndarray:
    """Residuals of the lower rows that some increments take away."""
    moved = pencil.va @ kin[..., None]
    return -(pencil.matrix @ any_numbers[..., None])[..., 0] / pencil.rows - moved[..., 0]


def smallest(eq: StepEquations, state: State, mult: np.ndarray) -> np.ndarray:
    """Of multipliers of all levels with the same forces the smallest, by NumPy."""
    N, u = null_space(eq.system.at(state.t, state.q)), eq.system.multiplier_units
    levels = mult.reshape(len(mult), eq.levels, -1) / u
    return (u * (levels - levels @ N @ N.T)).reshape(mult.shape)


@pytest.mark.compiled
@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
@pytest.mark.parametrize("name", SCENES)
def test_tangents_and_solutions_are_those_of_dense_matrices(name: str, form: Any) -> None:
    system, eq, state, mult = case(name, form)
    if not isinstance(eq.tangents, SparseTangents):
        assert system.n_lam and not system.evaluator.same_rows
        return
    redundant = eq.solver.core.redundant
    made = eq.tangents.at_increments(eq.refresh(state, mult), 0.1 * state.v, state.v)
    sparse, eq.tangents = eq.tangents, with_dense_matrices(eq)
    wanted = eq.tangents.at_increments(eq.refresh(state, mult), 0.1 * state.v, state.v)

    found = with_arrays(sparse, made)
    by_laws = any(items.law for items in system.evaluator.tables.sources)
    for field, values in vars(wanted).items():
        if field == "slopes":
            continue  # formulas have none in NumPy
        size = np.abs(values).max(initial=1e-300)
        # rows of accelerations are summed up in another order: differences divide that roundoff by 1.5e-8
        roundoff = 1e-6 if 2 in form.levels and field in ("by_q", "by_v") else 1e-13
        if by_laws:  # whose slopes differences of stiff efforts know worse
            roundoff = max(roundoff, 1e-5)
        if system.evaluator.tables.whole:  # whose slopes Python tells by other differences
            roundoff = max(roundoff, 1e-9)
        if sparse.structure.couplings.shares:  # told apart, which NumPy sums up
            roundoff = max(roundoff, 1e-7 if field == "by_v" else 1e-11)
        if eq.tied and field == "by_v":  # without springs NumPy sums up in another order, too
            roundoff = max(roundoff, 1e-11)
        assert getattr(found, field) == pytest.approx(values, rel=1e-13, abs=roundoff * size), field

    for s in (np.array([1.5 / H]), tableau(2).values / H, tableau(3).values / H):
        kin, low = right_hand_sides(eq, len(s))
        given = (kin, low) if np.iscomplexobj(s) else (kin.real, low.real)
        pencil = eq.tangents.pencil(found, s, JUDGE, redundant=redundant)
        if redundant:
            given = given[0], without_contradictions(pencil, *given)
        expected, solved = pencil.solve(*given), sparse.pencil(made, s, JUDGE, redundant=redundant).solve(*given)
        if redundant:
            expected = expected[0], smallest(eq, state, expected[1])
        for x, y in zip(solved, expected, strict=True):
            assert x.dtype == y.dtype
            assert x == pytest.approx(y, rel=1e-7, abs=1e-8 * np.abs(y).max(initial=1e-300))


@pytest.mark.parametrize(("place", "stiffness"), [(0.8, 1e7), (1.2, 0.0)], ids=["sticks", "slides"])
def test_dense_tangents_have_slopes_of_laws_beside_their_corners(place: float, stiffness: float) -> None:
    """Differences lead over all of what dry friction sticks by: secants held what slid, by 8.3e-3 of 0.07 m in a run in NumPy."""
    scene, mass = fmbd.Scene("rub", gravity=(0.0, 0.0)), fmbd.RigidBody("mass", 1.0, 1.0)
    rail = fmbd.prismatic("rail", fmbd.ground, mass, axis=(1, 0))
    scene.add(mass, rail, fmbd.dry_friction("rub", fmbd.displacement(rail), limit=5.0, stick=1e7))
    system, start, _ = scene.build()
    none = np.zeros((1, system.n_v))
    q = system.compose(start.q, np.array([[place * 5e-7, 0.0, 0.0]]))
    eq, state, mult = equations(system, fmbd.GGL(), (np.zeros(1), q, none, none, np.zeros((1, system.n_lam))))
    assert eq.refresh(state, mult).by_q[0, 0] == pytest.approx(stiffness, rel=1e-6, abs=1.0)


@pytest.mark.compiled
@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
@pytest.mark.parametrize("name", SCENES)
def test_stages_with_the_same_tangent_each_are_those_with_one(name: str, form: Any) -> None:
    system, eq, state, mult = case(name, form)
    made, tab, redundant = eq.refresh(state, mult), tableau(2), eq.solver.core.redundant
    kin, low = right_hand_sides(eq, 2)
    if redundant:
        low[:, system.n_v :] = 0.0  # rows that contradict each other have no solution
        kin = 0.0 * kin

    one = eq.pencil(made, tab.values / H, JUDGE, 2)
    wanted = [(tab.vectors @ x).real for x in one.solve(tab.inverse @ kin.real, tab.inverse @ low.real)]
    found = list(eq.whole_pencil([made, made], tab.W / H, JUDGE).solve(kin.real, low.real))
    if redundant:
        found[1], wanted[1] = (smallest(eq, state, x) for x in (found[1], wanted[1]))
    share = 1e-5 if redundant else 1e-7  # what is soft loses digits
    for x, y in zip(found, wanted, strict=True):
        assert x == pytest.approx(y, rel=1e-6, abs=share * np.abs(y).max(initial=1e-300))


@pytest.mark.compiled
@pytest.mark.parametrize("name", ["plane", "reduced 3D", "rod"])
def test_a_matrix_of_stages_with_a_tangent_each_takes_few_calls(name: str) -> None:
    """Where its entries are is found once: with matrices of SciPy each took 4 000 calls of Python."""
    system, eq, state, mult = case(name, fmbd.GGL())
    made = eq.refresh(state, mult)
    kin, low = np.zeros((3, system.n_v)), np.ones((3, eq.n_mult + system.n_v))

    def solved() -> None:
        eq.whole_pencil([made] * 3, tableau(3).W / H, JUDGE).solve(kin, low)

    solved()
    assert calls_of(solved) < 300


@pytest.mark.compiled
@pytest.mark.parametrize("name", ["plane", "reduced 3D", "rod"])
def test_rows_are_exchanged_where_pivots_are_small(name: str) -> None:
    """Derivatives of any numbers, half of them none, and no masses."""
    system, eq, state, mult = case(name, fmbd.GGL())
    made, rng = eq.refresh(state, mult), np.random.default_rng(4)
    assert isinstance(eq.tangents, SparseTangents)
    any_numbers = {x: rng.normal(size=made.by_q.shape) * rng.integers(0, 2, made.by_q.shape) for x in ("by_q", "by_v")}
    made = replace(made, **any_numbers, by_a=0.0 * made.by_a)

    s = tableau(3).values / H
    given = right_hand_sides(eq, len(s))
    found = eq.tangents.pencil(made, s, JUDGE, redundant=False).solve(*given)
    wanted = with_dense_matrices(eq).pencil(with_arrays(eq.tangents, made), s, JUDGE, redundant=False).solve(*given)
    for x, y in zip(found, wanted, strict=True):
        assert x == pytest.approx(y, rel=1e-6, abs=1e-7 * np.abs(y).max())

    nothing = replace(made, **{key: 0.0 * values for key, values in vars(made).items()})
    with pytest.raises(LinearSolveError, match="singular"):
        eq.tangents.pencil(nothing, s, JUDGE, redundant=False)


@pytest.mark.compiled
@pytest.mark.parametrize("rates", [*radau.RATES.values(), bdf.RATES], ids=["Radau", "Radau, constant", "BDF"])
@pytest.mark.parametrize("adaptive", [True, False])
def test_iterations_end_where_python_says(rates: Rates, adaptive: bool) -> None:
    """Increments that fall, stay and grow, by roundoff or not: all numbers of the two judges."""
    _, system, _ = pair_of(MAKERS["plane"])
    judge = system.evaluator.implicit.judge_increment
    rng, outcomes = np.random.default_rng(7), set()
    for _ in range(400):
        size, falls = 10.0 ** rng.uniform(-3, 4), rng.uniform(-2.5, 0.3)
        given = {name: getattr(rates, name) for name in vars(rates)}
        given |= {"most": int(rng.integers(2, 11)), "adaptive": adaptive, "tolerance": 0.03}
        given |= {"calm": ROUNDOFF, "stagnation": STAGNATION, "fallen": FALLEN}
        pair = [Convergence(**given, first=0.5, theta=0.3) for _ in range(2)]
        while pair[0].outcome == GOES_ON:
            still = bool(rng.uniform() < 0.1)
            judge_increment(pair[0], size, still=still)
            judge(ctypes.byref(pair[1]), ctypes.c_double(size), still)
            for name, _ in Convergence._fields_:
                assert getattr(pair[1], name) == pytest.approx(getattr(pair[0], name), rel=1e-14, nan_ok=True), name
            size *= 10.0 ** (falls + rng.normal(scale=0.3))
            if rng.uniform() < 0.02:
                size = np.nan
        outcomes.add(pair[0].outcome)
    assert outcomes == {CONVERGED, DIVERGED, TOO_SLOW}


@pytest.mark.compiled
@pytest.mark.parametrize("shape", ["chain", "coupled chain", "hub"])
def test_work_grows_with_the_number_of_bodies(shape: str) -> None:
    """As many directions of differences for any length of a chain, entries of matrices and factors in proportion to it, with a
    row that sums the angles of all hinges too, whose derivative by each takes a direction of its own, and where all hinges are
    those of one body.
    """
    found = []
    for n in (40, 80, 160):
        scene = hub(n) if shape == "hub" else chain(n, length=0.1, mass=0.1, inertia=1e-4)[0]
        if shape == "coupled chain":
            scene.add(fmbd.couple("all", {fmbd.angle(hinge): 1.0 for hinge in scene.joints.values()}))
        system, start, _ = scene.build()
        use_driver(system)
        rest = tuple(np.array([x]) for x in (0.0, start.q, start.v, 0.0 * start.v, np.zeros(system.n_lam)))
        eq, state, mult = equations(system, fmbd.GGL(), rest)
        pencil: Any = eq.pencil(eq.refresh(state, mult), tableau(3).values / H, JUDGE, 3)
        structure, size = pencil.room.structure, pencil.room.structure.all
        filled = sum(int(np.ctypeslib.as_array((np.ctypeslib.ctypes.c_long * (size + 1)).from_address(x))[-1])
                     for one in pencil.room.lower for x in (one.L_start, one.U_start))  # fmt: skip
        own = eq.whole_pencil([pencil.t] * 3, tableau(3).W / H, JUDGE)
        found.append((structure.couplings.together.max() + 1, len(structure.row) / n, filled / n, own.lu.nnz / n))
    directions, entries, filled, whole = np.array(found).T
    assert (directions == (6 if shape == "hub" else 9)).all() or shape == "coupled chain"
    assert whole == pytest.approx(whole[-1], rel=0.2) or shape == "hub"  # rows that SciPy exchanges fill its own
    assert entries == pytest.approx(entries[-1], rel=0.1)
    assert filled == pytest.approx(filled[-1], rel=0.1)
