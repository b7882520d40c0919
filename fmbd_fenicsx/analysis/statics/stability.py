"""Whether an equilibrium is stable: the softest motion that the constraints leave, of any scene.

With K the exact stiffness on increments y of the configuration as lengths, G y = 0, the smallest Rayleigh quotient

    mu = min  y^T K y / |y|^2                                                                                 (1)

is found by Davidson's method: on a growing basis V the smallest eigenvalue mu of V^T K V and its vector y, and as one more vector
w = P^-1 r, r = K y - mu y, with P the matrix of the equilibrium's own Newton iteration. A vector costs a product with K and a
back-solve. A negative mu is proof where differences over ten times the way tell the same, which roundoff does not; a positive one
counts where w lowers it no more, r^T w << mu |y|^2. Forces that follow have no potential, K is not symmetric, and a negative mu
proves nothing: there motions of the basis with K y = l M y and real l < 0 are asked for. Flutter is left to modes.

What spins may be held by gyroscopic forces where K is not definite: there the eigenvalues of small motions decide, of scenes
that have few.

Source: Morgan and Scott, Generalizations of Davidson's method, doi:10.1137/0907054.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg as sl

from ...rotations import Array
from ..small_motions.basis import DENSE_LIMIT, new_part, projected, random_motion
from ..small_motions.first_order import first_order
from ..small_motions.perturbation import SHIFT, SIDES, Perturbation
from .static_newton import StaticNewton

MOST = 24  # vectors
SETTLED = 0.1  # of mu, what another vector may take away
FLAT = 1e-13  # stiffness of a motion, over that of the stiffest seen, that is roundoff
SKEW = 10.0  # mu over what V^T K V lacks of symmetry, below which it is roundoff
WAY = 10.0 * SHIFT  # of a difference that has to tell the same, over the model's length
SLOW = 1e-12  # squared rate, over that of the preconditioner's step, with which roundoff of reactions may let it grow
ALIKE = 0.5  # of mu, by which it may differ
# of the rate at which a motion is left without gyroscopic forces, and below which roundoff parts double zeros
GROWS = 1e-3


def falling(about: Perturbation, newton: StaticNewton) -> Array | None:
    """A motion (largest displacement 1 m), like v, by which an equilibrium is left by itself; None where it is stable.

    ``newton``: with its matrix near the state. Collective.
    """
    system = about.system
    none = np.zeros(system.n_lam)
    basis: list[Array] = []
    images: list[Array] = []
    new = newton.solver.solve(about.mass(random_motion(about, 0)), none)[0]

    mu, skew = 0.0, False
    away: Array | None = None
    while len(basis) < MOST and (v := new_part(about, basis, new, newton.solver.solve)) is not None:
        basis.append(v)
        images.append(about.stiffness(v))
        K = np.array([[system.dot(x, image) for image in images] for x in basis])
        values, vectors = np.linalg.eigh(0.5 * (K + K.T))

        mu, y = float(values[0]), vectors[:, 0] @ np.array(basis)
        slowest = SLOW * newton.weights.cm * system.dot(y, about.mass(y))
        skew = bool(mu > -SKEW * np.abs(K - K.T).max())
        away = y if mu < -max(FLAT * np.abs(values).max(), slowest) else None
        # one motion alone does not show whether its forces have a potential
        if away is not None and not skew and len(basis) > 1:
            break

        rest = vectors[:, 0] @ np.array(images) - mu * system.units**2 * y
        new = newton.solver.solve(rest, none)[0]
        if mu > 0.0 and system.dot(rest, new) <= SETTLED * mu:
            break
    if away is not None and skew:
        away = _diverging(about, basis, K)
        mu = 0.0 if away is None else system.dot(away, about.stiffness(away))
    if away is None:
        return None

    size = system.max_abs(away)
    along = _quotient(newton, about, away / size) * size**2
    return np.asarray(away / size) if abs(along - mu) <= ALIKE * abs(mu) else None


def _diverging(about: Perturbation, basis: list[Array], K: Array) -> Array | None:
    """The motion of a basis that forces without a potential drive away fastest, K y = l M y with l < 0; None: there is none."""
    masses = [about.mass(v) for v in basis]
    rates, motions = sl.eig(K, np.array([[about.system.dot(x, mass) for mass in masses] for x in basis]))
    rates = np.where(rates.imag == 0.0, rates.real, np.inf)
    fastest = int(rates.argmin())
    return np.asarray(motions[:, fastest].real @ np.array(basis)) if rates[fastest] < 0.0 else None


def grows(about: Perturbation, newton: StaticNewton, motion: Array) -> bool:
    """Whether a motion grows that forces alone drive away, where bodies spin; False where it is not known. Collective."""
    system = about.system
    if system.fields or system.n_core > DENSE_LIMIT:
        return False
    small = first_order(projected(about, newton.solver, 1, shift=newton.weights.cm))
    growth = float(np.linalg.eigvals(small.A).real.max(initial=0.0))
    driven = -system.dot(motion, about.stiffness(motion)) / system.dot(motion, about.mass(motion))
    return growth > GROWS * np.sqrt(driven)


def _quotient(newton: StaticNewton, about: Perturbation, y: Array) -> float:
    """y^T K y by a difference of fourth order over a long way: what is slender is stretched by the square of its deflection."""
    system, s, way = about.system, about.state, 0.5 * WAY * about.system.length
    sides = (
        weight * newton.residual.values(newton.residual.at(system.compose(s.q, side * way * y), s.t), s.lam)[0]
        for side, weight in SIDES
    )
    return system.dot(y, sum(sides, np.zeros_like(y))) / (12.0 * way)
