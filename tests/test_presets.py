"""Solvers of a step: patch test, ideal Schur complement, bounded iterations, options."""

from __future__ import annotations

import numpy as np
import pytest
from tied import KEPT1, ROOT, Step, block, chain, tied

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.fem.traces.multipliers import Continuous, Dual, Ends
from fmbd_fenicsx.linear.blocks.elastic_blocks import Bddc, Multigrid
from fmbd_fenicsx.linear.presets import Direct, FieldSplit, Schur
from fmbd_fenicsx.linear.tie_preconditioner import Lumped


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
    normals = {name: (-1) ** (k + 1) * np.eye(dim)[i] for k, (name, i) in enumerate(SIDES.items()) if i < dim}
    loads = [fmbd.loads.traction(name, tuple(stress @ n)) for name, n in normals.items()]
    A, B = block("upper", dim, up, degree, 1.0, loads=loads), block("lower", dim, low, degree, loads=loads)
    scene = fmbd.Scene("patch")
    scene.add(A, B, fmbd.tie_surface("glue", A.surface("bottom"), B.surface("top"), space=space))
    held = {"space": Continuous(ends=Ends.KEPT), "shape": lambda x: H @ x}
    for name, side in (("top", A.surface("top")), ("floor", B.surface("bottom"))):
        scene.add(fmbd.tie_surface(name, side, fmbd.ground, **held))
    found = fmbd.equilibrium(scene)
    for k, p in found.system.fields:
        off = found.system.local_q(found.state.q, k) - (p.field.X_world @ H.T).ravel()
        assert max(p.comm.allgather(np.abs(off).max(initial=0.0))) < (1e-12 if dim == 2 else 1e-10) * 0.02
    glue, rows = found.system.traces[0]
    traction = glue.multipliers.coefficients(found.state.lam[rows].reshape(-1, dim))
    apart = np.abs(traction - stress @ glue.multipliers.trace.normals[0]).max()
    assert apart < (1e-12 if dim == 2 else 1e-10) * np.abs(stress).max() * 10


SIDES = {"left": 0, "right": 0, "back": 2, "front": 2}  # which are loaded, and along which axis their normals are


@pytest.mark.mpi
@pytest.mark.parametrize("degree, cm", [(1, 10.0), (2, 1e5), (2, 1.0)])
def test_ideal_schur_complement_needs_three_iterations(degree: int, cm: float) -> None:
    """S~ of a joint is S: three iterations whatever the system (Murphy, Golub and Wathen, doi:10.1137/S1064827599355153)."""
    body = block("body", 2, 6, degree)
    step = Step(body, fmbd.revolute("pin", body.surface("left"), fmbd.ground, center=(0.0, 0.5)), cm=cm)
    count, error = step.tried(FieldSplit(rtol=1e-9))
    assert count <= 4 and error < 1e-8  # the fourth only confirms the third


AXES = [dict(cells=n) for n in (8, 16, 32)] + [dict(step=x) for x in (1e-3, 10.0)] + [
    dict(E=1e3), dict(E=1e6), dict(E=1e-6), dict(rho=1e-6), dict(rho=1e6), dict(nu=0.4999),
]  # fmt: skip


@pytest.mark.parametrize("axis", AXES, ids=str)
def test_iterations_are_bounded(axis) -> None:
    count, error = tied(**{"cells": 16, **axis}).tried(FieldSplit())
    assert count <= 40 and error < 1e-5


PRESETS = [
    Direct(), Schur(), Schur(Multigrid()), Schur(Bddc()),
    FieldSplit(multiplier=Lumped()), FieldSplit(Multigrid()), FieldSplit(Bddc()),
]  # fmt: skip


@pytest.mark.smoke
@pytest.mark.mpi
@pytest.mark.parametrize("preset", PRESETS, ids=str)
def test_presets_agree_with_the_exact_solution(preset) -> None:
    assert tied(6).tried(preset)[1] < (1e-7 if isinstance(preset, FieldSplit) else 1e-9)


@pytest.mark.mpi
def test_three_dimensions() -> None:
    step = tied(3, dim=3, degree=2)
    for preset in (Direct(), FieldSplit()):
        count, error = step.tried(preset)
        assert count <= 40 and error < 1e-6


@pytest.mark.mpi
def test_sliding_tie_lets_the_tangent_go() -> None:
    A, B = block("upper", 2, 6, 2, 1.0), block("lower", 2, 4, 2)
    scene = fmbd.Scene("slide")
    scene.add(A, B, fmbd.tie_surface("slide", A.surface("bottom"), B.surface("top"), space=KEPT1, sliding=True))
    push = lambda x: np.array([[0.1], [0.0]]) + 0 * x
    scene.add(fmbd.tie_surface("top", A.surface("top"), fmbd.ground, space=KEPT1, shape=push))
    scene.add(fmbd.tie_surface("floor", B.surface("bottom"), fmbd.ground, space=KEPT1))
    found = fmbd.equilibrium(scene)
    for (k, p), wanted in zip(
        found.system.fields, ([0.1, 0.0], [0.0, 0.0]), strict=True
    ):  # the lower block does not notice
        off = found.system.local_q(found.state.q, k).reshape(-1, 2) - wanted
        assert max(p.comm.allgather(np.abs(off).max(initial=0.0))) < (1e-11 if wanted[0] else 1e-12)


@pytest.mark.mpi
@pytest.mark.parametrize("preset", [FieldSplit(), Schur(limit=0, rtol=1e-8)], ids=["whole", "multipliers"])
@pytest.mark.parametrize("links", [1, 4, 12])
def test_counts_are_flat_in_a_chain(links: int, preset) -> None:
    count, _ = chain(links).tried(preset)
    assert count <= (40 if isinstance(preset, FieldSplit) else 15)


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
@pytest.mark.parametrize("step, nu", [(1e-3, 0.3), (1.0, 0.3), (10.0, 0.3), (1.0, 0.4999), (None, 0.3)])
def test_iterations_on_the_multipliers(step: float | None, nu: float) -> None:
    """Half the iterations of MINRES, with the error checked."""
    count, error = tied(12, step=step, nu=nu).tried(Schur(limit=0, rtol=1e-9))
    assert 1 < count <= 26 and error < (1e-7 if step else 1e-5)


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
