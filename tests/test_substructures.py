"""Factors by substructures against whole ones: the same solutions, the same refusals, on any number of ranks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.csgraph as graph
from motion import elastic_rod

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.fem.factors import partial_factor, substructures
from fmbd_fenicsx.fem.factors.factor import PetscFactor, direct
from fmbd_fenicsx.fem.factors.partial_factor import IndefiniteError, PartialFactor
from fmbd_fenicsx.fem.factors.substructures import Substructures, separator
from fmbd_fenicsx.fem.fields import Field

needs_cholmod = pytest.mark.skipif(partial_factor.library() is None, reason="CHOLMOD cannot be called here")


def rod_field(rod_mesh: Callable[..., Any], dim: int) -> Field:
    mesh = rod_mesh(dim=dim, h=0.1 if dim == 2 else 0.2, height=0.2)
    return Field("rod", mesh, elastic_rod(mesh).forms())


def random_matrix(rng: np.random.Generator, blocks: int, n: int, dim: int) -> sp.csc_matrix:
    """Positive definite: some blocks that are coupled by the last two nodes alone."""
    parts = [sp.random(n, n, 0.1, rng=rng) for _ in range(blocks)]
    A = sp.lil_matrix((blocks * n + 2, blocks * n + 2))
    A[: blocks * n, : blocks * n] = sp.block_diag(parts)
    A[-2:, ::7] = 1.0
    B = sp.kron(A, rng.uniform(-1, 1, (dim, dim)))
    return (B @ B.T + 0.1 * sp.identity(B.shape[0])).tocsc()


@needs_cholmod
@pytest.mark.parametrize("blocks, dim", [(1, 1), (1, 3), (3, 2)])
def test_halves_of_a_factor(blocks: int, dim: int) -> None:
    """L_G L_G^T is the Schur complement of what stays last, the halves make the inverse, for one vector as for several."""
    rng = np.random.default_rng(3)
    A = random_matrix(rng, blocks, 40, dim)
    full, m = A.toarray(), (40 * blocks - 10) * dim  # some of the last block stay last as well
    factor = PartialFactor(A, m, dim)

    schur = full[m:, m:] - full[m:, :m] @ np.linalg.solve(full[:m, :m], full[:m, m:])
    found = np.empty_like(schur)
    found[np.ix_(factor.last, factor.last)] = factor.LG @ factor.LG.T
    np.testing.assert_allclose(found, schur, atol=1e-10 * np.abs(schur).max())
    assert np.all(np.triu(factor.LG, 1) == 0.0)

    b = rng.standard_normal((5, A.shape[0]))
    exact = np.linalg.solve(full, b.T).T
    for x in (b.copy(), *(row[None].copy() for row in b)):
        known = exact if len(x) == 5 else np.linalg.solve(full, x[0])[None]
        factor.solve_half(x)
        factor.solve_half(x, transposed=True)
        np.testing.assert_allclose(x, known, atol=1e-10 * np.abs(exact).max())
    factor.destroy()


@needs_cholmod
def test_rows_of_the_interface_stay_in_their_memory() -> None:
    """Supernodes join columns that are not coupled: one that stays last then has rows of the interior, with zeros."""
    rng = np.random.default_rng(5)
    for _ in range(20):
        A = sp.random(40, 40, 0.03, rng=rng)
        factor = PartialFactor((A @ A.T + sp.identity(40)).tocsc(), 30, 1)
        k = len(factor.last)
        room = np.full((2 * k, k), np.nan)
        partial_factor.library().trailing(factor._made, 30, room[k:].ctypes.data, factor.last.ctypes.data)
        np.testing.assert_array_equal(room[k:], factor.LG)
        assert np.isnan(room[:k]).all()
        factor.destroy()


def test_separator_of_pairs_is_smallest() -> None:
    """It touches every pair, and has as many numbers as the largest matching (Koenig)."""
    rng = np.random.default_rng(8)
    for n, density in ((5, 0.4), (30, 0.05), (30, 0.3), (80, 0.02)):
        edges = sp.random(n, n, density, format="csr", rng=rng)
        i, j = edges.nonzero()
        pairs = np.stack((i, 1000 + j), axis=1)
        cover = substructures._cover(pairs)
        assert np.isin(pairs, cover).any(axis=1).all()
        assert len(cover) == (graph.maximum_bipartite_matching(edges) >= 0).sum()


@needs_cholmod
@pytest.mark.mpi
@pytest.mark.parametrize("dim", [2, 3])
def test_same_solutions_as_by_a_whole_factor(rod_mesh: Callable[..., Any], dim: int) -> None:
    f = rod_field(rod_mesh, dim)
    E = f.combination(1e5, 1.0)
    whole, parts = PetscFactor(E, True, ""), Substructures(E, dim, separator(E, dim))
    b = np.random.default_rng(f.comm.rank).standard_normal((f.n * dim, 3))
    given = b.copy()
    for x, y in ((parts.solve(b), whole.solve(b)), (parts.solve(b[:, 1].copy()), whole.solve(b[:, 1].copy()))):
        largest = max(f.comm.allgather(np.abs(y).max(initial=0.0)))
        np.testing.assert_allclose(x, y, atol=1e-10 * largest)
    assert (b == given).all()
    whole.destroy(), parts.destroy(), E.destroy()


@needs_cholmod
@pytest.mark.mpi
@pytest.mark.parametrize("share", [-1e-3, -1e9])
def test_an_indefinite_matrix_is_refused_on_all_ranks(rod_mesh: Callable[..., Any], share: float) -> None:
    """A little: each rank's own part is definite, the interface is not. Much: no part is."""
    f = rod_field(rod_mesh, 2)
    E = f.combination(share, 1.0)
    with pytest.raises(IndefiniteError):
        Substructures(E, 2, separator(E, 2))


@needs_cholmod
@pytest.mark.mpi
def test_who_factors_and_why(rod_mesh: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    f = rod_field(rod_mesh, 2)
    E, ranks = f.combination(1e5, 1.0), f.comm.size
    made = direct(E, 2, True)
    assert made.how.startswith("CHOLMOD" if ranks == 1 else f"CHOLMOD on each of {ranks} ranks")
    made.destroy()
    monkeypatch.setattr(substructures, "DENSE", 0.0)
    made = direct(E, 2, True)
    assert made.how.startswith("CHOLMOD" if ranks == 1 else f"MUMPS, as the interface of {ranks} ranks has")
    made.destroy()
    assert "indefinite" in direct(E, 2, False).how


@pytest.mark.mpi
@pytest.mark.parametrize("definite", [True, False])
def test_a_factor_is_freed_with_the_last_that_holds_it(rod_mesh: Callable[..., Any], definite: bool) -> None:
    """Factors are made by the hundred in one run: PETSc counts one holder while a factor is in use, and none afterwards."""
    made = PetscFactor(rod_field(rod_mesh, 2).combination(1e6, 1.0), definite, "")
    assert made.matrix.getRefCount() == 1


def test_the_plan_of_a_run_tells_the_solver(rod_mesh: Callable[..., Any]) -> None:
    rod = elastic_rod(rod_mesh(dim=2, h=0.3, height=0.2))
    scene = fmbd.Scene("pendulum", gravity=(0, -9.81))
    scene.add(rod, fmbd.revolute("pin", rod.surface("pin"), fmbd.ground, center=(0, 0)))
    run = fmbd.solve(scene, t_end=4e-3, dt=2e-3)
    (how,) = run.plan.solvers
    assert how.startswith(("CHOLMOD", "MUMPS"))
    assert how in str(run.plan)
    assert how[:20] in run.report()
