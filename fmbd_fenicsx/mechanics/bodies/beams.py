"""Straight beams in a floating frame: Euler-Bernoulli or Timoshenko elements as reduced bodies, no mesh library needed.

A cross-section moves rigidly. In the beam's axes (x along it, y and z principal) the material points displace by

    u = U(x) + y V_y(x) + z V_z(x),   U = (u, v, w),  V_y = (-theta_z, 0, theta_x),  V_z = (theta_y, -theta_x, 0)       (1)

so a beam is a basis of fields like any other: with densities rho A, rho I_z, rho I_y of the sections the constants of
``mechanics.reduction.reduced`` are T_ab = int rho A U_a U_b^T + rho I_z V_y,a V_y,b^T + rho I_y V_z,a V_z,b^T dx, all
inertia couplings
included. Elements interpolate with the exact static solution (Hermite functions for GA = infinity, else with the shear
parameter 12 EI / (GA l^2)). The axial force of the inertia forces stiffens bending by int N (v'^2 + w'^2) dx.

Source: Przemieniecki, Theory of Matrix Structural Analysis, 1968, chapters 5 and 15.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ...checks import check_fields, number, typed, vector, whole
from ...errors import InputError, near, require
from ...rotations import Array
from ..body import rigid_twist
from ..cross_sections import Shape, rectangle, ring, shear_modulus
from ..reduction.reduced import ModalBody, ReducedConstants
from .beam_elements import BeamElements, constants_of
from .bodies import Surface


@dataclass(frozen=True)
class Section:
    """Stiffness and inertia of a cross-section, constant along the beam.

    ``EA`` N, ``EI`` N m^2 (about z; in space also ``EI_y`` about y and ``GJ``), ``rhoA`` kg/m, ``rhoI`` kg m (about z; in
    space also ``rhoI_y``), ``GA`` shear stiffness N, None for Euler-Bernoulli.
    """

    EA: float
    EI: float
    rhoA: float
    rhoI: float = 0.0
    GA: float | None = None
    EI_y: float | None = None
    GJ: float | None = None
    rhoI_y: float | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        stiff = {"EA": self.EA, "EI": self.EI, "rhoA": self.rhoA, "GA": self.GA, "EI_y": self.EI_y, "GJ": self.GJ}
        for name, value in stiff.items():
            if value is not None:
                number(f"Section: {name} =", value, above=0.0)
        number("Section: rhoI =", self.rhoI, least=0.0)
        number("Section: rhoI_y =", 0.0 if self.rhoI_y is None else self.rhoI_y, least=0.0)

    @property
    def thickness(self) -> float:
        """Height (m) of the rectangle with this ratio of stiffnesses; a drawing shows it."""
        return float(np.sqrt(12 * self.EI / self.EA))

    @classmethod
    @typed
    def rectangle(
        cls, *, youngs_modulus: float, poisson_ratio: float, density: float, width: float, height: float
    ) -> Section:
        """A solid rectangle: ``height`` along y, ``width`` along z (m); shear factor 5/6, torsion constant to 0.1 %."""
        what = "Section.rectangle"
        return cls._of(what, rectangle(what, width, height), youngs_modulus, poisson_ratio, density)

    @classmethod
    @typed
    def circle(
        cls, *, youngs_modulus: float, poisson_ratio: float, density: float, radius: float, inner: float = 0.0
    ) -> Section:
        """A disc, or a ring with the radius ``inner`` (m); shear factor of Cowper, :func:`.ring`."""
        return cls._of("Section.circle", ring(radius, inner, poisson_ratio), youngs_modulus, poisson_ratio, density)

    @classmethod
    def _of(cls, what: str, shape: Shape, E: float, nu: float, density: float) -> Section:
        """From a shape with the second moments about z and y, and the material."""
        A, Iz, Iy, J, factor = shape
        G = shear_modulus(what, E, nu, density)
        return cls(E * A, E * Iz, density * A, density * Iz, factor * G * A, E * Iy, G * J, density * Iy)


@dataclass(frozen=True, eq=False)
class Beam(ModalBody):
    """A straight elastic beam from ``start`` to ``end`` (world, m; two components in the plane, three in space).

    Args:
        name: what messages call it. Its surfaces are the end sections "start" and "end".
        section: stiffness and inertia.
        elements: number of elements.
        modes: vibration modes to keep; None keeps every degree of freedom.
        attached: True: the frame holds the start section; False: mean axes.
        stiffening: geometric stiffness of the axial force by inertia, held at the start section, in either frame.
        up: direction of the section's y axis in space; any direction across the beam when None.
        velocity, angular_velocity: rigid motion at the start (of the centre of mass; rad/s).
        mass_damping, stiffness_damping: Rayleigh coefficients alpha (1/s) and beta (s).
    """

    name: str
    start: Sequence[float]
    end: Sequence[float]
    section: Section
    elements: int = 10
    modes: int | None = None
    attached: bool = True
    stiffening: bool = False
    up: Sequence[float] | None = None
    velocity: Any = None
    angular_velocity: Any = None
    mass_damping: float = 0.0
    stiffness_damping: float = 0.0

    interpolated = True

    @property
    def space_rate(self) -> float:
        """Of cubic elements."""
        return 8.0

    @property
    def has_refined_basis(self) -> bool:
        """Where modes are left out."""
        return self.modes is not None

    @property
    def keeps_energy(self) -> bool:
        """Without damping."""
        return not (self.mass_damping or self.stiffness_damping)

    def __post_init__(self) -> None:
        what = f'Beam "{self.name}"'
        check_fields(self, what)
        require(
            self.dim in (2, 3) and len(self.end) == self.dim,
            f"{what}: start {self.start} and end {self.end} must both have 2 or 3 numbers.",
        )

        require(self.length > 0, f"{what}: start and end coincide.")
        whole(f"{what}: elements", self.elements, least=1)
        if self.modes is not None:
            whole(f"{what}: modes", self.modes)
        if self.up is not None:
            vector(f"{what}: up", self.up, size=self.dim, zero=False)

        number(f"{what}: mass_damping", self.mass_damping, least=0.0)
        number(f"{what}: stiffness_damping", self.stiffness_damping, least=0.0)
        self.start_twist()
        if self.dim == 3:
            s = self.section
            require(
                s.EI_y is not None and s.GJ is not None and s.rhoI_y is not None,
                f'Beam "{self.name}" in space: the section needs EI_y, GJ and rhoI_y too.',
            )

    @property
    def dim(self) -> int:  # type: ignore[override]
        """Space dimension, from the end points."""
        return len(self.start)

    @property
    def length(self) -> float:
        """m."""
        return float(np.linalg.norm(np.subtract(self.end, self.start)))

    def surface(self, name: str) -> Surface:
        """An end section: "start" or "end"."""
        if name not in ("start", "end"):
            raise InputError(f'Beam "{self.name}": no surface "{name}". {near(name, ["start", "end"])}')
        return Surface(self, name)

    def start_twist(self) -> Array:
        """Rigid velocity at the start, (n_twist,)."""
        return rigid_twist(self)

    def with_refined_basis(self, surfaces: tuple[str, ...]) -> Beam:
        """The same beam with all degrees of freedom of its elements."""
        return replace(self, modes=None)

    def with_finer_space(self, *, higher: bool) -> Beam:
        """The same beam with twice the elements: their degree is fixed. As many modes."""
        return replace(self, elements=2 * self.elements)

    @cached_property
    def constants(self) -> ReducedConstants:  # type: ignore[override]
        """What the time loop needs."""
        return constants_of([self])[0]

    @classmethod
    def prepare(cls, bodies: Sequence[Any]) -> None:
        """The constants of all of them, and what follows from these."""
        new = [beam for beam in bodies if "constants" not in vars(beam)]
        for beam, made in zip(new, constants_of(new), strict=True):
            vars(beam)["constants"] = made
        super().prepare(bodies)

    def centre_line(self, per_element: int = 4) -> Array:
        """Points of the centre line from the centre of mass, and their modes, (n, d, 1 + modes); world axes of the start, m."""
        return BeamElements([self]).centre_line(per_element)
