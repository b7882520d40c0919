"""BDDC on one distributed body, and subdomains tied by multipliers, both against the monolithic solve."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from test_traces import ROOT
from tied import block, manufactured, release, surface, tied

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.fem.elastic_forms import ElasticForms
from fmbd_fenicsx.fem.fields import Field
from fmbd_fenicsx.fem.traces.multipliers import Continuous, Ends
from fmbd_fenicsx.fem.traces.traces import trace_of
from fmbd_fenicsx.linear.blocks.domain_decomposition import unassembled
from fmbd_fenicsx.linear.blocks.elastic_blocks import Bddc, set_bddc
from fmbd_fenicsx.linear.blocks.spd import CholeskyFactor
from fmbd_fenicsx.linear.presets.krylov import FieldSplit
from fmbd_fenicsx.linear.presets.multiplier_schur import Schur
from fmbd_fenicsx.linear.rigid_modes import elastic_matrix
from fmbd_fenicsx.linear.saddle.elastic import Elastic

sys.path.insert(0, str(ROOT / "demos"))
from dual_interface import DualInterface, shared_traces  # noqa: E402

KEPT1 = Continuous(1, Ends.KEPT)


@pytest.mark.mpi
@pytest.mark.parametrize("dim, degree", [(2, 2), (3, 1), (3, 2)])
def test_bddc_against_the_factor(dim: int, degree: int) -> None:
    from petsc4py import PETSc

    field = block("block", dim, 8 if dim == 2 else 4, degree)
    cm = 4.0 * 16
    A = unassembled(field, cm, 1.0)
    ksp = PETSc.KSP().create(field.comm)
    ksp.setOptionsPrefix("bddc_test_")
    ksp.setOperators(A)
    ksp.setType("cg")
    ksp.setTolerances(rtol=1e-10)
    set_bddc(ksp)
    ksp.setFromOptions()
    b = np.sin(7 * field.X_world.sum(1))[:, None] * np.ones(dim)
    exact = CholeskyFactor(field, cm, 1.0)
    x, y = A.createVecs()
    y.array[:] = b.ravel()
    ksp.solve(y, x)
    wanted = exact.solve(b.ravel())
    e2, w2 = field.total(np.array([((x.array - wanted) ** 2).sum(), (wanted**2).sum()]))
    assert np.sqrt(e2 / w2) < 1e-8
    assert ksp.getIterationNumber() <= 25
    for obj in (ksp, A, exact, x, y, field):
        obj.destroy()


@pytest.mark.mpi
@pytest.mark.parametrize("preset", [FieldSplit(Bddc()), Schur(Bddc())], ids=str)
def test_bddc_in_the_presets(preset) -> None:
    s = tied(6)
    solver = preset.solver(s)
    f, g, error = manufactured(s)
    assert error(solver.solve(f, g)) < 1e-6
    solver.destroy()
    release(s)


@pytest.mark.mpi
@pytest.mark.parametrize("parts, cells", [(1, (6, 6)), (2, (6, 6)), (3, (6, 8)), (4, (6, 8))])
def test_subdomains_give_the_beam(parts: int, cells: tuple[int, int]) -> None:
    """A beam in pieces, clamped at its left end: counts bounded, result that of all pieces in one saddle
    point."""
    from mpi4py import MPI

    world = MPI.COMM_WORLD
    law = ElasticForms(fmbd.materials.linear_elastic(1.0, 0.3), 1.0, 2)

    def piece(i: int, comm) -> Field:
        mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", cells=cells[i % 2], origin=(float(i), 0.0), comm=comm)
        return Field(f"piece{i}", mesh, law)

    cm = 4 * 6.0**2
    own = {i: Elastic(piece(i, MPI.COMM_SELF), cm) for i in range(parts) if i % world.size == world.rank}
    traces = shared_traces(
        world,
        {(i, n): trace_of(e.body.space, e.body.mesh, n) for i, e in own.items() for n in ("left", "right")},
    )
    dual = DualInterface(world, own, traces)
    dual.hold((0, "left"), KEPT1)
    for i in range(1, parts):
        fine, coarse = (
            ((i, "left"), (i - 1, "right")) if cells[i % 2] >= cells[(i - 1) % 2] else ((i - 1, "right"), (i, "left"))
        )
        dual.tie(fine, coarse, KEPT1)
    dual.prepare()
    load = {
        i: e.body.mass(np.ones((e.body.n, 2)) * [0.0, 1.0] * (1 + e.body.X_world[:, :1])).ravel()
        for i, e in own.items()
    }
    u, lam, iterations = dual.solve(load, np.zeros(dual.n))
    assert iterations <= 25
    whole = _whole(piece, parts, cells, cm)
    found = {
        k: v
        for part in world.allgather({i: (own[i].body.X_world, u[i].reshape(-1, 2)) for i in own})
        for k, v in part.items()
    }
    for i, (x, v) in whole.items():
        order, other = np.lexsort(np.round(x, 8).T), np.lexsort(np.round(found[i][0], 8).T)
        assert np.abs(v[order] - found[i][1][other]).max() < 1e-8 * np.abs(v).max()
    dual.destroy()


def _whole(piece, parts: int, cells: tuple[int, int], cm: float):
    """The same by a direct solve on one rank."""
    from mpi4py import MPI

    from fmbd_fenicsx.fem.traces.mortar import mortar
    from fmbd_fenicsx.linear.presets.krylov import Direct
    from fmbd_fenicsx.linear.saddle.saddle import SaddlePoint
    from fmbd_fenicsx.linear.saddle.ties import hold, tie

    bodies = [piece(i, MPI.COMM_SELF) for i in range(parts)]
    ties = [hold("clamp", 0, KEPT1.on(surface(bodies[0], "left")))]
    for i in range(1, parts):
        a, b = (i, i - 1) if cells[i % 2] >= cells[(i - 1) % 2] else (i - 1, i)
        sides = [surface(bodies[k], "left" if k == i else "right") for k in (a, b)]
        ties.append(tie(f"glue{i}", a, b, mortar(*sides, KEPT1)))
    s = SaddlePoint([Elastic(b, cm) for b in bodies], ties)
    solver = Direct().solver(s)
    f = [b.mass(np.ones((b.n, 2)) * [0.0, 1.0] * (1 + b.X_world[:, :1])).ravel() for b in bodies]
    found = solver.solve(f, [np.zeros(t.rows) for t in ties])
    out = {i: (b.X_world, v.reshape(-1, 2)) for i, (b, v) in enumerate(zip(bodies, found.u, strict=True))}
    solver.destroy()
    release(s)
    return out


@pytest.mark.mpi
def test_fetidp_solves_the_elastic_block() -> None:
    """PETSc's FETI-DP on the unassembled block gives the answer of the assembled one."""
    from petsc4py import PETSc

    body = block("body", 2, 8, 1)
    cm = 4 * 8.0**2
    A, E = unassembled(body, cm, 1.0), elastic_matrix(body, cm, 1.0)
    b = E.createVecLeft()
    b.array[:] = np.repeat(np.sin(300 * body.X_world.sum(1))[:, None], 2, 1).ravel()
    x, r, ksp = b.duplicate(), b.duplicate(), PETSc.KSP().create(body.comm)
    ksp.setOptionsPrefix("dual_")
    PETSc.Options()["dual_fetidp_ksp_rtol"] = 1e-10
    ksp.setOperators(A)
    ksp.setType("fetidp")
    ksp.setFromOptions()
    ksp.solve(b, x)
    E.mult(x, r)
    r.axpy(-1.0, b)
    assert r.norm() <= 1e-8 * b.norm()
    assert ksp.getIterationNumber() <= 25
    for obj in (ksp, x, r, b, A, E):
        obj.destroy()
    body.destroy()
