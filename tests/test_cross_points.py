"""Where ties meet each other and held faces: three and four bodies on a point or an edge, every outer face held weakly.

The exact solution is a polynomial of the degree of V_h, so that displacements and tractions come out to roundoff when no
pivot is zero and the multipliers at the cross-points are determined.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tied import ROOT

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.fem.traces.multipliers import Continuous, Ends
from fmbd_fenicsx.fem.traces.tie_stability import infsup_together

MU, LAMBDA = fmbd.materials.lame(1.0, 0.3)
# name -> (origin, size, cells along x); ties (finer, coarser): block and face
FOUR = {"sw": ((0, 0), (1, 1), 2), "se": ((1, 0), (1, 1), 3), "nw": ((0, 1), (1, 1), 3), "ne": ((1, 1), (1, 1), 4)}
FOUR_TIES = [("se left", "sw right"), ("nw bottom", "sw top"), ("ne left", "nw right"), ("ne bottom", "se top")]
THREE = {"low": ((0, 0), (2, 1), 3), "nw": ((0, 1), (1, 1), 2), "ne": ((1, 1), (1, 1), 3)}
THREE_TIES = [("nw bottom", "low top"), ("ne bottom", "low top"), ("ne left", "nw right")]


class Exact:
    """u_i = c_i . x + x . Q_i x / 2 (Q = 0 for degree 1), its stress and the force that it needs."""

    def __init__(self, dim: int, degree: int) -> None:
        rng = np.random.default_rng(1)
        self.c = 0.1 * rng.standard_normal((dim, dim))
        Q = 0.1 * rng.standard_normal((dim, dim, dim)) * (degree > 1)
        self.Q = 0.5 * (Q + Q.swapaxes(1, 2))
        trace = np.einsum("kki->i", self.Q)  # d/dx_i div u
        self.force = -(MU * np.einsum("ijj->i", self.Q) + (MU + LAMBDA) * trace)

    def u(self, x: np.ndarray) -> np.ndarray:
        return x @ self.c.T + 0.5 * np.einsum("nj,ijk,nk->ni", x, self.Q, x)

    def traction(self, x: np.ndarray, normal: np.ndarray) -> np.ndarray:
        g = self.c + np.einsum("ijk,...k->...ij", self.Q, x)
        s = MU * (g + g.swapaxes(-1, -2)) + LAMBDA * np.trace(g, axis1=-2, axis2=-1)[..., None, None] * np.eye(
            len(self.c)
        )
        return np.einsum("...ij,...j->...i", s, normal)


def bodies(dim: int, blocks: dict[str, Any], **given: Any) -> dict[str, fmbd.AbsoluteBody]:
    """Elastic bodies by name."""
    elastic, made = fmbd.materials.linear_elastic(1.0, 0.3), {}
    for name, (origin, size, cells) in blocks.items():
        o, s = ((*origin, 0.0)[:dim], (*size, 1.0)[:dim])
        mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", size=s, cells=cells, origin=o)
        made[name] = fmbd.AbsoluteBody(name, mesh, density=1.0, elastic=elastic, **given)
    return made


def solve(
    dim: int, degree: int, blocks: dict[str, Any], glued: list[tuple[str, str]], times: int = 1, exact: Any = None
):
    """Largest errors of displacements and of tractions at all their nodes, relative to the largest values."""
    exact = exact or Exact(dim, degree)
    finer = {name: (origin, size, times * cells) for name, (origin, size, cells) in blocks.items()}
    made = bodies(dim, finer, degree=degree, loads=[fmbd.loads.body_force(tuple(exact.force))])
    side = lambda text: made[text.split()[0]].surface(text.split()[1])  # noqa: E731

    scene = fmbd.Scene("cross-points")
    scene.add(*made.values(), *(fmbd.tie_surface(f"{a} - {b}", side(a), side(b)) for a, b in glued))
    inner = {face for pair in glued for face in pair}
    faces = ("left", "right", "bottom", "top", "back", "front")[: 2 * dim]
    for outer in (f"{name} {face}" for name in blocks for face in faces if f"{name} {face}" not in inner):
        scene.add(fmbd.tie_surface(outer, side(outer), fmbd.ground, shape=lambda x: exact.u(x.T).T))
    found = fmbd.equilibrium(scene)

    off, size = np.zeros(2), np.zeros(2)
    for k, part in found.system.fields:
        wanted = exact.u(part.field.X_world)
        off[0] = max(off[0], np.abs(found.system.local_q(found.state.q, k).reshape(-1, dim) - wanted).max(initial=0.0))
        size[0] = max(size[0], np.abs(wanted).max(initial=0.0))
    for tie, rows in found.system.traces:
        t, lam = tie.multipliers.trace, found.state.lam[rows].reshape(-1, dim)
        wanted = exact.traction(t.corners, t.normals[:, None])
        off[1] = max(off[1], np.abs(tie.multipliers.coefficients(lam) - wanted).max())
        size[1] = max(size[1], np.abs(wanted).max())
    comm = found.system.comm
    return np.max(comm.allgather(off), axis=0) / np.max(comm.allgather(size), axis=0)


@pytest.mark.mpi
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("blocks, glued", [(FOUR, FOUR_TIES), (THREE, THREE_TIES)], ids=["four", "three"])
def test_patch_through_cross_points(dim: int, degree: int, blocks: dict[str, Any], glued: list[Any]) -> None:
    """Each tie ends at a cross-point and at held faces, each held face shares its edges with others."""
    u, traction = solve(dim, degree, blocks, glued)
    assert u < (1e-12 if dim == 2 else 1e-10)
    assert traction < (1e-10 if dim == 2 else 1e-8)


def test_tractions_at_cross_points_stay_bounded() -> None:
    """P1 displacements of a quadratic solution: the largest error of a traction, at the cross-points, falls with h."""
    errors = np.array([solve(2, 1, FOUR, FOUR_TIES, times, Exact(2, 2)) for times in (2, 4, 8)])
    assert (errors[1:, 1] < 0.7 * errors[:-1, 1]).all()
    assert errors[-1, 0] < errors[0, 0] / 10


@pytest.mark.mpi
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("dim", [2, 3])
def test_rank_in_a_scene(dim: int, degree: int) -> None:
    """rank(B) = rows for all ties together, by the inf-sup constant and by the scene's count of redundant rows."""
    scene = fmbd.Scene("four")
    fewer = {name: (origin, size, min(cells, 2 + (cells == 3))) for name, (origin, size, cells) in FOUR.items()}
    made = bodies(dim, fewer, degree=degree)
    scene.add(*made.values())
    side = lambda text: made[text.split()[0]].surface(text.split()[1])  # noqa: E731
    for a, b in FOUR_TIES:
        scene.add(fmbd.tie_surface(a, side(a), side(b)))
    for name in ("sw", "se"):
        scene.add(fmbd.tie_surface(f"{name} floor", made[name].surface("bottom"), fmbd.ground))
    together = infsup_together(list(scene.ties.values()))
    assert together.zero_modes == 0 and together.beta > 0.15
    assert scene.check().redundant == 0


def test_three_jumps_around_a_point_add_up_to_zero() -> None:
    """On matching meshes, P1 with kept ends: one dependent combination a component; none with merged ends."""
    made = bodies(2, {**THREE, "low": ((0, 0), (2, 1), 4), "ne": ((1, 1), (1, 1), 2)}, degree=1)
    side = lambda text: made[text.split()[0]].surface(text.split()[1])  # noqa: E731
    for space, count in ((Continuous(ends=Ends.KEPT), 1), (Continuous(), 0)):
        ties = [fmbd.tie_surface(a, side(a), side(b), space=space) for a, b in THREE_TIES]
        found = infsup_together(ties)
        assert found.zero_modes == count
        assert min(found.shares.values()) > 0.05 or not count
