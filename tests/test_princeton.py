"""Princeton beam: a slender blade bent by a dead load at an angle, as a solid with large displacements, in static equilibrium.

Reference: beam and solid solutions of a commercial code as printed by Obrezkov et al., Nonlinear Dyn. 109, 2022; they differ
from each other by up to 3 %, so the bound is 1 % outside the interval that they span. The soft bending has an exact
solution of its own, the elastica.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_bvp

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.materials import saint_venant_kirchhoff
from fmbd_fenicsx.traces.fields import Field

ROOT = Path(__file__).resolve().parents[1]
L, H, W, E, NU, F = 0.508, 0.0123777, 0.0032024, 71.7e9, 0.31, 8.896
REFERENCE = {  # angle -> (y of the beam, of the solid), (z of the beam, of the solid), m
    0: ((0.0107141763, 0.01069752828), (0.0, 0.0)),
    45: ((0.008837226265, 0.008686786771), (0.108987937, 0.105976311)),
    90: ((0.0, 0.0), (0.146245978, 0.143848652)),
}


def elastica() -> float:
    """Tip deflection of the inextensible beam bent about its soft axis."""
    EI = E * H * W**3 / 12

    def slope(s: Any, y: Any) -> Any:
        return np.array([y[1], -F / EI * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])])

    def ends(a: Any, b: Any) -> Any:
        return np.array([a[0], b[1], a[2], a[3]])

    s = np.linspace(0, L, 101)
    return float(solve_bvp(slope, ends, s, np.zeros((4, len(s))), tol=1e-9).y[3, -1])


@pytest.fixture(scope="module")
def blade() -> Any:
    mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", size=(L, H, W), origin=(0.0, -H / 2, -W / 2), counts=(40, 2, 1))
    loads = [fmbd.traction("right", (0, (1 - k) * F / H / W, k * F / H / W)) for k in (0, 1)]
    body = fmbd.AbsoluteBody("blade", mesh, energy=saint_venant_kirchhoff(E, NU), loads=loads, quadrature=2)
    field = Field("blade", mesh, body.forms())
    yield field
    field.destroy()


def tip(field: Any, angle: float) -> Any:
    """Mean displacement of the end under the load at an angle (degrees): Newton's method in ten load steps."""
    from petsc4py import PETSc

    held = np.flatnonzero(np.abs(field.X_world[:, 0]) < 1e-9)
    held = (held[:, None] * 3 + np.arange(3)).ravel().astype(np.int32)
    y, z = (b.ravel() for b in field.loads.vectors)
    load = np.cos(np.radians(angle)) * y + np.sin(np.radians(angle)) * z
    U = np.zeros(field.n * 3)
    for share in np.linspace(0.1, 1.0, 10):
        for _ in range(20):
            r = field.internal(U) - share * load
            r[held] = 0.0
            field.linearise(U)
            K = field.combination(0.0, 1.0)
            K.zeroRowsColumns(held)
            x, b = K.createVecs()
            b.array[:] = r
            ksp = PETSc.KSP().create(K.getComm())
            ksp.setOperators(K)
            ksp.setType("preonly")
            ksp.getPC().setType("lu")
            ksp.getPC().setFactorSolverType("mumps")
            ksp.solve(b, x)
            U -= x.array
            size = float(np.abs(x.array).max())
            for obj in (K, x, b, ksp):
                obj.destroy()
            if size < 1e-9:
                break
        assert size < 1e-9
    m = field.moments("right")
    return m.weights[:, 0] @ U.reshape(-1, 3)[m.nodes]


@pytest.mark.slow
@pytest.mark.serial
@pytest.mark.parametrize("angle", [0, 45, 90])
def test_static_deflection(blade: Any, angle: int) -> None:
    """Within 1 % of the interval between the reference's beam and solid; at 90 degrees within 1 % of the elastica."""
    found = tip(blade, angle)
    for value, pair in zip(found[1:], REFERENCE[angle], strict=True):
        if max(pair) > 0:
            assert 0.99 * min(pair) <= value <= 1.01 * max(pair)
        else:
            assert abs(value) < 1e-4
    if angle == 90:
        np.testing.assert_allclose(found[2], elastica(), rtol=0.01)
