"""Placements: how the points of a body move. What every part of a system offers, and all rigid bodies at once.

A rigid body has x = r + R X and the inertia m (r'' - g), J w' + w x J w. Elastic placements have files of their own:
``mechanics.elastic.floating`` x = r + R (X + u), ``mechanics.elastic.absolute`` x = X + u,
``mechanics.reduction.reduced`` x = r + R (X + Phi eta).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TypeGuard

import numpy as np

from ..checks import check_fields
from ..rotations import Array, Motions

if TYPE_CHECKING:
    from ..fem.fields import Field
    from ..fem.given_numbers import GivenNumbers
    from .elastic.foreshortening import Bent, Shortening


@dataclass(frozen=True)
class FrameMotion:
    """What a part needs of its frame: time (s), rotation (d, d), twist and its rate (n_twist,), gravity (d,), world axes.

    ``pull`` (r,): forces (N) and moments (N m) along its ports of second order, for tangents; None for a part without such ports.
    """

    t: float
    R: Array
    twist: Array
    accel: Array | None
    gravity: Array
    pull: Array | None = None


@dataclass(frozen=True)
class MeanAxis:
    """Tisserand frame: int rho u = 0 and int rho X x u = 0, so the frame follows the body's mean motion."""


@dataclass(frozen=True)
class Attached:
    """A frame in which the named surface does not move, on average."""

    surface: str

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True)
class Chord:
    """A frame through the mean points of two surfaces: the first stays where it is, the second on the line to it.

    In space the frame does not turn about the chord against the first surface, on average.
    """

    start: str
    end: str

    def __post_init__(self) -> None:
        check_fields(self)


class Approach(NamedTuple):
    """What led to where a tangent is taken, ``moved`` of local coordinates (n,): Newton's increment, or the motion predicted."""

    moved: Array
    predicted: bool = False


class Part(Protocol):
    """A block of local coordinates u of one body, beside the twist of its frame (the ground for absolute placements).

    ``ports`` are linear functions of u that joints, forces and sensors see. ``distributed`` parts hold this rank's share of
    a field; others are replicated and give their matrices to the core. What is given here is that of a replicated part with
    constant ports; a part inherits it and defines the rest.
    """

    name: str
    frame: int
    n: int
    n_port: int
    reference: Array  # (n_port,) ports of the body at the start
    port_matrix: Array  # (n_port, n), replicated parts only
    distributed: bool = False
    n_frame_rows: int = 0
    comm: Any = None
    body: Any = None  # of the scene
    numbers: GivenNumbers | None = None  # in the forms that it was made of, None: no forms
    mass_total: float = 0.0  # kg
    size: float = 0.0  # m
    rms: Array | None = None  # (n,) root mean square displacement by amplitudes of one, m; None: no amplitudes
    mean_rates: Array | None = None  # (n_twist, n) mean twist of its mass in its frame by u', body axes; None: none
    shortening: Shortening | None = None  # of ports that are of second order in u
    constant_mass: Array | None = None  # (n, n) of the local coordinates; None: it moves with the part
    leaves_out: bool = False  # whether Newton's matrix lacks terms of its motion: gyroscopic and centrifugal ones
    # whether ``force`` may depend on time beside the motion: one that does not is asked once for each
    of_time: bool = True

    together: bool = False  # whether ``force_many`` tells the rows of many motions by one call

    def remember(self, m: Any) -> None:
        """Write to a checkpoint what the part remembers beside its coordinates, or take it from there: nothing, unless it holds a
        frozen tangent; collective.
        """
        return None

    def lengths(self, length: float) -> Array:
        """What turns increments of the local coordinates into lengths (m), for a model of a size (m): (n,)."""
        return np.ones(self.n) if self.rms is None else self.rms

    def frame_lengths(self, length: float) -> Array:
        """What turns the values of the frame conditions into lengths (m), for a model of a size (m): (n_frame_rows,)."""
        return np.ones(self.n_frame_rows)

    def ports_of(self, w: Array, t: float) -> Array:
        """Ports of local coordinates, where they are at time t (s), without the reference part; collective."""
        return np.asarray(self.port_matrix @ w)

    def port_force(self, f: Array, t: float) -> Array:
        """Transpose of ``ports_of``."""
        return np.asarray(self.port_matrix.T @ f)

    def force(self, motion: FrameMotion, local: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        """Rows of the frame (n_twist,) and of the local coordinates (n,) of M a + h; collective."""

    def energies(self, motion: FrameMotion, pose: Array, local: tuple[Array, Array]) -> tuple[float, float, float]:
        """Kinetic, elastic and weight energy, J; collective."""

    def momenta(self, motion: FrameMotion, pose: Array, local: tuple[Array, Array]) -> tuple[Array, Array]:
        """Linear and angular momentum about the world origin; collective."""

    def given(self, motion: FrameMotion, local: tuple[Array, Array]) -> dict[str, float] | None:
        """Power (W) of its loads, its damping and so on, by kind; None where they cannot be told apart. Collective."""
        return None

    def mass_blocks(self, motion: FrameMotion, u: Array) -> tuple[Array, Array, Array]:
        """Mass blocks (frame, frame), (local, frame), (local, local); the last two for replicated parts only."""

    def stiffness_blocks(self, motion: FrameMotion, local: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        """Stiffness and damping of the local coordinates with two rates, (n, n) each; replicated parts only."""


class DistributedPart(Part, Protocol):
    """This rank's share of a displacement field, with what the elimination of the field from (cm M + cd C + ck K) x = b needs.

    ``inertia_columns`` (n, k): couple the field's inertia to the twist of its frame (k = n_twist, or 0 without a moving frame).
    ``shared_columns``: the frame conditions have these same columns. :meth:`column_version` and ``tangent_version`` are new
    numbers whenever the columns or the field's tangent have changed.
    """

    field: Field
    inertia_columns: Array
    shared_columns: bool = False
    moves_ports: bool = False  # whether its ports move along it, see ``port_entries``
    weights: Array | None = None  # (d, n): what gravity along each axis acts with on numbers that are no places
    traces: Sequence[Any] = ()  # sparse rows (rows, n) of ties by field multipliers, the last of the ports
    heavier: tuple[Array, Array] | None = None  # V (n, k) and C (k, k) of a mass V C V^T beside the field's own
    slack: np.ndarray | None = None  # one-sided springs that the tangent leaves out
    shown: Bent | None = None  # the second order of the ports that the columns hold

    @property
    def turns_little(self) -> str:
        """Why it may turn a little only, with place for the {strain} of a turn; it knows its ``mean_rotation``. Else nothing."""
        return ""

    def column_version(self, t: float) -> Any:
        """Number of the columns E^-1 H at time t (s); a new one asks for new columns."""
        return 0

    @property
    def in_use(self) -> Any:
        """Which columns are in use, at whatever time."""
        return 0

    def port_entries(self, ports: np.ndarray, t: float) -> tuple[np.ndarray, Array, Array, Array]:
        """Columns of ports that move, (k, m): coordinates that each has, their entries, and two rates of these, 1/s, 1/s^2."""
        none = np.zeros((0, 0))
        return none.astype(int), none, none, none

    @property
    def tangent_version(self) -> int:
        """Number of the tangent that the field holds; a new one asks for a new factor."""
        return 0

    def port_shares(self, w: Array, t: float) -> Array:
        """What this rank's coordinates have in ``ports_of``."""

    def port_columns(self, used: np.ndarray, t: float) -> Array:
        """Columns (n, count) of ``port_force`` for the port numbers ``used``."""

    def port_gram(self, t: float) -> Array:
        """P P^T of the ports p = P w, (n_port, n_port): ports of neighbouring surfaces share nodes; collective."""

    def corotation(self, u: Array) -> Array | None:
        """Rotation (d, d) in which the factored tangent acts, None for the field's own axes; collective."""
        return None

    def missing_momentum(self, u: Array) -> Array | None:
        """Rows (n_rot, n) of the moments of M u x, if these are missing from the columns of inertia, else None; collective."""
        return None

    @property
    def foretells(self) -> bool:
        """Whether an increment of Newton foretells stresses for the tangent, see :meth:`relinearise`."""
        return False

    @property
    def renewable(self) -> bool:
        """Whether :meth:`relinearise` changes anything."""
        return False

    @property
    def keeps_tangents(self) -> bool:
        """Whether tangents are kept until increments have paid for new ones: :mod:`..schemes.tangent_account`."""
        return False

    @property
    def begins_anew(self) -> bool:
        """Whether a step takes a tangent where it is predicted, once steps take new ones: what an older one is off by would be an
        increment many times too large.
        """
        return False

    @property
    def stiffens(self) -> bool:
        """Whether the stress of accelerations changes the stiffness."""
        return False

    def relinearise(
        self, motion: FrameMotion, local: tuple[Array, Array, Array], increment: Approach | None = None
    ) -> bool:
        """Take the tangent at a motion of the frame and local coordinates with two rates; False when it is constant anyway.

        ``increment``: what led there, where it is known. Collective.
        """
        return False

    def free_factors(self) -> None:
        """Free factors that solvers keep with the field."""
        return None


def is_distributed(part: Part) -> TypeGuard[DistributedPart]:
    """Whether the part holds this rank's share of a field."""
    return part.distributed


class FrameElements(Protocol):
    """Elements between several moving frames, such as those of a rod; replicated.

    Pairs (frames (m, k), values) name what belongs to which frames; a frame may occur in many.
    """

    name: str
    frames: np.ndarray  # of the nodes of each element, (m, k)
    kept: Any  # memory of elements that have one, changed by accepted steps only; else None

    def forces(self, t: float, pose: Array, twist: Array | None) -> list[tuple[np.ndarray, Array]]:
        """What they add to the balance M a + h of the frames, values (m, k, n_twist)."""

    def tangents(
        self, t: float, pose: Array, twist: Array | None, weights: tuple[float, float]
    ) -> list[tuple[np.ndarray, Array]]:
        """cd D + ck K for ``weights`` = (cd, ck): derivatives of the forces, values (m, k n_twist, k n_twist)."""

    def mean_forces(
        self, t: float, poses: tuple[Array, Array], twist: Array, h: float
    ) -> list[tuple[np.ndarray, Array]]:
        """As :meth:`forces`, over a step from old to new poses at the mean twist: their work is the change of energy."""

    def energy(self, t: float, pose: Array) -> float:
        """Elastic energy, J."""

    def first(self, ev: Any, state: Any) -> Any:
        """The memory at the start of a run from a state, evaluated as ``ev``."""

    def accepted(self, ev: Any, state: Any) -> Any:
        """The memory after a step that ended in a state, evaluated as ``ev``."""

    def jumps(self, kept: Any) -> bool:
        """Whether forces jump when the memory becomes ``kept``."""

    def memory_values(self) -> Array:
        """The memory as numbers (m,) that small motions change; (0,) where there is none."""

    def set_memory(self, values: Array, t: float) -> None:
        """Take these numbers as the memory at time t, s."""

    def memory_rates(self, ev: Any, t: float) -> Array:
        """Rates (m,) of these numbers in a configuration evaluated as ``ev``, 1/s."""

    def given(self, t: float, pose: Array, twist: Array) -> dict[str, float]:
        """Power (W) of their loads and of their damping."""


@dataclass(frozen=True)
class RigidBlock:
    """All rigid bodies at once: frames (n,), mass (n,) kg, inertia about the centre of mass (n, n_rot, n_rot) kg m^2."""

    motions: Motions
    frame: np.ndarray
    mass: Array
    inertia: Array

    def force(self, twist: Array, accel: Array, gravity: Array) -> Array:
        """Inertia minus weight, rows (n, n_twist): m (r'' - g), J w' + w x J w."""
        m, d = self.motions, self.motions.dim
        v, a = twist[self.frame], accel[self.frame]
        out = np.empty((len(self.frame), m.n_twist))
        out[:, :d] = self.mass[:, None] * (a[:, :d] - gravity)
        if d == 2:
            out[:, 2] = self.inertia[:, 0, 0] * a[:, 2]
            return out
        Jw = (self.inertia @ v[:, d:, None])[..., 0]
        out[:, d:] = (self.inertia @ a[:, d:, None])[..., 0] + m.moment(v[:, d:], Jw)
        return out

    def matrices(self) -> Array:
        """Mass matrices blockdiag(m 1, J), (n, n_twist, n_twist)."""
        d, n = self.motions.dim, self.motions.n_twist
        M = np.zeros((len(self.frame), n, n))
        M[:, range(d), range(d)] = self.mass[:, None]
        M[:, d:, d:] = self.inertia
        return M

    def energies(self, pose: Array, twist: Array, gravity: Array) -> tuple[float, float]:
        """Kinetic energy and potential energy of weight, J."""
        d = self.motions.dim
        v = twist[self.frame]
        kinetic = 0.5 * float((self.mass[:, None] * v[:, :d] ** 2).sum())
        kinetic += 0.5 * float(np.einsum("na,nab,nb->", v[:, d:], self.inertia, v[:, d:]))
        return kinetic, -float((self.mass[:, None] * pose[self.frame, :d] * gravity).sum())

    def momenta(self, pose: Array, twist: Array) -> tuple[Array, Array]:
        """Linear and angular momentum about the origin, world axes."""
        m, d = self.motions, self.motions.dim
        q, v = pose[self.frame], twist[self.frame]
        p = self.mass[:, None] * v[:, :d]
        spin = m.turn(m.matrix(q), (self.inertia @ v[:, d:, None])[..., 0])
        return p.sum(0), (m.moment(q[:, :d], p) + spin).sum(0)
