"""Where ties meet each other and held faces: three and four bodies on a point or an edge, every outer face held weakly.

The exact solution is a polynomial of the degree of V_h, so that displacements and tractions come out to roundoff when no
pivot is zero and the multipliers at the cross-points are determined.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from test_traces import ROOT
from tied import release, surface

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.fem.elastic_forms import ElasticForms
from fmbd_fenicsx.fem.fields import Field
from fmbd_fenicsx.fem.traces.mortar import mortar
from fmbd_fenicsx.fem.traces.multipliers import Continuous, Ends, default_space
from fmbd_fenicsx.fem.traces.tie_stability import infsup_together
from fmbd_fenicsx.linear.presets.krylov import Direct
from fmbd_fenicsx.linear.saddle.elastic import Elastic
from fmbd_fenicsx.linear.saddle.saddle import SaddlePoint
from fmbd_fenicsx.linear.saddle.ties import hold, tie

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


def arrangement(dim: int, degree: int, blocks: dict[str, Any], glued: list[tuple[str, str]], times: int = 1):
    """Fields by name, ties between them, and the outer faces."""
    law = ElasticForms(fmbd.materials.linear_elastic(1.0, 0.3), 1.0, degree)
    fields = {}
    for name, (origin, size, cells) in blocks.items():
        o, s = ((*origin, 0.0)[:dim], (*size, 1.0)[:dim])
        mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", size=s, cells=times * cells, origin=o)
        fields[name] = Field(name, mesh, law)
    inner = {side for pair in glued for side in pair}
    faces = ("left", "right", "bottom", "top", "back", "front")[: 2 * dim]
    outer = [f"{name} {face}" for name in blocks for face in faces if f"{name} {face}" not in inner]
    return fields, outer


def solve(
    dim: int, degree: int, blocks: dict[str, Any], glued: list[tuple[str, str]], times: int = 1, exact: Any = None
):
    """Largest errors of displacements and of tractions at all their nodes, relative to the largest values."""
    fields, outer = arrangement(dim, degree, blocks, glued, times)
    exact, number = exact or Exact(dim, degree), {name: i for i, name in enumerate(fields)}
    space = default_space(degree)

    def face(side: str):
        name, which = side.split()
        return number[name], surface(fields[name], which)

    rows, values, spaces = [], [], []
    for a, b in glued:
        (i, slave), (j, master) = face(a), face(b)
        c = mortar(slave, master, space)
        rows.append(tie(f"{a} - {b}", i, j, c))
        spaces.append(c.multipliers)
        values.append(np.zeros(rows[-1].rows))
    for side in outer:
        i, trace = face(side)
        spaces.append(space.on(trace))
        rows.append(hold(side, i, spaces[-1]))
        values.append(spaces[-1].integrals(exact.u).ravel())
    system = SaddlePoint([Elastic(f) for f in fields.values()], rows)
    solver = Direct().solver(system)
    loads = [f.mass(np.ones((f.n, 1)) * exact.force).ravel() for f in fields.values()]
    found = solver.solve(loads, values)
    off, size = np.zeros(2), np.zeros(2)
    for f, u in zip(fields.values(), found.u, strict=True):
        wanted = exact.u(f.X_world)
        off[0] = max(off[0], np.abs(u.reshape(-1, dim) - wanted).max(initial=0.0))
        size[0] = max(size[0], np.abs(wanted).max(initial=0.0))
    for mu, lam in zip(spaces, found.multipliers, strict=True):
        t = mu.trace
        wanted = -exact.traction(t.corners, t.normals[:, None])
        off[1] = max(off[1], np.abs(mu.coefficients(lam.reshape(-1, dim)) - wanted).max())
        size[1] = max(size[1], np.abs(wanted).max())
    comm = system.comm
    solver.destroy()
    release(system)
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
    made = {}
    for name, (origin, size, cells) in FOUR.items():
        mesh = fmbd.read_gmsh(
            ROOT / "meshes/block.py",
            size=(*size, 1.0)[:dim],
            cells=min(cells, 2 + (cells == 3)),
            origin=(*origin, 0.0)[:dim],
        )
        made[name] = fmbd.AbsoluteBody(
            name, mesh, degree=degree, density=1.0, elastic=fmbd.materials.linear_elastic(1.0, 0.3)
        )
        scene.add(made[name])
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
    made = {}
    for name, (origin, size, cells) in {**THREE, "low": ((0, 0), (2, 1), 4), "ne": ((1, 1), (1, 1), 2)}.items():
        mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", size=size, cells=cells, origin=origin)
        made[name] = fmbd.AbsoluteBody(
            name, mesh, degree=1, density=1.0, elastic=fmbd.materials.linear_elastic(1.0, 0.3)
        )
    side = lambda text: made[text.split()[0]].surface(text.split()[1])  # noqa: E731
    for space, count in ((Continuous(ends=Ends.KEPT), 1), (Continuous(), 0)):
        ties = [fmbd.tie_surface(a, side(a), side(b), space=space) for a, b in THREE_TIES]
        found = infsup_together(ties)
        assert found.zero_modes == count
        assert min(found.shares.values()) > 0.05 or not count
