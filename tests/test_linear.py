"""Linear solves of a step: against a dense matrix of the whole system, judged, and scaled whatever masses
and steps are.
"""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse
from motion import elastic_rod, elastic_scene

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import FmbdError, LinearSolveError
from fmbd_fenicsx.fem.fields import Field
from fmbd_fenicsx.linear import prepared
from fmbd_fenicsx.linear.blocks.field_blocks import FactoredField, Weights
from fmbd_fenicsx.linear.blocks.spd import CholeskyFactor, MassInverse
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.linear.core import CoreSolver
from fmbd_fenicsx.linear.residual import Judge
from fmbd_fenicsx.system import dependence
from fmbd_fenicsx.system.layout import State
from fmbd_fenicsx.system.system import System

HERE = Path(__file__).resolve().parent


def scene_of(mesh: Any, frame: Any) -> fmbd.Scene:
    """An elastic rod on the ground, and a rigid body at its tip."""
    scene, rod, block = elastic_scene(mesh, degree=1, frame=frame)
    d = mesh.dim
    scene.add(fmbd.revolute("pin", rod.surface("pin"), fmbd.ground, center=(0, 0, 0)[:d]))
    scene.add(fmbd.revolute("tip", rod.surface("tip"), block, center=(1, 0, 0)[:d]))
    return scene


def turned(scene: fmbd.Scene) -> tuple[System, State]:
    """The undeformed system in a turned position (joints may be open: only matrices are looked at)."""
    system, state, _ = scene.build()
    xi = np.zeros(system.n_v)
    n = system.n_frames * system.motions.n_twist
    xi[:n] = 0.4 * np.random.default_rng(3).standard_normal(n)
    return system, State(0.0, system.compose(state.q, xi), np.zeros(system.n_v), state.a, state.lam)


def dense(system: System, state: State, cm: float, ck: float) -> np.ndarray:
    """[cm M + ck K, G^T; G, 0] column by column from the balance and the constraints, one rank."""
    ev = system.at(0.0, state.q, state.v)
    n, m = system.n_v, system.n_lam
    A = np.zeros((n + m, n + m))
    rest = ev.balance(np.zeros(n))
    for j in range(n):
        e = np.eye(n)[j]
        A[:n, j] = cm * (ev.balance(e) - rest)
        for k, part in system.fields:
            local = system.local_v(e, k)
            A[system.slices[1][k], j] += ck * part.field.stiffness(local)
        A[n:, j] = ev.jacobian.times(e)
    A[:n, n:] = A[n:, :n].T
    return A


@pytest.mark.smoke
@pytest.mark.serial
@pytest.mark.parametrize("frame", [fmbd.MeanAxis(), fmbd.Attached("pin")], ids=["mean axis", "attached"])
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("ck", [0.0, 1e-6])
def test_step_solver_against_a_dense_matrix(dim: int, frame: Any, ck: float, rod_mesh: Callable[..., Any]) -> None:
    system, state = turned(scene_of(rod_mesh(dim=dim, h=0.5, height=0.4), frame))
    A = dense(system, state, 1.0, ck)
    n, m = system.n_v, system.n_lam
    rng = np.random.default_rng(8)
    b, c = rng.standard_normal(n), rng.standard_normal(m)
    solver = StepSolver(system)
    solver.prepare(system.at(0.0, state.q, state.v), Weights(1.0, 0.0, ck))
    x, y = solver.solve(b, c)
    solver.destroy()
    expected = np.linalg.solve(A, np.concatenate((b, c)))
    assert np.abs(np.concatenate((x, y)) - expected).max() < 1e-9 * np.abs(expected).max()


@pytest.mark.mpi
@pytest.mark.parametrize("dim", [2, 3])
def test_solution_fulfils_constraints_and_balance_on_any_rank_count(dim: int, rod_mesh: Callable[..., Any]) -> None:
    """The same by residuals, without a dense matrix."""
    system, state = turned(scene_of(rod_mesh(dim=dim, h=0.5, height=0.4), fmbd.MeanAxis()))
    ev = system.at(0.0, state.q, state.v)
    solver = StepSolver(system)
    solver.prepare(ev, Weights(1.0, 0.0, 0.0))
    rest = ev.balance(np.zeros(system.n_v))
    c = np.random.default_rng(1).standard_normal(system.n_lam)
    a, lam = solver.solve(-rest, c)
    solver.destroy()
    assert system.max_abs(ev.balance(a, lam)) < 1e-9 * system.max_abs(rest)
    assert np.abs(ev.jacobian.times(a) - c).max() < 1e-10 * np.abs(c).max()


@pytest.mark.smoke
@pytest.mark.mpi
def test_factor_and_mass_inverse_solve_all_columns(rod_mesh: Callable[..., Any]) -> None:
    mesh = rod_mesh(dim=3, h=0.5, height=0.4)
    f = Field("rod", mesh, elastic_rod(mesh).forms())
    B = np.random.default_rng(f.comm.rank).standard_normal((f.n * 3, 4))
    for factor, ck in ((CholeskyFactor(f, 2.0, 1e-6), 1e-6), (MassInverse(f, 2.0), 0.0)):
        X = factor.solve_columns(B)
        for j in range(4):
            r = 2.0 * f.mass(X[:, j].reshape(-1, 3)).ravel() + ck * f.stiffness(X[:, j]) - B[:, j]
            assert np.sqrt(f.total(np.array(r @ r))) < 1e-11 * np.sqrt(f.total(np.array(B[:, j] @ B[:, j])))
        x = factor.solve(B[:, 1].copy())
        assert np.abs(x - X[:, 1]).max(initial=0.0) < 1e-10 * np.abs(X).max()
        factor.destroy()


# -- the judge -----------------------------------------------------------------------------------------------
@pytest.mark.parametrize("residual", [np.nan, np.inf, 1e-3])
def test_judge_refuses(residual: float) -> None:
    with pytest.raises(LinearSolveError, match="the block"):
        Judge("the block").check(residual, 1.0)


def test_judge_accepts_roundoff_of_a_regular_matrix_only() -> None:
    """The bound by |A| |x| is tight, ends where matrices are singular, and never lets a false solution pass."""
    judge = Judge("the block")
    judge.check(5e-6, 1.0, grown=1e10)
    assert judge.worst == 5e-6
    for residual, grown in ((2e-5, 1e10), (1e-4, 1e12), (1.0, 1e16), (np.nan, 1e10), (1e-6, np.inf), (1e-6, np.nan)):
        with pytest.raises(LinearSolveError, match="the block"):
            judge.check(residual, 1.0, grown=grown)


@pytest.mark.mpi
@pytest.mark.parametrize("share", [0.0, 1e-18, 1e-16])
def test_matrix_singular_to_roundoff_is_refused(rod_mesh: Callable[..., Any], share: float) -> None:
    """cm M + K with a mass far below the roundoff of K: its backward error is small, its growth tells."""
    mesh = rod_mesh(dim=2, h=0.5, height=0.4)
    f = Field("rod", mesh, elastic_rod(mesh).forms())
    b = np.tile([1.0, 0.3], f.n)
    kb, mb = f.stiffness(f.X.ravel()), f.mass(f.X).ravel()
    size, mass = np.sqrt(f.total(np.array([kb @ kb, mb @ mb])))
    with pytest.raises(LinearSolveError, match='"rod"'):
        CholeskyFactor(f, share * size / mass, 1.0).solve(b)


@pytest.mark.mpi
def test_thin_body_at_a_long_step_is_solved_to_roundoff() -> None:
    """Aspect 1:100 and cm = 1e5 / s^2: roundoff of E x alone exceeds 1e-8 |b|, and the rigid solution is right to 1e-6."""
    mesh = fmbd.read_gmsh(HERE.parent / "meshes/rod.py", dim=2, length=1.0, height=0.01, h=0.02)
    rod = fmbd.FloatingBody("rod", mesh, density=1e3, elastic=fmbd.materials.plane_stress(2e11, 0.3))
    f = Field("rod", mesh, rod.forms())
    factor = CholeskyFactor(f, 1e5, 1.0)
    x = factor.solve(1e5 * f.mass(np.tile([0.0, 1.0], (f.n, 1))).ravel())
    factor.destroy()
    assert factor.judge.worst > factor.judge.tolerance
    np.testing.assert_allclose(x.reshape(-1, 2), np.tile([0.0, 1.0], (f.n, 1)), atol=1e-6)


def test_judge_keeps_the_worst() -> None:
    judge = Judge("the block")
    for r in (1e-12, 1e-10, 1e-13):
        judge.check(r, 1.0)
    assert judge.worst == 1e-10
    assert judge.solves == 3
    judge.check(0.0, 0.0)


@pytest.mark.mpi
def test_nan_on_the_right_hand_side_is_refused(rod_mesh: Callable[..., Any]) -> None:
    """PETSc reports such solves as converged."""
    mesh = rod_mesh(dim=2, h=0.5, height=0.4)
    f = Field("rod", mesh, elastic_rod(mesh).forms())
    factor = CholeskyFactor(f, 1.0, 1e-6)
    b = np.ones(f.n * 2)
    b[:1] = np.nan
    with pytest.raises(LinearSolveError, match='"rod"'):
        factor.solve(b)
    factor.destroy()


@pytest.mark.mpi
def test_floating_body_without_mass_is_refused(rod_mesh: Callable[..., Any]) -> None:
    """K alone is singular: a factorisation may go through, the residual tells."""
    mesh = rod_mesh(dim=2, h=0.5, height=0.4)
    f = Field("rod", mesh, elastic_rod(mesh).forms())
    b = np.tile([1.0, 0.3], f.n)
    with pytest.raises(LinearSolveError, match='"rod"'):
        CholeskyFactor(f, 0.0, 1.0).solve(b)


def test_a_factor_of_few_digits_is_refined():
    """A factor that is off by 1e-3 gives the solution all the same; one that is off by its own size is refused."""
    rng = np.random.default_rng(4)
    A, G = np.diag(rng.uniform(1, 1e8, 6)), rng.standard_normal((2, 6))
    b, c = rng.standard_normal(6), rng.standard_normal(2)
    for off, right in ((1e-3, True), (1.5, False)):
        solver = CoreSolver(Judge("the core"))
        solver.factor(A, G)
        exact = solver._solve
        solver._solve = lambda x, off=off, exact=exact: (1 + off) * exact(x)
        if right:
            x, y = solver.solve(b, c)
            np.testing.assert_allclose(np.concatenate((A @ x + G.T @ y, G @ x)), np.concatenate((b, c)), rtol=1e-6)
        else:
            with pytest.raises(LinearSolveError, match="relative residual"):
                solver.solve(b, c)


def test_dependent_constraints_share_their_multiplier() -> None:
    """The same row twice: both copies get the same multiplier, and the rows are fulfilled."""
    G = np.random.default_rng(0).standard_normal((2, 4))
    A, b = np.diag([1.0, 2.0, 3.0, 4.0]), np.array([1.0, -1.0, 0.5, 2.0])
    solver = CoreSolver(Judge("the core"))
    solver.factor(A, np.concatenate((G, G[:1])))
    x, y = solver.solve(b, np.array([1.0, 2.0, 1.0]))
    assert np.abs(G @ x - [1.0, 2.0]).max() < 1e-10
    assert abs(y[0] - y[2]) < 1e-10
    assert np.abs(A @ x + G.T @ [y[0] + y[2], y[1]] - b).max() < 1e-10


@pytest.mark.parametrize("apart", [0.0, 1e-12, 1e-10])
def test_rows_that_nearly_depend_share_their_multiplier_in_sparse_matrices(apart: float) -> None:
    """Beside fields, which stand for the 0 of the matrix: a sparse factor has pivots there, of roundoff."""
    G = np.array([[1.0, -1.0, 0.0], [1.0, -1.0, apart], [0.0, 1.0, 1.0]])
    A, C, found = np.diag([1.0, 2.0, 3.0]), np.zeros((3, 3)), []
    for made in (np.array, scipy.sparse.csr_array):
        solver = CoreSolver(Judge("the core"))
        solver.factor(made(A), made(G), C)
        assert not solver.exact
        found.append(np.concatenate(solver.solve(np.array([1.0, -1.0, 0.5]), np.array([0.2, 0.2, 0.1]))))
    np.testing.assert_allclose(found[0], found[1], atol=1e-9)


@pytest.mark.parametrize("light", [1e-6, 1e-13, 1e-26])
@pytest.mark.parametrize("redundant", [False, True])
def test_a_body_of_hardly_any_mass_passes_forces_on(light: float, redundant: bool) -> None:
    """A heavy mass, a light one and a heavy one in a row, and another light one that hangs at a heavy one; units of any size."""
    A = np.diag([1.0, light, 2.0, light])
    G = np.array([[1.0, -1.0, 0.0, 0.0], [0.0, 1.0, -1.0, 0.0]])
    b, c = np.array([1.0, 0.0, 2.0, light]), np.array([0.5, 0.25])
    first = (3.0 + c.sum() * 2.0 + c[0] * light) / (3.0 + light)  # of x, by the balance of all
    exact = np.array([first, first - c[0], first - c.sum(), 1.0])
    solver = CoreSolver(Judge("the core"))
    for unit in (1.0, 1e-20, 1e20):
        solver.redundant = redundant
        if redundant:
            solver.factor(unit * A, np.concatenate((G, [G[0] + G[1]])))
            x, y = solver.solve(unit * b, np.append(c, c.sum()))
            force = G.T @ y[:2] + (G[0] + G[1]) * y[2]
        else:
            solver.factor(unit * A, G)
            x, y = solver.solve(unit * b, c)
            force = G.T @ y
        np.testing.assert_allclose(x, exact, rtol=1e-9)
        np.testing.assert_allclose(force / unit, b - A @ exact, atol=1e-9)


def test_body_without_mass_is_refused() -> None:
    A = np.diag([1.0, 0.0])
    solver = CoreSolver(Judge("the core"))
    with pytest.raises(LinearSolveError, match="the core"):
        solver.factor(A, np.zeros((0, 2)))
        solver.solve(np.ones(2), np.zeros(0))


# -- scaling -------------------------------------------------------------------------------------------------
def chain(ratio: float) -> fmbd.Scene:
    """Two bodies of mass 1 and ``ratio`` on rods: ground, one, two."""
    one = fmbd.RigidBody("one", 1.0, 0.1, (1.0, 0.0))
    two = fmbd.RigidBody("two", ratio, 0.1 * ratio, (1.0, -1.0))
    scene = fmbd.Scene("chain", gravity=(0, -9.81))
    scene.add(one, two, fmbd.revolute("a", fmbd.ground, one, center=(0, 0)))
    scene.add(fmbd.distance("b", one, two, length=1.0))
    scene.sensor("one", fmbd.position(one))
    scene.sensor("two", fmbd.position(two))
    return scene


def scaled_condition(scene: fmbd.Scene, weights: Weights) -> float:
    """Condition number of the matrix that is factored."""
    system, state, _ = scene.build()
    solver = StepSolver(system)
    solver.prepare(system.at(0.0, state.q, np.zeros(system.n_v)), weights)
    core = solver.core
    A = core.A.toarray() if hasattr(core.A, "toarray") else core.A
    G = core.G.toarray() if hasattr(core.G, "toarray") else core.G
    K = np.block([[A, G.T], [G, np.zeros((len(G), len(G))) if core.C is None else core.C]])
    return float(np.linalg.cond(core.scale[:, None] * K * core.scale))


@pytest.mark.parametrize("ratio", [1.0, 1e9, 1e-9])
def test_condition_does_not_depend_on_masses(ratio: float) -> None:
    assert scaled_condition(chain(ratio), Weights(1.0, 0.0, 0.0)) < 20


@pytest.mark.serial
def test_condition_does_not_depend_on_the_step(rod_mesh: Callable[..., Any]) -> None:
    """An elastic scene: s = beta h^2 from h = 1e-2 to 1e-8."""
    scene = scene_of(rod_mesh(dim=2, h=0.5, height=0.4), fmbd.MeanAxis())
    found = [scaled_condition(scene, Weights(1.0, 0.0, 0.3 * h * h)) for h in (1e-2, 1e-4, 1e-6, 1e-8)]
    assert max(found) < 1e5
    assert max(found[1:]) < 2 * min(found[1:])


@pytest.mark.parametrize("light", [1e-6, 1e-9])
def test_light_body_between_heavy_ones_moves_like_none(light: float) -> None:
    """A pendulum whose rod is a body of mass 1e-9 moves like one with a massless rod."""
    bob = fmbd.RigidBody("bob", 1.0, 0.1, (1.0, 0.0))
    link = fmbd.RigidBody("link", light, 0.1 * light, (0.5, 0.0))
    real, ideal = fmbd.Scene("link", gravity=(0, -9.81)), fmbd.Scene("ideal", gravity=(0, -9.81))
    real.add(
        bob,
        link,
        fmbd.revolute("a", fmbd.ground, link, center=(0, 0)),
        fmbd.revolute("b", link, bob, center=(1, 0)),
    )
    ideal.add(bob, fmbd.distance("rod", fmbd.ground, bob, point_a=(0, 0), point_b=(1, 0), length=1.0))
    ends = []
    for scene in (real, ideal):
        scene.sensor("bob", fmbd.position(bob))
        ends.append(fmbd.solve(scene, t_end=0.5, dt=2e-3, newton=fmbd.Newton(1e-9))["bob"][-1])
    assert np.abs(ends[0] - ends[1]).max() < 1e-8 + light


def test_massless_body_that_nothing_holds_is_refused() -> None:
    with pytest.raises(FmbdError, match='"ghost".*mass'):
        fmbd.RigidBody("ghost", 0.0, 0.1)


def test_a_field_is_eliminated_from_what_it_sees_of_the_core(
    rod_mesh: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not from the columns of all other bodies, of which many would take the square of their number in each."""
    widths: list[int] = []
    seen_by = FactoredField.seen_by

    def noted(self: FactoredField, R: np.ndarray, S: np.ndarray) -> np.ndarray:
        widths.extend((R.shape[1], S.shape[1]))
        return seen_by(self, R, S)

    monkeypatch.setattr(FactoredField, "seen_by", noted)
    mesh, law = rod_mesh(h=0.5, height=0.4), fmbd.materials.plane_stress(1e8, 0.3)
    found, matrices = [], []
    for count in (1, 4):
        scene = fmbd.Scene("rods", gravity=(0.0, -9.81))
        for k in range(count):
            rod = fmbd.FloatingBody(f"rod {k}", mesh, density=1000.0, elastic=law, degree=1)
            scene.add(rod, fmbd.revolute(f"pin {k}", fmbd.ground, rod.surface("pin"), center=(0, 0)))
        system, state, _ = scene.build()
        solver = StepSolver(system)
        widths.clear()
        solver.prepare(system.at(0.0, state.q, state.v), Weights(1.0, 0.0, 1e-6))
        found.append(max(widths))
        b = np.random.default_rng(1).standard_normal(system.n_v)
        x, y = solver.solve(b, np.zeros(system.n_lam))
        matrices.append(dense(system, state, 1.0, 1e-6) @ np.concatenate((x, y)) - np.concatenate((b, 0 * y)))
        solver.destroy()
    assert found[0] == found[1]
    assert max(np.abs(left).max() for left in matrices) < 1e-9


def test_the_core_of_many_elastic_bodies_is_sparse(
    rod_mesh: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the same solutions as a dense one, whose work is the cube of their number; so is what tells that no rows depend. Nothing
    of the square of their number is made on the way.
    """
    mesh, law = rod_mesh(h=0.5, height=0.4), fmbd.materials.plane_stress(1e8, 0.3)
    scene, last = fmbd.Scene("chain", gravity=(0.0, -9.81)), fmbd.ground
    for k in range(70):
        rod = fmbd.FloatingBody(f"rod {k}", mesh.placed((float(k), 0.0)), density=1000.0, elastic=law, degree=1)
        scene.add(rod, fmbd.revolute(f"pin {k}", last, rod.surface("pin"), center=(float(k), 0)))
        last = rod.surface("tip")
    system, state, _ = scene.build()
    ev, b = system.at(0.0, state.q, state.v), np.random.default_rng(1).standard_normal(system.n_v)

    def bytes_of(solver: StepSolver, A: Any) -> int:
        """That are taken at most where the core is made of the fields."""
        made: Any = solver.prepared
        tracemalloc.start()
        prepared.Condensed(made.fields, solver.core, A, slice(None), made.momenta)
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return most

    def solved() -> tuple[np.ndarray, int]:
        solver, factors = StepSolver(system), []
        of_dense = solver.core._factor_dense
        solver.core._factor_dense = lambda K: factors.append(len(K)) or of_dense(K)  # type: ignore[method-assign]
        solver.prepare(ev, Weights(1.0, 0.0, 1e-6))
        found = np.concatenate(solver.solve(b, np.zeros(system.n_lam)))
        if not factors:
            A = scipy.sparse.csr_array(np.eye(system.n_core))
            assert bytes_of(solver, A) < 4 * (system.n_core + system.n_lam) ** 2
            assert max(len(S.on) for S in solver.prepared.fields.couplings) < 20  # type: ignore[attr-defined]
        solver.destroy()
        return found, len(factors)

    found, factors = solved()
    assert not factors
    assert scipy.sparse.issparse(dependence._scaled(ev))
    monkeypatch.setattr(prepared, "MANY", np.inf)
    by_dense, factors = solved()
    assert factors
    np.testing.assert_allclose(found, by_dense, atol=1e-9 * np.abs(by_dense).max())


def test_a_sparse_core_that_sees_fields_and_is_singular_is_looked_at_by_a_dense_factor() -> None:
    """Two rows that are the same share their multiplier."""
    A, G, C = np.eye(4), np.array([[1.0, 0, 0, 0], [1.0, 0, 0, 0]]), np.zeros((2, 2))
    found = []
    for kind in (np.asarray, scipy.sparse.csr_array):
        solver = CoreSolver(Judge("the core"))
        solver.factor(kind(A), kind(G), kind(C))
        found.append(np.concatenate(solver.solve(np.array([1.0, 2.0, 3.0, 4.0]), np.zeros(2))))
    np.testing.assert_allclose(found[1], [0.0, 2.0, 3.0, 4.0, 0.5, 0.5], atol=1e-12)
    np.testing.assert_allclose(found[0], found[1], atol=1e-12)
