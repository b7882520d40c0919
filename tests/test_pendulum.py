"""The elastic pendulum against beam theory, the rigid pendulum, and symmetries of mechanics."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg as spl
from motion import elastic_rod
from scipy.special import ellipk

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.fields import Field
from fmbd_fenicsx.linear.schur import StepSolver
from fmbd_fenicsx.rotations import Array
from fmbd_fenicsx.schemes.start import consistent
from fmbd_fenicsx.system import State, System

LENGTH, DENSITY = 1.0, 1000.0


# -- frequency of bending ------------------------------------------------------------------------------------------------
def matrix(M: Any) -> sp.csr_matrix:
    """A PETSc matrix of one rank for SciPy."""
    indptr, indices, values = M.getValuesCSR()
    return sp.csr_matrix((values, indices, indptr), shape=M.size)


def bending_frequency(mesh: Any, degree: int, E: float, guess: float) -> float:
    """First pinned-free circular frequency (rad/s) of a rod whose surface "pin" does not move on average.

    The eigenvalue of [K T^T; T 0] nearest to 0.5 guess^2, with the rigid swing at 0 below it.
    """
    f = Field("rod", mesh, elastic_rod(mesh, degree=degree, elastic=fmbd.materials.linear_elastic(E, 0.0)).forms())
    n, d = f.n * f.dim, f.dim
    pin = f.moments("pin")
    T = sp.lil_matrix((d, n))
    for k in range(d):
        T[k, pin.nodes * d + k] = pin.weights[:, 0]
    K, M1 = matrix(f.combination(0.0, 1.0)), matrix(f.M)
    M = sp.kron(M1, sp.eye(d))
    scale = abs(K).max()
    A = sp.bmat([[K, scale * T.T], [scale * T, None]], format="csc")
    B = sp.bmat([[M, None], [None, sp.csr_matrix((d, d))]], format="csc")
    values = spl.eigsh(A, k=2, M=B, sigma=0.5 * guess**2, return_eigenvectors=False)
    values = np.sort(values[values > 1e-3 * guess**2])
    f.destroy()
    return float(np.sqrt(values[0]))


def beam(E: float, height: float) -> float:
    """Euler and Bernoulli: tan(bL) = tanh(bL), bL = 3.92660231; rad/s."""
    return 3.92660231204792**2 / LENGTH**2 * float(np.sqrt(E * height**2 / 12 / DENSITY))


@pytest.mark.serial
def test_bending_frequency_tends_to_the_beam(rod_mesh: Callable[..., Any]) -> None:
    """Shear and rotary inertia lower it by c (H/L)^2: the difference falls by four when the height is halved."""
    defects = []
    for height in (0.1, 0.05):
        omega = bending_frequency(rod_mesh(dim=2, h=height / 2, height=height), 2, 1e7, beam(1e7, height))
        defects.append(1 - omega / beam(1e7, height))
    assert 0 < defects[1] < 0.01
    assert 3.5 < defects[0] / defects[1] < 4.3, defects


@pytest.mark.serial
@pytest.mark.parametrize("degree, rate", [(1, 2.0), (2, 3.0)])
def test_bending_frequency_converges_in_space(degree: int, rate: float, rod_mesh: Callable[..., Any]) -> None:
    """Against a fine mesh; eigenvalues converge with twice the order of the energy norm."""
    guess = beam(1e7, 0.2)
    fine = bending_frequency(rod_mesh(dim=2, h=0.0125, height=0.2), 2, 1e7, guess)
    sizes = [0.2, 0.1, 0.05]
    errors = [bending_frequency(rod_mesh(dim=2, h=h, height=0.2), degree, 1e7, guess) / fine - 1 for h in sizes]
    order = np.log2(np.array(errors[:-1]) / errors[1:])
    print(errors, order)
    assert min(errors) > 0  # Galerkin frequencies come from above
    assert order[-1] > rate - 0.2, (errors, order)
