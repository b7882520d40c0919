"""BDDC on one distributed body, and subdomains tied by multipliers, both against the monolithic solve."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from tied import KEPT1, ROOT, Step, unit_field

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.fem.elastic_forms import ElasticForms
from fmbd_fenicsx.fem.fields import Field
from fmbd_fenicsx.fem.traces.traces import trace_of
from fmbd_fenicsx.linear.blocks.domain_decomposition import unassembled
from fmbd_fenicsx.linear.blocks.elastic_blocks import Elastic, set_bddc
from fmbd_fenicsx.linear.blocks.spd import CholeskyFactor
from fmbd_fenicsx.linear.rigid_modes import elastic_matrix

sys.path.insert(0, str(ROOT / "demos"))
from dual_interface import DualInterface, shared_traces  # noqa: E402


@pytest.mark.mpi
@pytest.mark.parametrize("dim, degree", [(2, 2), (3, 1), (3, 2)])
def test_bddc_against_the_factor(dim: int, degree: int) -> None:
    from petsc4py import PETSc

    field = unit_field(dim, 8 if dim == 2 else 4, degree)
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
@pytest.mark.parametrize("parts, cells", [(1, (6, 6)), (2, (6, 6)), (3, (6, 8)), (4, (6, 8))])
def test_subdomains_give_the_beam(parts: int, cells: tuple[int, int]) -> None:
    """A beam in pieces, clamped at its left end: counts bounded, result that of all pieces in one saddle
    point."""
    from mpi4py import MPI

    world = MPI.COMM_WORLD
    law = ElasticForms(fmbd.materials.linear_elastic(1.0, 0.3), 1.0, 2)

    def mesh(i: int):
        return fmbd.read_gmsh(ROOT / "meshes/block.py", cells=cells[i % 2], origin=(float(i), 0.0), comm=MPI.COMM_SELF)

    cm = 4 * 6.0**2
    own = {i: Elastic(Field(f"piece{i}", mesh(i), law), cm) for i in range(parts) if i % world.size == world.rank}
    traces = shared_traces(
        world,
        {(i, n): trace_of(e.body.space, e.body.mesh, n) for i, e in own.items() for n in ("left", "right")},
    )
    dual = DualInterface(world, own, traces)
    dual.hold((0, "left"), KEPT1)
    for glued in _interfaces(parts, cells):
        dual.tie(*glued, KEPT1)
    dual.prepare()
    load = {
        i: e.body.mass(np.ones((e.body.n, 2)) * [0.0, 1.0] * (1 + e.body.X_world[:, :1])).ravel()
        for i, e in own.items()
    }
    u, lam, iterations = dual.solve(load, np.zeros(dual.n))
    assert iterations <= 25
    whole = _whole(mesh, parts, cells, cm)
    found = {
        k: v
        for part in world.allgather({i: (own[i].body.X_world, u[i].reshape(-1, 2)) for i in own})
        for k, v in part.items()
    }
    for i, (x, v) in whole.items():
        order, other = np.lexsort(np.round(x, 8).T), np.lexsort(np.round(found[i][0], 8).T)
        assert np.abs(v[order] - found[i][1][other]).max() < 1e-8 * np.abs(v).max()
    dual.destroy()


def _interfaces(parts: int, cells: tuple[int, int]) -> list[tuple[tuple[int, str], tuple[int, str]]]:
    """The finer side and the other one of each interface."""
    pairs = [((i, "left"), (i - 1, "right")) for i in range(1, parts)]
    return [(a, b) if cells[a[0] % 2] >= cells[b[0] % 2] else (b, a) for a, b in pairs]


def _whole(mesh, parts: int, cells: tuple[int, int], cm: float):
    """The same on each rank as one scene, by the direct solver."""
    elastic = fmbd.materials.linear_elastic(1.0, 0.3)
    bodies = [fmbd.AbsoluteBody(f"piece{i}", mesh(i), degree=2, density=1.0, elastic=elastic) for i in range(parts)]
    ties = [fmbd.tie_surface("clamp", bodies[0].surface("left"), fmbd.ground, space=KEPT1)]
    for n, glued in enumerate(_interfaces(parts, cells)):
        ties.append(fmbd.tie_surface(f"glue{n}", *(bodies[i].surface(side) for i, side in glued), space=KEPT1))
    step = Step(*bodies, *ties, cm=cm)
    f = [b.mass(np.ones((b.n, 2)) * [0.0, 1.0] * (1 + b.X_world[:, :1])).ravel() for b in step.fields]
    x, _ = step.solve(None, np.concatenate(f), np.zeros(step.system.n_lam))
    return {i: (b.X_world, step.system.local_v(x, i).reshape(-1, 2)) for i, b in enumerate(step.fields)}


@pytest.mark.mpi
def test_fetidp_solves_the_elastic_block() -> None:
    """PETSc's FETI-DP on the unassembled block gives the answer of the assembled one."""
    from petsc4py import PETSc

    body = unit_field(2, 8, 1)
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
