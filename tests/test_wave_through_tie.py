"""A wave through a tied interface whose meshes do not match: optimal rates of displacement and traction, no oscillation."""

from __future__ import annotations

import numpy as np
import pytest
from test_traces import ROOT

import fmbd_fenicsx as fmbd

K = 1.25 * np.pi  # wave number of a standing wave on a bar of 2 m, fixed at x = 0 and free at x = 2; speed 1 m/s
T_END = 1.0


def wave(x: np.ndarray) -> np.ndarray:
    return np.stack((np.sin(K * x[0]), 0 * x[0]))


def tied_bar(degree: int, times: int):
    """Two pieces that meet at x = 1 with 2 : 3 facets; started in the standing wave at rest."""
    law = fmbd.materials.linear_elastic(1.0, 0.0)
    scene, pieces = fmbd.Scene("bar"), []
    for i, counts in enumerate(((4, 2), (5, 3))):
        mesh = fmbd.read_gmsh(
            ROOT / "meshes/block.py", size=(1.0, 0.5), counts=tuple(times * n for n in counts), origin=(float(i), 0.0)
        )
        body = fmbd.AbsoluteBody(f"piece{i}", mesh, degree=degree, density=1.0, elastic=law, displacement=wave)
        pieces.append(body)
        scene.add(body)
    left, right = pieces
    scene.add(fmbd.tie_surface("wall", left.surface("left"), fmbd.ground))
    scene.add(fmbd.tie_surface("glue", right.surface("left"), left.surface("right")))
    scene.sensor("traction", fmbd.reaction("glue"))
    return scene, pieces


def errors(degree: int, times: int) -> np.ndarray:
    """Errors of u in L2 and H1 at the end, largest error of the interface traction over nodes and time."""
    import ufl
    from dolfinx import fem

    scene, pieces = tied_bar(degree, times)
    dt = 0.02 * float(times) ** (-(degree + 1) / 2)
    run = fmbd.solve(scene, t_end=T_END, dt=dt, scheme=fmbd.GeneralizedAlpha(0.8))
    squares = np.zeros(2)
    for body in pieces:
        u = fmbd.displacement_field(run, body)
        msh = body.mesh.dolfinx
        x = ufl.SpatialCoordinate(msh)
        e = u - ufl.as_vector((ufl.sin(K * x[0]) * np.cos(K * T_END), 0 * x[0]))
        for i, f in enumerate((ufl.inner(e, e), ufl.inner(ufl.grad(e), ufl.grad(e)))):
            squares[i] += msh.comm.allreduce(fem.assemble_scalar(fem.form(f * ufl.dx(degree=8))))
    lam = run["traction"].reshape(len(run.times), -1, 2)
    exact = K * np.cos(K) * np.cos(K * run.times)  # stress at x = 1; the multiplier is the traction on the right piece
    off = lam - np.stack((-exact, 0 * exact), axis=1)[:, None]
    return np.array([*np.sqrt(squares), np.abs(off).max()])


@pytest.mark.parametrize("degree", [1, 2])
def test_rates_of_a_wave_through_the_interface(degree: int) -> None:
    """u of order p + 1 in L2 and p in H1; the traction, over all nodes and all times, of order p: no oscillation grows."""
    table = np.array([errors(degree, n) for n in (1, 2, 4)])
    orders = np.log2(table[:-1] / table[1:])
    assert orders[-1, 0] > degree + 1 - 0.1
    assert orders[-1, 1] > degree - 0.1
    assert orders[-1, 2] > degree - 0.1
