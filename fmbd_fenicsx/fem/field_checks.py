"""Checks of an elastic field when it is built: linear functions, symmetry and sign of its form, locking, bending by first-order
cells; and, where it gets a frame, that its form does not resist rigid motion.
"""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np

from .. import dolfinx_compat as compat
from ..errors import InputError
from ..log import log
from ..rotations import Array
from .cell_volumes import least_volume
from .rigid_turns import RESISTED, resistance_to_turns, resists_shifts

SLENDER = 5.0  # length over height of bodies whose bending is looked at
STIFF = 2.0  # times as stiff in bending as they are that is told

LINEAR = 1e-8  # gradient of what a linear function of size 1 differs by in V_h: roundoff


def check_field(field: Any) -> None:
    """All checks of a new field; collective.

    Raises:
        InputError: displacements without linear functions; the elastic form is not symmetric, not positive or not finite.
    """
    _check_linear_functions(field)
    _check_stiffness(field)
    _warn_of_turning(field)
    _warn_of_locking(field)
    _warn_of_stiff_bending(field)


def check_start(field: Any, U: Array) -> None:
    """Refuse initial displacements U (n d,) of an energy that is not finite, or that turn cells inside out; collective.

    Raises:
        InputError: on all ranks alike.
    """
    energy = field.energy(U)
    if not np.isfinite(energy):
        raise InputError(
            f'Body "{field.name}": its elastic energy is {energy} J at the start. The initial displacement collapses or inverts '
            "cells, or the energy has no value at the start (a logarithm or a root of zero)."
        )
    volume = least_volume(field, U)
    if volume <= 0.0:
        raise InputError(
            f'Body "{field.name}": its initial displacement turns cells inside out (one to {volume:.3g} times its volume).'
        )


def check_free(field: Any) -> None:
    """Refuse an elastic form that resists translations of a body that gets a frame; collective.

    Raises:
        InputError: on all ranks alike. In u, the displacement in the frame, such a form would hold nothing in the world.
    """
    if resists_shifts(field):
        raise InputError(
            f'Body "{field.name}": its elastic form resists rigid motion, as a foundation does. In a floating frame it sees '
            "the displacement in the frame alone, which no foundation knows: take an AbsoluteBody, or springs and bushings "
            "between its surfaces and the ground."
        )


def _check_linear_functions(field: Any) -> None:
    """Refuse curved cells of an order above the displacements': the body could not turn without strain."""
    import ufl
    from dolfinx import fem

    domain, degree = field.mesh.dolfinx, field.forms.degree
    order = compat.coordinate_element(domain.geometry).degree
    if degree >= order:
        return

    x = fem.Function(field.space)
    x.x.array[: field.n * field.dim] = field.X_world.ravel()
    x.x.scatter_forward()
    off = ufl.grad(x) - ufl.Identity(field.dim)
    parts = ufl.inner(off, off) * ufl.dx, fem.Constant(domain, 1.0) * ufl.dx
    squares, volume = field.total(np.array([fem.assemble_scalar(compat.form(part)) for part in parts]))
    strain = np.sqrt(squares / volume)
    if strain > LINEAR:
        raise InputError(
            f'Body "{field.name}": displacements of degree {degree} on curved cells of order {order} contain no linear '
            f"functions (strains of {strain:.1e} are left), so the body could not turn freely. Take degree={order}, or cells of "
            f"order {degree}."
        )


def _check_stiffness(field: Any) -> None:
    """Symmetry of the elastic form, and its energy under rigid displacements, by random products."""
    rng = np.random.default_rng(7 + field.comm.rank)
    u, v = rng.standard_normal((2, field.n * field.dim))
    Ku, Kv = field.stiffness(u), field.stiffness(v)
    vKu, uKv, scale = field.total(np.array([v @ Ku, u @ Kv, np.abs(v) @ np.abs(Ku)]))

    if not np.isfinite(vKu):
        raise InputError(f'Body "{field.name}": the elastic form has entries that are not finite.')
    if abs(vKu - uKv) > 1e-9 * scale:
        raise InputError(
            f'Body "{field.name}": the elastic form is not symmetric: a(u, v) - a(v, u) = {vKu - uKv:.2e} for random '
            f"u, v of size a = {scale:.2e}. Write the stress with the symmetric gradient of u and pair it with that of v."
        )

    uKu, vKv = field.total(np.array([u @ Ku, v @ Kv]))
    if uKu <= 0 or vKv <= 0:
        raise InputError(
            f'Body "{field.name}": the elastic form is not positive (a(u, u) = {min(uKu, vKv):.2e}). '
            "Check the signs of the moduli (E > 0, -1 < nu < 0.5)."
        )

    # a form over some of the volumes leaves the nodes of the others without any
    bare = ~field.K.getDiagonal().array.reshape(-1, field.dim).any(axis=1)
    count, nodes = field.total(np.array([bare.sum(), len(bare)]))
    if count:
        places = np.concatenate(field.comm.allgather(field.X_world[bare][:1])).round(6).tolist()
        raise InputError(
            f'Body "{field.name}": {count} of {nodes} nodes have no stiffness (one at {places[0]}): the elastic '
            "form or energy leaves out a part of the body. Give a material to each volume of the mesh."
        )


def _warn_of_turning(field: Any) -> None:
    """A warning for a linear form that resists rotations and no translations: most often one of grad u."""
    if field.nonlinear or (share := resistance_to_turns(field)) <= RESISTED or resists_shifts(field):
        return
    log.warning(
        'body "%s": its elastic form resists a rotation with %.2g of the energy of a shear of that size, and no translation. '
        "Strains are sym(grad(u)), not grad(u)",
        field.name,
        share,
    )


def _warn_of_locking(field: Any) -> None:
    """Poisson's ratio from the energies of a stretch u = X and of a shear u = (y, x, 0); a warning where it is near 1/2."""
    if field.mixed:
        return
    d, x = field.dim, field.X

    # energies of a uniform swelling and of a simple shear tell lambda / mu
    shear = np.zeros_like(x)
    shear[:, 0], shear[:, 1] = x[:, 1], x[:, 0]
    pairs = [float(w.ravel() @ field.stiffness(w.ravel())) for w in (x, shear)]
    swell, slide = field.total(np.array(pairs))
    if not slide > 0:
        return

    ratio = (4 * swell / slide - 2 * d) / d**2  # lambda / mu of an isotropic homogeneous body
    field.poisson_ratio = ratio / (2 * (ratio + 1)) if ratio > -1 else -1.0

    # bending of P1 triangles: the error at 0.45 is twice that at 0.3
    limit = 0.45 if field.forms.degree == 1 else 0.495
    if field.poisson_ratio > limit + 1e-6:
        log.warning(
            'body "%s" has a Poisson ratio of %.5g: a displacement form of degree %d locks above %g; '
            "use elastic=nearly_incompressible(...) or energy=neo_hookean_mixed(...)",
            field.name,
            field.poisson_ratio,
            field.forms.degree,
            limit,
        )


def _warn_of_stiff_bending(field: Any) -> None:
    """A warning where first-order cells bend a slender body with far more energy than its strains have, (1).

        u = -x y a + x^2 / 2 b,    strain -y a a,    int C y^2 dV,  C of the stretch u = x a                         (1)

    with x, y along principal axes a, b, b the shorter one. What nodal values of u store beyond it is the shear of cells that
    cannot bend, of rectangles G l^2 / (C h^2), l their length and h the height of the body: that of a cantilever, more where
    nodes within the cells of a pattern give (crossed triangles).
    """
    if field.forms.degree != 1:
        return
    squares, axes = np.linalg.eigh(field.total(field.X.T @ field.mass(field.X)) / field.mass_total)
    worst = 0.0
    for short, long in combinations(range(field.dim), 2):
        if squares[long] < SLENDER**2 * squares[short]:
            continue
        b, a = axes[:, short], axes[:, long]
        x, y = field.X @ a, field.X @ b
        pure = np.outer(-x * y, a) + np.outer(0.5 * x**2, b), np.outer(x, a)
        bent, stretched = field.total(np.array([w.ravel() @ field.stiffness(w.ravel()) for w in pure]))
        worst = max(worst, bent / (stretched * squares[short]))
    if worst > STIFF:
        log.warning(
            'body "%s" has first-order cells, which make it up to %.3g times too stiff in bending; use degree=2 or shorter cells',
            field.name,
            worst,
        )
