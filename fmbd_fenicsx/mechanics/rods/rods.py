"""Geometrically exact rods in space (Simo and Reissner): the body that a user describes, and its mesh.

Large rotations and finite strains of stretch, shear, twist and bending in absolute coordinates. The nodes are moving frames of
the system, exactly as rigid bodies are, so joints, springs, loads and sensors at them work in every scheme; the elements of
:mod:`.elements` act between them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from ...checks import check_fields, number, whole
from ...errors import InputError, near, require
from ...rotations import Array, Vector
from ..bodies.bodies import Surface
from ..body import Body, rigid_twist
from .curves import Curve, constant_or_along
from .elements import LineLoad, RodElements
from .sections import RodSection
from .strains import shape_of

ENDS = ("start", "end")
ON_CURVE = 1e-6  # distance of a station from the curve, over its length
LARGEST_TURN = np.pi / 2  # between neighbouring nodes of the reference


def node_name(rod: str, node: int) -> str:
    """Name of the frame of a rod's node, counted from 0."""
    return f"{rod}, node {node + 1}"


@dataclass(frozen=True, eq=False)
class RodLoad:
    """A load along a rod: ``law``(s, t) -> (3,), N/m; ``turns``: a moment, N m/m; ``follower``: in axes of the sections.

    s is the arc length (m) of the rod without load, t the time (s). World axes else, per length of the rod without load.
    """

    law: Callable[[float, float], Any]
    follower: bool = False
    turns: bool = False

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True, eq=False)
class Rod(Body):
    """A geometrically exact rod in space; sections stay plane, shear is free.

    Args:
        name: what messages call it.
        curve: points (n, 3) in m, with a smooth spline through them (two: a straight rod), or a function of u in [0, 1].
        section: stiffness and inertia of the cross-section, see :class:`RodSection`.
        elements, degree: number of elements and degree (1, 2 or 3) of the interpolation; the order in space is twice the
            degree. The quadrature follows from the degree: nothing locks.
        normal: direction of section axis 2 (its part across the curve), (3,) or a function of s; None: carried along without
            twist from the world axis most across the start.
        twist: angle (rad) of the sections about the tangent, a function of s (m), on top.
        stations: names of places along the rod: name -> arc length s (m), or a point (3,) on the curve (m). They become nodes,
            and surfaces like the ends.
        loads: loads along the rod, :class:`RodLoad`.
        damping: time (s) of Kelvin-Voigt damping: section forces C (e + damping e').
        prestrain: strains (6,) at which the section is free of stress, beyond those of the curve, or a function of s.
        velocity, angular_velocity: of a rigid motion at the start, about the centre of mass; world axes, m/s, rad/s.

    Surfaces are "start", "end" and the stations: sections that joints, ties, forces and sensors attach to.
    """

    framed = False
    interpolated = True

    name: str
    curve: Any
    section: RodSection
    elements: int = 10
    degree: int = 3
    normal: Any = None
    twist: Callable[[float], float] | None = None
    stations: Mapping[str, Any] = field(default_factory=dict)
    loads: Sequence[RodLoad] = ()
    damping: float = 0.0
    prestrain: Any = None
    velocity: Vector | None = None
    angular_velocity: Any = None
    dim: int = field(init=False, default=3)

    @property
    def space_rate(self) -> float:
        """Of the order twice the degree."""
        return float(4.0**self.degree)

    @property
    def may_do_work(self) -> bool:
        """Loads may."""
        return bool(self.loads)

    @property
    def keeps_energy(self) -> bool:
        """Without loads, damping and relaxation."""
        return not (self.loads or self.damping or len(self.section.relaxation))

    def __post_init__(self) -> None:
        what = f'Rod "{self.name}"'
        check_fields(self, what)
        whole(f"{what}: elements", self.elements, least=1)
        number(f"{what}: damping", self.damping, least=0.0, unit="s")
        require(
            self.degree in (1, 2, 3),
            f"{what}: degree {self.degree} must be 1, 2 or 3: with these, as many Gauss points as the degree cannot lock.",
        )
        self._check_turns()

    def _place(self, name: str, given: Any) -> float:
        """Arc length of a station, m, checked: it lies on the curve and has a name of its own."""
        length = self.reference.length
        require(name not in ENDS, f'Rod "{self.name}": a station cannot be called "{name}": its ends are.')
        if np.ndim(given) == 0:
            require(
                bool(np.isfinite(given)) and 1e-9 * length < given < (1 - 1e-9) * length,
                f'Rod "{self.name}": station "{name}" at s = {given} m is off the curve, which is {length:.6g} m long. Its '
                'ends are the surfaces "start" and "end".',
            )
            return float(given)

        point = np.asarray(given, dtype=float)
        require(
            point.shape == (3,) and bool(np.isfinite(point).all()),
            f'Rod "{self.name}": station "{name}" must be an arc length (m) or a point (3,), found {given!r}.',
        )
        s, distance = self.reference.nearest(point)
        require(
            distance <= ON_CURVE * length,
            f'Rod "{self.name}": station "{name}" at {point.tolist()} is off the curve by {distance:.3g} m; the nearest '
            f"place is s = {s:.6g} m.",
        )
        return s

    def _check_turns(self) -> None:
        """Neighbouring nodes turn little against each other."""
        R = self.poses_matrix
        cosine = 0.5 * (np.einsum("nij,nij->n", R[1:], R[:-1]) - 1.0)
        turn = np.arccos(np.clip(cosine, -1.0, 1.0))
        worst = int(turn.argmax())
        if turn[worst] > LARGEST_TURN:
            raise InputError(
                f'Rod "{self.name}": its sections turn by {np.degrees(turn[worst]):.0f} degrees from '
                f"s = {self.nodes[worst]:.4g} m to {self.nodes[worst + 1]:.4g} m, too much between two nodes. Take at least "
                f"{int(np.ceil(self.elements * turn[worst] / LARGEST_TURN))} elements."
            )

    # -- mesh -------------------------------------------------------------------------------------------------------
    @cached_property
    def reference(self) -> Curve:
        """The curve by its arc length."""
        return Curve(self.name, self.curve)

    @cached_property
    def places(self) -> dict[str, float]:
        """Arc lengths of the stations, m."""
        return {name: self._place(name, given) for name, given in self.stations.items()}

    @cached_property
    def breaks(self) -> Array:
        """Arc lengths of the element ends, (m + 1,): equal lengths between stations."""
        length = self.reference.length
        inner = [s for s in self.places.values() if 1e-9 * length < s < (1 - 1e-9) * length]
        stops = np.unique([0.0, *inner, length])

        pieces = []
        for start, end in pairwise(stops):
            share = (end - start) / length
            count = max(1, round(self.elements * share))
            pieces.append(np.linspace(start, end, count, endpoint=False))
        return np.concatenate((*pieces, [length]))

    @property
    def length(self) -> float:
        """Length of the curve, m."""
        return self.reference.length

    @cached_property
    def nodes(self) -> Array:
        """Arc lengths of the nodes, ascending."""
        xi = shape_of(self.degree).nodes
        half = 0.5 * np.diff(self.breaks)
        inner = self.breaks[:-1, None] + half[:, None] * (1 + xi[:-1])
        return np.concatenate((inner.ravel(), self.breaks[-1:]))

    @cached_property
    def _at_nodes(self) -> tuple[Array, Array]:
        """Places and tangents of the nodes, (n, 3)."""
        return self.reference.at(self.nodes)

    @cached_property
    def poses_matrix(self) -> Array:
        """Section axes at the nodes of the reference, (n, 3, 3)."""
        return self.reference.axes(self.nodes, self._at_nodes, self.normal, self.twist)

    @cached_property
    def poses(self) -> Array:
        """Poses of the nodes at the start, (n, 7)."""
        from scipy.spatial.transform import Rotation

        turned = Rotation.from_matrix(self.poses_matrix).as_quat()
        square = turned[:, None] @ turned[:, :, None]
        return np.concatenate((self._at_nodes[0], turned / np.sqrt(square[:, 0])), axis=1)

    @cached_property
    def connectivity(self) -> np.ndarray:
        """Nodes of the elements, (m, degree + 1)."""
        return np.arange(len(self.breaks) - 1)[:, None] * self.degree + np.arange(self.degree + 1)

    @cached_property
    def lengths(self) -> Array:
        """Length of the rod that belongs to each node, m: Gauss-Lobatto weights."""
        weights = 0.5 * np.diff(self.breaks)[:, None] * shape_of(self.degree).node_weights
        return np.bincount(self.connectivity.ravel(), weights.ravel()).astype(float)

    @cached_property
    def inertia(self) -> tuple[Array, Array]:
        """Masses (n,), kg, and rotary inertias (n, 3, 3), kg m^2, of the nodes."""
        return self.lengths * self.section.masses(self.nodes), self.lengths[:, None, None] * self.section.inertias(
            self.nodes
        )

    def start_twists(self) -> Array:
        """Twists of the nodes at the start, (n, 6)."""
        given = rigid_twist(self)
        mass = self.inertia[0]
        x = self.poses[:, :3]
        # a rigid motion about the centre of mass: rotations in the axes of the sections
        arm = x - (mass @ x) / mass.sum()
        linear = given[:3] + np.cross(given[3:], arm)
        return np.concatenate((linear, np.einsum("nji,j->ni", self.poses_matrix, given[3:])), axis=1)

    # -- surfaces ---------------------------------------------------------------------------------------------------
    def surface(self, name: str) -> Surface:
        """A section: "start", "end" or a station."""
        known = [*ENDS, *self.stations]
        if name not in known:
            raise InputError(f'Rod "{self.name}": no section "{name}". {near(name, known)}')
        return Surface(self, name)

    def with_finer_space(self, *, higher: bool) -> Rod:
        """The same rod with twice the elements, on the same curve, so that its nodes turn less against each other."""
        kept = {f.name: getattr(self, f.name) for f in fields(self)}
        finer = object.__new__(type(self))
        finer.__dict__.update(kept, elements=2 * self.elements, reference=self.reference, places=self.places)
        return finer

    def node_of(self, section: str) -> int:
        """Number of the node of a named section."""
        if section in ENDS:
            return 0 if section == "start" else len(self.nodes) - 1
        return int(np.argmin(np.abs(self.nodes - self.places[section])))

    def elements_on(self, first: int) -> RodElements:
        """The elements of a system in which the nodes are the frames from ``first`` on."""
        shape = shape_of(self.degree)
        half = 0.5 * np.diff(self.breaks)
        points = self.breaks[:-1, None] + half[:, None] * (1 + shape.points)
        made = RodElements(self.name, first + self.connectivity, shape, half, np.zeros((*points.shape, 6)))
        made.points = points
        made.breaks = self.breaks

        # free of stress as it lies, but for prestrains
        poses = np.concatenate((np.zeros((first, 7)), self.poses))
        made.natural = made.strains(poses) + self._prestrains(points)

        # material and loads
        made.law = self.section.law(points)
        made.beta = self.damping
        made.arms = self.section.arms(points)
        made.kept = None if made.arms is None else made.arms.relaxed()
        made.loads = tuple(
            LineLoad(self.name, x.law, self.lengths, self.nodes, x.follower, x.turns) for x in self.loads
        )
        return made

    def _prestrains(self, points: Array) -> Array:
        """Strains free of stress, beyond those of the curve, (m, q, 6)."""
        if self.prestrain is None:
            return np.zeros((*points.shape, 6))
        found = constant_or_along(f'Rod "{self.name}": prestrain', self.prestrain, points.ravel(), 6)
        return found.reshape(*points.shape, 6)
