"""What every body says of itself, whatever its kind: each kind overrides where it differs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ..checks import array, vector
from ..errors import InputError
from ..rotations import Array, motions
from .placements import Part

# the order of the parts of a system: equations of the user's own, insides of rigid bodies, lines, modes; then those
# distributed over ranks, fields and wires
EQUATIONS, INSIDES, LINES, MODES, FIELDS, WIRES = range(6)

ORIGIN = (0.0, 0.0, 0.0)  # where nothing is given; the only three numbers that a plane body takes

FASTEST = 1e100  # m/s, rad/s: squares of more are no numbers


@dataclass(frozen=True)
class Site:
    """Where the part of a body goes: numbers of its ``frame`` and of the ``ground``, names of its ``surfaces`` in use.

    ``slides``: what slides along its wires, (wire, t -> x, x', x''). ``field``: makes the elastic field of a body for a scene.
    """

    frame: int
    ground: int
    surfaces: list[str]
    slides: Sequence[tuple[int, Any]]
    field: Callable[[Any], Any]


@dataclass(frozen=True)
class Placed:
    """A part with its local coordinates and rates at the start, and pose and twist of its frame where these follow from it."""

    part: Part
    q: Array
    v: Array
    pose: Array | None = None
    twist: Array | None = None


class Body:
    """The members that all bodies share.

    Attributes:
        name: what messages and sensors call it. ``dim``: 2 or 3, None: it fits scenes of any dimension.
        nodal: its unknowns are values at the nodes of a mesh, spread over the ranks.
        meshed: it has a mesh, whose surfaces can touch and whose displacements can be drawn.
        framed: it moves with one frame of its own.
        turns: it has an attitude, which joints and moments can act on.
        modal: it has amplitudes of modes as unknowns, computed from a mesh.
        interpolated: its motion is interpolated in space, with an error that finer elements make smaller.
        by_surface: joints and forces take hold of its named surfaces, not of the body.
        by_section: its surfaces are sections of a line.
        locked: it stays where it is and has no unknowns.
        alone: nobody expects anything attached to it.
        stage: place of its part among those of a system.
    """

    name: str
    dim: int | None
    nodal: ClassVar[bool] = False
    meshed: ClassVar[bool] = False
    framed: ClassVar[bool] = True
    turns: ClassVar[bool] = True
    modal: ClassVar[bool] = False
    interpolated: ClassVar[bool] = False
    by_surface: ClassVar[bool] = True
    by_section: ClassVar[bool] = False
    alone: ClassVar[bool] = False
    stage: ClassVar[int] = INSIDES
    locked: bool = False

    @property
    def body(self) -> Body:
        """Itself: what is attached to a surface is attached to a body too."""
        return self

    @property
    def solid(self) -> Any:
        """The body on whose mesh its displacements live: itself, or the one that it reduces."""
        return self

    @property
    def space_rate(self) -> float:
        """By what its error in space falls where the elements are halved; at corners of solids it is less."""
        return 4.0

    @property
    def displacement_degree(self) -> int | None:
        """Degree of the displacements of a solid; None where there is no choice."""
        return None

    @property
    def has_refined_basis(self) -> bool:
        """Whether its motion has an error because modes are left out, which :meth:`with_refined_basis` makes smaller."""
        return False

    @classmethod
    def prepare(cls, bodies: Sequence[Any]) -> None:
        """Make what all bodies of this kind in a scene need, once for all of them; collective."""

    def placed(self, site: Site) -> Placed | None:
        """Its part of a system, None for a body without local coordinates; collective."""
        return None

    def with_finer_space(self, *, higher: bool) -> Body:
        """The body with elements of ``higher`` degree where it may choose, or with smaller ones; collective.

        Raises:
            InputError: no elements interpolate its motion. MeshError: its mesh cannot be made again.
        """
        raise InputError(f'Body "{self.name}" has no elements that could be finer.')

    def with_refined_basis(self, surfaces: tuple[str, ...]) -> Body:
        """The body with more modes, static ones of the ``surfaces`` in use among them; of those that have a finer basis."""
        raise InputError(f'Body "{self.name}" has no modes that could be more.')

    def start_pose(self) -> Array:
        """Pose at the start, (n_pose,); none where it is known with the part."""
        return np.zeros(0)

    @property
    def elastic_law(self) -> Any:
        """Its elastic law: a bilinear form or an energy, None where it has none."""
        return None

    @property
    def nonlinear(self) -> bool:
        """Whether its displacements have an energy, whose stiffness changes with them, and no bilinear form."""
        return False

    @property
    def may_do_work(self) -> bool:
        """Whether it may put energy into a scene: by loads, or by equations of a user's own."""
        return False

    @property
    def keeps_energy(self) -> bool:
        """Whether its own forces keep the sum of the recorded energies: no damping, no loads, nothing that is not recorded."""
        return not self.may_do_work


def start_velocity(what: str, value: Any, size: int) -> Array:
    """A velocity (size,), zero where none is given."""
    if value is None:
        return np.zeros(size)
    found = array(what, value)
    if found.ndim == 0:
        found = found[None]
    if found.shape != (size,):
        found = vector(what, found, size=size)
    numbers: Any = found.tolist()
    if not max(map(abs, numbers)) < FASTEST:
        raise InputError(f"{what} {value} must be below {FASTEST:g}.")
    return found


def rigid_twist(body: Any) -> Array:
    """Twist (n_twist,) at the start of a body with a ``velocity`` and an ``angular_velocity``, zero where none is given."""
    what, m = f'Body "{body.name}"', motions(body.dim)
    v = start_velocity(f"{what}: velocity", body.velocity, m.dim)
    return np.concatenate((v, start_velocity(f"{what}: angular_velocity", body.angular_velocity, m.n_rot)))
