"""Mobility of a scene: degrees of freedom, rank of the constraints, redundant rows by joint, signs of unusual input.

With U_0 the left vectors of singular values that count as zero, see :mod:`.dependence`,

    freedom = velocities - rank,   redundancy = rows - rank = sum over joints of |U_0 rows of the joint|^2          (1)
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..energies import MixedEnergy
from ..log import log
from ..matrices import dense, singular_values
from ..mechanics.bodies.beams import Beam
from ..mechanics.forces.dry_friction import DryFriction
from ..mechanics.forces.force_elements import ScalarLoads
from ..mechanics.joints.joints import ground
from ..mechanics.reduction.craig_bampton import FrameModes, ReducedBody
from ..mechanics.reduction.reduced import ReducedPart
from ..rotations import Array
from .compiled.declarations import constants
from .dependence import DEPENDENT, NEAR_SINGULAR, rows_are_independent, scaled_jacobian, scaled_rows
from .evaluation import Evaluation
from .layout import RowBlock
from .lengths import FITS
from .spins import mode_by_modes
from .system import System

(SOFT,) = constants("parts.h", "SOFT")  # share of a row's compliance that solutions beside dependent rows add
SHARE = 0.02  # of a first frequency that half of the modes may change
HELD = 1e-6  # part of a rotation in the rows of a joint that is none
LOOK = 300  # constraint rows up to which modes of bodies are looked at
ALIKE = 1e-10  # those below this share leave nothing that could be seen in multipliers
CLEAR = math.sqrt(SOFT)  # rows that solutions beside dependent ones hold apart in one increment
LEAST_SHARE = 0.005  # of a row, that is listed
YIELDING = 0.1  # rad, or of the model's length: dry friction that gives way by more before it slides is told
LOCKED = 1e-2  # part of modes in rows, over that of what moves them most, below which they are not meant to give way


@dataclass(frozen=True)
class Mobility:
    """Mobility of a scene in one configuration.

    Attributes:
        velocities: unknown velocity components (all nodes of elastic bodies counted).
        rows, rank: constraint rows and how many of them are independent. ``freedom`` = velocities - rank.
        shares: joint -> its share in the redundancy; the shares add up to ``redundant``.
        conditioning: smallest nonzero singular value of the scaled G over the largest.
        weakest: joint -> its share in what that value is of.
        open: largest residual of the constraints as given (m).
        misfit: largest singular value over the largest of those that count as zero: by how much dependent rows differ.
        notes: what looks unusual, one sentence each.
    """

    velocities: int
    rows: int
    rank: int
    shares: dict[str, float]
    conditioning: float
    open: float
    notes: tuple[str, ...] = ()
    misfit: float = 0.0
    weakest: dict[str, float] = field(default_factory=dict)

    @property
    def freedom(self) -> int:
        """Degrees of freedom, 1."""
        return self.velocities - self.rank

    @property
    def redundant(self) -> int:
        """Dependent constraint rows, 1."""
        return self.rows - self.rank

    def __str__(self) -> str:
        lines = [
            "mobility",
            f"  degrees of freedom   {self.freedom:>6}   ({self.velocities} velocities, rank {self.rank})",
            f"  constraint rows      {self.rows:>6}   ({self.redundant} redundant)",
            f"  conditioning      {self.conditioning:9.1e}   (1 is best; below {NEAR_SINGULAR:.0e}: near-singular)",
            f"  open by           {self.open:9.1e} m",
        ]
        for joint, share in self.shares.items():
            if share < LEAST_SHARE:
                continue
            lines.append(f'  redundant: joint "{joint}" takes part with {share:.2f} rows; its reaction is not unique')
        return "\n".join(lines + [f"  note: {n}" for n in self.notes])


def mobility(ev: Evaluation) -> Mobility:
    """Mobility of a system in one configuration."""
    system = ev.system
    velocities = system.n_core + sum(p.field.n_global for _, p in system.fields)
    if not system.n_lam:
        return Mobility(velocities, 0, 0, {}, 1.0, 0.0)

    found = scaled_rows(ev)
    loose, sizes = found.loose, found.sizes
    part = (found.vectors[:, :loose] ** 2).sum(1)  # the share of each row in what depends on others
    # dependence has no culprit: every row that takes part bears its share
    shares = _by_joint(ev, part)
    return Mobility(
        velocities,
        system.n_lam,
        found.rank,
        {name: x for name, x in shares.items() if x > 1e-6},
        float(sizes[loose]) if found.rank else 0.0,
        float(np.abs(ev.constraint()).max()),
        misfit=float(sizes[loose - 1]) if loose and found.rank else 0.0,
        weakest=_by_joint(ev, found.vectors[:, loose] ** 2) if found.rank else {},
    )


def _by_joint(ev: Evaluation, parts: Array) -> dict[str, float]:
    """Parts of rows, (rows,), summed for each joint."""
    return {b.name: float(parts[b.rows].sum()) for b in ev.system.blocks}


def nearly_dependent(ev: Evaluation, rank: int, *, evens: bool = True) -> tuple[float, str]:
    """sigma_rank / sigma_1 of the scaled G, as :func:`~.dependence.scaled_rows`, and the joint with the largest part in that
    smallest singular vector.
    """
    size, vector = scaled_rows(ev, evens=evens).of(rank)
    part = _by_joint(ev, vector**2)
    return size, max(part, key=lambda name: part[name])


def nearly_the_same(found: Mobility) -> str:
    """Which joints hold nearly the same, beside rows that depend on each other, as sentences; "" where none do.

    Solutions with softened rows (``algebra/factor.c``) hold rows apart that differ by more than ``CLEAR``.
    """
    if not found.redundant or not found.rank or found.conditioning >= CLEAR:
        return ""
    joints = ", ".join(f'"{name}"' for name, share in found.weakest.items() if share > 0.1)
    return (
        f"joints {joints} hold nearly the same: what they hold beyond each other moves by {found.conditioning:.1e} of what "
        "moves other rows. Whether this scene moves, and by which forces, hangs on that: they are up to "
        f"{1.0 / found.conditioning:.0e} times the loads, and steps that cannot hold such rows apart fail. Let points and axes "
        f"agree to {DEPENDENT:.0e} of the model's length, so that they count as the same, or replace one joint by a bushing or "
        "by joints that hold less"
    )


def locked_modes(ev: Evaluation) -> str:
    """Whose modes joints hold although they hardly take part in them, as a sentence; "" where none are.

    With the scaled rows G_s = [F, E], E the columns of the modes of reduced bodies, and N^T F = 0, the rows N^T E = 0 are what
    joints hold beyond what rigid bodies need. Modes that a row moves by far less than others do, by the asymmetry of a mesh, are
    locked, and the forces that lock them are as much too large.
    """
    s = ev.system
    reduced = [(s.slices[1][k], part) for k, part in s.core_parts if isinstance(part, ReducedPart) and part.n]
    if not reduced or not 0 < s.n_lam <= LOOK or rows_are_independent(ev, LOCKED):
        return ""

    modes = np.concatenate([np.arange(span.start, span.stop) for span, _ in reduced])
    G = scaled_jacobian(ev)
    U, size, _ = singular_values(np.delete(G, modes, axis=1))
    N = U[:, int((size > DEPENDENT * size[0]).sum()) :]
    rows, share, motions = singular_values(N.T @ G[:, modes], full=False)
    share /= size[0]
    locked = np.flatnonzero((share > DEPENDENT) & (share < LOCKED))
    if not len(locked):
        return ""

    # the one that gives way least
    k = int(locked[-1])
    motion = np.zeros(s.n_core)
    motion[modes] = motions[k] ** 2
    body = max(reduced, key=lambda item: motion[item[0]].sum())[1].name
    parts = (N @ rows[:, k]) ** 2
    joints = ", ".join(f'"{b.name}"' for b in s.blocks if parts[b.rows].sum() > 0.1)
    return (
        f'the modes of body "{body}" are locked: joints {joints} hold more than rigid bodies need, and its modes give way to '
        f"that by {share[k]:.1e} of what moves other rows, so that forces there are far too large. Take more modes, "
        "reduced(basis=fmbd.CraigBampton(...)) with the surfaces of these joints, or joints that hold less"
    )


def tell_of_modes(ev: Evaluation) -> None:
    """Warn of reduced bodies whose modes joints lock, or that joints hold too stiffly by them."""
    found = doubtful_modes(ev)
    if found:
        log.warning("%s", found)


def doubtful_modes(ev: Evaluation) -> str:
    """Whose modes do not fit the joints, as a sentence: those that are locked, and those that are too stiff; "" where all do."""
    return locked_modes(ev) or stiff_modes(ev)


def loose_bodies(scene: Any) -> list[str]:
    """Bodies that no joint and no force attaches to anything and no contact can hold, where there are joints or forces at all."""
    bodies = scene.bodies
    parts = (*scene.joints.values(), *scene.ties.values(), *scene.forces.values())
    sides = [side for part in parts for side in (part.a, part.b) if side is not None and side is not ground]
    attached = {side.body.name for side in sides}
    attached |= _touching(scene) if attached else set()
    if not attached:
        return []

    free = [n for n, b in bodies.items() if n not in attached and not b.locked]
    return [n for n in free if not bodies[n].alone]


def _touching(scene: Any) -> set[str]:
    """Names of the bodies that take part in contacts: by a surface, by points, or by an obstacle that they carry."""
    from ..mechanics.contact.obstacles import Obstacle

    carriers = (
        pair.master.on if isinstance(pair.master, Obstacle) else pair.master.body for pair in scene.contacts.values()
    )
    slaves = (pair.slave.body for pair in scene.contacts.values())
    return {body.name for body in (*carriers, *slaves) if body is not None}


def check(scene: Any, deep: bool = False) -> Mobility:
    """Mobility of a scene as given, with notes on loose bodies, units and time scales; collective.

    ``deep``: also the inf-sup constants of the surface ties, here and on halved meshes, and of displacement and pressure.
    """
    system, state, _ = scene.build()
    ev = system.at(state.t, state.q)
    found = mobility(ev)

    notes = [f'body "{n}" is attached to nothing' for n in loose_bodies(scene)]
    notes += _units(system)
    notes += [
        f'tie "{tie.name}" leaves free: {", ".join(free)}' for tie, _ in system.traces if (free := tie.left_free())
    ]
    notes += _weak_ties(scene) + _pressures(scene) if deep else []

    if found.conditioning < NEAR_SINGULAR:
        notes.append(
            "the configuration is near-singular: constraints almost depend on each other, or a motion branches here"
        )
    notes += [near] if (near := nearly_the_same(found)) else []
    if found.misfit > ALIKE:
        notes.append(f"rows that differ by {found.misfit:.1e} of what moves them most count as the same")
    notes += [stiff] if (stiff := doubtful_modes(ev)) else []
    if found.open > 1e-6 * system.length:
        small = found.open <= FITS * system.length
        then = (
            "the start of a run closes them" if small else "a run refuses them: bodies are not where their joints are"
        )
        notes.append(f"the constraints are open by {found.open:.2g} m; {then}")

    # springs on bodies of the mean mass: a time step far longer sees nothing of them
    stiffest = float(stiffnesses(system).max(initial=0.0))
    fastest = np.sqrt(stiffest / (system.mass / max(len(system.frame_names), 1)))
    if fastest > 0:
        notes.append(
            f"springs: shortest period about {2 * np.pi / fastest:.2g} s (mean mass of a body, at the model's length from angles)"
        )

    notes += _yielding_friction(scene, system.length)

    return replace(found, notes=tuple(notes))


def _yielding_friction(scene: Any, length: float) -> list[str]:
    """Dry friction that is a spring over a good part of any motion: F / k above a tenth of a radian, or of the model's length."""
    sliders = [f for f in scene.forces.values() if isinstance(f, DryFriction)]
    return [
        f'dry friction "{f.name}" is a spring for {f.limit / f.stiffness:.3g} {f.on.unit} (limit / stick) before it slides'
        for f in sliders
        if f.limit / f.stiffness > YIELDING * (1.0 if f.on.unit == "rad" else length)
    ]


def _weak_ties(scene: Any) -> list[str]:
    """Ties whose multipliers are not controlled by the displacements, one by one and together."""
    from ..fem.traces.tie_stability import infsup_refined, infsup_together

    if not scene.ties:
        return []
    found = [(name, infsup_refined(tie)) for name, tie in scene.ties.items()]
    notes = [f'tie "{name}": {result}' for name, result in found if not result.stable]
    if len(found) > 1 and not notes:
        together = infsup_together(list(scene.ties.values()))
        notes += [] if together.stable else [str(together)]
    return notes


def _pressures(scene: Any) -> list[str]:
    """Inf-sup constants of displacement and pressure in mixed bodies, on their own meshes."""
    mixed = [b for b in scene.bodies.values() if b.nodal and isinstance(b.elastic_law, MixedEnergy)]
    if not mixed:
        return []
    from ..fem.pressure_stability import infsup_pressure

    constants = [(b.name, infsup_pressure(b.mesh, b.degree)[0]) for b in mixed]
    return [
        f'body "{name}": displacement and pressure have the inf-sup constant {beta:.3f}' for name, beta in constants
    ]


def stiffnesses(system: System) -> Array:
    """Those of linear springs, N/m, without zeros; that of an angle acts at the end of a lever of the model's length."""
    every = [np.zeros(0)]
    for loads in system.forces:
        if isinstance(loads, ScalarLoads):
            turning = [f.coordinate is not None and f.coordinate.unit == "rad" for f in loads.forces]
            every.append(np.abs(loads.k) / np.where(turning, system.length**2, 1.0))
    found = np.concatenate(every)
    return found[found > 0.0]


def _units(system: System) -> list[str]:
    """Sizes that suggest other units than m, kg, s."""
    notes = []
    g = system.gravity.size
    if g > 0 and not 1.0 < g < 30.0:
        notes.append(f"gravity is {g:g} m/s^2; in SI units it is 9.81 on Earth")
    if not 1e-4 < system.length < 1e5:
        notes.append(f"the model is {system.length:g} m long; lengths are in m")
    return notes


def stiff_modes(ev: Evaluation) -> str:
    """Which reduced bodies have modes that do not give way to the joints that hold them, as a sentence; "" where none do.

    Modes of a free body, or of one clamped elsewhere, carry no force on its surfaces: what a clamp bends there is the sum of many
    of them. By m modes the first frequency of a strip in a clamp is some 1.4 / m of it too high, by those of Craig and Bampton it
    is right at once. What half of the modes tell shows how far all of them are off.
    """
    s = ev.system
    free = [(k, part) for k, part in s.core_parts if isinstance(part, ReducedPart) and _by_frequency(part)]
    if not free or not 0 < s.n_lam <= LOOK:
        return ""

    rows = dense(ev.jacobian.core)
    for k, part in free:
        if not any(_turns_with(ev, k, part, rows, block) for block in s.blocks):
            continue
        all_modes, half = (mode_by_modes(ev, k, part, n)[0] / (2 * np.pi) for n in (part.n, part.n // 2))
        if half > (1 + SHARE) * all_modes or np.isinf(all_modes):
            found = f"{_hertz(all_modes)} by all of them, {_hertz(half)} by half"
            return (
                f'body "{part.name}" is stiffer between its joints by its {part.n} modes than it is: its first frequency there '
                f"is {found}. {_remedy(part)}"
            )
    return ""


def _remedy(part: ReducedPart) -> str:
    if isinstance(part.body, Beam):
        return "Take modes=None, which keeps all of its elements"
    return "Take reduced(basis=fmbd.CraigBampton(...)) with the surfaces that joints hold"


def _hertz(frequency: float) -> str:
    return f"{frequency:.4g} Hz" if np.isfinite(frequency) else "none"


def _turns_with(ev: Evaluation, k: int, part: ReducedPart, rows: Array, block: RowBlock) -> bool:
    """Whether a joint holds a rotation of its point on the reduced body k: forces alone are carried by few modes."""
    s, n, d = ev.system, ev.system.motions.n_twist, ev.system.motions.dim
    of_joint = rows[block.rows.start : block.rows.stop]
    if block.a < 0 or not of_joint[:, s.slices[1][k]].any():
        return False

    # rotations of the frame about the point of the joint
    on_frame = of_joint[:, n * part.frame : n * (part.frame + 1)]
    place, axes = ev.q[s.motions.n_pose * part.frame :][:d], np.eye(n - d)
    lever = place - ev.kin.x[block.a]
    turned = axes @ ev.rotation[part.frame].T if d == 3 else axes
    about = np.cross(turned, lever) if d == 3 else np.array([[-lever[1], lever[0]]])
    moved = on_frame @ np.hstack((about, axes)).T
    return bool(np.abs(moved).max() > HELD * np.abs(on_frame[:, d:]).max(initial=0.0))


def _by_frequency(part: ReducedPart) -> bool:
    """Whether a body has vibration modes alone, the lowest first."""
    body = part.body
    alone = body.modes is not None if isinstance(body, Beam) else _has_frame_modes(body)
    return alone and part.n > 1


def _has_frame_modes(body: Any) -> bool:
    return isinstance(body, ReducedBody) and isinstance(body.basis, FrameModes)
