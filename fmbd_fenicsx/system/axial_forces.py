"""How much of the stiffness of linear bodies the forces along them would change, which their forms leave out.

A force N along a slender body of length L works on the slopes of its displacements u, N int u'^2 dx / 2. In a moving frame what
the frame turns by is seen, the slopes in it are not, unless the body has ``stiffening``; in absolute coordinates none are. N
comes from the mean stress

    V sigma = sum_n f_n (X_n - c)^T                                                                         (1)

of nodal forces f that strain the body (of a field: f = K u), c its centre of mass, with what pressures add that turn with it
(:func:`..fem.loads.turned_virial`); the slopes from the displacements,

    int u'^2 dx = waves / L^2 int u^2 dx.                                                                   (2)

``waves`` is 4.6, 8.3, 12.3 for first shapes that are clamped at one end, pinned at both, clamped at both, in a frame at one
end; in mean axes 50 to 60 for the last two and for free ends. Runs and equilibria, which know no shapes, take the first of each
body as its joints hold it (``spins``).
"""

from __future__ import annotations

from collections.abc import Container, Sequence
from typing import Any

import numpy as np

from ..fem.loads import turned_virial
from ..log import log
from ..mechanics.elastic.absolute import AbsoluteField
from ..mechanics.elastic.modes import first_eigenvalue_bound, principal_axes
from ..mechanics.reduction.reduced import ReducedPart
from ..rotations import Array
from .evaluation import Evaluation
from .layout import Layout, State
from .spins import held_mode, in_linear_frames
from .system import System
from .tangents.foreshortened_ports import surface_forces

SHARE = 0.1  # of its stiffness in a shape that may be left out: a twentieth of the frequency
IN_RUNS = 0.25  # the same at an instant of a run, where forces come and go
ATTACHED, MEAN = 8.0, 55.0  # waves of (2) by the frame
STILL = 1e-6  # displacement of a body that takes no part in a shape, over the largest
# square of the first frequency clamped at one end over that without supports: the softest that joints hold
CLAMPED = 0.02
RIGID = 1e-6  # of that square, without supports, below which a shape is a rigid motion
SLENDER = 4.0  # length over the least thickness


class AxialForces:
    """Who looks at the linear bodies of a system that may be pressed or pulled along themselves; told is what leaves out more
    than a ``share`` of its stiffness. Bending does not follow what passes within 1 / omega_1: in a run, which starts at a time
    ``start`` (s), forces are told of that looks have found for so long. What pulls bodies that are ``spinning`` was
    told with them.
    """

    looks, between = 8, 20  # at a long run of equal steps, at least; steps between them, which cost less than a look

    def __init__(
        self, system: System, share: float = SHARE, start: float = -np.inf, spinning: Container[int] = ()
    ) -> None:
        self.system, self.share, self.spinning = system, share, spinning
        self.bodies = _bodies(system)
        self._asked, self._due = 0, 1  # looks that were asked for, and the next that is taken
        self._free = {k: _first_free(part) for k, part in self.bodies}
        self._since = dict.fromkeys(self._free, (0.0, start))  # sign of a force that counts, and when it was seen first

    def look(self, state: State) -> None:
        """Warn once of each body that leaves out too much; of many states at ever fewer. Collective."""
        self._asked += 1
        if not self.bodies or self._asked < self._due:
            return
        self._due = self._asked + self._asked // self.looks + 1

        ev = self.system.at(state.t, state.q, state.v)
        on_surfaces = _on_surfaces(ev, state.lam, self.bodies)
        for k, part in list(self.bodies):
            force, length = axial_force(ev, k, part, on_surfaces)
            share, omega = self._share(ev, k, part, _slopes(ev, part, force, length))
            sign, since = self._since[k]

            if share <= self.share:
                self._since[k] = 0.0, state.t
            elif sign * force < 0.0:
                self._since[k] = np.sign(force), state.t
            elif omega * (state.t - since) <= 1.0:
                self._since[k] = np.sign(force), since
            else:
                self.bodies.remove((k, part))
                if force > 0.0 and k in self.spinning:
                    continue
                _tell(part.name, force, share, "in bending between its joints")

    def _share(self, ev: Evaluation, k: int, part: Any, slopes: float) -> tuple[float, float]:
        """What is left out of the first shape as joints hold it, and its frequency (rad/s); 0 where no joints make it count."""
        if slopes <= self.share * CLAMPED * self._free[k]:
            return 0.0, 0.0
        omega, shape = held_mode(ev, k, part)
        return slopes * _over_stiffness(part, shape), omega


def tell_axial_forces(ev: Evaluation, lam: Array, shapes: Sequence[tuple[float, Array]]) -> None:
    """Warn of each body whose form leaves out a share of its stiffness in one of the ``shapes`` that is not small."""
    for name, force, share, frequency in left_out(ev, lam, shapes):
        if share > SHARE:
            _tell(name, force, share, f"in the mode of {frequency:.4g} Hz")


def _tell(name: str, force: float, share: float, where: str) -> None:
    pulled = force > 0
    log.warning(
        'body "%s" is %s along itself by some %.3g N, which %s %s of its stiffness %s; its linear form leaves that out%s. Take '
        "stiffening=True with an attached frame, an energy, or a Rod",
        name,
        "pulled" if pulled else "pressed",
        abs(force),
        "adds" if pulled else "takes",
        f"some {100.0 * share:.0f} %" if share < 1.0 or pulled else "all",
        where,
        "" if pulled else ", and it does not buckle",
    )


def _bodies(system: Layout) -> list[tuple[int, Any]]:
    """Linear bodies without stiffening, in moving frames or in absolute coordinates."""
    still = [(k, p) for k, p in system.fields if isinstance(p, AbsoluteField) and not p.field.nonlinear]
    return [(k, part) for k, part, stiffened in in_linear_frames(system) if not stiffened] + still


def left_out(
    ev: Evaluation, lam: Array, shapes: Sequence[tuple[float, Array]]
) -> list[tuple[str, float, float, float]]:
    """Of each linear body without stiffening its name, the mean force (N) along it, and where it matters most among ``shapes``
    (frequencies in Hz, increments like v): its share of the stiffness there, by (2), and the frequency; collective.
    """
    bodies = _bodies(ev.system)
    on_surfaces = _on_surfaces(ev, lam, bodies)
    found = []
    for k, part in bodies:
        force, length = axial_force(ev, k, part, on_surfaces)
        moved, frequency = max((_over_stiffness(part, ev.system.local_v(y, k)), f) for f, y in shapes)
        found.append((part.name, force, _slopes(ev, part, force, length) * moved, frequency))
    return found


def _on_surfaces(ev: Evaluation, lam: Array, bodies: Sequence[tuple[int, Any]]) -> Array:
    """Forces on the surfaces in use, (n_port,); fields tell theirs by their strains."""
    return surface_forces(ev, lam) if any(isinstance(part, ReducedPart) for _, part in bodies) else np.zeros(0)


def _slopes(ev: Evaluation, part: Any, force: float, length: float) -> float:
    """waves |N| / (m L), 1/s^2: by (2) the work of a force on the slopes of a shape over its mass times displacements squared."""
    waves = MEAN if part.frame < ev.system.n_frames and part.mean_rates is None else ATTACHED
    return waves * abs(force) / (part.mass_total * length)


def axial_force(ev: Evaluation, k: int, part: Any, on_surfaces: Array) -> tuple[float, float]:
    """Mean force (N, tension positive) along a principal axis of the body k, the largest, and its length (m); none of a body that
    is not slender. Collective.
    """
    if isinstance(part, ReducedPart):
        stress = part.virial(on_surfaces[ev.system.port_slice(k)], ev.t, ev.rotation[part.frame])
        sizes, axes = part.constants.derived.principal
    else:
        f = part.field
        strained = f.stiffness(ev.system.local_q(ev.q, k)) - f.loads.constant(ev.t, ev.rotation[part.frame])[1].ravel()
        carried = f.loads.carried(ev.t).T @ f.X
        stress = f.total(strained.reshape(f.X.shape).T @ f.X + turned_virial(carried))
        sizes, axes = principal_axes(f)

    length = float(np.sqrt(12.0 * sizes[-1] / part.mass_total))
    if sizes[0] * SLENDER**2 > sizes[-1]:
        return 0.0, length
    along = np.einsum("ia,ij,ja->a", axes, stress, axes)
    return float(along[np.abs(along).argmax()]) / length, length


def _over_stiffness(part: Any, u: Array) -> float:
    """Mass times displacements squared of a shape over twice its energy of strain, s^2; collective."""
    if isinstance(part, ReducedPart):
        moved = float(np.real(u.conj() @ part.constants.derived.mass @ u))
        strained = float(np.real(u.conj() @ part.constants.K @ u))
    else:
        field = part.field
        sums = np.zeros(2)
        for x in (np.ascontiguousarray(u.real), np.ascontiguousarray(u.imag)):
            sums = sums + (x @ field.mass(x.reshape(-1, field.dim)).ravel(), x @ field.stiffness(x))
        moved, strained = field.total(sums).tolist()

    still = moved <= STILL**2 * part.mass_total
    if still or strained <= RIGID * _first_free(part) * moved:
        return 0.0
    return moved / strained


def _first_free(part: Any) -> float:
    """Square of the first frequency without supports, (rad/s)^2; collective."""
    return part.first_frequency**2 if isinstance(part, ReducedPart) else first_eigenvalue_bound(part.field)
