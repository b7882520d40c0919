"""Bodies as a user describes them: data and checks, no computation.

Every body has a ``name``, a dimension ``dim`` and can be attached to joints and forces. An elastic body is attached by its
named surfaces, a rigid body by any point.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from ...checks import array, check_fields, instance, number, vector, whole, word
from ...energies import Hooke, MixedEnergy, SheetEnergy, StoredEnergy, ViscousForm
from ...errors import InputError, require
from ...fem.density import Density, check_density
from ...fem.elastic_forms import ElasticForms
from ...fem.loads import Load
from ...rotations import Array, Vector, motions
from ..body import FIELDS, ORIGIN, Body, Placed, Site, rigid_twist
from ..placements import Attached, Chord, MeanAxis, Part

if TYPE_CHECKING:
    from ...fem.traces.stability import OnSurface

Same = TypeVar("Same", bound="ElasticBody")


HIGHEST_DEGREE = 3  # of displacements


@dataclass(frozen=True, eq=False)
class RigidBody(Body):
    """A rigid body, placed by x = r + R X with X from the centre of mass.

    Args:
        name: what messages and sensors call it.
        mass: kg, positive.
        inertia: about the centre of mass in body axes, kg m^2: a number (plane), or (3,) principal values or (3, 3) (space).
        position: centre of mass at the start, world axes, m, (d,).
        rotation: attitude at the start: an angle (rad) in the plane; in space a matrix (3, 3), quaternion (scalar last) or
            SciPy's Rotation.
        velocity: of the centre of mass at the start, m/s, (d,).
        angular_velocity: at the start, body axes, rad/s: a number or (3,).
        locked: True keeps the body where it is; it then has no unknowns.
        shape: what it looks like in pictures, in body axes from the centre of mass: a shape of :mod:`fmbd_fenicsx.contacts`
            (box, cylinder, sphere, ...), an STL file (lengths in m), a mesh of :func:`~fmbd_fenicsx.read_gmsh`, or a list of
            them. None: what it touches with, else bars to its joints. It has no part in the motion.
    """

    by_surface = False

    name: str
    mass: float
    inertia: Any
    position: Vector = ORIGIN
    rotation: Any = None
    velocity: Vector | None = None
    angular_velocity: Any = None
    locked: bool = False
    dim: int = field(init=False)
    shape: Any = None

    def __post_init__(self) -> None:
        if self.shape is not None:
            from .appearance import check_shape

            check_shape(self.name, self.shape)

        what = f'Body "{self.name}"'
        check_fields(self, what)
        number(f"{what}: mass", self.mass, above=0.0, unit="kg")
        J = array(f"{what}: inertia", self.inertia, shape="a number (plane), (3,) or (3, 3) finite numbers (space)")
        object.__setattr__(self, "dim", 2 if J.ndim == 0 else 3)
        self._check_start(what)

        # in space there is a body with this inertia
        if self.dim == 2:
            number(f"{what}: inertia", J, above=0.0, unit="kg m^2 (a mass at a point is a fmbd.PointMass)")
            return
        require(J.shape in ((3,), (3, 3)), f"{what}: inertia must have shape (3,) or (3, 3), found {J.shape}.")
        if J.ndim == 2 and not (np.abs(J - J.T) <= 1e-12 * (np.abs(J).max() + np.abs(J.T))).all():
            raise InputError(f'Body "{self.name}": inertia is not symmetric: {J.tolist()}.')

        p = np.sort(J) if J.ndim == 1 else np.linalg.eigvalsh(J)
        if not p[0] > 0:
            raise InputError(
                f'Body "{self.name}": principal inertias {p} must be positive. A point mass, which does not turn, is a '
                "fmbd.PointMass."
            )
        if not p[0] + p[1] >= p[2] * (1 - 1e-9):
            raise InputError(
                f'Body "{self.name}": principal inertias {p} violate J1 + J2 >= J3; no mass distribution has them.'
            )

    def _check_start(self, what: str) -> None:
        """Pose and twist of the start. Its inertia makes a body plane or not; a position of the other kind shows a slip."""
        given = self.position
        size = len(given) if type(given) in (tuple, list) else np.asarray(given, dtype=object).size
        # texts of arrays cost more than all else that a body needs: they are made for an error only
        if self.dim == 3 and size != 3:
            raise InputError(
                f"{what}: position {self.position} has {size} numbers, but its inertia {self.inertia} is one of space. In the "
                "plane inertia is one number."
            )
        if self.dim == 2 and size == 3 and self.position is not ORIGIN:
            raise InputError(
                f"{what}: inertia {self.inertia} is one number, so the body is plane, and z of its position {self.position} "
                "would be lost. In space inertia is (3,) or (3, 3)."
            )

        try:
            _ = self._pose
        except InputError as error:
            raise error if str(error).startswith(what) else InputError(f"{what}: {error}") from None
        require(
            not (self.locked and self._twist.any()),
            f"{what} is locked and stays where it is: leave out its velocity, or locked=True.",
        )

    @property
    def inertia_matrix(self) -> Array:
        """(n_rot, n_rot)."""
        J = np.asarray(self.inertia, dtype=float)
        return J.reshape(1, 1) if J.ndim == 0 else np.diag(J) if J.ndim == 1 else J

    def part(self, frame: int) -> Part | None:
        """What moves in the body, or changes it, beside its own mass and inertia: a part on its frame. None: nothing.

        A body of a user's own inherits from this class and returns its :class:`~..placements.Part` here.
        """
        return None

    def start_local(self) -> tuple[Array, Array]:
        """Local coordinates of that part and their rates at the start, (n,) each."""
        return np.zeros(0), np.zeros(0)

    def placed(self, site: Site) -> Placed | None:
        """What moves in the body, where there is anything."""
        inner = self.part(site.frame)
        if inner is None:
            return None
        inner.body = self
        return Placed(inner, *self.start_local())

    def start_pose(self) -> Array:
        """Pose at the start, (n_pose,)."""
        return self._pose.copy()

    def start_twist(self) -> Array:
        """Twist at the start, (n_twist,)."""
        return self._twist.copy()

    # A scene asks for both several times.
    @cached_property
    def _pose(self) -> Array:
        position = vector(f'Body "{self.name}": position', self.position, size=self.dim)
        return motions(self.dim).pose(position, self.rotation)

    @cached_property
    def _twist(self) -> Array:
        return rigid_twist(self)


@dataclass(frozen=True, eq=False)
class Surface:
    """A named surface of an elastic body: what joints, forces and sensors attach to."""

    body: Any
    name: str

    @property
    def dim(self) -> int:
        """Space dimension of the body."""
        return int(self.body.dim)

    def multipliers_on(self) -> OnSurface:
        """Where multipliers act that hold the surface."""
        from ...fem.traces.stability import OnSurface

        return OnSurface(self.body.mesh, self.name, self.body.degree)

    def __repr__(self) -> str:
        return f'surface "{self.name}" of "{self.body.name}"'


@dataclass(frozen=True, eq=False)
class ElasticBody(Body):
    """What elastic bodies have in common, however they are placed.

    Args:
        name: what messages and sensors call it.
        mesh: from :func:`fmbd_fenicsx.read_gmsh`, in world coordinates of the start, or of the stress-free state.
        degree: of the Lagrange displacements (2 by default: P1 is far too stiff in bending).
        density: kg/m^3 (in the plane: kg/m^2 of the sheet); or one for each volume of the mesh, by its name; or a function of
            the place x (m), where the body lies at the start, that gives a UFL expression.
        elastic: the elastic form a(u, v, dx) in UFL, symmetric and bilinear; or
        energy: the elastic energy Pi(u, dx) in UFL, J, for instance from :mod:`fmbd_fenicsx.materials`. Either may be a
            :class:`~fmbd_fenicsx.MixedEnergy` of displacement and pressure, for nu up to 1/2.
        velocity, angular_velocity: of a rigid motion at the start (about the centre of mass), added to
            ``displacement_rate``; world axes = body axes, m/s, rad/s.
        displacement, displacement_rate: initial u(x), u'(x): functions of the coordinates (d, n) -> (d, n) in m, m/s.
        mass_damping, stiffness_damping: Rayleigh coefficients alpha (1/s) and beta (s); the stiffness is that of the body without
            stress, and at constant pressure where an energy has one.
        quadrature: degree of the quadrature of the elastic form or energy; None: what the form asks
            for, on hexahedra 2 degree + 1, at most 4 (degree - 1) of an energy, whose forces and tangent then have the same.
        loads: of :mod:`fmbd_fenicsx.fem.loads`: tractions, pressure, body forces, thermal stress, own forms.
        viscous: Kelvin-Voigt damping: a bilinear form (u, v, dx) of the rate u of the local displacements; or, of absolute
            bodies with an energy, a :class:`~fmbd_fenicsx.ViscousForm` (u, rate, v, dx), for instance
            :func:`~fmbd_fenicsx.materials.kelvin_voigt`, which damps strain and never rigid motion.
    """

    nodal = meshed = interpolated = True
    stage = FIELDS

    name: str
    mesh: Any
    degree: int = 2
    density: Density = field(kw_only=True)
    elastic: Callable[[Any, Any, Any], Any] | None = None
    energy: Callable[[Any, Any], Any] | MixedEnergy | None = None
    velocity: Vector | None = None
    angular_velocity: Any = None
    displacement: Callable[[Array], Array] | None = None
    displacement_rate: Callable[[Array], Array] | None = None
    mass_damping: float = 0.0
    stiffness_damping: float = 0.0
    quadrature: int | None = None
    loads: Sequence[Load] = ()
    viscous: Callable[[Any, Any, Any], Any] | ViscousForm | None = None

    def __post_init__(self) -> None:
        """Check density, degree, damping, and one description of elasticity."""
        from ...fem.mesh.mesh import Mesh

        n = self.name
        what = f'Body "{n}"'

        # materials in each other's place, before their arguments are counted
        require(
            not isinstance(self.elastic, StoredEnergy), f"{what}: elastic is a stored energy; give it as energy=..."
        )
        require(not isinstance(self.energy, Hooke), f"{what}: energy is a bilinear form; give it as elastic=...")
        check_fields(self, what)
        instance(f"{what}: mesh", self.mesh, Mesh)

        # one description of elasticity
        require(
            (self.elastic is None) != (self.energy is None),
            f'Body "{n}": give either elastic(u, v, dx), a bilinear form, or energy(u, dx), in J.',
        )
        given = self.elastic_law
        require(
            callable(given), f'Body "{n}": elastic must be a function (u, v, dx) -> UFL form, energy one of (u, dx).'
        )
        if self.dim == 3 and (isinstance(given, SheetEnergy) or (isinstance(given, Hooke) and given.sheet)):
            raise InputError(
                f"{what}: materials.{given.name} is a law of sheets in the plane, and {self.mesh.label} is in space. Take "
                "materials.linear_elastic, or an energy such as materials.neo_hookean."
            )

        # numbers
        check_density(f"{what}: density", self.density, self.mesh)
        require(1 <= self.degree <= HIGHEST_DEGREE, f"{what}: degree {self.degree} must be 1, 2 or 3.")
        if self.quadrature is not None:
            whole(f"{what}: quadrature", self.quadrature, least=1)
        require(
            not isinstance(self.viscous, ViscousForm) or (isinstance(self, AbsoluteBody) and self.nonlinear),
            f'Body "{n}": a ViscousForm needs an AbsoluteBody with an energy. Else give viscous(u, v, dx), bilinear in the rate.',
        )
        number(f"{what}: mass_damping", self.mass_damping, least=0.0, unit="1/s")
        number(f"{what}: stiffness_damping", self.stiffness_damping, least=0.0, unit="s")

        self.start_twist()
        for load in self.loads:
            load.check(self)

    @property
    def dim(self) -> int:  # type: ignore[override]
        """Space dimension, from the mesh."""
        return int(self.mesh.dim)

    @property
    def displacement_degree(self) -> int | None:
        """That of its Lagrange elements."""
        return self.degree

    @property
    def elastic_law(self) -> Any:
        """The form or energy given."""
        return self.energy if self.nonlinear else self.elastic

    @property
    def nonlinear(self) -> bool:
        """An energy is given."""
        return self.energy is not None

    @property
    def may_do_work(self) -> bool:
        """Loads may."""
        return bool(self.loads)

    @property
    def keeps_energy(self) -> bool:
        """Without loads and damping."""
        damped = self.mass_damping or self.stiffness_damping or self.viscous is not None
        return not (self.may_do_work or damped)

    def surface(self, name: str) -> Surface:
        """The named surface of the mesh."""
        known = self.mesh.surface_names
        word(f'Body "{self.name}": name of a surface', name)
        if name not in known:
            raise InputError(f'Body "{self.name}": {self.mesh.missing(name)}')
        return Surface(self, name)

    def forms(self) -> ElasticForms:
        """What the field needs to know."""
        return ElasticForms(
            self.elastic,
            self.density,
            self.degree,
            self.mass_damping,
            self.stiffness_damping,
            self.energy,
            self.quadrature,
            tuple(self.loads),
            self.viscous,
        )

    def frequencies(self, n: int, *, held: str | Sequence[str] = ()) -> Array:
        """The first n natural frequencies (Hz) of this body alone, ascending; collective.

        Without ``held`` the body is free and its rigid motions are left out; a held surface keeps its mean position and rotation.
        """
        from ..reduction.natural import natural_frequencies

        return natural_frequencies(self, n, [held] if isinstance(held, str) else held)

    def start_twist(self) -> Array:
        """Rigid velocity of the centre of mass and angular velocity at the start, (n_twist,)."""
        return rigid_twist(self)

    def with_(self: Same, **changes: Any) -> Same:
        """A copy with some arguments changed."""
        return replace(self, **changes)

    def with_finer_space(self: Same, *, higher: bool) -> Same:
        """The same body with ``higher`` degree, up to :data:`HIGHEST_DEGREE`, or on a mesh of half the cell size; collective.

        Raises MeshError where the mesh cannot be made again.
        """
        if higher and self.degree < HIGHEST_DEGREE:
            return replace(self, degree=self.degree + 1)
        return replace(self, mesh=self.mesh.refined())


@dataclass(frozen=True, eq=False)
class FloatingBody(ElasticBody):
    """An elastic body in a floating frame: x = r + R (X + u), u small, in V_h.

    With ``elastic`` strains are linear in the frame. An ``energy`` with the full nonlinear strain carries the stiffening by
    initial stress, which a linear form leaves out.

    Args:
        name, mesh, ... viscous: see :class:`ElasticBody`.
        frame: :class:`MeanAxis` (default), :class:`Attached` or :class:`Chord`.
        stiffening: True adds the geometric stiffness of the stress by inertia forces, held by the surface of an attached
            frame; the name of a surface does the same in any frame, with that surface holding the body.
    """

    frame: MeanAxis | Attached | Chord = MeanAxis()
    stiffening: bool | str = False

    def __post_init__(self) -> None:
        super().__post_init__()
        require(
            self.stiffening is not True or isinstance(self.frame, Attached),
            f'Body "{self.name}": stiffening=True needs a frame attached to the surface that holds the body: '
            'frame=Attached(...). In other frames name that surface: stiffening="pin".',
        )
        require(
            not self.stiffening or self.elastic is not None,
            f'Body "{self.name}": stiffening belongs to a linear form; an energy stiffens by itself.',
        )

        # names of surfaces are looked up now, not in the run
        if isinstance(self.stiffening, str):
            self.surface(self.stiffening)
        if isinstance(self.frame, Attached):
            self.surface(self.frame.surface)
        if isinstance(self.frame, Chord):
            self.surface(self.frame.start)
            self.surface(self.frame.end)

    def placed(self, site: Site) -> Placed:
        """Its field in its frame, with the frame of the start."""
        from ..elastic.floating_start import placed_field

        return placed_field(self, site)

    @property
    def held_at(self) -> str | None:
        """Name of the surface that holds the inertia forces which stiffen the body; None without stiffening."""
        if self.stiffening is True and isinstance(self.frame, Attached):
            return self.frame.surface
        return self.stiffening or None  # type: ignore[return-value]

    def reduced(self, *, modes: int | None = None, frequency: float | None = None, basis: Any = None) -> Any:
        """This body by a few modes: by their number, up to a frequency (Hz), or with a ``basis`` such as
        ``fmbd.CraigBampton(("pin", "tip"), 10)``.

        ``modes=0`` gives the rigid body with the same mass, inertia and surfaces.

        Raises:
            InputError: an energy in place of a linear form, or no basis.
        """
        from ..reduction.craig_bampton import CraigBampton, FrameModes, ReducedBody, RefinedBasis

        require(
            self.elastic is not None,
            f'Body "{self.name}": modes need the linear form elastic(u, v, dx), not an energy.',
        )
        bases = (FrameModes, CraigBampton, RefinedBasis)
        require(
            not isinstance(modes, bases), f'Body "{self.name}": a basis is given by its name, reduced(basis={modes}).'
        )
        if basis is not None:
            instance(f'Body "{self.name}": basis', basis, bases)
        return ReducedBody(self, FrameModes(modes, frequency) if basis is None else basis)


@dataclass(frozen=True, eq=False)
class AbsoluteBody(ElasticBody):
    """An elastic body in absolute coordinates: x = X + u, u in V_h; no floating frame. Arguments of :class:`ElasticBody`.

    With ``elastic`` (linear, bilinear form) displacements and rotations must stay small; the matrix is factored once. With an
    ``energy`` they are of any size (total Lagrangian).
    """

    framed = False

    def placed(self, site: Site) -> Placed:
        """Its field, with the rigid motion of the start in its rates."""
        from ..elastic.absolute import placed_field

        return placed_field(self, site)
