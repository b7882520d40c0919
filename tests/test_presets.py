"""Solvers of the saddle point: patch test, ideal Schur complement, bounded iterations, diagnosis, options."""

from __future__ import annotations

import numpy as np
import pytest
from preconditioners import Exact, Lumped
from tied import ROOT, block, manufactured, release, surface, tied

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError, LinearSolveError
from fmbd_fenicsx.fem.traces.mortar import mortar
from fmbd_fenicsx.fem.traces.multipliers import Continuous, Discontinuous, Dual, Ends
from fmbd_fenicsx.linear.blocks.elastic_blocks import Multigrid
from fmbd_fenicsx.linear.presets.krylov import Direct, FieldSplit
from fmbd_fenicsx.linear.presets.multiplier_schur import Schur
from fmbd_fenicsx.linear.saddle.elastic import Elastic
from fmbd_fenicsx.linear.saddle.saddle import SaddlePoint
from fmbd_fenicsx.linear.saddle.ties import hold, slide, tie

KEPT1 = Continuous(1, Ends.KEPT)


@pytest.mark.parametrize(
    "dim, up, low, degree, space",
    [
        (2, 6, 6, 1, Continuous()),
        pytest.param(2, 6, 9, 1, Continuous(), marks=pytest.mark.mpi),
        pytest.param(2, 7, 11, 1, Dual(), marks=pytest.mark.mpi),
        pytest.param(2, 8, 5, 2, KEPT1, marks=pytest.mark.mpi),
        (2, 8, 4, 2, Continuous()),
        pytest.param(3, 2, 3, 1, Continuous(), marks=pytest.mark.mpi),
        (3, 3, 2, 1, Dual()),
        (3, 3, 2, 2, KEPT1),
    ],
)
def test_patch(dim: int, up: int, low: int, degree: int, space) -> None:
    """A linear displacement passes a non-matching interface to roundoff, and so do the tractions."""
    H = np.array([[0.01, 0.003, 0.002], [0.004, -0.02, 0.001], [-0.002, 0.005, 0.015]])[:dim, :dim]
    G, lmbda = 1 / 2.6, 0.3 / 1.3 / 0.4
    stress = G * (H + H.T) + lmbda * np.trace(H) * np.eye(dim)
    A, B = block("upper", dim, up, degree, 1.0), block("lower", dim, low, degree)
    coupling = mortar(surface(A, "bottom"), surface(B, "top"), space)
    kept = Continuous(ends=Ends.KEPT)
    top, floor = kept.on(surface(A, "top")), kept.on(surface(B, "bottom"))
    ties = [tie("glue", 0, 1, coupling), hold("top", 0, top), hold("floor", 1, floor)]
    s = SaddlePoint([Elastic(A), Elastic(B)], ties)
    loads = []
    for field in (A, B):
        f = np.zeros((field.n, dim))
        for name in ("left", "right", "back", "front")[: 2 * (dim - 1)]:
            t = surface(field, name)
            mine = t.owned >= 0
            f[t.owned[mine]] += (t.mass() @ np.ones(t.n))[mine, None] * (stress @ t.normals[0])
        loads.append(f.ravel())
    exact = lambda x: x @ H.T  # noqa: E731
    solver = Direct().solver(s)
    found = solver.solve(loads, [np.zeros(ties[0].rows), top.integrals(exact).ravel(), floor.integrals(exact).ravel()])
    worst = max(np.abs(u - exact(F.X_world).ravel()).max(initial=0.0) for u, F in zip(found.u, (A, B), strict=True))
    assert max(A.comm.allgather(worst)) < (1e-12 if dim == 2 else 1e-10) * 0.02
    traction = coupling.multipliers.coefficients(found.multipliers[0].reshape(-1, dim))
    assert (
        np.abs(traction + stress @ coupling.slave_trace.normals[0]).max()
        < (1e-12 if dim == 2 else 1e-10) * np.abs(stress).max() * 10
    )
    solver.destroy()
    release(s)


@pytest.mark.parametrize("degree, step", [pytest.param(1, 1.0, marks=pytest.mark.mpi), (2, 1e-3), (2, 10.0)])
def test_ideal_schur_complement_needs_three_iterations(degree: int, step: float) -> None:
    s = tied(6, degree=degree, step=step)
    solver = FieldSplit(multiplier=Exact(), rtol=1e-9).solver(s)
    f, g, error = manufactured(s)
    found = solver.solve(f, g)
    assert found.iterations <= 4 and error(found) < 1e-8  # the fourth only confirms the third
    solver.destroy()
    release(s)


@pytest.mark.mpi
def test_too_few_iterations_are_an_error() -> None:
    """Whatever PETSc says, the true residual decides."""
    s = tied(4)
    solver = FieldSplit(max_iterations=5).solver(s)
    f, g, _ = manufactured(s)
    with pytest.raises(LinearSolveError, match=r"relative residual .* after 5 iterations"):
        solver.solve(f, g)
    solver.destroy()
    release(s)


AXES = [dict(cells=n) for n in (8, 16, 32)] + [dict(step=x) for x in (1e-3, 10.0)] + [
    dict(E=1e3), dict(E=1e6), dict(E=1e-6), dict(rho=1e-6), dict(rho=1e6), dict(nu=0.4999),
]  # fmt: skip


@pytest.mark.parametrize("axis", AXES, ids=str)
def test_iterations_are_bounded(axis) -> None:
    s = tied(**{"cells": 16, **axis})
    solver = FieldSplit().solver(s)
    f, g, error = manufactured(s)
    found = solver.solve(f, g)
    assert found.iterations <= 40
    assert error(found) < 1e-5
    solver.destroy()
    release(s)


@pytest.mark.smoke
@pytest.mark.mpi
@pytest.mark.parametrize(
    "preset",
    [Direct(), Schur(), Schur(Multigrid()), FieldSplit(multiplier=Lumped()), FieldSplit(Multigrid())],
    ids=str,
)
def test_presets_agree_with_the_exact_solution(preset) -> None:
    s = tied(6)
    solver = preset.solver(s)
    f, g, error = manufactured(s)
    found = solver.solve(f, g)
    assert error(found) < (1e-7 if isinstance(preset, FieldSplit) else 1e-9)
    assert found.residual <= 1e-6
    solver.destroy()
    release(s)


@pytest.mark.mpi
def test_three_dimensions() -> None:
    s = tied(3, dim=3, degree=2)
    f, g, error = manufactured(s)
    for preset in (Direct(), FieldSplit()):
        solver = preset.solver(s)
        found = solver.solve(f, g)
        assert found.iterations <= 40 and error(found) < 1e-6
        solver.destroy()
    release(s)


@pytest.mark.mpi
def test_sliding_tie_lets_the_tangent_go() -> None:
    A, B = block("upper", 2, 6, 2, 1.0), block("lower", 2, 4, 2)
    glue = slide("slide", 0, 1, mortar(surface(A, "bottom"), surface(B, "top"), KEPT1))
    ties = [
        glue,
        hold("top", 0, KEPT1.on(surface(A, "top"))),
        hold("floor", 1, KEPT1.on(surface(B, "bottom"))),
    ]
    s = SaddlePoint([Elastic(A), Elastic(B)], ties)
    solver = Direct().solver(s)
    push = ties[1].multipliers.integrals(lambda x: np.array([[0.1, 0.0]]) + 0 * x).ravel()
    found = solver.solve([np.zeros(e.rows) for e in s.elastic], [np.zeros(glue.rows), push, np.zeros(ties[2].rows)])
    assert A.comm.allreduce(np.abs(found.u[1]).max(initial=0.0)) < 1e-12  # the lower block does not notice
    sideways = A.comm.allreduce(np.abs(found.u[0].reshape(-1, 2) - [0.1, 0.0]).max(initial=0.0))
    assert sideways < 1e-11
    solver.destroy()
    release(s)


@pytest.mark.mpi
def test_floating_body_is_named() -> None:
    A, B = block("arm", 2, 4, 1, 1.0), block("base", 2, 4, 1)
    ties = [
        hold("floor", 1, KEPT1.on(surface(B, "bottom"))),
        hold("pin", 0, Discontinuous(0).on(surface(A, "left")).without(np.arange(1, 4))),
    ]
    s = SaddlePoint([Elastic(A), Elastic(B)], ties)
    solver = Direct().solver(s)
    f = [np.ones(e.rows) for e in s.elastic]
    with pytest.raises(LinearSolveError, match='Zero-energy motion: body "arm" rotates about'):
        solver.solve(f, [np.zeros(t.rows) for t in ties])
    solver.destroy()
    release(s)
    A = block("arm", 2, 4, 1)
    with pytest.raises(InputError, match='Body "arm" has no inertia .* no tie holds it'):
        SaddlePoint([Elastic(A)], [])
    A.destroy()


@pytest.mark.mpi
def test_dependent_multipliers_are_named() -> None:
    A = block("arm", 2, 4, 1)
    t = surface(A, "left")
    ties = [hold("one", 0, KEPT1.on(t)), hold("two", 0, KEPT1.on(t))]
    s = SaddlePoint([Elastic(A, 1.0)], ties)
    solver = Direct().solver(s)
    with pytest.raises(LinearSolveError, match='Multipliers of "one" and "two" depend on each other'):
        solver.solve([np.ones(s.rows[0])], [np.ones(x.rows) for x in ties])
    with pytest.raises(LinearSolveError, match='"one" and "two" depend'):
        Schur().solver(s)
    solver.destroy()
    release(s)


@pytest.mark.mpi
def test_unknown_option_is_refused() -> None:
    from petsc4py import PETSc

    options = PETSc.Options()
    s = tied(4)
    f, g, _ = manufactured(s)
    options["wrong_fieldsplit_uper.u_pc_type"] = "jacobi"
    solver = FieldSplit().solver(s, "wrong_")
    with pytest.raises(InputError, match=r"nothing used: -wrong_fieldsplit_uper\.u_pc_type jacobi"):
        solver.solve(f, g)
    options.delValue("wrong_fieldsplit_uper.u_pc_type")
    solver.destroy()
    options["right_fieldsplit_upper.u_pc_type"] = "gamg"
    solver = FieldSplit().solver(s, "right_")
    solver.solve(f, g)
    assert solver.ksp.getPC().getFieldSplitSubKSP()[0].getPC().getType() == "gamg"
    options.delValue("right_fieldsplit_upper.u_pc_type")
    solver.destroy()
    release(s)


@pytest.mark.mpi
@pytest.mark.parametrize("links", [1, 4, 12])
def test_counts_are_flat_in_a_chain(links: int) -> None:
    s = chain(links)
    solver = FieldSplit().solver(s)
    f, g, _ = manufactured(s)
    assert solver.solve(f, g).iterations <= 40
    solver.destroy()
    release(s)


def chain(links: int) -> SaddlePoint:
    """Blocks on top of each other, tied; the lowest is held."""
    bodies = [block(f"link{i}", 2, 6 if i % 2 else 4, 2, float(i)) for i in range(links)]
    ties = [hold("floor", 0, KEPT1.on(surface(bodies[0], "bottom")))]
    for i in range(1, links):
        slave, master = (i, i - 1) if i % 2 else (i - 1, i)
        sides = [surface(bodies[k], "bottom" if k == i else "top") for k in (slave, master)]
        ties.append(tie(f"glue{i}", slave, master, mortar(*sides, KEPT1)))
    return SaddlePoint([Elastic(b, 4 * 36.0 / 10.0) for b in bodies], ties)


# -- in scenes ------------------------------------------------------------------------------------------------------------
def swinging(kind: str) -> fmbd.Scene:
    """A bar on a pin that swings: in absolute coordinates, or in a floating frame."""
    mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", size=(1.0, 0.25), cells=4)
    body = {"absolute": fmbd.AbsoluteBody, "floating": fmbd.FloatingBody}[kind]
    bar = body("bar", mesh, density=1000.0, elastic=fmbd.materials.linear_elastic(1e7, 0.3))
    scene = fmbd.Scene("swing", gravity=(0, -9.81))
    scene.add(bar, fmbd.revolute("pin", bar.surface("left"), fmbd.ground, center=(0.0, 0.125)))
    scene.sensor("tip", fmbd.position(bar.surface("right")))
    return scene


@pytest.mark.mpi
@pytest.mark.parametrize("kind", ["absolute", "floating"])
@pytest.mark.parametrize("preset", [Direct(), Schur(), Schur(Multigrid(), rtol=1e-10)], ids=str)
def test_presets_in_a_scene(kind: str, preset) -> None:
    """One argument chooses the solver; the motion is the same."""
    runs = [fmbd.solve(swinging(kind), t_end=0.02, dt=1e-3, linear=linear) for linear in (None, preset)]
    assert np.abs(runs[0]["tip"] - runs[1]["tip"]).max() < 1e-9
    inside = runs[1].counters["elastic_iterations"]
    assert (inside > runs[1].counters["back_solves"] / 2) == (preset == Schur(Multigrid(), rtol=1e-10))


@pytest.mark.mpi
def test_options_of_a_scene() -> None:
    from petsc4py import PETSc

    options, linear = PETSc.Options(), Schur(Multigrid(), rtol=1e-10)
    plain = fmbd.solve(swinging("absolute"), t_end=2e-3, dt=1e-3, linear=linear)
    options["swing_bar.u_pc_type"] = "jacobi"
    run = fmbd.solve(swinging("absolute"), t_end=2e-3, dt=1e-3, linear=linear)
    assert run.counters["elastic_iterations"] > 1.5 * plain.counters["elastic_iterations"]  # it was used
    options.delValue("swing_bar.u_pc_type")
    options["swing_rod.u_pc_type"] = "jacobi"
    with pytest.raises(InputError, match=r"nothing used: -swing_rod\.u_pc_type jacobi"):
        fmbd.solve(swinging("absolute"), t_end=2e-3, dt=1e-3, linear=linear)
    options.delValue("swing_rod.u_pc_type")


@pytest.mark.mpi
@pytest.mark.parametrize("step, nu", [(1e-3, 0.3), (1.0, 0.3), (10.0, 0.3), (1.0, 0.4999)])
def test_conjugate_gradients_on_the_multipliers(step: float, nu: float) -> None:
    """Half the iterations of MINRES, with the error checked."""
    s = tied(12, step=step, nu=nu)
    solver = Schur(limit=0, rtol=1e-9).solver(s)
    f, g, error = manufactured(s)
    found = solver.solve(f, g)
    assert 1 < found.iterations <= 26 and error(found) < 1e-7
    solver.destroy()
    release(s)


def two_blocks(kinds: str) -> fmbd.Scene:
    """A block clamped by a tie, another tied to it without matching meshes; "a": absolute, "f": floating."""
    body, elastic = {"a": fmbd.AbsoluteBody, "f": fmbd.FloatingBody}, fmbd.materials.linear_elastic(1e7, 0.3)
    scene = fmbd.Scene("two", gravity=(0, -9.81))
    for i, kind in enumerate(kinds):
        mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", size=(1.0, 1.0), cells=6 - i, origin=(float(i), 0.0))
        scene.add(body[kind](f"block{i}", mesh, density=1000.0, elastic=elastic))
    one, two = scene.bodies["block0"], scene.bodies["block1"]
    scene.add(fmbd.tie_surface("clamp", one.surface("left"), fmbd.ground))
    scene.add(fmbd.tie_surface("glue", one.surface("right"), two.surface("left")))
    scene.sensor("tip", fmbd.position(two.surface("right")))
    scene.sensor("clamp", fmbd.velocity(two.surface("right")))
    return scene


@pytest.mark.mpi
@pytest.mark.parametrize("kinds", ["aa", "af"])
def test_many_multipliers_in_a_scene(kinds: str) -> None:
    """Iterations on the multipliers of ties give the motion and the tractions of the dense core."""
    runs = [fmbd.solve(two_blocks(kinds), t_end=2e-3, dt=1e-3, linear=x) for x in (None, Schur(limit=0, rtol=1e-10))]
    assert np.abs(runs[0]["clamp"] - runs[1]["clamp"]).max() < 1e-9 * np.abs(runs[0]["clamp"]).max()
    lam = [r.state.lam for r in runs]
    assert np.abs(lam[0] - lam[1]).max() < 1e-7 * np.abs(lam[0]).max()
    its = runs[1].counters["tie_iterations"]
    assert runs[0].counters["tie_iterations"] == 0 and 2 <= its / runs[1].counters["newton_iterations"] <= 50


def test_many_multipliers_need_a_preset(monkeypatch) -> None:
    monkeypatch.setattr(Direct, "limit", 10)
    with pytest.raises(InputError, match=r"28 multipliers; the direct solver takes up to 10.*linear=fmbd\.Schur\(\)"):
        fmbd.solve(two_blocks("aa"), t_end=1e-3, dt=1e-3, linear=Direct())
