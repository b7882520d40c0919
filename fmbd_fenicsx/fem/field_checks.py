"""Checks of an elastic field when it is built: linear functions, symmetry and sign of its form, locking, thin first-order cells;
and, where it gets a frame, that its form does not resist rigid motion.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .. import dolfinx_compat as compat
from ..errors import InputError
from ..log import log
from ..rotations import Array
from .cell_volumes import least_volume
from .rigid_turns import RESISTED, resistance_to_turns, resists_shifts

# length over height of first-order cells above which bending is far too stiff (1:1000 measured: 280 times)
SLENDER = 50.0

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
    _warn_of_slender_cells(field)


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


def _warn_of_slender_cells(field: Any) -> None:
    """A warning for first-order simplices that are longer than ``SLENDER`` times their height."""
    if field.forms.degree != 1:
        return
    aspect = max(field.comm.allgather(_largest_aspect(field.mesh.dolfinx)))
    if aspect > SLENDER:
        log.warning(
            'body "%s" has first-order cells %.3g times as long as high: they are far too stiff in bending; use degree=2 or '
            "shorter cells",
            field.name,
            aspect,
        )


def _largest_aspect(msh: Any) -> float:
    """Largest edge over height d V / A of this rank's cells (A the largest facet), straight simplices; 0 for others."""
    cells = compat.geometry_dofmap(msh)
    d = msh.topology.dim
    if not len(cells) or cells.shape[1] != d + 1:
        return 0.0

    x = msh.geometry.x[cells]  # (cells, d + 1, 3)
    pairs = [(i, j) for i in range(d + 1) for j in range(i)]
    edge = np.max([np.linalg.norm(x[:, i] - x[:, j], axis=1) for i, j in pairs], axis=0)
    if d == 1:
        return 1.0

    a = x[:, 1] - x[:, 0]
    b = x[:, 2] - x[:, 0]
    if d == 2:
        twice = np.linalg.norm(np.cross(a, b), axis=1)
        return float(np.max(edge**2 / twice))

    six = np.abs(np.einsum("ci,ci->c", np.cross(a, b), x[:, 3] - x[:, 0]))
    faces = [np.cross(x[:, j] - x[:, i], x[:, k] - x[:, i]) for i, j, k in ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3))]
    return float(np.max(edge * np.max([np.linalg.norm(f, axis=1) for f in faces], axis=0) / six))
