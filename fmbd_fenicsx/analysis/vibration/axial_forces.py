"""How much of the stiffness of linear bodies in moving frames the forces along them would change, which their forms leave out.

A force N along a slender body of length L works on the slopes of its displacements u in the frame, N int u'^2 dx / 2. What the
frame turns by is seen, this is not, unless the body has ``stiffening``. N comes from the mean stress

    V sigma = sum_n f_n (X_n - c)^T                                                                         (1)

of nodal forces f that strain the body (of a field: f = K u), c its centre of mass; the slopes from the displacements,

    int u'^2 dx = waves / L^2 int u^2 dx.                                                                   (2)

``waves`` is 4.6, 8.3, 12.3 for first shapes that are clamped at one end, pinned at both, clamped at both, in a frame at one
end; in mean axes 50 to 60 for the last two and for free ends.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...log import log
from ...mechanics.reduction.reduced import ReducedPart
from ...rotations import Array
from ...system.evaluation import Evaluation
from ...system.spins import in_linear_frames
from ...system.tangents.foreshortened_ports import surface_forces

SHARE = 0.1  # of its stiffness in a shape that may be left out: a twentieth of the frequency
ATTACHED, MEAN = 8.0, 55.0  # waves of (2) by the frame
STILL = 1e-6  # displacement of a body that takes no part in a shape, over the largest


def tell_axial_forces(ev: Evaluation, lam: Array, shapes: Sequence[tuple[float, Array]]) -> None:
    """Warn of each body whose form leaves out a share of its stiffness in one of the ``shapes`` that is not small."""
    for name, force, share, frequency in left_out(ev, lam, shapes):
        if share > SHARE:
            log.warning(
                'body "%s" is %s along itself by some %.3g N: of its stiffness in the mode of %.4g Hz that %s some %.0f %%, '
                "which its linear form leaves out; nor does it buckle. Take stiffening=True with an attached frame, an energy, "
                "or a Rod",
                name,
                "pulled" if force > 0 else "pressed",
                abs(force),
                frequency,
                "adds" if force > 0 else "takes",
                100.0 * share,
            )


def left_out(
    ev: Evaluation, lam: Array, shapes: Sequence[tuple[float, Array]]
) -> list[tuple[str, float, float, float]]:
    """Of each linear body without stiffening its name, the mean force (N) along it, and where it matters most among ``shapes``
    (frequencies in Hz, increments like v): its share of the stiffness there, by (2), and the frequency; collective.
    """
    bodies = [(k, part) for k, part, stiffened in in_linear_frames(ev.system) if not stiffened]
    on_surfaces = surface_forces(ev, lam) if bodies else np.zeros(0)
    found = []
    for k, part in bodies:
        force, length = axial_force(ev, k, part, on_surfaces)
        waves = ATTACHED if part.mean_rates is not None else MEAN
        moved, frequency = max((_over_stiffness(part, ev.system.local_v(y, k)), f) for f, y in shapes)
        found.append((part.name, force, waves * abs(force) * moved / (part.mass_total * length), frequency))
    return found


def axial_force(ev: Evaluation, k: int, part: Any, on_surfaces: Array) -> tuple[float, float]:
    """Mean force (N, tension positive) along a principal axis of the body k, the largest, and its length (m); collective."""
    d = ev.system.motions.dim
    if isinstance(part, ReducedPart):
        constants = part.constants
        centre, second = constants.S[:, 0] / constants.mass, constants.T[0, 0]
        stress = part.virial(on_surfaces[ev.system.port_slice(k)], ev.t, ev.rotation[part.frame], centre)
    else:
        f, u = part.field, ev.system.local_q(ev.q, k)
        MX = f.mass(f.X)
        first, second = f.total(MX.T @ np.ones(f.n)), f.total(MX.T @ f.X)
        centre = first / f.mass_total
        strained = f.stiffness(u).reshape(-1, d) - f.loads.constant(ev.t, ev.rotation[part.frame])[1]
        stress = f.total(strained.T @ (f.X - centre))

    sizes, axes = np.linalg.eigh(second - part.mass_total * np.outer(centre, centre))
    length = float(np.sqrt(12.0 * sizes[-1] / part.mass_total))
    along = np.einsum("ia,ij,ja->a", axes, stress, axes)
    return float(along[np.abs(along).argmax()]) / length, length


def _over_stiffness(part: Any, u: Array) -> float:
    """Mass times displacements squared of a shape over twice its energy of strain, s^2; collective."""
    if isinstance(part, ReducedPart):
        M = np.trace(part.constants.T[1:, 1:], axis1=2, axis2=3)
        moved, strained = (float(np.real(u.conj() @ A @ u)) for A in (M, part.constants.K))
    else:
        f = part.field
        parts = [np.ascontiguousarray(x) for x in (u.real, u.imag)]
        sums = [np.array([x @ f.mass(x.reshape(-1, f.dim)).ravel(), x @ f.stiffness(x)]) for x in parts]
        moved, strained = f.total(sum(sums)).tolist()
    return moved / strained if moved > STILL**2 * part.mass_total else 0.0
